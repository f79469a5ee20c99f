//! The ray that connects camera and point: finds the normalised image point whose ray passes through a given point.
//!
//! In: surfaces in the order of travel, a point. Out: a [`Connection`]. Method: Newton on the two components of the
//! miss across the ray, started from the mirrored pinhole. The search may pass through lines that no light takes (a
//! surface met backwards); only the result must be a real ray. By Fermat's principle the optical path between two
//! points through flat interfaces is the minimum of a convex function, so there is at most one answer.
//!
//! Where Newton fails from there (the straight line to the point is totally reflected where the bent one is not, or the
//! rays are steep), the refractive indices are raised in steps from none to the true ones, each answer starting the
//! next search.

use crate::optics::{NoRay, Ray, RayWithJacobian, Surface};
use nalgebra::{Matrix2, Matrix2x3, Matrix3x2, Point2, Point3, SMatrix, Vector2, Vector3};

/// Newton steps after which a start is given up; two to four are usual.
const MAX_STEPS: usize = 20;

/// Largest remaining error in normalised image coordinates: 1e-9 px at 10,000 px focal length.
const TOLERANCE: f64 = 1e-13;

/// Smallest step in which the indices are raised, as a fraction: fine enough for rays that leave a wall at up to 85°.
const MIN_EASE: f64 = 1e-3;

/// A line from the camera through all surfaces, and its miss distance from a point.
#[derive(Debug, Clone, Copy)]
pub(super) struct Connection {
    /// The normalised image point it starts at.
    pub(super) normalised: Point2<f64>,
    /// The line after the last surface.
    pub(super) folded: RayWithJacobian,
    /// Two unit vectors across it, as columns; d miss / d point is their transpose.
    across: Matrix3x2<f64>,
    /// Point minus line, along these two vectors, metres.
    miss: Vector2<f64>,
    /// The inverse of d miss / d normalised image point.
    d_normalised: Matrix2<f64>,
}

/// The ray that reaches `point` after all `surfaces`.
///
/// # Errors
/// [`NoRay`] where none does.
pub(super) fn connect(surfaces: &[Surface], point: &Point3<f64>) -> Result<Connection, NoRay> {
    if !point.coords.iter().all(|v| v.is_finite()) {
        return Err(NoRay::NotConverged);
    }
    if let Some(Surface::Mirror(mirror)) = surfaces.last()
        && mirror.plane.signed_distance(point) <= 0.0
    {
        return Err(NoRay::BehindMirror);
    }
    let apparent = unfold(surfaces, point);
    if apparent.z <= 0.0 {
        return Err(NoRay::BeforeLastSurface);
    }
    let start = Point2::new(apparent.x / apparent.z, apparent.y / apparent.z);
    let real = |found: Connection| found.real(point);
    newton(surfaces, start, point).and_then(real).or_else(|why| {
        if is_beyond_last_wall(surfaces, point) {
            ease_in(surfaces, start, point).and_then(real).map_err(|_| why)
        } else {
            Err(NoRay::BeforeLastSurface)
        }
    })
}

/// As [`connect`], started from the ray to a nearby point: faster, with the same result.
///
/// # Errors
/// [`NoRay`] where none does.
pub(super) fn connect_beside(
    surfaces: &[Surface],
    point: &Point3<f64>,
    (beside, its_point): (&Connection, &Point3<f64>),
) -> Result<Connection, NoRay> {
    let start = beside.normalised + beside.d_point() * (point - its_point);
    newton(surfaces, start, point).and_then(|found| found.real(point)).or_else(|_| connect(surfaces, point))
}

/// Folds the line of a normalised image point through all surfaces; derivatives are with respect to as many of that
/// point's coordinates as the result has columns, none or both.
///
/// # Errors
/// [`NoRay`] where the line ends; see [`Surface::apply`] for what `lost` in the result says.
pub(super) fn fold<const D: usize>(
    surfaces: &[Surface],
    normalised: &Point2<f64>,
) -> Result<RayWithJacobian<D>, NoRay> {
    let v = Vector3::new(normalised.x, normalised.y, 1.0);
    let length = v.norm();
    let direction = v / length;
    let d_v = SMatrix::<f64, 3, D>::identity();
    let start = RayWithJacobian {
        ray: Ray { origin: Point3::origin(), direction },
        d_origin: SMatrix::zeros(),
        d_direction: (d_v - direction * (direction.transpose() * d_v)) / length,
        lost: None,
    };
    surfaces.iter().try_fold(start, |ray, surface| surface.apply(&ray))
}

/// The point as it would appear without refraction: mirrored through all mirrors, last one first.
fn unfold(surfaces: &[Surface], point: &Point3<f64>) -> Point3<f64> {
    surfaces.iter().rev().fold(*point, |p, surface| surface.mirrored(&p))
}

/// Whether the point lies on the far side of the wall that ends the path, as seen from the (mirrored) camera.
fn is_beyond_last_wall(surfaces: &[Surface], point: &Point3<f64>) -> bool {
    let Some(Surface::Wall(wall)) = surfaces.last() else { return true };
    let camera = surfaces.iter().fold(Point3::origin(), |p, surface| surface.mirrored(&p));
    if wall.outer.signed_distance(&camera) > -0.5 * wall.thickness_m {
        wall.inner().signed_distance(point) < 0.0
    } else {
        wall.outer.signed_distance(point) > 0.0
    }
}

/// Newton from one start; gives up when a step brings no improvement.
fn newton(surfaces: &[Surface], start: Point2<f64>, point: &Point3<f64>) -> Result<Connection, NoRay> {
    let mut here = Connection::at(surfaces, start, point)?;
    for _ in 0..MAX_STEPS {
        let next = Connection::at(surfaces, here.normalised - here.step(), point)?;
        // Far off the axis normalised coordinates grow with 1/cos² of the angle.
        let scale = 1.0 + next.normalised.coords.norm_squared();
        if next.step().norm() < TOLERANCE * scale {
            return Ok(next);
        }
        if next.miss.norm() >= here.miss.norm() {
            return Err(NoRay::NotConverged);
        }
        here = next;
    }
    Err(NoRay::NotConverged)
}

/// Newton along a sequence of indices, from the straight line to the true refraction.
fn ease_in(surfaces: &[Surface], start: Point2<f64>, point: &Point3<f64>) -> Result<Connection, NoRay> {
    let (mut normalised, mut part, mut stride) = (start, 0.0, 0.5);
    loop {
        let next = f64::min(part + stride, 1.0);
        let eased: Vec<Surface> = surfaces.iter().map(|s| s.with_refraction(next)).collect();
        match newton(&eased, normalised, point) {
            Ok(found) if next == 1.0 => return Ok(found),
            Ok(found) => (normalised, part) = (found.normalised, next),
            Err(why) if stride < MIN_EASE => return Err(why),
            Err(_) => stride *= 0.5,
        }
    }
}

impl Connection {
    /// The line of one normalised image point, and its miss.
    fn at(surfaces: &[Surface], normalised: Point2<f64>, point: &Point3<f64>) -> Result<Self, NoRay> {
        let folded = fold(surfaces, &normalised)?;
        let d = folded.ray.direction;
        let aside = if d.x.abs() < 0.6 { Vector3::x() } else { Vector3::y() };
        let e1 = d.cross(&aside).normalize();
        let across = Matrix3x2::from_columns(&[e1, d.cross(&e1)]);
        let to_point = point - folded.ray.origin;
        // As the line turns by dd, so do the vectors across it, towards -d: that is the second term. Their rotation
        // about the line itself does not change the length of the miss and is left out.
        let d_miss = -across.transpose() * (folded.d_origin + folded.d_direction * to_point.dot(&d));
        Ok(Self {
            normalised,
            folded,
            across,
            miss: across.transpose() * to_point,
            d_normalised: d_miss.try_inverse().ok_or(NoRay::NotConverged)?,
        })
    }

    /// `self`, if light takes this way to the point.
    fn real(self, point: &Point3<f64>) -> Result<Self, NoRay> {
        match self.folded.lost {
            Some(why) => Err(why),
            None if self.folded.ray.nearest(point) <= 0.0 => Err(NoRay::BeforeLastSurface),
            None => Ok(self),
        }
    }

    /// The Newton step, to be subtracted.
    fn step(&self) -> Vector2<f64> {
        self.d_normalised * self.miss
    }

    /// d normalised image point / d point, where the miss is zero: the implicit function theorem.
    pub(super) fn d_point(&self) -> Matrix2x3<f64> {
        -self.d_normalised * self.across.transpose()
    }
}
