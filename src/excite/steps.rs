//! Held levels: a staircase through them in order, or at random.
//!
//! If slew is limited, the current ramps from one level to the next ([`Limits::ramp`](super::Limits::ramp)).

use super::{ExciteError, Resolution, Signal, samples};
use crate::source::FrameRate;

/// Order of the levels.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Order {
    /// As given, repeated from the first.
    Staircase,
    /// At random, never the same twice in a row; reproducible by seed.
    Random {
        /// Seed.
        seed: u64,
    },
}

/// Steps.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Steps {
    /// The levels, amperes.
    pub levels_a: Vec<f64>,
    /// How long each is held, seconds.
    pub hold_s: f64,
    /// Total length, seconds.
    pub duration_s: f64,
    /// Their order.
    pub order: Order,
}

impl Steps {
    /// Rows for which each level is held: the nearest whole number.
    fn held_rows(&self, rate: FrameRate) -> usize {
        (self.hold_s * rate.hz()).round() as usize
    }

    /// How long each level is held, seconds.
    pub(crate) fn held_s(&self, rate: FrameRate) -> f64 {
        self.held_rows(rate) as f64 / rate.hz()
    }

    /// The signal at `rate`.
    ///
    /// # Errors
    /// [`ExciteError`] when there are fewer than two levels, they are held for less than two samples, not all of them
    /// are reached, or the length is zero.
    pub(crate) fn signal(&self, rate: FrameRate) -> Result<Signal, ExciteError> {
        let mut different: Vec<f64> = self.levels_a.iter().copied().filter(|level| level.is_finite()).collect();
        different.sort_by(f64::total_cmp);
        different.dedup();
        if different.len() < 2 {
            return Err(ExciteError::Levels { found: different.len() });
        }
        let (all, held_rows) = (samples(rate, self.duration_s)?, self.held_rows(rate));
        if !self.hold_s.is_finite() || held_rows < 2 {
            return Err(ExciteError::Hold { hold_s: self.hold_s, rate_hz: rate.hz() });
        }
        let levels = all.div_ceil(held_rows);
        let given = self.levels_a.len();
        if levels < given {
            let (duration_s, hold_s) = (self.duration_s, self.hold_s);
            return Err(ExciteError::UnusedLevels { duration_s, fit: levels, given, hold_s });
        }
        let levels: Vec<f64> = match self.order {
            Order::Staircase => self.levels_a.iter().copied().cycle().take(levels).collect(),
            Order::Random { seed } => {
                let mut random = fastrand::Rng::with_seed(seed);
                let mut last = None;
                let mut draw = || {
                    let others: Vec<f64> = different.iter().copied().filter(|level| Some(*level) != last).collect();
                    last = random.choice(others);
                    last
                };
                (0..levels).filter_map(|_| draw()).collect()
            }
        };
        let held = levels.into_iter().flat_map(|level| std::iter::repeat_n(level, held_rows));
        Ok(Signal { rate, values_a: held.take(all).collect(), resolution: Resolution::TABLE })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn steps(order: Order) -> Steps {
        Steps { levels_a: vec![0.0, 0.05, 0.1, 0.05], hold_s: 0.5, duration_s: 10.0, order }
    }

    fn ten() -> FrameRate {
        "10".parse().unwrap()
    }

    #[test]
    fn a_staircase_goes_through_its_levels_and_begins_again() {
        let signal = steps(Order::Staircase).signal(ten()).unwrap();
        let levels: Vec<f64> = signal.values_a.chunks(5).map(|held| held[0]).collect();
        assert_eq!(levels[..6], [0.0, 0.05, 0.1, 0.05, 0.0, 0.05]);
        assert!(signal.values_a.chunks(5).all(|held| held.iter().all(|value| *value == held[0])));
        assert_eq!((signal.values_a.len(), signal.duration_s()), (100, 10.0));
    }

    #[test]
    fn random_levels_differ_from_one_to_the_next() {
        let signal = steps(Order::Random { seed: 1 }).signal(ten()).unwrap();
        let levels: Vec<f64> = signal.values_a.chunks(5).map(|held| held[0]).collect();
        assert!(levels.windows(2).all(|pair| pair[0] != pair[1]));
        assert!([0.0, 0.05, 0.1].iter().all(|level| levels.contains(level)));
        assert_eq!(signal, steps(Order::Random { seed: 1 }).signal(ten()).unwrap());
        assert_ne!(signal, steps(Order::Random { seed: 2 }).signal(ten()).unwrap());
    }

    #[test]
    fn one_level_and_a_short_hold_are_refused() {
        let message = |steps: Steps| steps.signal(ten()).unwrap_err().to_string();
        let fits = steps(Order::Staircase);
        assert!(
            message(Steps { levels_a: vec![0.1, 0.1], ..fits.clone() }).contains("two levels that differ; 1 given")
        );
        assert!(message(Steps { hold_s: 0.1, ..fits.clone() }).contains("hold it for 0.2 s or longer"));
        let long = message(Steps { hold_s: 2.0 * fits.duration_s / fits.levels_a.len() as f64, ..fits });
        assert!(long.contains("levels fit, each held for"), "{long}");
    }
}
