//! The optical path: a lens and an ordered list of surfaces. `trace` folds a pixel's ray through the list, `project`
//! inverts it.
//!
//! `project` looks for the normalised image point whose traced ray passes through the given point: Newton on the two
//! components of the miss across the ray, started from the mirrored pinhole. A refracted view has no single centre, so
//! there is no closed form; two to four steps reach rounding. The derivative follows from the implicit function.

use super::{Lens, Ray, RayWithJacobian, Surface};
use nalgebra::{Matrix2, Matrix2x3, Matrix3x2, Point2, Point3, Vector3};

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
    /// The lens model folds over there.
    #[error("the lens model gives this pixel no direction")]
    Lens,
    /// The ray runs parallel to a surface or away from it.
    #[error("the ray does not meet a surface of the path")]
    MissesSurface,
    /// The mirror is met from behind, or the point lies behind it.
    #[error("behind the mirror")]
    BehindMirror,
    /// The angle is beyond the critical one.
    #[error("total reflection")]
    TotalReflection,
    /// The point lies in front of the last surface, where the path has not ended yet, or behind the camera.
    #[error("the point is not beyond the last surface of the path")]
    BeforeLastSurface,
    /// Newton did not converge.
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

/// Newton steps after which a point is given up.
const MAX_STEPS: usize = 25;

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
        Ok(self.lens.distort(&self.solve(point)?.0))
    }

    /// As [`OpticalPath::project`], with derivatives and the connecting ray.
    ///
    /// # Errors
    /// [`NoRay`] where no ray of this path arrives.
    pub fn project_with_jacobian(&self, point: &Point3<f64>) -> Result<Projection, NoRay> {
        let (normalised, folded, miss) = self.solve(point)?;
        let (pixel, d_pixel) = self.lens.distort_with_jacobian(&normalised);
        let d_normalised = -miss.d_parameters.try_inverse().ok_or(NoRay::NotConverged)? * miss.across.transpose();
        Ok(Projection { pixel, d_pixel: d_pixel * d_normalised, ray: folded.ray })
    }

    /// Folds the ray of a normalised image point through all surfaces; derivatives are with respect to that point.
    fn fold(&self, normalised: &Point2<f64>) -> Result<RayWithJacobian, NoRay> {
        let v = Vector3::new(normalised.x, normalised.y, 1.0);
        let length = v.norm();
        let direction = v / length;
        let d_v = Matrix3x2::new(1.0, 0.0, 0.0, 1.0, 0.0, 0.0);
        let mut ray = RayWithJacobian {
            ray: Ray { origin: Point3::origin(), direction },
            d_origin: Matrix3x2::zeros(),
            d_direction: (d_v - direction * (direction.transpose() * d_v)) / length,
        };
        for surface in &self.surfaces {
            ray = surface.apply(&ray)?;
        }
        Ok(ray)
    }

    /// The point as it would appear without refraction: mirrored through all mirrors, last one first.
    fn unfold(&self, point: &Point3<f64>) -> Point3<f64> {
        self.surfaces.iter().rev().fold(*point, |p, surface| match surface {
            Surface::Mirror(mirror) => mirror.plane.reflect(&p),
            Surface::Wall(_) => p,
        })
    }

    fn solve(&self, point: &Point3<f64>) -> Result<(Point2<f64>, RayWithJacobian, Miss), NoRay> {
        if let Some(Surface::Mirror(mirror)) = self.surfaces.last()
            && mirror.plane.signed_distance(point) <= 0.0
        {
            return Err(NoRay::BehindMirror);
        }
        let virtual_point = self.unfold(point);
        if virtual_point.z <= 0.0 {
            return Err(NoRay::BeforeLastSurface);
        }
        let mut at = Point2::new(virtual_point.x / virtual_point.z, virtual_point.y / virtual_point.z);
        let mut folded = self.fold(&at)?;
        let mut miss = Miss::of(&folded, point);
        for _ in 0..MAX_STEPS {
            let step = miss.d_parameters.try_inverse().ok_or(NoRay::NotConverged)? * miss.value;
            // Halve a step that leaves the field where rays arrive, or that does not come nearer.
            let mut fraction = 1.0;
            let (next, next_folded, next_miss) = loop {
                let next = at - step * fraction;
                let tried = self.fold(&next).map(|f| (f, Miss::of(&f, point)));
                match tried {
                    Ok((f, m)) if m.value.norm() < miss.value.norm() => break (next, f, m),
                    _ if step.norm() * fraction < 1e-15 => {
                        // No step brings it nearer: either rounding is reached, or there is no ray.
                        return miss.converged(point, at, folded);
                    }
                    _ => fraction *= 0.5,
                }
            };
            let moved = (next - at).norm();
            (at, folded, miss) = (next, next_folded, next_miss);
            if moved < 1e-15 {
                break;
            }
        }
        miss.converged(point, at, folded)
    }
}

/// By how much a ray misses a point: two components across the ray.
struct Miss {
    value: nalgebra::Vector2<f64>,
    /// d value / d normalised image point.
    d_parameters: Matrix2<f64>,
    /// The two unit vectors across the ray, as columns; d value / d point is its transpose.
    across: Matrix3x2<f64>,
}

impl Miss {
    fn of(r: &RayWithJacobian, point: &Point3<f64>) -> Self {
        let d = r.ray.direction;
        let helper = if d.x.abs() < 0.6 { Vector3::x() } else { Vector3::y() };
        let e1 = d.cross(&helper).normalize();
        let e2 = d.cross(&e1);
        let across = Matrix3x2::from_columns(&[e1, e2]);
        let to_point = point - r.ray.origin;
        let along = to_point.dot(&d);
        // The frame across the ray turns with it; at a miss of zero its turning does not matter, and near it hardly.
        Self {
            value: across.transpose() * to_point,
            d_parameters: -(across.transpose() * (r.d_origin + r.d_direction * along)),
            across,
        }
    }

    fn converged(
        self,
        point: &Point3<f64>,
        at: Point2<f64>,
        folded: RayWithJacobian,
    ) -> Result<(Point2<f64>, RayWithJacobian, Self), NoRay> {
        let along = folded.ray.nearest(point);
        // 1e-12 of the distance is far below 1e-9 px at any usable focal length.
        if self.value.norm() > 1e-12 * (point.coords.norm() + folded.ray.origin.coords.norm()).max(1e-3) {
            return Err(NoRay::NotConverged);
        }
        if along <= 0.0 {
            return Err(NoRay::BeforeLastSurface);
        }
        Ok((at, folded, self))
    }
}
