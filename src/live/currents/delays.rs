//! The clock of who sends currents against this computer's.
//!
//! In: each sample's own time and its arrival. Out: what to say of them. A sample cannot arrive before its time, and
//! one that is late may have been held up on its way; but if all of some seconds are late, or later than at first, the
//! sender's clock is behind, was set back, or runs slow.

use crate::sink::CurrentSample;
use crate::source::times::seconds;

/// A sample whose time is this much after its arrival is by another clock.
const AHEAD_NS: i64 = 5_000_000;
/// If no sample arrives sooner than this after its time, that is not transport: the sender's clock is behind. Likewise
/// if all come this much later than earlier ones.
const BEHIND_NS: i64 = 200_000_000;
/// Length of the windows that are compared, by arrival.
const WINDOW_NS: i64 = 2_000_000_000;

/// Delays from the times of samples to their arrivals.
#[derive(Debug, Default)]
pub(super) struct Delays {
    /// The least of all.
    least_ns: Option<i64>,
    /// When a window began, and the least within it.
    window: Option<(i64, i64)>,
    grown: bool,
}

impl Delays {
    /// Takes a sample; what to say of it, if it is the first of its kind.
    pub(super) fn take(&mut self, sample: &CurrentSample) -> Option<String> {
        if sample.host_ns == sample.arrival_ns {
            return None;
        }
        let delay_ns = sample.arrival_ns.saturating_sub(sample.host_ns);
        let was_ahead = self.is_ahead();
        let least_ns = self.least_ns.map_or(delay_ns, |least_ns| least_ns.min(delay_ns));
        self.least_ns = Some(least_ns);
        if self.is_ahead() && !was_ahead {
            return Some(format!(
                "a sample has a time {:.3} s after its arrival: the sender's clock is ahead of this computer's, and \
                 currents are logged so much too late; set both by NTP or PTP, or leave host_ns out",
                -seconds(delay_ns)
            ));
        }
        let (since_ns, within_ns) = self.window.unwrap_or((sample.arrival_ns, delay_ns));
        let within_ns = within_ns.min(delay_ns);
        self.window = Some((since_ns, within_ns));
        if sample.arrival_ns.saturating_sub(since_ns) < WINDOW_NS {
            return None;
        }
        self.window = None;
        let later_ns = within_ns.saturating_sub(least_ns);
        if later_ns < BEHIND_NS || std::mem::replace(&mut self.grown, true) {
            return None;
        }
        Some(format!(
            "samples arrive {:.3} s later after their times than before: the sender's clock was set back or runs slow, \
             and currents are logged so much too early, or they are held up on their way; set both clocks by NTP or \
             PTP, or leave host_ns out",
            seconds(later_ns)
        ))
    }

    /// Whether a sample had a time after its arrival.
    pub(super) fn is_ahead(&self) -> bool {
        self.least_ns.is_some_and(|least_ns| least_ns < -AHEAD_NS)
    }

    /// What is odd in all samples together.
    pub(super) fn doubt(&self) -> Option<String> {
        let least_ns = self.least_ns.filter(|least_ns| *least_ns > BEHIND_NS)?;
        Some(format!(
            "every sample arrived {:.3} s or more after its time: the sender's clock is behind this computer's, and \
             currents are logged so much too early; set both by NTP or PTP, or leave host_ns out",
            seconds(least_ns)
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What is said of samples with these delays, 100 per second.
    fn said(delays_ms: impl Iterator<Item = i64>) -> (Vec<String>, Option<String>) {
        let mut delays = Delays::default();
        let sample = |(k, delay_ms): (i64, i64)| {
            let arrival_ns = 1_700_000_000_000_000_000 + k * 10_000_000;
            CurrentSample { host_ns: arrival_ns - delay_ms * 1_000_000, arrival_ns, seq: None, current_a: vec![0.1] }
        };
        let all = (0..).zip(delays_ms).filter_map(|at| delays.take(&sample(at))).collect();
        (all, delays.doubt())
    }

    #[test]
    fn a_clock_that_is_ahead_or_behind_is_told_once() {
        let (all, doubt) = said((0..1000).map(|_| -300));
        assert!(all.len() == 1 && all[0].contains("0.300 s after its arrival") && doubt.is_none(), "{all:?} {doubt:?}");
        let (all, doubt) = said((0..1000).map(|_| 400));
        assert!(all.is_empty() && doubt.unwrap().contains("0.400 s or more"), "{all:?}");
    }

    #[test]
    fn a_clock_that_is_set_back_or_runs_slow_is_told_once_and_jitter_is_not() {
        let (all, _) = said((0..1000).map(|k| if k < 500 { 3 } else { 1503 }));
        assert!(all.len() == 1 && all[0].contains("1.500 s later"), "{all:?}");
        let (all, _) = said((0..3000).map(|k| 3 + k / 5));
        assert!(all.len() == 1 && all[0].contains("later after their times"), "{all:?}");
        let (all, doubt) = said((0..3000).map(|k| if k % 150 < 140 { 900 } else { 2 + k % 7 }));
        assert!(all.is_empty() && doubt.is_none(), "{all:?} {doubt:?}");
    }
}
