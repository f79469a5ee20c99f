//! What makes the pictures fit best: places of the bands along the tube, blur of the lens, offset of the chroma samples.

use crate::calibrate::markers::line_search::minimise;
use crate::calibrate::markers::{MarkersError, track};
use crate::rig::Rig;
use crate::source::Frame;
use crate::track::{TrackOptions, Tracker};

/// Frames that decide.
const TUNING_FRAMES: usize = 12;

/// Places along the tube that the rig does not know: the median arc between neighbours, from the chord and the angle it
/// makes with the coil's tangent, as if the tube were an arc of a circle.
pub(super) fn place_bands(rig: &mut Rig, frames: &[Frame]) -> Result<(), MarkersError> {
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
pub(super) fn tune(rig: &mut Rig, frames: &[Frame]) -> Result<(), MarkersError> {
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
