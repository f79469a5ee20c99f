//! The band that the input excites: all but 1 % of its energy at either end; and where that of the output ends.
//!
//! From the periodogram of the whole record, mean removed and without a window, which would hide how a chirp begins and
//! ends. The energy is summed over frequency and interpolated between its lines, so that the edges do not jump from
//! line to line with the record's length: a bandwidth may refer to the lower one.

use crate::identify::data::segments::{Segment, bridged};
use rustfft::FftPlanner;
use rustfft::num_complex::Complex;

/// Fraction of a signal's energy outside of its band at either end.
const BAND_TAIL: f64 = 0.01;
/// Least zeros after a segment, relative to its samples: lines are then closer than the record resolves.
const PADDING: usize = 1;

/// Lower and upper edge, Hz; everything up to half the sampling rate for an input that does not change.
pub(super) fn excited_hz(segments: &[Segment], period_s: f64) -> (f64, f64) {
    band_hz(segments.iter().map(|segment| &segment.input[..]), period_s)
}

/// Frequency below which 99 % of the output's energy lies, Hz. Outputs that are missing are taken from a line between
/// their neighbours.
pub(super) fn output_ends_hz(segments: &[Segment], period_s: f64) -> f64 {
    let outputs: Vec<Vec<f64>> = segments.iter().map(|segment| bridged(&segment.output, usize::MAX)).collect();
    band_hz(outputs.iter().map(Vec::as_slice), period_s).1
}

fn band_hz<'a>(signals: impl Iterator<Item = &'a [f64]> + Clone, period_s: f64) -> (f64, f64) {
    let nyquist_hz = 0.5 / period_s;
    // What is missing at an end is no motion.
    let known = |signal: &'a [f64]| signal.iter().copied().filter(|v| !v.is_nan());
    let samples: usize = signals.clone().map(|signal| known(signal).count()).sum();
    let mean = signals.clone().flat_map(known).sum::<f64>() / samples.max(1) as f64;
    let longest = signals.clone().map(<[f64]>::len).max().unwrap_or(0);
    let length = ((1 + PADDING) * longest).next_power_of_two();
    let transform = FftPlanner::new().plan_fft_forward(length);
    let mut power = vec![0.0; length / 2 + 1];
    for signal in signals {
        let mut buffer: Vec<Complex<f64>> = known(signal).map(|v| Complex::new(v - mean, 0.0)).collect();
        buffer.resize(length, Complex::new(0.0, 0.0));
        transform.process(&mut buffer);
        power.iter_mut().zip(&buffer).for_each(|(sum, line)| *sum += line.norm_sqr());
    }
    // Half of the first line and of the last is at negative frequencies and beyond half the rate.
    if let [first, .., last] = power.as_mut_slice() {
        *first *= 0.5;
        *last *= 0.5;
    }
    let step_hz = 1.0 / (length as f64 * period_s);
    let total: f64 = power.iter().sum();
    // A line stands for the half step on either side of it.
    let reaches = |part: f64| {
        let mut sum = 0.0;
        for (k, line) in power.iter().enumerate() {
            if sum + line >= part * total && *line > 0.0 {
                let from_hz = (k as f64 - 0.5).max(0.0) * step_hz;
                let to_hz = ((k as f64 + 0.5) * step_hz).min(nyquist_hz);
                return from_hz + (to_hz - from_hz) * (part * total - sum) / line;
            }
            sum += line;
        }
        nyquist_hz
    };
    if total > 0.0 { (reaches(BAND_TAIL), reaches(1.0 - BAND_TAIL)) } else { (0.0, nyquist_hz) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    fn segment(samples: usize, of: impl Fn(f64) -> f64) -> Segment {
        let input: Vec<f64> = (0..samples).map(|k| of(k as f64 / 60.0)).collect();
        Segment { output: input.clone(), input, ..Segment::default() }
    }

    /// A linear chirp has the same energy at every frequency: 1 % of it is 1 % of its band, whatever the rate, and in
    /// whole or with a hole.
    #[test]
    fn the_edges_of_a_chirp_do_not_depend_on_length_or_rate() {
        let chirp = |t: f64, end: f64| (TAU * (0.5 * t + 3.5 * t * t / (2.0 * end))).sin();
        for seconds in [50_usize, 60, 75] {
            let end = seconds as f64;
            let whole = segment(60 * seconds, |t| chirp(t, end));
            let slow = Segment { input: whole.input.iter().step_by(3).copied().collect(), ..Segment::default() };
            let parts = [whole.part(0, 1000, 1.0 / 60.0), whole.part(1020, 60 * seconds, 1.0 / 60.0)];
            for (segments, period_s) in [(&[whole][..], 1.0 / 60.0), (&[slow], 0.05), (&parts, 1.0 / 60.0)] {
                let (low, high) = excited_hz(segments, period_s);
                assert!((low - 0.535).abs() < 0.06 && (high - 3.965).abs() < 0.06, "{seconds} s: {low} to {high}");
            }
        }
    }

    /// Also of a record so short, or sampled so fast, that averaged spectra resolve hertz only.
    #[test]
    fn a_slow_output_ends_where_it_does_at_any_rate() {
        for rate in [60, 500, 2000] {
            let wave = |k: usize| (TAU * 0.8 * k as f64 / f64::from(rate)).sin();
            let output = (0..10 * rate as usize).map(|k| if k % 40 < 3 { f64::NAN } else { wave(k) }).collect();
            let segment = Segment { input: vec![0.0; 10 * rate as usize], output, ..Segment::default() };
            let ends = output_ends_hz(&[segment], 1.0 / f64::from(rate));
            assert!((0.75..1.5).contains(&ends), "{rate}: {ends}");
        }
    }

    #[test]
    fn a_sine_excites_its_frequency() {
        let (low, high) = excited_hz(&[segment(6000, |t| 3.0 + (TAU * 2.0 * t).sin())], 1.0 / 60.0);
        assert!(low > 1.9 && high < 2.1, "{low} {high}");
        assert_eq!(excited_hz(&[segment(600, |_| 3.0)], 0.05), (0.0, 10.0));
    }
}
