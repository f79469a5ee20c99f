//! Blur of each view. What a mirror shows is farther away, and a mirror may be dirty, so that one view may be less
//! sharp than the others; a lens is astigmatic towards the edge of its pictures, and scaled pictures are blurred along
//! one side. With a common, round blur bands are then off by some tenths of a pixel, and no residual tells.
//!
//! Method. Beginning with the common blur, the misfit with less and with more blur in one view gives the distance to
//! the best one, with σ from the scatter of the frames. Unless two views differ by a tenth or more, and that is no
//! chance, all share the common blur: it is known better. The same for the ratio of the blurs along x and along y,
//! which is 1 unless a view tells clearly that it is not.

use crate::calibrate::markers::compared::{Compared, clipped};
use crate::rig::Rig;
use crate::source::Frame;
use crate::track::misfit_curve::{Curve, Distance, SHAPE, SIZE, STEP, are_apart, changed};
use nalgebra::Vector2;

/// Difference from which views have blurs of their own, of the logarithm.
const APART: f64 = 0.1;
/// The same of the ratio of directions. Pose and image model move it by up to 0.16 (measured on seven recordings).
const DIRECTED: f64 = 0.2;
/// Limits of a blur, pixels.
pub(super) const LIMITS_PX: (f64, f64) = (0.3, 3.0);
/// Moves towards the best blurs, and how close they end, difference of the logarithm.
const MOST_MOVES: usize = 5;
const SETTLED: f64 = 0.02;
/// σ that all frames have in common, from errors of the image model, of the logarithm. Measured: in a lossless
/// recording with one view blurred by 0.8 pixels, 0.48 and 0.91 px were found where 0.467 and 0.926 px are right.
const MODEL_SD: f64 = 0.03;

/// Finds the views' blurs; returns σ of the size of that of each view from this view alone, pixels, `None` where it
/// does not tell.
pub(super) fn find(rig: &mut Rig, frames: &[&Frame], followers: &[Frame]) -> Vec<Option<f64>> {
    let mut sizes = distances(rig, frames, followers, SIZE);
    if are_apart(&sizes, APART) {
        sizes = approach(rig, frames, followers, &[SIZE]);
    }
    let is_directed = |curve: &Curve| curve.tells_shape() && curve.distance().is_some_and(|off| off.exceeds(DIRECTED));
    if curves(rig, frames, followers, SHAPE).iter().flatten().any(is_directed) {
        sizes = approach(rig, frames, followers, &[SHAPE, SIZE]);
    }
    // Three decimals are beyond the accuracy.
    let round = |blur_px: Vector2<f64>| blur_px.map(|px| (px * 1e3).round() / 1e3);
    rig.views.iter_mut().for_each(|view| view.blur_px = view.blur_px.map(round));
    let sd_px = |(blur_px, size): (Option<Vector2<f64>>, &Option<Distance>)| {
        let blur_px = blur_px?;
        Some((blur_px.x * blur_px.y).sqrt() * size.as_ref()?.sd.hypot(MODEL_SD))
    };
    rig.blurs_px().zip(&sizes).map(sd_px).collect()
}

/// Moves each view's blur along these ways, by turns, to the best one; returns how far that is along the last.
fn approach(rig: &mut Rig, frames: &[&Frame], followers: &[Frame], ways: &[Vector2<f64>]) -> Vec<Option<Distance>> {
    let mut last = Vec::new();
    for _ in 0..MOST_MOVES {
        let mut settled = true;
        for &way in ways {
            last = distances(rig, frames, followers, way);
            settled &= last.iter().flatten().all(|distance| distance.log.abs() < SETTLED);
            let moved = |(blur_px, distance): (Option<Vector2<f64>>, &Option<Distance>)| {
                let moved_px = changed(&blur_px?, way, distance.as_ref().map_or(0.0, |distance| distance.log));
                Some(moved_px.map(|px| px.clamp(LIMITS_PX.0, LIMITS_PX.1)))
            };
            let blurs_px: Vec<_> = rig.blurs_px().zip(&last).map(moved).collect();
            rig.views.iter_mut().zip(blurs_px).for_each(|(view, blur_px)| view.blur_px = blur_px);
        }
        if settled {
            break;
        }
    }
    last
}

/// How far the best blur of each view is, along a way.
fn distances(rig: &Rig, frames: &[&Frame], followers: &[Frame], way: Vector2<f64>) -> Vec<Option<Distance>> {
    let distances = curves(rig, frames, followers, way).into_iter().map(|curve| curve?.distance()).collect();
    tracing::debug!("the best blurs of the views are away by {distances:?}, along {way:?}");
    distances
}

/// How the misfit of each view changes with its blur, along a way.
fn curves(rig: &Rig, frames: &[&Frame], followers: &[Frame], way: Vector2<f64>) -> Vec<Option<Curve>> {
    let compared = Compared::with(rig, frames.to_vec(), followers);
    let of_view = |(v, blur_px): (usize, Option<Vector2<f64>>)| {
        let blur_px = blur_px?;
        let with = |log: f64| {
            let mut other = rig.clone();
            other.views[v].blur_px = Some(changed(&blur_px, way, log));
            other
        };
        let Curve { slopes, curvatures } = compared.curve(&with(-STEP), &with(STEP))?;
        Some(Curve { slopes: clipped(&slopes), curvatures: clipped(&curvatures) })
    };
    rig.blurs_px().enumerate().map(of_view).collect()
}
