//! Whether pictures fall into two groups with different lenses: two cameras, or one whose focus or zoom was changed.
//!
//! In: a solution and its corners. Out: [`TwoLenses`], when one lens clearly does not fit.
//!
//! Pictures are first split by the direction in which their pulls on the single lens differ most; each group is then
//! solved separately and every picture moves to the lens with the smaller residual, until none changes. Any set can be
//! split like this; two lenses are reported only if they differ by far more than their covariances, which include the
//! scatter of one camera's pictures, and fit the corners much better than one.
//!
//! Cannot tell: groups of fewer than four pictures; lenses that differ less than other errors of the pictures. For
//! OpenCV's pair of cameras, with centres 15 px apart, a half-and-half mixture is detected, five pictures among twelve
//! of the other are not.

use crate::calibrate::bundle::{Bundle, Corner, Solution};
use crate::calibrate::geometry::Parameter;
use crate::optics::Lens;
use nalgebra::{DMatrix, DVector};

/// Fewest pictures of a group.
const MIN_PICTURES: usize = 4;
const MAX_ROUNDS: usize = 8;
/// Least difference of the lenses relative to their covariances, χ² per degree of freedom: pictures of one camera,
/// split in the worst way, reach 10.
const MIN_CHI2: f64 = 15.0;
/// Least ratio of the sums of squares of one lens and of two.
const MIN_COST_RATIO: f64 = 1.25;
/// Residuals are capped at this many σ.
const OUTLIER: f64 = 4.0;

/// Two groups of pictures, and the lens of each.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct TwoLenses {
    /// Indices of the pictures.
    pub(crate) groups: [Vec<usize>; 2],
    /// Their lenses.
    pub(crate) lenses: [Lens; 2],
}

/// Searches for two groups.
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
    (apart > MIN_CHI2 && all > MIN_COST_RATIO * best.left)
        .then_some(TwoLenses { groups: best.groups, lenses: [a.geometry.lens, b.geometry.lens] })
}

/// Pictures in two groups.
struct Split {
    groups: [Vec<usize>; 2],
    solutions: [Solution; 2],
    /// Sum of squares with the better lens for each picture.
    left: f64,
}

/// Splits the pictures by each of the two directions in which their pulls differ most; whether each picture is in the
/// first half.
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

fn part(solved: &Solution, corners: &[Corner], mut first: Vec<bool>) -> Option<Split> {
    let mut best: Option<Split> = None;
    for _ in 0..MAX_ROUNDS {
        let group = |which: bool| (0..first.len()).filter(|i| first[*i] == which).collect::<Vec<usize>>();
        let groups = [group(true), group(false)];
        if groups.iter().any(|group| group.len() < MIN_PICTURES) {
            break;
        }
        let of = |group: &Vec<usize>| solved.of_pictures(group, corners).solve().ok();
        let (Some(a), Some(b)) = (of(&groups[0]), of(&groups[1])) else { break };
        let [by_a, by_b] = [&a, &b].map(|lens| squares(solved, &lens.geometry.lens, corners));
        let (Some(by_a), Some(by_b)) = (by_a, by_b) else { break };
        let left = by_a.iter().zip(&by_b).map(|(a, b)| a.min(*b)).sum();
        if best.as_ref().is_none_or(|best| left < best.left) {
            best = Some(Split { groups, solutions: [a, b], left });
        }
        let next: Vec<bool> = by_a.iter().zip(&by_b).map(|(a, b)| a < b).collect();
        if next == first {
            break;
        }
        first = next;
    }
    best
}

/// For each picture, the sum of squares with a lens, its pose being free.
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
