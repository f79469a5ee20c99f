//! The centre line of a stretch of tube around one or more bands.
//!
//! s is the arc length from the middle of the reference band, metres, positive towards the tip. The reference band is
//! straight over |s| ≤ h (a coil is rigid; h = 0 for a soft band); beyond it the direction turns by the angles
//! φ(s) = κ_down σ + ½ κ'_down σ² (σ = s − h > 0) or κ_up σ (σ = s + h < 0), two components across the tangent t:
//!
//! T(s) = t (1 − ½|φ|²) + N φ, X(s) = c + t (s − ½∫|φ|²) + N ∫φ.
//!
//! Good to |φ|⁴/24: 2 µm over 15 mm at 0.3 rad.

use nalgebra::{Const, Dyn, Matrix3, Matrix3x2, OMatrix, Point3, SMatrix, SVector, Vector2, Vector3};

/// Number of shape parameters: centre (3), tangent (2), curvature above (2), below (2), and its change below (2).
pub(crate) const SHAPE: usize = 11;

/// Shape parameters (rows) by any number of others.
pub(crate) type ShapeBy = OMatrix<f64, Const<SHAPE>, Dyn>;

/// A vector of shape parameters' increments.
pub(crate) type ShapeStep = SVector<f64, SHAPE>;

/// A stretch of tube.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct TubeShape {
    /// Middle of the reference band on the centre line, camera frame, metres.
    pub centre: Point3<f64>,
    /// Orthonormal: columns n1, n2 (across) and t (tangent of the reference band, base to tip).
    pub frame: Matrix3<f64>,
    /// Curvature above the reference band, 1/m, components along n1, n2.
    pub curvature_up: Vector2<f64>,
    /// Curvature just below it, 1/m.
    pub curvature_down: Vector2<f64>,
    /// Change of curvature with arc length below it, 1/m².
    pub curvature_down_rate: Vector2<f64>,
    /// Half length of the straight part, metres.
    pub straight_half_m: f64,
}

impl TubeShape {
    /// A straight tube through `centre` along `direction`.
    pub(crate) fn straight(centre: Point3<f64>, direction: &Vector3<f64>, straight_half_m: f64) -> Self {
        let t = direction.normalize();
        let helper = if t.x.abs() < 0.6 { Vector3::x() } else { Vector3::z() };
        let n1 = t.cross(&helper).normalize();
        let n2 = t.cross(&n1);
        Self {
            centre,
            frame: Matrix3::from_columns(&[n1, n2, t]),
            curvature_up: Vector2::zeros(),
            curvature_down: Vector2::zeros(),
            curvature_down_rate: Vector2::zeros(),
            straight_half_m,
        }
    }

    /// Tangent of the reference band.
    pub(crate) fn tangent(&self) -> Vector3<f64> {
        self.frame.column(2).into()
    }

    /// The two unit vectors across the tangent.
    pub(crate) fn across(&self) -> Matrix3x2<f64> {
        self.frame.fixed_columns::<2>(0).into()
    }

    /// The curvatures among the parameters, the others nil.
    pub(crate) fn curvatures(&self) -> ShapeStep {
        let mut parameters = ShapeStep::zeros();
        for (at, pair) in [(5, self.curvature_up), (7, self.curvature_down), (9, self.curvature_down_rate)] {
            parameters.fixed_rows_mut::<2>(at).copy_from(&pair);
        }
        parameters
    }

    /// Point of the centre line at arc length `s`, its direction, and d point / d parameters.
    pub(crate) fn at(&self, s: f64) -> (Point3<f64>, Vector3<f64>, SMatrix<f64, 3, SHAPE>) {
        let n = self.across();
        let t = self.tangent();
        let h = self.straight_half_m;
        let sigma = if s > h {
            s - h
        } else if s < -h {
            s + h
        } else {
            0.0
        };
        let (k, rate) =
            if s > h { (self.curvature_down, self.curvature_down_rate) } else { (self.curvature_up, Vector2::zeros()) };
        let (s2, s3, s4, s5) = (sigma.powi(2), sigma.powi(3), sigma.powi(4), sigma.powi(5));
        let turn = k * sigma + rate * (s2 / 2.0);
        let aside = k * (s2 / 2.0) + rate * (s3 / 6.0);
        let shortening = k.norm_squared() * s3 / 6.0 + k.dot(&rate) * s4 / 8.0 + rate.norm_squared() * s5 / 40.0;
        let along = s - shortening;
        let point = self.centre + t * along + n * aside;
        let direction = t * (1.0 - turn.norm_squared() / 2.0) + n * turn;

        let mut d = SMatrix::<f64, 3, SHAPE>::zeros();
        d.fixed_view_mut::<3, 3>(0, 0).copy_from(&Matrix3::identity());
        d.fixed_view_mut::<3, 2>(0, 3).copy_from(&(n * along - t * aside.transpose()));
        let d_k = n * (s2 / 2.0) - t * (k * (s3 / 3.0) + rate * (s4 / 8.0)).transpose();
        if s > h {
            let d_rate = n * (s3 / 6.0) - t * (k * (s4 / 8.0) + rate * (s5 / 20.0)).transpose();
            d.fixed_view_mut::<3, 2>(0, 7).copy_from(&d_k);
            d.fixed_view_mut::<3, 2>(0, 9).copy_from(&d_rate);
        } else {
            d.fixed_view_mut::<3, 2>(0, 5).copy_from(&d_k);
        }
        (point, direction, d)
    }

    /// d direction / d parameters at arc length `s`, to first order in the angle φ that the tube has turned by.
    pub(crate) fn d_direction(&self, s: f64) -> SMatrix<f64, 3, SHAPE> {
        let sigma = s - s.clamp(-self.straight_half_m, self.straight_half_m);
        let down = sigma > 0.0;
        let bent = self.curvature_down * sigma + self.curvature_down_rate * (sigma * sigma / 2.0);
        let turn = if down { bent } else { self.curvature_up * sigma };
        let d_turn = self.across() - self.tangent() * turn.transpose();
        let mut d = SMatrix::<f64, 3, SHAPE>::zeros();
        d.fixed_view_mut::<3, 2>(0, 3).copy_from(&d_turn);
        if down {
            d.fixed_view_mut::<3, 2>(0, 7).copy_from(&(d_turn * sigma));
            d.fixed_view_mut::<3, 2>(0, 9).copy_from(&(d_turn * (sigma * sigma / 2.0)));
        } else {
            d.fixed_view_mut::<3, 2>(0, 5).copy_from(&(d_turn * sigma));
        }
        d
    }

    /// The shape moved by a step of its parameters.
    pub(crate) fn moved(&self, step: &ShapeStep) -> Self {
        let tilt = Vector2::new(step[3], step[4]);
        // Rotation that takes t to t + N·tilt (to first order) without turning about t, so that curvatures keep their axes.
        let axis = self.across() * Vector2::new(-tilt.y, tilt.x);
        let rotation = nalgebra::Rotation3::new(axis);
        Self {
            centre: self.centre + Vector3::new(step[0], step[1], step[2]),
            frame: rotation * self.frame,
            curvature_up: self.curvature_up + Vector2::new(step[5], step[6]),
            curvature_down: self.curvature_down + Vector2::new(step[7], step[8]),
            curvature_down_rate: self.curvature_down_rate + Vector2::new(step[9], step[10]),
            straight_half_m: self.straight_half_m,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bent() -> TubeShape {
        TubeShape {
            curvature_up: Vector2::new(5.0, -8.0),
            curvature_down: Vector2::new(-12.0, 4.0),
            curvature_down_rate: Vector2::new(150.0, -60.0),
            ..TubeShape::straight(Point3::new(-0.1, 0.02, 1.4), &Vector3::new(0.3, 0.9, -0.2), 6e-3)
        }
    }

    #[test]
    fn a_constant_curvature_is_an_arc_of_a_circle() {
        let shape = TubeShape {
            curvature_down: Vector2::new(20.0, 0.0),
            ..TubeShape::straight(Point3::origin(), &Vector3::z(), 6e-3)
        };
        // 10 mm of an arc of radius 50 mm after 6 mm of straight: 0.2 rad.
        let (point, direction, _) = shape.at(16e-3);
        let n = shape.across();
        assert!((point.coords.dot(&n.column(0)) - 0.05 * (1.0 - 0.2_f64.cos())).abs() < 4e-6);
        assert!((point.z - (6e-3 + 0.05 * 0.2_f64.sin())).abs() < 1e-6);
        assert!((direction.angle(&Vector3::z()) - 0.2).abs() < 2e-3);
        assert!((direction.norm() - 1.0).abs() < 1e-3);
    }

    #[test]
    fn derivatives_equal_differences_of_moved_shapes() {
        let shape = bent();
        for s in [-15e-3, -3e-3, 0.0, 5e-3, 12e-3, 25e-3] {
            let (_, _, d) = shape.at(s);
            for k in 0..SHAPE {
                let h = [1e-6, 1e-6, 1e-6, 1e-5, 1e-5, 1e-2, 1e-2, 1e-2, 1e-2, 1.0, 1.0][k];
                let mut step = ShapeStep::zeros();
                step[k] = h;
                let difference = (shape.moved(&step).at(s).0 - shape.moved(&(-step)).at(s).0) / (2.0 * h);
                let error = (difference - d.column(k)).norm();
                assert!(error < 1e-4 * difference.norm() + 1e-9, "s {s} parameter {k}: {difference} {}", d.column(k));
            }
        }
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
