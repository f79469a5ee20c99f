//! Poses with their covariances.
//!
//! The z axis of the coil's frame lies along its tangent, reached from the frame of the poses by the shortest rotation:
//! rotation about the tube itself is not measured. An unmeasured angle has the variance of a uniform one, π²/3: large,
//! yet invertible for a filter (infinity and NaN are not).

use crate::log::ros2::messages::{Pose, Quaternion, Xyz};
use crate::log::schema::messages::{Position, Tangent};
use nalgebra::{Isometry3, Matrix3, Quaternion as Turn, Unit, UnitQuaternion, Vector3};

/// Rotates the axes of pictures (x right, y down, z forward) into those of bodies (x forward, y left, z up).
pub(super) const CAMERA_FROM_OPTICAL: UnitQuaternion<f64> =
    Unit::new_unchecked(Turn::from_vector(nalgebra::Vector4::new(-0.5, 0.5, -0.5, 0.5)));

/// Variance of an unknown angle, rad².
pub(super) const ANY_ANGLE_RAD2: f64 = std::f64::consts::PI * std::f64::consts::PI / 3.0;

/// Pose and covariance of a marker, in the base frame if `based`. `None` when the message lacks a part.
pub(super) fn oriented(position: &Position, tangent: Option<&Tangent>, based: bool) -> Option<(Pose, [f64; 36])> {
    let (point, covariance) = if based {
        (position.in_base_m.as_ref()?, &position.covariance_in_base_m2)
    } else {
        (&position.in_camera_m, &position.covariance_in_camera_m2)
    };
    let place = matrix(covariance)?;
    let along = match tangent {
        None => None,
        Some(tangent) if based => Some((tangent.in_base.as_ref()?, &tangent.covariance_in_base_rad2)),
        Some(tangent) => Some((&tangent.in_camera, &tangent.covariance_in_camera_rad2)),
    };
    let (orientation, turned) = match along {
        None => (UnitQuaternion::identity(), Matrix3::identity() * ANY_ANGLE_RAD2),
        Some((t, covariance)) => {
            let t = Vector3::new(t.x, t.y, t.z);
            (turn_to(&t), covariance_of_turn(&t, &matrix(covariance)?))
        }
    };
    let position = Xyz { x: point.x, y: point.y, z: point.z };
    Some((Pose { position, orientation: quaternion(&orientation) }, by_rows(&place, &turned)))
}

/// The shortest rotation of z to `t`; for the exact opposite of z, any half turn will do.
pub(super) fn turn_to(t: &Vector3<f64>) -> UnitQuaternion<f64> {
    UnitQuaternion::rotation_between(&Vector3::z(), t)
        .unwrap_or_else(|| UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI))
}

/// Covariance of the rotation about the axes of the frame, from that of the direction: δω = t × δt, and any angle about
/// t.
fn covariance_of_turn(t: &Vector3<f64>, direction: &Matrix3<f64>) -> Matrix3<f64> {
    let cross = t.cross_matrix();
    cross * direction * cross.transpose() + t * t.transpose() * ANY_ANGLE_RAD2
}

/// A transform as a message.
pub(super) fn pose_of(place: &Isometry3<f64>) -> Pose {
    let v = &place.translation.vector;
    Pose { position: Xyz { x: v.x, y: v.y, z: v.z }, orientation: quaternion(&place.rotation) }
}

pub(super) fn quaternion(turn: &UnitQuaternion<f64>) -> Quaternion {
    Quaternion { x: turn.i, y: turn.j, z: turn.k, w: turn.w }
}

fn matrix(by_rows: &[f64]) -> Option<Matrix3<f64>> {
    (by_rows.len() == 9).then(|| Matrix3::from_row_slice(by_rows))
}

/// Both blocks; their correlation is unknown.
fn by_rows(place: &Matrix3<f64>, turned: &Matrix3<f64>) -> [f64; 36] {
    std::array::from_fn(|k| {
        let (row, column) = (k / 6, k % 6);
        match (row < 3, column < 3) {
            (true, true) => place[(row, column)],
            (false, false) => turned[(row - 3, column - 3)],
            _ => 0.0,
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn axes_of_pictures_are_turned_into_those_of_bodies() {
        let turned = |v: Vector3<f64>| CAMERA_FROM_OPTICAL * v;
        for (optical, body) in
            [(Vector3::z(), Vector3::x()), (Vector3::x(), -Vector3::y()), (Vector3::y(), -Vector3::z())]
        {
            assert!((turned(optical) - body).norm() < 1e-15, "{optical} {}", turned(optical));
        }
    }

    /// Rotations drawn from the covariance scatter the tangent as its own covariance states.
    #[test]
    fn the_covariance_of_the_turn_is_that_of_the_direction() {
        let t = Vector3::new(0.4, -0.2, 0.8).normalize();
        let (u, v) = (t.cross(&Vector3::y()).normalize(), t.cross(&t.cross(&Vector3::y())).normalize());
        let direction = u * u.transpose() * 4e-6 + v * v.transpose() * 9e-6;
        let turn = covariance_of_turn(&t, &direction);
        assert!(((t.transpose() * turn * t)[0] - ANY_ANGLE_RAD2).abs() < 1e-12);
        // δt = δω × t
        let cross = t.cross_matrix();
        assert!((cross * turn * cross.transpose() - direction).norm() < 1e-14);
        assert!((turn_to(&t) * Vector3::z() - t).norm() < 1e-12);
        assert!((turn_to(&-Vector3::z()) * Vector3::z() + Vector3::z()).norm() < 1e-12);
    }
}
