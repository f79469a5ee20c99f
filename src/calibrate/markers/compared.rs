//! Which of two rigs explains the same frames better.

use crate::median::upper_median;
use crate::rig::Rig;
use crate::source::Frame;
use crate::track::misfit_curve::Curve;
use crate::track::{TrackOptions, Tracker};

/// Longest time between a frame and its follower, seconds.
pub(super) const LONGEST_PAIR_S: f64 = 0.06;
/// Independent thirds of the frames, whose results give the σ of what is fitted.
pub(super) const PARTS: usize = 3;
/// By how many σ something must be fitted better, or be beyond zero, to count.
pub(super) const MIN_GAIN_SDS: f64 = 3.0;
/// A difference beyond this many times the median one is that of a fit that ended elsewhere, and says nothing of the
/// rig.
const CLIPPED: f64 = 3.0;

/// Frames, and how badly a first rig explains each.
pub(super) struct Compared<'a> {
    frames: Vec<&'a Frame>,
    followers: &'a [Frame],
    first: Vec<Option<f64>>,
}

impl<'a> Compared<'a> {
    /// `followers`: frames that closely follow some of `frames`, in order; they show motion blur.
    pub(super) fn with(rig: &Rig, frames: Vec<&'a Frame>, followers: &'a [Frame]) -> Self {
        let mut compared = Self { frames, followers, first: Vec::new() };
        compared.first = compared.misfits(rig);
        compared
    }

    /// By how much `rig` explains the frames worse than the first one, mean ln σ² of the residuals; `None` when half of
    /// the frames or fewer can be fitted with both.
    pub(super) fn excess(&self, rig: &Rig) -> Option<f64> {
        self.excesses(rig).map(|excesses| clipped_mean(&excesses))
    }

    /// The same for each frame that can be fitted with both.
    pub(super) fn excesses(&self, rig: &Rig) -> Option<Vec<f64>> {
        let both = self.misfits(rig).into_iter().zip(&self.first);
        let differences: Vec<f64> = both.filter_map(|(misfit, first)| Some(misfit? - (*first)?)).collect();
        (differences.len() * 2 > self.frames.len()).then_some(differences)
    }

    /// Of the frames that can be fitted with all three: how their misfit changes from a rig with less blur than the
    /// first one by way of that to one with more; `None` when they are half of the frames or fewer.
    pub(super) fn curve(&self, less: &Rig, more: &Rig) -> Option<Curve> {
        let mut curve = Curve::default();
        for ((less, own), more) in self.misfits(less).into_iter().zip(&self.first).zip(self.misfits(more)) {
            if let (Some(less), Some(own), Some(more)) = (less, own, more) {
                curve.add([less, *own, more]);
            }
        }
        (curve.slopes.len() * 2 > self.frames.len()).then_some(curve)
    }

    /// Of each frame, motion blur included where the exposure and its follower are known.
    fn misfits(&self, rig: &Rig) -> Vec<Option<f64>> {
        let Ok(mut tracker) = Tracker::new(rig, TrackOptions::default()) else { return vec![None; self.frames.len()] };
        let misfit = |frame: &&Frame| {
            let next = self.followers.get(self.followers.partition_point(|next| next.stamp.ns <= frame.stamp.ns));
            let close = |next: &&Frame| next.stamp.seconds_since(frame.stamp) < LONGEST_PAIR_S;
            match next.filter(close).filter(|_| rig.camera.exposure_s.is_some()) {
                Some(next) => tracker.misfit_after(frame, next),
                None => tracker.misfit(frame),
            }
        };
        self.frames.iter().map(misfit).collect()
    }
}

/// The values, the largest reduced, so that each has a bounded influence on their mean.
pub(super) fn clipped(values: &[f64]) -> Vec<f64> {
    let limit = CLIPPED * upper_median(values.iter().map(|value| value.abs())).unwrap_or(0.0);
    values.iter().map(|value| value.clamp(-limit, limit)).collect()
}

pub(super) fn clipped_mean(values: &[f64]) -> f64 {
    clipped(values).iter().sum::<f64>() / values.len().max(1) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_wild_value_counts_little() {
        assert!((clipped_mean(&[0.02, -0.01, 0.015, 0.01, 0.02]) - 0.011).abs() < 1e-12);
        assert!(clipped_mean(&[-0.02, -0.01, -0.015, -0.01, 5.0]) < 0.0);
        assert!(clipped_mean(&[]).abs() < f64::MIN_POSITIVE);
    }
}
