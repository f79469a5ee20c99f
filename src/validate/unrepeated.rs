//! σ of a response from what does not repeat in its periods.
//!
//! In: the aligned points of the periods that count. Out: σ of a size and of a turn as these show it. It contains
//! errors that persist from frame to frame, of which the tracker's own σ knows nothing, and whatever else differs from
//! period to period: a motion that still settles, a middle that moves.
//!
//! Method. What repeats has only multiples of the path's frequency F; with P periods, what lies at F ± j F/P between
//! them is noise (Pintelon and Schoukens, System Identification, 2012, doi:10.1002/9781118287422, chapter 2). An error
//! of the size is the projection of all errors on the path around its middle, one of the phase that on the path's
//! direction of motion. Both projections, turned by cos and sin of 2π j k/(N P) at command k of N, see the noise beside
//! F alone; their mean square is its power at F if that changes little between F/P and 2F.
//!
//! What it cannot detect: an error that is the same in all periods.

use super::path::DesiredPath;
use super::step::Step;
use nalgebra::Vector3;
use std::f64::consts::TAU;

/// Most frequencies on each side of the path's own.
const NEIGHBOURS: usize = 4;

/// σ of the error of a whole motion's size, and of its turn times its size, metres. `None` with fewer than two periods.
pub(super) fn sd_m(path: &DesiredPath, steps: &[Step]) -> Option<f64> {
    let length = path.points.len();
    let periods = steps.len() / length;
    let errors: Vec<Option<Vector3<f64>>> = errors(steps.get(..periods * length)?, length);
    let count = errors.iter().flatten().count() as f64;
    let middle = path.points.iter().map(|point| point.coords).sum::<Vector3<f64>>() / length as f64;
    let (mut squares, mut all) = (0.0, 0);
    for j in 1..periods.min(NEIGHBOURS + 1) {
        for quarter in [0.0, 0.25] {
            let wave = |k: usize| (TAU * (j as f64 * k as f64 / (length * periods) as f64 - quarter)).cos();
            let radius = |k: usize| (path.point(k).coords - middle) * wave(k);
            let direction = |k: usize| (path.point(k + 1) - path.point(k + length - 1)) * wave(k);
            squares += square(&errors, radius)? + square(&errors, direction)?;
            all += 2;
        }
    }
    (all > 0).then(|| (squares / f64::from(all) / count).sqrt())
}

/// Each point minus the mean of the points of the same command in all periods.
fn errors(steps: &[Step], length: usize) -> Vec<Option<Vector3<f64>>> {
    let mean = |k: usize| {
        let points = || steps.iter().skip(k).step_by(length).filter_map(|step| step.aligned);
        points().map(|point| point.coords).sum::<Vector3<f64>>() / points().count() as f64
    };
    let means: Vec<Vector3<f64>> = (0..length).map(mean).collect();
    steps.iter().zip(means.iter().cycle()).map(|(step, mean)| Some(step.aligned?.coords - mean)).collect()
}

/// The squared projection of errors on a motion of size 1: σ² for independent errors of σ in each coordinate. `None`
/// for no motion.
fn square(errors: &[Option<Vector3<f64>>], motion: impl Fn(usize) -> Vector3<f64>) -> Option<f64> {
    let known = errors.iter().enumerate().filter_map(|(k, error)| Some((motion(k), (*error)?)));
    let (both, own) =
        known.fold((0.0, 0.0), |(both, own), (motion, error)| (both + motion.dot(&error), own + motion.norm_squared()));
    (own > 0.0).then(|| both * both / own)
}
