//! A sine whose frequency sweeps up or down the band.
//!
//! Linear: f(t) = f0 + (f1 − f0) t / T, phase 2π (f0 t + (f1 − f0) t² / 2T): equal energy per hertz. Logarithmic: f(t)
//! = f0 (f1 / f0)^(t / T), phase 2π f0 T / ln(f1/f0) ((f1/f0)^(t/T) − 1): equal energy per octave, more at low
//! frequencies. Both begin at zero current, like `scipy.signal.chirp` with `phi=-90`.

use super::{ExciteError, Signal, band, positive};
use crate::source::FrameRate;
use std::f64::consts::TAU;

/// Kind of sweep.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) enum Sweep {
    /// Constant hertz per second.
    #[default]
    Linear,
    /// Constant octaves per second.
    Logarithmic,
}

/// A chirp.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Chirp {
    /// Frequency at the beginning, Hz.
    pub from_hz: f64,
    /// Frequency at the end, Hz.
    pub to_hz: f64,
    /// Length, seconds.
    pub duration_s: f64,
    /// Amplitude, amperes.
    pub amplitude_a: f64,
    /// Kind of sweep.
    pub sweep: Sweep,
}

impl Chirp {
    /// The signal at `rate`.
    ///
    /// # Errors
    /// [`ExciteError`] when a value is not positive, the rate too low, or the length zero.
    pub(crate) fn signal(&self, rate: FrameRate) -> Result<Signal, ExciteError> {
        let Self { from_hz, to_hz, duration_s, amplitude_a, sweep } = *self;
        positive("amplitude", amplitude_a, "A")?;
        band(from_hz, to_hz, rate)?;
        let ln_ratio = (to_hz / from_hz).ln();
        if sweep == Sweep::Logarithmic && ln_ratio == 0.0 {
            return Err(ExciteError::NoSweep { hz: from_hz });
        }
        let cycles = |t: f64| match sweep {
            Sweep::Linear => from_hz * t + (to_hz - from_hz) * t * t / (2.0 * duration_s),
            Sweep::Logarithmic => from_hz * duration_s / ln_ratio * ((ln_ratio * t / duration_s).exp() - 1.0),
        };
        Signal::of(rate, duration_s, |t| amplitude_a * (TAU * cycles(t)).sin())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn paper(sweep: Sweep) -> Chirp {
        Chirp { from_hz: 0.5, to_hz: 8.0, duration_s: 300.0, amplitude_a: 0.1, sweep }
    }

    fn sixty() -> FrameRate {
        "60".parse().unwrap()
    }

    /// Rising zero crossings per second in a piece of the signal.
    fn crossings_hz(signal: &Signal, from_s: usize, to_s: usize) -> f64 {
        let piece = &signal.values_a[from_s * 60..to_s * 60];
        piece.windows(2).filter(|pair| pair[0] < 0.0 && pair[1] >= 0.0).count() as f64 / (to_s - from_s) as f64
    }

    #[test]
    fn the_papers_chirp() {
        let signal = paper(Sweep::Linear).signal(sixty()).unwrap();
        assert_eq!(signal.values_a.len(), 18_000);
        assert_eq!(signal.values_a[0], 0.0);
        assert!((signal.peak_a() - 0.1).abs() < 1e-5 && (signal.crest_factor() - 2_f64.sqrt()).abs() < 0.01);
        // The frequency in the middle of each piece.
        for (from, to) in [(0, 40), (130, 170), (260, 300)] {
            let middle = 0.5 + 7.5 * (from + to) as f64 / 600.0;
            let found = crossings_hz(&signal, from, to);
            assert!((found - middle).abs() < 0.03, "{found} Hz, expected {middle}");
        }
        // Differences at 8 Hz: 2 A sin(π f / r) r.
        let (slew, at_s) = signal.largest_slew();
        assert!((slew - 2.0 * 0.1 * (std::f64::consts::PI * 8.0 / 60.0).sin() * 60.0).abs() < 0.05 && at_s > 280.0);
    }

    #[test]
    fn a_logarithmic_sweep_is_at_the_geometric_mean_half_way() {
        let signal = paper(Sweep::Logarithmic).signal(sixty()).unwrap();
        let found = crossings_hz(&signal, 140, 160);
        assert!((found - 2.0).abs() < 0.06, "{found} Hz");
    }

    #[test]
    fn values_that_make_no_chirp_are_refused() {
        let message = |chirp: Chirp| chirp.signal(sixty()).unwrap_err().to_string();
        let chirp = paper(Sweep::Linear);
        assert_eq!(message(Chirp { amplitude_a: 0.0, ..chirp }), "amplitude is 0 A; it must be above 0");
        assert!(message(Chirp { to_hz: 30.0, ..chirp }).contains("stay below 30 Hz"));
        assert!(message(Chirp { duration_s: f64::NAN, ..chirp }).contains("duration is NaN s"));
        assert!(message(Chirp { duration_s: 1e9, ..chirp }).contains("2 to 4000000 are possible"));
        assert!(
            message(Chirp { to_hz: 0.5, sweep: Sweep::Logarithmic, ..chirp }).contains("two frequencies that differ")
        );
        assert!(Chirp { to_hz: 0.5, ..chirp }.signal(sixty()).is_ok());
    }
}
