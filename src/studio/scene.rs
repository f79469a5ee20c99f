//! Bands in pictures, and the rig in space, as the page draws them: pixels, and mm in the camera's frame.

use crate::estimate::BandObservation;
use crate::optics::Surface;
use crate::rig::{Rig, walk};
use nalgebra::{Point2, Point3};
use serde_json::{Value, json};

/// A band as the tracker fitted it.
pub(super) fn band(of: &BandObservation) -> Value {
    json!({
        "centre": [of.centre_px.x, of.centre_px.y],
        "sd_px": (of.covariance_px2.trace() / 2.0).max(0.0).sqrt(),
        "axis": [of.axis.x, of.axis.y],
        "axis_sd_deg": of.axis_sd_rad.to_degrees(),
        "residual_px": [of.residual_px.x, of.residual_px.y],
        "fit_rms": of.fit_rms,
        "separation": of.separation,
        "outline": of.outline_px.iter().map(|p| [p.x, p.y]).collect::<Vec<_>>(),
    })
}

fn mm(point: &Point3<f64>) -> [f64; 3] {
    [point.x, point.y, point.z].map(|v| (v * 1e5).round() / 1e2)
}

/// What stands still: the parts of mirrors and walls that the views are seen through, and the camera's view.
pub(super) fn set_up(rig: &Rig) -> Value {
    let mut surfaces = Vec::new();
    for view in rig.views.iter().filter(|view| !view.region_px.is_empty()) {
        let met: Vec<_> = view.region_px.iter().filter_map(|corner| walk(&view.optics, corner).ok()).collect();
        for (s, name) in view.path.iter().enumerate() {
            let corners: Vec<[f64; 3]> = met.iter().filter_map(|(met, _)| met.get(s)).map(|at| mm(&at.point)).collect();
            let mirror = matches!(view.optics.surfaces.get(s), Some(Surface::Mirror(_)));
            surfaces.push(json!({ "name": name, "view": view.name, "mirror": mirror, "corners": corners }));
        }
    }
    let bands = rig.markers.iter().map(|m| json!({ "name": m.name, "length_mm": m.length_m * 1e3 }));
    json!({
        "surfaces": surfaces,
        "tube_mm": rig.catheter.diameter_m * 1e3,
        "bands": bands.collect::<Vec<_>>(),
        "coil": rig.catheter.coil,
        "b0": rig.base.as_ref().map(|base| [base.b0.x, base.b0.y, base.b0.z]),
    })
}

/// What one frame shows: bands, their images in the mirrors, and the light from each band to the camera. `places` has
/// those of the bands that were measured, metres, camera frame.
pub(super) fn light(rig: &Rig, places: &[Option<Point3<f64>>]) -> Value {
    let mut paths = Vec::new();
    let mut images = Vec::new();
    for view in &rig.views {
        let mirrors = || {
            view.optics.surfaces.iter().filter_map(|s| match s {
                Surface::Mirror(mirror) => Some(mirror),
                Surface::Wall(_) => None,
            })
        };
        if mirrors().next().is_some() {
            let image = |place: &Option<Point3<f64>>| {
                // Seen from the camera, the last mirror on the way is the first to fold the world.
                place.map(|place| mm(&mirrors().rev().fold(place, |p, m| m.plane.reflect(&p))))
            };
            images.push(json!({ "view": view.name, "points": places.iter().map(image).collect::<Vec<_>>() }));
        }
        for (m, place) in places.iter().enumerate() {
            let Some(place) = place else { continue };
            let Ok(pixel) = view.optics.project(place) else { continue };
            let Ok((met, _)) = walk(&view.optics, &Point2::new(pixel.x, pixel.y)) else { continue };
            let mut points = vec![[0.0; 3]];
            points.extend(met.iter().map(|at| mm(&at.point)));
            points.push(mm(place));
            paths.push(json!({ "view": view.name, "band": m, "points": points }));
        }
    }
    let places: Vec<_> = places.iter().map(|place| place.as_ref().map(mm)).collect();
    json!({ "places": places, "images": images, "light": paths })
}
