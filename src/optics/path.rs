//! The optical path: a lens and an ordered list of surfaces. `trace` folds a pixel's ray through the list; `project`
//! inverts it.
//!
//! A refracted view has no single centre, so there is no closed form for `project`: it solves for the ray (`solve.rs`),
//! to rounding in two to four steps.

use crate::optics::solve::{self, Connection};
use crate::optics::{Lens, NoRay, Ray, RayWithJacobian, Surface};
use nalgebra::{Matrix2x3, Matrix3x2, Point2, Point3};

/// A lens and the surfaces a camera ray meets, in the order of travel.
///
/// # Assumptions
/// Surfaces are unbounded planes and met in the given order; the view's region limits them in the picture.
#[derive(Debug, Clone, PartialEq)]
pub struct OpticalPath {
    /// The camera's lens.
    pub lens: Lens,
    /// The surfaces, from the camera to the marker's medium.
    pub surfaces: Vec<Surface>,
}

/// A traced pixel.
#[derive(Debug, Clone, Copy)]
pub struct Tracing {
    /// The ray in the medium of the marker.
    pub ray: Ray,
    /// d origin / d pixel, metres per pixel.
    pub d_origin: Matrix3x2<f64>,
    /// d direction / d pixel, per pixel.
    pub d_direction: Matrix3x2<f64>,
}

/// A projected point.
#[derive(Debug, Clone, Copy)]
pub struct Projection {
    /// Where it is seen.
    pub pixel: Point2<f64>,
    /// d pixel / d point, pixels per metre.
    pub d_pixel: Matrix2x3<f64>,
    /// The ray that connects them, in the medium of the marker.
    pub ray: Ray,
    /// The point.
    pub point: Point3<f64>,
    /// Where the search for a nearby point starts.
    connection: Connection,
}

impl Projection {
    /// The pixel without the lens: a normalised image point.
    pub fn normalised(&self) -> Point2<f64> {
        self.connection.normalised
    }
}

impl OpticalPath {
    /// The ray, in the medium of the marker, along which a pixel sees.
    ///
    /// # Errors
    /// [`NoRay`] when the ray is lost on the way.
    pub fn trace(&self, pixel: &Point2<f64>) -> Result<Ray, NoRay> {
        self.trace_normalised(&self.lens.undistort(pixel).ok_or(NoRay::Lens)?)
    }

    /// As [`OpticalPath::trace`], of a normalised image point.
    ///
    /// # Errors
    /// [`NoRay`] when the ray is lost on the way.
    pub(crate) fn trace_normalised(&self, normalised: &Point2<f64>) -> Result<Ray, NoRay> {
        Ok(self.fold::<0>(normalised)?.ray)
    }

    /// As [`OpticalPath::trace`], with derivatives.
    ///
    /// # Errors
    /// [`NoRay`] when the ray is lost on the way.
    pub fn trace_with_jacobian(&self, pixel: &Point2<f64>) -> Result<Tracing, NoRay> {
        let normalised = self.lens.undistort(pixel).ok_or(NoRay::Lens)?;
        let (_, d_pixel) = self.lens.distort_with_jacobian(&normalised);
        let d_normalised = d_pixel.try_inverse().ok_or(NoRay::Lens)?;
        let r = self.fold(&normalised)?;
        Ok(Tracing { ray: r.ray, d_origin: r.d_origin * d_normalised, d_direction: r.d_direction * d_normalised })
    }

    /// Where a point is seen.
    ///
    /// # Errors
    /// [`NoRay`] where no ray of this path arrives.
    pub fn project(&self, point: &Point3<f64>) -> Result<Point2<f64>, NoRay> {
        Ok(self.lens.distort(&self.connect(point)?.normalised))
    }

    /// As [`OpticalPath::project`], with derivatives and the connecting ray.
    ///
    /// # Errors
    /// [`NoRay`] where no ray of this path arrives.
    pub fn project_with_jacobian(&self, point: &Point3<f64>) -> Result<Projection, NoRay> {
        self.seen(point, solve::connect(&self.surfaces, point)?)
    }

    /// As [`OpticalPath::project_with_jacobian`], but twice as fast, for a point close to one already projected.
    ///
    /// # Errors
    /// [`NoRay`] where no ray of this path arrives.
    pub fn project_beside(&self, point: &Point3<f64>, beside: &Projection) -> Result<Projection, NoRay> {
        let beside = (&beside.connection, &beside.point);
        self.seen(point, solve::connect_beside(&self.surfaces, point, beside)?)
    }

    fn seen(&self, point: &Point3<f64>, connection: Connection) -> Result<Projection, NoRay> {
        if !self.lens.is_one_to_one(&connection.normalised) {
            return Err(NoRay::Lens);
        }
        let (pixel, d_pixel) = self.lens.distort_with_jacobian(&connection.normalised);
        let d_pixel = d_pixel * connection.d_point();
        Ok(Projection { pixel, d_pixel, ray: connection.folded.ray, point: *point, connection })
    }

    /// Folds the ray of a normalised image point through all surfaces and rejects one that no light takes.
    fn fold<const D: usize>(&self, normalised: &Point2<f64>) -> Result<RayWithJacobian<D>, NoRay> {
        let folded = solve::fold(&self.surfaces, normalised)?;
        match folded.lost {
            Some(why) => Err(why),
            None => Ok(folded),
        }
    }

    /// The ray to a point, rejected where the lens model does not hold.
    fn connect(&self, point: &Point3<f64>) -> Result<Connection, NoRay> {
        let connection = solve::connect(&self.surfaces, point)?;
        if self.lens.is_one_to_one(&connection.normalised) { Ok(connection) } else { Err(NoRay::Lens) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::optics::{Mirror, Plane, Wall};
    use nalgebra::{Vector2, Vector3};

    /// A lens without distortion, 1000 px, principal point (500, 400).
    fn path(surfaces: Vec<Surface>) -> OpticalPath {
        let lens = Lens {
            focal_px: Vector2::new(1000.0, 1000.0),
            principal_point_px: Point2::new(500.0, 400.0),
            distortion: [0.0; 5],
            denominator: [0.0; 3],
        };
        OpticalPath { lens, surfaces }
    }

    fn mirror(normal: Vector3<f64>, offset_m: f64) -> Surface {
        Surface::Mirror(Mirror { plane: Plane::new(normal, offset_m).unwrap() })
    }

    /// A wall at z = 1 m that faces the camera.
    fn wall(thickness_m: f64, index_wall: f64, index_inside: f64) -> Surface {
        let outer = Plane::new(-Vector3::z(), -1.0).unwrap();
        Surface::Wall(Wall { outer, thickness_m, index_outside: 1.0, index_wall, index_inside })
    }

    /// Apparent distance of a point on the axis: where two of its rays close to the axis meet.
    fn apparent_distance(path: &OpticalPath, distance_m: f64) -> f64 {
        let aside_m = 1e-6;
        let pixel = path.project(&Point3::new(aside_m, 0.0, distance_m)).unwrap();
        1000.0 * aside_m / (pixel.x - 500.0)
    }

    #[test]
    fn in_air_it_is_the_pinhole() {
        // 1000 · 0.1/2 + 500, 1000 · (-0.2)/2 + 400.
        let pixel = path(vec![]).project(&Point3::new(0.1, -0.2, 2.0)).unwrap();
        assert!((pixel - Point2::new(550.0, 300.0)).norm() < 1e-12);
    }

    #[test]
    fn a_mirror_shows_the_image() {
        // In x = 1, the point (0.6, 0.1, 2) has its image at (1.4, 0.1, 2): 1000 · 0.7 + 500, 1000 · 0.05 + 400.
        let seen = path(vec![mirror(-Vector3::x(), -1.0)]).project_with_jacobian(&Point3::new(0.6, 0.1, 2.0)).unwrap();
        assert!((seen.pixel - Point2::new(1200.0, 450.0)).norm() < 1e-12);
        // Moving to the right, it is seen to move to the left: 1000 px / 2 m.
        assert!((seen.d_pixel.m11 + 500.0).abs() < 1e-9 && (seen.d_pixel.m22 - 500.0).abs() < 1e-9);
    }

    #[test]
    fn water_lifts_to_the_apparent_depth() {
        // 0.15 m of water looks like 0.15 / 1.333 = 0.112528 m.
        let seems = apparent_distance(&path(vec![wall(0.0, 1.333, 1.333)]), 1.15);
        assert!((seems - 1.112528).abs() < 1e-6, "{seems}");
    }

    #[test]
    fn what_ignoring_the_water_and_the_pane_costs() {
        // Ignoring 150 mm of water: 150 · (1 - 1/1.333) = 37.47 mm.
        let water = path(vec![wall(0.0, 1.333, 1.333)]);
        assert!((1.15 - apparent_distance(&water, 1.15) - 37.472e-3).abs() < 1e-6);
        // A 6 mm pane taken for water: 6/1.333 - 6/1.52 = 0.554 mm of apparent distance...
        let pane = path(vec![wall(0.006, 1.52, 1.333)]);
        let seems = apparent_distance(&pane, 1.15);
        assert!((apparent_distance(&water, 1.15) - seems - 0.5538e-3).abs() < 1e-7);
        // ...which the water stretches to 6 · (1 - 1.333/1.52) = 0.738 mm of true depth.
        assert!((apparent_distance(&water, 1.15 - 0.73816e-3) - seems).abs() < 1e-7);
    }

    #[test]
    fn an_immersed_mirror_by_hand() {
        // Index 4/3 from z = 0.6 on. (0.8, 0, 0.6) meets the water at (0.8, 0, 0.6) and continues as (0.6, 0, 0.8):
        // sines 0.8 and 0.8/(4/3) = 0.6. After 0.5 m it meets the mirror x = 1.1 at (1.1, 0, 1), turns to (-0.6, 0,
        // 0.8) and reaches (0.8, 0, 1.4) after another 0.5 m. Pixel: 1000 · 0.8/0.6 + 500.
        let outer = Plane::new(-Vector3::z(), -0.6).unwrap();
        let index = 4.0 / 3.0;
        let water =
            Surface::Wall(Wall { outer, thickness_m: 0.0, index_outside: 1.0, index_wall: index, index_inside: index });
        let path = path(vec![water, mirror(-Vector3::x(), -1.1)]);
        let pixel = Point2::new(1000.0 * 4.0 / 3.0 + 500.0, 400.0);
        let ray = path.trace(&pixel).unwrap();
        assert!((ray.origin - Point3::new(1.1, 0.0, 1.0)).norm() < 1e-14);
        assert!((ray.direction - Vector3::new(-0.6, 0.0, 0.8)).norm() < 1e-14);
        assert!((path.project(&Point3::new(0.8, 0.0, 1.4)).unwrap() - pixel).norm() < 1e-10);
    }

    #[test]
    fn steep_and_thick_is_found() {
        // 80° in air, a 100 mm pane, 1 m of water. Glass: sin 80°/1.52 = 0.64790, tan = 0.85052; water: sin = 0.73879,
        // cos = 0.67395. The point is at (5.6713 + 0.0851 + 0.7388, 1.1 + 0.6740), in a straight direction of 74.7°.
        let path = path(vec![wall(0.1, 1.52, 1.333)]);
        let pixel = Point2::new(500.0 + 1000.0 * 80_f64.to_radians().tan(), 400.0);
        let point = path.trace(&pixel).unwrap().at(1.0);
        assert!((path.project(&point).unwrap() - pixel).norm() < 1e-8);
    }

    #[test]
    fn out_of_the_water_points_aside_are_found_where_the_straight_line_is_totally_reflected() {
        // Camera 1 m under the surface; sin 45° · 1.333 = 0.942574 leaves at 70.49°. A point 5 m further along lies in
        // a direction of 65.0°, far beyond the critical 48.6°.
        let outer = Plane::new(Vector3::z(), 1.0).unwrap();
        let surface =
            Surface::Wall(Wall { outer, thickness_m: 0.0, index_outside: 1.0, index_wall: 1.333, index_inside: 1.333 });
        let path = path(vec![surface]);
        let ray = path.trace(&Point2::new(1500.0, 400.0)).unwrap();
        assert!((ray.direction.x - 0.942574).abs() < 1e-6);
        assert!((path.project(&ray.at(5.0)).unwrap() - Point2::new(1500.0, 400.0)).norm() < 1e-9);
        // The same pixel row further out: 1000 · tan 48.6066° = 1134.5 px is the last that sees the air.
        assert!(path.trace(&Point2::new(500.0 + 1134.0, 400.0)).is_ok());
        assert_eq!(path.trace(&Point2::new(500.0 + 1135.0, 400.0)), Err(NoRay::TotalReflection));
    }

    #[test]
    fn where_no_ray_arrives_the_reason_is_given() {
        let reason =
            |surfaces: Vec<Surface>, x: f64, y: f64, z: f64| path(surfaces).project(&Point3::new(x, y, z)).unwrap_err();
        let side_mirror = mirror(-Vector3::x(), -1.0);
        let tank = wall(0.005, 1.52, 1.333);
        assert_eq!(reason(vec![], 0.0, 0.1, -1.0), NoRay::BeforeLastSurface);
        assert_eq!(reason(vec![], 0.0, 0.0, 0.0), NoRay::BeforeLastSurface);
        assert_eq!(reason(vec![side_mirror], 1.2, 0.0, 2.0), NoRay::BehindMirror);
        assert_eq!(reason(vec![side_mirror], 1.0, 0.0, 2.0), NoRay::BehindMirror);
        assert_eq!(reason(vec![side_mirror], 0.5, 0.0, -2.0), NoRay::BeforeLastSurface);
        // A mirror with its back to the camera.
        assert_eq!(reason(vec![mirror(Vector3::x(), 1.0)], 1.2, 0.0, 2.0), NoRay::BehindMirror);
        // In front of the tank, within its wall, and on its inner face.
        assert_eq!(reason(vec![tank], 0.1, 0.0, 0.5), NoRay::BeforeLastSurface);
        assert_eq!(reason(vec![tank], 0.1, 0.0, 1.003), NoRay::BeforeLastSurface);
        assert_eq!(reason(vec![tank], 0.1, 0.0, 1.0), NoRay::BeforeLastSurface);
        // Via the mirror, a tank whose wall faces away from it cannot be reached.
        assert_eq!(reason(vec![side_mirror, tank], 0.5, 0.0, 0.5), NoRay::BeforeLastSurface);
        // NaN and infinity get an answer, and at once.
        for surfaces in [vec![], vec![side_mirror], vec![tank], vec![side_mirror, tank]] {
            assert_eq!(reason(surfaces.clone(), f64::NAN, 0.0, 2.0), NoRay::NotConverged);
            assert_eq!(reason(surfaces.clone(), 0.0, f64::INFINITY, 2.0), NoRay::NotConverged);
            assert_eq!(path(surfaces).trace(&Point2::new(f64::NAN, 0.0)), Err(NoRay::Lens));
        }
    }

    #[test]
    fn a_lens_that_folds_does_not_show_points_from_far_outside() {
        // x (1 - 0.3 x²) peaks at x = √(1/0.9) = 1.054. The direction x = 1.7 would be drawn at 1.7 · 0.133 = 0.226.
        let mut folded = path(vec![]);
        folded.lens.distortion = [-0.3, 0.0, 0.0, 0.0, 0.0];
        assert!(folded.project(&Point3::new(1.05, 0.0, 1.0)).is_ok());
        assert_eq!(folded.project(&Point3::new(1.06, 0.0, 1.0)), Err(NoRay::Lens));
        assert_eq!(folded.project(&Point3::new(1.7, 0.0, 1.0)), Err(NoRay::Lens));
    }
}
