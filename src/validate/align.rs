//! Rigid alignment of two sets of points without scaling.
//!
//! In: pairs of points. Out: rotation and translation that map the first of each pair to the second with the least mean
//! square, by the singular value decomposition of their covariance (Arun, Huang and Blostein, IEEE TPAMI 9, 1987,
//! doi:10.1109/TPAMI.1987.4767965). It never gives a reflection: where one would fit better, the direction of the
//! smallest singular value is flipped (Umeyama, IEEE TPAMI 13, 1991).
//!
//! What it hides: on a circle, a motion that lags looks like one rotated about the circle's axis, and is rotated back.

use nalgebra::{Matrix3, Point3, Rotation3, UnitQuaternion, Vector3};

/// A rigid motion that maps observed points to desired ones.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Alignment {
    /// Rotation, about the origin.
    pub rotation: Rotation3<f64>,
    /// Translation after it, metres.
    pub translation_m: Vector3<f64>,
    /// Root mean square of the remaining distances, metres.
    pub rms_m: f64,
}

impl Alignment {
    /// The best fit to pairs (from, to); `None` for fewer than three, or if they are all on one line, because the
    /// rotation about it is then undetermined.
    pub(crate) fn of(pairs: &[(Point3<f64>, Point3<f64>)]) -> Option<Self> {
        if pairs.len() < 3 {
            return None;
        }
        let (from, to) = centroids(pairs);
        let covariance: Matrix3<f64> = pairs.iter().map(|(a, b)| (b - to) * (a - from).transpose()).sum();
        let svd = covariance.svd(true, true);
        let (u, v_t) = (svd.u?, svd.v_t?);
        // nalgebra gives singular values in descending order.
        let values = svd.singular_values;
        if !(values.y > 1e-9 * values.x && values.x > 0.0) {
            return None;
        }
        let sign = (u.determinant() * v_t.determinant()).signum();
        let rotation =
            Rotation3::from_matrix_unchecked(u * Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, sign)) * v_t);
        let translation_m = to - rotation * from;
        let mut alignment = Self { rotation, translation_m, rms_m: 0.0 };
        alignment.rms_m = rms(pairs.iter().map(|(a, b)| (alignment.apply(a) - b).norm()));
        Some(alignment)
    }

    /// Moves a point.
    pub(crate) fn apply(&self, point: &Point3<f64>) -> Point3<f64> {
        self.rotation * point + self.translation_m
    }

    /// Angle of the rotation, radians, and its axis, if there is a rotation.
    pub(crate) fn angle_axis(&self) -> (f64, Option<Vector3<f64>>) {
        // The quaternion's angle keeps its digits near zero, where the matrix's loses half of them.
        let turn = UnitQuaternion::from_rotation_matrix(&self.rotation);
        (turn.angle(), turn.axis().map(|axis| axis.into_inner()))
    }
}

fn centroids(pairs: &[(Point3<f64>, Point3<f64>)]) -> (Point3<f64>, Point3<f64>) {
    let count = pairs.len() as f64;
    let (from, to) = pairs.iter().fold((Vector3::zeros(), Vector3::zeros()), |(from, to), (a, b)| {
        (from + a.coords / count, to + b.coords / count)
    });
    (from.into(), to.into())
}

/// Root mean square; 0 if empty.
pub(super) fn rms(values: impl Iterator<Item = f64>) -> f64 {
    let (count, sum) = values.fold((0_u64, 0.0), |(count, sum), value| (count + 1, sum + value * value));
    if count == 0 { 0.0 } else { (sum / count as f64).sqrt() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    fn cloud() -> Vec<Point3<f64>> {
        (0..40)
            .map(|k| {
                let t = f64::from(k);
                Point3::new((1.3 * t).sin(), (0.7 * t + 1.0).cos(), 0.5 * (2.1 * t).sin())
            })
            .collect()
    }

    #[test]
    fn a_rigid_motion_is_found_exactly() {
        let rotation = Rotation3::from_euler_angles(0.4, -1.1, 2.9);
        let shift = Vector3::new(0.3, -2.0, 5.0);
        let pairs: Vec<_> = cloud().into_iter().map(|p| (p, rotation * p + shift)).collect();
        let found = Alignment::of(&pairs).unwrap();
        assert!(found.rms_m < 1e-12 && (found.rotation.matrix() - rotation.matrix()).norm() < 1e-12);
        assert!((found.translation_m - shift).norm() < 1e-12);
    }

    #[test]
    fn a_mirrored_set_is_not_reflected() {
        let pairs: Vec<_> = cloud().into_iter().map(|p| (p, Point3::new(-p.x, p.y, p.z))).collect();
        let found = Alignment::of(&pairs).unwrap();
        assert!((found.rotation.matrix().determinant() - 1.0).abs() < 1e-12);
        assert!(found.rms_m > 0.1);
    }

    #[test]
    fn scale_is_left_as_it_is() {
        let pairs: Vec<_> = cloud().into_iter().map(|p| (p, p * 2.0)).collect();
        let found = Alignment::of(&pairs).unwrap();
        assert!(found.angle_axis().0 < 1e-12);
        let expected = rms(centred(&pairs));
        assert!((found.rms_m - expected).abs() < 1e-12);
    }

    fn centred(pairs: &[(Point3<f64>, Point3<f64>)]) -> impl Iterator<Item = f64> {
        let (from, _) = centroids(pairs);
        pairs.iter().map(move |(a, _)| (a - from).norm())
    }

    #[test]
    fn a_lag_on_a_circle_is_absorbed_as_a_turn() {
        let lag = 0.6;
        let on = |t: f64| Point3::new(0.01 * t.cos(), 0.01 * t.sin(), 0.05);
        let pairs: Vec<_> = (0..200).map(|k| TAU * f64::from(k) / 200.0).map(|t| (on(t - lag), on(t))).collect();
        let found = Alignment::of(&pairs).unwrap();
        let unaligned = rms(pairs.iter().map(|(a, b)| (a - b).norm()));
        assert!(found.rms_m < 1e-12 && (unaligned - 0.02 * (lag / 2.0).sin()).abs() < 1e-12);
        let (angle, axis) = found.angle_axis();
        assert!((angle - lag).abs() < 1e-9 && (axis.unwrap() - Vector3::z()).norm() < 1e-9);
    }

    #[test]
    fn points_on_a_line_leave_the_rotation_open() {
        let line: Vec<_> = (0..9).map(|k| Point3::new(f64::from(k), 2.0 * f64::from(k), 1.0)).map(|p| (p, p)).collect();
        assert_eq!(Alignment::of(&line), None);
        assert_eq!(Alignment::of(&line[..2]), None);
        let one = vec![(Point3::origin(), Point3::origin()); 5];
        assert_eq!(Alignment::of(&one), None);
    }
}
