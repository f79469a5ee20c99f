//! Parameters fitted to the pictures: places of the bands along the tube, blur of the lens, offset and reach of the
//! chroma samples, gamma, exposure.

use crate::calibrate::markers::compared::{Compared, MIN_GAIN_SDS, PARTS, clipped};
use crate::calibrate::markers::line_search::minimise;
use crate::calibrate::markers::locate::candidates::px_per_m;
use crate::calibrate::markers::{MarkersError, motion_blur, track, view_blurs};
use crate::estimate::Estimate;
use crate::rig::{Camera, Marker, Rig};
use crate::source::{Frame, Picture, Timestamp};
use crate::track::LONGEST_EXPOSURE;
use crate::track::misfit_curve::mean_with_sd;
use crate::track::{TrackOptions, Tracker};

/// Frames used for the fit, and for the decision whether a gamma is needed.
const TUNING_FRAMES: usize = 12;
const JUDGING_FRAMES: usize = 48;
/// How often chroma of pixels is measured again at the place where it was found: far off it looks nearer than it is.
const SLIP_STEPS: usize = 3;

/// How far the tube between two bands may deviate from a circular arc: its excess length over the chord is uncertain by
/// this fraction of chord · ψ², where ψ is the angle between the chord and the coil's tangent (an arc is longer by 1/6
/// of it).
const NO_ARC: f64 = 0.2;
/// Least σ of the distance of two bands in one frame, metres.
const MIN_SD_M: f64 = 0.05e-3;
/// Where the search for blur begins, and its step, pixels.
const FIRST_BLUR_PX: f64 = 0.6;
const BLUR_STEP_PX: f64 = 0.1;
/// Step of the search for an offset of chroma samples, and its limits, pixels; the same for their reach, in distances
/// between samples: from the nearest pixels to the next samples.
const CHROMA_STEP_PX: f64 = 0.3;
const CHROMA_LIMITS_PX: (f64, f64) = (-1.5, 1.5);
const CHROMA_REACH_STEP: f64 = 0.2;
const CHROMA_REACH_LIMITS: (f64, f64) = (0.5, 1.0);
/// Where the search for gamma begins, its step, and its limits; it counts from a mean ln σ² of the residuals that is
/// smaller by this much, and by [`MIN_GAIN_SDS`].
const FIRST_GAMMA: f64 = 0.5;
const GAMMA_STEP: f64 = 0.1;
const GAMMAS: (f64, f64) = (0.25, 1.4);
const MIN_GAIN: f64 = 0.001;
/// Where the search for the rounding of the tube's end begins, its step and longest, and the least that counts, radii.
const FIRST_ROUNDING: f64 = 0.7;
const ROUNDING_STEP: f64 = 0.2;
const ROUNDINGS: (f64, f64) = (0.05, 2.0);
const MIN_ROUNDING: f64 = 0.15;
/// Part of the last band that may be round.
const MOST_OF_BAND: f64 = 0.7;
/// Step of the search for a band's length, and its limits, as ratios to the given one.
const LENGTH_STEP: f64 = 0.05;
const LENGTHS: (f64, f64) = (0.74, 1.36);
/// A search that ends further from where it began than this part of the length is repeated from there; most searches.
const LENGTH_SETTLED: f64 = 0.01;
const MOST_SEARCHES: usize = 4;

/// Finds places along the tube that the rig lacks, from those that it has, or else from the outer edge of the first
/// band; returns the σ of each band's distance from the one before, metres; `None` where it was known or is not found.
///
/// An arc is measured as a chord: all frames count, most of all those in which the tube is straight.
pub(super) fn place_bands(rig: &mut Rig, frames: &[Frame]) -> Result<Vec<Option<f64>>, MarkersError> {
    let mut sd_m = vec![None; rig.markers.len()];
    if rig.markers.iter().all(|m| m.centre_m.is_some()) {
        return Ok(sd_m);
    }
    let (tracker, estimates) = track(rig, frames)?;
    let along_px = frames.first().map_or(0.0, |frame| tracker.lasting_error(&frame.picture).along_px);
    let coil = rig.catheter.coil;
    let known: Vec<bool> = rig.markers.iter().map(|m| m.centre_m.is_some()).collect();
    let first = known.iter().position(|known| *known).unwrap_or_else(|| {
        rig.markers.iter_mut().take(1).for_each(|m| m.centre_m = Some(m.length_m / 2.0));
        0
    });
    // Of a band from the one before: distance and σ.
    let distance = |m: usize| {
        let beside_coil = m == coil || m == coil + 1;
        let arcs: Vec<(f64, f64)> = estimates.iter().filter_map(|e| arc(e, m, beside_coil)).collect();
        let (arc_m, sd) = combined(&arcs, beside_coil)?;
        Some((arc_m, sd.hypot(places_sd_m(&estimates, m))))
    };
    let behind = (first + 1..rig.markers.len()).map(|m| (m, m - 1));
    let before = (0..first).rev().map(|m| (m, m + 1));
    for (m, from) in behind.chain(before).filter(|(m, _)| !known[*m]) {
        let later = m.max(from);
        let (Some(from_m), Some((arc_m, sd))) = (rig.markers[from].centre_m, distance(later)) else { return Ok(sd_m) };
        rig.markers[m].centre_m = Some(if from < m { from_m + arc_m } else { from_m - arc_m });
        sd_m[later] = Some(sd);
    }
    // Where bands are fitted together, the pictures give more information.
    let some = every(frames, TUNING_FRAMES);
    for m in (1..rig.markers.len()).filter(|&m| (m == coil || m == coil + 1) && !(known[m] && known[m - 1])) {
        let (Some(from_m), Some(to_m)) = (rig.markers[m - 1].centre_m, rig.markers[m].centre_m) else { continue };
        let start = to_m - from_m;
        // What was known stays: the bands behind are moved, up to the next known one, or those before.
        let (moved, sign) = if known[m] {
            (known[..m].iter().rposition(|known| *known).map_or(0, |last| last + 1)..m, -1.0)
        } else {
            (m..known[m..].iter().position(|known| *known).map_or(known.len(), |next| m + next), 1.0)
        };
        let shifted = |arc: f64| {
            let mut shifted = rig.clone();
            for marker in &mut shifted.markers[moved.clone()] {
                marker.centre_m = marker.centre_m.map(|c| c + sign * (arc - start));
            }
            shifted
        };
        if let Some((mean, sd)) = determined(rig, &some, start, 0.2e-3, (start * 0.9, start * 1.1), shifted) {
            sd_m[m] = Some(sd.hypot(seen_off_m(rig, &estimates, m, along_px)));
            *rig = shifted(mean);
        }
    }
    Ok(sd_m)
}

/// σ along the chord of the positions of a marker and the one before it, common to all frames, because errors of the
/// image model at a band's end do not average out, metres.
fn places_sd_m(estimates: &[Estimate], m: usize) -> f64 {
    let variances: Vec<f64> = estimates
        .iter()
        .filter_map(|e| {
            let place = |m: usize| e.markers.get(m)?.position.as_ref().ok();
            let (a, b) = (place(m - 1)?, place(m)?);
            let along = (b.point - a.point).normalize();
            Some(along.dot(&((a.covariance + b.covariance) * along)))
        })
        .collect();
    (variances.iter().sum::<f64>() / variances.len().max(1) as f64).sqrt()
}

/// σ of the distance of a marker from the one before it that all frames have in common, metres: each view shows each
/// band off along the tube by so many pixels, independently of the others.
fn seen_off_m(rig: &Rig, estimates: &[Estimate], m: usize, along_px: f64) -> f64 {
    let of_band = |m: usize| {
        let point = estimates.iter().find_map(|e| Some(e.markers.get(m)?.position.as_ref().ok()?.point))?;
        let m_per_px: Vec<f64> = rig.views.iter().filter_map(|view| Some(1.0 / px_per_m(view, &point)?)).collect();
        // Views count alike.
        let sum = m_per_px.iter().map(|m_per_px| m_per_px.powi(2)).sum::<f64>();
        (!m_per_px.is_empty()).then(|| sum / (m_per_px.len() as f64).powi(2))
    };
    along_px * [m - 1, m].iter().filter_map(|m| of_band(*m)).sum::<f64>().sqrt()
}

/// Circular arc between a marker and the one before it, and chord · ψ², metres.
fn arc(estimate: &Estimate, m: usize, beside_coil: bool) -> Option<(f64, f64)> {
    let place = |m: usize| Some(estimate.markers.get(m)?.position.as_ref().ok()?.point);
    let chord = place(m)? - place(m - 1)?;
    // A tangent is known only beside the coil; elsewhere the chord must do.
    let angle = match &estimate.tangent {
        Ok(tangent) if beside_coil => tangent.direction.angle(&chord),
        _ => 0.0,
    };
    let stretched = if angle > 1e-6 { angle / angle.sin() } else { 1.0 };
    Some((chord.norm() * stretched, chord.norm() * angle * angle))
}

/// The arc and its σ from those of all frames; where no tangent gives the bend of the tube, the longest chords count.
fn combined(arcs: &[(f64, f64)], bend_is_known: bool) -> Option<(f64, f64)> {
    if !bend_is_known {
        let mut chords: Vec<f64> = arcs.iter().map(|arc| arc.0).collect();
        chords.sort_by(f64::total_cmp);
        let long = *chords.get(chords.len() * 9 / 10)?;
        let median = *chords.get(chords.len() / 2)?;
        return Some((long, (long - median).max(MIN_SD_M)));
    }
    let weight = |bend: f64| 1.0 / (MIN_SD_M.powi(2) + (NO_ARC * bend).powi(2));
    let sum: f64 = arcs.iter().map(|arc| weight(arc.1)).sum();
    let mean = |of: &dyn Fn(&(f64, f64)) -> f64| arcs.iter().map(|arc| weight(arc.1) * of(arc)).sum::<f64>() / sum;
    let at = mean(&|arc| arc.0);
    let effective = sum.powi(2) / arcs.iter().map(|arc| weight(arc.1).powi(2)).sum::<f64>();
    let scatter = (mean(&|arc| (arc.0 - at).powi(2)) / effective.max(1.0)).sqrt();
    // The error of the bend has the same sign in all frames.
    let shape = mean(&|arc| NO_ARC * arc.1);
    (!arcs.is_empty()).then(|| (at, (scatter.powi(2) + shape.powi(2) + (0.3 * MIN_SD_M).powi(2)).sqrt()))
}

/// The length, metres, with which the pictures are explained best, from independent parts of the frames, with its σ;
/// `None` where they do not determine it. `with` is the rig with another length.
fn determined(
    rig: &Rig,
    frames: &[&Frame],
    start: f64,
    step: f64,
    limits: (f64, f64),
    with: impl Fn(f64) -> Rig,
) -> Option<(f64, f64)> {
    let parts = (0..PARTS).map(|part| {
        let compared = Compared::with(rig, frames.iter().skip(part).step_by(PARTS).copied().collect(), &[]);
        let best = minimise(start, step, limits, |length_m| compared.excess(&with(length_m)))?;
        // No curvature: what it changes is not fitted, or not together.
        (best.curvature > 0.0).then_some(best.at)
    });
    Some(mean_with_sd(&parts.collect::<Option<Vec<f64>>>()?))
}

/// The lengths of coil and next band with which the pictures are explained best, metres, with σ; `None` for other
/// bands, whose ends do not all lie in the fitted stretch or may be covered by the clamp, and where the pictures do not
/// tell.
pub(super) fn lengths_m(rig: &Rig, frames: &[Frame]) -> Vec<Option<(f64, f64)>> {
    let some = every(frames, TUNING_FRAMES);
    let coil = rig.catheter.coil;
    let fitted = |(m, marker): (usize, &Marker)| {
        if m != coil && m != coil + 1 {
            return None;
        }
        let with = |length_m: f64| {
            let mut changed = rig.clone();
            changed.markers[m].length_m = length_m;
            changed
        };
        let given = marker.length_m;
        let limits = (given * LENGTHS.0, given * LENGTHS.1);
        // Far from the given one it is found too close to it.
        let (mut mean, mut sd) = (given, 0.0);
        for _ in 0..MOST_SEARCHES {
            let start = mean;
            (mean, sd) = determined(&with(start), &some, start, given * LENGTH_STEP, limits, with)?;
            if (mean - start).abs() < given * LENGTH_SETTLED {
                break;
            }
        }
        tracing::debug!("{} fits best with a length of {:.3} ± {:.3} mm", marker.name, mean * 1e3, sd * 1e3);
        Some((mean, sd))
    };
    rig.markers.iter().enumerate().map(fitted).collect()
}

/// Blur, chroma offset, gamma and, unless it is stated, exposure; returns σ of each view's blur, pixels. A wrong gamma
/// and motion both look like blur: once they are known, blur is fitted again.
pub(super) fn tune(rig: &mut Rig, frames: &[Frame], followers: &[Frame]) -> Result<Vec<Option<f64>>, MarkersError> {
    if let (Some(exposure_s), Some(interval_s)) = (rig.camera.exposure_s, interval_s(frames, followers))
        && exposure_s > LONGEST_EXPOSURE * interval_s
    {
        return Err(MarkersError::Exposure { exposure_ms: exposure_s * 1e3, interval_ms: interval_s * 1e3 });
    }
    let reach = chroma_is_as_sampled(rig, frames);
    sharpen(rig, frames, followers, reach);
    rig.camera.gamma = gamma(rig, frames, followers);
    if rig.camera.gamma.is_some() {
        sharpen(rig, frames, followers, reach);
    }
    rig.catheter.end_rounding_m = end_rounding_m(rig, frames, followers);
    if rig.catheter.end_rounding_m.is_some() {
        sharpen(rig, frames, followers, reach);
    }
    if rig.camera.exposure_s.is_none() {
        rig.camera.exposure_s = motion_blur::exposure_s(rig, frames, followers)?;
        if rig.camera.exposure_s.is_some() {
            sharpen(rig, frames, followers, reach);
        }
    }
    // Last: motion that is not modelled blurs views differently.
    Ok(view_blurs::find(rig, &every(frames, JUDGING_FRAMES), followers))
}

/// The power of light that the camera stores, where it explains the pictures clearly better than the transfer function
/// that the recording declares: cameras for machine vision store light as it is and say nothing, and converted
/// recordings are often tagged wrongly. Light mixes at the edges of bands and tube, so they show it.
fn gamma(rig: &Rig, frames: &[Frame], followers: &[Frame]) -> Option<f64> {
    let some = every(frames, TUNING_FRAMES);
    let with = |gamma: f64| {
        let mut changed = rig.clone();
        changed.camera.gamma = Some(gamma);
        changed
    };
    let gammas = (0..PARTS).map(|part| {
        let frames: Vec<&Frame> = some.iter().skip(part).step_by(PARTS).copied().collect();
        let compared = Compared::with(rig, frames, followers);
        Some(minimise(FIRST_GAMMA, GAMMA_STEP, GAMMAS, |gamma| compared.excess(&with(gamma)))?.at)
    });
    let (gamma, sd) = mean_with_sd(&gammas.collect::<Option<Vec<_>>>()?);
    tracing::debug!("gamma {gamma:.3} ± {sd:.3}");
    let mut declared = rig.clone();
    declared.camera.gamma = None;
    is_clearly_better(&declared, &with(gamma), frames, followers).then(|| (gamma * 1e3).round() / 1e3)
}

/// Whether another rig explains the pictures clearly better. (Each frame is compared: a few would tell too little of
/// the scatter.)
fn is_clearly_better(rig: &Rig, other: &Rig, frames: &[Frame], followers: &[Frame]) -> bool {
    let Some(excesses) = Compared::with(rig, every(frames, JUDGING_FRAMES), followers).excesses(other) else {
        return false;
    };
    let gains: Vec<f64> = excesses.into_iter().map(|excess| -excess).collect();
    let (gain, gain_sd) = mean_with_sd(&clipped(&gains));
    tracing::debug!("explained better by {gain:.4} ± {gain_sd:.4}");
    gain > MIN_GAIN.max(MIN_GAIN_SDS * gain_sd)
}

/// Length over which the tube's end is rounded, metres, where that explains the pictures clearly better than an end
/// that is cut straight.
fn end_rounding_m(rig: &Rig, frames: &[Frame], followers: &[Frame]) -> Option<f64> {
    let end = rig.markers.get(rig.catheter.end?)?;
    let mut straight = rig.clone();
    straight.catheter.end_rounding_m = None;
    let with = |rounding_m: f64| {
        let mut changed = straight.clone();
        changed.catheter.end_rounding_m = Some(rounding_m);
        changed
    };
    let radius_m = rig.catheter.diameter_m / 2.0;
    let limits = (ROUNDINGS.0 * radius_m, (MOST_OF_BAND * end.length_m).min(ROUNDINGS.1 * radius_m));
    let [start, step] = [FIRST_ROUNDING, ROUNDING_STEP].map(|radii| radii * radius_m);
    if start + step > limits.1 {
        return None;
    }
    let some = every(frames, TUNING_FRAMES);
    let (rounding_m, sd_m) = determined(&straight, &some, start, step, limits, with)?;
    tracing::debug!("the end is rounded over {:.3} ± {:.3} mm", rounding_m * 1e3, sd_m * 1e3);
    let counts = rounding_m > MIN_ROUNDING * radius_m && rounding_m > MIN_GAIN_SDS * sd_m;
    (counts && is_clearly_better(&straight, &with(rounding_m), frames, followers))
        .then_some((rounding_m * 1e6).round() / 1e6)
}

/// Whether samples of chroma show how far they reached: a coder that predicts pictures has smoothed chroma more than
/// whatever sampled it, and so have copies of its pictures.
fn chroma_is_as_sampled(rig: &Rig, frames: &[Frame]) -> bool {
    let some = every(frames, TUNING_FRAMES);
    let Some(picture) = some.first().map(|frame| &frame.picture) else { return false };
    let has_noise = || Tracker::new(rig, TrackOptions::default()).is_ok_and(|mut t| t.have_sensor_noise(&some));
    picture.format().is_subsampled() && picture.quantisation().map_or_else(has_noise, |q| !q.predicted)
}

/// Blur, common to all views; where the samples of chroma are and, if asked for, how far they reach.
fn sharpen(rig: &mut Rig, frames: &[Frame], followers: &[Frame], reach: bool) {
    let some = every(frames, TUNING_FRAMES);
    let pictures_are = |are: fn(&Picture) -> bool| some.first().is_some_and(|frame| are(&frame.picture));
    let subsampled = pictures_are(|picture| picture.format().is_subsampled());
    rig.camera.blur_px.get_or_insert(FIRST_BLUR_PX);
    // They hardly depend on each other, but for blur and reach: a second pass only polishes.
    for finer in [1.0, 0.5] {
        let compared = Compared::with(rig, some.clone(), followers);
        let fit = |rig: &mut Rig, step: f64, limits: (f64, f64), of: &dyn Fn(&mut Camera) -> &mut f64| {
            let start = *of(&mut rig.camera);
            let with = |value: f64| {
                let mut changed = rig.clone();
                *of(&mut changed.camera) = value;
                changed
            };
            if let Some(best) = minimise(start, step * finer, limits, |value| compared.excess(&with(value))) {
                *rig = with(best.at.clamp(limits.0, limits.1));
            }
        };
        fit(rig, BLUR_STEP_PX, view_blurs::LIMITS_PX, &|camera| camera.blur_px.get_or_insert(FIRST_BLUR_PX));
        for axis in 0..2 {
            if subsampled {
                fit(rig, CHROMA_STEP_PX, CHROMA_LIMITS_PX, &|camera| &mut camera.chroma_offset_px[axis]);
            }
            if reach {
                fit(rig, CHROMA_REACH_STEP, CHROMA_REACH_LIMITS, &|camera| &mut camera.chroma_reach[axis]);
            }
        }
        // Where each pixel has its own chroma, misfits of two offsets may be those of different channels.
        let per_pixel = pictures_are(|picture| picture.format().has_chroma_per_pixel());
        for _ in 0..if per_pixel { SLIP_STEPS } else { 0 } {
            let Ok(mut tracker) = Tracker::new(rig, TrackOptions::default()) else { break };
            let slip_px = tracker.mean_slip_px(&some);
            (0..2).for_each(|axis| rig.camera.colour_offset_px[axis] -= slip_px[axis]);
        }
    }
    // Three decimals are beyond the accuracy.
    let round = |v: f64| (v * 1e3).round() / 1e3;
    rig.camera.blur_px = rig.camera.blur_px.map(round);
    rig.camera.chroma_offset_px = rig.camera.chroma_offset_px.map(round);
    rig.camera.chroma_reach = rig.camera.chroma_reach.map(round);
    rig.camera.colour_offset_px = rig.camera.colour_offset_px.map(round);
}

/// The time from a frame to its follower, seconds: a quarter of all steps are no longer. (Single stamps may be off.)
fn interval_s(frames: &[Frame], followers: &[Frame]) -> Option<f64> {
    let mut stamps: Vec<Timestamp> = frames.iter().chain(followers).map(|frame| frame.stamp).collect();
    stamps.sort_by_key(|stamp| stamp.ns);
    let steps = stamps.windows(2).filter_map(|pair| Some(pair.get(1)?.seconds_since(*pair.first()?)));
    let mut steps: Vec<f64> = steps.filter(|step_s| *step_s > 0.0).collect();
    steps.sort_by(f64::total_cmp);
    steps.get(steps.len() / 4).copied()
}

/// At most `count` of the frames, spread evenly.
fn every(frames: &[Frame], count: usize) -> Vec<&Frame> {
    frames.iter().step_by(frames.len().div_ceil(count).max(1)).collect()
}
