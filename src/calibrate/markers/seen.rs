//! What a frame shows in the bands' colours: the bands, and other objects with the reason why they are not bands.

use super::locate::BandMatch;
use super::locate::candidates::{Candidate, px_per_m};
use crate::estimate::Estimate;
use crate::rig::Rig;
use crate::segment::{Blob, Segmenter, Window};
use crate::source::Frame;
use nalgebra::{Point2, Vector2};

/// The rectangle of a band in a view.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rectangle {
    /// Its middle, pixels.
    pub centre: Point2<f64>,
    /// Unit vector along the band.
    pub axis: Vector2<f64>,
    /// Length along the axis, pixels.
    pub length: f64,
    /// Width across it, pixels.
    pub width: f64,
}

impl Rectangle {
    /// Rectangle in each view.
    pub(super) fn of(candidate: &Candidate) -> Vec<Option<Self>> {
        candidate.matches.iter().map(|matched| matched.as_ref().map(Self::of_match)).collect()
    }

    pub(super) fn of_match(matched: &BandMatch) -> Self {
        Self { centre: matched.centre, axis: matched.axis, length: matched.size.length, width: matched.size.width }
    }

    /// Its corners, in turn.
    pub fn corners(&self) -> [Point2<f64>; 4] {
        let along = self.axis * (self.length / 2.0);
        let across = Vector2::new(-self.axis.y, self.axis.x) * (self.width / 2.0);
        [along + across, along - across, -along - across, -along + across].map(|corner| self.centre + corner)
    }
}

/// Something in a band's colour.
#[derive(Debug, Clone, PartialEq)]
pub struct SeenBlob {
    /// Index of the marker whose colour it has.
    pub marker: usize,
    /// Index of the view.
    pub view: usize,
    /// Its middle, pixels.
    pub centre: Point2<f64>,
    /// The pixels it covers.
    pub bounds: Window,
    /// Its area, px².
    pub area_px2: f64,
    /// Why it is not the band; `None` when it is.
    pub rejected: Option<String>,
}

/// Plausible size of a band's blob relative to the expected one.
const SIZE_RATIO: (f64, f64) = (0.2, 3.0);

/// All blobs inside the views' regions, judged by what the tracker measured in the same frame.
pub(super) fn blobs(rig: &Rig, frame: &Frame, estimate: &Estimate) -> Vec<SeenBlob> {
    let Ok(mut segmenter) = Segmenter::for_rig(rig) else { return Vec::new() };
    let Ok(found) = segmenter.all_blobs(&frame.picture) else { return Vec::new() };
    let views = |blob: &Blob| {
        (0..rig.views.len())
            .find(|v| blob.view.is_none_or(|view| view == *v) && rig.views[*v].contains(&blob.centre_px))
    };
    found.iter().filter_map(|blob| Some(judged(rig, blob, views(blob)?, estimate))).collect()
}

fn judged(rig: &Rig, blob: &Blob, view: usize, estimate: &Estimate) -> SeenBlob {
    let marker = &estimate.markers[blob.marker];
    let measured = marker.views.get(view).and_then(|seen| seen.as_ref().ok());
    let is_band = measured.is_some_and(|band| {
        let reach = band.outline_px.iter().map(|p| (p - band.centre_px).norm()).fold(0.0, f64::max);
        (band.centre_px - blob.centre_px).norm() <= reach
    });
    let scale = marker.position.as_ref().ok().and_then(|p| px_per_m(&rig.views[view], &p.point));
    let expected = scale.map(|scale| scale * scale * rig.markers[blob.marker].length_m * rig.catheter.diameter_m);
    let ratio = expected.map(|expected| blob.area_px2 / expected);
    let rejected = match ratio {
        _ if is_band => None,
        Some(ratio) if ratio > SIZE_RATIO.1 => Some(format!("{ratio:.0} times as large as the band")),
        Some(ratio) if ratio < SIZE_RATIO.0 => Some("much smaller than the band".to_owned()),
        Some(_) => Some("not where the other views and the tube say that the band is".to_owned()),
        None => Some("the band was not measured in this frame".to_owned()),
    };
    SeenBlob {
        marker: blob.marker,
        view,
        centre: blob.centre_px,
        bounds: blob.bounds,
        area_px2: blob.area_px2,
        rejected,
    }
}
