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

/// In which steps a file has times and currents.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Resolution {
    /// Nanoseconds.
    pub time_ns: i64,
    /// Amperes; 0 for any.
    pub current_a: f64,
}

impl Resolution {
    /// Of a table: so fine that it does not matter.
    pub(crate) const TABLE: Self = Self { time_ns: 1, current_a: 0.0 };
    /// Of a list for the amplifier, whose delays are whole milliseconds.
    pub(crate) const LIST: Self = Self { time_ns: 1_000_000, current_a: 1e-6 };

    /// The nearest current that it has.
    fn nearest(self, value_a: f64) -> f64 {
        if self.current_a > 0.0 { (value_a / self.current_a).round() * self.current_a } else { value_a }
    }

    /// The largest that it has up to this one.
    fn below(self, value_a: f64) -> f64 {
        let steps = |exact: f64| (exact * (1.0 + error::ROUNDING)).floor();
        if self.current_a > 0.0 { steps(value_a / self.current_a) * self.current_a } else { value_a }
    }
}

/// A current over time, at a constant rate.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Signal {
    /// Samples per second.
    pub rate: FrameRate,
    /// One value per sample, amperes, each held until the next.
    pub values_a: Vec<f64>,
    /// Of the file that it is for.
    pub resolution: Resolution,
}

impl Signal {
    /// As a file of this resolution has it.
    pub(crate) fn written_as(self, resolution: Resolution) -> Self {
        let values_a = self.values_a.into_iter().map(|value| resolution.nearest(value)).collect();
        Self { values_a, resolution, ..self }
    }

    /// A signal of `duration_s` at `rate`, each sample from its time.
    fn of(rate: FrameRate, duration_s: f64, value_a: impl Fn(f64) -> f64) -> Result<Self, ExciteError> {
        let samples = samples(rate, duration_s)?;
        let mut signal = Self { rate, values_a: Vec::with_capacity(samples), resolution: Resolution::TABLE };
        for k in 0..samples {
            let t_s = signal.time_s(k);
            signal.values_a.push(value_a(t_s));
        }
        Ok(signal)
    }

    /// Time of sample `k`, seconds; sample 0 is at 0.
    pub(crate) fn time_s(&self, k: usize) -> f64 {
        let step_ns = self.resolution.time_ns;
        let rounded = |ns: i64| ns.saturating_add(step_ns / 2).div_euclid(step_ns) * step_ns;
        self.rate.stamp_ns(k as u64).map_or(f64::INFINITY, |ns| seconds(rounded(ns)))
    }

    /// Time from the sample before `k` to it, seconds; before the first one, that to the second.
    fn interval_s(&self, k: usize) -> f64 {
        let k = k.max(1);
        self.time_s(k) - self.time_s(k - 1)
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

    /// Slews, amperes per second, and the samples at which they are: the step from one sample to the next over the time
    /// between them. The steps from rest and back count.
    fn slews(&self) -> impl Iterator<Item = (f64, usize)> {
        let before = std::iter::once(&0.0).chain(&self.values_a);
        let after = self.values_a.iter().chain(std::iter::once(&0.0));
        before.zip(after).zip(0..).map(|((before, after), k)| ((after - before).abs() / self.interval_s(k), k))
    }

    /// The largest of them, and its time.
    pub(crate) fn largest_slew(&self) -> (f64, f64) {
        let (slew_a_s, k) = self.slews().max_by(|a, b| a.0.total_cmp(&b.0)).unwrap_or((0.0, 0));
        (slew_a_s, self.time_s(k))
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
