//! Angles of deflection from the coil's tangent, with their σ.
//!
//! With t in the base frame: θ = atan2(t·x, t·z), polar = acos(t·z), azimuth = atan2(t·y, t·x). In the plane of B0 and
//! the tangent at rest θ is the paper's 90° − φ (sin θ = t·B0; Tuna et al. 2018, Eq. 6).

use crate::estimate::{Deflection, Tangent};
use crate::rig::Base;
use nalgebra::{RowVector3, Vector3};

/// Deflection of a tangent (camera frame) in the base frame.
pub fn deflection(tangent: &Tangent, base: &Base) -> Deflection {
    let rotation = base.base_from_camera.rotation.to_rotation_matrix();
    let t = rotation * tangent.direction;
    let covariance = rotation.matrix() * tangent.covariance * rotation.matrix().transpose();
    let d_theta = theta_derivative(&t);
    Deflection {
        theta_rad: t.x.atan2(t.z),
        theta_sd_rad: sd((d_theta * covariance * d_theta.transpose())[0]),
        polar_rad: t.xy().norm().atan2(t.z),
        azimuth_rad: t.y.atan2(t.x),
    }
}

/// Derivative of θ with respect to the tangent t, base frame: dθ = (t.z dt.x − t.x dt.z)/(t.x² + t.z²).
pub(crate) fn theta_derivative(t: &Vector3<f64>) -> RowVector3<f64> {
    RowVector3::new(t.z, 0.0, -t.x) / (t.x * t.x + t.z * t.z)
}

/// Derivative of θ with respect to a small turn ω of the base frame, base frame: the tangent's coordinates change by
/// −ω × t.
pub(crate) fn theta_derivative_by_turn(t: &Vector3<f64>) -> RowVector3<f64> {
    -t.cross(&theta_derivative(t).transpose()).transpose()
}

/// Of a variance, which rounding may have made negative. (A tangent normal to the plane has no θ, and its σ is not a
/// number.)
fn sd(variance: f64) -> f64 {
    if variance < 0.0 { 0.0 } else { variance.sqrt() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Isometry3, Matrix3, Rotation3, UnitQuaternion};

    fn base() -> Base {
        Base {
            base_from_camera: Isometry3::from_parts(
                Vector3::new(0.1, 0.2, 0.3).into(),
                UnitQuaternion::from_euler_angles(0.3, -0.2, 0.1),
            ),
            b0: Vector3::x(),
            gravity: None,
        }
    }

    fn tangent_in_base(t: Vector3<f64>) -> Tangent {
        let camera_from_base = base().base_from_camera.rotation.inverse();
        let direction = (camera_from_base * t).normalize();
        let across = Matrix3::identity() - direction * direction.transpose();
        Tangent { direction, covariance: across * 1e-4, bound: across * 1e-4 }
    }

    #[test]
    fn thirty_degrees_towards_b0_and_away() {
        let (sin, cos) = 30_f64.to_radians().sin_cos();
        let towards = deflection(&tangent_in_base(Vector3::new(sin, 0.0, cos)), &base());
        assert!((towards.theta_rad.to_degrees() - 30.0).abs() < 1e-9);
        assert!((towards.polar_rad.to_degrees() - 30.0).abs() < 1e-9);
        assert!(towards.azimuth_rad.abs() < 1e-9);
        let away = deflection(&tangent_in_base(Vector3::new(-sin, 0.0, cos)), &base());
        assert!((away.theta_rad.to_degrees() + 30.0).abs() < 1e-9);
        assert!((away.azimuth_rad.abs() - std::f64::consts::PI).abs() < 1e-9);
    }

    #[test]
    fn out_of_plane_is_azimuth_not_theta() {
        let d = deflection(&tangent_in_base(Vector3::new(0.0, 0.5, 0.75_f64.sqrt())), &base());
        assert!(d.theta_rad.abs() < 1e-9);
        assert!((d.polar_rad.to_degrees() - 30.0).abs() < 1e-9);
        assert!((d.azimuth_rad.to_degrees() - 90.0).abs() < 1e-9);
    }

    #[test]
    fn sigma_of_theta_is_that_of_the_tangent_in_the_plane_and_grows_out_of_it() {
        let d = deflection(&tangent_in_base(Vector3::new(0.5, 0.0, 0.75_f64.sqrt())), &base());
        assert!((d.theta_sd_rad - 1e-2).abs() < 1e-9);
        // Tilted out of the plane by 60°, only half the tangent lies in it: its error turns θ twice as far.
        let tilted = Rotation3::from_axis_angle(&Vector3::x_axis(), -60_f64.to_radians()) * Vector3::z();
        let d = deflection(&tangent_in_base(tilted), &base());
        assert!((d.theta_sd_rad - 2e-2).abs() < 1e-9);
        let unknown = Deflection { theta_sd_rad: sd(f64::NAN), ..d };
        assert!(unknown.theta_sd_rad.is_nan() && sd(-1e-30) == 0.0);
    }

    #[test]
    fn derivatives_are_those_of_differences_in_and_out_of_the_plane() {
        let theta = |t: &Vector3<f64>| t.x.atan2(t.z);
        for t in [[0.5, 0.0, 0.8], [-0.3, 0.7, 0.6], [0.1, -0.9, -0.4]] {
            let t = Vector3::from(t).normalize();
            for axis in [Vector3::x(), Vector3::y(), Vector3::z()] {
                let h = 1e-6;
                let moved = (theta(&(t + axis * h)) - theta(&(t - axis * h))) / (2.0 * h);
                assert!((moved - (theta_derivative(&t) * axis)[0]).abs() < 1e-8, "{t} {axis}");
                // Coordinates in a frame that is turned by h about the axis.
                let seen = |angle: f64| theta(&(Rotation3::new(axis * angle).inverse() * t));
                let turned = (seen(h) - seen(-h)) / (2.0 * h);
                assert!((turned - (theta_derivative_by_turn(&t) * axis)[0]).abs() < 1e-8, "{t} {axis}");
            }
        }
        // In the plane, θ turns as far as the frame about its normal, and no other axis matters.
        let of_turn = theta_derivative_by_turn(&Vector3::new(0.6, 0.0, 0.8));
        assert!((of_turn - RowVector3::new(0.0, -1.0, 0.0)).norm() < 1e-12, "{of_turn}");
    }
}
