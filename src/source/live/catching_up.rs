//! Whether a long step between arrivals means lost frames, or frames that were held up on their way.
//!
//! A sender that pauses or writes in bursts catches up: its next frames come early, until they are where they would
//! have been. What is lost stays away: all later frames are late by whole periods. So a step is judged after some more
//! frames, by the one that was least late. Losses that follow one another more closely make the later ones later still:
//! each is known as long after it.

use std::collections::VecDeque;

/// Frames at the camera's own pace after which a step is judged.
const SETTLING: usize = 16;
/// Steps shorter than this, in periods, are those of frames that catch up.
const PACE: f64 = 0.5;

/// Judges steps.
pub(super) struct CatchingUp {
    /// The rate that was stated.
    period_ns: f64,
    last_ns: Option<i64>,
    late: Option<Late>,
}

/// Frames since a long step, which are not all judged yet.
struct Late {
    /// The last arrival before it, and the period.
    from_ns: i64,
    period_ns: f64,
    /// Frames since then, and those known to be lost by now.
    frames: u32,
    /// How late each of the last frames at the camera's pace was, or one that followed it faster if that was less late.
    late_ns: VecDeque<f64>,
    /// Frames that are missing if none is only late.
    most: u32,
}

impl CatchingUp {
    pub(super) fn new(period_ns: f64) -> Self {
        Self { period_ns, last_ns: None, late: None }
    }

    /// Takes a frame's arrival, and how many are missing before it judged by this step alone. Returns how many are
    /// known to be lost by now and were not before.
    pub(super) fn lost(&mut self, arrival_ns: i64, missing: u32) -> u32 {
        let Some(last_ns) = self.last_ns.replace(arrival_ns) else { return 0 };
        let step_ns = arrival_ns.saturating_sub(last_ns) as f64;
        if missing > 0 {
            // In bursts the usual step is too short; a camera may also be slower than stated.
            let period_ns = self.period_ns.max(step_ns / (f64::from(missing) + 1.0));
            let new = || Late { from_ns: last_ns, period_ns, frames: 0, late_ns: VecDeque::new(), most: 0 };
            let late = self.late.get_or_insert_with(new);
            late.most = late.most.saturating_add(missing);
        }
        let Some(late) = &mut self.late else { return 0 };
        late.frames = late.frames.saturating_add(1);
        let now_ns = arrival_ns.saturating_sub(late.from_ns) as f64 - f64::from(late.frames) * late.period_ns;
        match late.late_ns.back_mut().filter(|_| step_ns <= PACE * late.period_ns) {
            Some(least_ns) => *least_ns = least_ns.min(now_ns),
            None => late.late_ns.push_back(now_ns),
        }
        if (now_ns / late.period_ns).round() < 1.0 {
            self.late = None;
            return 0;
        }
        if late.late_ns.len() < SETTLING {
            return 0;
        }
        let least_ns = late.late_ns.iter().copied().fold(f64::INFINITY, f64::min);
        late.late_ns.pop_front();
        // A float cast saturates.
        let lost = ((least_ns / late.period_ns).round() as u32).min(late.most);
        late.most -= lost;
        late.frames = late.frames.saturating_add(lost);
        // Counted from the earliest frame that is left: an error of the period does not add up.
        let first_ns = late.late_ns.front().copied().unwrap_or_default();
        let off_ns = if lost > 0 { first_ns - (first_ns / late.period_ns).round() * late.period_ns } else { 0.0 };
        late.from_ns = late.from_ns.saturating_add(off_ns as i64);
        late.late_ns.iter_mut().for_each(|late_ns| *late_ns -= f64::from(lost) * late.period_ns + off_ns);
        let is_left = late.late_ns.back().is_some_and(|now_ns| (now_ns / late.period_ns).round() >= 1.0);
        if late.most == 0 || !is_left {
            self.late = None;
        }
        lost
    }
}

#[cfg(test)]
mod tests {
    use super::super::super::StreamFaults;
    use super::super::super::stamps::StampWatch;
    use super::*;

    const PERIOD_NS: f64 = 1e9 / 60.0;

    /// Frames found lost at each of some arrivals, in periods.
    fn found(arrivals: impl IntoIterator<Item = f64>) -> Vec<u32> {
        let (mut watch, mut faults) = (StampWatch::new("pipe".into(), Some(PERIOD_NS), 0.0), StreamFaults::default());
        let mut catching_up = CatchingUp::new(PERIOD_NS);
        let judge = |(seq, at): (u64, f64)| {
            let ns = (at * PERIOD_NS) as i64;
            let missing = watch.gap(ns, seq, &mut faults);
            catching_up.lost(ns, missing)
        };
        (0..).zip(arrivals).map(judge).collect()
    }

    #[test]
    fn what_comes_in_bursts_is_not_lost() {
        for burst in [2, 8, 40, 150] {
            let arrivals = (0..600).map(|k| f64::from(k / burst * burst + burst) + f64::from(k % burst) * 0.02);
            assert_eq!(found(arrivals).iter().sum::<u32>(), 0, "bursts of {burst}");
        }
        // A pause of half a second, then what was held up, quickly.
        let pause = (0..300).map(|k| if (100..130).contains(&k) { 130.0 + f64::from(k) * 1e-3 } else { f64::from(k) });
        assert_eq!(found(pause).iter().sum::<u32>(), 0);
    }

    #[test]
    fn what_stays_away_is_lost() {
        let three = found((0..200).map(|k| f64::from(if k < 100 { k } else { k + 3 })));
        assert_eq!(three.iter().sum::<u32>(), 3);
        assert_eq!(three.iter().position(|lost| *lost == 3), Some(115), "known 16 frames later");
        // Of a pause of ten periods, four frames were held up and six lost; jitter of a tenth.
        let jitter = |k: u32| f64::from(k * 7 % 10) * 0.01;
        let some = (0..200).map(|k| match k {
            0..100 => f64::from(k) + jitter(k),
            100..104 => 110.0 + f64::from(k) * 1e-3,
            _ => f64::from(k + 6) + jitter(k),
        });
        assert_eq!(found(some).iter().sum::<u32>(), 6);
    }

    #[test]
    fn losses_that_never_pause_are_counted() {
        for every in [3, 5, 10, 16, 20] {
            let arrivals: Vec<u32> = (0..600).filter(|k| *k < 100 || k % every != 0).collect();
            let found = found(arrivals.iter().map(|k| f64::from(*k) + f64::from(k * 7 % 10) * 0.01));
            let lost = (600 - arrivals.len()) as u32;
            // The last few are not known yet.
            let known = lost - (SETTLING as u32).div_ceil(every - 1);
            let total: u32 = found.iter().sum();
            assert!((known..=lost).contains(&total), "every {every}: {total} of {lost}");
        }
    }

    /// One that is slower than stated is judged by its own pace after a few frames.
    #[test]
    fn a_slower_camera_is_followed() {
        let slow = found((0..300).map(|k| f64::from(2 * k + if k < 200 { 0 } else { 2 })));
        assert_eq!(slow[100..].iter().sum::<u32>(), 1);
    }
}
