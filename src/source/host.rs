//! The host's clock, and the camera's time on it.
//!
//! [`HostClock`] counts nanoseconds since 1970 and cannot be set back: it starts at the computer's time of day and
//! follows its monotonic clock from there. A step of the time of day (NTP, a user) does not affect it.
//!
//! [`ClockFit`] maps the stamps of another clock to it. In: (stamp, arrival) of every frame, as they arrive. Out: the
//! host's time at which that frame was stamped, up to the minimum delay between stamp and arrival, which only a clock
//! wired to the camera could know.
//!
//! Method. Offset = arrival − stamp = constant + drift + delay, and the delay never falls below its minimum: the truth
//! lies on the lower envelope. The least offset of each second is kept for two minutes; the line is the edge of their
//! lower convex hull that spans the middle of them (it lies below all points at the least sum of distances: Moon,
//! Skelly and Towsley, IEEE INFOCOM 1999, doi:10.1109/INFCOM.1999.749287). In the first seconds the drift is taken as
//! zero. An offset more than two seconds below the line (a clock that was set) begins a new fit, and so does a stamp
//! earlier than the one before: the clock was set back, or that one was ahead and would hold the line down for minutes.
//! One more than two seconds above it begins a new fit only if it lasts for a second and does not shrink: the last
//! frames before a pause wait for what comes after it, and after an interruption those that have waited come faster
//! than they were taken. Frames whose arrival is not their own, as of damaged packets, are mapped and teach nothing:
//! paired with the arrival of an earlier one, they would hold the line down for minutes too.
//!
//! A camera that loses frames and counts only the others, in its stamps, cannot be told from a path that became slower:
//! both are late from then on, and the line stays. That is told ([`ClockFit::is_late`]).
//!
//! The first frames may have waited: a server sends what it kept since its last key frame at once. Nothing is known yet
//! that tells how long; the frames after them do ([`ClockFit::began_late`]).

use std::collections::VecDeque;
use std::time::{Instant, SystemTime, UNIX_EPOCH};

/// A frame's times on the host's clock, nanoseconds since 1970.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct HostTime {
    /// When the frame had arrived completely, before decoding.
    pub arrival_ns: i64,
    /// The frame's own stamp, mapped to this clock; increases from frame to frame.
    pub stamp_ns: i64,
}

/// The host's clock.
#[derive(Debug, Clone, Copy)]
pub struct HostClock {
    started: Instant,
    started_ns: i64,
}

impl HostClock {
    /// Starts at the computer's time of day, which is read only once.
    pub fn start() -> Self {
        Self::set_by(SystemTime::now)
    }

    fn set_by(time_of_day: impl FnOnce() -> SystemTime) -> Self {
        let since_1970 = time_of_day().duration_since(UNIX_EPOCH).unwrap_or_default();
        Self { started: Instant::now(), started_ns: i64::try_from(since_1970.as_nanos()).unwrap_or(i64::MAX) }
    }

    /// When it was set, nanoseconds since 1970.
    pub fn started_ns(&self) -> i64 {
        self.started_ns
    }

    /// Nanoseconds since 1970.
    pub fn now_ns(&self) -> i64 {
        self.at_ns(Instant::now())
    }

    /// The same for an earlier instant.
    pub fn at_ns(&self, moment: Instant) -> i64 {
        let elapsed = moment.saturating_duration_since(self.started);
        self.started_ns.saturating_add(i64::try_from(elapsed.as_nanos()).unwrap_or(i64::MAX))
    }
}

/// Length of the bins of stamps.
const BIN_NS: i64 = 1_000_000_000;
/// Bins remembered.
const BINS: usize = 120;
/// Time of the stamps before which drift cannot be told from delay.
const MIN_DRIFT_SPAN_NS: i64 = 10 * BIN_NS;
/// No crystal drifts more.
const MAX_DRIFT: f64 = 500e-6;
/// A stamp this far from the fit comes from another clock, or the clock was set.
const STEP_NS: i64 = 2_000_000_000;
/// Offsets that fall by more than this within a second are those of frames that have waited. (What is sent at less than
/// 1.05 times its rate falls more slowly, and begins a new fit.)
const FALLING_NS: i64 = 50_000_000;
/// A frame that is no later than this after others that have waited did not wait itself.
const CAUGHT_UP_NS: i64 = 10_000_000;
/// Frames are late if the earliest of every bin, for so many bins, is later than the line by this.
const LATE_NS: i64 = 100_000_000;
const LATE_BINS: usize = 5;
/// First frames have waited if they are later than those after them by this: less is the start of a sender.
const WAITED_NS: i64 = 500_000_000;
/// Longer than what a server keeps for those who join, in bins.
const JOINING_BINS: usize = 15;

/// The mapping of another clock to the host's.
#[derive(Debug, Clone, Default)]
pub struct ClockFit {
    /// (stamp, least offset at it) of each bin, oldest first.
    least: VecDeque<(i64, i64)>,
    /// Offset of the first frame of this line.
    first: Option<i64>,
    last: Option<HostTime>,
    /// The stamp of the frame before, by its own clock.
    last_stamp_ns: Option<i64>,
    /// Stamp and offset of the first of those that are about equally late, since one was later than the line by
    /// [`STEP_NS`].
    far_since: Option<(i64, i64)>,
    restarts: u64,
}

impl ClockFit {
    /// Takes the next frame: its stamp by its own clock and its arrival by the host's.
    pub fn map(&mut self, stamp_ns: i64, arrival_ns: i64) -> HostTime {
        let offset = arrival_ns.saturating_sub(stamp_ns);
        let beyond = self.offset_at(stamp_ns).map_or(0, |expected| offset.saturating_sub(expected));
        let is_far = beyond > STEP_NS;
        // Until those that have waited come as the others do.
        let is_behind = is_far || self.far_since.is_some() && beyond > CAUGHT_UP_NS;
        let since = self.far_since.filter(|(_, first)| first.saturating_sub(offset) < FALLING_NS);
        let (since_ns, _) = since.unwrap_or((stamp_ns, offset));
        let is_steady = stamp_ns.saturating_sub(since_ns) >= BIN_NS;
        let goes_back = self.last_stamp_ns.is_some_and(|last_ns| stamp_ns < last_ns);
        let restart = goes_back || beyond < -STEP_NS || is_far && is_steady;
        if restart {
            self.least.clear();
            self.first = None;
            self.restarts += 1;
        }
        if restart || !is_behind || is_steady {
            self.far_since = None;
            self.add(stamp_ns, offset);
        } else {
            self.far_since = Some(since.unwrap_or((stamp_ns, offset)));
        }
        self.last_stamp_ns = Some(stamp_ns);
        self.placed(stamp_ns, arrival_ns)
    }

    /// The same of a frame whose arrival may be that of another: the fit does not learn from it.
    pub fn placed(&mut self, stamp_ns: i64, arrival_ns: i64) -> HostTime {
        let offset = self.offset_at(stamp_ns).unwrap_or(arrival_ns.saturating_sub(stamp_ns));
        let mapped = stamp_ns.saturating_add(offset).min(arrival_ns);
        // An improved fit may give an earlier time than the previous frame got.
        let stamp_ns = self.last.map_or(mapped, |last| mapped.max(last.stamp_ns.saturating_add(1)));
        let time = HostTime { arrival_ns, stamp_ns };
        self.last = Some(time);
        time
    }

    /// The other clock began anew with the next frame.
    pub(crate) fn begin_anew(&mut self) {
        self.least.clear();
        (self.first, self.last_stamp_ns, self.far_since) = (None, None, None);
    }

    /// How much later the first frame of the line arrived than those after it say, nanoseconds, if that is much. Known
    /// a second after the frames that had waited.
    pub fn began_late(&self) -> Option<i64> {
        if self.least.len() > JOINING_BINS {
            return None;
        }
        let least = self.least.iter().map(|(_, offset)| *offset).min()?;
        let has_caught_up = |(_, offset): &(i64, i64)| offset.saturating_sub(least) < CAUGHT_UP_NS;
        let since = self.least.iter().position(has_caught_up)?;
        let late = self.first?.saturating_sub(least);
        (late > WAITED_NS && since + 1 < self.least.len()).then_some(late)
    }

    /// By how much all frames of the last seconds arrived later than the line, nanoseconds, if that is much.
    pub fn is_late(&self) -> Option<i64> {
        // The last bin is not over yet.
        let recent = self.least.iter().rev().skip(1).take(LATE_BINS);
        if recent.len() < LATE_BINS {
            return None;
        }
        let edge = self.edge()?;
        let least = recent.map(|(at, offset)| offset.saturating_sub(on(edge, *at))).min()?;
        (least > LATE_NS).then_some(least)
    }

    /// How often the other clock was found to have been set or restarted.
    pub fn restarts(&self) -> u64 {
        self.restarts
    }

    /// How much faster than the host's clock the other one runs, as a fraction; `None` in the first seconds.
    pub fn drift(&self) -> Option<f64> {
        let (from, to) = self.edge()?;
        (from != to).then(|| -slope(from, to))
    }

    fn add(&mut self, stamp_ns: i64, offset: i64) {
        self.first.get_or_insert(offset);
        match self.least.back_mut() {
            Some((at, least)) if stamp_ns.div_euclid(BIN_NS) == at.div_euclid(BIN_NS) => {
                if offset < *least {
                    (*at, *least) = (stamp_ns, offset);
                }
            }
            _ => {
                if self.least.len() == BINS {
                    self.least.pop_front();
                }
                self.least.push_back((stamp_ns, offset));
            }
        }
    }

    fn offset_at(&self, stamp_ns: i64) -> Option<i64> {
        Some(on(self.edge()?, stamp_ns))
    }

    /// Two points of the line; the same one twice while the drift is unknown.
    fn edge(&self) -> Option<((i64, i64), (i64, i64))> {
        let (first, last) = (*self.least.front()?, *self.least.back()?);
        if last.0.saturating_sub(first.0) < MIN_DRIFT_SPAN_NS {
            let least = *self.least.iter().min_by_key(|(_, offset)| *offset)?;
            return Some((least, least));
        }
        let middle = first.0 + (last.0 - first.0) / 2;
        let mut hull: Vec<(i64, i64)> = Vec::new();
        for &point in &self.least {
            while let [.., a, b] = hull.as_slice() {
                if slope(*a, *b) < slope(*b, point) {
                    break;
                }
                hull.pop();
            }
            hull.push(point);
        }
        let edge = hull.windows(2).find_map(|edge| match edge {
            [from, to] if to.0 >= middle => Some((*from, *to)),
            _ => None,
        })?;
        (slope(edge.0, edge.1).abs() <= MAX_DRIFT).then_some(edge).or(Some((last, last)))
    }
}

/// The offset at a stamp on the line through two points.
fn on((from, to): ((i64, i64), (i64, i64)), stamp_ns: i64) -> i64 {
    let beyond = (slope(from, to) * stamp_ns.saturating_sub(from.0) as f64).round();
    from.1.saturating_add(beyond as i64)
}

fn slope(from: (i64, i64), to: (i64, i64)) -> f64 {
    let length = to.0.saturating_sub(from.0);
    if length == 0 { 0.0 } else { to.1.saturating_sub(from.1) as f64 / length as f64 }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Frames of a camera whose clock is fast by `drift`, arriving at least 5 ms late, mostly more.
    fn frames(drift: f64, seconds: i64) -> impl Iterator<Item = (i64, i64, i64)> {
        (0..60 * seconds).map(move |k| {
            let taken_ns = 1_700_000_000_000_000_000 + k * 16_666_667;
            let stamp_ns = 77_000_000_000 + ((k * 16_666_667) as f64 * (1.0 + drift)) as i64;
            // A delay that is smallest once in 17 frames, with occasional bursts.
            let late_ns = 5_000_000 + (k * 7 % 17) * 400_000 + if k % 211 == 100 { 90_000_000 } else { 0 };
            (stamp_ns, taken_ns + late_ns, taken_ns)
        })
    }

    #[test]
    fn drift_and_least_delay_are_found_under_jitter() {
        for drift in [0.0, 80e-6, -150e-6] {
            let mut fit = ClockFit::default();
            let mut last = i64::MIN;
            for (stamp_ns, arrival_ns, taken_ns) in frames(drift, 300) {
                let time = fit.map(stamp_ns, arrival_ns);
                assert!(time.stamp_ns > last && time.stamp_ns <= arrival_ns.max(last + 1));
                last = time.stamp_ns;
                if stamp_ns > 77_000_000_000 + 30 * BIN_NS {
                    let error_us = (time.stamp_ns - taken_ns - 5_000_000) as f64 * 1e-3;
                    assert!(error_us.abs() < 100.0, "drift {drift}: {error_us} µs");
                }
            }
            let found = fit.drift().unwrap();
            assert!((found - drift).abs() < 2e-6, "{found} instead of {drift}");
            assert_eq!(fit.restarts(), 0);
        }
    }

    #[test]
    fn a_clock_that_is_set_begins_anew_and_the_host_s_time_goes_on() {
        let mut fit = ClockFit::default();
        let mut last = i64::MIN;
        for (k, (stamp_ns, arrival_ns, taken_ns)) in frames(20e-6, 60).enumerate() {
            let set_back = if k >= 1800 { 50_000_000_000 } else { 0 };
            let time = fit.map(stamp_ns - set_back, arrival_ns);
            assert!(time.stamp_ns > last);
            last = time.stamp_ns;
            assert!((time.stamp_ns - taken_ns).abs() < 20_000_000, "frame {k}");
        }
        assert_eq!(fit.restarts(), 1);
    }

    /// Less than the two seconds that tell another clock from a delay.
    #[test]
    fn a_clock_that_is_set_back_a_little_is_followed_at_once() {
        let mut fit = ClockFit::default();
        let mut last = i64::MIN;
        for (k, (stamp_ns, arrival_ns, taken_ns)) in frames(0.0, 60).enumerate() {
            let set_back = if k >= 1800 { 980_000_000 } else { 0 };
            let time = fit.map(stamp_ns - set_back, arrival_ns);
            assert!(time.stamp_ns > last);
            last = time.stamp_ns;
            assert!((time.stamp_ns - taken_ns).abs() < 20_000_000, "frame {k}: {}", time.stamp_ns - taken_ns);
        }
        assert_eq!(fit.restarts(), 1);
    }

    #[test]
    fn one_wrong_stamp_does_not_move_the_times_of_the_frames_after_it() {
        for wrong_ns in [1_500_000_000, 40_000_000, -40_000_000, -1_500_000_000] {
            let mut fit = ClockFit::default();
            for (k, (stamp_ns, arrival_ns, taken_ns)) in frames(0.0, 60).enumerate() {
                let off_ns = if k == 1800 { wrong_ns } else { 0 };
                let time = fit.map(stamp_ns + off_ns, arrival_ns);
                let late_ns = time.stamp_ns - taken_ns;
                assert!(k == 1800 || late_ns.abs() < 20_000_000, "{wrong_ns}, frame {k}: {late_ns}");
            }
        }
    }

    /// Two frames wait for what comes after a pause of four seconds.
    #[test]
    fn frames_that_wait_for_those_after_a_pause_keep_their_times() {
        let mut fit = ClockFit::default();
        for (k, (stamp_ns, arrival_ns, taken_ns)) in frames(0.0, 30).enumerate() {
            let pause_ns = if k >= 600 { 4_000_000_000 } else { 0 };
            let waited_ns = if (598..600).contains(&k) { 4_000_000_000 } else { 0 };
            let time = fit.map(stamp_ns + pause_ns, arrival_ns + pause_ns + waited_ns);
            let late_ns = time.stamp_ns - taken_ns - pause_ns;
            assert!(late_ns.abs() < 20_000_000, "frame {k}: {late_ns}");
        }
        assert_eq!(fit.restarts(), 0);
    }

    /// The stream stops for some seconds; what has waited then comes so many times as fast as it was taken.
    #[test]
    fn frames_that_have_waited_do_not_move_the_line() {
        for (stop_s, fast) in [(3.5, 5.0), (4.0, 20.0), (10.0, 2.0), (3.0, 1.2), (6.0, 1000.0)] {
            let mut fit = ClockFit::default();
            let mut free_ns = 0;
            for (k, (stamp_ns, arrival_ns, taken_ns)) in frames(0.0, 90).enumerate() {
                let resumed_ns = taken_ns + ((1200.0 / 60.0 + stop_s - k as f64 / 60.0) * 1e9) as i64;
                let waited_ns = if k < 1200 { arrival_ns } else { arrival_ns.max(resumed_ns).max(free_ns) };
                free_ns = waited_ns + (16_666_667.0 / fast) as i64;
                let time = fit.map(stamp_ns, waited_ns);
                let late_ns = time.stamp_ns - taken_ns;
                assert!(late_ns.abs() < 20_000_000, "{stop_s} s, {fast} times as fast, frame {k}: {late_ns}");
            }
            assert_eq!(fit.restarts(), 0);
        }
    }

    /// A camera stamps by count and loses three seconds, or one and a half.
    #[test]
    fn frames_that_stay_late_begin_anew_or_are_told() {
        for (lost_ns, restarts) in [(3_000_000_000, 1), (1_500_000_000, 0)] {
            let (mut fit, mut told_ns) = (ClockFit::default(), None);
            for (k, (stamp_ns, arrival_ns, taken_ns)) in frames(0.0, 40).enumerate() {
                let lost_ns = if k >= 1200 { lost_ns } else { 0 };
                let time = fit.map(stamp_ns, arrival_ns + lost_ns);
                told_ns = told_ns.or(fit.is_late());
                let late_ns = time.stamp_ns - taken_ns - lost_ns;
                assert!(late_ns.abs() < 20_000_000 || k >= 1200, "frame {k}: {late_ns}");
                assert!(late_ns.abs() < 20_000_000 || k < 1262 || restarts == 0, "frame {k}: {late_ns}");
                assert!(told_ns.is_none() || k >= 1200 + 5 * 60, "told at frame {k}");
            }
            assert_eq!((fit.restarts(), told_ns.is_some()), (restarts, restarts == 0));
        }
    }

    /// A server sends at once what it kept since its last key frame.
    #[test]
    fn first_frames_that_had_waited_are_told() {
        for kept_ns in [0, 250_000_000, 800_000_000, 3_700_000_000] {
            let (mut fit, mut told) = (ClockFit::default(), None);
            for (k, (stamp_ns, arrival_ns, taken_ns)) in frames(0.0, 30).enumerate() {
                let joined_ns = frames(0.0, 1).next().unwrap().2 + kept_ns + k as i64 * 20_000;
                let time = fit.map(stamp_ns, arrival_ns.max(joined_ns));
                let late_ns = time.stamp_ns - taken_ns;
                assert!(late_ns.abs() < 20_000_000 || taken_ns < joined_ns, "frame {k}: {late_ns}");
                told = told.or(fit.began_late());
                assert!(told.is_none() || taken_ns > joined_ns, "frame {k}");
            }
            assert_eq!(told.is_some(), kept_ns > WAITED_NS);
            assert!(told.is_none_or(|told| (told - kept_ns).abs() < 20_000_000), "{kept_ns}: {told:?}");
        }
    }

    /// Damaged frames come with the arrival of one a third of a second before.
    #[test]
    fn the_arrival_of_another_frame_teaches_nothing() {
        let mut fit = ClockFit::default();
        for (k, (stamp_ns, arrival_ns, taken_ns)) in frames(0.0, 30).enumerate() {
            let time = match k % 100 {
                50 => fit.placed(stamp_ns, arrival_ns - 300_000_000),
                _ => fit.map(stamp_ns, arrival_ns),
            };
            let late_ns = time.stamp_ns - taken_ns;
            assert!(late_ns.abs() < 20_000_000 || k % 100 == 50, "frame {k}: {late_ns}");
        }
    }

    /// The time of day is set by an hour while a camera runs: neither arrivals nor mapped stamps change.
    #[test]
    fn a_step_of_the_time_of_day_does_not_show() {
        let hour = std::time::Duration::from_secs(3600);
        for step in [|t: SystemTime, by| t + by, |t: SystemTime, by| t - by] {
            let mut time_of_day = UNIX_EPOCH + std::time::Duration::from_secs(1_700_000_000);
            let clock = HostClock::set_by(|| time_of_day);
            let (mut fit, mut last) = (ClockFit::default(), None::<HostTime>);
            for k in 0..240 {
                if k == 120 {
                    time_of_day = step(time_of_day, hour);
                }
                let arrival = clock.started + std::time::Duration::from_micros(16_667 * k);
                let time = fit.map(5_000_000_000 + 16_667_000 * k as i64, clock.at_ns(arrival));
                if let Some(last) = last {
                    assert_eq!(time.arrival_ns - last.arrival_ns, 16_667_000, "frame {k}");
                    assert_eq!(time.stamp_ns - last.stamp_ns, 16_667_000, "frame {k}");
                }
                last = Some(time);
            }
            assert_eq!(fit.restarts(), 0);
            // A clock started now has it.
            let later = HostClock::set_by(|| time_of_day);
            assert_eq!((later.started_ns - clock.started_ns).abs(), 3_600_000_000_000);
        }
    }

    #[test]
    fn the_first_frame_is_not_later_than_its_arrival() {
        let mut fit = ClockFit::default();
        let time = fit.map(5, 1_000);
        assert_eq!(time, HostTime { arrival_ns: 1_000, stamp_ns: 1_000 });
        assert_eq!(fit.drift(), None);
    }
}
