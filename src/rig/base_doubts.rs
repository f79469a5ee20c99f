//! Directions in the base frame that no experiment has.

use super::Base;
use nalgebra::Vector3;

/// A catheter that hangs does so nearly along gravity, up to its own curvature, degrees.
const HANGS_WITHIN_DEG: f64 = 20.0;
/// B0 is across the catheter at rest, from this angle on, degrees.
const ACROSS_FROM_DEG: f64 = 70.0;

/// Reasons why a base frame may be wrong, as sentences.
pub(crate) fn base_doubts(base: &Base) -> Vec<String> {
    let z = base.base_from_camera.rotation.inverse() * Vector3::z();
    let from_z_deg = |direction: &Vector3<f64>| direction.angle(&z).to_degrees();
    let hangs = base.gravity.map(|gravity| from_z_deg(&gravity)).filter(|deg| *deg > HANGS_WITHIN_DEG);
    let hangs = hangs.map(|deg| {
        format!(
            "gravity is {deg:.0}° from z, the catheter at rest: is its direction in the camera frame (x right, y down, \
             z forward)? A catheter that hangs is within {HANGS_WITHIN_DEG:.0}°"
        )
    });
    // B0 and its reverse are the same axis.
    let across_deg = from_z_deg(&base.b0);
    let across_deg = across_deg.min(180.0 - across_deg);
    let along = (across_deg < ACROSS_FROM_DEG).then(|| {
        format!(
            "B0 is only {across_deg:.0}° from z, the catheter at rest, and should be across it: is its direction in \
             the camera frame (x right, y down, z forward)? x, and with it θ, depends on the little that is across"
        )
    });
    hangs.into_iter().chain(along).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Isometry3, UnitQuaternion};

    #[test]
    fn gravity_and_b0_where_they_cannot_be_are_told() {
        // z of the base frame is y of the camera: down.
        let turn = UnitQuaternion::rotation_between(&Vector3::y(), &Vector3::z()).unwrap();
        let told = |b0: Vector3<f64>, gravity: Option<Vector3<f64>>| {
            let base_from_camera = Isometry3::from_parts(Vector3::new(0.01, 0.02, 0.3).into(), turn);
            base_doubts(&Base { base_from_camera, b0, gravity }).join("; ")
        };
        let at = |deg: f64| Vector3::new(deg.to_radians().sin(), deg.to_radians().cos(), 0.0);
        assert_eq!(told(at(90.0), None), "");
        assert_eq!(told(at(-75.0), Some(at(15.0))), "");
        assert!(told(at(90.0), Some(Vector3::z())).starts_with("gravity is 90° from z"));
        for deg in [65.0, -65.0, 115.0] {
            assert!(told(at(deg), Some(at(0.0))).starts_with("B0 is only 65° from z"), "{deg}");
        }
    }
}
