//! Reasons to doubt a calibration's verdict: it assumes that the model is right and corners have only noise, which the
//! residuals may contradict.
//!
//! In: a calibration, the check on held-out pictures. Out: [`Diagnostic`]s.
//!
//! Residuals of pure noise are uncorrelated between neighbours; a bent mirror, a lens of another kind, or undeclared
//! water leave residuals that are correlated across the picture ([`neighbourhoods`]). If something moved, pictures
//! before and after it see different geometries (`moved.rs`).
//!
//! What is known of lens, distances and angles is compared with all the rest, boards taped to walls included.
//!
//! Cannot tell: errors of the model that other parameters absorb, such as a wrong thickness of the glass; a taped board
//! that is not flat on its wall.

use crate::calibrate::bundle::prior::Prior;
use crate::calibrate::bundle::{NoSolution, Solution};
use crate::calibrate::geometry::{Parameter, bounds};
use crate::calibrate::least_squares::sigmas;
use crate::calibrate::rig::RigCalibration;
use crate::calibrate::rig::held_out::{HeldOut, LengthErrors};
use crate::calibrate::rig::moved::{Moved, moved};
use nalgebra::{DMatrix, DVector, Point2, Vector2};
use std::collections::BTreeMap;

/// Neighbourhoods along the longer side of a view, and fewest corners for a meaningful mean.
const NEIGHBOURHOODS_ALONG: f64 = 7.0;
const MIN_CORNERS: usize = 6;
/// Ratio of neighbourhood means to those of noise above which they are not noise: for 20 neighbourhoods, five standard
/// deviations.
const CORRELATED_ABOVE: f64 = 1.5;
/// Priors and pictures contradict each other beyond this many standard deviations.
pub(crate) const CONTRADICTION_SD: f64 = 3.0;
/// The pictures' information on a value is compared if it is at least this fraction of all information on it.
const REDUNDANT: f64 = 1e-3;
/// The same of a combination of a lens' numbers. With less it is not linear where distances are hardly known: a lens
/// that pictures moved by 0.24 of its σ seemed 7 σ off, with a front wall known to 38 mm.
const REDUNDANT_OF_MANY: f64 = 1e-2;

/// A reason.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Diagnostic {
    /// Pictures before and after a moment that see different geometries.
    #[error(
        "something moved between {before} and {after}, by its looks {what}: the pictures before and after show two \
         geometries, {times:.1} times as far apart as their scatter explains. Errors are larger than stated: take the \
         pictures again, or use those of one side alone"
    )]
    Moved {
        /// What: a camera that turns often looks like a mirror that does.
        what: String,
        /// Name of the last picture before it.
        before: String,
        /// Name of the first picture after it.
        after: String,
        /// Difference, relative to the scatter.
        times: f64,
    },
    /// Correlated residuals.
    #[error(
        "corners of the {view} view that are neighbours are off together, {times:.1} times as much as noise explains: \
         is there water or glass that was not given, a mirror or a board that is not flat, another lens or focus than \
         calibrated, squares of another size? Did camera, mirror or tank move between two pictures?"
    )]
    Together {
        /// Name of the view.
        view: String,
        /// Length of the neighbourhoods' means, relative to noise.
        times: f64,
    },
    /// A lens without σ.
    #[error(
        "the rig file has no covariance of the lens (calibrate camera writes it): the lens is taken as exact, and no \
         σ contains its errors"
    )]
    ExactLens,
    /// Wrong lengths.
    #[error(
        "lengths of {nominal_mm:.0} mm on held-out boards are off {times:.1} times as much as noise explains: is the \
         board bent anew in each picture, or its print uneven? Was it moved during the exposure, or camera, mirror or \
         tank between two pictures?"
    )]
    Lengths {
        /// The length.
        nominal_mm: f64,
        /// RMS error, relative to noise.
        times: f64,
    },
    /// A print whose squares are not square.
    #[error(
        "the print is stretched: along its rows it is longer by {percent:.2} ± {sd_percent:.2} % than along its \
         columns. It is allowed for, with the mean of both sides as stated: measure the grid along both sides. Was it \
         so in the calibration of the lens?"
    )]
    Stretched {
        /// Longer along rows by so many per cent; negative if along columns.
        percent: f64,
        /// Its σ.
        sd_percent: f64,
    },
    /// A prior that is far from what the pictures give.
    #[error(
        "the pictures contradict {what} as it was given, by {off:.1} σ: is it right, and the size of the squares? Were \
         pictures flipped or turned, or taken with another lens, focus or zoom? Is the print stretched along one side? \
         In a tank: is it plain water of the stated temperature?"
    )]
    Prior {
        /// What.
        what: String,
        /// Difference in standard deviations.
        off: f64,
    },
}

/// Corners close to each other in a view.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Neighbourhood {
    /// Mean position, pixels.
    pub middle: Point2<f64>,
    /// Mean residual, pixels.
    pub mean_px: Vector2<f64>,
    /// How many corners.
    pub count: usize,
}

/// All reasons to doubt the verdict.
pub fn diagnose(done: &RigCalibration, held: &[Result<HeldOut, NoSolution>]) -> Vec<Diagnostic> {
    let mut doubts = Vec::new();
    if let Some(Moved { what, picture, evidence }) = moved(&done.solution) {
        let name = |picture: usize| done.solution.names.get(picture).cloned().unwrap_or_default();
        let (before, after) = (name(picture.saturating_sub(1)), name(picture));
        doubts.push(Diagnostic::Moved { what, before, after, times: evidence.sqrt() });
    }
    if !done.solution.free.contains(&Parameter::Focal(0)) {
        doubts.push(Diagnostic::ExactLens);
    }
    for (view, (name, _)) in done.solution.geometry.views.iter().enumerate() {
        if let Some(times) = neighbour_correlation(&residuals(done, view)).filter(|times| *times > CORRELATED_ABOVE) {
            doubts.push(Diagnostic::Together { view: name.clone(), times });
        }
    }
    let lengths = [
        LengthErrors::of(held.iter().flatten().flat_map(|h| &h.edges)),
        LengthErrors::of(held.iter().flatten().flat_map(|h| &h.diagonals)),
    ];
    for off in lengths.into_iter().flatten().filter(LengthErrors::beyond_noise) {
        doubts.push(Diagnostic::Lengths { nominal_mm: off.nominal_m * 1e3, times: off.rms_m / off.noise_m });
    }
    if let Some((stretch, sd)) = done.solution.shape.stretched(&done.solution.shape_covariance) {
        doubts.push(Diagnostic::Stretched { percent: 100.0 * stretch, sd_percent: 100.0 * sd });
    }
    for known in &done.solution.known {
        if let Some(Compared { off, .. }) = compared(&done.solution, known).filter(|rest| rest.off > CONTRADICTION_SD) {
            doubts.push(Diagnostic::Prior { what: known.what(&done.solution.geometry), off });
        }
    }
    doubts
}

/// A prior against the result of everything else.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Compared {
    /// How far they are apart, in their combined standard deviations.
    pub off: f64,
    /// σ of what everything else says, in σ of the prior; `None` for a prior of several numbers.
    pub rest_sd: Option<f64>,
}

/// Compares a prior with everything else. `None` when that has next to no information.
///
/// A prior's residual is small where the pictures have little information, so it is compared with its own covariance.
/// Poses are taken as solved.
pub(crate) fn compared(solution: &Solution, known: &Prior) -> Option<Compared> {
    let rows = known.rows(&solution.geometry, &solution.poses, &solution.free);
    let residuals = DVector::from_iterator(rows.len(), rows.iter().map(|row| row.residual));
    let mut by_geometry = DMatrix::zeros(rows.len(), solution.free.len());
    for (i, row) in rows.iter().enumerate() {
        by_geometry.row_mut(i).tr_copy_from(&row.by_geometry);
    }
    let seen = |covariance: &DMatrix<f64>| &by_geometry * covariance * by_geometry.transpose();
    let gain = seen(&solution.weighted_covariance);
    // The prior entered the solution with the weight of the search.
    let one = DMatrix::identity(rows.len(), rows.len());
    let left = (one - &gain * 2.0 + seen(&solution.covariance)).symmetric_eigen();
    let directions = left.eigenvalues.iter().zip(left.eigenvectors.column_iter());
    let least = if rows.len() == 1 { REDUNDANT } else { REDUNDANT_OF_MANY };
    let (squares, variances): (Vec<f64>, Vec<f64>) = directions
        .filter(|(variance, _)| **variance > least)
        .map(|(variance, direction)| (direction.dot(&residuals).powi(2) / variance, *variance))
        .unzip();
    // With the variance r of the rest, that of the prior being 1, and the gain K of the prior, the residual's variance
    // is (1 − K)² (1 + r).
    let rest_sd = |left: &f64| (left / (1.0 - gain[(0, 0)]).powi(2) - 1.0).max(0.0).sqrt();
    let rest_sd = (rows.len() == 1).then(|| variances.first().map(rest_sd));
    (!squares.is_empty())
        .then(|| Compared { off: sigmas(squares.iter().sum(), squares.len()), rest_sd: rest_sd.flatten() })
}

/// Positions and residuals of a view's corners, pixels.
pub(crate) fn residuals(done: &RigCalibration, view: usize) -> Vec<(Point2<f64>, Vector2<f64>)> {
    let all = done.corners.iter().zip(&done.solution.residuals_px);
    all.filter(|(c, _)| c.view == view).map(|(c, residual)| (c.pixel, *residual)).collect()
}

/// Means over squares of the picture with enough corners.
pub(crate) fn neighbourhoods(residuals: &[(Point2<f64>, Vector2<f64>)]) -> Vec<Neighbourhood> {
    let [low, high] = bounds(residuals.iter().map(|(p, _)| p.coords));
    let side = ((high - low).max() / NEIGHBOURHOODS_ALONG).max(1.0);
    let mut squares = BTreeMap::new();
    for (place, residual) in residuals {
        let at = (place.coords - low) / side;
        let (places, sum, count) =
            squares.entry((at.y as i64, at.x as i64)).or_insert((Vector2::zeros(), Vector2::zeros(), 0_usize));
        *places += place.coords;
        *sum += residual;
        *count += 1;
    }
    squares
        .into_values()
        .filter(|(.., count)| *count >= MIN_CORNERS)
        .map(|(places, sum, count)| {
            let n = count as f64;
            Neighbourhood { middle: Point2::from(places / n), mean_px: sum / n, count }
        })
        .collect()
}

/// Length of the neighbourhoods' means relative to those of independent residuals with the same RMS; `None` without
/// neighbourhoods or residuals.
pub(crate) fn neighbour_correlation(residuals: &[(Point2<f64>, Vector2<f64>)]) -> Option<f64> {
    let means = neighbourhoods(residuals);
    let mean_square = residuals.iter().map(|(_, r)| r.norm_squared()).sum::<f64>() / residuals.len().max(1) as f64;
    let sum = means.iter().map(|n| n.mean_px.norm_squared() * n.count as f64).sum::<f64>();
    (!means.is_empty() && mean_square > 0.0).then(|| (sum / means.len() as f64 / mean_square).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibrate::bundle::tests::bundle;
    use crate::calibrate::geometry::tests::geometry;
    use crate::testing::random::Random;

    /// Compared with solving without the prior: the difference of the two solutions over their combined deviations.
    #[test]
    fn a_contradiction_is_the_distance_from_what_the_rest_says() {
        let truth = geometry();
        let given = |off_m: f64| Prior::Distance {
            surface: 0,
            distance_m: truth.value(Parameter::Offset { surface: 0 }).abs() + off_m,
            sd_m: 2e-3,
        };
        let mut without = bundle(&truth, 0.02, 1.0, 11);
        without.known.retain(|known| matches!(known, Prior::Lens { .. }));
        let alone = without.clone().solve().unwrap();
        let at = alone.free.iter().position(|p| *p == Parameter::Offset { surface: 0 }).unwrap();
        let (says_m, sd_m) =
            (alone.geometry.value(Parameter::Offset { surface: 0 }).abs(), alone.covariance[(at, at)].sqrt());
        assert!(sd_m > 2e-3, "the pictures say less than the tape measure: {sd_m}");
        // Much nearer boards would be before the wall.
        for off_m in [0.0, 0.02, -0.06] {
            let mut with = without.clone();
            with.known.push(given(off_m));
            let solved = with.solve().unwrap();
            let Prior::Distance { distance_m, .. } = given(off_m) else { unreachable!() };
            let expected = (says_m - distance_m).abs() / sd_m.hypot(2e-3);
            let rest = compared(&solved, &given(off_m)).unwrap();
            let (found, rest_sd_m) = (rest.off, 2e-3 * rest.rest_sd.unwrap());
            assert!((rest_sd_m / sd_m - 1.0).abs() < 0.25, "{off_m}: {rest_sd_m}, expected {sd_m}");
            // The correlation within pictures is estimated separately in each.
            assert!((found - expected).abs() < 0.05 + 0.2 * expected, "{off_m}: {found}, expected {expected}");
            // The lens agrees in any case: it was drawn from its stated covariance.
            let lens = compared(&solved, &solved.known[0]).unwrap();
            assert!(lens.off < CONTRADICTION_SD && lens.rest_sd.is_none(), "{lens:?}");
        }
    }

    #[test]
    fn what_neighbours_have_in_common_is_told_from_noise() {
        let mut random = Random::new(1);
        let mut noise = move || (random.uniform() - 0.5) * 0.2;
        let mut field = |common: f64| -> Vec<(Point2<f64>, Vector2<f64>)> {
            let at = |i: usize| Point2::new(100.0 + (i % 30) as f64 * 10.0, 50.0 + (i / 30) as f64 * 10.0);
            let bent = |p: &Point2<f64>| Vector2::new((p.x / 60.0).sin(), 0.0) * common;
            (0..900).map(|i| (at(i), bent(&at(i)) + Vector2::new(noise(), noise()))).collect()
        };
        for _ in 0..20 {
            let even = neighbour_correlation(&field(0.0)).unwrap();
            assert!((0.75..1.3).contains(&even), "{even}");
        }
        // As large as the standard deviation of the noise, 0.058 px.
        let bent = neighbour_correlation(&field(0.058)).unwrap();
        assert!(bent > CORRELATED_ABOVE, "{bent}");
        assert!(neighbour_correlation(&field(0.0)[..5]).is_none());
        assert!(neighbour_correlation(&[(Point2::origin(), Vector2::zeros()); 9]).is_none());
    }
}
