//! Whether one picture, or all before some moment, were taken with another focal length or principal point.
//!
//! In: a solution with an even print, and its corners. Out: [`Changed`], where one lens clearly does not fit.
//!
//! Every cluster of pictures by itself, and all before each moment in their order, is allowed focal lengths and a
//! principal point of its own, to first order about the solution ([`Part`]), all else being one. This lowers the sum of
//! squares by χ². What it leaves of the clusters' pulls on these parameters tells by how much the errors of this set
//! exceed the noise of its corners. Were pulls Gaussian, the ratio of both would have the F distribution with 4 and
//! 4 (n − 2) degrees of freedom, n the number of clusters: its tail, times the number of groups, is the chance of the
//! best.
//!
//! An uneven print makes up for another lens, and another lens for an uneven print (`two_lenses.rs`). So where another
//! lens is found with an even print, the print is found with both, and the same asked again.
//!
//! Cannot tell: several pictures that each have another lens; another lens of which the picture itself tells less than
//! errors of others do. Such a picture hardly changes the lens.

use super::two_lenses::{of_group, shared_shape};
use crate::calibrate::bundle::clusters::Part;
use crate::calibrate::bundle::{Bundle, Corner, Solution};
use crate::optics::Lens;
use crate::whitening::chi_square;
use nalgebra::{DMatrix, DVector};
use std::ops::Range;

/// Focal lengths and principal point, which come first.
const OWN: usize = 4;
/// Fewest clusters in all, and before or after a moment.
const MIN_CLUSTERS: usize = 7;
const MIN_BESIDE: usize = 3;
/// Largest chance.
const MAX_CHANCE: f64 = 3e-4;
/// Part of a cluster's information about each parameter that is added to it: what is below this is rounding.
const RANK: f64 = 1e-6;

/// A group of pictures and the others, with different lenses.
#[derive(Debug)]
pub(super) struct Changed {
    /// Indices of the pictures; the first group is one cluster, or those before a moment.
    pub(super) groups: [Vec<usize>; 2],
    /// Their lenses.
    pub(super) lenses: [Lens; 2],
    /// Whether the first group is a single cluster.
    pub(super) is_single: bool,
    /// In how many sets of one lens there is so much evidence for two.
    pub(super) chance: f64,
}

/// The group with most evidence for another lens, if that is no chance.
pub(super) fn changed(even: &Solution, corners: &[Corner]) -> Option<Changed> {
    let Changed { groups, lenses, is_single, .. } = best(even)?;
    let shape = if is_single {
        // Alone it tells too little of its lens to help with the print.
        let others = even.of_pictures(&groups[1], corners);
        Bundle { shape: even.shape.that_may_be_uneven(), ..others }.solve().ok()?.shape
    } else {
        shared_shape(even, corners, &groups, lenses)?
    };
    let all: Vec<usize> = (0..even.poses.len()).collect();
    best(&of_group(even, &shape, corners, &all).solve().ok()?)
}

fn best(solution: &Solution) -> Option<Changed> {
    let parts = &solution.parts;
    let count = parts.len();
    if count < MIN_CLUSTERS {
        return None;
    }
    let size = solution.whitening.nrows();
    let own = solution.whitening.tr_solve_lower_triangular(&DMatrix::identity(size, OWN))?;
    let alone = (0..count).map(|cluster| cluster..cluster + 1);
    let groups: Vec<Range<usize>> = alone.chain((MIN_BESIDE..=count - MIN_BESIDE).map(|before| 0..before)).collect();
    let fits = groups.iter().filter_map(|group| Some((group, Fit::of(parts, &own, group)?)));
    let (group, fit) = fits.max_by(|a, b| a.1.ratio.total_cmp(&b.1.ratio))?;
    let chance = groups.len() as f64 * f_tail(fit.ratio, count - 2);
    let lens = |moved: &DVector<f64>| {
        // The lens comes first.
        let by = solution.whitening.tr_mul(moved);
        solution.geometry.stepped(&solution.free, by.as_slice()).lens
    };
    let pictures = |inside: bool| {
        let all = solution.clusters.iter().enumerate();
        all.filter(|(_, cluster)| group.contains(*cluster) == inside).map(|(picture, _)| picture).collect()
    };
    (chance < MAX_CHANCE).then(|| Changed {
        groups: [pictures(true), pictures(false)],
        lenses: fit.moved.each_ref().map(lens),
        is_single: group.len() == 1,
        chance,
    })
}

/// A group's own lens.
struct Fit {
    /// χ² of it per parameter, over that of what it leaves.
    ratio: f64,
    /// By how much the unknowns of the group and of the others differ from the solution.
    moved: [DVector<f64>; 2],
}

impl Fit {
    /// `own`: what the group's own parameters change.
    fn of(parts: &[Part], own: &DMatrix<f64>, group: &Range<usize>) -> Option<Self> {
        let (first, rest) = parts.get(group.clone())?.split_first()?;
        let mut together = first.clone();
        rest.iter().for_each(|part| together.add(part));
        let pull = own.tr_mul(&together.pull);
        let change = about(own, &together).cholesky()?.solve(&pull);
        let moved = together.apart(&(own * &change));
        let left = parts.iter().enumerate().map(|(cluster, part)| {
            let by = &moved[usize::from(!group.contains(&cluster))];
            chi_square(&own.tr_mul(&part.pull_after(by)), about(own, part))
        });
        // The noise is known, and less cannot be left but by chance.
        let freedom = (OWN * (parts.len() - 2)) as f64;
        let left = (left.sum::<Option<f64>>()? / freedom).max(1.0);
        Some(Self { ratio: change.dot(&pull) / OWN as f64 / left, moved })
    }
}

/// The information of one or several clusters about parameters of their own.
fn about(own: &DMatrix<f64>, part: &Part) -> DMatrix<f64> {
    let mut about = part.about_difference(own);
    for i in 0..about.nrows() {
        about[(i, i)] *= 1.0 + RANK;
    }
    about
}

/// How often a ratio of variances is larger by chance, with 4 and 4·`n` degrees of freedom.
fn f_tail(ratio: f64, n: usize) -> f64 {
    let half = 2.0 * n as f64;
    // The incomplete beta function I(half, 2).
    let part = half / (half + 2.0 * ratio);
    part.powf(half) * (1.0 + half * (1.0 - part))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_tail_of_the_f_distribution() {
        // By tables: 5 % with 4 and 20 degrees of freedom beyond 2.866, 1 % with 4 and 40 beyond 3.828.
        assert!((f_tail(2.8661, 5) - 0.05).abs() < 1e-5, "{}", f_tail(2.8661, 5));
        assert!((f_tail(3.8283, 10) - 0.01).abs() < 1e-5, "{}", f_tail(3.8283, 10));
        assert_eq!(f_tail(0.0, 5), 1.0);
    }
}
