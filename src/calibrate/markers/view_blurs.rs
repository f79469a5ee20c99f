//! Blur of each view. What a mirror shows is farther away, and a mirror may be dirty, so that one view may be less
//! sharp than the others; with a common blur bands are then off by some tenths of a pixel, and no residual tells.
//!
//! Method. Beginning with the common blur, the misfit with less and with more blur in one view gives the distance to
//! the best one, with σ from the scatter of the frames. Unless two views differ by a tenth or more, and that is no
//! chance, all share the common blur: it is known better.

use crate::calibrate::markers::compared::{Compared, clipped};
use crate::rig::Rig;
use crate::source::Frame;
use crate::track::misfit_curve::{Curve, Distance, STEP, are_apart};

/// Difference from which views have blurs of their own, of the logarithm.
const APART: f64 = 0.1;
/// Limits of a blur, pixels.
pub(super) const LIMITS_PX: (f64, f64) = (0.3, 3.0);
/// Moves towards the best blurs, and how close they end, difference of the logarithm.
const MOST_MOVES: usize = 5;
const SETTLED: f64 = 0.02;
/// σ that all frames have in common, from errors of the image model, of the logarithm. Measured: in a lossless
/// recording with one view blurred by 0.8 pixels, 0.48 and 0.91 px were found where 0.467 and 0.926 px are right.
const MODEL_SD: f64 = 0.03;

/// Finds the views' blurs; returns σ of that of each view from this view alone, pixels, `None` where it does not tell.
pub(super) fn find(rig: &mut Rig, frames: &[&Frame], followers: &[Frame]) -> Vec<Option<f64>> {
    let Some(common_px) = rig.camera.blur_px else { return vec![None; rig.views.len()] };
    let mut distances = distances(rig, frames, followers);
    if are_apart(&distances, APART) {
        for _ in 0..MOST_MOVES {
            for (view, distance) in rig.views.iter_mut().zip(&distances) {
                let factor = distance.as_ref().map_or(1.0, Distance::factor);
                view.blur_px = Some((view.blur_px.unwrap_or(common_px) * factor).clamp(LIMITS_PX.0, LIMITS_PX.1));
            }
            if distances.iter().flatten().all(|distance| distance.log.abs() < SETTLED) {
                break;
            }
            distances = self::distances(rig, frames, followers);
        }
    }
    // Three decimals are beyond the accuracy.
    rig.views.iter_mut().for_each(|view| view.blur_px = view.blur_px.map(|blur_px| (blur_px * 1e3).round() / 1e3));
    let blurs_px = rig.blurs_px().zip(&distances);
    blurs_px.map(|(blur_px, distance)| Some(blur_px? * (*distance)?.sd.hypot(MODEL_SD))).collect()
}

/// How far the best blur of each view is.
fn distances(rig: &Rig, frames: &[&Frame], followers: &[Frame]) -> Vec<Option<Distance>> {
    let compared = Compared::with(rig, frames.to_vec(), followers);
    let of_view = |v: usize| {
        let with = |log: f64| {
            let mut changed = rig.clone();
            changed.views[v].blur_px = rig.blurs_px().nth(v).flatten().map(|blur_px| blur_px * log.exp());
            changed
        };
        let Curve { slopes, curvatures } = compared.curve(&with(-STEP), &with(STEP))?;
        let distance = Curve { slopes: clipped(&slopes), curvatures: clipped(&curvatures) }.distance();
        tracing::debug!("the best blur of view `{}` is away by {distance:?}", rig.views[v].name);
        distance
    };
    (0..rig.views.len()).map(of_view).collect()
}
