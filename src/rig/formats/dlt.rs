//! DLT coefficients L1 to L11 of views, for laboratories whose tools triangulate with them (DLTdv, Argus, and others).
//!
//! u = (L1 X + L2 Y + L3 Z + L4) / (L9 X + L10 Y + L11 Z + 1), v = (L5 X + L6 Y + L7 Z + L8) / (the same). Source:
//! Abdel-Aziz and Karara, "Direct linear transformation from comparator coordinates into object space coordinates"
//! (1971), doi:10.14358/PERS.81.2.103.
//!
//! A mirror gives a mirrored camera, which has a valid, left-handed DLT. A wall leaves the rays no common centre, and
//! distortion bends lines: neither has a DLT.

use super::super::{Draft, RigError, View};
use crate::optics::Surface;
use nalgebra::{Matrix3x4, Matrix4, Vector3, Vector4};
use std::path::Path;

/// How far in front of the lens, along the optical axis, the origin is put when a rig has no base frame, metres. It
/// cannot be in the lens: the denominator is 1 at the origin, and the depth is 0 in the lens.
pub const ORIGIN_M: f64 = 1.0;

/// Depth of the origin below which the coefficients would be rounding noise, metres.
const MIN_DEPTH_M: f64 = 1e-6;

/// The coefficients of all views, or of the one named, as DLTdv reads them: eleven lines, one column per view,
/// separated by commas.
///
/// X, Y, Z are millimetres, in the base frame when the rig has one, else in the camera's with its origin moved
/// [`ORIGIN_M`] forward. u goes right and v down; `first_pixel` is the value of both at the centre of the top-left
/// pixel: 0 as in a rig, 1 as in MATLAB and DLTdv. `name` is the rig in error messages.
///
/// # Errors
/// [`RigError`] for a view that has no DLT, naming the wall, the distortion or the origin that prevents it.
pub fn write(rig: &Draft, view: Option<&str>, first_pixel: f64, name: &Path) -> Result<String, RigError> {
    let views = match view {
        Some(view) => vec![rig.view(view, name)?],
        None => rig.views.iter().collect(),
    };
    if views.is_empty() {
        return Err(RigError::Key {
            file: name.to_path_buf(),
            key: "view".to_owned(),
            problem: "expected at least one [[view]]: DLT coefficients are those of a view".to_owned(),
        });
    }
    let columns = views.iter().map(|v| coefficients(rig, v, first_pixel, name)).collect::<Result<Vec<_>, _>>()?;
    let line = |row| {
        let numbers: Vec<String> = columns.iter().filter_map(|c| c.get(row)).map(|l| format!("{l:e}")).collect();
        numbers.join(",") + "\n"
    };
    Ok((0..11).map(line).collect())
}

fn coefficients(rig: &Draft, view: &View, first_pixel: f64, name: &Path) -> Result<[f64; 11], RigError> {
    let wrong = |key: String, value: String, expected: String| {
        Err(RigError::Value { file: name.to_path_buf(), key, value, expected })
    };
    let lens = &rig.camera.lens;
    if lens.distortion != [0.0; 5] || lens.is_rational() {
        let expected =
            "zeros: DLT coefficients hold no distortion. Undistort the pictures with this lens, and export a rig \
                        whose distortion is zero"
                .to_owned();
        return wrong("camera.distortion".to_owned(), format!("{:?}", lens.coefficients()), expected);
    }
    let mut image_from_camera = Matrix4::identity();
    for (surface_name, surface) in view.path.iter().zip(&view.optics.surfaces) {
        match surface {
            Surface::Mirror(mirror) => {
                let normal = mirror.plane.normal().push(0.0);
                let to_plane = Vector4::from(mirror.plane.normal().push(-mirror.plane.offset_m()));
                image_from_camera *= Matrix4::identity() - normal * to_plane.transpose() * 2.0;
            }
            Surface::Wall(wall) => {
                let expected = format!(
                    "mirrors only: DLT coefficients hold no refraction, and `{surface_name}` is a wall (indices {} | \
                     {} | {})",
                    wall.index_outside, wall.index_wall, wall.index_inside
                );
                return wrong(format!("view.{}.path", view.name), format!("{:?}", view.path), expected);
            }
        }
    }
    let camera_from_world = match &rig.base {
        Some(base) => base.base_from_camera.inverse().to_homogeneous(),
        None => Matrix4::new_translation(&Vector3::new(0.0, 0.0, ORIGIN_M)),
    };
    let (f, c) = (lens.focal_px, lens.principal_point_px + nalgebra::Vector2::repeat(first_pixel));
    let projection = Matrix3x4::new(f.x, 0.0, c.x, 0.0, 0.0, f.y, c.y, 0.0, 0.0, 0.0, 1.0, 0.0);
    let millimetres = Matrix4::from_diagonal(&Vector4::new(1e-3, 1e-3, 1e-3, 1.0));
    let p = projection * image_from_camera * camera_from_world * millimetres;
    let depth_m = p.m34;
    if depth_m.abs() < MIN_DEPTH_M {
        let expected =
            format!("an origin of the frame before or behind the lens: it lies {depth_m:.1e} m from its plane");
        return wrong(format!("view.{}", view.name), format!("{:?}", view.path), expected);
    }
    let p = p / depth_m;
    Ok([p.m11, p.m12, p.m13, p.m14, p.m21, p.m22, p.m23, p.m24, p.m31, p.m32, p.m33])
}
