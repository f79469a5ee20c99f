//! Distribution of a signal's energy over frequency.

use super::Signal;
use rustfft::FftPlanner;
use rustfft::num_complex::Complex;

/// The one-sided periodogram of a whole signal.
///
/// It is that of the samples, up to half their rate: holding them adds images around multiples of the rate, and
/// attenuates the signal itself by sinc(f / rate) (0.25 dB at 8 Hz and 60 samples per second).
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Spectrum {
    /// Distance of lines, Hz: 1 over the length.
    pub step_hz: f64,
    /// Mean square in each line, A²; line 0 is the mean current's. The sum of all is the mean square of the signal.
    pub power_a2: Vec<f64>,
}

impl Spectrum {
    /// The spectrum of a signal.
    pub(crate) fn of(signal: &Signal) -> Self {
        let n = signal.values_a.len();
        let mut values: Vec<_> = signal.values_a.iter().map(|value| Complex::new(*value, 0.0)).collect();
        FftPlanner::new().plan_fft_forward(n).process(&mut values);
        let scale = 1.0 / (n as f64 * n as f64);
        // A line and its mirror image count together, except the mean and, for an even number, the middle.
        let both = |k: usize| if k == 0 || 2 * k == n { 1.0 } else { 2.0 };
        let lines = values.iter().take(n / 2 + 1).enumerate();
        Self {
            step_hz: signal.rate.hz() / n.max(1) as f64,
            power_a2: lines.map(|(k, value)| both(k) * value.norm_sqr() * scale).collect(),
        }
    }

    /// Fraction of the energy between two frequencies, inclusive.
    pub(crate) fn share(&self, from_hz: f64, to_hz: f64) -> f64 {
        let (half, all) = (self.step_hz / 2.0, self.power_a2.iter().sum::<f64>());
        let inside = |k: usize| (from_hz - half..to_hz + half).contains(&(k as f64 * self.step_hz));
        // The sum of nothing is −0.
        (self.power_a2.iter().enumerate().filter(|(k, _)| inside(*k)).map(|(_, power)| power).sum::<f64>() + 0.0) / all
    }

    /// The band that contains all but 1 % of the energy, half of that below and half above, Hz.
    pub(crate) fn occupied_hz(&self) -> (f64, f64) {
        let all: f64 = self.power_a2.iter().sum();
        let edge = |lines: &mut dyn Iterator<Item = usize>| {
            let mut passed = 0.0;
            for k in lines {
                passed += self.power_a2.get(k).copied().unwrap_or(0.0);
                if passed > 0.005 * all {
                    return k as f64 * self.step_hz;
                }
            }
            0.0
        };
        (edge(&mut (0..self.power_a2.len())), edge(&mut (0..self.power_a2.len()).rev()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::excite::Resolution;
    use std::f64::consts::TAU;

    #[test]
    fn a_sine_is_one_line_and_the_sum_is_the_mean_square() {
        for n in [600, 601] {
            let hz = 5.0 * 60.0 / f64::from(n);
            let values_a =
                (0..n).map(|k| 0.02 + 0.1 * (TAU * hz * f64::from(k) / 60.0 + 0.3).sin()).collect::<Vec<_>>();
            let signal = Signal { rate: "60".parse().unwrap(), values_a, resolution: Resolution::TABLE };
            let spectrum = Spectrum::of(&signal);
            assert!((spectrum.power_a2[5] - 0.005).abs() < 1e-12 && (spectrum.power_a2[0] - 4e-4).abs() < 1e-12);
            let sum: f64 = spectrum.power_a2.iter().sum();
            assert!((sum / signal.rms_a().powi(2) - 1.0).abs() < 1e-12);
            assert!((spectrum.share(hz, hz) - 0.005 / 0.0054).abs() < 1e-9);
            assert!((spectrum.share(0.0, 30.0) - 1.0).abs() < 1e-12);
            assert_eq!(spectrum.occupied_hz(), (0.0, 5.0 * spectrum.step_hz));
        }
    }
}
