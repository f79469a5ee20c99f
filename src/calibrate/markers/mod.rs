//! `catoptra calibrate markers`: what the tracker must know about the bands, from a click near each in one view.
//!
//! In: a recording, a rig with its optics and band lengths, clicks. Out: the rig with colour models for each view,
//! places of the bands along the tube, blur and chroma offset of the camera; and intermediate results, for the page
//! that shows them.
//!
//! 1. `locate`: in the picked frame, the bands are found by their size and the tube's, in all views jointly.
//! 2. Colours are learned from the bands and their surroundings. With them the tracker must measure the same bands.
//! 3. Frames from the whole recording are tracked, and the colours are learned again from all bands in all views.
//! 4. Blur of the lens, offset and reach of the chroma samples, and unknown distances between bands close to the coil
//!    are fitted to the pictures; so are the lengths of coil and next band, which are compared with those given.
//!
//! Nothing learned in an earlier run is used: the same recording and clicks give the same rig.

mod clusters;
mod compared;
mod error;
mod exposure;
mod first;
mod fitted;
mod glance;
mod learned;
mod line_search;
pub(crate) mod locate;
mod measures;
mod motion_blur;
mod pick;
mod regions;
mod samples;
mod seen;
mod view_blurs;

pub use error::MarkersError;
pub use exposure::Exposure;
pub(crate) use glance::{glance, mask, preview};
pub use learned::{Verdict, ViewColours, verdict};
pub use measures::ContradictedDimension;
pub use pick::Pick;
pub use regions::ProposedRegion;
pub use seen::{Rectangle, SeenBlob};

use crate::calibrate::frames::spread_with;
use crate::estimate::{BandObservation, Estimate, MarkerEstimate, Miss};
use crate::rig::Rig;
use crate::source::times::seconds;
use crate::source::{Frame, FrameSource};
use crate::track::{TrackOptions, Tracker};
use fitted::{lengths_m, place_bands, tune};
use learned::{learn_views, set_models};
use locate::pixels::Pixels;
use locate::{Near, locate};
use nalgebra::Vector3;
use samples::{Place, Samples};

/// Results of a calibration, intermediate and final.
#[derive(Debug)]
pub struct Teaching {
    /// The rig as learned so far.
    pub rig: Rig,
    /// The clicks.
    pub picks: Vec<Pick>,
    /// The frame of the clicks, once read.
    pub frame: Option<Frame>,
    /// Where each marker was located in each view, by marker.
    pub located: Vec<Vec<Option<Rectangle>>>,
    /// The colours learned in each view.
    pub views: Vec<ViewColours>,
    /// Blobs of the bands' colours in that frame.
    pub blobs: Vec<SeenBlob>,
    /// Regions that would exclude everything but the catheter.
    pub regions: Vec<ProposedRegion>,
    /// What was learned, or why nothing was.
    pub outcome: Result<MarkersCalibration, MarkersError>,
}

/// What was learned, and how well.
#[derive(Debug, Clone)]
pub struct MarkersCalibration {
    /// Frames used.
    pub frames: usize,
    /// For each marker, frames in which it was measured.
    pub answered: Vec<usize>,
    /// For each marker that was missed, the first reason.
    pub first_miss: Vec<Option<Miss>>,
    /// σ of each band's distance from the one before it along the tube, metres; `None` where not measured.
    pub centre_sd_m: Vec<Option<f64>>,
    /// For each view, σ of its blur from this view alone, pixels; `None` where its pictures do not tell.
    pub blur_sd_px: Vec<Option<f64>>,
    /// Dimensions that the pictures contradict.
    pub contradicted: Vec<ContradictedDimension>,
    /// How far each marker moves: RMS distance from its mean place, metres; 0 where it was not measured.
    pub moves_m: Vec<f64>,
}

/// Most frames used, spread over the recording.
const MAX_FRAMES: usize = 48;
/// Fraction of the frames in which each band must be measured.
const MIN_ANSWERED: f64 = 0.5;

/// Options of [`calibrate_markers`] besides picks.
#[derive(Debug, Clone, Copy, Default)]
pub struct MarkersOptions {
    /// The picks were made in the first frame at least this long after the recording's first one, nanoseconds.
    pub after_ns: i64,
    /// Exposure time of each picture, seconds; learned from motion blur if not given.
    pub exposure_s: Option<f64>,
}

/// Learns the markers of `rig`. Any colours, and the camera's blur and chroma offset, are ignored; given places along
/// the tube are used. `picks` has at least one click per marker.
pub fn calibrate_markers(
    rig: &Rig,
    picks: &[Pick],
    options: &MarkersOptions,
    source: &mut dyn FrameSource,
) -> Teaching {
    let mut teaching = Teaching::new(rig, picks, options);
    teaching.outcome = teaching.learn(options.after_ns, source);
    teaching
}

impl Teaching {
    /// The state before anything is learned.
    fn new(rig: &Rig, picks: &[Pick], options: &MarkersOptions) -> Self {
        let mut rig = rig.clone();
        rig.camera.blur_px = None;
        rig.views.iter_mut().for_each(|view| view.blur_px = None);
        rig.camera.chroma_offset_px = [0.0; 2];
        rig.camera.chroma_reach = [1.0; 2];
        rig.camera.colour_offset_px = [0.0; 2];
        rig.camera.exposure_s = options.exposure_s;
        rig.camera.gamma = None;
        rig.markers.iter_mut().for_each(|marker| marker.colours.clear());
        rig.markers.iter_mut().for_each(|marker| marker.usual_residuals.clear());
        Self {
            rig,
            picks: picks.to_vec(),
            frame: None,
            located: Vec::new(),
            views: Vec::new(),
            blobs: Vec::new(),
            regions: Vec::new(),
            outcome: Err(MarkersError::NoFrame),
        }
    }

    fn learn(&mut self, after_ns: i64, source: &mut dyn FrameSource) -> Result<MarkersCalibration, MarkersError> {
        let clicks = pick::in_rig_order(&self.rig, &self.picks)?;
        let spread = spread_with(source, MAX_FRAMES, after_ns)?;
        let (mut frames, followers) = (spread.frames, spread.followers);
        let Some(wanted) = spread.wanted else {
            return Err(match frames.as_slice() {
                [] => MarkersError::NoFrame,
                _ => MarkersError::BeyondEnd { at_s: seconds(after_ns), length_s: seconds(spread.length_ns) },
            });
        };
        let learned = self.learn_from(&clicks, &frames, &followers, wanted);
        let frame = frames.swap_remove(wanted);
        self.evaluate_frame(&frame);
        self.frame = Some(frame);
        learned
    }

    fn learn_from(
        &mut self,
        clicks: &[Vec<Near>],
        frames: &[Frame],
        followers: &[Frame],
        picked: usize,
    ) -> Result<MarkersCalibration, MarkersError> {
        let frame = &frames[picked];
        let pixels = Pixels::of(&frame.picture).ok_or(crate::segment::SegmentError::Grey)?;
        self.learn_picked(clicks, frame, &pixels)?;
        let rig = &mut self.rig;
        self.views = learn_everywhere(rig, frames)?;
        let (given, stated_s) = (rig.markers.clone(), rig.camera.exposure_s);
        let mut centre_sd_m = place_bands(rig, frames)?;
        let mut blur_sd_px = tune(rig, frames, followers)?;
        // The last band's place was found as if the tube were cut straight.
        let rounding_m = rig.catheter.end_rounding_m;
        if rounding_m.is_some() && centre_sd_m.iter().any(Option::is_some) {
            rig.camera.exposure_s = stated_s;
            rig.markers.iter_mut().zip(&given).for_each(|(marker, given)| marker.centre_m = given.centre_m);
            centre_sd_m = place_bands(rig, frames)?;
            blur_sd_px = tune(rig, frames, followers)?;
            rig.catheter.end_rounding_m = rig.catheter.end_rounding_m.or(rounding_m);
        }
        if let Ok(views) = learn_everywhere(rig, frames) {
            self.views = views;
        }
        let (tracker, estimates) = track(rig, frames)?;
        for (m, marker) in rig.markers.iter_mut().enumerate() {
            marker.usual_residuals = tracker.usual_residuals(m);
        }
        let answered = |m: usize| estimates.iter().filter(|e| e.markers[m].position.is_ok()).count();
        let first_miss = |m: usize| estimates.iter().find_map(|e| e.markers[m].position.as_ref().err().cloned());
        let moves_m = |m: usize| {
            let places =
                || estimates.iter().filter_map(|e| Some(e.markers.get(m)?.position.as_ref().ok()?.point.coords));
            let count = places().count().max(1) as f64;
            let mean = places().sum::<Vector3<f64>>() / count;
            (places().map(|place| (place - mean).norm_squared()).sum::<f64>() / count).sqrt()
        };
        let markers = 0..rig.markers.len();
        let done = MarkersCalibration {
            frames: frames.len(),
            answered: markers.clone().map(answered).collect(),
            first_miss: markers.clone().map(first_miss).collect(),
            centre_sd_m,
            blur_sd_px,
            contradicted: measures::contradicted(rig, frames, &estimates, &lengths_m(rig, frames)),
            moves_m: markers.map(moves_m).collect(),
        };
        self.usable(&done)?;
        Ok(done)
    }

    /// Learns from the picked frame alone; the tracker must measure the bands that were located in it.
    fn learn_picked(&mut self, clicks: &[Vec<Near>], frame: &Frame, pixels: &Pixels) -> Result<(), MarkersError> {
        let rig = &mut self.rig;
        let located = locate(rig, pixels, clicks).map_err(|why| first::explained(rig, clicks, why))?;
        self.located = located.iter().map(Rectangle::of).collect();
        self.views = first::learn_located(rig, &located, frame)?;
        for (v, view) in self.views.iter().enumerate() {
            let lost = view.exposure.iter().enumerate().find(|(_, e)| e.is_some_and(|e| e.is_lost()));
            if let Some((m, Some(exposure))) = lost {
                let (name, view) = (rig.markers[m].name.clone(), rig.views[v].name.clone());
                return Err(MarkersError::Overexposed { name, view, advice: exposure.advice().unwrap_or_default() });
            }
        }
        first::confirm(rig, clicks, &located, frame).map(drop)
    }

    /// Checks that the result is usable.
    fn usable(&self, done: &MarkersCalibration) -> Result<(), MarkersError> {
        let pairs = self.alike(done);
        if !pairs.is_empty() {
            return Err(MarkersError::Alike(pairs.join(", ")));
        }
        let names: Vec<&str> = self.rig.views.iter().map(|v| v.name.as_str()).collect();
        for (m, answered) in done.answered.iter().enumerate() {
            if (*answered as f64) < MIN_ANSWERED * done.frames as f64 {
                let reason = done.first_miss[m]
                    .as_ref()
                    .map_or(String::new(), |miss| format!(" ({})", miss.plain_words(&names)));
                let name = self.rig.markers[m].name.clone();
                return Err(MarkersError::TooSeldom { name, answered: *answered, frames: done.frames, reason });
            }
        }
        Ok(())
    }

    /// Bands whose colour is that of another band, or of surroundings that keep it from being measured.
    fn alike(&self, done: &MarkersCalibration) -> Vec<String> {
        let markers = self.rig.markers.len();
        let mut pairs: Vec<String> = Vec::new();
        for (view, info) in self.views.iter().zip(&self.rig.views) {
            for s in view.learned.separations.iter().filter(|s| verdict(s) == Verdict::Poor) {
                let beside = view.classes.get(s.other).is_some_and(|name| name.starts_with("beside"));
                let seldom = done.answered.get(s.marker).is_some_and(|n| n * 10 < done.frames * 9);
                if s.other < markers || (beside && seldom) {
                    let of = |class: usize| view.classes.get(class).map_or("", String::as_str);
                    pairs.push(format!("`{}` and `{}` in view `{}`", of(s.marker), of(s.other), info.name));
                }
            }
        }
        pairs
    }

    /// Evaluates the picked frame with the current colours.
    fn evaluate_frame(&mut self, frame: &Frame) -> Option<Estimate> {
        if self.rig.markers.iter().any(|marker| marker.colours.is_empty()) {
            return None;
        }
        let mut tracker = Tracker::new(&self.rig, TrackOptions::default()).ok()?;
        let estimate = tracker.step(frame).ok()?;
        self.blobs = seen::blobs(&self.rig, frame, &estimate);
        self.regions = regions::propose(&self.rig, &estimate, &self.blobs);
        Some(estimate)
    }
}

/// What all frames show, and the tracker that has seen them.
fn track(rig: &Rig, frames: &[Frame]) -> Result<(Tracker, Vec<Estimate>), MarkersError> {
    let mut tracker = Tracker::lenient(rig)?;
    let estimates = frames.iter().map(|frame| tracker.step(frame)).collect::<Result<_, _>>()?;
    Ok((tracker, estimates))
}

/// Colours of all bands in all views of all frames.
fn learn_everywhere(rig: &mut Rig, frames: &[Frame]) -> Result<Vec<ViewColours>, MarkersError> {
    let views = rig.views.clone();
    let names: Vec<String> = rig.markers.iter().map(|m| m.name.clone()).collect();
    let mut samples: Vec<Samples<'_>> = views.iter().map(|view| Samples::new(view, names.clone())).collect();
    for (estimate, frame) in track(rig, frames)?.1.iter().zip(frames) {
        for (v, samples) in samples.iter_mut().enumerate() {
            // A marker at an unknown place would teach that its band is background.
            let places: Option<Vec<_>> =
                estimate.markers.iter().enumerate().map(|(m, e)| place(rig, (m, v), e)).collect();
            if let Some(places) = places {
                samples.add(&frame.picture, &places.into_iter().flatten().collect::<Vec<_>>());
            }
        }
    }
    let learned = learn_views(&samples)?;
    set_models(rig, &learned);
    Ok(learned)
}

/// Where a marker is in a view: measured, or predicted from the other views (`Some(None)`: out of sight); `None` when
/// its position is unknown.
fn place(rig: &Rig, (m, v): (usize, usize), estimate: &MarkerEstimate) -> Option<Option<Place>> {
    let point = estimate.position.as_ref().ok()?.point;
    let seen: &Result<BandObservation, Miss> = estimate.views.get(v)?;
    Some(match seen {
        Ok(band) => Some(Place::band(m, band)),
        Err(_) => rig
            .views
            .get(v)?
            .optics
            .project_with_jacobian(&point)
            .ok()
            .map(|expected| Place::hidden(expected.pixel, expected.d_pixel.norm() * rig.markers[m].length_m)),
    })
}
