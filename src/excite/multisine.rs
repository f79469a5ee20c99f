//! A sum of sines at all multiples of 1/period in a band, with equal amplitudes, repeated every period.
//!
//! Each period is the same, so noise shows in the differences of periods, and no frequency leaks into another. The
//! phases are free: they determine the ratio of peak to root mean square (the crest factor), and so how much energy the
//! amplifier's limit allows.
//! - Schroeder's phases φ_k = −π k (k − 1) / K (IEEE Trans. Inf. Theory 16, 1970, doi:10.1109/TIT.1970.1054411): a
//!   periodic chirp.
//! - Random phases, the best of a number of draws: without order in time, as preferred for linear identification of a
//!   non-linear plant.
//!
//! The sum is scaled so that its peak is the requested amplitude.

use super::{ExciteError, Resolution, Signal, band, positive, samples};
use crate::source::FrameRate;
use rustfft::FftPlanner;
use rustfft::num_complex::Complex;
use std::f64::consts::{PI, TAU};

/// How phases are chosen.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Phases {
    /// Schroeder's.
    Schroeder,
    /// Random, the best of several draws; reproducible by seed.
    Random {
        /// Seed of the first draw; further draws follow.
        seed: u64,
        /// Number of draws, at least 1.
        tries: u32,
    },
}

/// A multisine.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Multisine {
    /// Lowest frequency, Hz.
    pub from_hz: f64,
    /// Highest frequency, Hz.
    pub to_hz: f64,
    /// Length of a period, seconds.
    pub period_s: f64,
    /// Total length, seconds; the last period may be cut short.
    pub duration_s: f64,
    /// Peak, amperes.
    pub amplitude_a: f64,
    /// How phases are chosen.
    pub phases: Phases,
}

impl Multisine {
    /// The signal at `rate`, and its number of sines.
    ///
    /// # Errors
    /// [`ExciteError`] when a value is not positive, the rate too low, the band is reversed or has no line, or the
    /// period is not a whole number of samples.
    pub(crate) fn signal(&self, rate: FrameRate) -> Result<(Signal, usize), ExciteError> {
        positive("amplitude", self.amplitude_a, "A")?;
        positive("period", self.period_s, "s")?;
        if self.from_hz > self.to_hz {
            return Err(ExciteError::Reversed { from_hz: self.from_hz, to_hz: self.to_hz });
        }
        band(self.from_hz, self.to_hz, rate)?;
        let (exact, all) = (self.period_s * rate.hz(), samples(rate, self.duration_s)?);
        let one = samples(rate, self.period_s)?;
        if (exact - one as f64).abs() > 1e-6 {
            let near_s = one as f64 / rate.hz();
            return Err(ExciteError::Period { period_s: self.period_s, rate_hz: rate.hz(), near_s });
        }
        if all < one {
            return Err(ExciteError::ShorterThanPeriod { duration_s: self.duration_s, period_s: self.period_s });
        }
        // A frequency that is a multiple up to rounding counts as one.
        let first = ((self.from_hz * self.period_s) - 1e-9).ceil().max(1.0) as usize;
        let last = ((self.to_hz * self.period_s) + 1e-9).floor() as usize;
        if first > last {
            let step_hz = 1.0 / self.period_s;
            return Err(ExciteError::NoLine { from_hz: self.from_hz, to_hz: self.to_hz, step_hz });
        }
        let lines = last - first + 1;
        let period = match self.phases {
            Phases::Schroeder => {
                let phase = |k: usize| -PI * k as f64 * (k as f64 - 1.0) / lines as f64;
                sum(one, first, &(1..=lines).map(phase).collect::<Vec<_>>())
            }
            Phases::Random { seed, tries } => {
                let mut random = fastrand::Rng::with_seed(seed);
                let mut draw = || sum(one, first, &(0..lines).map(|_| TAU * random.f64()).collect::<Vec<_>>());
                let mut best = draw();
                for _ in 1..tries {
                    let next = draw();
                    // All have the same energy: the smallest peak is the smallest crest factor.
                    if peak(&next) < peak(&best) {
                        best = next;
                    }
                }
                best
            }
        };
        let scale = self.amplitude_a / peak(&period);
        let values_a = period.iter().cycle().take(all).map(|value| value * scale).collect();
        Ok((Signal { rate, values_a, resolution: Resolution::TABLE }, lines))
    }
}

/// One period of `samples`: cosines of amplitude 1 from line `first`, with these phases.
fn sum(samples: usize, first: usize, phases: &[f64]) -> Vec<f64> {
    let mut lines = vec![Complex::new(0.0, 0.0); samples];
    for (line, phase) in lines.iter_mut().skip(first).zip(phases) {
        *line = Complex::from_polar(1.0, *phase);
    }
    FftPlanner::new().plan_fft_inverse(samples).process(&mut lines);
    // The real part of the one-sided sum is the sum of cosines.
    lines.iter().map(|value| value.re).collect()
}

fn peak(values: &[f64]) -> f64 {
    values.iter().fold(0.0, |peak, value| peak.max(value.abs()))
}

#[cfg(test)]
mod tests {
    use super::super::Spectrum;
    use super::*;

    fn multisine(phases: Phases) -> Multisine {
        Multisine { from_hz: 0.5, to_hz: 8.0, period_s: 20.0, duration_s: 60.0, amplitude_a: 0.1, phases }
    }

    fn sixty() -> FrameRate {
        "60".parse().unwrap()
    }

    #[test]
    fn lines_are_equally_strong_and_nothing_is_between_them() {
        for phases in [Phases::Schroeder, Phases::Random { seed: 3, tries: 1 }] {
            let (signal, lines) = multisine(phases).signal(sixty()).unwrap();
            assert_eq!((lines, signal.values_a.len()), (151, 3600));
            assert!((signal.peak_a() - 0.1).abs() < 1e-12);
            let spectrum = Spectrum::of(&signal);
            let expected = signal.rms_a().powi(2) / 151.0;
            for (k, power) in spectrum.power_a2.iter().enumerate() {
                // Three periods: a line of the sum is every third line of the spectrum.
                let on = k % 3 == 0 && (10..=160).contains(&(k / 3));
                let should = if on { expected } else { 0.0 };
                assert!((power - should).abs() < 1e-9 * expected, "line {k}: {power}, expected {should}");
            }
        }
    }

    #[test]
    fn more_draws_give_a_smaller_crest_factor_and_a_seed_the_same_signal() {
        let crest = |tries| multisine(Phases::Random { seed: 1, tries }).signal(sixty()).unwrap().0.crest_factor();
        let schroeder = multisine(Phases::Schroeder).signal(sixty()).unwrap().0.crest_factor();
        let (one, many) = (crest(1), crest(300));
        assert!(schroeder < 2.0 && many < one && many < 2.9, "{schroeder} {one} {many}");
        assert_eq!(crest(5), crest(5));
        let other = multisine(Phases::Random { seed: 2, tries: 1 }).signal(sixty()).unwrap().0.crest_factor();
        assert_ne!(crest(1), other);
    }

    #[test]
    fn bands_and_periods_that_do_not_fit_are_refused() {
        let message = |multisine: Multisine| multisine.signal(sixty()).unwrap_err().to_string();
        let fits = multisine(Phases::Schroeder);
        let period = message(Multisine { period_s: 20.01, ..fits });
        assert!(
            period.contains("1200.600 samples") && period.contains("20.016666666666666 s is the nearest"),
            "{period}"
        );
        let band = message(Multisine { from_hz: 1.01, to_hz: 1.04, ..fits });
        assert!(band.contains("no multiple of 0.05 Hz"), "{band}");
        assert_eq!(
            message(Multisine { from_hz: 8.0, to_hz: 0.5, ..fits }),
            "the band goes from 8 Hz down to 0.5 Hz: give the lower frequency with --from"
        );
        assert!(message(Multisine { to_hz: 31.0, ..fits }).contains("stay below 30 Hz"));
    }
}
