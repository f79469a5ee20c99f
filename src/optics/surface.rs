//! Surfaces that a ray meets: a plane mirror, a flat glass wall, and what each does to the ray and its derivative.
//!
//! Reflection: d' = d − 2(n·d)n. Refraction (Snell in vector form), n against the ray, η = n₁/n₂, c = −n·d: d' = η d +
//! (η c − √(1 − η²(1 − c²))) n; no real root means total reflection. Source: Glassner (ed.), "An Introduction to Ray
//! Tracing" (1989), ch. 4; for the flat layers of a tank: Agrawal et al., "A theory of multi-layer flat refractive
//! geometry", CVPR 2012, doi:10.1109/CVPR.2012.6248073.

use crate::optics::{NoRay, Ray, RayWithJacobian};
use nalgebra::{Point3, SMatrix, Vector3};

/// A plane `normal·X = offset_m`, camera frame, metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Plane {
    normal: Vector3<f64>,
    offset_m: f64,
}

/// Why four numbers do not describe a plane.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum PlaneError {
    /// The normal is not of unit length.
    #[error("plane normal has length {0}, expected 1")]
    Length(f64),
    /// A number is NaN or infinite.
    #[error("plane has a number that is not finite: normal ({0}, {1}, {2}), offset {3}")]
    NotFinite(f64, f64, f64, f64),
}

/// How far unit vectors and rotations read from a file may be off: six printed decimals.
pub(crate) const UNIT_TOLERANCE: f64 = 2e-6;

/// How far behind its start a ray may meet a plane and still count as meeting it, metres: rounding.
const ON_PLANE_M: f64 = 1e-12;

impl Plane {
    /// A plane from a unit normal and its distance from the camera along that normal.
    ///
    /// # Errors
    /// When a number is not finite, or the normal differs from length 1 by more than rounding in a file explains.
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

    /// Moves the ray's origin to where its line meets the plane; meeting it backwards is recorded in `lost`.
    fn meet<const D: usize>(&self, r: &RayWithJacobian<D>) -> Result<RayWithJacobian<D>, NoRay> {
        let Ray { origin, direction } = r.ray;
        let along = self.normal.dot(&direction);
        let distance = -self.signed_distance(&origin) / along;
        if !distance.is_finite() {
            return Err(NoRay::MissesSurface); // parallel, or NaN
        }
        let n = self.normal.transpose();
        let d_distance: SMatrix<f64, 1, D> = -(n * r.d_origin + n * r.d_direction * distance) / along;
        Ok(RayWithJacobian {
            ray: Ray { origin: origin + direction * distance, direction },
            d_origin: r.d_origin + r.d_direction * distance + direction * d_distance,
            d_direction: r.d_direction,
            // A ray may start on the plane, to rounding (a pane of zero thickness).
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
    /// The ray after this surface. Where it meets the surface backwards, or a mirror's back, the line is continued
    /// nevertheless and `lost` says so: a search may pass through such rays on its way to a real one.
    ///
    /// # Errors
    /// [`NoRay`] when there is no line to continue: the ray is parallel to the surface, or totally reflected.
    pub(super) fn apply<const D: usize>(&self, ray: &RayWithJacobian<D>) -> Result<RayWithJacobian<D>, NoRay> {
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

    /// The image of a point without refraction: mirrored by a mirror, unchanged by a wall.
    pub(super) fn mirrored(&self, point: &Point3<f64>) -> Point3<f64> {
        match self {
            Self::Mirror(mirror) => mirror.plane.reflect(point),
            Self::Wall(_) => *point,
        }
    }

    /// The same surface with a fraction of its refraction: 0 none, 1 all.
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

fn reflect<const D: usize>(plane: &Plane, ray: &RayWithJacobian<D>) -> Result<RayWithJacobian<D>, NoRay> {
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
fn refract<const D: usize>(plane: &Plane, eta: f64, ray: &RayWithJacobian<D>) -> Result<RayWithJacobian<D>, NoRay> {
    let at = plane.meet(ray)?;
    let d = at.ray.direction;
    let n = if plane.normal().dot(&d) < 0.0 { plane.normal() } else { -plane.normal() };
    let cos_in = -n.dot(&d);
    let cos_out_squared = 1.0 - eta * eta * (1.0 - cos_in * cos_in);
    if cos_out_squared <= 0.0 {
        return Err(NoRay::TotalReflection);
    }
    let cos_out = cos_out_squared.sqrt();
    let d_cos_in: SMatrix<f64, 1, D> = -(n.transpose() * at.d_direction);
    let d_cos_out = d_cos_in * (eta * eta * cos_in / cos_out);
    Ok(RayWithJacobian {
        ray: Ray { direction: (d * eta + n * (eta * cos_in - cos_out)).normalize(), ..at.ray },
        d_direction: at.d_direction * eta + n * (d_cos_in * eta - d_cos_out),
        ..at
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Matrix3x2;

    fn plane(x: f64, y: f64, z: f64, offset_m: f64) -> Plane {
        Plane::new(Vector3::new(x, y, z), offset_m).unwrap()
    }

    /// A ray in the x-z plane at an angle to the z axis.
    fn ray(origin: Point3<f64>, angle_deg: f64) -> RayWithJacobian {
        let (sin, cos) = angle_deg.to_radians().sin_cos();
        RayWithJacobian {
            ray: Ray { origin, direction: Vector3::new(sin, 0.0, cos) },
            d_origin: Matrix3x2::zeros(),
            d_direction: Matrix3x2::zeros(),
            lost: None,
        }
    }

    /// A wall met along z at z = 1 m, its outside facing the camera.
    fn wall(thickness_m: f64, index_outside: f64, index_wall: f64, index_inside: f64) -> Surface {
        Surface::Wall(Wall { outer: plane(0.0, 0.0, -1.0, -1.0), thickness_m, index_outside, index_wall, index_inside })
    }

    #[test]
    fn planes_are_checked_and_say_what_is_wrong() {
        let length = Plane::new(Vector3::new(0.0, 0.6, 0.7), 1.0).unwrap_err();
        assert!(length.to_string().contains("0.92195"), "{length}"); // √(0.36 + 0.49) = 0.921954
        assert!(matches!(Plane::new(Vector3::new(0.0, f64::NAN, 1.0), 1.0), Err(PlaneError::NotFinite(..))));
        assert!(matches!(Plane::new(Vector3::z(), f64::INFINITY), Err(PlaneError::NotFinite(..))));
        // Six printed decimals of (1, 1, 1)/√3 are accepted and brought to unit length.
        let read = plane(0.577350, 0.577350, 0.577350, 0.0);
        assert!((read.normal().norm() - 1.0).abs() < 1e-15);
    }

    #[test]
    fn a_point_is_mirrored_in_a_plane() {
        // In x = 0.5, the point (1, 2, 3) lies 0.5 in front; its image lies as far behind.
        let mirror = plane(1.0, 0.0, 0.0, 0.5);
        assert_eq!(mirror.signed_distance(&Point3::new(1.0, 2.0, 3.0)), 0.5);
        assert_eq!(mirror.reflect(&Point3::new(1.0, 2.0, 3.0)), Point3::new(0.0, 2.0, 3.0));
        // In x + z = √2·d tilted by 45°, d = 1/√2: (x, y, z) becomes (1 - z, y, 1 - x).
        let s = std::f64::consts::FRAC_1_SQRT_2;
        let image = plane(s, 0.0, s, s).reflect(&Point3::new(0.2, 0.7, -0.3));
        assert!((image - Point3::new(1.3, 0.7, 0.8)).norm() < 1e-15);
    }

    #[test]
    fn a_mirror_turns_a_ray() {
        // (0.6, 0, 0.8) from the origin meets z = 2 after 2.5 m at x = 1.5 and returns as (0.6, 0, -0.8).
        let mirror = Surface::Mirror(Mirror { plane: plane(0.0, 0.0, -1.0, -2.0) });
        let out = mirror.apply(&ray(Point3::origin(), 0.6_f64.asin().to_degrees())).unwrap();
        assert!((out.ray.origin - Point3::new(1.5, 0.0, 2.0)).norm() < 1e-15);
        assert!((out.ray.direction - Vector3::new(0.6, 0.0, -0.8)).norm() < 1e-15);
        assert_eq!(out.lost, None);
    }

    #[test]
    fn snell_at_45_degrees_from_air_through_glass_into_water() {
        // sin 45° / 1.52 = 0.465202, cos = 0.885205: 27.7233° in the glass, 5 mm · tan = 2.627651 mm aside.
        // sin 45° / 1.333 = 0.530463, cos = 0.847708: 32.0367° in the water, whatever the glass.
        let out = wall(0.005, 1.0, 1.52, 1.333).apply(&ray(Point3::origin(), 45.0)).unwrap();
        assert!((out.ray.origin - Point3::new(1.002627651, 0.0, 1.005)).norm() < 1e-9);
        assert!((out.ray.direction - Vector3::new(0.530463, 0.0, 0.847708)).norm() < 1e-6);
        assert!((out.ray.direction.x.asin().to_degrees() - 32.0367).abs() < 1e-4);
    }

    #[test]
    fn a_ray_along_the_normal_goes_straight_on() {
        let out = wall(0.005, 1.0, 1.52, 1.333).apply(&ray(Point3::new(0.2, -0.1, 0.0), 0.0)).unwrap();
        assert_eq!(out.ray.direction, Vector3::z());
        assert!((out.ray.origin - Point3::new(0.2, -0.1, 1.005)).norm() < 1e-15);
    }

    #[test]
    fn a_pane_in_air_shifts_a_ray_sideways() {
        // t sin i (1 - cos i / (n cos r)) for t = 10 mm, i = 60°, n = 1.5: sin² r = (3/4)/(9/4) = 1/3, cos r =
        // 0.816497; 8.660254 mm · (1 - 0.5/1.224745) = 5.124720 mm.
        let before = ray(Point3::origin(), 60.0);
        let after = wall(0.010, 1.0, 1.5, 1.0).apply(&before).unwrap().ray;
        assert!((after.direction - before.ray.direction).norm() < 1e-15);
        let aside = (Point3::origin() - after.at(after.nearest(&Point3::origin()))).norm();
        assert!((aside - 5.124720e-3).abs() < 1e-9, "{aside}");
    }

    #[test]
    fn a_wall_met_from_inside_undoes_it_met_from_outside() {
        // The reverse, through the wall of the test above: from 32.0367° in the water to 45° in the air.
        let Surface::Wall(outside) = wall(0.005, 1.0, 1.52, 1.333) else { unreachable!() };
        let turned = Surface::Wall(Wall { outer: plane(0.0, 0.0, 1.0, 1.0), ..outside });
        let angle_deg = (0.5_f64.sqrt() / 1.333).asin().to_degrees();
        let out = turned.apply(&ray(Point3::origin(), angle_deg)).unwrap();
        let (sin, cos) = 45_f64.to_radians().sin_cos();
        assert!((out.ray.direction - Vector3::new(sin, 0.0, cos)).norm() < 1e-12);
        // It meets the inner face at z = 0.995 and leaves at z = 1: 0.995 · tan 32.0367° + 0.005 · tan 27.7233° =
        // 0.995 · 0.625761 + 0.005 · 0.525530 = 0.625260.
        assert!((out.ray.origin - Point3::new(0.625260, 0.0, 1.0)).norm() < 1e-6, "{}", out.ray.origin);
    }

    #[test]
    fn beyond_the_critical_angle_nothing_leaves_the_water() {
        // asin(1 / 1.333) = 48.6066°, with or without glass in between.
        for index_wall in [1.333, 1.52] {
            let Surface::Wall(pane) = wall(0.005, 1.0, index_wall, 1.333) else { unreachable!() };
            let surface = Surface::Wall(Wall { outer: plane(0.0, 0.0, 1.0, 1.0), ..pane });
            let out = surface.apply(&ray(Point3::origin(), 48.606)).unwrap();
            assert!(out.ray.direction.x > 0.9999, "almost along the wall");
            assert_eq!(surface.apply(&ray(Point3::origin(), 48.607)).unwrap_err(), NoRay::TotalReflection);
        }
    }

    #[test]
    fn lines_that_no_light_takes_are_marked() {
        let mirror = |z: f64| Surface::Mirror(Mirror { plane: plane(0.0, 0.0, z, z) });
        let lost = |surface: Surface, ray: &RayWithJacobian| surface.apply(ray).unwrap().lost;
        // From behind; a mirror that lies behind the start; a wall that does.
        assert_eq!(lost(mirror(1.0), &ray(Point3::origin(), 10.0)), Some(NoRay::BehindMirror));
        assert_eq!(lost(mirror(-1.0), &ray(Point3::new(0.0, 0.0, 1.1), 10.0)), Some(NoRay::MissesSurface));
        let glass = wall(0.005, 1.0, 1.52, 1.333);
        assert_eq!(lost(glass, &ray(Point3::new(0.0, 0.0, 1.1), 10.0)), Some(NoRay::MissesSurface));
        // On the wall to rounding, and a pane of zero thickness: met.
        assert_eq!(lost(glass, &ray(Point3::new(0.0, 0.0, 1.0 + 1e-15), 10.0)), None);
        assert_eq!(lost(wall(0.0, 1.0, 1.52, 1.333), &ray(Point3::origin(), 10.0)), None);
        // Parallel: there is no line to go on with.
        let aside = Surface::Mirror(Mirror { plane: plane(1.0, 0.0, 0.0, -1.0) });
        assert_eq!(aside.apply(&ray(Point3::origin(), 0.0)).unwrap_err(), NoRay::MissesSurface);
    }
}
