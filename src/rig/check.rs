//! What a rig means: where its rays go, how its views relate, whether tracing and projection agree, and what a user
//! should know before measuring with it.
//!
//! Assumption: the views look at one place, near where the rays of their central pixels come closest. This cannot tell
//! whether the numbers are true, only whether they are consistent.

use super::walk::{central_pixel, grid, walk};
use super::warnings::warnings;
use super::{Camera, Draft, View};
use crate::optics::{NoRay, OpticalPath, Ray, Surface};
use nalgebra::{Matrix2, Point2, Point3, Vector2, Vector3};

pub use super::view_check::{ClosestApproach, ROUND_TRIP_LIMIT_PX, Refraction, RoundTrip, ViewCheck};
pub use super::walk::Crossing;
pub use super::warnings::Warning;

/// Spacing of the test grid, pixels.
const GRID_PX: f64 = 16.0;
/// Distances tried when a single view cannot tell where the catheter is, metres.
const DISTANCES_M: [f64; 3] = [0.1, 0.3, 1.0];

/// The result of [`check`].
#[derive(Debug, Clone)]
pub struct Check {
    /// Full angle of view across the picture's middle row and column, radians; `None` where the lens model folds over.
    pub field_of_view_rad: [Option<f64>; 2],
    /// One entry per view, in the rig's order.
    pub views: Vec<ViewCheck>,
    /// Where the central rays of the first two views come closest.
    pub closest_approach: Option<ClosestApproach>,
    /// What a user should know, the most serious first.
    pub warnings: Vec<Warning>,
}

impl Check {
    /// Whether every view sees something and traces and projects consistently.
    pub fn usable(&self) -> bool {
        self.views.iter().all(|v| v.round_trip.with_ray > 0 && v.round_trip.faithful())
    }
}

/// Checks everything in a rig, complete or not.
///
/// # Errors
/// [`NoRay`] when a view has no central ray; a rig that was read from a file has one.
pub fn check(rig: &Draft) -> Result<Check, NoRay> {
    let mut central = Vec::with_capacity(rig.views.len());
    for view in &rig.views {
        let centre_px = central_pixel(&rig.camera, view)?;
        let (crossings, ray) = walk(&view.optics, &centre_px)?;
        central.push((centre_px, crossings, ray));
    }
    let closest_approach = match central.as_slice() {
        [(_, _, a), (_, _, b), ..] => closest_approach(a, b),
        _ => None,
    };
    let views: Vec<ViewCheck> = rig
        .views
        .iter()
        .zip(central)
        .map(|(view, (centre_px, crossings, ray))| {
            let met_m = closest_approach.map(|m| ray.nearest(&m.point)).filter(|distance| *distance > 0.0);
            let distances_m = met_m.map_or(DISTANCES_M, |met| [0.5 * met, met, 1.5 * met]);
            let working_distance_m = met_m.unwrap_or(DISTANCES_M[1]);
            ViewCheck {
                refraction: refraction(view, &centre_px, &crossings, &ray.at(working_distance_m)),
                round_trip: round_trip(&rig.camera, view, &distances_m),
                centre_px,
                crossings,
                ray,
                working_distance_m,
            }
        })
        .collect();
    let warnings = warnings(rig, &views, closest_approach.as_ref());
    Ok(Check { field_of_view_rad: field_of_view_rad(&rig.camera), views, closest_approach, warnings })
}

/// Midpoint of the shortest segment between two rays; `None` when they are parallel or it lies behind one of them.
fn closest_approach(a: &Ray, b: &Ray) -> Option<ClosestApproach> {
    let cos = a.direction.dot(&b.direction);
    let between = b.origin - a.origin;
    let along = Matrix2::new(1.0, -cos, cos, -1.0).try_inverse()?
        * Vector2::new(between.dot(&a.direction), between.dot(&b.direction));
    let (on_a, on_b) = (a.at(along.x), b.at(along.y));
    (along.x > 0.0 && along.y > 0.0).then(|| ClosestApproach {
        point: nalgebra::center(&on_a, &on_b),
        apart_m: (on_a - on_b).norm(),
        angle_rad: cos.clamp(-1.0, 1.0).acos(),
    })
}

fn refraction(view: &View, pixel: &Point2<f64>, crossings: &[Crossing], point: &Point3<f64>) -> Option<Refraction> {
    let last = crossings.iter().rposition(|c| c.media.is_some())?;
    let (before, after) = crossings.get(last)?.media?;
    let Some(Surface::Wall(wall)) = view.optics.surfaces.get(last) else { return None };
    let without_walls = OpticalPath {
        lens: view.optics.lens,
        surfaces: view.optics.surfaces.iter().filter(|s| matches!(s, Surface::Mirror(_))).copied().collect(),
    };
    let straight = without_walls.trace(pixel).ok()?;
    // From the last wall on, via the mirrors behind it.
    let stations: Vec<Point3<f64>> = crossings.iter().skip(last).map(|c| c.point).chain([*point]).collect();
    let depth_m: f64 = stations.iter().zip(stations.iter().skip(1)).map(|(a, b)| (b - a).norm()).sum();
    // Near the normal a layer of thickness t and index n seen from index 1 appears t/n thick.
    Some(Refraction {
        nearer_m: depth_m * (1.0 - before / after) + wall.thickness_m * (1.0 - before / wall.index_wall),
        beside_m: (straight.at(straight.nearest(point)) - point).norm(),
    })
}

fn round_trip(camera: &Camera, view: &View, distances_m: &[f64]) -> RoundTrip {
    let mut result =
        RoundTrip { pixels: 0, with_ray: 0, distances_m: distances_m.to_vec(), lost: 0, max_error_px: 0.0 };
    for pixel in grid(camera, GRID_PX).filter(|pixel| view.contains(pixel)) {
        result.pixels += 1;
        let Ok(ray) = view.optics.trace(&pixel) else { continue };
        result.with_ray += 1;
        for distance_m in distances_m {
            match view.optics.project(&ray.at(*distance_m)) {
                Ok(back) => result.max_error_px = result.max_error_px.max((back - pixel).norm()),
                Err(_) => result.lost += 1,
            }
        }
    }
    result
}

/// Full angles of view of the picture's middle row and column.
fn field_of_view_rad(camera: &Camera) -> [Option<f64>; 2] {
    let [right, bottom] = camera.size_px.map(|size| f64::from(size) - 0.5);
    let middle = Point2::new((right - 0.5) / 2.0, (bottom - 0.5) / 2.0);
    let angle = |a: Point2<f64>, b: Point2<f64>| {
        let direction = |p| camera.lens.undistort(&p).map(|n| Vector3::new(n.x, n.y, 1.0));
        Some(direction(a)?.angle(&direction(b)?))
    };
    [
        angle(Point2::new(-0.5, middle.y), Point2::new(right, middle.y)),
        angle(Point2::new(middle.x, -0.5), Point2::new(middle.x, bottom)),
    ]
}
