//! Where a point is seen, and where a pixel looks: the lens, the surfaces, and the path through them.
//!
//! - [`Lens`]: pinhole and Brown-Conrady distortion, pixel <-> direction.
//! - [`Surface`]: a plane mirror or a flat glass wall, and what it does to a ray.
//! - [`OpticalPath`]: lens and an ordered list of surfaces; [`OpticalPath::trace`] and its inverse
//!   [`OpticalPath::project`], both with Jacobians. Everything else in the project builds on these two.
//! - [`triangulate()`]: a point from its images in two or more views.
//!
//! # Conventions
//! Everything is in the `camera` frame (OpenCV: x right, y down, z forward), metres. Pixel (0, 0) is the centre of the
//! top-left pixel. A plane is `n·X = d`.

mod lens;
mod no_ray;
mod path;
mod solve;
mod surface;
mod triangulate;

pub(crate) use lens::corners;
pub use lens::{Lens, LensError};
pub use no_ray::NoRay;
pub use path::{OpticalPath, Projection, Tracing};
pub(crate) use surface::UNIT_TOLERANCE;
pub use surface::{Mirror, Plane, PlaneError, Surface, Wall};
pub use triangulate::{Sighting, Triangulated, triangulate};

use nalgebra::{Point3, SMatrix, Vector3};

/// A half-line in the camera frame: `origin + s·direction`, s ≥ 0, metres; `direction` has unit length.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ray {
    /// Where the ray leaves the last surface (the camera's centre if there is none), metres.
    pub origin: Point3<f64>,
    /// Unit direction of travel, away from the camera.
    pub direction: Vector3<f64>,
}

impl Ray {
    /// The point `distance_m` along the ray.
    pub fn at(&self, distance_m: f64) -> Point3<f64> {
        self.origin + self.direction * distance_m
    }

    /// Distance along the ray of the point nearest to `point`, metres (negative: behind the origin).
    pub fn nearest(&self, point: &Point3<f64>) -> f64 {
        (point - self.origin).dot(&self.direction)
    }
}

/// A ray partway through a path, with its derivative with respect to the normalised image point it started from; with
/// `D` = 0 without it, which is several times faster.
#[derive(Debug, Clone, Copy)]
struct RayWithJacobian<const D: usize = 2> {
    ray: Ray,
    d_origin: SMatrix<f64, 3, D>,
    d_direction: SMatrix<f64, 3, D>,
    /// Why no light takes this line, if it was continued nevertheless.
    lost: Option<NoRay>,
}
