//! Camera frames lost between two frames, from time stamps alone.
//!
//! In: the stamps in the order of arrival, the resolution of the clock (tick) and the period the recording declares, if
//! it does. Out: how many camera frames are missing before each one.
//!
//! Method. The camera's period is the declared one as long as the steps confirm it (most are whole multiples of it and
//! some are the period itself), else the median of the last [`WINDOW`] steps, refined to their mean. A step of k
//! periods lost k − 1 frames. Only earlier steps are used, so a live run and its recording give the same numbers.
//!
//! Assumptions: less than half of the frames are lost where no rate is declared; the rate holds for half a window
//! (after a change to a slower rate the steps count as losses until the median has adapted). Where no rate is declared,
//! the first eight steps cannot be judged and count as without loss, and where one is declared those before the first
//! step of that length: a header may state 60 frames per second and the recording have every eighth. A declared period
//! of one tick of the clock counts as none where more than 5 % of the frames are missing: it may be the tick alone.
//!
//! A recording of truly variable rate has no period: where more than a quarter of the steps are not whole multiples of
//! the median, or short and long steps take turns (stamps that alternate, or a camera without a declared rate that
//! loses every third frame), only steps over [`GAP_MEDIANS`] medians are counted, in medians. What this cannot detect:
//! frames lost when a clock stamps them at a constant rate as they arrive.

use std::collections::VecDeque;

/// Steps that are remembered.
pub(crate) const WINDOW: usize = 61;
/// A step of this many medians is a gap even where the rate varies.
const GAP_MEDIANS: f64 = 4.0;
/// Steps needed before the period is estimated.
const MIN_STEPS: usize = 8;
/// Steps during which a declared period is trusted.
const DECLARED_STEPS: usize = 8;
/// Fraction of a period by which a step may differ from a whole multiple.
const JITTER_TOLERANCE: f64 = 0.2;
/// Frames at most this many periods late are out of order; further back, the clock was reset.
const MAX_REORDER_PERIODS: f64 = 8.0;

/// How regular the steps have been.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Rhythm {
    /// Too few steps to tell.
    Unknown,
    /// A camera of this period.
    Steady {
        /// Nanoseconds from frame to frame.
        period_ns: f64,
    },
    /// No common period.
    Varying {
        /// Median step.
        median_ns: f64,
    },
}

/// How a stamp follows the one before.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Order {
    /// The first stamp.
    First,
    /// Later than all before.
    Later,
    /// The same time again.
    Same,
    /// Earlier than the latest: out of order, or the clock was set back.
    Earlier {
        /// How much earlier than the latest stamp.
        by_ns: i64,
    },
}

/// What one stamp tells.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Step {
    /// Camera frames lost before this one; 0 where the stamp is not later than those before.
    pub gap: u32,
    /// How it follows.
    pub order: Order,
}

/// Counts lost frames, see the module's documentation.
#[derive(Debug, Clone)]
pub(crate) struct GapCounter {
    declared_ns: Option<f64>,
    tick_ns: f64,
    latest_ns: Option<i64>,
    steps_ns: VecDeque<i64>,
}

impl GapCounter {
    /// `declared_ns`: period the recording declares, if plausible ([`plausible_period_ns`]); `tick_ns`: resolution of
    /// the clock.
    pub(crate) fn new(declared_ns: Option<f64>, tick_ns: f64) -> Self {
        let declared_ns = declared_ns.filter(|p| p.is_finite() && *p > 0.0);
        Self { declared_ns, tick_ns: tick_ns.max(0.0), latest_ns: None, steps_ns: VecDeque::with_capacity(WINDOW) }
    }

    /// Takes the next stamp.
    pub(crate) fn step(&mut self, stamp_ns: i64) -> Step {
        let Some(latest_ns) = self.latest_ns else {
            self.latest_ns = Some(stamp_ns);
            return Step { gap: 0, order: Order::First };
        };
        let step_ns = stamp_ns.saturating_sub(latest_ns);
        let rhythm = self.rhythm();
        if step_ns == 0 {
            return Step { gap: 0, order: Order::Same };
        }
        if step_ns < 0 {
            let late_frame = match rhythm {
                Rhythm::Steady { period_ns: p } | Rhythm::Varying { median_ns: p } => {
                    -(step_ns as f64) <= MAX_REORDER_PERIODS * p
                }
                Rhythm::Unknown => false,
            };
            if !late_frame {
                self.latest_ns = Some(stamp_ns);
            }
            return Step { gap: 0, order: Order::Earlier { by_ns: step_ns.saturating_neg() } };
        }
        let lost = |period_ns: f64| (step_ns as f64 / period_ns).round() - 1.0;
        let gap = match rhythm {
            Rhythm::Unknown => 0.0,
            Rhythm::Steady { .. } if !self.is_confirmed() => 0.0,
            Rhythm::Steady { period_ns } => lost(period_ns),
            Rhythm::Varying { median_ns } if step_ns as f64 > GAP_MEDIANS * median_ns => lost(median_ns),
            Rhythm::Varying { .. } => 0.0,
        };
        if self.steps_ns.len() == WINDOW {
            self.steps_ns.pop_front();
        }
        self.steps_ns.push_back(step_ns);
        self.latest_ns = Some(stamp_ns);
        // A float cast saturates: a negative gap (a short step) becomes 0.
        Step { gap: gap as u32, order: Order::Later }
    }

    /// How regular the steps so far have been.
    pub(crate) fn rhythm(&self) -> Rhythm {
        let count = self.steps_ns.len();
        if let Some(period_ns) = self.declared_ns {
            let single = self.steps_ns.iter().filter(|&&s| self.periods(s, period_ns) == Some(1.0)).count();
            if count < DECLARED_STEPS || (single * 8 >= count && self.is_regular(period_ns)) {
                return Rhythm::Steady { period_ns };
            }
        }
        let Some(median_ns) = self.lower_median_ns().filter(|_| count >= MIN_STEPS) else {
            return Rhythm::Unknown;
        };
        if !self.is_regular(median_ns) || self.alternates(median_ns) {
            return Rhythm::Varying { median_ns };
        }
        let (mut time_ns, mut periods) = (0.0, 0.0);
        for &step_ns in &self.steps_ns {
            if let Some(k) = self.periods(step_ns, median_ns) {
                time_ns += step_ns as f64;
                periods += k;
            }
        }
        Rhythm::Steady { period_ns: time_ns / periods }
    }

    /// Whether a step of the declared length was seen, or the declared period is not relied on any more.
    fn is_confirmed(&self) -> bool {
        let single = |period_ns| self.steps_ns.iter().any(|&step_ns| self.periods(step_ns, period_ns) == Some(1.0));
        self.steps_ns.len() >= DECLARED_STEPS || self.declared_ns.is_none_or(single)
    }

    /// Steps judged so far, at most [`WINDOW`].
    pub(crate) fn steps_seen(&self) -> usize {
        self.steps_ns.len()
    }

    /// Of an even count, the lower of the two in the middle: among few steps, a gap is less likely than a regular step.
    fn lower_median_ns(&self) -> Option<f64> {
        let mut sorted: Vec<i64> = self.steps_ns.iter().copied().collect();
        sorted.sort_unstable();
        sorted.get(sorted.len().saturating_sub(1) / 2).map(|&m| m as f64)
    }

    /// How many periods the step has, if a whole number.
    fn periods(&self, step_ns: i64, period_ns: f64) -> Option<f64> {
        let k = (step_ns as f64 / period_ns).round().max(1.0);
        let off_ns = (step_ns as f64 - k * period_ns).abs();
        // Either stamp is up to half a tick off.
        (off_ns <= JITTER_TOLERANCE * period_ns + self.tick_ns).then_some(k)
    }

    /// Whether steps of one and of more periods take turns: stamps that alternate, or every third frame lost.
    fn alternates(&self, period_ns: f64) -> bool {
        let periods: Vec<_> = self.steps_ns.iter().map(|&step_ns| self.periods(step_ns, period_ns)).collect();
        let turns = periods.windows(2).filter(|pair| pair[0] != pair[1]).count();
        turns * 10 >= 9 * periods.len().saturating_sub(1)
    }

    /// Whether all of few steps, or three quarters of many, are whole multiples.
    fn is_regular(&self, period_ns: f64) -> bool {
        let odd = self.steps_ns.iter().filter(|&&s| self.periods(s, period_ns).is_none()).count();
        odd * 4 <= self.steps_ns.len().saturating_sub(MIN_STEPS)
    }
}

/// The period of a declared rate, if it can be a camera's: between 0.1 and 10000 frames per second, and the average
/// rate the container gives neither above it nor below 60 % of it. Rates as (numerator, denominator). For recordings of
/// variable rate, and of one that is no whole number of the clock's ticks, libav often gives the rate of the ticks, and
/// no average or a lower one.
pub(crate) fn plausible_period_ns(rate: (i32, i32), average: (i32, i32), tick_ns: f64) -> Option<f64> {
    let hertz = |(n, d): (i32, i32)| (n > 0 && d > 0).then(|| f64::from(n) / f64::from(d));
    let rate = hertz(rate).filter(|r| (0.1..=1e4).contains(r))?;
    let is_a_tick = 1e9 / rate < 1.5 * tick_ns;
    let least = if is_a_tick { 0.95 } else { 0.6 };
    (least..=1.05).contains(&(hertz(average)? / rate)).then_some(1e9 / rate)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::random::Random;

    const MS: i64 = 1_000_000;

    fn gaps(counter: &mut GapCounter, stamps: impl IntoIterator<Item = i64>) -> Vec<u32> {
        stamps.into_iter().map(|s| counter.step(s).gap).collect()
    }

    /// Whole milliseconds of a 60 Hz camera.
    fn sixty(frame: i64) -> i64 {
        (frame * 1000 + 30) / 60 * MS
    }

    /// Uniform in 0..1.
    fn noise(i: i64) -> f64 {
        Random::new(i as u64).uniform()
    }

    #[test]
    fn steps_of_16_and_17_ms_are_no_gaps_with_and_without_a_declared_rate() {
        for declared in [None, Some(1e9 / 60.0)] {
            let mut counter = GapCounter::new(declared, 1e6);
            assert!(gaps(&mut counter, (0..1000).map(sixty)).iter().all(|&g| g == 0), "{declared:?}");
            let Rhythm::Steady { period_ns } = counter.rhythm() else { panic!("{:?}", counter.rhythm()) };
            assert!((period_ns - 1e9 / 60.0).abs() < 2e4, "{period_ns}");
        }
    }

    #[test]
    fn lost_frames_are_counted_singly_and_by_the_hundred() {
        for declared in [None, Some(1e9 / 60.0)] {
            let lost = |f: i64| f == 20 || (40..43).contains(&f) || (100..400).contains(&f);
            let kept: Vec<i64> = (0..500).filter(|&f| !lost(f)).collect();
            let counted = gaps(&mut GapCounter::new(declared, 1e6), kept.iter().map(|&f| sixty(f)));
            let mut expected = vec![0; kept.len()];
            for (i, pair) in kept.windows(2).enumerate() {
                expected[i + 1] = (pair[1] - pair[0] - 1) as u32;
            }
            assert_eq!(counted, expected, "{declared:?}");
        }
    }

    #[test]
    fn a_quarter_of_all_frames_lost_at_random_is_counted_in_full() {
        let kept: Vec<i64> = (0..3000).filter(|&f| f < 10 || noise(f) > 0.227).collect();
        let counted: u32 = gaps(&mut GapCounter::new(None, 1e6), kept.iter().map(|&f| sixty(f))).iter().sum();
        let lost = (kept.last().unwrap() + 1) as u32 - kept.len() as u32;
        assert_eq!(counted, lost);
        assert!(lost > 600);
    }

    /// A camera of 60 Hz whose every second stamp is 5.5 ms late, and one of 90 Hz that loses every third frame.
    #[test]
    fn stamps_that_alternate_are_no_gaps() {
        let late = |f: i64| sixty(f) + f % 2 * 11 * MS / 2;
        let third = (0..500).filter(|f| f % 3 != 2).map(|f| f * 1_000_000_000 / 90);
        for stamps in [(0..500).map(late).collect::<Vec<_>>(), third.collect()] {
            let mut counter = GapCounter::new(None, 1e3);
            assert!(gaps(&mut counter, stamps).iter().all(|&gap| gap == 0));
            assert!(matches!(counter.rhythm(), Rhythm::Varying { .. }), "{:?}", counter.rhythm());
        }
    }

    #[test]
    fn a_declared_rate_is_believed_with_more_than_half_the_frames_lost_but_not_without_any_support() {
        let third: Vec<i64> = (0..600).filter(|&f| f < 10 || noise(f) > 0.6).collect();
        let counted: u32 =
            gaps(&mut GapCounter::new(Some(1e9 / 60.0), 1e6), third.iter().map(|&f| sixty(f))).iter().sum();
        assert_eq!(counted, (third.last().unwrap() + 1) as u32 - third.len() as u32);
        // Declared 60, delivered 30: the camera's period is 33 ms once that is clear.
        let mut counter = GapCounter::new(Some(1e9 / 60.0), 1e6);
        let thirty = gaps(&mut counter, (0..100).map(|f| sixty(2 * f)));
        assert!(thirty.iter().all(|&g| g == 0), "{thirty:?}");
    }

    #[test]
    fn a_truly_variable_rate_reports_no_gaps_except_a_real_hole() {
        let mut counter = GapCounter::new(None, 1e6);
        let mut now = 0;
        let mut counted = Vec::new();
        for i in 0..2000 {
            let hole = if i == 1000 { 2000.0 } else { 0.0 };
            now += (10.0 + 30.0 * noise(i) + hole).round() as i64 * MS;
            counted.push(counter.step(now).gap);
        }
        assert!((60..110).contains(&counted[1000]), "{}", counted[1000]);
        counted.remove(1000);
        assert_eq!(counted.iter().filter(|&&g| g > 0).count(), 0);
        assert!(matches!(counter.rhythm(), Rhythm::Varying { median_ns } if (20e6..30e6).contains(&median_ns)));
    }

    #[test]
    fn arrival_jitter_of_a_sixth_of_the_period_is_no_gap() {
        let stamps = (0..1000).map(|f| f * 16_666_667 + (2.8e6 * noise(f)) as i64);
        assert!(gaps(&mut GapCounter::new(None, 1.0), stamps).iter().all(|&g| g == 0));
    }

    #[test]
    fn repeated_and_late_stamps_count_no_gap_and_a_clock_set_back_starts_anew() {
        let mut counter = GapCounter::new(Some(10e6), 1e6);
        let steps: Vec<Step> =
            [0, 10, 20, 20, 40, 30, 50, 60, 5, 15, 35].iter().map(|t| counter.step(t * MS)).collect();
        assert_eq!(steps.iter().map(|s| s.gap).collect::<Vec<_>>(), [0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0]);
        assert_eq!(steps[3].order, Order::Same);
        assert_eq!(steps[5].order, Order::Earlier { by_ns: 10 * MS });
        assert_eq!(counter.step(-10_000 * MS).order, Order::Earlier { by_ns: 10_060 * MS });
        assert_eq!(counter.step(-9_980 * MS), Step { gap: 1, order: Order::Later });
    }

    #[test]
    fn a_change_to_a_slower_rate_counts_until_the_median_has_followed() {
        let stamps = (0..200).map(|f: i64| if f < 100 { f * 33 * MS } else { (100 * 33 + (f - 100) * 66) * MS });
        let counted = gaps(&mut GapCounter::new(None, 1e6), stamps);
        assert!(counted[..=100].iter().all(|&g| g == 0));
        assert!(counted[101..=130].iter().all(|&g| g == 1));
        assert!(counted[135..].iter().all(|&g| g == 0), "{counted:?}");
    }

    #[test]
    fn only_a_rate_that_can_be_a_cameras_is_taken() {
        assert_eq!(plausible_period_ns((50, 1), (50, 1), 1e6), Some(20e6));
        assert_eq!(plausible_period_ns((50, 1), (0, 0), 1e6), None);
        assert_eq!(plausible_period_ns((50, 1), (40, 1), 1e6), Some(20e6));
        assert_eq!(plausible_period_ns((1000, 1), (45, 1), 1e6), None);
        assert_eq!(plausible_period_ns((90_000, 1), (0, 1), 1e6), None);
        assert_eq!(plausible_period_ns((0, 0), (30, 1), 1e6), None);
        // 60 frames per second on a clock of 10 ms, and 100.
        assert_eq!(plausible_period_ns((100, 1), (60, 1), 1e7), None);
        assert_eq!(plausible_period_ns((100, 1), (100, 1), 1e7), Some(1e7));
    }
}
