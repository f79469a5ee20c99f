//! Follows the blur of the pictures, where it is no longer that on which the bands were taught: a lens that was moved,
//! a camera that sharpens. With a wrong blur bands are off by some tenths of a pixel, and no residual tells.
//!
//! Method. Some frames are fitted with more and with less blur too. Three misfits give slope and curvature over the
//! logarithm of the blur, and over several frames its minimum: the criterion by which the bands are taught. Motion
//! blurs as well: unless the exposure is known, and its blur modelled, only frames in which the coil hardly moves
//! count. What the pose of the catheter and a coder do to the minimum stays below a quarter of the blur. If it is
//! further away, and that is no chance, the blur moves there in steps.
//!
//! Cannot detect: blur that differs between the views, changes below a quarter, and any while the coil always moves by
//! several pixels per frame.

use crate::rig::Rig;
use crate::source::Timestamp;
use crate::track::fit::{TubeFit, ViewFit};
use crate::track::trials::Trials;

/// Blur assumed for a rig whose blur has not been measured: a sharp lens and square pixels.
const DEFAULT_BLUR_PX: f64 = 0.6;
/// How much more or less blur is tried, and how far it moves at a time: difference of its logarithm.
const STEP: f64 = 0.2;
const LONGEST_MOVE: f64 = 0.4;
/// Frames for a decision: whether the blur is another one, and how far it is, once that is known.
const FRAMES: (usize, usize) = (12, 5);
/// Distance of the minimum from which the blur follows, difference of the logarithm: at first, and once it has.
const FOLLOWS: (f64, f64) = (0.22, 0.05);
/// Standard deviations of the mean slope beyond which it is no chance.
const SIGNIFICANT_SD: f64 = 4.0;
/// Limits of the blur, pixels.
const LIMITS_PX: (f64, f64) = (0.25, 4.0);
/// Fastest motion from one frame to the next, pixels: where its blur is modelled, and where not. During the longest
/// exposure the second adds a sixth to a blur of half a pixel.
const FASTEST_PX: (f64, f64) = (4.0, 1.0);
/// Largest difference of two fits that ended in the same minimum, pixels.
const SAME_PX: f64 = 0.7;

/// The blur of the pictures.
#[derive(Debug)]
pub(crate) struct Focus {
    blur_px: f64,
    /// The fastest motion of frames that count, pixels per frame.
    fastest_px: f64,
    trials: Trials,
    /// Of these frames since the last decision: slopes of the misfit over the logarithm of the blur, and the sum of its
    /// curvatures.
    slopes: Vec<f64>,
    curvature: f64,
    /// Whether the blur has ever changed.
    followed: bool,
}

impl Focus {
    /// Beginning with that of the rig, where motion blur is modelled if the exposure is known.
    pub(crate) fn of(rig: &Rig) -> Self {
        Self::new(rig.camera.blur_px.unwrap_or(DEFAULT_BLUR_PX), rig.camera.exposure_s.is_some())
    }

    fn new(blur_px: f64, knows_motion: bool) -> Self {
        let fastest_px = if knows_motion { FASTEST_PX.0 } else { FASTEST_PX.1 };
        Self { blur_px, fastest_px, trials: Trials::default(), slopes: Vec::new(), curvature: 0.0, followed: false }
    }

    /// Of the pictures, pixels.
    pub(crate) fn blur_px(&self) -> f64 {
        self.blur_px
    }

    /// Whether it is no longer that of the rig.
    pub(crate) fn has_changed(&self) -> bool {
        self.followed
    }

    /// The blurs with which a frame is to be fitted too, less and more, if it is; its coil moved so many pixels.
    pub(crate) fn tries(&mut self, stamp: Timestamp, moved_px: f64) -> Option<[f64; 2]> {
        let counts = moved_px <= self.fastest_px && self.trials.are_due(stamp);
        counts.then(|| [-STEP, STEP].map(|by| self.blur_px * by.exp()))
    }

    /// Adds the fits of that frame with less and with more blur; whether the blur moves.
    pub(crate) fn moves(&mut self, fit: &TubeFit, [less, more]: [&TubeFit; 2]) -> bool {
        let is_same = |other: &TubeFit| {
            let place = |view: &ViewFit| view.image.at_arc(0.0).pixel;
            fit.views.iter().zip(&other.views).all(|(a, b)| (place(a) - place(b)).norm() < SAME_PX)
        };
        is_same(less) && is_same(more) && self.add([less, fit, more].map(|fit| fit.misfit))
    }

    fn add(&mut self, [less, own, more]: [f64; 3]) -> bool {
        let (count, least) = if self.followed { (FRAMES.1, FOLLOWS.1) } else { (FRAMES.0, FOLLOWS.0) };
        self.slopes.push((more - less) / (2.0 * STEP));
        self.curvature += (more - 2.0 * own + less) / STEP.powi(2);
        if self.slopes.len() < count {
            return false;
        }
        let off = self.off().filter(|off| off.abs() > least);
        if let Some(off) = off {
            let (low, high) = LIMITS_PX;
            self.blur_px = (self.blur_px * off.clamp(-LONGEST_MOVE, LONGEST_MOVE).exp()).clamp(low, high);
            self.followed = true;
            tracing::debug!("the pictures' blur is now taken for {:.3} px", self.blur_px);
        }
        self.trials.go_on(off.is_some());
        self.slopes.clear();
        self.curvature = 0.0;
        off.is_some()
    }

    /// How far the best blur is from the present one, as the difference of the logarithm; `None` if that may be chance.
    /// Without a minimum nearby it is far.
    fn off(&self) -> Option<f64> {
        let count = self.slopes.len() as f64;
        let slope = self.slopes.iter().sum::<f64>() / count;
        let variance = self.slopes.iter().map(|one| (one - slope).powi(2)).sum::<f64>() / (count - 1.0) / count;
        if slope.abs() <= SIGNIFICANT_SD * variance.sqrt() {
            return None;
        }
        let curvature = self.curvature / count;
        Some(if curvature > 0.0 { -slope / curvature } else { -slope.signum() * LONGEST_MOVE })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::random::Random;

    /// The blur after some decisions on pictures of another one, with noise of the misfits.
    fn followed(taught_px: f64, true_px: f64, noise: f64) -> f64 {
        let (mut focus, mut random) = (Focus::new(taught_px, false), Random::new(3));
        for _ in 0..20 * FRAMES.0 {
            // As of real pictures: flatter far away.
            let misfit = |blur: f64| 0.5 * (0.5 + (blur / true_px).ln().powi(2)).ln() + noise * random.normal();
            focus.add([(-STEP).exp(), 1.0, STEP.exp()].map(|by| focus.blur_px * by).map(misfit));
        }
        focus.blur_px
    }

    #[test]
    fn a_blur_that_changed_is_found() {
        for true_px in [0.3, 0.7, 1.2] {
            let found = followed(0.5, true_px, 0.02);
            assert!((found / true_px).ln().abs() < 0.1, "{found}, not {true_px}");
        }
    }

    #[test]
    fn a_blur_that_is_about_right_stays_and_so_does_one_that_cannot_be_seen() {
        for true_px in [0.46, 0.5, 0.55] {
            assert!((followed(0.5, true_px, 0.02) - 0.5).abs() < 1e-12, "{true_px}");
        }
        assert!((followed(0.5, 0.9, 30.0) - 0.5).abs() < 1e-12);
    }
}
