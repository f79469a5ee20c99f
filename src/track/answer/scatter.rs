//! Scatter of measurements from frame to frame, compared with their covariance.
//!
//! A coder displaces what is not worth its bits, a whole band at once, and no residual shows that. But it does so
//! differently in every frame, while a catheter moves smoothly: over a fraction of a second its motion is a polynomial
//! of time, and the divided difference of the next higher order leaves only the errors,
//!
//! y = Σ cᵢ xᵢ, cᵢ = 1 / Π_{j≠i} (tᵢ − tⱼ), E|y|² = Σ cᵢ² tr Cᵢ.
//!
//! The mean of |y|² over its expectation, for the recent frames, is the factor by which the covariance is too small.
//!
//! Rounded stamps scatter what moves: by its speed times their σ, which is expected too and no error of the place.
//!
//! Below 24 frames per second so many frames take longer than a motion is a polynomial, and the factor is 1. Errors
//! that persist from frame to frame do not show. The excess over the expectation is taken to be the fraction of such
//! errors that changes, as given by the image model (image_model.rs).

use crate::source::Timestamp;
use crate::source::times::seconds;
use nalgebra::{Matrix3, Vector3};
use std::collections::VecDeque;

/// Order of the difference: at 60 Hz it reduces a swing of 3 Hz and 40 mm to 1 µm but keeps errors of 30 µm whole.
const ORDER: usize = 6;
/// Longest span of frames over which the motion is a polynomial, nanoseconds.
const LONGEST_NS: i64 = 250_000_000;
/// Half-life of an observation, frames.
const HALF_LIFE: f64 = 10.0;
/// Factor of a scatter that σ does not explain by far, and frames with it after which it is no chance.
const LARGE: f64 = 16.0;
const FRAMES: u32 = 30;
/// Prior: the covariance is right, with the weight of this many frames.
const PRIOR_FRAMES: f64 = 1.0;

/// Measurements of one quantity, and their scatter.
#[derive(Debug, Clone, Default)]
pub(in crate::track) struct Scatter {
    recent: VecDeque<(i64, Vector3<f64>, f64)>,
    sum: f64,
    frames: f64,
    /// Frames in which it was large.
    large: u32,
}

impl Scatter {
    /// Adds a measurement; returns the factor, 1 or more, by which its covariance is too small. Of errors beyond it,
    /// the fraction `persisting` of their variance persists from frame to frame. `stamp_sd_s` is σ of the stamps by
    /// their rounding, seconds.
    pub(in crate::track) fn add(
        &mut self,
        stamp: Timestamp,
        value: Vector3<f64>,
        covariance: &Matrix3<f64>,
        (persisting, stamp_sd_s): (f64, f64),
    ) -> f64 {
        // A clock that is set back begins anew.
        if self.recent.back().is_some_and(|last| stamp.ns < last.0) {
            self.recent.clear();
        }
        self.recent.push_back((stamp.ns, value, covariance.trace()));
        while self.recent.len() > ORDER + 1
            || self.recent.front().is_some_and(|first| stamp.ns.saturating_sub(first.0) > LONGEST_NS)
        {
            self.recent.pop_front();
        }
        if let Some(ratio) = self.ratio(stamp_sd_s) {
            let fading = 0.5_f64.powf(1.0 / HALF_LIFE);
            (self.sum, self.frames) = (self.sum * fading + ratio, self.frames * fading + 1.0);
        }
        let ratio = (self.sum + PRIOR_FRAMES) / (self.frames + PRIOR_FRAMES);
        let factor = 1.0 + (ratio - 1.0).max(0.0) / (1.0 - persisting);
        self.large = self.large.saturating_add(u32::from(factor > LARGE));
        factor
    }

    /// Whether it was large for a while: the motion is not smooth, or the frames do not show it evenly.
    pub(in crate::track) fn is_unsteady(&self) -> bool {
        self.large >= FRAMES
    }

    /// Square of the difference over its expectation; `None` with too few frames.
    fn ratio(&self, stamp_sd_s: f64) -> Option<f64> {
        if self.recent.len() <= ORDER {
            return None;
        }
        let newest = self.recent.back()?.0;
        let before_s = |ns: i64| seconds(ns.saturating_sub(newest));
        let (mut difference, mut expected) = (Vector3::zeros(), 0.0);
        for (i, (t, value, trace)) in self.recent.iter().enumerate() {
            let others = self.recent.iter().enumerate().filter(|(j, _)| *j != i);
            // Times are in frames of 60 Hz, so that the product stays within range.
            let c = 1.0 / others.map(|(_, other)| (before_s(*t) - before_s(other.0)) * 60.0).product::<f64>();
            difference += value * c;
            expected += c * c * (trace + (self.speed(i) * stamp_sd_s).powi(2));
        }
        let ratio = difference.norm_squared() / expected;
        ratio.is_finite().then_some(ratio)
    }

    /// Speed at a measurement, per second, from those beside it; 0 where none are.
    fn speed(&self, i: usize) -> f64 {
        let (before, after) = (self.recent.get(i.saturating_sub(1)), self.recent.get(i + 1).or(self.recent.back()));
        let (Some((from, a, _)), Some((to, b, _))) = (before, after) else { return 0.0 };
        let speed = (b - a).norm() / seconds(to.saturating_sub(*from));
        if speed.is_finite() { speed } else { 0.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::source::Clock;
    use crate::testing::random::Random;

    /// A swing of 40 mm at 2 Hz, measured about every 60th of a second with errors of `sd`, metres.
    fn swing(sd: f64, mut measured: impl FnMut(Timestamp, Vector3<f64>)) {
        let mut dice = Random::new(5);
        for i in 0..400 {
            let ns = i * 16_666_667 + (dice.normal() * 1e6) as i64;
            let way = 0.04 * (12.6 * ns as f64 * 1e-9).sin();
            let error = Vector3::new(dice.normal(), dice.normal(), dice.normal()) * sd;
            measured(Timestamp { ns, clock: Clock::Container }, Vector3::new(way, 0.3 * way, -way) + error);
        }
    }

    /// The mean factor where errors of `sd` are stated as `said`.
    fn factor(sd: f64, said: f64, persisting: f64) -> f64 {
        let (mut scatter, mut sum) = (Scatter::default(), 0.0);
        let covariance = Matrix3::identity() * said.powi(2);
        swing(sd, |stamp, value| sum += scatter.add(stamp, value, &covariance, (persisting, 0.0)));
        sum / 400.0
    }

    #[test]
    fn errors_larger_than_said_are_seen_through_a_swing_and_honest_ones_change_little() {
        let honest = factor(3e-5, 3e-5, 0.0);
        assert!((1.0..1.3).contains(&honest), "{honest}");
        let three = factor(9e-5, 3e-5, 0.0);
        assert!((6.5..11.0).contains(&three), "{three}");
        assert!((factor(9e-5, 3e-5, 0.5) - (2.0 * three - 1.0)).abs() < 1e-9);
        assert!((factor(1e-5, 3e-5, 0.5) - 1.0).abs() < 1e-12);
    }

    #[test]
    fn stamps_in_whole_milliseconds_are_no_scatter() {
        let mean = |stamp_sd_s: f64| {
            let (mut scatter, mut sum) = (Scatter::default(), 0.0);
            swing(1e-5, |stamp, value| {
                let stamp = Timestamp { ns: (stamp.ns + 500_000).div_euclid(1_000_000) * 1_000_000, ..stamp };
                sum += scatter.add(stamp, value, &(Matrix3::identity() * 1e-10), (0.0, stamp_sd_s));
            });
            sum / 400.0
        };
        let (known, unknown) = (mean(1e-3 / 12.0_f64.sqrt()), mean(0.0));
        assert!((1.0..1.4).contains(&known) && unknown > 20.0, "{known} {unknown}");
    }

    #[test]
    fn only_a_large_scatter_is_unsteady() {
        let unsteady = |sd: f64| {
            let mut scatter = Scatter::default();
            swing(sd, |stamp, value| {
                _ = scatter.add(stamp, value, &(Matrix3::identity() * 3e-5_f64.powi(2)), (0.0, 0.0))
            });
            scatter.is_unsteady()
        };
        assert!(!unsteady(3e-5) && !unsteady(6e-5) && unsteady(3e-4));
    }
}
