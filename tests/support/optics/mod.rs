//! Random but valid rigs for the tests of the optics: each surface is placed in the path of one pixel's ray.

pub(crate) mod reference;

use catoptra::optics::{Lens, Mirror, OpticalPath, Plane, Surface, Wall};
use nalgebra::{Point2, Point3, Vector2, Vector3};

/// What a path is made of, in the order of travel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Element {
    Mirror,
    /// A wall met from outside.
    In,
    /// A wall met from inside.
    Out,
}
use Element::{In, Mirror as M, Out};

/// The paths under test.
pub(crate) const PATHS: [&[Element]; 10] =
    [&[], &[In], &[M], &[M, In], &[In, M], &[M, M, In], &[M, M], &[Out], &[In, Out], &[M, In, M]];

/// A path, a pixel whose ray goes through it, and a point on that ray.
#[derive(Debug, Clone)]
pub(crate) struct Case {
    pub(crate) path: OpticalPath,
    pub(crate) pixel: Point2<f64>,
    pub(crate) point: Point3<f64>,
}

/// Numbers that make a case: all between 0 and 1.
pub(crate) const DICE: usize = 32;

/// Builds a case from dice; `None` when they describe no valid one (lens folded over, total reflection, or a ray that
/// leaves a wall at more than 85°).
///
/// Lens: 800 to 3500 px, distortion up to a quarter. Mirrors are met at up to 70° from their normal, walls at up to
/// 75°; panes are up to 15 mm thick, indices 1.4 to 1.8 (pane) and 1 to 1.5 (inside).
pub(crate) fn build(elements: &[Element], dice: &[f64; DICE]) -> Option<Case> {
    let mut dice = dice.iter();
    let mut draw = |low: f64, high: f64| low + (high - low) * dice.next().expect("enough dice");
    let focal = draw(800.0, 3500.0);
    let lens = Lens {
        focal_px: Vector2::new(focal, focal * draw(0.98, 1.02)),
        principal_point_px: Point2::new(draw(580.0, 700.0), draw(450.0, 570.0)),
        distortion: [draw(-0.25, 0.25), draw(-0.2, 0.2), draw(-2e-3, 2e-3), draw(-2e-3, 2e-3), draw(-0.1, 0.1)],
        denominator: [0.0; 3],
    };
    let pixel = Point2::new(draw(0.0, 1280.0), draw(0.0, 1024.0));
    let mut path = OpticalPath { lens, surfaces: Vec::new() };
    for element in elements {
        let ray = path.trace(&pixel).ok()?;
        let widest: f64 = if *element == M { 70.0 } else { 75.0 };
        let (tilt, turn) = (draw(0.0, widest.to_radians()), draw(0.0, std::f64::consts::TAU));
        let e1 = ray.direction.cross(&Vector3::new(0.3, -0.5, 0.8)).normalize();
        let e2 = ray.direction.cross(&e1);
        let against = -ray.direction * tilt.cos() + (e1 * turn.cos() + e2 * turn.sin()) * tilt.sin();
        let place = ray.at(draw(0.1, 1.2));
        let plane = |normal: Vector3<f64>| Plane::new(normal, normal.dot(&place.coords)).expect("a plane");
        let (thickness_m, index_wall, index_inside) = (draw(0.0, 0.015), draw(1.4, 1.8), draw(1.0, 1.5));
        let wall = |outer| Surface::Wall(Wall { outer, thickness_m, index_outside: 1.0, index_wall, index_inside });
        path.surfaces.push(match element {
            Element::Mirror => Surface::Mirror(Mirror { plane: plane(against) }),
            // A wall met from inside keeps the index of the wall it was entered through, if there is one.
            Element::In => wall(plane(against)),
            Element::Out => match path.surfaces.last() {
                Some(Surface::Wall(front)) => {
                    Surface::Wall(Wall { outer: plane(-against).moved(front.thickness_m), ..*front })
                }
                _ => wall(plane(-against).moved(thickness_m)),
            },
        });
    }
    let ray = path.trace(&pixel).ok()?;
    if let Some(last) = path.surfaces.last()
        && last.plane().normal().dot(&ray.direction).abs() < 85_f64.to_radians().cos()
    {
        return None;
    }
    Some(Case { path, pixel, point: ray.at(draw(0.005, 1.0)) })
}
