//! Follows the blur of the pictures, where it is no longer that on which the bands were taught: a lens that was moved,
//! a camera that sharpens, a mirror that fogs. With a wrong blur bands are off by some tenths of a pixel, and no
//! residual tells.
//!
//! Method. Some frames are fitted with more and with less blur too. Three misfits give slope and curvature over the
//! logarithm of the blur, and over several frames its minimum (misfit_curve.rs): the criterion by which the bands are
//! taught. Motion blurs as well: unless the exposure is known, and its blur modelled, only frames in which the coil
//! hardly moves count. What the pose of the catheter and a coder do to the minimum stays below a quarter of the blur.
//! If it is further away, and that is no chance, the blur moves there in steps. The misfit of each view tells the same
//! of that view: where they differ by more than a quarter, each follows its own, else all follow the common one, which
//! is known better.
//!
//! Cannot detect: changes below a quarter, and any while the coil always moves by several pixels per frame.

use crate::rig::Rig;
use crate::source::Timestamp;
use crate::track::fit::tube_fit::{TubeFit, ViewFit};
use crate::track::memory::trials::Trials;
use crate::track::recording::misfit_curve::{Curve, Distance, STEP, are_apart};

/// Blur assumed for a rig whose blur has not been measured: a sharp lens and square pixels.
const DEFAULT_BLUR_PX: f64 = 0.6;
/// Frames for a decision: whether the blur is another one, and how far it is, once that is known.
const FRAMES: (usize, usize) = (12, 5);
/// Distance of the minimum from which the blur follows, difference of the logarithm: at first, and once it has. The
/// same for how far views are from each other.
const FOLLOWS: (f64, f64) = (0.22, 0.05);
/// Limits of the blur, pixels.
const LIMITS_PX: (f64, f64) = (0.25, 4.0);
/// Fastest motion from one frame to the next, pixels: where its blur is modelled, and where not. During the longest
/// exposure the second adds a sixth to a blur of half a pixel.
const FASTEST_PX: (f64, f64) = (4.0, 1.0);
/// Largest difference of two fits that ended in the same minimum, pixels.
const SAME_PX: f64 = 0.7;

/// The blur of the pictures in each view.
#[derive(Debug)]
pub(in crate::track) struct Focus {
    blurs_px: Vec<f64>,
    /// The fastest motion of frames that count, pixels per frame.
    fastest_px: f64,
    trials: Trials,
    /// Of the frames since the last decision: of all views together, and of each.
    all: Curve,
    views: Vec<Curve>,
    /// Whether the blur has ever changed, and whether the views' have by different factors.
    followed: bool,
    apart: bool,
}

impl Focus {
    /// Beginning with that of the rig, where motion blur is modelled if the exposure is known.
    pub(in crate::track) fn of(rig: &Rig) -> Self {
        let blurs_px = rig.blurs_px().map(|blur_px| blur_px.unwrap_or(DEFAULT_BLUR_PX)).collect();
        Self::new(blurs_px, rig.camera.exposure_s.is_some())
    }

    fn new(blurs_px: Vec<f64>, knows_motion: bool) -> Self {
        let fastest_px = if knows_motion { FASTEST_PX.0 } else { FASTEST_PX.1 };
        let views = vec![Curve::default(); blurs_px.len()];
        let (all, trials) = (Curve::default(), Trials::default());
        Self { blurs_px, fastest_px, trials, all, views, followed: false, apart: false }
    }

    /// Of the pictures in each view, pixels.
    pub(in crate::track) fn blurs_px(&self) -> &[f64] {
        &self.blurs_px
    }

    /// Of the view that is blurred most.
    pub(in crate::track) fn most_px(&self) -> f64 {
        self.blurs_px.iter().copied().fold(0.0, f64::max)
    }

    /// Whether it is no longer that of the rig.
    pub(in crate::track) fn has_changed(&self) -> bool {
        self.followed
    }

    /// The blurs with which a frame is to be fitted too, less and more, if it is; its coil moved so many pixels.
    pub(in crate::track) fn tries(&mut self, stamp: Timestamp, moved_px: f64) -> Option<[Vec<f64>; 2]> {
        let counts = moved_px <= self.fastest_px && self.trials.are_due(stamp);
        counts.then(|| [-STEP, STEP].map(|by| self.blurs_px.iter().map(|blur_px| blur_px * by.exp()).collect()))
    }

    /// Adds the fits of that frame in some views with less and with more blur; whether the blur moves.
    pub(in crate::track) fn moves(&mut self, views: &[usize], fit: &TubeFit, [less, more]: [&TubeFit; 2]) -> bool {
        let is_same = |other: &TubeFit| {
            let place = |view: &ViewFit| view.image.at_arc(0.0).pixel;
            fit.views.iter().zip(&other.views).all(|(a, b)| (place(a) - place(b)).norm() < SAME_PX)
        };
        if !(is_same(less) && is_same(more)) {
            return false;
        }
        let fits = [less, fit, more];
        let of_view = |(i, v): (usize, &usize)| Some((*v, all_of(fits.map(|fit| Some(fit.views.get(i)?.misfit)))?));
        let of_views: Vec<_> = views.iter().enumerate().filter_map(of_view).collect();
        self.add(fits.map(|fit| fit.misfit), &of_views)
    }

    fn add(&mut self, misfits: [f64; 3], of_views: &[(usize, [f64; 3])]) -> bool {
        let frames = if self.followed { FRAMES.1 } else { FRAMES.0 };
        self.all.add(misfits);
        of_views.iter().for_each(|(v, misfits)| self.views[*v].add(*misfits));
        if self.all.slopes.len() < frames {
            return false;
        }
        let moves = self.decide(frames);
        let (low, high) = LIMITS_PX;
        for (blur_px, distance) in self.blurs_px.iter_mut().zip(&moves) {
            *blur_px = distance.map_or(*blur_px, |distance| (*blur_px * distance.factor()).clamp(low, high));
        }
        let moved = moves.iter().any(Option::is_some);
        if moved {
            self.followed = true;
            tracing::debug!("the pictures' blur is now taken for {:.3?} px", self.blurs_px);
        }
        self.trials.go_on(moved);
        self.all = Curve::default();
        self.views.fill(Curve::default());
        moved
    }

    /// How far each view's blur is to move, if it is.
    fn decide(&mut self, frames: usize) -> Vec<Option<Distance>> {
        let least = |again: bool| if again { FOLLOWS.1 } else { FOLLOWS.0 };
        let seen = |view: &Curve| view.distance().filter(|_| view.slopes.len() >= frames);
        let own: Vec<_> = self.views.iter().map(seen).collect();
        let all = self.all.distance();
        tracing::debug!("the best blur is away by {all:?}, in the views {own:?}");
        let apart = are_apart(&own, least(self.apart));
        let moves = if apart { own } else { vec![all; own.len()] };
        let least = least(self.followed || apart);
        self.apart |= apart;
        moves.into_iter().map(|distance| distance.filter(|distance| distance.exceeds(least))).collect()
    }
}

/// All three, if there are.
fn all_of([less, own, more]: [Option<f64>; 3]) -> Option<[f64; 3]> {
    Some([less?, own?, more?])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::random::Random;

    /// The blurs after some decisions on pictures of others, with noise of the misfits.
    fn followed(taught_px: [f64; 2], true_px: [f64; 2], noise: f64) -> Focus {
        let (mut focus, mut random) = (Focus::new(taught_px.to_vec(), false), Random::new(3));
        for _ in 0..20 * FRAMES.0 {
            // As of real pictures: flatter far away.
            let mut misfit = |off: f64| 0.5 * (0.5 + off.powi(2)).ln() + noise * random.normal();
            let of_views = [0, 1].map(|v| {
                let off = (focus.blurs_px[v] / true_px[v]).ln();
                (v, [off - STEP, off, off + STEP].map(&mut misfit))
            });
            let mean = |k: usize| f64::midpoint(of_views[0].1[k], of_views[1].1[k]);
            focus.add([mean(0), mean(1), mean(2)], &of_views);
        }
        focus
    }

    fn assert_found(focus: &Focus, true_px: [f64; 2]) {
        for (found, true_px) in focus.blurs_px.iter().zip(true_px) {
            assert!((found / true_px).ln().abs() < 0.1, "{found}, not {true_px}");
        }
    }

    #[test]
    fn a_blur_that_changed_is_found() {
        for true_px in [0.3, 0.7, 1.2] {
            let focus = followed([0.5; 2], [true_px; 2], 0.02);
            assert_found(&focus, [true_px; 2]);
            assert!((focus.blurs_px[0] - focus.blurs_px[1]).abs() < 1e-12, "it is common to the views");
        }
    }

    #[test]
    fn a_blur_that_is_about_right_stays_and_so_does_one_that_cannot_be_seen() {
        for true_px in [0.46, 0.5, 0.55] {
            assert!((followed([0.5; 2], [true_px; 2], 0.02).most_px() - 0.5).abs() < 1e-12, "{true_px}");
        }
        assert!((followed([0.5; 2], [0.9; 2], 30.0).most_px() - 0.5).abs() < 1e-12);
    }

    #[test]
    fn views_that_became_different_are_found_and_one_that_did_not_change_stays() {
        for true_px in [[0.5, 0.93], [0.5, 0.7], [0.8, 0.5], [0.35, 0.9]] {
            assert_found(&followed([0.5; 2], true_px, 0.02), true_px);
        }
        assert!((followed([0.5; 2], [0.5, 0.93], 0.005).blurs_px[0] - 0.5).abs() < 1e-12);
    }

    #[test]
    fn views_that_were_taught_with_different_blurs_change_together() {
        let focus = followed([0.5, 0.8], [0.75, 1.2], 0.02);
        assert_found(&focus, [0.75, 1.2]);
        assert!((focus.blurs_px[1] / focus.blurs_px[0] - 1.6).abs() < 1e-12);
    }

    /// A view that hides the coil tells nothing.
    #[test]
    fn a_view_that_is_not_seen_follows_the_others() {
        let mut focus = Focus::new(vec![0.5; 2], false);
        for k in 0..40 {
            let misfit = |blur: f64| (blur / 0.8).ln().powi(2) + 1e-3 * f64::from(k % 3);
            let misfits = [(-STEP).exp(), 1.0, STEP.exp()].map(|by| misfit(focus.blurs_px[0] * by));
            focus.add(misfits, &[(0, misfits)]);
        }
        assert_found(&focus, [0.8; 2]);
    }
}
