//! The optical path: a lens and an ordered list of surfaces. `trace` folds a pixel's ray through the list, `project`
//! inverts it.
//!
//! A refracted view has no single centre, so there is no closed form for `project`: it searches the ray (`solve.rs`), two
//! to four steps to rounding.

use super::solve::{self, Connection};
use super::{Lens, Ray, RayWithJacobian, Surface};
use nalgebra::{Matrix2x3, Matrix3x2, Point2, Point3};

/// A lens and the surfaces a camera ray meets, in the order of travel.
///
/// # Assumptions
/// Surfaces are unbounded planes and met in the given order; what limits them in the picture is the view's region.
#[derive(Debug, Clone, PartialEq)]
pub struct OpticalPath {
    /// The camera's lens.
    pub lens: Lens,
    /// From the camera to the marker's medium.
    pub surfaces: Vec<Surface>,
}

/// Why no ray connects a pixel and a place.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum NoRay {
    /// The lens model folds over there: pixel and direction do not belong to each other one to one.
    #[error("outside the field where the lens model is one-to-one")]
    Lens,
    /// The ray runs parallel to a surface or away from it: the path does not lead this way.
    #[error("the ray does not meet a surface of the path")]
    MissesSurface,
    /// A mirror is met from behind, or the point lies behind the last one.
    #[error("behind the mirror")]
    BehindMirror,
    /// The angle is beyond the critical one.
    #[error("total reflection")]
    TotalReflection,
    /// The point lies in front of the last surface, where the path has not ended yet, or (mirrored back, where there are
    /// mirrors) behind the camera.
    #[error("the point is not in front of the camera and beyond the last surface of the path")]
    BeforeLastSurface,
    /// No ray was found, or the point is not a finite number.
    #[error("no ray found to this point")]
    NotConverged,
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
}

impl OpticalPath {
    /// The ray, in the medium of the marker, that a pixel sees along.
    ///
    /// # Errors
    /// [`NoRay`] when the ray is lost on its way.
    pub fn trace(&self, pixel: &Point2<f64>) -> Result<Ray, NoRay> {
        let normalised = self.lens.undistort(pixel).ok_or(NoRay::Lens)?;
        Ok(self.fold(&normalised)?.ray)
    }

    /// As [`OpticalPath::trace`], with derivatives.
    ///
    /// # Errors
    /// [`NoRay`] when the ray is lost on its way.
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
        let connection = self.connect(point)?;
        let (pixel, d_pixel) = self.lens.distort_with_jacobian(&connection.normalised);
        Ok(Projection { pixel, d_pixel: d_pixel * connection.d_point(), ray: connection.folded.ray })
    }

    /// Folds the ray of a normalised image point through all surfaces and refuses one that no light takes.
    fn fold(&self, normalised: &Point2<f64>) -> Result<RayWithJacobian, NoRay> {
        let folded = solve::fold(&self.surfaces, normalised)?;
        match folded.lost {
            Some(why) => Err(why),
            None => Ok(folded),
        }
    }

    /// The ray to a point, refused where the lens model does not hold.
    fn connect(&self, point: &Point3<f64>) -> Result<Connection, NoRay> {
        let connection = solve::connect(&self.surfaces, point)?;
        if self.lens.is_one_to_one(&connection.normalised) { Ok(connection) } else { Err(NoRay::Lens) }
    }
}
