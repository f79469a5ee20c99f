//! The centre line of a stretch of tube around one or more bands.
//!
//! s is the arc length from the middle of the reference band, metres, positive towards the tip. The reference band is
//! straight over |s| ≤ h (a coil is rigid; h = 0 for a soft band). Beyond it the tube bends: its curvature starts at
//! zero, because what holds the coil also stiffens the tube beside it, and is κ'σ + ½κ''σ² after the arc σ, separately
//! on either side, with two components across the tangent t. Its integral φ turns the direction:
//!
//! T(s) = t (1 − ½|φ|²) + N φ, X(s) = c + t (s − ½∫|φ|²) + N ∫φ.
//!
//! Accurate to |φ|⁴/24: 2 µm over 15 mm at 0.3 rad.

use nalgebra::{Const, Dyn, Matrix3, Matrix3x2, OMatrix, Point3, SMatrix, SVector, Vector2, Vector3};

/// Number of derivatives of the curvature with respect to arc length on one side of the straight part: first and
/// second.
pub(in crate::track) const BENDS: usize = 2;

/// Index of the bends above and below the straight part among the parameters.
const ABOVE: usize = 5;
const BELOW: usize = ABOVE + 2 * BENDS;

/// Number of shape parameters: centre (3), tangent (2), bends above and below (2 each).
pub(in crate::track) const SHAPE: usize = BELOW + 2 * BENDS;

/// Power of σ with the first bend: the turn has σ² / 2! with it and σ³ / 3! with the second.
const POWER: usize = 2;
const FACTORIALS: [f64; BENDS] = [2.0, 6.0];

/// Shape parameters (rows) by any number of others.
pub(in crate::track) type ShapeBy = OMatrix<f64, Const<SHAPE>, Dyn>;

/// A vector of shape parameters' increments.
pub(in crate::track) type ShapeStep = SVector<f64, SHAPE>;

/// A stretch of tube.
#[derive(Debug, Clone, PartialEq)]
pub(in crate::track) struct TubeShape {
    /// Middle of the reference band on the centre line, camera frame, metres.
    pub centre: Point3<f64>,
    /// Orthonormal: columns n1, n2 (across) and t (tangent of the reference band, base to tip).
    pub frame: Matrix3<f64>,
    /// Derivatives of the curvature just above the straight part, components along n1, n2: 1/m², 1/m³.
    pub above: [Vector2<f64>; BENDS],
    /// The same just below it.
    pub below: [Vector2<f64>; BENDS],
    /// Half length of the straight part, metres.
    pub straight_half_m: f64,
}

impl TubeShape {
    /// A straight tube through `centre` along `direction`.
    pub(in crate::track) fn straight(centre: Point3<f64>, direction: &Vector3<f64>, straight_half_m: f64) -> Self {
        let t = direction.normalize();
        let helper = if t.x.abs() < 0.6 { Vector3::x() } else { Vector3::z() };
        let n1 = t.cross(&helper).normalize();
        let n2 = t.cross(&n1);
        Self {
            centre,
            frame: Matrix3::from_columns(&[n1, n2, t]),
            above: [Vector2::zeros(); BENDS],
            below: [Vector2::zeros(); BENDS],
            straight_half_m,
        }
    }

    /// Tangent of the reference band.
    pub(in crate::track) fn tangent(&self) -> Vector3<f64> {
        self.frame.column(2).into()
    }

    /// The two unit vectors across the tangent.
    pub(in crate::track) fn across(&self) -> Matrix3x2<f64> {
        self.frame.fixed_columns::<2>(0).into()
    }

    /// The bends among the parameters, the others zero.
    pub(in crate::track) fn bends(&self) -> ShapeStep {
        let mut parameters = ShapeStep::zeros();
        for (i, bend) in self.above.iter().chain(&self.below).enumerate() {
            parameters.fixed_rows_mut::<2>(ABOVE + 2 * i).copy_from(bend);
        }
        parameters
    }

    /// Point of the centre line at arc length `s`, its direction, and d point / d parameters.
    pub(in crate::track) fn at(&self, s: f64) -> (Point3<f64>, Vector3<f64>, SMatrix<f64, 3, SHAPE>) {
        let n = self.across();
        let t = self.tangent();
        let (sigma, first, bends) = self.beyond(s);
        // φ = Σ aᵢ σⁱ.
        let a: [Vector2<f64>; BENDS] = std::array::from_fn(|i| bends[i] / FACTORIALS[i]);
        // ∫σⁱσʲ and ∫σⁱ.
        let integral = |power: usize| sigma.powi(power as i32 + 1) / (power + 1) as f64;
        let both = |i: usize, j: usize| integral(i + j + 2 * POWER);
        let once = |i: usize| integral(i + POWER);
        let (mut turn, mut aside, mut along) = (Vector2::zeros(), Vector2::zeros(), s);
        let mut d_along = [Vector2::zeros(); BENDS];
        for i in 0..BENDS {
            turn += a[i] * sigma.powi((i + POWER) as i32);
            aside += a[i] * once(i);
            d_along[i] = -(0..BENDS).map(|j| a[j] * both(i, j)).sum::<Vector2<f64>>();
            along += a[i].dot(&d_along[i]) / 2.0;
        }
        let point = self.centre + t * along + n * aside;
        let direction = t * (1.0 - turn.norm_squared() / 2.0) + n * turn;

        let mut d = SMatrix::<f64, 3, SHAPE>::zeros();
        d.fixed_view_mut::<3, 3>(0, 0).copy_from(&Matrix3::identity());
        d.fixed_view_mut::<3, 2>(0, 3).copy_from(&(n * along - t * aside.transpose()));
        for (i, d_along) in d_along.iter().enumerate() {
            let moved = (n * once(i) + t * d_along.transpose()) / FACTORIALS[i];
            d.fixed_view_mut::<3, 2>(0, first + 2 * i).copy_from(&moved);
        }
        (point, direction, d)
    }

    /// d direction / d parameters at arc length `s`, to first order in the angle φ that the tube has turned by.
    pub(super) fn d_direction(&self, s: f64) -> SMatrix<f64, 3, SHAPE> {
        let (sigma, first, _) = self.beyond(s);
        let by: [f64; BENDS] = std::array::from_fn(|i| sigma.powi((i + POWER) as i32) / FACTORIALS[i]);
        let d_turn = self.across() - self.tangent() * self.turn(s).transpose();
        let mut d = SMatrix::<f64, 3, SHAPE>::zeros();
        d.fixed_view_mut::<3, 2>(0, 3).copy_from(&d_turn);
        for (i, by) in by.into_iter().enumerate() {
            d.fixed_view_mut::<3, 2>(0, first + 2 * i).copy_from(&(d_turn * by));
        }
        d
    }

    /// Angle φ by which the direction has turned at arc length `s`, radians.
    pub(in crate::track) fn turn(&self, s: f64) -> Vector2<f64> {
        let (sigma, _, bends) = self.beyond(s);
        (0..BENDS).map(|i| bends[i] * (sigma.powi((i + POWER) as i32) / FACTORIALS[i])).sum()
    }

    /// The step that moves its centre and tangent to those of another shape.
    pub(in crate::track) fn step_to(&self, other: &Self) -> ShapeStep {
        let (t, across) = (other.tangent(), self.across().tr_mul(&other.tangent()));
        let tilt = across.try_normalize(0.0).map_or(across, |way| way * across.norm().atan2(t.dot(&self.tangent())));
        let mut step = ShapeStep::zeros();
        step.fixed_rows_mut::<3>(0).copy_from(&(other.centre - self.centre));
        step.fixed_rows_mut::<2>(3).copy_from(&tilt);
        step
    }

    /// Distance beyond the straight part, and the bends there: their index among the parameters and their values.
    fn beyond(&self, s: f64) -> (f64, usize, &[Vector2<f64>; BENDS]) {
        let sigma = s - s.clamp(-self.straight_half_m, self.straight_half_m);
        if sigma > 0.0 { (sigma, BELOW, &self.below) } else { (sigma, ABOVE, &self.above) }
    }

    /// The shape moved by a step of its parameters.
    pub(in crate::track) fn moved(&self, step: &ShapeStep) -> Self {
        let tilt = Vector2::new(step[3], step[4]);
        // Rotation that takes t to t + N·tilt (to first order) without turning about t, so that curvatures keep their
        // axes.
        let axis = self.across() * Vector2::new(-tilt.y, tilt.x);
        let rotation = nalgebra::Rotation3::new(axis);
        let bent = |bends: &[Vector2<f64>; BENDS], first: usize| {
            std::array::from_fn(|i| bends[i] + step.fixed_rows::<2>(first + 2 * i))
        };
        Self {
            centre: self.centre + Vector3::new(step[0], step[1], step[2]),
            frame: rotation * self.frame,
            above: bent(&self.above, ABOVE),
            below: bent(&self.below, BELOW),
            straight_half_m: self.straight_half_m,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bent() -> TubeShape {
        TubeShape {
            above: [Vector2::new(-900.0, 1200.0), Vector2::new(3e4, 5e4)],
            below: [Vector2::new(1500.0, -600.0), Vector2::new(-4e4, 2e4)],
            ..TubeShape::straight(Point3::new(-0.1, 0.02, 1.4), &Vector3::new(0.3, 0.9, -0.2), 6e-3)
        }
    }

    /// With curvature proportional to the arc the tube is a clothoid; compared with one integrated in small steps.
    #[test]
    fn a_growing_curvature_is_a_clothoid() {
        let shape = TubeShape {
            below: [Vector2::new(4000.0, 0.0), Vector2::zeros()],
            ..TubeShape::straight(Point3::origin(), &Vector3::z(), 6e-3)
        };
        // 10 mm after a straight part of 6 mm: 0.2 rad.
        let (point, direction, _) = shape.at(16e-3);
        let steps = 1000;
        let turn = |i: i32| 2000.0 * ((f64::from(i) + 0.5) / f64::from(steps) * 10e-3).powi(2);
        let sum = |f: fn(f64) -> f64| (0..steps).map(|i| f(turn(i)) * 10e-3 / f64::from(steps)).sum::<f64>();
        let n = shape.across();
        assert!((point.coords.dot(&n.column(0)) - sum(f64::sin)).abs() < 4e-6);
        assert!((point.z - (6e-3 + sum(f64::cos))).abs() < 1e-6);
        assert!((direction.angle(&Vector3::z()) - 0.2).abs() < 2e-3);
        assert!((direction.norm() - 1.0).abs() < 1e-3);
    }

    #[test]
    fn derivatives_equal_differences_of_moved_shapes() {
        let shape = bent();
        for s in [-15e-3, -3e-3, 0.0, 5e-3, 12e-3, 25e-3] {
            let (_, _, d) = shape.at(s);
            for k in 0..SHAPE {
                let h = match k {
                    0..3 => 1e-6,
                    3..ABOVE => 1e-5,
                    _ => [1.0, 1e2][(k - ABOVE) / 2 % BENDS],
                };
                let mut step = ShapeStep::zeros();
                step[k] = h;
                let difference = (shape.moved(&step).at(s).0 - shape.moved(&(-step)).at(s).0) / (2.0 * h);
                let error = (difference - d.column(k)).norm();
                assert!(error < 1e-4 * difference.norm() + 1e-9, "s {s} parameter {k}: {difference} {}", d.column(k));
            }
        }
    }

    #[test]
    fn the_step_to_a_shape_moves_there() {
        let shape = bent();
        let there = TubeShape::straight(Point3::new(-0.09, 0.03, 1.39), &Vector3::new(0.5, 0.8, 0.1), 6e-3);
        let moved = shape.moved(&shape.step_to(&there));
        assert!((moved.centre - there.centre).norm() < 1e-12 && moved.tangent().angle(&there.tangent()) < 1e-7);
        assert_eq!(moved.below, shape.below);
        assert!(shape.step_to(&shape).norm() < 1e-12);
    }

    #[test]
    fn moving_keeps_the_frame_orthonormal_and_turns_the_tangent_as_told() {
        let mut step = ShapeStep::zeros();
        step[3] = 0.01;
        step[4] = -0.02;
        let shape = bent();
        let moved = shape.moved(&step);
        assert!((moved.frame.transpose() * moved.frame - Matrix3::identity()).norm() < 1e-12);
        let expected = shape.tangent() + shape.across() * Vector2::new(0.01, -0.02);
        assert!(moved.tangent().angle(&expected) < 1e-5);
    }
}
