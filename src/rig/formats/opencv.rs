//! YAML of OpenCV's `FileStorage`, with the names that `samples/cpp/calibration.cpp` writes.

use super::yaml::Node;
use super::{from_matrices, list};
use crate::rig::{Camera, RigError};

pub(super) fn read(root: &Node<'_>) -> Result<Camera, RigError> {
    if let Some(fisheye) = root.get(&["fisheye_model"])
        && fisheye.number()? != 0.0
    {
        return Err(fisheye.wrong("0: a fisheye lens has no place in a rig"));
    }
    from_matrices(root)
}

pub(super) fn write(camera: &Camera) -> String {
    let [width, height] = camera.size_px;
    let matrix_of = |rows: usize, values: &[f64]| {
        format!(
            " !!opencv-matrix\n   rows: {rows}\n   cols: {}\n   dt: d\n   data: [ {} ]\n",
            values.len() / rows,
            list(values)
        )
    };
    format!(
        "%YAML:1.0\n---\nimage_width: {width}\nimage_height: {height}\ncamera_matrix:{}distortion_coefficients:{}",
        matrix_of(3, &camera.lens.matrix()),
        matrix_of(camera.lens.coefficients().len(), &camera.lens.coefficients()),
    )
}
