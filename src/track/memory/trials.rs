//! How often frames are fitted in two other ways too, with less and with more of something.

use crate::source::Timestamp;

/// How far apart they are, seconds: while they are to decide soon, and when all was found right.
const SPACING_S: (f64, f64) = (0.05, 5.0);
/// Longest time over which a motion between frames tells something, seconds.
pub(in crate::track) const LONGEST_STEP_S: f64 = 0.25;

/// When such frames are due.
#[derive(Debug)]
pub(in crate::track) struct Trials {
    last: Option<Timestamp>,
    spacing_s: f64,
}

impl Default for Trials {
    fn default() -> Self {
        Self { last: None, spacing_s: SPACING_S.0 }
    }
}

impl Trials {
    /// Whether a frame is to be one.
    pub(in crate::track) fn are_due(&mut self, stamp: Timestamp) -> bool {
        // A clock may be set back.
        let due = self.last.is_none_or(|then| !(0.0..self.spacing_s).contains(&stamp.seconds_since(then)));
        self.last = if due { Some(stamp) } else { self.last };
        due
    }

    /// Whether they are to decide soon, from now on.
    pub(in crate::track) fn go_on(&mut self, soon: bool) {
        self.spacing_s = if soon { SPACING_S.0 } else { SPACING_S.1 };
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::source::Clock;

    #[test]
    fn they_are_due_from_time_to_time_and_after_a_clock_was_set_back() {
        let mut trials = Trials::default();
        let mut due = |ms: i64| trials.are_due(Timestamp { ns: ms * 1_000_000, clock: Clock::Stream });
        assert!(due(3_600_000) && !due(3_600_040) && due(3_600_060));
        assert!(due(0) && !due(40) && due(60));
    }
}
