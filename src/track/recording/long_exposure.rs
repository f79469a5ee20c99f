//! Whether the rig states an exposure that is longer than a frame: a wrong unit, or that of another rate.
//!
//! Motion is then blurred in the model by more than it can be, and moving bands are not found, or in the wrong places.

use crate::source::Timestamp;

/// An exposure lasts at most for a frame, give or take what stamps are off.
pub(crate) const LONGEST_EXPOSURE: f64 = 1.1;
/// Steps in a row, shorter than the exposure: single ones are of stamps that are off.
const STEPS: u32 = 10;

/// Compares the exposure with the steps from frame to frame.
pub(in crate::track) struct LongExposure {
    exposure_s: Option<f64>,
    steps: u32,
}

impl LongExposure {
    /// For the exposure of a rig, seconds.
    pub(in crate::track) fn of(exposure_s: Option<f64>) -> Self {
        Self { exposure_s, steps: 0 }
    }

    /// Takes the time of a frame, and of the one before.
    pub(in crate::track) fn add(&mut self, now: Timestamp, before: Timestamp) {
        let step_s = now.seconds_since(before);
        let is_short = self.exposure_s.is_some_and(|exposure_s| step_s > 0.0 && exposure_s > LONGEST_EXPOSURE * step_s);
        if !self.is_seen() {
            self.steps = if is_short { self.steps + 1 } else { 0 };
        }
    }

    /// Whether it is too long.
    pub(in crate::track) fn is_seen(&self) -> bool {
        self.steps >= STEPS
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::source::Clock;

    /// Whether it is seen in frames at these times, milliseconds.
    fn seen(exposure_s: Option<f64>, times_ms: impl Iterator<Item = f64>) -> bool {
        let mut exposure = LongExposure::of(exposure_s);
        let stamps: Vec<Timestamp> =
            times_ms.map(|ms| Timestamp { ns: (ms * 1e6) as i64, clock: Clock::Container }).collect();
        stamps.windows(2).for_each(|pair| exposure.add(pair[1], pair[0]));
        exposure.is_seen()
    }

    #[test]
    fn an_exposure_longer_than_frames_is_seen_and_a_stamp_that_is_off_is_not() {
        let steady = || (0..100).map(|k| f64::from(k) * 16.7);
        assert!(seen(Some(0.5), steady()));
        assert!(!seen(Some(0.0165), steady()) && !seen(None, steady()));
        assert!(!seen(Some(0.0165), steady().map(|ms| if (ms as i64) % 5 == 0 { ms + 6.0 } else { ms })));
    }
}
