//! Exposure of the pictures, from their motion blur.
//!
//! In: pairs of frames that follow each other. Out: the exposure; none where it cannot be seen.
//!
//! Method. Of the pairs in which the tube moves furthest, how well the image model fits is computed for exposures from
//! zero to the whole interval. The best one is found from each third of the pairs; their scatter is its σ. It counts
//! if the pairs that were not used to find it are fitted better with it than without: the best of many exposures fits
//! a little better also where there is no blur.

use crate::calibrate::markers::MarkersError;
use crate::calibrate::markers::compared::{LONGEST_PAIR_S, MIN_GAIN_SDS, PARTS, clipped, clipped_mean};
use crate::calibrate::markers::line_search::minimise;
use crate::estimate::MarkerEstimate;
use crate::median::upper_median;
use crate::rig::Rig;
use crate::source::Frame;
use crate::track::misfit_curve::mean_with_sd;
use crate::track::{TrackOptions, Tracker};

/// Number of exposures tried, from zero to the whole interval between two frames.
const EXPOSURES: usize = 9;
/// Pairs of frames that it is fitted to, the fastest.
const PAIRS: usize = 24;
/// A band that is this many σ from where it was has moved.
const MOVES_SDS: f64 = 4.0;
/// The least exposure that counts, as a fraction of the interval: blur over a tenth of the motion is negligible.
const MIN_PART: f64 = 0.1;

/// Two frames, one after the other.
struct Pair<'a> {
    frame: &'a Frame,
    next: &'a Frame,
    /// Largest way of a band, metres.
    way_m: f64,
    interval_s: f64,
}

/// Exposure of the pictures, seconds; `None` when it cannot be seen: too little motion, or too short an exposure.
pub(super) fn exposure_s(rig: &Rig, frames: &[Frame], followers: &[Frame]) -> Result<Option<f64>, MarkersError> {
    let moving = moving(rig, frames, followers)?;
    let Some(interval_s) = moving.first().map(|pair| pair.interval_s) else { return Ok(None) };
    let step_s = interval_s / (EXPOSURES - 1) as f64;
    // How well each exposure fits each pair; a pair that one of them cannot fit at all is not used.
    let curve = |pair: &Pair<'_>| -> Option<Vec<f64>> {
        let misfit = |i: usize| {
            let mut changed = rig.clone();
            changed.camera.exposure_s = Some(i as f64 * step_s);
            Tracker::new(&changed, TrackOptions::default()).ok()?.misfit_after(pair.frame, pair.next)
        };
        let misfits = (0..EXPOSURES).map(misfit).collect::<Option<Vec<_>>>()?;
        let middle = upper_median(misfits.iter().copied())?;
        Some(misfits.iter().map(|misfit| misfit - middle).collect())
    };
    let curves: Vec<Vec<f64>> = moving.iter().filter_map(curve).take(PAIRS).collect();
    if curves.len() < 2 * PARTS {
        return Ok(None);
    }
    let of_part = |part: usize| curves.iter().skip(part).step_by(PARTS);
    let best = (0..PARTS).map(|part| {
        let all = |i: usize| of_part(part).map(|curve| curve[i]).collect::<Vec<_>>();
        let at = |s: f64| Some(clipped_mean(&all((s / step_s).round() as usize)));
        Some(minimise(step_s * (EXPOSURES / 2) as f64, step_s, (0.0, interval_s * (1.0 + 1e-9)), at)?.at)
    });
    let Some(best) = best.collect::<Option<Vec<f64>>>() else { return Ok(None) };
    let (mean, sd) = mean_with_sd(&best);
    // With the exposure that the part before found.
    let gains = (0..PARTS).zip(best.iter().cycle().skip(PARTS - 1)).flat_map(|(part, other)| {
        let tried = (other / step_s).round() as usize;
        of_part(part).filter_map(move |curve| Some(curve.first()? - curve.get(tried)?))
    });
    let (gain, gain_sd) = mean_with_sd(&clipped(&gains.collect::<Vec<_>>()));
    tracing::debug!(
        "exposure from thirds of {} pairs of frames: {best:?} s; ln σ² less by {gain:.2e} ± {gain_sd:.1e} with it",
        curves.len()
    );
    let is_seen = mean > MIN_GAIN_SDS * sd && mean > MIN_PART * interval_s;
    // Microseconds are beyond the accuracy.
    Ok((is_seen && gain > MIN_GAIN_SDS * gain_sd).then(|| (mean * 1e6).round() / 1e6))
}

/// The pairs in which a band moves, those with the longest way first.
fn moving<'a>(rig: &Rig, frames: &'a [Frame], followers: &'a [Frame]) -> Result<Vec<Pair<'a>>, MarkersError> {
    let mut all: Vec<&Frame> = frames.iter().chain(followers).collect();
    all.sort_by_key(|frame| frame.stamp.ns);
    let mut moving = Vec::new();
    for pair in all.windows(2) {
        let (frame, next) = (pair[0], pair[1]);
        let interval_s = next.stamp.seconds_since(frame.stamp);
        if !(interval_s > 0.0 && interval_s < LONGEST_PAIR_S) {
            continue;
        }
        let mut tracker = Tracker::new(rig, TrackOptions::default())?;
        let (before, after) = (tracker.step(frame)?, tracker.step(next)?);
        // Way and its σ; all bands must be seen.
        let way = |(a, b): (&MarkerEstimate, &MarkerEstimate)| {
            let (a, b) = (a.position.as_ref().ok()?, b.position.as_ref().ok()?);
            Some(((b.point - a.point).norm(), a.sd_m().hypot(b.sd_m())))
        };
        let ways: Option<Vec<(f64, f64)>> = before.markers.iter().zip(&after.markers).map(way).collect();
        let Some(ways) = ways else { continue };
        if ways.iter().any(|(way_m, sd_m)| *way_m > MOVES_SDS * sd_m) {
            let way_m = ways.iter().map(|(way_m, _)| *way_m).fold(0.0, f64::max);
            moving.push(Pair { frame, next, way_m, interval_s });
        }
    }
    moving.sort_by(|a, b| b.way_m.total_cmp(&a.way_m));
    Ok(moving)
}
