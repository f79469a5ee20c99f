//! Regions that contain everything the tube can reach, proposed where other objects of the bands' colours lie outside.

use super::seen::SeenBlob;
use crate::estimate::Estimate;
use crate::rig::Rig;
use nalgebra::{Point2, Point3, Rotation3, Vector3};

/// A rectangle of pixels for a view.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ProposedRegion {
    /// Index of the view.
    pub view: usize,
    /// Its corners, whole pixels.
    pub from: Point2<f64>,
    /// The opposite corner.
    pub to: Point2<f64>,
    /// Objects of a band's colour in the view that it excludes.
    pub leaves_out: usize,
}

/// Margin of the swing beyond the tube's length, metres, and above its first band, as a fraction of its length.
const MARGIN_M: f64 = 10e-3;
const ABOVE: f64 = 0.15;

/// A region for each view where one excludes other objects. It contains the whole volume that the tube can reach.
pub(super) fn propose(rig: &Rig, estimate: &Estimate, blobs: &[SeenBlob]) -> Vec<ProposedRegion> {
    let place = |m: usize| estimate.markers.get(m)?.position.as_ref().ok().map(|p| p.point);
    let count = rig.markers.len();
    let (Some(first), Some(last)) = (place(0), count.checked_sub(1).and_then(place)) else { return Vec::new() };
    let points: Vec<Point3<f64>> = (0..count).filter_map(place).collect();
    let stretched: f64 = points.windows(2).map(|pair| (pair[1] - pair[0]).norm()).sum();
    let along = match (rig.markers[0].centre_m, rig.markers[count - 1].centre_m) {
        (Some(a), Some(b)) => b - a,
        _ => stretched * 1.1,
    };
    let reach_m = along + rig.markers[count - 1].length_m + MARGIN_M;
    let down = (last - first).normalize();
    let view = |v: usize| -> Option<ProposedRegion> {
        let optics = &rig.views[v].optics;
        let pixels = sphere(&down).filter_map(|direction| optics.project(&(first + direction * reach_m)).ok());
        let (mut from, mut to) = (Point2::new(f64::MAX, f64::MAX), Point2::new(f64::MIN, f64::MIN));
        for pixel in pixels {
            from = from.inf(&pixel);
            to = to.sup(&pixel);
        }
        let [width, height] = rig.camera.size_px.map(|size| f64::from(size - 1));
        from = from.map(f64::floor).sup(&Point2::origin());
        to = to.map(f64::ceil).inf(&Point2::new(width, height));
        let outside = |p: &Point2<f64>| p.x < from.x || p.y < from.y || p.x > to.x || p.y > to.y;
        let leaves_out = blobs.iter().filter(|b| b.view == v && b.rejected.is_some() && outside(&b.centre)).count();
        let proposed = ProposedRegion { view: v, from, to, leaves_out };
        (leaves_out > 0 && to.x > from.x && to.y > from.y).then_some(proposed)
    };
    (0..rig.views.len()).filter_map(view).collect()
}

/// Directions all over the sphere except its top, opposite to `down`.
fn sphere(down: &Vector3<f64>) -> impl Iterator<Item = Vector3<f64>> {
    let turn = Rotation3::rotation_between(&Vector3::z(), down).unwrap_or_else(Rotation3::identity);
    let rings = (0..=12).map(|i| -ABOVE + (1.0 + ABOVE) * f64::from(i) / 12.0);
    rings.flat_map(move |z| {
        let radius = (1.0 - z * z).max(0.0).sqrt();
        (0..24).map(move |k| {
            let (sin, cos) = (f64::from(k) * std::f64::consts::TAU / 24.0).sin_cos();
            turn * Vector3::new(radius * cos, radius * sin, z)
        })
    })
}
