//! ROS's camera_info: the file that `camera_calibration` saves, or a message as `topic echo` shows it (`K`, `D`,
//! `width`).

use super::yaml::Node;
use super::{from_matrices, list};
use crate::rig::{Camera, RigError};

pub(super) fn read(root: &Node<'_>) -> Result<Camera, RigError> {
    // Older files name no model and mean plumb_bob; rational_polynomial has three more coefficients.
    if let Some(model) = root.get(&["distortion_model"])
        && !matches!(model.word()?, "plumb_bob" | "rational_polynomial")
    {
        return Err(model
            .wrong("plumb_bob or rational_polynomial: a rig holds k1, k2, p1, p2, k3 and k4, k5, k6 of these models"));
    }
    let camera = from_matrices(root)?;
    if let Some(model) = root.get(&["distortion_model"])
        && model.word()? == "plumb_bob"
        && camera.lens.is_rational()
    {
        let beyond = camera.lens.denominator;
        return Err(model.wrong(format!("rational_polynomial where k4, k5, k6 are {beyond:?}")));
    }
    Ok(camera)
}

/// There is no rectification; the projection matrix is the camera's own.
pub(super) fn write(camera: &Camera) -> String {
    let [width, height] = camera.size_px;
    let lens = &camera.lens;
    let block = |name: &str, rows: usize, values: &[f64]| {
        format!("{name}:\n  rows: {rows}\n  cols: {}\n  data: [{}]\n", values.len() / rows, list(values))
    };
    [
        format!("image_width: {width}\nimage_height: {height}\ncamera_name: camera\n"),
        block("camera_matrix", 3, &lens.matrix()),
        format!("distortion_model: {}\n", lens.ros_name()),
        block("distortion_coefficients", 1, &lens.coefficients()),
        block("rectification_matrix", 3, &[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]),
        block("projection_matrix", 3, &lens.projection_matrix()),
    ]
    .concat()
}
