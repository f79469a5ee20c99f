//! Whether pictures fall into two groups that each want a lens of their own: two cameras, or one whose focus or zoom
//! was moved.
//!
//! In: a solution and its corners. Out: [`TwoLenses`], when one lens is clearly not enough.
//!
//! Pictures are first parted by the direction in which they pull at the one lens most differently; each group is then
//! solved by itself and every picture goes to the lens that leaves less of it, until none changes. Any set can be
//! parted so; of two lenses is spoken when they differ by far more than their covariances say, which hold what the
//! pictures of one camera scatter, and leave much less of the corners than one.
//!
//! Cannot tell: groups of fewer than four pictures; lenses closer than what else is wrong in the pictures. Of OpenCV's
//! pair of cameras, 15 px apart in centre, a mixture of halves is told, five pictures among twelve of the other are
//! not.

use crate::calibrate::bundle::{Bundle, Corner, Solution};
use crate::calibrate::geometry::Parameter;
use crate::optics::Lens;
use nalgebra::{DMatrix, DVector};

/// Fewest pictures of a group.
const FEWEST: usize = 4;
const MOST_ROUNDS: usize = 8;
/// The lenses differ by so many times what their covariances say, χ² by its freedom: pictures of one camera, parted as
/// badly as they can be, reach 10.
const APART: f64 = 15.0;
/// One lens leaves so many times the squares that two leave.
const LEFT: f64 = 1.25;
/// A corner counts as no further off than so many σ.
const OUTLIER: f64 = 4.0;

/// Two groups of pictures, and the lens of each.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct TwoLenses {
    /// Indices of the pictures.
    pub(crate) groups: [Vec<usize>; 2],
    /// Their lenses.
    pub(crate) lenses: [Lens; 2],
}

/// Looks for two groups.
pub(crate) fn two_lenses(solved: &Solution, corners: &[Corner]) -> Option<TwoLenses> {
    let all = squares(solved, &solved.geometry.lens, corners)?.iter().sum::<f64>();
    let starts = starts(&solved.pulls)?;
    let parted = starts.into_iter().filter_map(|start| part(solved, corners, start));
    let best = parted.min_by(|a, b| a.left.total_cmp(&b.left))?;
    let [a, b] = &best.solutions;
    let off = DVector::from_iterator(
        Parameter::of_lens(&a.geometry.lens).len(),
        Parameter::of_lens(&a.geometry.lens).iter().map(|p| a.geometry.value(*p) - b.geometry.value(*p)),
    );
    let together = (&a.covariance + &b.covariance).cholesky()?;
    let apart = off.dot(&together.solve(&off)) / off.len() as f64;
    (apart > APART && all > LEFT * best.left)
        .then_some(TwoLenses { groups: best.groups, lenses: [a.geometry.lens, b.geometry.lens] })
}

/// Pictures in two groups.
struct Parted {
    groups: [Vec<usize>; 2],
    solutions: [Solution; 2],
    /// Squares that the better lens of each picture leaves.
    left: f64,
}

/// Halves of the pictures by each of the two directions in which they pull most differently; whether each is of the
/// first.
fn starts(pulls: &[DVector<f64>]) -> Option<Vec<Vec<bool>>> {
    let size = pulls.first()?.len();
    let matrix = DMatrix::from_fn(pulls.len(), size, |row, column| pulls[row][column]);
    let ways = matrix.svd(true, false);
    let along = ways.u?;
    let half = |column: usize| {
        let mut sorted: Vec<f64> = along.column(column).iter().copied().collect();
        sorted.sort_by(f64::total_cmp);
        let median = sorted[sorted.len() / 2];
        along.column(column).iter().map(|value| *value < median).collect()
    };
    Some((0..along.ncols().min(2)).map(half).collect())
}

fn part(solved: &Solution, corners: &[Corner], mut first: Vec<bool>) -> Option<Parted> {
    let mut best: Option<Parted> = None;
    for _ in 0..MOST_ROUNDS {
        let group = |which: bool| (0..first.len()).filter(|i| first[*i] == which).collect::<Vec<usize>>();
        let groups = [group(true), group(false)];
        if groups.iter().any(|group| group.len() < FEWEST) {
            break;
        }
        let of = |group: &Vec<usize>| solved.of_pictures(group, corners).solve().ok();
        let (Some(a), Some(b)) = (of(&groups[0]), of(&groups[1])) else { break };
        let [by_a, by_b] = [&a, &b].map(|lens| squares(solved, &lens.geometry.lens, corners));
        let (Some(by_a), Some(by_b)) = (by_a, by_b) else { break };
        let left = by_a.iter().zip(&by_b).map(|(a, b)| a.min(*b)).sum();
        if best.as_ref().is_none_or(|best| left < best.left) {
            best = Some(Parted { groups, solutions: [a, b], left });
        }
        let next: Vec<bool> = by_a.iter().zip(&by_b).map(|(a, b)| a < b).collect();
        if next == first {
            break;
        }
        first = next;
    }
    best
}

/// For each picture, the squares that a lens leaves, its pose being free.
fn squares(solved: &Solution, lens: &Lens, corners: &[Corner]) -> Option<Vec<f64>> {
    let all: Vec<usize> = (0..solved.poses.len()).collect();
    let mut bundle: Bundle = solved.of_pictures(&all, corners);
    bundle.geometry.lens = *lens;
    bundle.free = Vec::new();
    let left = bundle.search().ok()?.left_px().ok()?;
    let most = (OUTLIER * solved.corner_sd_px).powi(2);
    let mut sums = vec![0.0; all.len()];
    for (corner, residual) in corners.iter().zip(left) {
        *sums.get_mut(corner.picture)? += residual.norm_squared().min(most);
    }
    Some(sums)
}
