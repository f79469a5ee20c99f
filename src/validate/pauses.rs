//! From camera frames to one observed point per command.
//!
//! A command is held for a pause. Where there is at least one camera frame per pause, the frames within it are
//! averaged. Where the pause is shorter than the time between frames, the motion is
//! [interpolated](super::Interpolation) between frames at the middle of each pause, where an average also belongs. A
//! command without a frame in its pause, or between frames with a gap, has no point: nothing is interpolated across a
//! gap, and nothing is extrapolated.

use super::spline::{Curve, Interpolation};
use crate::median::upper_median;
use crate::source::times::seconds;
use nalgebra::Vector3;

/// Frames further apart than this many usual intervals have a gap between them.
const GAP: f64 = 1.5;

/// Times of the commands: number k is held from `start_ns + k · pause_ns` for `pause_ns`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Window {
    pub(super) start_ns: i64,
    pub(super) pause_ns: i64,
    pub(super) commands: usize,
}

/// The observation of one command.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Mean {
    pub(super) value: Vector3<f64>,
    /// Frames averaged; 0 if interpolated.
    pub(super) frames: usize,
    /// Sum of the squared distances of these frames from it.
    pub(super) squares: f64,
    /// How much later than the middle of the pause these frames are in the mean, in pauses.
    pub(super) later: f64,
}

/// A value at a camera time.
pub(super) type Sample = (i64, Vector3<f64>);

impl Window {
    pub(super) fn end_ns(&self) -> i64 {
        self.at_ns(self.commands)
    }

    /// When command `k` begins.
    pub(super) fn at_ns(&self, k: usize) -> i64 {
        self.start_ns.saturating_add(self.pause_ns.saturating_mul(i64::try_from(k).unwrap_or(i64::MAX)))
    }

    /// Mean of the samples within each pause, without the fraction `left_out` at its beginning; samples are in order of
    /// time.
    pub(super) fn averaged(&self, samples: &[Sample], left_out: f64) -> Vec<Option<Mean>> {
        let late_ns = (self.pause_ns as f64 * left_out).round() as i64;
        (0..self.commands)
            .map(|k| {
                let from = samples.partition_point(|(ns, _)| *ns < self.at_ns(k).saturating_add(late_ns));
                let to = samples.partition_point(|(ns, _)| *ns < self.at_ns(k + 1));
                let inside = samples.get(from..to).filter(|inside| !inside.is_empty())?;
                let value = inside.iter().map(|(_, v)| v).sum::<Vector3<f64>>() / inside.len() as f64;
                let squares = inside.iter().map(|(_, v)| (v - value).norm_squared()).sum();
                let time_s = inside.iter().map(|(ns, _)| self.seconds(*ns)).sum::<f64>() / inside.len() as f64;
                let later = (time_s - self.middle_s(k)) / seconds(self.pause_ns);
                Some(Mean { value, frames: inside.len(), squares, later })
            })
            .collect()
    }

    /// The motion at the middle of each pause, between samples that are usually `interval_s` apart.
    pub(super) fn interpolated(&self, samples: &[Sample], interval_s: f64, how: Interpolation) -> Vec<Option<Mean>> {
        let times_s = samples.iter().map(|(ns, _)| self.seconds(*ns)).collect();
        let curve = Curve::through(times_s, samples.iter().map(|(_, v)| *v).collect(), how);
        (0..self.commands)
            .map(|k| {
                let (value, apart_s) = curve.at(self.middle_s(k))?;
                (apart_s < GAP * interval_s).then_some(Mean { value, frames: 0, squares: 0.0, later: 0.0 })
            })
            .collect()
    }

    /// The middle of pause `k`, relative to the start.
    fn middle_s(&self, k: usize) -> f64 {
        self.seconds(self.at_ns(k)) + self.pause_ns as f64 * 0.5e-9
    }

    /// Relative to the start: small numbers keep their digits.
    fn seconds(&self, ns: i64) -> f64 {
        seconds(ns.saturating_sub(self.start_ns))
    }
}

/// The usual time between frames, seconds: the median. `None` for fewer than two.
pub(super) fn interval_s(stamps_ns: &[i64]) -> Option<f64> {
    let steps = stamps_ns.iter().zip(stamps_ns.iter().skip(1)).map(|(a, b)| b.saturating_sub(*a));
    upper_median(steps.map(seconds))
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: i64 = 1_000_000;

    #[test]
    fn frames_within_a_pause_are_averaged_and_a_pause_without_one_is_left_out() {
        let window = Window { start_ns: 100 * MS, pause_ns: 50 * MS, commands: 4 };
        let at = |ms: i64, x: f64| (ms * MS, Vector3::new(x, 0.0, 0.0));
        // On a boundary a frame belongs to the pause that begins.
        let samples = [at(99, 9.0), at(100, 1.0), at(120, 3.0), at(150, 5.0), at(260, 7.0), at(300, 9.0)];
        let found = window.averaged(&samples, 0.0);
        let expected = |x: f64, frames, squares, later: f64| {
            let value = Vector3::new(x, 0.0, 0.0);
            move |mean: &Option<Mean>| {
                mean.is_some_and(|mean| {
                    (mean.value, mean.frames, mean.squares) == (value, frames, squares)
                        && (mean.later - later).abs() < 1e-9
                })
            }
        };
        // Means of 100 and 120, 150, 260 ms, in pauses of 50 ms from 100 ms on.
        assert!(expected(2.0, 2, 2.0, -0.3)(&found[0]) && expected(5.0, 1, 0.0, -0.5)(&found[1]), "{found:?}");
        assert!(found[2].is_none() && expected(7.0, 1, 0.0, -0.3)(&found[3]), "{found:?}");
        assert_eq!(window.end_ns(), 300 * MS);
        let late = window.averaged(&samples, 0.4);
        assert!(expected(3.0, 1, 0.0, -0.1)(&late[0]) && late[1..].iter().all(Option::is_none), "{late:?}");
    }

    #[test]
    fn short_pauses_are_interpolated_but_not_across_a_lost_frame() {
        let window = Window { start_ns: 0, pause_ns: 4 * MS, commands: 25 };
        let samples: Vec<Sample> = [0, 16, 32, 64, 80].map(|ms| (ms * MS, Vector3::new(ms as f64, 0.0, 1.0))).to_vec();
        let found = window.interpolated(&samples, 0.016, Interpolation::Spline);
        let known: Vec<usize> = (0..25).filter(|k| found[*k].is_some()).collect();
        assert_eq!(known, [(0..8).collect::<Vec<_>>(), (16..20).collect()].concat());
        for k in known {
            assert!((found[k].unwrap().value.x - (4.0 * k as f64 + 2.0)).abs() < 1e-9);
        }
    }

    #[test]
    fn the_usual_interval_is_the_median() {
        assert_eq!(interval_s(&[0, 16 * MS, 33 * MS, 80 * MS]), Some(0.017));
        assert_eq!(interval_s(&[5]), None);
    }
}
