//! Whether samples of currents that have no times of their own arrive in bursts.
//!
//! Such a sample gets the time of its arrival. If the sender, the network or, but for datagrams on Linux, this program
//! stood still, those that waited arrive together, about as many as should have come meanwhile, and all but the last
//! are late.

use crate::median::median;
use crate::source::times::seconds;
use std::collections::VecDeque;

/// Intervals of which the usual one is known: the latest, and the fewest.
const INTERVALS: usize = 32;
const FEWEST: usize = 8;
/// A silence is this many usual intervals, and samples that waited come within this part of one.
const SILENCE: f64 = 3.0;
const TOGETHER: f64 = 0.3;
/// Part of the samples that should have come during a silence, which come after it if they waited.
const MADE_UP: f64 = 0.5;
/// Fewest late samples to be told.
const MIN_LATE: u64 = 3;
/// A silence that makes samples late by more than matters, nanoseconds.
const LEAST_SILENCE_NS: i64 = 20_000_000;

/// Arrivals of samples, and how many of them waited.
#[derive(Debug, Default)]
pub(super) struct Bursts {
    last_ns: Option<i64>,
    intervals_ns: VecDeque<f64>,
    /// The silence that the current burst follows, nanoseconds, 0 outside of a burst; and the samples of the burst.
    silence_ns: i64,
    burst: u64,
    late: u64,
    longest_ns: i64,
}

impl Bursts {
    /// The next sample arrived.
    pub(super) fn take(&mut self, arrival_ns: i64) {
        let Some(last_ns) = self.last_ns.replace(arrival_ns) else { return };
        let interval_ns = arrival_ns.saturating_sub(last_ns);
        let usual_ns = median(self.intervals_ns.iter().copied()).filter(|_| self.intervals_ns.len() >= FEWEST);
        let times = usual_ns.map_or(1.0, |usual_ns| interval_ns as f64 / usual_ns);
        if times > SILENCE && interval_ns > LEAST_SILENCE_NS {
            if self.silence_ns > 0 && self.burst == 0 {
                self.note(interval_ns);
            }
            (self.silence_ns, self.burst) = (interval_ns, 0);
        } else if self.silence_ns > 0 && times < TOGETHER {
            let should_have_come = usual_ns.map_or(0.0, |usual_ns| self.silence_ns as f64 / usual_ns) - 1.0;
            // All of a burst are late once they are enough.
            let late = |burst: u64| if burst as f64 >= MADE_UP * should_have_come { burst } else { 0 };
            let before = late(self.burst);
            self.burst += 1;
            self.late += late(self.burst) - before;
            if late(self.burst) > 0 {
                self.longest_ns = self.longest_ns.max(self.silence_ns);
            }
        } else {
            (self.silence_ns, self.burst) = (0, 0);
            self.note(interval_ns);
        }
    }

    fn note(&mut self, interval_ns: i64) {
        if self.intervals_ns.len() == INTERVALS {
            self.intervals_ns.pop_front();
        }
        self.intervals_ns.push_back(interval_ns as f64);
    }

    /// What the times of samples suffer from, at the end of the run.
    pub(super) fn doubt(&self) -> Option<String> {
        (self.late >= MIN_LATE).then(|| {
            format!(
                "{} samples came in bursts after silences of up to {:.2} s, and have the times of their arrival: they \
                 are late by up to as much; let the sender give host_ns",
                self.late,
                seconds(self.longest_ns)
            )
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: i64 = 1_000_000;

    fn doubt(arrivals_ms: impl Iterator<Item = i64>) -> Option<String> {
        let mut bursts = Bursts::default();
        arrivals_ms.for_each(|ms| bursts.take(ms * MS));
        bursts.doubt()
    }

    #[test]
    fn samples_that_waited_are_told_from_a_sender_that_paused() {
        let every_30 = |from: i64, count: i64| (0..count).map(move |k| from + 30 * k);
        assert_eq!(doubt(every_30(0, 100)), None);
        // The sender pauses for 1.2 s.
        assert_eq!(doubt(every_30(0, 30).chain(every_30(2070, 30))), None);
        // The receiver does: 40 samples wait for it.
        let waited = (0..40).map(|k| 2070 + k / 10);
        let told = doubt(every_30(0, 30).chain(waited).chain(every_30(2100, 30))).unwrap();
        assert!(told.starts_with("39 samples came in bursts after silences of up to 1.20 s"), "{told}");
        assert_eq!(doubt([5, 5, 5, 5].into_iter()), None);
        // It sends what changes: rests for a second, and has a few values at once.
        let changes = (0..10).flat_map(|k| [0, 100, 200, 300, 320, 340].map(|ms| 1500 * k + ms));
        assert_eq!(doubt(changes), None);
        // At first all that waited before the run came at once.
        let backlog = (0..20).chain(every_30(100, 60)).chain((0..40).map(|k| 3100 + k / 10));
        assert!(doubt(backlog).is_some());
    }
}
