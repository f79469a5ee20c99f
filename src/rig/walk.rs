//! Follows one ray along a view's path: where it meets each surface, at what angle, between which media.

use super::{Camera, View, polygon};
use crate::optics::{NoRay, OpticalPath, Ray, Surface};
use nalgebra::{Point2, Point3};

/// One surface met by one ray.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Crossing {
    /// Where the ray leaves the surface, camera frame, metres (for a wall: on its far face).
    pub point: Point3<f64>,
    /// Angle between the arriving ray and the surface's normal, radians.
    pub incidence_rad: f64,
    /// Refractive index before and behind a wall; `None` at a mirror.
    pub media: Option<(f64, f64)>,
}

/// Follows the ray of a pixel; returns its crossings and the ray in the marker's medium.
pub(crate) fn walk(optics: &OpticalPath, pixel: &Point2<f64>) -> Result<(Vec<Crossing>, Ray), NoRay> {
    let mut so_far = OpticalPath { lens: optics.lens, surfaces: Vec::new() };
    let mut ray = so_far.trace(pixel)?;
    let mut crossings = Vec::with_capacity(optics.surfaces.len());
    for surface in &optics.surfaces {
        let cos = surface.plane().normal().dot(&ray.direction);
        so_far.surfaces.push(*surface);
        ray = so_far.trace(pixel)?;
        crossings.push(Crossing {
            point: ray.origin,
            incidence_rad: cos.abs().min(1.0).acos(),
            media: match surface {
                Surface::Mirror(_) => None,
                Surface::Wall(wall) if cos < 0.0 => Some((wall.index_outside, wall.index_inside)),
                Surface::Wall(wall) => Some((wall.index_inside, wall.index_outside)),
            },
        });
    }
    Ok((crossings, ray))
}

/// Pixels on a grid of spacing `step_px` over the picture, border included.
pub(super) fn grid(camera: &Camera, step_px: f64) -> impl Iterator<Item = Point2<f64>> {
    let [columns, rows] = camera.size_px.map(|size| (f64::from(size - 1) / step_px).floor() as u32);
    (0..=rows).flat_map(move |j| (0..=columns).map(move |i| Point2::new(f64::from(i), f64::from(j)) * step_px))
}

/// The pixel that represents a view: the centre of its region or, without one, the pixel nearest to the picture's
/// centre that has a ray.
pub(super) fn central_pixel(camera: &Camera, view: &View) -> Result<Point2<f64>, NoRay> {
    if !view.region_px.is_empty() {
        let centre = polygon::area_and_centre(&view.region_px).1;
        return view.optics.trace(&centre).map(|_| centre);
    }
    let centre = Point2::from(camera.size_px.map(|size| f64::from(size - 1) / 2.0));
    let Err(no_ray) = view.optics.trace(&centre) else { return Ok(centre) };
    let longer_side = f64::from(camera.size_px[0].max(camera.size_px[1]));
    grid(camera, (longer_side / 32.0).max(1.0))
        .filter(|pixel| view.optics.trace(pixel).is_ok())
        .min_by(|a, b| (a - centre).norm().total_cmp(&(b - centre).norm()))
        .ok_or(no_ray)
}
