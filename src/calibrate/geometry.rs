//! [`Geometry`]: what all pictures of a rig share, lens, mirrors and walls, as parameters of a least squares problem.
//!
//! In: a geometry, a point, a view. Out: the pixel and its derivatives with respect to the point and to every
//! [`Parameter`].
//!
//! Derivatives with respect to the lens are analytic. Those with respect to surfaces follow from the ray: when a
//! parameter moves the ray of a fixed pixel by δ where it passes the point, the pixel of the fixed point moves by
//! −(∂pixel/∂point) δ (the implicit function theorem); δ is a central difference of two traced rays, so no search is
//! needed.

use crate::optics::{Lens, NoRay, OpticalPath, Plane, Surface, Wall};
use crate::rig::View;
use nalgebra::{Matrix2x3, Point2, Point3, SMatrix, SVector, Unit, UnitQuaternion, Vector2, Vector3};
use std::collections::BTreeMap;

/// Half a step of a central difference: radians, metres, index. Truncation and rounding errors are both below 1e-9 of a
/// derivative.
const STEP: f64 = 1e-5;

/// Lens, surfaces and views.
#[derive(Debug, Clone, PartialEq)]
pub struct Geometry {
    /// The lens.
    pub lens: Lens,
    /// The surfaces, with their names.
    pub surfaces: Vec<(String, Surface)>,
    /// The views: name, and indices of the surfaces that a camera ray meets.
    pub views: Vec<(String, Vec<usize>)>,
}

impl Geometry {
    /// That of a rig; `None` when a view's path names a surface that it does not have.
    pub(crate) fn of(lens: Lens, surfaces: &BTreeMap<String, Surface>, views: &[View]) -> Option<Self> {
        let index = |name: &String| surfaces.keys().position(|own| own == name);
        let view = |view: &View| {
            let path = view.path.iter().map(index).collect::<Option<Vec<_>>>()?;
            Some((view.name.clone(), path))
        };
        let views = views.iter().map(view).collect::<Option<Vec<_>>>()?;
        Some(Self { lens, surfaces: surfaces.iter().map(|(name, s)| (name.clone(), *s)).collect(), views })
    }
}

/// The box of some points: its lowest and its highest corner; infinite the wrong way round without any.
pub(crate) fn bounds<const D: usize>(points: impl IntoIterator<Item = SVector<f64, D>>) -> [SVector<f64, D>; 2] {
    let none = [SVector::repeat(f64::INFINITY), SVector::repeat(f64::NEG_INFINITY)];
    points.into_iter().fold(none, |[low, high], point| [low.inf(&point), high.sup(&point)])
}

/// One number that a calibration may change.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Parameter {
    /// Focal length along x (0) or y (1), pixels.
    Focal(usize),
    /// Principal point, x (0) or y (1), pixels.
    Principal(usize),
    /// k1, k2, p1, p2, k3.
    Distortion(usize),
    /// k4, k5, k6, of a rational lens.
    Denominator(usize),
    /// Rotation of a surface's normal about one of two axes across it, radians, see [`tilt_axes`].
    Tilt {
        /// Index of the surface.
        surface: usize,
        /// Which axis, 0 or 1.
        axis: usize,
    },
    /// Distance of a surface from the camera along its normal, metres.
    Offset {
        /// Index of the surface.
        surface: usize,
    },
    /// Refractive index inside all walls (the same water).
    IndexInside,
}

impl Parameter {
    /// All parameters of a rational lens, in the order fx, fy, cx, cy, k1, k2, p1, p2, k3, k4, k5, k6.
    pub const LENS: [Self; 12] = [
        Self::Focal(0),
        Self::Focal(1),
        Self::Principal(0),
        Self::Principal(1),
        Self::Distortion(0),
        Self::Distortion(1),
        Self::Distortion(2),
        Self::Distortion(3),
        Self::Distortion(4),
        Self::Denominator(0),
        Self::Denominator(1),
        Self::Denominator(2),
    ];

    /// Those of [`Parameter::LENS`] that this lens has: nine, or twelve where it is rational.
    pub fn of_lens(lens: &Lens) -> &'static [Self] {
        let [five @ .., _, _, _] = &Self::LENS;
        if lens.is_rational() { &Self::LENS } else { five }
    }

    /// The three of a surface.
    pub fn of_surface(surface: usize) -> [Self; 3] {
        [Self::Tilt { surface, axis: 0 }, Self::Tilt { surface, axis: 1 }, Self::Offset { surface }]
    }

    /// Its name in a rig file, with the names of surfaces from `surface`; units are SI, pixels for the lens.
    pub fn name<'a>(self, surface: impl Fn(usize) -> &'a str) -> String {
        let of = |names: &[&str], i: usize| names.get(i).copied().unwrap_or_default().to_owned();
        match self {
            Self::Focal(axis) => of(&["focal_x_px", "focal_y_px"], axis),
            Self::Principal(axis) => of(&["principal_point_x_px", "principal_point_y_px"], axis),
            Self::Distortion(i) => of(&["k1", "k2", "p1", "p2", "k3"], i),
            Self::Denominator(i) => of(&["k4", "k5", "k6"], i),
            Self::Tilt { surface: index, axis } => format!("{}_tilt_{axis}_rad", surface(index)),
            Self::Offset { surface: index } => format!("{}_offset_m", surface(index)),
            Self::IndexInside => "index_inside".to_owned(),
        }
    }

    /// The parameter with this name, with the indices of surfaces from `surface`.
    pub fn from_name(name: &str, surface: impl Fn(&str) -> Option<usize>) -> Option<Self> {
        if let Some(of_lens) = Self::LENS.into_iter().find(|parameter| parameter.name(|_| "") == name) {
            return Some(of_lens);
        }
        if let Some(own) = name.strip_suffix("_offset_m") {
            return Some(Self::Offset { surface: surface(own)? });
        }
        for axis in 0..2 {
            if let Some(own) = name.strip_suffix(&format!("_tilt_{axis}_rad")) {
                return Some(Self::Tilt { surface: surface(own)?, axis });
            }
        }
        (name == "index_inside").then_some(Self::IndexInside)
    }

    fn is_of_lens(self) -> bool {
        matches!(self, Self::Focal(_) | Self::Principal(_) | Self::Distortion(_) | Self::Denominator(_))
    }
}

/// Two unit vectors across a normal, about which [`Parameter::Tilt`] turns it. As close as possible to the camera's x
/// and y, so that the numbers have a meaning: axis 0 turns the surface up or down, axis 1 left or right.
pub fn tilt_axes(normal: &Vector3<f64>) -> [Vector3<f64>; 2] {
    let down = if normal.y.abs() < 0.9 { Vector3::y() } else { Vector3::z() };
    let vertical = (down - normal * normal.dot(&down)).normalize();
    [vertical.cross(normal), vertical]
}

/// A point as seen in a view.
#[derive(Debug, Clone)]
pub struct Seen {
    /// Where.
    pub pixel: Point2<f64>,
    /// d pixel / d point, pixels per metre.
    pub d_point: Matrix2x3<f64>,
    /// d pixel / d parameter, in the order of the parameters that [`Projector`] was made with.
    pub d_parameters: Vec<Vector2<f64>>,
}

impl Geometry {
    /// The path of a view.
    pub fn path(&self, view: usize) -> OpticalPath {
        let surfaces = self.views[view].1.iter().map(|&s| self.surfaces[s].1).collect();
        OpticalPath { lens: self.lens, surfaces }
    }

    /// The value of a parameter; 0 for a tilt, because tilts are relative to the current surface.
    pub fn value(&self, parameter: Parameter) -> f64 {
        match parameter {
            Parameter::Focal(axis) => self.lens.focal_px[axis],
            Parameter::Principal(axis) => self.lens.principal_point_px[axis],
            Parameter::Distortion(i) => self.lens.distortion[i],
            Parameter::Denominator(i) => self.lens.denominator[i],
            Parameter::Tilt { .. } => 0.0,
            Parameter::Offset { surface } => self.surfaces[surface].1.plane().offset_m(),
            Parameter::IndexInside => self.walls().next().map_or(1.0, |wall| wall.index_inside),
        }
    }

    fn walls(&self) -> impl Iterator<Item = &Wall> {
        self.surfaces.iter().filter_map(|(_, surface)| match surface {
            Surface::Wall(wall) => Some(wall),
            Surface::Mirror(_) => None,
        })
    }

    /// The geometry with one parameter changed by `step`.
    pub fn moved(&self, parameter: Parameter, step: f64) -> Self {
        let mut moved = self.clone();
        match parameter {
            Parameter::Focal(axis) => moved.lens.focal_px[axis] += step,
            Parameter::Principal(axis) => moved.lens.principal_point_px[axis] += step,
            Parameter::Distortion(i) => moved.lens.distortion[i] += step,
            Parameter::Denominator(i) => moved.lens.denominator[i] += step,
            Parameter::Tilt { surface, axis } => {
                let surface = &mut moved.surfaces[surface].1;
                let plane = surface.plane();
                let about = Unit::new_normalize(tilt_axes(&plane.normal())[axis]);
                let normal = UnitQuaternion::from_axis_angle(&about, step) * plane.normal();
                set_plane(surface, normal, plane.offset_m());
            }
            Parameter::Offset { surface } => {
                let surface = &mut moved.surfaces[surface].1;
                let plane = surface.plane();
                set_plane(surface, plane.normal(), plane.offset_m() + step);
            }
            Parameter::IndexInside => {
                for (_, surface) in &mut moved.surfaces {
                    if let Surface::Wall(wall) = surface {
                        wall.index_inside += step;
                    }
                }
            }
        }
        moved
    }

    /// The geometry with all parameters changed; both tilts of a surface are relative to its current position.
    pub fn stepped(&self, parameters: &[Parameter], steps: &[f64]) -> Self {
        let mut moved = self.clone();
        for (surface, (_, own)) in moved.surfaces.iter_mut().enumerate() {
            let [a, b] = tilt_axes(&own.plane().normal());
            let turn = |axis: usize| {
                let tilt = Parameter::Tilt { surface, axis };
                parameters.iter().zip(steps).filter(|(p, _)| **p == tilt).map(|(_, step)| step).sum::<f64>()
            };
            let normal = UnitQuaternion::from_scaled_axis(a * turn(0) + b * turn(1)) * own.plane().normal();
            let offset_m = own.plane().offset_m();
            set_plane(own, normal, offset_m);
        }
        let others = parameters.iter().zip(steps).filter(|(p, _)| !matches!(p, Parameter::Tilt { .. }));
        others.fold(moved, |geometry, (parameter, step)| geometry.moved(*parameter, *step))
    }
}

/// Moves a surface; numbers that are not a plane leave it unchanged, and the search that made them has failed.
fn set_plane(surface: &mut Surface, normal: Vector3<f64>, offset_m: f64) {
    let Ok(plane) = Plane::new(normal.normalize(), offset_m) else { return };
    match surface {
        Surface::Mirror(mirror) => mirror.plane = plane,
        Surface::Wall(wall) => wall.outer = plane,
    }
}

/// Projects points and differentiates the pixels with respect to a list of parameters.
#[derive(Debug, Clone)]
pub struct Projector {
    parameters: Vec<Parameter>,
    views: Vec<ViewProjector>,
}

#[derive(Debug, Clone)]
struct ViewProjector {
    path: OpticalPath,
    /// For each parameter other than the lens's that moves the view's rays: its index, and the path on either side.
    moved: Vec<(usize, OpticalPath, OpticalPath)>,
}

impl Projector {
    /// The projector of a geometry, with derivatives by the parameters of interest.
    pub fn new(geometry: &Geometry, parameters: &[Parameter]) -> Self {
        let views = (0..geometry.views.len())
            .map(|view| {
                let path = geometry.path(view);
                let moved = parameters
                    .iter()
                    .enumerate()
                    .filter(|(_, parameter)| !parameter.is_of_lens())
                    .map(|(i, p)| (i, geometry.moved(*p, STEP).path(view), geometry.moved(*p, -STEP).path(view)))
                    .filter(|(_, plus, _)| *plus != path)
                    .collect();
                ViewProjector { path, moved }
            })
            .collect();
        Self { parameters: parameters.to_vec(), views }
    }

    /// The pixel at which a view shows a point, metres, camera frame.
    ///
    /// # Errors
    /// [`NoRay`] where it does not show it.
    pub fn pixel(&self, view: usize, place: &Point3<f64>) -> Result<Point2<f64>, NoRay> {
        self.views[view].path.project(place)
    }

    /// As [`Projector::pixel`], with derivatives.
    ///
    /// # Errors
    /// [`NoRay`] where the view does not show the point.
    pub fn seen(&self, view: usize, place: &Point3<f64>) -> Result<Seen, NoRay> {
        let view = &self.views[view];
        let projection = view.path.project_with_jacobian(place)?;
        let normalised = projection.normalised();
        let by_lens = lens_derivatives(&view.path.lens, &normalised);
        let column = |parameter: &Parameter| {
            let i = Parameter::LENS.iter().position(|p| p == parameter);
            i.map_or_else(Vector2::zeros, |i| by_lens.column(i).into())
        };
        let mut d_parameters: Vec<Vector2<f64>> = self.parameters.iter().map(column).collect();
        for (i, plus, minus) in &view.moved {
            let passes = |path: &OpticalPath| path.trace_normalised(&normalised).map(|ray| ray.at(ray.nearest(place)));
            let shift = (passes(plus)? - passes(minus)?) / (2.0 * STEP);
            d_parameters[*i] = -(projection.d_pixel * shift);
        }
        Ok(Seen { pixel: projection.pixel, d_point: projection.d_pixel, d_parameters })
    }
}

/// d pixel / d (fx, fy, cx, cy, k1, k2, p1, p2, k3, k4, k5, k6) at a normalised image point.
fn lens_derivatives(lens: &Lens, normalised: &Point2<f64>) -> SMatrix<f64, 2, 12> {
    let (x, y) = (normalised.x, normalised.y);
    let r2 = x * x + y * y;
    let distorted = (lens.distort(normalised) - lens.principal_point_px).component_div(&lens.focal_px);
    let [k1, k2, _, _, k3] = lens.distortion;
    // The radial factor is N/D.
    let (below, _) = lens.denominator_at(r2);
    let by_above = normalised.coords / below;
    let by_below = -by_above * ((1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))) / below);
    let columns = [
        Vector2::new(distorted.x, 0.0),
        Vector2::new(0.0, distorted.y),
        Vector2::x(),
        Vector2::y(),
        lens.focal_px.component_mul(&(by_above * r2)),
        lens.focal_px.component_mul(&(by_above * r2 * r2)),
        lens.focal_px.component_mul(&Vector2::new(2.0 * x * y, r2 + 2.0 * y * y)),
        lens.focal_px.component_mul(&Vector2::new(r2 + 2.0 * x * x, 2.0 * x * y)),
        lens.focal_px.component_mul(&(by_above * r2 * r2 * r2)),
        lens.focal_px.component_mul(&(by_below * r2)),
        lens.focal_px.component_mul(&(by_below * r2 * r2)),
        lens.focal_px.component_mul(&(by_below * r2 * r2 * r2)),
    ];
    SMatrix::from_columns(&columns)
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::optics::Mirror;

    fn plane(normal: [f64; 3], offset_m: f64) -> Plane {
        Plane::new(Vector3::from(normal).normalize(), offset_m).unwrap()
    }

    /// A tank with a mirror beside it.
    pub(crate) fn geometry() -> Geometry {
        let wall = |outer| {
            Surface::Wall(Wall { outer, thickness_m: 5e-3, index_outside: 1.0, index_wall: 1.52, index_inside: 1.333 })
        };
        let mirror = Surface::Mirror(Mirror { plane: plane([-0.70, 0.02, -0.71], -1.1) });
        Geometry {
            lens: Lens {
                focal_px: Vector2::new(2700.0, 2710.0),
                principal_point_px: Point2::new(640.0, 510.0),
                distortion: [-0.11, 0.14, 6e-4, -4e-4, 0.02],
                denominator: [0.0; 3],
            },
            surfaces: vec![
                ("front_wall".into(), wall(plane([-0.05, 0.04, -1.0], -1.26))),
                ("side_mirror".into(), mirror),
                ("side_wall".into(), wall(plane([1.0, 0.01, -0.05], -0.05))),
            ],
            views: vec![("direct".into(), vec![0]), ("mirror".into(), vec![1, 2])],
        }
    }

    #[test]
    fn derivatives_are_those_of_the_projection() {
        let geometry = geometry();
        let parameters: Vec<Parameter> = Parameter::LENS
            .into_iter()
            .chain((0..3).flat_map(Parameter::of_surface))
            .chain([Parameter::IndexInside])
            .collect();
        let projector = Projector::new(&geometry, &parameters);
        for place in [Point3::new(-0.11, 0.02, 1.40), Point3::new(-0.16, -0.05, 1.36)] {
            for view in 0..2 {
                let seen = projector.seen(view, &place).unwrap();
                for (i, parameter) in parameters.iter().enumerate() {
                    // Independent check: the projection with two complete geometries, with another step.
                    let step = if parameter.is_of_lens() { 1e-3 } else { 1e-6 };
                    let at = |step: f64| geometry.moved(*parameter, step).path(view).project(&place).unwrap();
                    let expected = (at(step) - at(-step)) / (2.0 * step);
                    let error = (seen.d_parameters[i] - expected).norm();
                    assert!(error <= 2e-6 * (1.0 + expected.norm()), "{parameter:?} in view {view}: {error}");
                }
            }
        }
    }

    #[test]
    fn a_tilt_turns_the_normal_by_its_angle_and_keeps_the_distance() {
        let geometry = geometry();
        for surface in 0..3 {
            for axis in 0..2 {
                let moved = geometry.stepped(&[Parameter::Tilt { surface, axis }], &[0.01]);
                let alone = geometry.moved(Parameter::Tilt { surface, axis }, 0.01);
                let plane = |of: &Geometry| of.surfaces[surface].1.plane();
                let (before, after) = (plane(&geometry), plane(&moved));
                assert!((after.normal() - plane(&alone).normal()).norm() < 1e-12);
                assert!((before.normal().angle(&after.normal()) - 0.01).abs() < 1e-12);
                assert_eq!(before.offset_m(), after.offset_m());
            }
        }
    }
}
