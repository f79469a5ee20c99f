//! Limits of amplifier and coils, and limiting of signals.

use super::error::{ExciteError, ROUNDING};
use super::{Resolution, Signal};

/// Limits of the current.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Limits {
    /// Largest current, amperes.
    pub current_a: f64,
    /// Largest change, amperes per second.
    pub slew_a_s: Option<f64>,
}

/// Kind of change.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Change {
    /// Values beyond the limit of current.
    Current,
    /// Values reached too fast.
    Slew,
}

/// A change by limiting, and where.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Clipped {
    /// Its kind.
    pub what: Change,
    /// Number of samples.
    pub samples: usize,
    /// Time of the first, seconds.
    pub first_s: f64,
    /// Time of the last, seconds.
    pub last_s: f64,
    /// The largest change, amperes.
    pub largest_a: f64,
}

impl Limits {
    /// Checks that a signal keeps the limits.
    ///
    /// # Errors
    /// The first limit that it exceeds, with the time, and for slew the amplitude that would keep it.
    pub(crate) fn check(&self, signal: &Signal) -> Result<(), ExciteError> {
        let beyond = self.current_a * (1.0 + ROUNDING);
        if let Some(first) = signal.values_a.iter().position(|value| value.abs() > beyond) {
            let (at_s, value_a) = (signal.time_s(first), signal.peak_a());
            return Err(ExciteError::Current { at_s, value_a, limit_a: self.current_a });
        }
        let Some(limit_a_s) = self.slew_a_s else { return Ok(()) };
        let mut beyond = signal.slews().filter(|(slew_a_s, _)| *slew_a_s > limit_a_s * (1.0 + ROUNDING));
        match beyond.next() {
            Some((_, first)) => {
                let (slew_a_s, _) = signal.largest_slew();
                // Two values rounded to the file's resolution may differ by one step more.
                let step_a_s = signal.resolution.current_a / signal.interval_s(first);
                let fits_a = signal.peak_a() * (limit_a_s - step_a_s).max(0.0) / slew_a_s;
                let (at_s, uneven) = (signal.time_s(first), signal.resolution == Resolution::LIST);
                Err(ExciteError::Slew { at_s, slew_a_s, limit_a_s, fits_a, uneven })
            }
            None => Ok(()),
        }
    }

    /// Clips the signal to the limits: first the current, then its slew, from the beginning on. Returns what was
    /// changed. A ramp back to zero current is added if the slew limit requires it.
    pub(crate) fn clip(&self, signal: &mut Signal) -> Vec<Clipped> {
        let mut clipped = Vec::new();
        let before = signal.values_a.clone();
        let most_a = signal.resolution.below(self.current_a);
        for value in &mut signal.values_a {
            *value = value.clamp(-most_a, most_a);
        }
        clipped.extend(changed(Change::Current, &before, signal));
        clipped.extend(self.ramp(signal));
        clipped
    }

    /// Limits the slew of the current; see [`Limits::clip`].
    pub(crate) fn ramp(&self, signal: &mut Signal) -> Option<Clipped> {
        let slew_a_s = self.slew_a_s?;
        // Whole steps of the file's resolution, one at least: otherwise nothing would ever change.
        let step_a = |signal: &Signal, k: usize| {
            signal.resolution.below(slew_a_s * signal.interval_s(k)).max(signal.resolution.current_a)
        };
        let before = signal.values_a.clone();
        let mut last: f64 = 0.0;
        let steps_a: Vec<f64> = (0..before.len()).map(|k| step_a(signal, k)).collect();
        for (value, step_a) in signal.values_a.iter_mut().zip(steps_a) {
            last = value.clamp(last - step_a, last + step_a);
            *value = last;
        }
        let clipped = changed(Change::Slew, &before, signal);
        loop {
            let step_a = step_a(signal, signal.values_a.len());
            if last.abs() <= step_a * (1.0 + ROUNDING) {
                break;
            }
            last -= step_a.copysign(last);
            signal.values_a.push(last);
        }
        clipped
    }

    /// Checks that every step of `signal`, whose levels are held for `hold_s` or up to its end, reaches its level in
    /// that time.
    ///
    /// # Errors
    /// The first step that does not.
    pub(crate) fn check_steps(&self, signal: &Signal, hold_s: f64) -> Result<(), ExciteError> {
        let Some(limit_a_s) = self.slew_a_s else { return Ok(()) };
        let mut before = 0.0;
        for (k, value) in signal.values_a.iter().enumerate() {
            let needs_s = (value - before).abs() / limit_a_s;
            let left_ns = (1e9 * (signal.duration_s() - signal.time_s(k))).round();
            let hold_s = hold_s.min(left_ns / 1e9);
            if needs_s > hold_s * (1.0 + ROUNDING) {
                return Err(ExciteError::Unreached { at_s: signal.time_s(k), needs_s, limit_a_s, hold_s });
            }
            before = *value;
        }
        Ok(())
    }
}

fn changed(what: Change, before: &[f64], signal: &Signal) -> Option<Clipped> {
    let pairs = before.iter().zip(&signal.values_a).enumerate();
    let changes: Vec<(usize, f64)> =
        pairs.map(|(k, (before, after))| (k, (before - after).abs())).filter(|(_, change)| *change > 0.0).collect();
    let ((first, _), (last, _)) = (changes.first()?, changes.last()?);
    Some(Clipped {
        what,
        samples: changes.len(),
        first_s: signal.time_s(*first),
        last_s: signal.time_s(*last),
        largest_a: changes.iter().fold(0.0, |largest, (_, change)| largest.max(*change)),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn signal(values_a: &[f64]) -> Signal {
        Signal { rate: "10".parse().unwrap(), values_a: values_a.to_vec(), resolution: Resolution::TABLE }
    }

    #[test]
    fn beyond_a_limit_is_told_with_where_and_what_would_keep_it() {
        let limits = Limits { current_a: 0.1, slew_a_s: Some(1.0) };
        assert_eq!(limits.check(&signal(&[0.1, 0.05, -0.05, -0.1])), Ok(()));
        let message = |values: &[f64]| limits.check(&signal(values)).unwrap_err().to_string();
        assert_eq!(
            message(&[0.0, 0.11, 0.15]),
            "the current reaches 150.0 mA, and from 0.100 s on exceeds the limit of 100.0 mA: an amplitude of 100.0 mA \
             keeps it"
        );
        assert_eq!(
            message(&[0.1, -0.1]),
            "the current changes by up to 2.000 A/s, and from 0.100 s on exceeds the limit of 1 A/s: an amplitude of \
             50.0 mA keeps it"
        );
        // The return to zero counts.
        let back = Limits { slew_a_s: Some(0.5), ..limits };
        assert!(back.check(&signal(&[0.05, 0.1])).unwrap_err().to_string().contains("from 0.200 s on"));
    }

    /// What is told is rounded, and must fit.
    #[test]
    fn the_amplitude_that_is_told_keeps_the_limit() {
        let limits = Limits { current_a: 0.1, slew_a_s: Some(2.0) };
        for resolution in [Resolution::TABLE, Resolution::LIST] {
            for hz in [3.5, 5.1, 7.7, 8.0] {
                let chirp = |amplitude_a: f64| {
                    let wave = |k: i32| amplitude_a * (std::f64::consts::TAU * hz * f64::from(k) / 250.0).sin();
                    let exact =
                        Signal { rate: "250".parse().unwrap(), ..signal(&(0..500).map(wave).collect::<Vec<_>>()) };
                    exact.written_as(resolution)
                };
                let told = |amplitude_a: f64| -> f64 {
                    let message = limits.check(&chirp(amplitude_a)).unwrap_err().to_string();
                    let after = message.split("an amplitude of ").nth(1).unwrap();
                    after.split(' ').next().unwrap().parse::<f64>().unwrap() * 1e-3
                };
                assert_eq!(limits.check(&chirp(told(0.1))), Ok(()), "{hz} Hz");
                assert_eq!(told(0.2), 0.1);
            }
        }
    }

    #[test]
    fn what_is_clipped_is_told_and_the_rest_is_as_it_was() {
        let limits = Limits { current_a: 0.1, slew_a_s: None };
        let mut cut = signal(&[0.05, 0.12, 0.15, -0.05, -0.2, 0.0]);
        let message = limits.clip(&mut cut);
        assert_eq!(cut.values_a, [0.05, 0.1, 0.1, -0.05, -0.1, 0.0]);
        let [only] = message.as_slice() else { panic!("{message:?}") };
        assert_eq!((only.what, only.samples, only.first_s, only.last_s), (Change::Current, 3, 0.1, 0.4));
        assert!((only.largest_a - 0.1).abs() < 1e-15);
        assert_eq!(limits.check(&cut), Ok(()));
    }

    /// 400 per second: delays of 2 and 3 ms by turns.
    #[test]
    fn a_list_keeps_the_slew_with_the_delays_that_it_has() {
        let sine = |k: i32| 0.1 * (0.12 * f64::from(k)).sin();
        let exact = Signal { rate: "400".parse().unwrap(), ..signal(&(0..184).map(sine).collect::<Vec<_>>()) };
        let limits = Limits { current_a: 0.1, slew_a_s: Some(4.85) };
        assert_eq!(limits.check(&exact), Ok(()));
        let mut list = exact.written_as(Resolution::LIST);
        let refused = limits.check(&list).unwrap_err().to_string();
        assert!(refused.contains("the limit of 4.85 A/s") && refused.contains("whole ms"), "{refused}");
        assert_eq!(limits.clip(&mut list).len(), 1);
        assert_eq!(limits.check(&list), Ok(()));
        // Multiples of 1 µA stay as they are when the list is written.
        assert!(list.values_a.iter().all(|value| (value * 1e6 - (value * 1e6).round()).abs() < 1e-6));
        assert!(list.time_s(1) == 0.003 && list.time_s(2) == 0.005);
    }

    #[test]
    fn steps_become_ramps_and_end_at_zero() {
        let limits = Limits { current_a: 0.1, slew_a_s: Some(0.4) };
        let mut steps = signal(&[0.1; 5]);
        let message = limits.ramp(&mut steps).unwrap();
        let expected = [0.04, 0.08, 0.1, 0.1, 0.1, 0.06, 0.02];
        assert!(steps.values_a.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-12), "{:?}", steps.values_a);
        assert_eq!((steps.values_a.len(), message.samples, message.what), (7, 2, Change::Slew));
        assert_eq!(limits.check(&steps), Ok(()));
        assert_eq!(limits.check_steps(&signal(&[0.1; 5]), 0.5), Ok(()));
        assert!(limits.check_steps(&signal(&[0.1; 2]), 0.5).is_err());
        let late = limits.check_steps(&signal(&[0.0, 0.1, 0.1]), 0.2).unwrap_err().to_string();
        assert!(late.contains("at 0.100 s takes 0.250 s at 0.4 A/s, and levels are held for 0.2 s"), "{late}");
    }
}
