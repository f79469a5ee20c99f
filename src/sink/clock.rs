//! Times in files for people: the zero of their axis, and those of a video's frames.

use crate::source::times::seconds;

/// Start of the time axis of an overlay video or a report, nanoseconds of the camera's clock.
///
/// Recordings count from near zero and are shown with their own times. With clocks that count from the computer's start
/// or from 1970 the axis would begin hours or decades before the first frame: there it starts at the first frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Origin {
    /// Camera time of zero.
    pub ns: i64,
}

/// Latest first stamp that is shown unchanged: one hour.
const LATEST_OWN_ZERO_NS: i64 = 3_600_000_000_000;

impl Origin {
    /// From the stamp of the first frame.
    pub(crate) fn of_first(stamp_ns: i64) -> Self {
        Self { ns: if (0..=LATEST_OWN_ZERO_NS).contains(&stamp_ns) { 0 } else { stamp_ns } }
    }

    /// Nanoseconds on the axis.
    pub(crate) fn elapsed_ns(self, stamp_ns: i64) -> i64 {
        stamp_ns.saturating_sub(self.ns)
    }

    /// Seconds on the axis; the difference is taken in whole nanoseconds first.
    pub(crate) fn elapsed_s(self, stamp_ns: i64) -> f64 {
        seconds(self.elapsed_ns(stamp_ns))
    }
}

/// Times of a video's frames, in the smallest unit of time in its file.
pub(super) struct Rising {
    /// That of the last frame; -1 before the first.
    pub last: i64,
    /// Whether a frame was not later than the one before.
    went_back: bool,
}

impl Rising {
    pub(super) fn new() -> Self {
        Self { last: -1, went_back: false }
    }

    /// The time of a frame whose stamp is at `time`. Two frames cannot be shown at once: one that is not later than the
    /// one before moves by one unit behind it. `warning` says so, of the first.
    pub(super) fn next(&mut self, time: i64, stamp_ns: i64, warning: &str) -> i64 {
        if time <= self.last && !self.went_back {
            tracing::warn!(stamp_ns, "{warning}");
            self.went_back = true;
        }
        self.last = time.max(self.last + 1);
        self.last
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn recordings_keep_their_time_and_clocks_since_1970_start_at_the_first_frame() {
        assert_eq!(Origin::of_first(33_000_000).elapsed_ns(50_000_000), 50_000_000);
        let unix = 1_700_000_000_123_456_789;
        assert_eq!(Origin::of_first(unix).elapsed_ns(unix + 16_666_667), 16_666_667);
        assert_eq!(Origin::of_first(-5).elapsed_ns(-5), 0);
    }
}
