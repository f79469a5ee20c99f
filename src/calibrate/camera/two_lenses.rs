//! Whether pictures fall into two groups with different lenses: two cameras, or one whose focus or zoom was changed.
//!
//! In: a solution, the same with an even print, and their corners. Out: [`TwoLenses`], when one lens clearly does not
//! fit.
//!
//! Pictures in which the board lies alike share their errors and stay together: what is split are their clusters, most
//! of them single pictures. They are first split by what each says alone, in many ways, and the splits compared to
//! first order about the single lens. For the best of them each group is then solved separately, and every cluster
//! moves to the lens with the smaller residual, until none changes. Any set can be split like this; two lenses are
//! reported only if they differ by more than their covariances, which include the scatter of one camera's pictures, and
//! fit the corners better than one. Where they fit no better, because depth makes up for a change of focus or zoom, the
//! pictures before and after some moments in their order are compared: of so few splits none is chosen to differ, so
//! that focal lengths or principal points that differ clearly are enough. Single pictures, and those before or after
//! any moment, are compared in `changed.rs`.
//!
//! Both groups have one shape of the board: one for each would make up for another lens. An uneven print makes up for
//! two lenses too, and two lenses for an uneven print. So the groups are searched with an even print. Then the corners
//! of one are moved to where the other's lens would show them, the shape is found anew from all pictures, and both
//! lenses with it; against them stands one lens with a print that may be uneven.
//!
//! Cannot tell: groups of fewer than four clusters; lenses that differ less than other errors of the pictures. Of
//! OpenCV's twelve pictures of one camera, half of them enlarged, in any order, is detected at 5 %, at 3 % hardly. For
//! its pair of cameras, with centres 15 px apart, a half-and-half mixture is detected.

use super::turn::Turn;
use crate::calibrate::bundle::clusters::Part;
use crate::calibrate::bundle::shape::Shape;
use crate::calibrate::bundle::{Bundle, Corner, Solution};
use crate::calibrate::geometry::Parameter;
use crate::optics::Lens;
use crate::whitening::chi_square;
use nalgebra::{DMatrix, DVector, Vector4};
use rayon::prelude::*;

/// Fewest clusters of a group.
const MIN_CLUSTERS: usize = 4;
const MAX_ROUNDS: usize = 8;
/// Splits that are solved for: the best to first order.
const MAX_STARTS: usize = 3;
/// Least evidence for two lenses: their difference relative to their covariances, χ² per degree of freedom, times the
/// part by which the sum of squares of one lens exceeds that of two. Pictures of one camera, split in the worst way,
/// reach 2.8 (four sets of photographs: 15.8 · 0.14, 13.5 · 0.21, 9.7 · 0.22, 3.7 · 0.43); with half of them enlarged
/// by 5 % it is 4.8 and more.
pub(super) const MIN_EVIDENCE: f64 = 3.75;
/// Parts of the pictures after which focus or zoom may have been moved.
const MOMENTS: [f64; 3] = [1.0 / 3.0, 0.5, 2.0 / 3.0];
/// χ² of the difference of focal lengths and principal points before and after. Pictures of one camera reach 11, four
/// sets of photographs, and simulated ones 16.
const MOVED_CHI2: f64 = 25.0;
/// Residuals are capped at this many σ.
pub(super) const OUTLIER: f64 = 4.0;

/// Two groups of pictures, and the lens of each.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct TwoLenses {
    /// Indices of the pictures.
    pub(crate) groups: [Vec<usize>; 2],
    /// Their lenses.
    pub(crate) lenses: [Lens; 2],
    /// How the pictures of the second group differ from the first, if they are those of one lens.
    pub(crate) turn: Option<Turn>,
}

/// Pictures before and after a moment at which focus or zoom were moved, or the part of the sensor that is read.
pub(super) fn before_and_after(solved: &Solution, corners: &[Corner]) -> Option<TwoLenses> {
    let clusters = solved.parts.len();
    let at = |part: f64| {
        // They are numbered in the order of their first pictures.
        let before = (part * clusters as f64).round() as usize;
        let first: Vec<bool> = (0..clusters).map(|cluster| cluster < before).collect();
        let roughly = solved_apart(solved, &solved.shape, corners, &first)?;
        if off_chi2(&roughly.1)? < MOVED_CHI2 {
            return None;
        }
        let (groups, solutions) = &roughly;
        let shape = shared_shape(solved, corners, groups, solutions.each_ref().map(|of| of.geometry.lens))?;
        let (groups, solutions) = solved_apart(solved, &shape, corners, &first)?;
        let chi2 = off_chi2(&solutions)?;
        let lenses = solutions.map(|solution| solution.geometry.lens);
        (chi2 > MOVED_CHI2).then_some((chi2, TwoLenses { groups, lenses, turn: None }))
    };
    let found = MOMENTS.into_iter().filter_map(at);
    found.max_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, found)| found)
}

/// χ² of the difference of focal lengths and principal points.
fn off_chi2([a, b]: &[Solution; 2]) -> Option<f64> {
    let [f, c] = [|lens: &Lens| lens.focal_px, |lens: &Lens| lens.principal_point_px.coords]
        .map(|of| of(&a.geometry.lens) - of(&b.geometry.lens));
    let off = Vector4::new(f.x, f.y, c.x, c.y);
    // They come first.
    let together = (&a.covariance + &b.covariance).fixed_view::<4, 4>(0, 0).into_owned();
    chi_square(&off, together)
}

/// Pictures in any order, and how much evidence there is for two groups; `even` is the solution with an even print.
pub(super) fn in_any_order(solved: &Solution, even: &Solution, corners: &[Corner]) -> Option<(f64, TwoLenses)> {
    let all = squares(solved, &solved.shape, &solved.geometry.lens, corners)?.iter().sum::<f64>();
    let starts = starts(&even.parts);
    let parted: Vec<Split> =
        starts.into_par_iter().filter_map(|start| part(even, &even.shape, corners, start)).collect();
    let best = parted.into_iter().min_by(|a, b| a.left.total_cmp(&b.left))?;
    let (groups, [a, b]) = &best.apart;
    let shape = shared_shape(even, corners, groups, [a, b].map(|of| of.geometry.lens))?;
    let best = part(even, &shape, corners, best.first)?;
    let (groups, [a, b]) = best.apart;
    let off = DVector::from_iterator(
        Parameter::of_lens(&a.geometry.lens).len(),
        Parameter::of_lens(&a.geometry.lens).iter().map(|p| a.geometry.value(*p) - b.geometry.value(*p)),
    );
    let apart = chi_square(&off, &a.covariance + &b.covariance)? / off.len() as f64;
    let evidence = apart * (all / best.left - 1.0);
    let lenses = [a.geometry.lens, b.geometry.lens];
    (evidence > MIN_EVIDENCE).then_some((evidence, TwoLenses { groups, lenses, turn: None }))
}

/// Pictures in two groups.
struct Split {
    /// Whether each cluster is in the first.
    first: Vec<bool>,
    apart: Apart,
    /// Sum of squares with the better lens for each cluster.
    left: f64,
}

/// Splits of the clusters to start from, the most promising first: whether each cluster is in the first group.
///
/// In every direction in which the clusters' pulls differ, and along every unknown, the clusters are put in the order
/// of what each says alone, and parted at every gap.
fn starts(parts: &[Part]) -> Vec<Vec<bool>> {
    let Some(size) = parts.first().map(|part| part.pull.len()) else { return Vec::new() };
    let pulls = DMatrix::from_fn(parts.len(), size, |row, column| parts.get(row).map_or(0.0, |part| part.pull[column]));
    let directions = pulls.svd(false, true).v_t.map(|ways| ways.transpose());
    let unknowns = DMatrix::<f64>::identity(size, size);
    let mut splits: Vec<(f64, Vec<bool>)> = Vec::new();
    for direction in directions.iter().flat_map(|ways| ways.column_iter()).chain(unknowns.column_iter()) {
        let alone = |part: &Part| direction.dot(&part.pull) / direction.dot(&(&part.information * direction));
        let values: Vec<f64> = parts.iter().map(alone).collect();
        let mut sorted = values.clone();
        sorted.sort_by(f64::total_cmp);
        for bound in sorted {
            let split = settled(parts, values.iter().map(|value| *value < bound).collect());
            splits.extend(split.filter(|(_, new)| !splits.iter().any(|(_, old)| is_same(old, new))));
        }
    }
    splits.sort_by(|a, b| b.0.total_cmp(&a.0));
    splits.into_iter().take(MAX_STARTS).map(|(_, split)| split).collect()
}

/// Whether two splits have the same groups.
fn is_same(a: &[bool], b: &[bool]) -> bool {
    a == b || a.iter().zip(b).all(|(a, b)| a != b)
}

/// Moves clusters to the group whose lens suits them better, to first order about the single lens, until none changes;
/// and by how much two lenses lower the sum of squares.
fn settled(parts: &[Part], mut first: Vec<bool>) -> Option<(f64, Vec<bool>)> {
    let size = parts.first()?.pull.len();
    let of_parts = parts.iter().fold(DMatrix::zeros(size, size), |sum, part| sum + &part.information);
    let prior = DMatrix::identity(size, size) - of_parts;
    let mut best: Option<(f64, Vec<bool>)> = None;
    for _ in 0..MAX_ROUNDS {
        let own =
            |which: bool| parts.iter().zip(&first).filter(move |(_, first)| **first == which).map(|(part, _)| part);
        if [true, false].iter().any(|which| own(*which).count() < MIN_CLUSTERS) {
            break;
        }
        let moved = |which: bool| {
            let information = own(which).fold(prior.clone(), |sum, part| sum + &part.information);
            let pull = own(which).fold(DVector::zeros(size), |sum, part| sum + &part.pull);
            information.cholesky().map(|information| information.solve(&pull))
        };
        let (a, b) = (moved(true)?, moved(false)?);
        let gain =
            |part: &Part, moved: &DVector<f64>| 2.0 * part.pull.dot(moved) - moved.dot(&(&part.information * moved));
        let gains: Vec<[f64; 2]> = parts.iter().map(|part| [gain(part, &a), gain(part, &b)]).collect();
        let sum: f64 = gains.iter().zip(&first).map(|([a, b], first)| if *first { a } else { b }).sum();
        let next: Vec<bool> = gains.iter().map(|[a, b]| a > b).collect();
        if best.as_ref().is_none_or(|(most, _)| sum > *most) {
            best = Some((sum, first.clone()));
        }
        if next == first {
            break;
        }
        first = next;
    }
    best
}

/// The pictures of two groups, and the solution of each by itself.
type Apart = ([Vec<usize>; 2], [Solution; 2]);

/// The clusters in the `first` group and the others, with a shape of the board; `None` where a group is too small, or
/// has no solution.
fn solved_apart(solved: &Solution, shape: &Shape, corners: &[Corner], first: &[bool]) -> Option<Apart> {
    if [true, false].iter().any(|which| first.iter().filter(|first| *first == which).count() < MIN_CLUSTERS) {
        return None;
    }
    let pictures = solved.clusters.iter().enumerate();
    let group = |which: bool| {
        pictures.clone().filter(|(_, cluster)| first.get(**cluster) == Some(&which)).map(|(i, _)| i).collect()
    };
    let groups: [Vec<usize>; 2] = [group(true), group(false)];
    let of = |group: &Vec<usize>| of_group(solved, shape, corners, group).solve().ok();
    let solutions = [of(&groups[0])?, of(&groups[1])?];
    Some((groups, solutions))
}

/// The board's shape with two lenses: all pictures as the first would have taken them.
pub(super) fn shared_shape(
    solved: &Solution,
    corners: &[Corner],
    groups: &[Vec<usize>; 2],
    [a, b]: [Lens; 2],
) -> Option<Shape> {
    let all: Vec<usize> = (0..solved.poses.len()).collect();
    let mut bundle = solved.of_pictures(&all, corners);
    bundle.geometry.lens = a;
    for corner in bundle.corners.iter_mut().filter(|corner| groups[1].contains(&corner.picture)) {
        corner.pixel = a.distort(&b.undistort(&corner.pixel)?);
    }
    bundle.shape = bundle.shape.that_may_be_uneven();
    Some(bundle.solve().ok()?.shape)
}

/// The problem of some pictures, with a shape of the board.
pub(super) fn of_group(solved: &Solution, shape: &Shape, corners: &[Corner], group: &[usize]) -> Bundle {
    let mut own = solved.of_pictures(group, corners);
    own.corners.iter_mut().for_each(|corner| corner.place = shape.place(&corner.place));
    own.shape = Shape::rigid();
    own
}

fn part(solved: &Solution, shape: &Shape, corners: &[Corner], mut first: Vec<bool>) -> Option<Split> {
    let mut best: Option<Split> = None;
    for _ in 0..MAX_ROUNDS {
        let Some((groups, [a, b])) = solved_apart(solved, shape, corners, &first) else { break };
        let [by_a, by_b] = [&a, &b].map(|lens| squares(solved, shape, &lens.geometry.lens, corners));
        let (Some(by_a), Some(by_b)) = (by_a, by_b) else { break };
        let left = by_a.iter().zip(&by_b).map(|(a, b)| a.min(*b)).sum();
        if best.as_ref().is_none_or(|best| left < best.left) {
            best = Some(Split { first: first.clone(), apart: (groups, [a, b]), left });
        }
        let next: Vec<bool> = by_a.iter().zip(&by_b).map(|(a, b)| a < b).collect();
        if next == first {
            break;
        }
        first = next;
    }
    best
}

/// For each cluster, the sum of squares with a lens, the poses being free.
pub(super) fn squares(solved: &Solution, shape: &Shape, lens: &Lens, corners: &[Corner]) -> Option<Vec<f64>> {
    let all: Vec<usize> = (0..solved.poses.len()).collect();
    let mut bundle = of_group(solved, shape, corners, &all);
    bundle.geometry.lens = *lens;
    bundle.free = Vec::new();
    let left = bundle.search().ok()?.left_px().ok()?;
    let most = (OUTLIER * solved.corner_sd_px).powi(2);
    let mut sums = vec![0.0; solved.parts.len()];
    for (corner, residual) in corners.iter().zip(left) {
        *sums.get_mut(*solved.clusters.get(corner.picture)?)? += residual.norm_squared().min(most);
    }
    Some(sums)
}
