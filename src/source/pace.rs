//! Frames at the pace at which they were taken.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// How long a wait sleeps before it looks whether it shall stop.
pub(crate) const POLL_INTERVAL: Duration = Duration::from_millis(50);

/// When frames are due, counted from the first one.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Pace {
    began: Instant,
    first_ns: i64,
}

impl Pace {
    /// The frame stamped `first_ns` is due now.
    pub(crate) fn from_now(first_ns: i64) -> Self {
        Self { began: Instant::now(), first_ns }
    }

    /// Whether a frame stamped `ns` should have been passed on before now.
    pub(crate) fn is_overdue(&self, ns: i64) -> bool {
        self.due(ns) < Instant::now()
    }

    /// Waits until a frame stamped `ns` is due; false when asked to stop.
    pub(crate) fn wait(&self, ns: i64, stop: &AtomicBool) -> bool {
        let due = self.due(ns);
        loop {
            if stop.load(Ordering::Relaxed) {
                return false;
            }
            let rest = due.saturating_duration_since(Instant::now());
            if rest.is_zero() {
                return true;
            }
            std::thread::sleep(rest.min(POLL_INTERVAL));
        }
    }

    /// A stamp that goes back is due at once.
    fn due(&self, ns: i64) -> Instant {
        self.began + Duration::from_nanos(u64::try_from(ns.saturating_sub(self.first_ns)).unwrap_or(0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_are_due_after_the_time_between_their_stamps() {
        let (pace, stop) = (Pace::from_now(1_000), AtomicBool::new(false));
        assert!(pace.wait(1_000, &stop) && pace.wait(-1_000, &stop));
        let late = 1_000 + 20_000_000;
        assert!(pace.wait(late, &stop) && pace.began.elapsed() >= Duration::from_millis(20));
        assert!(!pace.is_overdue(i64::MAX));
        stop.store(true, Ordering::Relaxed);
        assert!(!pace.wait(i64::MAX, &stop));
    }
}
