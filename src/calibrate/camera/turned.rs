//! Whether some pictures were flipped, or turned by 180°, and others not.
//!
//! In: a solution, the same with an even print, and their corners. Out: [`TwoLenses`], when one lens clearly does not
//! fit.
//!
//! Flipped pictures show a lens whose principal point lies on the other side of the picture's middle. Their boards
//! seem to be the other way up, where the unevenness of a print shifts corners the other way too: one lens with its
//! principal point in the middle and an uneven print nearly make up for them. But two lenses of which one is the other
//! flipped have no more parameters than one. So even a single picture can be told.
//!
//! For each [`Turn`], the search starts with a principal point beside the middle and an even print. Each cluster of
//! pictures (`bundle/clusters.rs`) is taken as it is or turned back, as suits the lens, then the lens is found anew
//! from all of them, until none changes. The evidence is that of `two_lenses`: both solutions may have an uneven
//! print.
//!
//! Cannot tell: which of the groups is as the camera took it; a lens whose principal point is within a few pixels of
//! the picture's middle, which may be flipped at will; reliably, flipped pictures of a print that is uneven as well.

use super::turn::{Pictures, Turn};
use super::two_lenses::{MIN_EVIDENCE, OUTLIER, TwoLenses, squares};
use crate::calibrate::board::Board;
use crate::calibrate::bundle::{Bundle, Corner, Solution};
use crate::median::upper_median;
use crate::optics::Lens;
use rayon::prelude::*;

const MAX_ROUNDS: usize = 8;
/// Initial distance of the principal point from the middle, as a part of the picture's size.
const BESIDE: f64 = 0.01;
/// Median residuals of the two groups that differ by less than this factor are those of one lens.
const ALIKE: f64 = 2.0;

/// Searches for pictures that are flipped or turned, and says how much evidence there is; `even` is the solution with
/// an even print.
pub(super) fn turned(
    board: &Board,
    solved: &Solution,
    even: &Solution,
    corners: &[Corner],
    size_px: [u32; 2],
) -> Option<(f64, TwoLenses)> {
    let as_given = (even.clone(), corners.to_vec());
    let ways = Turn::ALL.into_iter().filter_map(|turn| Some((turn, turn.pictures(&as_given, board, size_px)?)));
    let starts: Vec<(Turn, usize, Pictures)> =
        ways.flat_map(|(turn, all)| turn.axes().iter().map(move |axis| (turn, *axis, all.clone()))).collect();
    let parted = starts.into_par_iter().filter_map(|(turn, axis, all)| {
        let mut lens = even.geometry.lens;
        for axis in turn.axes() {
            lens.principal_point_px[*axis] = (f64::from(size_px[*axis]) - 1.0) / 2.0;
            lens.distortion[3 - axis] = 0.0;
        }
        lens.principal_point_px[axis] += BESIDE * f64::from(size_px[axis]);
        Some((turn, part(lens, &as_given, &all)?))
    });
    let (turn, Split { turned, bundle, .. }) = parted.min_by(|a, b| a.1.left.total_cmp(&b.1.left))?;
    let found = Bundle { shape: bundle.shape.that_may_be_uneven(), ..bundle }.solve().ok()?;
    let most = (OUTLIER * solved.corner_sd_px).powi(2);
    let left = |of: &Solution| of.residuals_px.iter().map(|r| r.norm_squared().min(most)).sum::<f64>();
    let groups = [false, true].map(|which| (0..turned.len()).filter(|i| turned.get(*i) == Some(&which)).collect());
    let lenses = [found.geometry.lens, turn.lens(found.geometry.lens, size_px)];
    let evidence = turn.apart(&found, size_px)? * (left(solved) / left(&found) - 1.0);
    // What else was done to pictures, a zoom or a shift, may be nearer to the turned lens than to their own.
    let [own, others] = [false, true].map(|which| {
        let of_group = corners.iter().zip(&found.residuals_px).filter(|(c, _)| turned.get(c.picture) == Some(&which));
        upper_median(of_group.map(|(_, residual)| residual.norm()))
    });
    let alike = own.zip(others).is_some_and(|(a, b)| a.max(b) < ALIKE * a.min(b));
    (evidence > MIN_EVIDENCE).then_some((evidence, TwoLenses { groups, lenses, turn: alike.then_some(turn) }))
}

/// Pictures of which some are turned back.
struct Split {
    /// Whether each is.
    turned: Vec<bool>,
    /// The solution with an even print.
    bundle: Bundle,
    /// Sum of squares.
    left: f64,
}

/// Turns pictures back or not, as suits the lens.
fn part(mut lens: Lens, as_given: &Pictures, all: &Pictures) -> Option<Split> {
    let mut shape = as_given.0.shape;
    let mut best: Option<Split> = None;
    for _ in 0..MAX_ROUNDS {
        let of = |(solved, corners): &Pictures| squares(solved, &shape, &lens, corners);
        let (own, others) = (of(as_given)?, of(all)?);
        let clusters: Vec<bool> = own.iter().zip(&others).map(|(own, other)| other < own).collect();
        let left = own.iter().zip(&others).map(|(own, other)| own.min(*other)).sum();
        let turned: Vec<bool> = as_given.0.clusters.iter().map(|c| clusters.get(*c) == Some(&true)).collect();
        if let Some(best) = best.as_mut().filter(|best| best.turned == turned) {
            best.left = left;
            break;
        }
        let is_turned = |picture: usize| turned.get(picture) == Some(&true);
        let (mut solved, mut corners) = as_given.clone();
        let poses = solved.poses.iter_mut().zip(&all.0.poses).enumerate().filter(|(i, _)| is_turned(*i));
        poses.for_each(|(_, (pose, turned))| *pose = *turned);
        let moved = corners.iter_mut().zip(&all.1).filter(|(corner, _)| is_turned(corner.picture));
        moved.for_each(|(corner, turned)| *corner = *turned);
        let pictures: Vec<usize> = (0..turned.len()).collect();
        let bundle = solved.of_pictures(&pictures, &corners).search().ok()?;
        (lens, shape) = (bundle.geometry.lens, bundle.shape);
        best = Some(Split { turned, bundle, left });
    }
    best
}
