//! Whether camera, tank or a mirror moved between two pictures.
//!
//! In: a solution, its pictures in the order in which they were taken. Out: [`Moved`], where one geometry does not hold
//! for all.
//!
//! If something moves once, the pictures before and after it see two geometries that differ by its motion. Motions are
//! rigid: the camera's turns and shifts all surfaces, the tank's all walls, a mirror's itself. For every moment between
//! two pictures and everything that may have moved, the motion is found that fits best, to first order about the
//! solution ([`Part`]), with one geometry for all else free. It lowers the sum of squares by χ². Evidence is χ² per
//! direction of the motion, over the scatter of the pictures' pulls that the motion leaves, relative to that of noise.
//!
//! Pictures whose corners are off together scatter more than their noise, and not in all directions alike: some motion
//! always seems to explain a part of it. So the same is asked of the pictures in other orders: a move is reported if
//! hardly any of them has as much evidence.
//!
//! Pictures in which the board lies alike are one cluster, and stand where the first of them does. Boards taped to
//! walls count as before the move.
//!
//! Cannot tell: a move with a single cluster on one side; one much smaller than σ, and with fewer than ten clusters
//! all but clear ones; two moves from one; a move from errors of the board or the lens that change along with the order
//! of the pictures, as when the board is carried from one end of the tank to the other.

use crate::calibrate::bundle::Solution;
use crate::calibrate::bundle::clusters::Part;
use crate::calibrate::geometry::{Parameter, tilt_axes};
use crate::optics::Surface;
use nalgebra::{DMatrix, DVector};

/// Fewest clusters before and after a move.
const MIN_CLUSTERS: usize = 2;
/// Directions are left out of which the pictures say less than this part of what they would of a move half-way, were
/// nothing else known.
const MIN_INFORMATION: f64 = 0.05;
/// Singular values of a motion's directions below this part of the largest are rounding.
const RANK: f64 = 1e-6;
/// Least evidence for a move. In 52 simulated sets with noise alone the most was 4.8.
const MIN_EVIDENCE: f64 = 6.0;
/// Other orders of the pictures, and the largest part of them that may have as much evidence.
const ORDERS: usize = 500;
const MAX_CHANCE: f64 = 0.01;
/// With so much evidence a larger part may, and orders that make the same two groups do not count: of few pictures, or
/// at an end, many do. In 80 simulated sets in which the corners of each picture were off together by as much as their
/// noise, the most was 17.
const CLEAR: f64 = 20.0;
const MAX_CHANCE_IF_CLEAR: f64 = 0.06;
/// Relative difference of evidence that is none.
const ROUNDING: f64 = 1e-6;

/// A move.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Moved {
    /// What fits best: `the camera`, `the tank`, or a mirror's name.
    pub(crate) what: String,
    /// Index of the first picture after it.
    pub(crate) picture: usize,
    /// See the module.
    pub(crate) evidence: f64,
}

/// The move for which there is most evidence, if that is no chance.
pub(crate) fn moved(solution: &Solution) -> Option<Moved> {
    // Clusters are numbered in the order of their first pictures; those of taped boards alone come last.
    let last = *solution.clusters.iter().max()?;
    let mut parts: Vec<&Part> = solution.parts.get(..=last)?.iter().collect();
    let motions = motions(solution);
    let Evidence { gain, evidence, motion, at } = most_evidence(&parts, &motions, 0.0)?;
    // Other orders that make the same two groups gain the same, but for rounding.
    let (least, more) = (gain * (1.0 - ROUNDING), gain * (1.0 + ROUNDING));
    let most = |chance: f64| (chance * ORDERS as f64) as usize;
    let (mut as_much, mut clearly_more) = (0, 0);
    let mut random = fastrand::Rng::with_seed(0);
    for _ in 0..ORDERS {
        random.shuffle(&mut parts);
        if let Some(other) = most_evidence(&parts, &motions, least) {
            as_much += 1;
            clearly_more += usize::from(other.gain > more);
        }
        if clearly_more > most(MAX_CHANCE_IF_CLEAR) {
            return None;
        }
    }
    let is_no_chance = as_much <= most(MAX_CHANCE) || evidence > CLEAR;
    let picture = solution.clusters.iter().position(|cluster| *cluster == at)?;
    is_no_chance.then(|| Moved { what: motions[motion].0.clone(), picture, evidence })
}

/// Evidence for a move: which of the motions, and before which cluster.
struct Evidence {
    /// By how much it exceeds the least, over all directions: motions of many and of few are compared by it.
    gain: f64,
    evidence: f64,
    motion: usize,
    at: usize,
}

/// The most evidence for a move, if it gains `least` or more.
fn most_evidence(parts: &[&Part], motions: &[(String, DMatrix<f64>)], least: f64) -> Option<Evidence> {
    let size = parts.first()?.pull.len();
    // Each cluster's pull has the covariance Hᵢ − Hᵢ² if there is nothing but noise.
    let noise: f64 = parts.iter().map(|part| part.information.trace() - part.information.norm_squared()).sum();
    let mut together = Part::nothing(size);
    let mut best: Option<Evidence> = None;
    for (at, part) in parts.iter().enumerate().rev() {
        together.add(part);
        if at < MIN_CLUSTERS || parts.len() - at < MIN_CLUSTERS {
            continue;
        }
        for (motion, (_, directions)) in motions.iter().enumerate() {
            let Some((chi2, count, moved)) = fitted(directions, &together) else { continue };
            let least = best.as_ref().map_or(least, |best| best.gain);
            let gained = |chi2: f64| chi2 - MIN_EVIDENCE * count;
            if gained(chi2) < least {
                continue;
            }
            let [after, before] = together.apart(&moved);
            let left = parts.iter().enumerate().map(|(i, part)| {
                let by = if i < at { &before } else { &after };
                part.pull_after(by).norm_squared()
            });
            let chi2 = chi2 / (left.sum::<f64>() / noise).max(1.0);
            if gained(chi2) >= least {
                best = Some(Evidence { gain: gained(chi2), evidence: chi2 / count, motion, at });
            }
        }
    }
    best
}

/// Everything that may have moved, and the directions in which its motions change the unknowns: orthonormal, in the
/// coordinates of [`Part`].
fn motions(solution: &Solution) -> Vec<(String, DMatrix<f64>)> {
    let surfaces = &solution.geometry.surfaces;
    let all: Vec<usize> = (0..surfaces.len()).collect();
    let (walls, mirrors): (Vec<usize>, Vec<usize>) =
        all.iter().partition(|surface| matches!(surfaces[**surface].1, Surface::Wall(_)));
    // Without anything else, a camera's motion is the mirror's.
    let mut movable = Vec::new();
    if all.len() > 1 {
        movable.push(("the camera".to_owned(), all));
    }
    if !walls.is_empty() && !mirrors.is_empty() {
        movable.push(("the tank".to_owned(), walls));
    }
    movable.extend(mirrors.into_iter().map(|mirror| (surfaces[mirror].0.clone(), vec![mirror])));
    movable.into_iter().filter_map(|(what, together)| Some((what, directions(solution, &together)?))).collect()
}

/// Directions of surfaces that turn and shift together.
fn directions(solution: &Solution, together: &[usize]) -> Option<DMatrix<f64>> {
    let mut by_motion = DMatrix::zeros(solution.whitening.nrows(), 6);
    for (row, parameter) in solution.free.iter().enumerate() {
        let (Parameter::Tilt { surface, .. } | Parameter::Offset { surface }) = *parameter else { continue };
        if !together.contains(&surface) {
            continue;
        }
        let normal = solution.geometry.surfaces[surface].1.plane().normal();
        // By a turn about the camera's centre, and by a shift. The turn changes no distance from that centre.
        let (first, by) = match *parameter {
            Parameter::Tilt { axis, .. } => (0, tilt_axes(&normal)[axis]),
            _ => (3, normal),
        };
        by_motion.fixed_view_mut::<1, 3>(row, first).copy_from(&by.transpose());
    }
    let svd = solution.whitening.tr_solve_lower_triangular(&by_motion)?.svd(true, false);
    let least = RANK * svd.singular_values.max();
    let kept: Vec<usize> = (0..svd.singular_values.len()).filter(|i| svd.singular_values[*i] > least).collect();
    (!kept.is_empty()).then_some(svd.u?.select_columns(&kept))
}

/// By how much a motion in some directions lowers the sum of squares, the number of these, and that motion.
/// `after`: the clusters after it, together.
fn fitted(directions: &DMatrix<f64>, after: &Part) -> Option<(f64, f64, DVector<f64>)> {
    let about = after.about_difference(directions).symmetric_eigen();
    let (mut chi2, mut count, mut moved) = (0.0, 0.0, DVector::zeros(after.pull.len()));
    for (information, direction) in about.eigenvalues.iter().zip(about.eigenvectors.column_iter()) {
        // Of a move half-way it would be 1/4.
        if *information > 0.25 * MIN_INFORMATION {
            let direction = directions * direction;
            let along = direction.dot(&after.pull);
            chi2 += along * along / information;
            count += 1.0;
            moved += direction * (along / information);
        }
    }
    (count > 0.0).then_some((chi2, count, moved))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibrate::bundle::tests::bundle;
    use crate::calibrate::geometry::tests::geometry;
    use crate::calibrate::geometry::{Geometry, Projector};
    use crate::calibrate::tests::gaussian;
    use nalgebra::{Vector2, Vector3};

    /// Twelve pictures of which those from `first` on are taken after surfaces turned about the camera's centre and
    /// shifted together: radians, metres.
    fn with_move(
        seed: u64,
        first: usize,
        together: &[usize],
        (turn, shift_m): (Vector3<f64>, Vector3<f64>),
    ) -> Solution {
        let truth = geometry();
        let parameters: Vec<Parameter> = together.iter().flat_map(|surface| Parameter::of_surface(*surface)).collect();
        let step = |surface: &usize| {
            let normal = truth.surfaces[*surface].1.plane().normal();
            let [a, b] = tilt_axes(&normal);
            [turn.dot(&a), turn.dot(&b), normal.dot(&shift_m)]
        };
        let after = truth.stepped(&parameters, &together.iter().flat_map(step).collect::<Vec<_>>());
        let seen = |geometry: &Geometry| Projector::new(geometry, &[]);
        let (seen_before, seen_after) = (seen(&truth), seen(&after));
        let mut bundle = bundle(&truth, 0.05, 1.0, seed);
        let poses = bundle.clone().solve().unwrap().poses;
        for corner in bundle.corners.iter_mut().filter(|corner| corner.picture >= first) {
            let place = poses[corner.picture] * corner.place;
            let by = |projector: &Projector| projector.pixel(corner.view, &place).unwrap();
            corner.pixel += by(&seen_after) - by(&seen_before);
        }
        bundle.solve().unwrap()
    }

    #[test]
    fn a_mirror_that_turned_by_a_tenth_of_a_degree_is_found_with_the_picture() {
        let mirror = geometry().surfaces.iter().position(|(_, s)| matches!(s, Surface::Mirror(_))).unwrap();
        for (seed, first) in [(1, 6), (2, 3), (3, 9)] {
            let turn = Vector3::y() * 0.1_f64.to_radians();
            let found = moved(&with_move(seed, first, &[mirror], (turn, Vector3::zeros()))).unwrap();
            assert_eq!((found.what.as_str(), found.picture), ("side_mirror", first), "{found:?}");
            assert!(found.evidence > 4.0 * MIN_EVIDENCE, "{found:?}");
        }
    }

    #[test]
    fn a_tank_that_shifted_and_a_camera_that_turned_are_found() {
        let surfaces = geometry().surfaces;
        let walls: Vec<usize> = (0..surfaces.len()).filter(|i| matches!(surfaces[*i].1, Surface::Wall(_))).collect();
        let shift_m = Vector3::new(4e-3, 0.0, 0.0);
        // One looks like the other, and a camera that turns like a mirror that does: the pictures tell the moment.
        assert_eq!(moved(&with_move(4, 6, &walls, (Vector3::zeros(), shift_m))).unwrap().picture, 6);
        let all: Vec<usize> = (0..surfaces.len()).collect();
        let turn = Vector3::y() * 0.1_f64.to_radians();
        assert_eq!(moved(&with_move(5, 6, &all, (turn, Vector3::zeros()))).unwrap().picture, 6);
    }

    /// With errors that the corners of each picture have in common, some motion always explains a part of their
    /// scatter, but of other orders too.
    #[test]
    fn pictures_whose_corners_are_off_together_did_not_move() {
        const SETS: u64 = 24;
        let (mut found, mut most) = (0, 0.0_f64);
        for seed in 0..SETS {
            let mut bundle = bundle(&geometry(), 0.05, 1.0, 700 + seed);
            let mut random = gaussian(8000 + seed);
            let fields: Vec<[f64; 12]> = (0..24).map(|_| std::array::from_fn(|_| 0.05 * random())).collect();
            for corner in &mut bundle.corners {
                let (u, v) = (corner.place.x / 0.032, corner.place.y / 0.024);
                let field = &fields[2 * corner.picture + corner.view];
                let by = [1.0, u, v, u * v, u * u, v * v];
                let along = |i: usize| by.iter().zip(&field[6 * i..]).map(|(b, f)| b * f).sum::<f64>();
                corner.pixel += Vector2::new(along(0), along(1));
            }
            let solution = bundle.solve().unwrap();
            let parts: Vec<&Part> = solution.parts.iter().collect();
            most = most.max(most_evidence(&parts, &motions(&solution), 0.0).map_or(0.0, |most| most.evidence));
            found += usize::from(moved(&solution).is_some());
        }
        assert!(most > MIN_EVIDENCE, "the orders were not asked: {most}");
        assert!(found <= 1, "{found} of {SETS}");
    }

    #[test]
    fn noise_is_no_move() {
        for seed in 0..40 {
            let found = moved(&bundle(&geometry(), 0.1, 1.0, 300 + seed).solve().unwrap());
            assert_eq!(found, None, "{seed}");
        }
    }
}
