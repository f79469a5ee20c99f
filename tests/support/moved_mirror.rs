//! A rig whose mirror was bumped.

use catoptra::calibrate::geometry::tilt_axes;
use catoptra::optics::{Plane, Surface};
use catoptra::rig::{Draft, Rig};
use nalgebra::UnitQuaternion;
use std::path::Path;

/// The rig with its mirror turned, up or down and to the left or right, and shifted along its normal.
pub(crate) fn moved(rig: &Rig, turn_deg: [f64; 2], shift_mm: f64) -> Rig {
    let mut draft = Draft::from(rig.clone());
    let mirror = draft.surfaces.values_mut().find_map(|surface| match surface {
        Surface::Mirror(mirror) => Some(mirror),
        Surface::Wall(_) => None,
    });
    let mirror = mirror.unwrap();
    let [a, b] = tilt_axes(&mirror.plane.normal());
    let turn = UnitQuaternion::from_scaled_axis(a * turn_deg[0].to_radians() + b * turn_deg[1].to_radians());
    let normal = (turn * mirror.plane.normal()).normalize();
    mirror.plane = Plane::new(normal, mirror.plane.offset_m() + shift_mm * 1e-3).unwrap();
    Rig::from_toml_str(&draft.to_toml_string(), Path::new("moved.toml")).unwrap()
}
