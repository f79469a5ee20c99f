//! The image of a stretch of tube in a view: the centre line as equidistant knots, each projected with its derivatives.
//!
//! Between knots the axis is a cubic (Hermite); widths and derivatives change linearly.

use crate::optics::{NoRay, OpticalPath, Projection};
use crate::track::model::tube_shape::{SHAPE, ShapeStep, TubeShape};
use nalgebra::{Matrix2x3, Point2, Point3, SMatrix, Vector2, Vector3};

/// Number of local quantities that change with the shape: position across the axis, position along it, bulge of the
/// rings.
const LOCAL: usize = 3;

/// Image of one point of the centre line.
#[derive(Debug, Clone)]
pub(in crate::track) struct Knot {
    /// Arc length, metres.
    pub arc_m: f64,
    /// Pixel.
    pub pixel: Point2<f64>,
    /// d pixel / d s, pixels per metre.
    pub along: Vector2<f64>,
    /// Length of `along`, pixels per metre.
    pub scale: f64,
    /// Half width of the tube across its axis, pixels.
    pub half_width: f64,
    /// Displacement of a ring's near side along the axis relative to its centre, pixels (signed, along `along`).
    pub bulge: f64,
    /// Variance that the motion during the exposure adds to the blur, across the axis and along it, px².
    pub swept: Vector2<f64>,
    /// d pixel / d shape parameters.
    pub d_pixel: SMatrix<f64, 2, SHAPE>,
    /// Derivatives of the position across and along the axis, and of the bulge, with respect to the shape parameters,
    /// pixels. A tube that turns towards the camera shows rounder rings.
    pub d_local: [ShapeStep; LOCAL],
    /// The point nearby that was last projected.
    projected: Projection,
}

impl Knot {
    /// d pixel / d point, pixels per metre.
    pub(in crate::track) fn d_point(&self) -> &Matrix2x3<f64> {
        &self.projected.d_pixel
    }

    /// Unit vectors across the axis and along it, in the picture.
    pub(in crate::track) fn axes(&self) -> [Vector2<f64>; 2] {
        let along = self.along / self.scale;
        [Vector2::new(-along.y, along.x), along]
    }
}

/// Over such a short distance a projection is linear to 1e-4 px, for cameras at least half a metre away.
const LINEAR_M: f64 = 0.2e-3;

/// Motion of the tube during the exposure: a fraction of its motion since an earlier frame.
#[derive(Debug, Clone)]
pub(in crate::track) struct Sweep {
    /// Where it was.
    pub before: TubeShape,
    /// Exposure over the time since.
    pub share: f64,
}

impl Sweep {
    /// Motion of the point at an arc length, metres.
    fn way(&self, arc_m: f64, now: &Point3<f64>) -> Vector3<f64> {
        (now - self.before.at(arc_m).0) * self.share
    }
}

/// Image of the centre line between two arc lengths, as equidistant knots.
#[derive(Debug, Clone)]
pub(in crate::track) struct TubeImage {
    /// Arc length of the first knot, metres.
    pub first_m: f64,
    /// Distance of the knots, metres.
    pub spacing_m: f64,
    /// Knots.
    pub knots: Vec<Knot>,
    /// The axis after each knot but the last: the powers' coefficients in the fraction of the way to the next, pixels.
    pieces: Vec<[Vector2<f64>; 4]>,
}

impl TubeImage {
    /// Projects the centre line from `range.0` to `range.1` (metres of arc) at about `spacing_m`. `nearby` is an image
    /// of the same stretch that may be much like it.
    ///
    /// # Errors
    /// [`NoRay`] when a part of it cannot be seen in this view.
    pub(in crate::track) fn of(
        shape: &TubeShape,
        radius_m: f64,
        optics: &OpticalPath,
        range: (f64, f64),
        spacing_m: f64,
        sweep: Option<&Sweep>,
        nearby: Option<&Self>,
    ) -> Result<Self, NoRay> {
        let steps = ((range.1 - range.0) / spacing_m).ceil().max(1.0);
        let spacing_m = (range.1 - range.0) / steps;
        let mut beside = None;
        let mut knots = Vec::with_capacity(steps as usize + 1);
        for i in 0..=steps as usize {
            let arc_m = range.0 + i as f64 * spacing_m;
            let (point, direction, d) = shape.at(arc_m);
            let known = nearby.and_then(|image| image.knots.get(i)).map(|knot| knot.projected);
            let known = known.filter(|known| (point - known.point).norm_squared() < LINEAR_M * LINEAR_M);
            let seen = match (known, &beside) {
                (Some(known), _) => known,
                (None, Some(beside)) => optics.project_beside(&point, beside)?,
                (None, None) => optics.project_with_jacobian(&point)?,
            };
            beside = Some(seen);
            let pixel = seen.pixel + seen.d_pixel * (point - seen.point);
            let along: Vector2<f64> = seen.d_pixel * direction;
            let unit = along.normalize();
            // The outline is where the line of sight grazes the tube: across both. The nearest side faces the
            // camera.
            let sight = seen.ray.direction;
            let side = direction.cross(&sight).normalize();
            let near = side.cross(&direction).normalize();
            let near = if near.dot(&sight) > 0.0 { -near } else { near };
            let half = seen.d_pixel * side * radius_m;
            let half_width = (half.x * unit.y - half.y * unit.x).abs();
            let bulge = (seen.d_pixel * near * radius_m).dot(&unit);
            // Moving along the line of sight moves no pixel: bulge = radius · |along| · cos / sin of the angle
            // between.
            let d_direction = shape.d_direction(arc_m);
            let (cos, sin) = (direction.dot(&sight), direction.cross(&sight).norm());
            let d_bulge = (sight.transpose() * d_direction * (along.norm() / sin.powi(3))
                + unit.transpose() * seen.d_pixel * d_direction * (cos / sin))
                * radius_m;
            let d_pixel = seen.d_pixel * d;
            let across = Vector2::new(-unit.y, unit.x);
            let way = sweep.map_or(Vector2::zeros(), |sweep| seen.d_pixel * sweep.way(arc_m, &point));
            knots.push(Knot {
                arc_m,
                pixel,
                along,
                scale: along.norm(),
                half_width,
                bulge,
                swept: Vector2::new(way.dot(&across), way.dot(&unit)).map(|way| way * way / 12.0),
                d_local: [d_pixel.tr_mul(&across), d_pixel.tr_mul(&unit), d_bulge.transpose()],
                d_pixel,
                projected: seen,
            });
        }
        let pieces = knots.windows(2).map(|pair| hermite(&pair[0], &pair[1], spacing_m)).collect();
        Ok(Self { first_m: range.0, spacing_m, knots, pieces })
    }
}

/// The cubic between two knots that meets both with their directions.
fn hermite(a: &Knot, b: &Knot, spacing_m: f64) -> [Vector2<f64>; 4] {
    let (ta, tb) = (a.along * spacing_m, b.along * spacing_m);
    let rise = b.pixel - a.pixel;
    [a.pixel.coords, ta, rise * 3.0 - ta * 2.0 - tb, ta + tb - rise * 2.0]
}

impl TubeImage {
    /// Index of the knot before `knot`, at most the last but one.
    fn before(&self, knot: f64) -> usize {
        (knot as usize).min(self.pieces.len() - 1)
    }

    /// Index of the knot before `knot`, and the fraction of the way to the next (0..1, held at both ends).
    fn between(&self, knot: f64) -> (usize, f64) {
        let i = self.before(knot);
        (i, (knot - i as f64).clamp(0.0, 1.0))
    }

    /// Half width of the tube at a knot coordinate, pixels.
    fn half_width(&self, knot: f64) -> f64 {
        let (i, f) = self.between(knot);
        let (a, b) = (self.knots[i].half_width, self.knots[i + 1].half_width);
        a + (b - a) * f
    }

    /// Pixel and derivative per knot at a knot coordinate, straight beyond the ends.
    fn axis(&self, knot: f64) -> (Point2<f64>, Vector2<f64>) {
        let held = knot.clamp(0.0, self.pieces.len() as f64);
        let i = self.before(held);
        let f = held - i as f64;
        let [a, b, c, d] = &self.pieces[i];
        let slope = b + (c * 2.0 + d * (3.0 * f)) * f;
        (Point2::from(a + (b + (c + d * f) * f) * f + slope * (knot - held)), slope)
    }

    /// RMS distance between the knots of two images of the same stretch, pixels.
    pub(in crate::track) fn distance(&self, other: &Self) -> f64 {
        let apart = self.knots.iter().zip(&other.knots).map(|(a, b)| (a.pixel - b.pixel).norm_squared());
        (apart.sum::<f64>() / self.knots.len() as f64).sqrt()
    }

    /// Arc length of a knot coordinate, metres.
    pub(in crate::track) fn arc_m(&self, knot: f64) -> f64 {
        self.first_m + knot * self.spacing_m
    }

    /// The axis between a knot and the next: the powers' coefficients in the fraction of the way, pixels.
    pub(in crate::track) fn piece(&self, knot: usize) -> &[Vector2<f64>; 4] {
        &self.pieces[knot]
    }

    /// Knot coordinate of an arc length.
    pub(in crate::track) fn knot_of(&self, s_m: f64) -> f64 {
        (s_m - self.first_m) / self.spacing_m
    }

    /// The knot nearest to an arc length.
    pub(in crate::track) fn at_arc(&self, s_m: f64) -> &Knot {
        let i = self.knot_of(s_m).round().clamp(0.0, (self.knots.len() - 1) as f64);
        &self.knots[i as usize]
    }

    /// The point of the tube's outline at a knot coordinate: `side` 1 or −1 half widths across.
    pub(in crate::track) fn beside(&self, knot: f64, side: f64) -> Point2<f64> {
        let (at, d) = self.axis(knot);
        let along = d / d.norm();
        at + Vector2::new(-along.y, along.x) * (side * self.half_width(knot))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_motion_across_the_tube_is_across_it() {
        let [path, _] = crate::testing::two_views::views();
        let shape = TubeShape::straight(Point3::new(0.001, -0.004, 1.35), &Vector3::new(0.2, 1.0, 0.4), 6e-3);
        for knot in TubeImage::of(&shape, 6e-3, &path, (-20e-3, 25e-3), 2e-3, None, None).unwrap().knots {
            let [across, along] = knot.axes();
            let turned = Vector2::new(-knot.along.y, knot.along.x).normalize();
            assert!((across.dot(&(along * 7.0 + turned * -2.0)) + 2.0).abs() < 1e-12);
            assert!(across.dot(&(along * 7.0)).abs() < 1e-12);
        }
    }

    /// Its own sight of a moved tube would change it too, but by a thousandth of what a turn does.
    #[test]
    fn the_rings_bulge_turns_with_the_tube() {
        let [path, _] = crate::testing::two_views::views();
        let shape = TubeShape {
            bends: [(-900.0, 1200.0), (3e4, 5e4), (1500.0, -600.0), (-4e4, 2e4)].map(|(x, y)| Vector2::new(x, y)),
            ..TubeShape::straight(Point3::new(0.001, -0.004, 1.35), &Vector3::new(0.2, 1.0, 0.4), 6e-3)
        };
        let image =
            |shape: &TubeShape| TubeImage::of(shape, 6e-3, &path, (-20e-3, 25e-3), 2e-3, None, None).unwrap().knots;
        let knots = image(&shape);
        for (parameter, step) in (3..SHAPE).zip([1e-4, 1e-4, 1.0, 1.0, 1e2, 1e2, 1.0, 1.0, 1e2, 1e2]) {
            let mut by = ShapeStep::zeros();
            by[parameter] = step;
            for ((high, low), knot) in image(&shape.moved(&by)).iter().zip(&image(&shape.moved(&-by))).zip(&knots) {
                let found = (high.bulge - low.bulge) / 2.0;
                let error = (found - knot.d_local[2][parameter] * step).abs();
                assert!(
                    error < 0.1 * 12.0 * 1e-4,
                    "parameter {parameter}: {found}, not {}",
                    knot.d_local[2][parameter] * step
                );
            }
        }
    }
}
