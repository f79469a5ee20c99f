//! The centre line of a stretch of tube around one or more bands, and its image in a view.
//!
//! s is the arc length from the middle of the reference band, metres, positive towards the tip. The reference band is
//! straight over |s| ≤ h (a coil is rigid; h = 0 for a soft band); beyond it the direction turns by the angles
//! φ(s) = κ_down σ + ½ κ'_down σ² (σ = s − h > 0) or κ_up σ (σ = s + h < 0), two components across the tangent t:
//!
//! T(s) = t (1 − ½|φ|²) + N φ, X(s) = c + t (s − ½∫|φ|²) + N ∫φ.
//!
//! Good to |φ|⁴/24: 2 µm over 15 mm at 0.3 rad.

use crate::optics::{NoRay, OpticalPath};
use nalgebra::{Matrix2x3, Matrix3, Matrix3x2, Point2, Point3, SMatrix, SVector, Vector2, Vector3};

/// Number of shape parameters: centre (3), tangent (2), curvature above (2), below (2), and its change below (2).
pub(crate) const SHAPE: usize = 11;

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
    fn d_direction(&self, s: f64) -> SMatrix<f64, 3, SHAPE> {
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

/// Image of one point of the centre line.
#[derive(Debug, Clone)]
pub(crate) struct Knot {
    /// Pixel.
    pub pixel: Point2<f64>,
    /// d pixel / d s, pixels per metre.
    pub along: Vector2<f64>,
    /// Length of `along`, pixels per metre.
    pub scale: f64,
    /// Half width of the tube across its axis, pixels.
    pub half_width: f64,
    /// How far the near side of a ring is displaced along the axis against its centre, pixels (signed, along `along`).
    pub bulge: f64,
    /// d pixel / d shape parameters.
    pub d_pixel: SMatrix<f64, 2, SHAPE>,
    /// d bulge / d shape parameters: a tube that turns towards the camera shows its rings rounder.
    pub d_bulge: SMatrix<f64, 1, SHAPE>,
    /// d pixel / d point, pixels per metre.
    pub d_point: Matrix2x3<f64>,
}

/// Image of the centre line between two arc lengths, as equidistant knots.
#[derive(Debug, Clone)]
pub(crate) struct TubeImage {
    /// Arc length of the first knot, metres.
    pub first_m: f64,
    /// Distance of the knots, metres.
    pub spacing_m: f64,
    /// Knots.
    pub knots: Vec<Knot>,
}

impl TubeImage {
    /// Projects the centre line from `range.0` to `range.1` (metres of arc) at about `spacing_m`.
    ///
    /// # Errors
    /// [`NoRay`] when a part of it cannot be seen in this view.
    pub(crate) fn of(
        shape: &TubeShape,
        radius_m: f64,
        optics: &OpticalPath,
        range: (f64, f64),
        spacing_m: f64,
    ) -> Result<Self, NoRay> {
        let steps = ((range.1 - range.0) / spacing_m).ceil().max(1.0);
        let spacing_m = (range.1 - range.0) / steps;
        let knots = (0..=steps as usize)
            .map(|i| {
                let (point, direction, d) = shape.at(range.0 + i as f64 * spacing_m);
                let seen = optics.project_with_jacobian(&point)?;
                let along: Vector2<f64> = seen.d_pixel * direction;
                let unit = along.normalize();
                // The outline is where the line of sight grazes the tube: across both. The nearest side faces the camera.
                let sight = seen.ray.direction;
                let side = direction.cross(&sight).normalize();
                let near = side.cross(&direction).normalize();
                let near = if near.dot(&sight) > 0.0 { -near } else { near };
                let half = seen.d_pixel * side * radius_m;
                let half_width = (half.x * unit.y - half.y * unit.x).abs();
                let bulge = (seen.d_pixel * near * radius_m).dot(&unit);
                // Moving along the line of sight moves no pixel: bulge = radius · |along| · cos / sin of the angle between.
                let d_direction = shape.d_direction(range.0 + i as f64 * spacing_m);
                let (cos, sin) = (direction.dot(&sight), direction.cross(&sight).norm());
                let d_bulge = (sight.transpose() * d_direction * (along.norm() / sin.powi(3))
                    + unit.transpose() * seen.d_pixel * d_direction * (cos / sin))
                    * radius_m;
                Ok(Knot {
                    pixel: seen.pixel,
                    along,
                    scale: along.norm(),
                    half_width,
                    bulge,
                    d_pixel: seen.d_pixel * d,
                    d_bulge,
                    d_point: seen.d_pixel,
                })
            })
            .collect::<Result<_, NoRay>>()?;
        Ok(Self { first_m: range.0, spacing_m, knots })
    }
}

/// The image of the tube at a knot coordinate.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Local {
    /// Half width, pixels.
    pub half_width: f64,
    /// Displacement of a ring's near side along the axis, pixels.
    pub bulge: f64,
    /// Pixels per metre along the axis.
    pub scale: f64,
}

impl TubeImage {
    /// Index of the knot before `knot`, and the fraction of the way to the next (0..1, held at both ends).
    fn between(&self, knot: f64) -> (usize, f64) {
        let last = self.knots.len() - 2;
        let i = (knot.max(0.0) as usize).min(last);
        (i, (knot - i as f64).clamp(0.0, 1.0))
    }

    /// Width, bulge and scale at a knot coordinate.
    pub(crate) fn local(&self, knot: f64) -> Local {
        let (i, f) = self.between(knot);
        let (a, b) = (&self.knots[i], &self.knots[i + 1]);
        let mix = |p: f64, q: f64| p + (q - p) * f;
        Local {
            half_width: mix(a.half_width, b.half_width),
            bulge: mix(a.bulge, b.bulge),
            scale: mix(a.scale, b.scale),
        }
    }

    /// d pixel / d shape at a knot coordinate.
    pub(crate) fn d_pixel(&self, knot: f64) -> SMatrix<f64, 2, SHAPE> {
        let (i, f) = self.between(knot);
        self.knots[i].d_pixel * (1.0 - f) + self.knots[i + 1].d_pixel * f
    }

    /// d bulge / d shape at a knot coordinate.
    pub(crate) fn d_bulge(&self, knot: f64) -> SMatrix<f64, 1, SHAPE> {
        let (i, f) = self.between(knot);
        self.knots[i].d_bulge * (1.0 - f) + self.knots[i + 1].d_bulge * f
    }

    /// Pixel and derivative per knot at a knot coordinate: cubic Hermite between knots, straight beyond the ends.
    fn axis(&self, knot: f64) -> (Point2<f64>, Vector2<f64>) {
        let last = (self.knots.len() - 1) as f64;
        if knot < 0.0 || knot > last {
            let (end, beyond) =
                if knot < 0.0 { (&self.knots[0], knot) } else { (&self.knots[self.knots.len() - 1], knot - last) };
            let d = end.along * self.spacing_m;
            return (end.pixel + d * beyond, d);
        }
        let (i, f) = self.between(knot);
        let (a, b) = (&self.knots[i], &self.knots[i + 1]);
        let (ta, tb) = (a.along * self.spacing_m, b.along * self.spacing_m);
        let rise = b.pixel - a.pixel;
        let g = 1.0 - f;
        let (p, q) = (ta - rise, tb - rise);
        (a.pixel + rise * f + (p * g - q * f) * (f * g), rise + (p * g - q * f) * (1.0 - 2.0 * f) - (p + q) * (f * g))
    }

    /// Knot coordinate and distance aside, pixels, from the straight line between the first and the last knot.
    pub(crate) fn chord_foot(&self, pixel: &Point2<f64>) -> (f64, f64) {
        let (a, b) = (&self.knots[0], &self.knots[self.knots.len() - 1]);
        let chord = b.pixel - a.pixel;
        let off = pixel - a.pixel;
        let knot = off.dot(&chord) / chord.norm_squared() * (self.knots.len() - 1) as f64;
        (knot, (chord.x * off.y - chord.y * off.x) / chord.norm())
    }

    /// Greatest distance of the axis from the straight line between its ends, pixels.
    pub(crate) fn sagitta(&self) -> f64 {
        self.knots.iter().map(|k| self.chord_foot(&k.pixel).1.abs()).fold(0.0, f64::max)
    }

    /// Greatest half width, pixels.
    pub(crate) fn greatest_half_width(&self) -> f64 {
        self.knots.iter().map(|k| k.half_width).fold(0.0, f64::max)
    }

    /// The nearest point of the axis to a pixel: knot coordinate, signed distance across, unit vector along.
    /// `steps` Newton steps from `start`; one is enough when the tube has moved by less than a pixel since. The last step
    /// follows the tangent: over less than a knot the axis bends by nothing that matters.
    pub(crate) fn foot(&self, pixel: &Point2<f64>, start: f64, steps: usize) -> (f64, f64, Vector2<f64>) {
        let mut knot = start;
        let mut step = 0.0;
        let (mut at, mut d) = self.axis(knot);
        for i in 0..steps {
            if i > 0 {
                knot += step;
                (at, d) = self.axis(knot);
            }
            step = (pixel - at).dot(&d) / d.norm_squared();
        }
        let along = d / d.norm();
        let off = pixel - (at + d * step);
        (knot + step, along.x * off.y - along.y * off.x, along)
    }

    /// Knot coordinate of an arc length.
    pub(crate) fn knot_of(&self, s_m: f64) -> f64 {
        (s_m - self.first_m) / self.spacing_m
    }
}

impl TubeImage {
    /// The knot nearest to an arc length.
    pub(crate) fn at_arc(&self, s_m: f64) -> &Knot {
        let i = self.knot_of(s_m).round().clamp(0.0, (self.knots.len() - 1) as f64);
        &self.knots[i as usize]
    }
}

impl TubeImage {
    /// The point of the tube's outline at a knot coordinate: `side` 1 or −1 half widths across.
    pub(crate) fn beside(&self, knot: f64, side: f64) -> Point2<f64> {
        let (at, d) = self.axis(knot);
        let along = d / d.norm();
        at + Vector2::new(-along.y, along.x) * (side * self.local(knot).half_width)
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

    /// Its own sight of a moved tube would change it too, but by a thousandth of what a turn does.
    #[test]
    fn the_rings_bulge_turns_with_the_tube() {
        let [path, _] = super::super::drawn::views();
        let shape = TubeShape {
            centre: Point3::new(0.001, -0.004, 1.35),
            ..TubeShape {
                frame: TubeShape::straight(Point3::origin(), &Vector3::new(0.2, 1.0, 0.4), 6e-3).frame,
                ..bent()
            }
        };
        let image = |shape: &TubeShape| TubeImage::of(shape, 6e-3, &path, (-20e-3, 25e-3), 2e-3).unwrap().knots;
        let knots = image(&shape);
        for (parameter, step) in (3..11).zip([1e-4, 1e-4, 1e-2, 1e-2, 1e-2, 1e-2, 1.0, 1.0]) {
            let mut by = ShapeStep::zeros();
            by[parameter] = step;
            for ((high, low), knot) in image(&shape.moved(&by)).iter().zip(&image(&shape.moved(&-by))).zip(&knots) {
                let found = (high.bulge - low.bulge) / 2.0;
                let error = (found - knot.d_bulge[parameter] * step).abs();
                assert!(
                    error < 0.1 * 12.0 * 1e-4,
                    "parameter {parameter}: {found}, not {}",
                    knot.d_bulge[parameter] * step
                );
            }
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
