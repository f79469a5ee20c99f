//! The centre line of a stretch of tube around one or more bands.
//!
//! s is the arc length from the middle of the reference band, metres, positive towards the tip. Its direction turns by
//! the angle φ, with two components across the tangent t at s = 0:
//!
//! T(s) = t (1 − ½|φ|²) + N φ, X(s) = c + t (s − ½∫|φ|²) + N ∫φ.
//!
//! Left out are |φ|⁴/24 of the length and |φ|³/6 of the way aside: beside a rigid band 2 µm over 15 mm at 0.3
//! rad; beside a soft one 17 µm, which its κ'' takes up.
//!
//! - A rigid reference band, a coil, is straight over |s| ≤ h. Beyond it the tube bends: its curvature starts at
//!   zero, because what holds the coil also stiffens the tube beside it, and is κ'σ + ½κ''σ² after the arc σ,
//!   separately on either side.
//! - A soft one (h = 0) bends as the tube beside it: the curvature is κ + κ's + ½κ''s². That of a rod which is
//!   loaded at its end alone changes linearly along it; the last term is for its weight, and for a band that
//!   stiffens it.

use nalgebra::{Const, Dyn, Matrix3, Matrix3x2, OMatrix, Point3, SMatrix, SVector, Vector2, Vector3};
use std::ops::Range;

/// Number of bends, which say how the curvature changes along the arc: of a rigid band κ' and κ'' above it, then both
/// below it; of a soft one κ, κ', κ'', and one without effect.
pub(in crate::track) const BENDS: usize = 4;

/// Index of the first bend among the parameters.
const FIRST_BEND: usize = 5;

/// Number of shape parameters: centre (3), tangent (2), bends (2 each).
pub(in crate::track) const SHAPE: usize = FIRST_BEND + 2 * BENDS;

/// Most bends that turn the tube at one place.
const MOST: usize = 3;

/// Prior σ of bends, 1/m, 1/m², 1/m³. Beside a rigid band each reaches 15 /m, half a right angle over 5 cm, within a
/// centimetre. A soft band bends by up to twice that, and its κ'' is small: its weight gives a tube 1e3 /m³.
const BESIDE_RIGID_SD: [f64; 2] = [1500.0, 3e5];
const SOFT_SD: [f64; 3] = [30.0, 1500.0, 5e4];

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
    /// Curvature and its derivatives, components along n1, n2; see [`BENDS`].
    pub bends: [Vector2<f64>; BENDS],
    /// Half length of the straight part, metres; 0 of a soft band.
    pub straight_half_m: f64,
}

/// What turns the tube up to an arc length: Σ bendₖ σ^pₖ / pₖ!, with powers that rise by one.
struct Turn {
    /// Arc along which it turns, metres.
    sigma: f64,
    /// The bends, at most [`MOST`].
    bends: Range<usize>,
    /// Power of the first.
    power: usize,
    /// σ^pₖ / pₖ!.
    terms: [f64; MOST],
}

impl Turn {
    /// `first` is the term of the first bend.
    fn new(sigma: f64, bends: Range<usize>, power: usize, first: f64) -> Self {
        let mut terms = [first; MOST];
        for k in 1..MOST {
            terms[k] = terms[k - 1] * sigma / (power + k) as f64;
        }
        Self { sigma, bends, power, terms }
    }

    /// Each bend's index, and its term.
    fn terms(&self) -> impl Iterator<Item = (usize, f64)> {
        self.bends.clone().zip(self.terms)
    }

    /// ∫ of the term of the `k`-th bend.
    fn once(&self, k: usize) -> f64 {
        self.terms[k] * self.sigma / (self.power + k + 1) as f64
    }

    /// ∫ of the product of two bends' terms.
    fn both(&self, k: usize, l: usize) -> f64 {
        self.terms[k] * self.terms[l] * self.sigma / (2 * self.power + k + l + 1) as f64
    }
}

impl TubeShape {
    /// A straight tube through `centre` along `direction`.
    pub(in crate::track) fn straight(centre: Point3<f64>, direction: &Vector3<f64>, straight_half_m: f64) -> Self {
        let t = direction.normalize();
        let helper = if t.x.abs() < 0.6 { Vector3::x() } else { Vector3::z() };
        let n1 = t.cross(&helper).normalize();
        let n2 = t.cross(&n1);
        Self { centre, frame: Matrix3::from_columns(&[n1, n2, t]), bends: [Vector2::zeros(); BENDS], straight_half_m }
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
    pub(in crate::track) fn parameters_of_bends(&self) -> ShapeStep {
        let mut parameters = ShapeStep::zeros();
        for (i, bend) in self.bends.iter().enumerate() {
            parameters.fixed_rows_mut::<2>(FIRST_BEND + 2 * i).copy_from(bend);
        }
        parameters
    }

    /// Information of what is known of a shape before it is seen: centre and tangent are free.
    pub(in crate::track) fn prior(&self) -> SMatrix<f64, SHAPE, SHAPE> {
        let ([first, second], [curvature, slope, bow]) = (BESIDE_RIGID_SD, SOFT_SD);
        let sds = if self.is_soft() { [curvature, slope, bow, 1.0] } else { [first, second, first, second] };
        let mut information = SMatrix::zeros();
        for i in FIRST_BEND..SHAPE {
            information[(i, i)] = sds[(i - FIRST_BEND) / 2].powi(-2);
        }
        information
    }

    /// Point of the centre line at arc length `s`, its direction, and d point / d parameters.
    pub(in crate::track) fn at(&self, s: f64) -> (Point3<f64>, Vector3<f64>, SMatrix<f64, 3, SHAPE>) {
        let n = self.across();
        let t = self.tangent();
        let turning = self.turning(s);
        let turn = self.turned_by(&turning);
        let (mut aside, mut along) = (Vector2::zeros(), s);
        let mut d = SMatrix::<f64, 3, SHAPE>::zeros();
        for (k, i) in turning.bends.clone().enumerate() {
            let once = turning.once(k);
            aside += self.bends[i] * once;
            let mut d_along = Vector2::zeros();
            for (l, j) in turning.bends.clone().enumerate() {
                d_along -= self.bends[j] * turning.both(k, l);
            }
            along += self.bends[i].dot(&d_along) / 2.0;
            d.fixed_view_mut::<3, 2>(0, FIRST_BEND + 2 * i).copy_from(&(n * once + t * d_along.transpose()));
        }
        let point = self.centre + t * along + n * aside;
        let direction = t * (1.0 - turn.norm_squared() / 2.0) + n * turn;
        d.fixed_view_mut::<3, 3>(0, 0).copy_from(&Matrix3::identity());
        d.fixed_view_mut::<3, 2>(0, 3).copy_from(&(n * along - t * aside.transpose()));
        (point, direction, d)
    }

    /// d direction / d parameters at arc length `s`, to first order in the angle φ that the tube has turned by.
    pub(super) fn d_direction(&self, s: f64) -> SMatrix<f64, 3, SHAPE> {
        let turning = self.turning(s);
        let d_turn = self.across() - self.tangent() * self.turned_by(&turning).transpose();
        let mut d = SMatrix::<f64, 3, SHAPE>::zeros();
        d.fixed_view_mut::<3, 2>(0, 3).copy_from(&d_turn);
        for (i, by) in turning.terms() {
            d.fixed_view_mut::<3, 2>(0, FIRST_BEND + 2 * i).copy_from(&(d_turn * by));
        }
        d
    }

    /// Angle φ by which the direction has turned at arc length `s`, radians.
    pub(in crate::track) fn turn(&self, s: f64) -> Vector2<f64> {
        self.turned_by(&self.turning(s))
    }

    fn turned_by(&self, turning: &Turn) -> Vector2<f64> {
        turning.terms().map(|(i, by)| self.bends[i] * by).sum()
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

    fn is_soft(&self) -> bool {
        self.straight_half_m == 0.0
    }

    fn turning(&self, s: f64) -> Turn {
        if self.is_soft() {
            return Turn::new(s, 0..3, 1, s);
        }
        let sigma = s - s.clamp(-self.straight_half_m, self.straight_half_m);
        Turn::new(sigma, if sigma > 0.0 { 2..4 } else { 0..2 }, 2, sigma * sigma / 2.0)
    }

    /// The shape moved by a step of its parameters.
    pub(in crate::track) fn moved(&self, step: &ShapeStep) -> Self {
        let tilt = Vector2::new(step[3], step[4]);
        // Rotation that takes t to t + N·tilt (to first order) without turning about t, so that curvatures keep their
        // axes.
        let axis = self.across() * Vector2::new(-tilt.y, tilt.x);
        let rotation = nalgebra::Rotation3::new(axis);
        Self {
            centre: self.centre + Vector3::new(step[0], step[1], step[2]),
            frame: rotation * self.frame,
            bends: std::array::from_fn(|i| self.bends[i] + step.fixed_rows::<2>(FIRST_BEND + 2 * i)),
            straight_half_m: self.straight_half_m,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bent() -> TubeShape {
        TubeShape {
            bends: [(-900.0, 1200.0), (3e4, 5e4), (1500.0, -600.0), (-4e4, 2e4)].map(|(x, y)| Vector2::new(x, y)),
            ..TubeShape::straight(Point3::new(-0.1, 0.02, 1.4), &Vector3::new(0.3, 0.9, -0.2), 6e-3)
        }
    }

    /// With curvature proportional to the arc the tube is a clothoid; compared with one integrated in small steps.
    #[test]
    fn a_growing_curvature_is_a_clothoid() {
        let shape = TubeShape {
            bends: [Vector2::zeros(), Vector2::zeros(), Vector2::new(4000.0, 0.0), Vector2::zeros()],
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

    /// A soft band whose tube bends around it.
    fn soft() -> TubeShape {
        TubeShape {
            bends: [(-8.0, 12.0), (400.0, -300.0), (1e4, 3e4), (0.0, 0.0)].map(|(x, y)| Vector2::new(x, y)),
            ..TubeShape::straight(Point3::new(-0.1, 0.02, 1.4), &Vector3::new(0.3, 0.9, -0.2), 0.0)
        }
    }

    #[test]
    fn a_soft_band_lies_on_an_arc_of_a_circle() {
        let curvature = 10.0;
        let shape = TubeShape {
            bends: [Vector2::new(curvature, 0.0), Vector2::zeros(), Vector2::zeros(), Vector2::zeros()],
            ..TubeShape::straight(Point3::origin(), &Vector3::z(), 0.0)
        };
        for s in [-15e-3, -4e-3, 8e-3_f64] {
            let (point, direction, _) = shape.at(s);
            let angle = curvature * s;
            let (sin, cos) = angle.sin_cos();
            let circle = shape.across().column(0) * ((1.0 - cos) / curvature) + Vector3::z() * (sin / curvature);
            assert!((point.coords - circle).norm() < 4e-6, "{s}: {point} {circle}");
            assert!((direction.angle(&Vector3::z()) - angle.abs()).abs() < 2e-3, "{s}");
        }
    }

    #[test]
    fn derivatives_equal_differences_of_moved_shapes() {
        for (shape, places, bends) in [
            (bent(), [-15e-3, -3e-3, 0.0, 5e-3, 12e-3, 25e-3], [1.0, 1e2, 1.0, 1e2]),
            (soft(), [-15e-3, -3e-3, 0.0, 5e-3, 12e-3, 15e-3], [1e-2, 1.0, 1e2, 1.0]),
        ] {
            derivatives_equal_differences(&shape, &places, bends);
        }
    }

    fn derivatives_equal_differences(shape: &TubeShape, places: &[f64], bends: [f64; BENDS]) {
        for s in places.iter().copied() {
            let (_, _, d) = shape.at(s);
            for k in 0..SHAPE {
                let h = match k {
                    0..3 => 1e-6,
                    3..FIRST_BEND => 1e-5,
                    _ => bends[(k - FIRST_BEND) / 2],
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
        assert_eq!(moved.bends, shape.bends);
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
