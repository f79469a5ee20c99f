//! Kalibr's camchain: one camera, pinhole and radtan (k1, k2, p1, p2; there is no k3).

use super::yaml::{Node, pixels};
use super::{camera, list};
use crate::rig::{Camera, RigError};
use std::path::Path;

/// The cameras of a chain: `cam0`, `cam1`, …
pub(super) fn cameras<'a>(root: &Node<'a>) -> Vec<(&'a str, Node<'a>)> {
    let numbered =
        |name: &str| name.strip_prefix("cam").is_some_and(|n| !n.is_empty() && n.bytes().all(|b| b.is_ascii_digit()));
    root.entries().into_iter().filter(|(name, _)| numbered(name)).collect()
}

pub(super) fn read(root: &Node<'_>) -> Result<Camera, RigError> {
    let found = cameras(root);
    let cam = match found.as_slice() {
        [] => root.need(&["cam0"], "the camera of a camchain")?,
        [(_, cam)] => cam.clone(),
        [_, (_, second), ..] => {
            let names: Vec<&str> = found.iter().map(|(name, _)| *name).collect();
            let expected = format!("one camera, there are {}: leave one in the file", names.join(", "));
            return Err(second.wrong(expected));
        }
    };
    for (key, known) in [("camera_model", "pinhole"), ("distortion_model", "radtan")] {
        let model = cam.need(&[key], known)?;
        if model.word()? != known {
            return Err(model.wrong(format!("{known}: a rig holds no other model of Kalibr's")));
        }
    }
    let intrinsics = cam.need(&["intrinsics"], "[fu, fv, pu, pv]")?;
    let &[fx, fy, cx, cy] = intrinsics.numbers()?.as_slice() else {
        return Err(intrinsics.wrong("four numbers [fu, fv, pu, pv]"));
    };
    let coefficients = cam.need(&["distortion_coeffs"], "[k1, k2, r1, r2]")?;
    let &[k1, k2, p1, p2] = coefficients.numbers()?.as_slice() else {
        return Err(coefficients.wrong("four numbers [k1, k2, r1, r2]"));
    };
    let size = cam.need(&["resolution"], "[width, height]")?;
    let &[width, height] = size.numbers()?.as_slice() else {
        return Err(size.wrong("two numbers [width, height]"));
    };
    let Some(size_px) = pixels(width).zip(pixels(height)) else {
        return Err(size.wrong("two whole numbers from 1 to 65535"));
    };
    camera(&intrinsics, size_px.into(), [fx, fy, cx, cy], ([k1, k2, p1, p2, 0.0], [0.0; 3]))
}

/// The camera as a chain of one; `name` is the rig in error messages.
///
/// # Errors
/// [`RigError::Value`] when the lens has a k3 or is rational.
pub(super) fn write(camera: &Camera, name: &Path) -> Result<String, RigError> {
    let [k1, k2, p1, p2, k3] = camera.lens.distortion;
    if camera.lens.is_rational() {
        return Err(RigError::Value {
            file: name.to_path_buf(),
            key: "camera.denominator".to_owned(),
            value: format!("{:?}", camera.lens.denominator),
            expected: "no denominator: Kalibr's radtan model has k1, k2, p1, p2 only".to_owned(),
        });
    }
    if k3 != 0.0 {
        return Err(RigError::Value {
            file: name.to_path_buf(),
            key: "camera.distortion".to_owned(),
            value: format!("{:?}", camera.lens.distortion),
            expected: format!("k3 = 0, it is {k3}: Kalibr's radtan model has k1, k2, p1, p2 only"),
        });
    }
    let (f, c) = (camera.lens.focal_px, camera.lens.principal_point_px);
    let [width, height] = camera.size_px;
    Ok(format!(
        "cam0:\n  cam_overlaps: []\n  camera_model: pinhole\n  distortion_coeffs: [{}]\n  distortion_model: radtan\n  \
         intrinsics: [{}]\n  resolution: [{width}, {height}]\n  rostopic: /cam0/image_raw\n",
        list(&[k1, k2, p1, p2]),
        list(&[f.x, f.y, c.x, c.y]),
    ))
}
