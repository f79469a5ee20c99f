//! One clock for all stamps of a run, also when that of the camera or the sender began anew.
//!
//! In: the stamps as they come, the host's times of each, and when the source was interrupted. Out: stamps that rise
//! from one part of a run to the next. Otherwise moments would occur twice in a run, and what is known by its time, a
//! veto or a place in a plot, would be of two frames.
//!
//! Method. Of the first frame after an interruption, the time since the last frame by the camera's clock is compared
//! with that by the host's, up to its arrival. Where they differ by more than arrivals vary, or the camera's went back,
//! its clock began anew: all stamps from there on are shifted by what makes them agree with the host's. A clock that
//! goes back by more than that without an interruption, or ahead of the host's, began anew as well: the sender was
//! restarted faster than its absence was noticed, or its clock was set. (Ahead only where frames came at the pace of
//! their stamps until then: a recording that is sent as fast as it goes has holes.) Where the shift before suits again,
//! a single stamp was wrong.
//!
//! Cannot tell: that a stamp in the first second of a run is too late; how long such an interruption was, better than
//! arrivals vary (some hundredths of a second, with network streams some tenths; seconds with servers that begin with
//! what they kept, which is told: [`ClockFit::began_late`](super::super::host::ClockFit::began_late)); a clock that was
//! set by less than [`ANEW_NS`].

use super::super::times::seconds;

/// More than arrivals of the first frame after an interruption vary, nanoseconds.
const ANEW_NS: i64 = 2_000_000_000;
/// Time of the stamps after which their pace is known, nanoseconds.
const PACE_NS: i64 = 1_000_000_000;

/// The clock of a run.
#[derive(Debug, Default)]
pub(super) struct OneClock {
    /// Since the clock last began anew, and before.
    setting: Setting,
    earlier: Setting,
    last: Option<Last>,
    interrupted: bool,
}

/// How the camera's clock is set.
#[derive(Debug, Clone, Copy, Default)]
struct Setting {
    /// Added to its stamps.
    shift_ns: i64,
    /// Stamp and the host's time of its first frame.
    since: Option<(i64, i64)>,
    /// The least difference of the two.
    least_ns: Option<i64>,
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

    /// Whether the clock began anew with the next frame, which is stamped `stamp_ns` and arrived at `arrival_ns`;
    /// `name` of the source, for messages.
    pub(super) fn begins_anew(&mut self, stamp_ns: i64, arrival_ns: i64, name: &str) -> bool {
        let interrupted = std::mem::take(&mut self.interrupted);
        let Some(last) = self.last else { return false };
        let by_camera = stamp_ns.saturating_sub(last.stamp_ns);
        let by_host = arrival_ns.saturating_sub(last.host_ns).max(1);
        let ahead = by_camera.saturating_sub(by_host);
        let goes_back = if interrupted { by_camera <= 0 || ahead < -ANEW_NS } else { by_camera < -ANEW_NS };
        let next_ns = last.shifted_ns.saturating_add(by_host);
        let by_earlier = stamp_ns.saturating_add(self.earlier.shift_ns);
        let suits = by_earlier > last.shifted_ns && by_earlier.saturating_sub(next_ns).saturating_abs() < ANEW_NS;
        // Not so where frames before it were late, and those that have waited with them are lost.
        let is_early = |least_ns: i64| arrival_ns.saturating_sub(stamp_ns) < least_ns.saturating_sub(ANEW_NS);
        let is_set = self.setting.least_ns.is_some_and(is_early) && (suits || self.is_paced());
        if !goes_back && !(ahead > ANEW_NS && (interrupted || is_set)) {
            return false;
        }
        if suits {
            std::mem::swap(&mut self.setting, &mut self.earlier);
        } else {
            self.earlier = self.setting;
            self.setting = Setting { shift_ns: next_ns.saturating_sub(stamp_ns), ..Setting::default() };
        }
        tracing::warn!(
            "{name}: its clock began anew: from here on {:.3} s are added to its stamps, so that they continue by the \
             host's clock",
            seconds(self.setting.shift_ns)
        );
        true
    }

    /// The stamp on the clock of the run of the next frame, which was taken at `host_ns`.
    pub(super) fn stamp_ns(&mut self, stamp_ns: i64, host_ns: i64) -> i64 {
        let Setting { shift_ns, since, least_ns } = &mut self.setting;
        let shifted_ns = stamp_ns.saturating_add(*shift_ns);
        since.get_or_insert((stamp_ns, host_ns));
        let delay_ns = host_ns.saturating_sub(stamp_ns);
        *least_ns = Some(least_ns.map_or(delay_ns, |least_ns| least_ns.min(delay_ns)));
        self.last = Some(Last { stamp_ns, shifted_ns, host_ns });
        shifted_ns
    }

    /// Whether something is added to its stamps.
    pub(super) fn is_shifted(&self) -> bool {
        self.setting.shift_ns != 0
    }

    /// Whether frames came about as fast as they were taken.
    fn is_paced(&self) -> bool {
        let (Some((stamp_ns, host_ns)), Some(last)) = (self.setting.since, self.last) else { return false };
        let by_camera = last.stamp_ns.saturating_sub(stamp_ns);
        by_camera >= PACE_NS && last.host_ns.saturating_sub(host_ns) >= by_camera / 2
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
            clock.begins_anew(stamp, host, "camera");
            clock.stamp_ns(stamp, host)
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
        assert!(!clock.begins_anew(7 * S, 130 * S, "camera"));
        assert_eq!(clock.stamp_ns(7 * S, 127 * S), 31 * S + 9);
        clock.interrupt();
        assert_eq!(at(&mut clock, S * 14 / 10, 137 * S), 41 * S + 9);
        // Begun anew at once, without an interruption that was noticed.
        let _ = at(&mut clock, 9 * S, 144 * S + S * 6 / 10);
        assert_eq!(at(&mut clock, 0, 145 * S + S * 6 / 10), 49 * S + S * 6 / 10 + 9);
    }

    #[test]
    fn a_clock_that_goes_ahead_of_the_hosts_was_set() {
        let mut clock = OneClock::default();
        let mut at = |stamp: i64, host: i64| (clock.begins_anew(stamp, host, "camera"), clock.stamp_ns(stamp, host));
        assert_eq!([at(5 * S, 100 * S), at(6 * S, 101 * S)], [(false, 5 * S), (false, 6 * S)]);
        // A day ahead in one stamp alone: the next has its own again, to the nanosecond.
        assert_eq!(at(86_407 * S, 102 * S + 7), (true, 7 * S + 7));
        assert_eq!(at(8 * S, 103 * S + 3), (true, 8 * S));
        assert_eq!(at(9 * S, 104 * S), (false, 9 * S));
        // Ahead from here on.
        assert_eq!([at(3610 * S, 105 * S), at(3611 * S, 106 * S)], [(true, 10 * S), (false, 11 * S)]);
        // Frames that are lost are no new clock, nor are those that have waited.
        assert_eq!([at(3651 * S, 146 * S), at(3652 * S, 155 * S)], [(false, 51 * S), (false, 52 * S)]);
        // A stamp that is too early, and two that are too late, half a second apart.
        assert_eq!([at(2 * S, 156 * S), at(3654 * S, 157 * S)], [(true, 53 * S), (true, 54 * S)]);
        assert_eq!(at(3655 * S, 158 * S), (false, 55 * S));
        for k in [1, 2] {
            assert!(at(90_000 * S, 158 * S + k * S / 2 - 1).0);
            assert_eq!(at(3655 * S + k * S / 2, 158 * S + k * S / 2), (true, 55 * S + k * S / 2));
        }
        // Frames that a slow way holds up more and more, until those that wait are thrown away.
        let mut clock = OneClock::default();
        let mut at = |stamp: i64, host: i64| (clock.begins_anew(stamp, host, "camera"), clock.stamp_ns(stamp, host));
        for k in 0..10 {
            assert_eq!(at(k * S, 100 * S + k * S * 17 / 10), (false, k * S));
        }
        assert_eq!(at(16 * S, 117 * S), (false, 16 * S));
        // A recording that is sent faster than it was taken has a hole.
        let mut clock = OneClock::default();
        let mut at = |stamp: i64, host: i64| (clock.begins_anew(stamp, host, "camera"), clock.stamp_ns(stamp, host));
        let fast = [at(5 * S, 100 * S), at(6 * S, 100 * S + 9), at(7 * S, 100 * S + 20), at(20 * S, 100 * S + 30)];
        assert_eq!(fast, [5, 6, 7, 20].map(|s| (false, s * S)));
    }
}
