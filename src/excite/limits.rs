//! Limits of amplifier and coils, and limiting of signals.

use super::{ExciteError, Signal};

/// Relative excess over a limit attributed to rounding.
const ROUNDING: f64 = 1e-9;

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
        let largest = signal.values_a.iter().map(|value| value.abs()).enumerate().max_by(|a, b| a.1.total_cmp(&b.1));
        if let Some((at, value_a)) = largest.filter(|(_, value)| *value > beyond) {
            return Err(ExciteError::Current { at_s: signal.time_s(at), value_a, limit_a: self.current_a });
        }
        let (slew_a_s, at_s) = signal.largest_slew();
        match self.slew_a_s {
            Some(limit_a_s) if slew_a_s > limit_a_s * (1.0 + ROUNDING) => {
                let fits_a = signal.peak_a() * limit_a_s / slew_a_s;
                Err(ExciteError::Slew { at_s, slew_a_s, limit_a_s, fits_a })
            }
            _ => Ok(()),
        }
    }

    /// Clips the signal to the limits: first the current, then its slew, from the beginning on. Returns what was
    /// changed. A ramp back to zero current is added if the slew limit requires it.
    pub(crate) fn clip(&self, signal: &mut Signal) -> Vec<Clipped> {
        let mut clipped = Vec::new();
        let before = signal.values_a.clone();
        for value in &mut signal.values_a {
            *value = value.clamp(-self.current_a, self.current_a);
        }
        clipped.extend(changed(Change::Current, &before, signal));
        clipped.extend(self.ramp(signal));
        clipped
    }

    /// Limits the slew of the current; see [`Limits::clip`].
    pub(crate) fn ramp(&self, signal: &mut Signal) -> Option<Clipped> {
        let step_a = self.slew_a_s? / signal.rate.hz();
        let before = signal.values_a.clone();
        let mut last = 0.0;
        for value in &mut signal.values_a {
            last = value.clamp(last - step_a, last + step_a);
            *value = last;
        }
        let clipped = changed(Change::Slew, &before, signal);
        while last.abs() > step_a * (1.0 + ROUNDING) {
            last -= step_a.copysign(last);
            signal.values_a.push(last);
        }
        clipped
    }

    /// Checks that every step of `signal`, whose levels are held for `hold_s`, reaches its level in that time.
    ///
    /// # Errors
    /// The first step that does not.
    pub(crate) fn check_steps(&self, signal: &Signal, hold_s: f64) -> Result<(), ExciteError> {
        let Some(limit_a_s) = self.slew_a_s else { return Ok(()) };
        let mut before = 0.0;
        for (k, value) in signal.values_a.iter().enumerate() {
            let needs_s = (value - before).abs() / limit_a_s;
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
        Signal { rate: "10".parse().unwrap(), values_a: values_a.to_vec() }
    }

    #[test]
    fn beyond_a_limit_is_told_with_where_and_what_would_keep_it() {
        let limits = Limits { current_a: 0.1, slew_a_s: Some(1.0) };
        assert_eq!(limits.check(&signal(&[0.1, 0.05, -0.05, -0.1])), Ok(()));
        let message = |values: &[f64]| limits.check(&signal(values)).unwrap_err().to_string();
        assert_eq!(message(&[0.0, 0.11, 0.15]), "the current reaches 150.0 mA at 0.200 s, the limit is 100.0 mA");
        assert_eq!(
            message(&[0.1, -0.1]),
            "the current changes by 2.000 A/s at 0.100 s, the limit is 1 A/s: an amplitude of 50.0 mA keeps it"
        );
        // The return to zero counts.
        let back = Limits { slew_a_s: Some(0.5), ..limits };
        assert!(back.check(&signal(&[0.05, 0.1])).unwrap_err().to_string().contains("at 0.200 s"));
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
        let late = limits.check_steps(&signal(&[0.0, 0.1, 0.1]), 0.2).unwrap_err().to_string();
        assert!(late.contains("at 0.100 s takes 0.250 s at 0.4 A/s, and levels are held for 0.2 s"), "{late}");
    }
}
