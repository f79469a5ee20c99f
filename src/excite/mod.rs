//! Coil currents that excite the catheter to identify its dynamics: chirp, multisine, steps.
//!
//! In: parameters of the signal, and the limits of amplifier and coils ([`Limits`]). Out: a [`Signal`], one current per
//! period of the controller, held until the next one (zero-order hold); its [spectrum](Spectrum); and a table
//! ([`Signal::table`]).
//!
//! The signal begins from rest and is followed by one row of zero current, so that an amplifier that holds its last
//! value ends without current. Both jumps count for the slew.
//!
//! What it does not do: check whether the catheter survives it (Section III.B of the paper stays below 8 Hz to spare
//! it), or compensate the non-linearity of the torque.

mod chirp;
mod error;
mod limits;
mod multisine;
mod spectrum;
mod steps;
mod write;

pub(crate) use chirp::{Chirp, Sweep};
pub(crate) use error::ExciteError;
pub(crate) use limits::{Change, Clipped, Limits};
pub(crate) use multisine::{Multisine, Phases};
pub(crate) use spectrum::Spectrum;
pub(crate) use steps::{Order, Steps};
pub(crate) use write::is_own_table;

use crate::source::FrameRate;
use crate::source::times::seconds;

/// Most rows: an hour at 1 kHz, and a table that programs can still open.
const MAX_SAMPLES: usize = 4_000_000;

/// A current over time, at a constant rate.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Signal {
    /// Samples per second.
    pub rate: FrameRate,
    /// One value per sample, amperes, each held until the next.
    pub values_a: Vec<f64>,
}

impl Signal {
    /// A signal of `duration_s` at `rate`, each sample from its time.
    fn of(rate: FrameRate, duration_s: f64, value_a: impl Fn(f64) -> f64) -> Result<Self, ExciteError> {
        let samples = samples(rate, duration_s)?;
        let mut signal = Self { rate, values_a: Vec::with_capacity(samples) };
        for k in 0..samples {
            let t_s = signal.time_s(k);
            signal.values_a.push(value_a(t_s));
        }
        Ok(signal)
    }

    /// Time of sample `k`, seconds; sample 0 is at 0.
    pub(crate) fn time_s(&self, k: usize) -> f64 {
        self.rate.stamp_ns(k as u64).map_or(f64::INFINITY, seconds)
    }

    /// Duration, seconds.
    pub(crate) fn duration_s(&self) -> f64 {
        self.time_s(self.values_a.len())
    }

    /// Largest current, amperes.
    pub(crate) fn peak_a(&self) -> f64 {
        self.values_a.iter().fold(0.0, |peak, value| peak.max(value.abs()))
    }

    /// Root mean square, amperes.
    pub(crate) fn rms_a(&self) -> f64 {
        (self.values_a.iter().map(|value| value * value).sum::<f64>() / self.values_a.len().max(1) as f64).sqrt()
    }

    /// Peak over root mean square: 1 for a signal always at its peak, 1.41 for a sine.
    pub(crate) fn crest_factor(&self) -> f64 {
        self.peak_a() / self.rms_a()
    }

    /// Largest slew, amperes per second, and its time: the step from one sample to the next over the time between them.
    /// The steps from rest and back count.
    pub(crate) fn largest_slew(&self) -> (f64, f64) {
        let before = std::iter::once(&0.0).chain(&self.values_a);
        let after = self.values_a.iter().chain(std::iter::once(&0.0));
        let steps = before.zip(after).map(|(before, after)| (after - before).abs());
        let largest = steps.enumerate().max_by(|a, b| a.1.total_cmp(&b.1)).unwrap_or((0, 0.0));
        (largest.1 * self.rate.hz(), self.time_s(largest.0))
    }
}

/// The number of samples.
fn samples(rate: FrameRate, duration_s: f64) -> Result<usize, ExciteError> {
    positive("duration", duration_s, "s")?;
    let samples = (duration_s * rate.hz()).round();
    if samples < 2.0 || samples > MAX_SAMPLES as f64 {
        return Err(ExciteError::Samples { duration_s, rate_hz: rate.hz(), most: MAX_SAMPLES });
    }
    Ok(samples as usize)
}

fn positive(what: &'static str, value: f64, unit: &'static str) -> Result<(), ExciteError> {
    if value.is_finite() && value > 0.0 { Ok(()) } else { Err(ExciteError::NotPositive { what, value, unit }) }
}

/// Checks that the band is below half the rate.
fn band(from_hz: f64, to_hz: f64, rate: FrameRate) -> Result<(), ExciteError> {
    positive("lowest frequency", from_hz, "Hz")?;
    positive("highest frequency", to_hz, "Hz")?;
    let nyquist_hz = rate.hz() / 2.0;
    if to_hz < nyquist_hz && from_hz < nyquist_hz {
        Ok(())
    } else {
        Err(ExciteError::Nyquist { highest_hz: from_hz.max(to_hz), rate_hz: rate.hz() })
    }
}
