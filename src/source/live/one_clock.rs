//! One clock for all stamps of a run, also when that of the camera or the sender began anew.
//!
//! In: the stamps as they come, the host's times of each, and when the source was interrupted. Out: stamps that rise
//! from one part of a run to the next. Otherwise moments would occur twice in a run, and what is known by its time, a
//! veto or a place in a plot, would be of two frames.
//!
//! Method. Of the first frame after an interruption, the time since the last frame by the camera's clock is compared
//! with that by the host's, up to its arrival. Where they differ by more than arrivals vary, or the camera's went back,
//! its clock began anew: all stamps from there on are shifted by what makes them agree with the host's. A clock that
//! goes back by more than that without an interruption began anew as well: the sender was restarted faster than its
//! absence was noticed.
//!
//! Cannot tell: how long such an interruption was, better than arrivals vary (some hundredths of a second, with
//! network streams some tenths); a clock that was set by less than [`ANEW_NS`].

use super::super::HostTime;
use super::super::times::seconds;

/// More than arrivals of the first frame after an interruption vary, nanoseconds.
const ANEW_NS: i64 = 2_000_000_000;

/// The clock of a run.
#[derive(Debug, Default)]
pub(super) struct OneClock {
    /// Added to the stamps since the clock last began anew.
    shift_ns: i64,
    last: Option<Last>,
    interrupted: bool,
}

/// The frame before.
#[derive(Debug, Clone, Copy)]
struct Last {
    stamp_ns: i64,
    /// As given out.
    shifted_ns: i64,
    /// When, by the host's clock: its arrival may be late, as that of the last before a silence.
    host_ns: i64,
}

impl OneClock {
    /// The source was lost; its next frame is of another connection.
    pub(super) fn interrupt(&mut self) {
        self.interrupted = true;
    }

    /// The stamp on the clock of the run of a frame that is stamped `stamp_ns`; `name` of the source, for messages.
    pub(super) fn stamp_ns(&mut self, stamp_ns: i64, host: HostTime, name: &str) -> i64 {
        if let Some(last) = self.last {
            let by_camera = stamp_ns.saturating_sub(last.stamp_ns);
            let by_host = host.arrival_ns.saturating_sub(last.host_ns).max(1);
            let differ = by_camera.saturating_sub(by_host).saturating_abs() > ANEW_NS;
            let anew = if self.interrupted { by_camera <= 0 || differ } else { by_camera < -ANEW_NS };
            if anew {
                self.shift_ns = last.shifted_ns.saturating_add(by_host).saturating_sub(stamp_ns);
                tracing::warn!(
                    "{name}: its clock began anew: from here on {:.3} s are added to its stamps, so that they continue \
                     by the host's clock",
                    seconds(self.shift_ns)
                );
            }
        }
        self.interrupted = false;
        let shifted_ns = stamp_ns.saturating_add(self.shift_ns);
        self.last = Some(Last { stamp_ns, shifted_ns, host_ns: host.stamp_ns });
        shifted_ns
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const S: i64 = 1_000_000_000;

    #[test]
    fn a_clock_that_began_anew_is_continued_by_the_hosts() {
        let mut clock = OneClock::default();
        let at = |clock: &mut OneClock, stamp: i64, host: i64| {
            clock.stamp_ns(stamp, HostTime { arrival_ns: host, stamp_ns: host }, "camera")
        };
        assert_eq!((at(&mut clock, 5 * S, 100 * S), at(&mut clock, 6 * S, 101 * S)), (5 * S, 6 * S));
        // Reordered frames are no new clock.
        assert_eq!((at(&mut clock, 6 * S - 9, 101 * S), at(&mut clock, 6 * S + 9, 101 * S)), (6 * S - 9, 6 * S + 9));
        clock.interrupt();
        // Ten seconds later, from 1.4 s on.
        assert_eq!(at(&mut clock, S * 14 / 10, 111 * S), 16 * S + 9);
        assert_eq!(at(&mut clock, S * 24 / 10, 112 * S), 17 * S + 9);
        // A clock that goes on through an interruption is believed, also where the first frame comes late.
        clock.interrupt();
        assert_eq!(at(&mut clock, S * 54 / 10, 116 * S), 20 * S + 9);
        // A start that is later than the end before, by less than the interruption lasted.
        clock.interrupt();
        assert_eq!(at(&mut clock, S * 60 / 10, 126 * S), 30 * S + 9);
        // The last before a silence is read late: its time is by the line of those before.
        let late = HostTime { arrival_ns: 130 * S, stamp_ns: 127 * S };
        assert_eq!(clock.stamp_ns(7 * S, late, "camera"), 31 * S + 9);
        clock.interrupt();
        assert_eq!(at(&mut clock, S * 14 / 10, 137 * S), 41 * S + 9);
        // Begun anew at once, without an interruption that was noticed.
        let _ = at(&mut clock, 9 * S, 144 * S + S * 6 / 10);
        assert_eq!(at(&mut clock, 0, 145 * S + S * 6 / 10), 49 * S + S * 6 / 10 + 9);
    }
}
