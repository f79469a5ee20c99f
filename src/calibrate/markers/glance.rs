//! What a click shows before anything is learned from the whole recording, for the page on which bands are picked.
//!
//! [`glance`] takes one click and gives the rectangle that looks like the band there, its colour against its
//! surroundings, and the blob of that colour. [`preview`] takes a click on every band and does the first steps of
//! [`calibrate_markers`](super::calibrate_markers) with that one frame.

use super::error::MarkersError;
use super::exposure::Exposure;
use super::learned::{ViewColours, learn_views};
use super::locate::at_click;
use super::locate::pixels::Pixels;
use super::samples::{Place, Samples, colour};
use super::{MarkersOptions, Pick, Rectangle, Teaching, first, pick};
use crate::estimate::Estimate;
use crate::rig::{ColourModel, Rig};
use crate::segment::{Blob, Search, Segmenter, THRESHOLD};
use crate::source::{Frame, Picture, Window};
use nalgebra::Point2;

/// The presumed band at one click.
#[derive(Debug, Clone)]
pub(crate) struct Glance {
    /// Where it is.
    pub rectangle: Rectangle,
    /// Contrast with its surroundings: 1 is the level of shading and noise.
    pub contrast: f64,
    /// Its colour against its surroundings, with the classes that it is separated from.
    pub colours: ViewColours,
    /// The blob of that colour in the rectangle, if there is one.
    pub blob: Option<Blob>,
    /// Window of the mask.
    pub window: Window,
}

impl Glance {
    /// The colour model.
    pub(crate) fn model(&self) -> Option<&ColourModel> {
        self.colours.learned.models.first()
    }

    /// How the band is exposed.
    pub(crate) fn exposure(&self) -> Option<Exposure> {
        self.colours.exposure.first().copied().flatten()
    }
}

/// How far around the rectangle blobs are searched, pixels.
const AROUND_PX: f64 = 60.0;

/// Examines one click in a picture and its [`Pixels`].
///
/// # Errors
/// When the click is outside of its view, nothing there looks like the band, or its colour is that of its surroundings.
pub(crate) fn glance(rig: &Rig, pick: &Pick, picture: &Picture, pixels: &Pixels) -> Result<Glance, MarkersError> {
    let near = pick::near(rig, pick)?;
    let marker = rig.marker(&pick.name).ok_or_else(|| MarkersError::NoPick(pick.name.clone()))?;
    let matched = at_click(rig, pixels, marker, &near).map_err(|why| {
        let clicks: Vec<Vec<_>> =
            (0..rig.markers.len()).map(|m| if m == marker { vec![near] } else { Vec::new() }).collect();
        first::explained(rig, &clicks, why)
    })?;
    let view = rig.views.get(near.view).ok_or(MarkersError::NoVolume)?;
    let mut samples = Samples::new(view, vec![pick.name.clone()]);
    samples.add(picture, &[Place::of_match(0, &matched)]);
    let colours = learn_views(&[samples])?.pop().ok_or(MarkersError::NoFrame)?;
    let rectangle = Rectangle::of_match(&matched);
    let window = around(&rectangle, picture.size_px());
    let blob = match colours.learned.models.first() {
        Some(model) => {
            let mut segmenter =
                Segmenter::new(std::slice::from_ref(model))?.with_chroma_offset_px(rig.camera.chroma_offset_px);
            let blobs = segmenter.blobs(picture, &[Search { marker: None, view: None, window }])?;
            let off = |blob: &&Blob| (blob.centre_px - rectangle.centre).norm();
            let near = blobs.iter().filter(|blob| off(blob) < rectangle.length.max(rectangle.width));
            near.min_by(|a, b| off(a).total_cmp(&off(b))).cloned()
        }
        None => None,
    };
    Ok(Glance { rectangle, contrast: matched.score, colours, blob, window })
}

fn around(rectangle: &Rectangle, size_px: [u32; 2]) -> Window {
    let reach = rectangle.length.max(rectangle.width) + AROUND_PX;
    let low = |c: f64| (c - reach).floor().max(0.0) as u32;
    let high = |c: f64| (c + reach).ceil().max(0.0) as u32;
    let Point2 { coords: c } = rectangle.centre;
    Window { x0: low(c.x), y0: low(c.y), x1: high(c.x), y1: high(c.y) }.clipped(size_px)
}

/// Pixels of a window that count as the marker, as runs `[y, from, to]`, `to` exclusive. Each pixel is judged by its
/// nearest samples.
pub(crate) fn mask(picture: &Picture, model: &ColourModel, window: Window) -> Vec<[u32; 3]> {
    let Some(rgb) = picture.rgb_from_stored() else { return Vec::new() };
    let window = window.clipped(picture.size_px());
    let mut runs = Vec::new();
    for y in window.y0..window.y1 {
        let mut from = None;
        for x in window.x0..window.x1 {
            let counts = colour(picture, &rgb, x, y).is_some_and(|c| model.score(&c) > f64::from(THRESHOLD));
            match (from, counts) {
                (None, true) => from = Some(x),
                (Some(start), false) => {
                    runs.push([y, start, x]);
                    from = None;
                }
                _ => {}
            }
        }
        runs.extend(from.map(|start| [y, start, window.x1]));
    }
    runs
}

/// Results from the picked frame alone.
#[derive(Debug)]
pub(crate) struct Preview {
    /// The results so far, without frame and outcome.
    pub teaching: Teaching,
    /// The tracker's measurement with the colours of this frame, if it got that far.
    pub estimate: Option<Estimate>,
    /// Why the bands cannot be learned from it.
    pub problem: Option<MarkersError>,
}

/// Finds all bands in all views of one frame, and measures them.
pub(crate) fn preview(rig: &Rig, picks: &[Pick], options: &MarkersOptions, frame: &Frame, pixels: &Pixels) -> Preview {
    let mut teaching = Teaching::new(rig, picks, options);
    let clicks = pick::in_rig_order(&teaching.rig, picks);
    let learned = clicks.and_then(|clicks| teaching.learn_picked(&clicks, frame, pixels));
    let estimate = teaching.evaluate_frame(frame);
    Preview { teaching, estimate, problem: learned.err() }
}
