//! ROS's camera_info: the file that `camera_calibration` saves, or a message as `topic echo` shows it (`K`, `D`,
//! `width`).

use super::yaml::Node;
use super::{from_matrices, list, matrix};
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
    of_whole_pictures(root, camera.size_px)?;
    Ok(camera)
}

/// The matrix of a message is that of its sensor's whole pictures, which those that are recorded may not be.
fn of_whole_pictures(root: &Node<'_>, size_px: [u32; 2]) -> Result<(), RigError> {
    for name in ["binning_x", "binning_y"] {
        if let Some(binning) = root.get(&[name])
            && binning.number()? > 1.0
        {
            return Err(binning.wrong(
                "0 or 1: the matrix is that of pictures without binning; calibrate with those that you record",
            ));
        }
    }
    let Some(roi) = root.get(&["roi"]) else { return Ok(()) };
    for (name, whole) in [("width", size_px[0]), ("height", size_px[1])] {
        if let Some(side) = roi.get(&[name])
            && ![0.0, f64::from(whole)].contains(&side.number()?)
        {
            return Err(side.wrong(format!(
                "0 or {whole}: the matrix is that of whole pictures; calibrate with those that you record"
            )));
        }
    }
    Ok(())
}

/// There is no rectification; the projection matrix is the camera's own.
pub(super) fn write(camera: &Camera) -> String {
    let [width, height] = camera.size_px;
    let lens = &camera.lens;
    let (f, c) = (lens.focal_px, lens.principal_point_px);
    let block = |name: &str, rows: usize, values: &[f64]| {
        format!("{name}:\n  rows: {rows}\n  cols: {}\n  data: [{}]\n", values.len() / rows, list(values))
    };
    [
        format!("image_width: {width}\nimage_height: {height}\ncamera_name: camera\n"),
        block("camera_matrix", 3, &matrix(lens)),
        format!("distortion_model: {}\n", if lens.is_rational() { "rational_polynomial" } else { "plumb_bob" }),
        block("distortion_coefficients", 1, &lens.coefficients()),
        block("rectification_matrix", 3, &[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]),
        block("projection_matrix", 3, &[f.x, 0.0, c.x, 0.0, 0.0, f.y, c.y, 0.0, 0.0, 0.0, 1.0, 0.0]),
    ]
    .concat()
}
