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

use super::colours::{Place, Samples};
use super::tune::minimise;
use crate::estimate::{BandObservation, Estimate, MarkerEstimate, Miss};
use crate::rig::{Marker, Rig, View};
use crate::segment::{LearnError, Learned, SegmentError, Segmenter, Separation, learn};
use crate::source::{Frame, FrameSource, SourceError};
use crate::track::{TrackError, TrackOptions, Tracker};
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

/// Why the markers cannot be calibrated.
#[derive(Debug, thiserror::Error)]
pub enum MarkersError {
    /// The recording broke.
    #[error(transparent)]
    Source(#[from] SourceError),
    /// No frame at all.
    #[error("the recording has no frame")]
    NoFrame,
    /// A click for a marker that the rig does not have.
    #[error("no pick for marker `{0}` of the rig: every marker needs one")]
    NoPick(String),
    /// A click outside the picture.
    #[error("pick {name}@{x},{y} lies outside the picture of {width}x{height} pixels")]
    Outside {
        /// Marker.
        name: String,
        /// Pixel.
        x: f64,
        /// Pixel.
        y: f64,
        /// Of the picture.
        width: u32,
        /// Of the picture.
        height: u32,
    },
    /// A click beside the view that it should be in.
    #[error("pick {name}@{x},{y} lies outside region_px of view `{view}`{}", also_in(other.as_deref()))]
    OutsideView {
        /// Marker.
        name: String,
        /// Pixel.
        x: f64,
        /// Pixel.
        y: f64,
        /// The view it should be in.
        view: String,
        /// The view it is in.
        other: Option<String>,
    },
    /// The colours cannot be learned.
    #[error("the colours cannot be told apart: {0}")]
    Learn(#[from] LearnError),
    /// No blob under the click.
    #[error("nothing of a colour of its own at {x},{y}, where `{name}` was picked: click on the middle of the band")]
    NoBlob {
        /// Marker.
        name: String,
        /// Pixel.
        x: f64,
        /// Pixel.
        y: f64,
    },
    /// The band is not found in another view, or found elsewhere.
    #[error("`{name}` was picked at {x},{y} but cannot be measured in the first frame: {reason}")]
    NotMeasured {
        /// Marker.
        name: String,
        /// Pixel.
        x: f64,
        /// Pixel.
        y: f64,
        /// Why.
        reason: String,
    },
    /// The picture does not belong to the rig.
    #[error(transparent)]
    Track(#[from] TrackError),
    /// The picture cannot be segmented.
    #[error(transparent)]
    Segment(#[from] SegmentError),
}

/// Frames looked at, spread over the recording, and the memory they may take together.
const MOST_FRAMES: usize = 48;
const FRAME_BYTES: u64 = 400_000_000;
/// Frames that decide blur, chroma offset and distances.
const TUNING_FRAMES: usize = 12;

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

fn also_in(other: Option<&str>) -> String {
    other.map_or(String::new(), |other| format!("; it lies in that of `{other}`, say so with --view if all picks do"))
}

fn in_rig_order(rig: &Rig, picks: &[Pick], view: usize) -> Result<Vec<Pick>, MarkersError> {
    let [width, height] = rig.camera.size_px;
    rig.markers
        .iter()
        .map(|marker| {
            let pick = picks.iter().find(|p| p.name == marker.name);
            let pick = pick.ok_or_else(|| MarkersError::NoPick(marker.name.clone()))?;
            let Point2 { coords } = pick.pixel;
            let within = |v: f64, size: u32| (0.0..f64::from(size)).contains(&v);
            let (name, x, y) = (pick.name.clone(), coords.x, coords.y);
            if !(within(x, width) && within(y, height)) {
                return Err(MarkersError::Outside { name, x, y, width, height });
            }
            match rig.views.get(view) {
                Some(missed) if !missed.contains(&pick.pixel) => {
                    let other = rig.views.iter().find(|v| v.contains(&pick.pixel)).map(|v| v.name.clone());
                    Err(MarkersError::OutsideView { name, x, y, view: missed.name.clone(), other })
                }
                _ => Ok(pick.clone()),
            }
        })
        .collect()
}

/// At most so many frames, spread evenly over the recording, the first one among them.
pub(super) fn spread(source: &mut dyn FrameSource, most: usize) -> Result<Vec<Frame>, SourceError> {
    let [width, height] = source.size_px();
    let fitting = FRAME_BYTES / (u64::from(width) * u64::from(height) * 2).max(1);
    let most = most.min(fitting.max(4) as usize);
    let mut stride = 1;
    let mut frames: Vec<Frame> = Vec::new();
    let mut number = 0;
    loop {
        let frame = match source.next_frame() {
            Ok(Some(frame)) => frame,
            Ok(None) => break,
            // Colours are learned as well from the part that can be read.
            Err(error) if error.is_early_end() && !frames.is_empty() => {
                tracing::warn!("{error}");
                break;
            }
            Err(error) => return Err(error),
        };
        if number % stride == 0 {
            frames.push(frame);
        }
        number += 1;
        // Too many: keep every second one. Works for any length, known beforehand or not.
        if frames.len() > most {
            let mut even = false;
            frames.retain(|_| {
                even = !even;
                even
            });
            stride *= 2;
        }
    }
    Ok(frames)
}

/// Colours from the clicks, then from the blobs under them.
fn learn_first(rig: &Rig, picks: &[Pick], first: &Frame) -> Result<Rig, MarkersError> {
    let names = || picks.iter().map(|p| p.name.clone()).collect();
    let mut rig = rig.clone();
    for (marker, pick) in rig.markers.iter_mut().zip(picks) {
        marker.length_m = pick.length_m;
    }
    let clicks: Vec<Point2<f64>> = picks.iter().map(|p| p.pixel).collect();
    let mut samples = Samples::new(names());
    samples.add_clicks(&first.picture, &clicks);
    set_models(&mut rig, &learn(&samples.classes())?);
    // The whole band shows more of its shading than the click, and what lies beside it matters most. The tube stays a class of
    // its own: blobs reach a little into it, and would grow into it further each time.
    for _ in 0..2 {
        let places = blobs_under(&rig, picks, first)?;
        let mut samples = Samples::new(names());
        samples.add(&first.picture, &places, true);
        samples.add_around(&first.picture, &clicks);
        set_models(&mut rig, &learn(&samples.classes())?);
    }
    Ok(rig)
}

fn blobs_under(rig: &Rig, picks: &[Pick], frame: &Frame) -> Result<Vec<Place>, MarkersError> {
    let mut segmenter = Segmenter::for_rig(rig)?;
    let blobs = segmenter.all_blobs(&frame.picture)?;
    picks
        .iter()
        .enumerate()
        .map(|(m, pick)| {
            let (x, y) = (pick.pixel.x, pick.pixel.y);
            let holds = |low: u32, high: u32, v: f64| (f64::from(low)..f64::from(high)).contains(&v);
            // A scattered one may reach around the band.
            blobs
                .iter()
                .filter(|b| b.marker == m && holds(b.bounds.x0, b.bounds.x1, x) && holds(b.bounds.y0, b.bounds.y1, y))
                .min_by(|a, b| a.area_px2.total_cmp(&b.area_px2))
                .map(Place::blob)
                .ok_or_else(|| MarkersError::NoBlob { name: pick.name.clone(), x, y })
        })
        .collect()
}

fn set_models(rig: &mut Rig, learned: &Learned) {
    for (marker, model) in rig.markers.iter_mut().zip(&learned.models) {
        marker.colour = Some(*model);
    }
}

/// The tracker must measure, in the first frame, the very bands that were clicked.
fn confirm(rig: &Rig, picks: &[Pick], view: usize, first: &Frame) -> Result<(), MarkersError> {
    let estimate = Tracker::new(rig, TrackOptions::default())?.step(first)?;
    let names: Vec<&str> = rig.views.iter().map(|v| v.name.as_str()).collect();
    for ((pick, marker), info) in picks.iter().zip(&estimate.markers).zip(&rig.markers) {
        let not_measured = |reason: String| MarkersError::NotMeasured {
            name: pick.name.clone(),
            x: pick.pixel.x,
            y: pick.pixel.y,
            reason,
        };
        if let Err(miss) = &marker.position {
            let also: Vec<String> = estimate
                .markers
                .iter()
                .zip(&rig.markers)
                .filter(|(m, other)| m.position.as_ref().is_err_and(|e| e == miss) && other.name != info.name)
                .map(|(_, other)| format!("`{}`", other.name))
                .collect();
            let also = if also.is_empty() { String::new() } else { format!(" (nor can {})", also.join(", ")) };
            return Err(not_measured(format!("{}{also}", why(rig, info, miss))));
        }
        if let Some(Ok(seen)) = marker.views.get(view) {
            let away = (seen.centre_px - pick.pixel).norm();
            let longest = seen.outline_px.iter().map(|p| (p - seen.centre_px).norm()).fold(0.0, f64::max);
            if away > longest + 2.0 {
                return Err(not_measured(format!(
                    "the band of this colour that fits a length of {} mm is seen at {:.0},{:.0} in view `{}`",
                    info.length_m * 1e3,
                    seen.centre_px.x,
                    seen.centre_px.y,
                    names[view]
                )));
            }
        }
    }
    Ok(())
}

/// A miss as the one who clicked should hear it.
fn why(rig: &Rig, marker: &Marker, miss: &Miss) -> String {
    let band =
        format!("a band of {:.1} mm on a tube of {:.1} mm", marker.length_m * 1e3, rig.catheter.diameter_m * 1e3);
    match miss {
        Miss::NotSeen { view } => {
            let view = rig.views.get(*view).map_or("another view", |v| v.name.as_str());
            format!("nothing of its colour that could be {band} is seen in `{view}`")
        }
        Miss::Ambiguous { candidates } => format!(
            "{candidates} things of its colour are where it could be: cover the others, or draw the views' region_px tighter"
        ),
        Miss::RaysDiverge { distance_m } => format!(
            "what has its colour in the views is not in one place, lines of sight pass {:.1} mm apart: click on the band \
             itself, and see whether mirror and walls in the rig are where they were",
            distance_m * 1e3
        ),
        _ => format!("what is there does not look like {band}: are click, length and diameter right?"),
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

/// Places along the tube that the rig does not know: the median arc between neighbours, from the chord and the angle it
/// makes with the coil's tangent, as if the tube were an arc of a circle.
fn place_bands(rig: &mut Rig, frames: &[Frame]) -> Result<(), MarkersError> {
    if rig.markers.iter().all(|m| m.centre_m.is_some()) {
        return Ok(());
    }
    let estimates = track(rig, frames)?;
    let coil = rig.catheter.coil;
    let mut at = rig.markers.first().map_or(0.0, |m| m.length_m / 2.0);
    for m in 0..rig.markers.len() {
        if m > 0 {
            let mut arcs: Vec<f64> = estimates
                .iter()
                .filter_map(|e| {
                    let place = |m: usize| Some(e.markers.get(m)?.position.as_ref().ok()?.point);
                    let chord = place(m)? - place(m - 1)?;
                    // Only beside the coil is a tangent known; elsewhere the chord has to do.
                    let angle = match e.tangent.as_ref().ok().filter(|_| m == coil || m == coil + 1) {
                        Some(tangent) => tangent.direction.angle(&chord),
                        None => 0.0,
                    };
                    Some(chord.norm() * if angle > 1e-6 { angle / angle.sin() } else { 1.0 })
                })
                .collect();
            if arcs.is_empty() {
                return Ok(());
            }
            arcs.sort_by(f64::total_cmp);
            at += arcs[arcs.len() / 2];
        }
        rig.markers[m].centre_m = Some(at);
    }
    // The arcs are refined by what the pictures show where bands are fitted together.
    let free: Vec<usize> = (1..rig.markers.len()).filter(|&m| m == coil || m == coil + 1).collect();
    let some = every(frames, TUNING_FRAMES);
    for m in free {
        let start = rig.markers[m].centre_m.unwrap_or(at) - rig.markers[m - 1].centre_m.unwrap_or(0.0);
        let shifted = |arc: f64| {
            let mut shifted = rig.clone();
            for later in &mut shifted.markers[m..] {
                later.centre_m = later.centre_m.map(|c| c + arc - start);
            }
            shifted
        };
        if let Some(best) = minimise(start, 0.2e-3, (start * 0.9, start * 1.1), |arc| misfit(&shifted(arc), &some)) {
            // No curvature: the two are not fitted together, so that the pictures say nothing about it.
            if best.curvature > 0.0 {
                *rig = shifted(best.at);
            }
        }
    }
    Ok(())
}

/// Blur and chroma offset.
fn tune(rig: &mut Rig, frames: &[Frame]) -> Result<(), MarkersError> {
    let some = every(frames, TUNING_FRAMES);
    let subsampled = some.first().is_some_and(|f| f.picture.plane(1).is_some_and(|plane| plane.scale != [1, 1]));
    let mut blur = rig.camera.blur_px.unwrap_or(0.6);
    // Blur and offsets hardly depend on each other: a second pass only polishes.
    for pass in 0..2 {
        let finer = if pass == 0 { 1.0 } else { 0.5 };
        let with_blur = |blur: f64| {
            let mut changed = rig.clone();
            changed.camera.blur_px = Some(blur);
            changed
        };
        if let Some(best) = minimise(blur, 0.1 * finer, (0.3, 3.0), |b| misfit(&with_blur(b), &some)) {
            blur = best.at;
        }
        *rig = with_blur(blur);
        for axis in 0..2 {
            let with_offset = |offset: f64| {
                let mut changed = rig.clone();
                changed.camera.chroma_offset_px[axis] = offset;
                changed
            };
            let start = rig.camera.chroma_offset_px[axis];
            let best = subsampled
                .then(|| minimise(start, 0.3 * finer, (-1.5, 1.5), |offset| misfit(&with_offset(offset), &some)));
            if let Some(best) = best.flatten() {
                *rig = with_offset(best.at);
            }
        }
    }
    // Three decimals are more than the pictures can tell.
    let round = |v: f64| (v * 1e3).round() / 1e3;
    rig.camera.blur_px = rig.camera.blur_px.map(round);
    rig.camera.chroma_offset_px = rig.camera.chroma_offset_px.map(round);
    Ok(())
}

/// At most `count` of the frames, spread evenly.
fn every(frames: &[Frame], count: usize) -> Vec<&Frame> {
    frames.iter().step_by(frames.len().div_ceil(count).max(1)).collect()
}

/// How badly the rig explains the pictures: the mean of the fits' misfits; `None` when a frame cannot be fitted.
fn misfit(rig: &Rig, frames: &[&Frame]) -> Option<f64> {
    let mut tracker = Tracker::new(rig, TrackOptions::default()).ok()?;
    let misfits: Vec<f64> = frames.iter().filter_map(|frame| tracker.misfit(frame)).collect();
    (misfits.len() * 2 > frames.len()).then(|| misfits.iter().sum::<f64>() / misfits.len() as f64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sink::fixture;
    use crate::source::{Clock, Colour, Picture, PixelFormat, Timestamp};

    /// A white tube with three bands, 7 px wide, in 4:2:0; its edges are as soft as a lens makes them.
    fn hanging_on(ground: [f64; 3]) -> Frame {
        const SIZE: [usize; 2] = [120, 280];
        let albedo = |y: f64| match y {
            30.0..43.0 => [0.45, 0.33, 0.04],
            190.0..215.0 => [0.04, 0.22, 0.06],
            242.0..255.0 => [0.04, 0.08, 0.35],
            _ => [0.62, 0.62, 0.63],
        };
        let encode = |light: f64| (1.055 * light.powf(1.0 / 2.4) - 0.055) * 255.0;
        let rgb = |x: usize, y: usize| {
            let mut light = [0.0; 3];
            for k in 0..64 {
                let at = |i: usize, k: usize| i as f64 + (k as f64 + 0.5) / 4.0 - 1.0;
                let (px, py) = (at(x, k % 8), at(y, k / 8));
                let seen = if (px - 60.2).abs() < 3.5 && (20.0..255.0).contains(&py) { albedo(py) } else { ground };
                light.iter_mut().zip(seen).for_each(|(sum, v)| *sum += 0.6 * v / 64.0);
            }
            light.map(encode)
        };
        let format = PixelFormat::Yuv { chroma_log2: [1, 1] };
        let plane = |channel: usize| {
            let step = if channel == 0 { 1 } else { 2 };
            let (weights, constant) = Colour::SRGB.channel_from_rgb(format, channel);
            let stored = |x, y| rgb(x, y).iter().zip(weights).map(|(v, w)| v * w).sum::<f64>() + constant;
            let mean = |x: usize, y: usize| {
                let near = (0..step * step).map(|k| stored(x * step + k % step, y * step + k / step));
                (near.sum::<f64>() / (step * step) as f64).round() as u8
            };
            (0..SIZE[1] / step)
                .flat_map(|y| (0..SIZE[0] / step).map(move |x| (x, y)))
                .map(|(x, y)| mean(x, y))
                .collect()
        };
        let planes = (0..3).map(plane).collect();
        let picture = Picture::from_planes(SIZE[0] as u32, SIZE[1] as u32, format, Colour::SRGB, planes).unwrap();
        Frame { seq: 0, stamp: Timestamp { ns: 0, clock: Clock::Container }, gap: 0, host: None, picture }
    }

    /// On a dark ground a band's blob reaches into the tube beside it; learning from it must not draw the tube in.
    #[test]
    fn bands_stay_bands_whatever_they_hang_before() {
        for ground in [[0.02, 0.02, 0.018], [0.13, 0.13, 0.12], [0.4, 0.39, 0.36]] {
            let frame = hanging_on(ground);
            let pick = |name: &str, y, length_m| Pick { name: name.into(), pixel: Point2::new(60.0, y), length_m };
            let picks = [pick("base", 36.0, 6e-3), pick("coil", 202.0, 12e-3), pick("tip", 248.0, 6e-3)];
            let rig = learn_first(&fixture::rig(), &picks, &frame).unwrap();
            for marker in &rig.markers {
                let model = marker.colour.unwrap();
                let white = model.weights.sum() * 190.0 + model.bias;
                assert!(white < 0.15, "{ground:?}: the tube scores {white:.2} as `{}`", marker.name);
            }
            let mut segmenter = Segmenter::for_rig(&rig).unwrap();
            let blobs = segmenter.all_blobs(&frame.picture).unwrap();
            let found: Vec<(usize, u32, u32)> = blobs.iter().map(|b| (b.marker, b.bounds.y0, b.bounds.y1)).collect();
            assert_eq!(found.len(), 3, "{ground:?}: {found:?}");
            for ((m, low, high), (from, to)) in found.into_iter().zip([(30, 43), (190, 215), (242, 255)]) {
                assert!(low + 4 >= from && high <= to + 4, "{ground:?}: marker {m} from {low} to {high}");
            }
        }
    }
}
