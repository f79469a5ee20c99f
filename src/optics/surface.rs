//! Surfaces that a ray meets: a plane mirror, a flat glass wall, and what each does to the ray and its derivative.
//!
//! Reflection: d' = d − 2(n·d)n. Refraction (Snell in vector form), n against the ray, η = n₁/n₂, c = −n·d:
//! d' = η d + (η c − √(1 − η²(1 − c²))) n; no real root means total reflection.
//! Source: Glassner (ed.), "An Introduction to Ray Tracing" (1989), ch. 2; for the flat layers of a tank: Agrawal et al.,
//! "A theory of multi-layer flat refractive geometry", CVPR 2012, doi:10.1109/CVPR.2012.6248073.

use super::path::NoRay;
use super::{Ray, RayWithJacobian};
use nalgebra::{Point3, RowVector2, Vector3};

/// A plane `normal·X = offset_m`, camera frame, metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Plane {
    normal: Vector3<f64>,
    offset_m: f64,
}

/// Why four numbers are not a plane.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum PlaneError {
    /// The normal is not of unit length.
    #[error("plane normal has length {0}, expected 1")]
    Length(f64),
    /// A number is NaN or infinite.
    #[error("plane has a number that is not finite: normal ({0}, {1}, {2}), offset {3}")]
    NotFinite(f64, f64, f64, f64),
}

/// How far a normal read from a file may be from unit length: six printed decimals.
const UNIT_TOLERANCE: f64 = 2e-6;

/// How far behind the start of a ray a plane may be met and still count as met, metres: rounding.
const ON_PLANE_M: f64 = 1e-12;

impl Plane {
    /// A plane from a unit normal and its distance from the camera along that normal.
    ///
    /// # Errors
    /// When a number is not finite, or the normal is longer or shorter than 1 by more than rounding in a file explains.
    pub fn new(normal: Vector3<f64>, offset_m: f64) -> Result<Self, PlaneError> {
        let length = normal.norm();
        if !length.is_finite() || !offset_m.is_finite() {
            return Err(PlaneError::NotFinite(normal.x, normal.y, normal.z, offset_m));
        }
        if (length - 1.0).abs() > UNIT_TOLERANCE {
            return Err(PlaneError::Length(length));
        }
        Ok(Self { normal: normal / length, offset_m })
    }

    /// Unit normal.
    pub fn normal(&self) -> Vector3<f64> {
        self.normal
    }

    /// d in n·X = d, metres.
    pub fn offset_m(&self) -> f64 {
        self.offset_m
    }

    /// Signed distance of a point, positive on the side the normal points to, metres.
    pub fn signed_distance(&self, point: &Point3<f64>) -> f64 {
        self.normal.dot(&point.coords) - self.offset_m
    }

    /// The mirror image of a point.
    pub fn reflect(&self, point: &Point3<f64>) -> Point3<f64> {
        point - self.normal * (2.0 * self.signed_distance(point))
    }

    /// The same plane moved by `distance_m` along its normal.
    pub fn moved(&self, distance_m: f64) -> Self {
        Self { normal: self.normal, offset_m: self.offset_m + distance_m }
    }

    /// Moves the ray's origin to where its line meets the plane; a plane met backwards is recorded in `lost`.
    fn meet(&self, r: &RayWithJacobian) -> Result<RayWithJacobian, NoRay> {
        let Ray { origin, direction } = r.ray;
        let along = self.normal.dot(&direction);
        let distance = -self.signed_distance(&origin) / along;
        if !distance.is_finite() {
            return Err(NoRay::MissesSurface); // parallel, or a number that is none
        }
        let n = self.normal.transpose();
        let d_distance: RowVector2<f64> = -(n * r.d_origin + n * r.d_direction * distance) / along;
        Ok(RayWithJacobian {
            ray: Ray { origin: origin + direction * distance, direction },
            d_origin: r.d_origin + r.d_direction * distance + direction * d_distance,
            d_direction: r.d_direction,
            // A ray may start on the plane to rounding (a pane of no thickness).
            lost: r.lost.or((distance < -ON_PLANE_M).then_some(NoRay::MissesSurface)),
        })
    }
}

/// A plane front-surface mirror; its normal points to the side it reflects on.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Mirror {
    /// The reflecting plane.
    pub plane: Plane,
}

/// A flat pane between two media: two parallel refracting interfaces.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Wall {
    /// Outer face; the normal points outwards, to the side of `index_outside`.
    pub outer: Plane,
    /// Thickness of the pane, metres; the inner face lies at −thickness along the normal.
    pub thickness_m: f64,
    /// Refractive index outside (air: 1).
    pub index_outside: f64,
    /// Refractive index of the pane (glass: 1.52, acrylic: 1.49).
    pub index_wall: f64,
    /// Refractive index inside (water: 1.333).
    pub index_inside: f64,
}

impl Wall {
    /// The inner face, its normal outwards too.
    pub fn inner(&self) -> Plane {
        self.outer.moved(-self.thickness_m)
    }
}

/// One element of an optical path.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Surface {
    /// Reflects.
    Mirror(Mirror),
    /// Refracts, twice.
    Wall(Wall),
}

impl Surface {
    /// The ray after this surface. Where it meets the surface backwards, or a mirror's back, the line is continued all
    /// the same and `lost` says so: a search may pass through such rays on its way to a real one.
    ///
    /// # Errors
    /// [`NoRay`] when there is no line to continue: the ray is parallel to the surface, or totally reflected.
    pub(super) fn apply(&self, ray: &RayWithJacobian) -> Result<RayWithJacobian, NoRay> {
        match self {
            Self::Mirror(mirror) => reflect(&mirror.plane, ray),
            Self::Wall(wall) => {
                let inward = wall.outer.normal().dot(&ray.ray.direction) < 0.0;
                let (first, second) = if inward {
                    ((wall.outer, wall.index_outside), (wall.inner(), wall.index_inside))
                } else {
                    ((wall.inner(), wall.index_inside), (wall.outer, wall.index_outside))
                };
                let in_wall = refract(&first.0, first.1 / wall.index_wall, ray)?;
                refract(&second.0, wall.index_wall / second.1, &in_wall)
            }
        }
    }

    /// What it makes of a point without refraction: a mirror's image, through a wall the point itself.
    pub(super) fn mirrored(&self, point: &Point3<f64>) -> Point3<f64> {
        match self {
            Self::Mirror(mirror) => mirror.plane.reflect(point),
            Self::Wall(_) => *point,
        }
    }

    /// The same surface with only a part of its refraction: 0 none, 1 all.
    pub(super) fn with_refraction(&self, part: f64) -> Self {
        match self {
            Self::Mirror(_) => *self,
            Self::Wall(wall) => {
                let eased = |index: f64| wall.index_outside + (index - wall.index_outside) * part;
                let (index_wall, index_inside) = (eased(wall.index_wall), eased(wall.index_inside));
                Self::Wall(Wall { index_wall, index_inside, ..*wall })
            }
        }
    }

    /// The plane that defines it: a mirror's reflecting face, a wall's outer face.
    pub fn plane(&self) -> Plane {
        match self {
            Self::Mirror(mirror) => mirror.plane,
            Self::Wall(wall) => wall.outer,
        }
    }
}

fn reflect(plane: &Plane, ray: &RayWithJacobian) -> Result<RayWithJacobian, NoRay> {
    let at = plane.meet(ray)?;
    let n = plane.normal();
    let d = at.ray.direction;
    let along = n.dot(&d);
    Ok(RayWithJacobian {
        ray: Ray { direction: d - n * (2.0 * along), ..at.ray },
        d_direction: at.d_direction - n * (n.transpose() * at.d_direction) * 2.0,
        lost: at.lost.or((along > 0.0).then_some(NoRay::BehindMirror)),
        ..at
    })
}

/// Refraction at one interface; `eta` = index before / index behind. The normal may point either way.
fn refract(plane: &Plane, eta: f64, ray: &RayWithJacobian) -> Result<RayWithJacobian, NoRay> {
    let at = plane.meet(ray)?;
    let d = at.ray.direction;
    let n = if plane.normal().dot(&d) < 0.0 { plane.normal() } else { -plane.normal() };
    let cos_in = -n.dot(&d);
    let cos_out_squared = 1.0 - eta * eta * (1.0 - cos_in * cos_in);
    if cos_out_squared <= 0.0 {
        return Err(NoRay::TotalReflection);
    }
    let cos_out = cos_out_squared.sqrt();
    let d_cos_in: RowVector2<f64> = -(n.transpose() * at.d_direction);
    let d_cos_out = d_cos_in * (eta * eta * cos_in / cos_out);
    Ok(RayWithJacobian {
        ray: Ray { direction: (d * eta + n * (eta * cos_in - cos_out)).normalize(), ..at.ray },
        d_direction: at.d_direction * eta + n * (d_cos_in * eta - d_cos_out),
        ..at
    })
}
