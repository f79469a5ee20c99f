//! `catoptra calibrate markers`: what the tracker must know of the bands, from one click a band in one view.
//!
//! In: a recording, a rig with its optics, for each band a click in the first frame and its length. Out: the rig with
//! colour models, places of the bands along the tube, blur and chroma offset of the camera.
//!
//! 1. The colour at each click against the colours around it and the rest of the picture gives a first discriminant; the
//!    blob under the click against what lies beside it a better one.
//! 2. The tracker finds the same bands in the other views of the first frame: rays must meet, sizes must fit.
//! 3. Frames from the whole recording are tracked, and the colours learned again from all bands in all views.
//! 4. Blur of the lens, offset of the chroma samples, and unknown distances between bands close to the coil are those that
//!    explain the pictures best.
//!
//! Cannot detect: a wrong length or diameter given by the user, other than by a poor fit.

mod error;
mod first;
mod fitted;
mod line_search;
pub(crate) mod locate;
mod samples;
pub mod surroundings;

pub use error::MarkersError;

use crate::calibrate::frames::spread;
use crate::calibrate::markers::samples::{Place, Samples};
use crate::estimate::{BandObservation, Estimate, MarkerEstimate, Miss};
use crate::rig::{Rig, View};
use crate::segment::{Learned, Separation, learn};
use crate::source::{Frame, FrameSource};
use crate::track::{TrackOptions, Tracker};
use first::{confirm, in_rig_order, learn_first};
use fitted::{place_bands, tune};
use nalgebra::Point2;

/// One click.
#[derive(Debug, Clone, PartialEq)]
pub struct Pick {
    /// Name of the marker.
    pub name: String,
    /// A place on the band in the first frame, pixels.
    pub pixel: Point2<f64>,
    /// Length of the band along the tube, metres.
    pub length_m: f64,
}

/// What was learned, and how well.
#[derive(Debug, Clone)]
pub struct MarkersCalibration {
    /// The rig with everything learned.
    pub rig: Rig,
    /// Names of the classes that the separations refer to.
    pub classes: Vec<String>,
    /// Colour models' separations.
    pub learned: Learned,
    /// Frames used.
    pub frames: usize,
    /// For each marker, frames in which it was measured.
    pub answered: Vec<usize>,
    /// For each marker that was missed, the first reason.
    pub first_miss: Vec<Option<Miss>>,
}

/// Frames looked at, spread over the recording.
const MOST_FRAMES: usize = 48;

/// Learns the markers of `rig`, whose colours may be missing; `picks` has one click a marker, in view `view`.
///
/// # Errors
/// [`MarkersError`]. Poor separation of the colours is no error here: see [`MarkersCalibration::weak_pairs`].
pub fn calibrate_markers(
    rig: &Rig,
    picks: &[Pick],
    view: usize,
    source: &mut dyn FrameSource,
) -> Result<MarkersCalibration, MarkersError> {
    let picks = in_rig_order(rig, picks, view)?;
    let frames = spread(source, MOST_FRAMES)?;
    let first = frames.first().ok_or(MarkersError::NoFrame)?;
    let mut rig = learn_first(rig, &picks, first)?;
    confirm(&rig, &picks, view, first)?;
    let mut learned = learn_everywhere(&mut rig, &frames)?;
    place_bands(&mut rig, &frames)?;
    tune(&mut rig, &frames)?;
    learned = learn_everywhere(&mut rig, &frames).unwrap_or(learned);
    let estimates = track(&rig, &frames)?;
    let answered = |m: usize| estimates.iter().filter(|e| e.markers[m].position.is_ok()).count();
    let first_miss = |m: usize| estimates.iter().find_map(|e| e.markers[m].position.as_ref().err().cloned());
    Ok(MarkersCalibration {
        frames: frames.len(),
        answered: (0..rig.markers.len()).map(answered).collect(),
        first_miss: (0..rig.markers.len()).map(first_miss).collect(),
        classes: learned.0,
        learned: learned.1,
        rig,
    })
}

impl MarkersCalibration {
    /// Pairs of classes that are too alike to find the band by its colour.
    pub fn weak_pairs(&self) -> impl Iterator<Item = &Separation> {
        self.learned.separations.iter().filter(|s| !is_apart(s))
    }
}

/// Single samples may be mistaken, a band may not: it has a dozen samples or more, of which half must be right.
const LEAST_D_PRIME: f64 = 3.0;

/// Whether a band's colour is far enough from another class.
pub fn is_apart(separation: &Separation) -> bool {
    separation.d_prime >= LEAST_D_PRIME
}

fn set_models(rig: &mut Rig, learned: &Learned) {
    for (marker, model) in rig.markers.iter_mut().zip(&learned.models) {
        marker.colour = Some(*model);
    }
}

fn track(rig: &Rig, frames: &[Frame]) -> Result<Vec<Estimate>, MarkersError> {
    let mut tracker = Tracker::new(rig, TrackOptions::default())?;
    Ok(frames.iter().map(|frame| tracker.step(frame)).collect::<Result<_, _>>()?)
}

/// Colours of all bands in all views of all frames.
fn learn_everywhere(rig: &mut Rig, frames: &[Frame]) -> Result<(Vec<String>, Learned), MarkersError> {
    let mut samples = Samples::new(rig.markers.iter().map(|m| m.name.clone()).collect());
    for (estimate, frame) in track(rig, frames)?.iter().zip(frames) {
        // A marker that is somewhere unknown would teach that its band is background.
        let places: Option<Vec<_>> = estimate.markers.iter().enumerate().map(|(m, e)| places(rig, m, e)).collect();
        if let Some(places) = places {
            samples.add(&frame.picture, &places.into_iter().flatten().collect::<Vec<_>>(), true);
        }
    }
    let classes = samples.classes();
    let learned = learn(&classes)?;
    set_models(rig, &learned);
    Ok((classes.into_iter().map(|c| c.name).collect(), learned))
}

/// Where a marker is in each view: measured, or where the other views say; `None` when its position is not known.
fn places(rig: &Rig, m: usize, estimate: &MarkerEstimate) -> Option<Vec<Place>> {
    let point = estimate.position.as_ref().ok()?.point;
    let place = |(view, seen): (&View, &Result<BandObservation, Miss>)| match seen {
        Ok(band) => Some(Place::band(m, band)),
        Err(_) => {
            let expected = view.optics.project_with_jacobian(&point).ok()?;
            Some(Place::hidden(expected.pixel, expected.d_pixel.norm() * rig.markers[m].length_m))
        }
    };
    Some(rig.views.iter().zip(&estimate.views).filter_map(place).collect())
}
