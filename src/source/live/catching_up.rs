//! Whether a long step between arrivals means lost frames, or frames that were held up on their way.
//!
//! A sender that pauses or writes in bursts catches up: its next frames come early, until they are where they would
//! have been. What is lost stays away: all later frames are late by whole periods. So a step is judged after some more
//! frames, by the one that was least late.

/// Frames at the camera's own pace after which a step is judged.
const SETTLING: u32 = 16;
/// Steps shorter than this, in periods, are those of frames that catch up.
const PACE: f64 = 0.5;

/// Judges steps.
pub(super) struct CatchingUp {
    /// The rate that was stated.
    period_ns: f64,
    last_ns: Option<i64>,
    late: Option<Late>,
}

/// A step that is not judged yet.
struct Late {
    /// The last arrival before it, and the period.
    from_ns: i64,
    period_ns: f64,
    /// Frames since then; of these, those at the camera's pace since the last long step.
    frames: u32,
    paced: u32,
    /// How late the frame since the last long step was that was least late.
    least_ns: f64,
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
            let new = || Late { from_ns: last_ns, period_ns, frames: 0, paced: 0, least_ns: f64::INFINITY, most: 0 };
            let late = self.late.get_or_insert_with(new);
            (late.paced, late.least_ns, late.most) = (0, f64::INFINITY, late.most.saturating_add(missing));
        }
        let Some(late) = &mut self.late else { return 0 };
        late.frames += 1;
        late.paced += u32::from(step_ns > PACE * late.period_ns);
        let due_ns = f64::from(late.frames) * late.period_ns;
        late.least_ns = late.least_ns.min(arrival_ns.saturating_sub(late.from_ns) as f64 - due_ns);
        let lost = (late.least_ns / late.period_ns).round();
        if lost < 1.0 {
            self.late = None;
            return 0;
        }
        if late.paced < SETTLING {
            return 0;
        }
        let lost = (lost as u32).min(late.most);
        self.late = None;
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

    /// One that is slower than stated is judged by its own pace after a few frames.
    #[test]
    fn a_slower_camera_is_followed() {
        let slow = found((0..300).map(|k| f64::from(2 * k + if k < 200 { 0 } else { 2 })));
        assert_eq!(slow[100..].iter().sum::<u32>(), 1);
    }
}
