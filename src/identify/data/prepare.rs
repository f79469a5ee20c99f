//! Preparation of the signals: detrending and decimation.

use crate::identify::data::grid::fill;
use crate::identify::data::segments::{Record, Segment};
use std::f64::consts::PI;

/// Half length of the anti-aliasing filter, in samples of the result.
const HALF_TAPS: usize = 5;
/// Its cutoff, as a fraction of the new Nyquist frequency.
const CORNER: f64 = 0.8;
/// Nothing of more than this fraction of the new rate passes it: less than 0.5 %.
const PASSES: f64 = 0.62;
/// Frequencies over which its response is integrated.
const INTEGRATED: usize = 400;

/// What is removed from input and output.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) enum Detrend {
    /// Nothing.
    #[default]
    None,
    /// The mean of the fitted data, removed from all data.
    Mean,
    /// A line through each fitted record; from other records the mean of the fitted data.
    Linear,
}

/// A line over time.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct Line {
    /// Value at `about_s`.
    pub offset: f64,
    /// Change per second.
    pub slope: f64,
    /// Seconds of the record's clock.
    pub about_s: f64,
}

impl Line {
    /// Nearest to points (seconds, value); without `slope` their mean.
    pub(in crate::identify) fn through(points: impl Iterator<Item = (f64, f64)> + Clone, slope: bool) -> Self {
        let n = points.clone().count().max(1) as f64;
        let about_s = points.clone().map(|(t, _)| t).sum::<f64>() / n;
        let offset = points.clone().map(|(_, v)| v).sum::<f64>() / n;
        let spread = points.clone().map(|(t, _)| (t - about_s).powi(2)).sum::<f64>();
        let slope =
            if slope && spread > 0.0 { points.map(|(t, v)| (t - about_s) * v).sum::<f64>() / spread } else { 0.0 };
        Self { offset, slope, about_s }
    }

    pub(in crate::identify) fn at(&self, t: f64) -> f64 {
        self.offset + self.slope * (t - self.about_s)
    }
}

/// What was removed from one record's input and output.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct Trend {
    /// What was removed from the input.
    pub input: Line,
    /// What was removed from the output.
    pub output: Line,
}

impl Trend {
    /// The trend of one record's segments, or of several records' without `slope`.
    pub(crate) fn of(segments: &[Segment], period_s: f64, slope: bool) -> Self {
        let line = |signal: fn(&Segment) -> &[f64]| {
            let points = segments.iter().flat_map(move |s| {
                let timed = signal(s).iter().enumerate().map(move |(k, v)| (s.start_s + k as f64 * period_s, *v));
                timed.filter(|(_, v)| !v.is_nan())
            });
            Line::through(points, slope)
        };
        Self { input: line(|s| &s.input), output: line(|s| &s.output) }
    }

    /// Removes it. What was taken off input and output are not at rest together: the difference is left to be fitted,
    /// and so is the state at the beginning.
    pub(crate) fn remove(&self, segment: &mut Segment, period_s: f64) {
        let start_s = segment.start_s;
        let off = |signal: &mut [f64], line: Line| {
            signal.iter_mut().enumerate().for_each(|(k, v)| *v -= line.at(start_s + k as f64 * period_s));
        };
        off(&mut segment.input, self.input);
        off(&mut segment.output, self.output);
        segment.from_rest = false;
        // What remains of the zero is an offset of the output alone.
        segment.by_zero = Some(vec![0.0; segment.len()]);
        segment.zero_drifts = self.input.slope != 0.0 || self.output.slope != 0.0;
    }
}

/// Every `factor`-th sample after a low-pass filter (windowed sinc, Hamming, zero phase).
///
/// What is held from sample to sample, the input, no longer is after it: as the input of a model that holds it for the
/// whole new period, it must be larger at high frequencies. Held for `T` a signal loses sinc(f T); held for `factor` T,
/// 1/D(f) more, with D(f) = sin(π factor f T)/(factor sin(π f T)). Averaging it over the new hold loses D(f) besides
/// and brings it to the hold's centre; [`for_held`] gives back both.
///
/// Outputs missing for no longer than a new period are interpolated, by a cubic: a hole would spread over the whole
/// filter. Five samples of the result are lost at both ends of every segment, and beside longer holes. All segments
/// keep to one grid: that of every `factor`-th place of the record's.
pub(crate) fn decimate(record: &Record, factor: usize, period_s: f64) -> Record {
    let half = HALF_TAPS * factor;
    let low_pass = low_pass(factor);
    let for_held = for_held(&low_pass, factor);
    let filtered = |signal: &[f64], taps: &[f64]| -> Vec<f64> {
        signal.windows(taps.len()).map(|w| w.iter().zip(taps).map(|(v, tap)| v * tap).sum::<f64>()).collect()
    };
    let held = |signal: &[f64]| -> Vec<f64> {
        let filtered = filtered(signal, &for_held);
        filtered.chunks_exact(factor).map(|hold| hold.iter().sum::<f64>() / factor as f64).collect()
    };
    let thinned = |segment: &Segment| {
        let first = segment.first.div_ceil(factor);
        let skip = first * factor - segment.first;
        let input = held(from(&segment.input, skip));
        let output = filtered(&without_holes(from(&segment.output, skip), factor), &low_pass);
        Segment {
            first: first + HALF_TAPS,
            start_s: segment.start_s + (skip + half) as f64 * period_s,
            output: output.into_iter().step_by(factor).take(input.len()).collect(),
            instrument: segment.instrument.as_deref().map(|signal| held(from(signal, skip))),
            by_zero: segment.by_zero.as_deref().map(|signal| held(from(signal, skip))),
            zero_drifts: segment.zero_drifts,
            by_delay: segment.by_delay.as_deref().map(|signal| held(from(signal, skip))),
            record: segment.record,
            input,
            within: None,
            from_rest: false,
        }
    };
    let segments = record.segments.iter().map(thinned).filter(|s| !s.is_empty()).collect();
    Record { name: record.name.clone(), segments }
}

/// The signal with holes of up to `most` samples filled.
fn without_holes(signal: &[f64], most: usize) -> Vec<f64> {
    let mut known: Vec<Option<f64>> = signal.iter().map(|v| (!v.is_nan()).then_some(*v)).collect();
    fill(&mut known, most);
    known.into_iter().map(|v| v.unwrap_or(f64::NAN)).collect()
}

/// The filter before every `factor`-th sample is taken, from its first tap to its last.
fn low_pass(factor: usize) -> Vec<f64> {
    let half = HALF_TAPS * factor;
    let corner = CORNER / factor as f64;
    let tap = |k: usize| {
        let x = k as f64 - half as f64;
        let sinc = if x == 0.0 { corner } else { (PI * corner * x).sin() / (PI * x) };
        sinc * (0.54 + 0.46 * (PI * x / half as f64).cos())
    };
    of_sum_1((0..=2 * half).map(tap).collect())
}

/// The filter, as long as `low_pass`, that comes nearest to its response over D(f)²: the inverse Fourier transform up
/// to where it lets nothing through, cut at both ends. That leaves 0.15 % up to the frequency where half passes.
fn for_held(low_pass: &[f64], factor: usize) -> Vec<f64> {
    let half = HALF_TAPS * factor;
    let step = (PASSES / factor as f64).min(0.5) / INTEGRATED as f64;
    // Cycles per sample.
    let at = |k: usize| (k as f64 + 0.5) * step;
    let cosine = |f: f64, k: usize| (2.0 * PI * f * (k as f64 - half as f64)).cos();
    let wanted: Vec<(f64, f64)> = (0..INTEGRATED)
        .map(|k| {
            let f = at(k);
            let passed: f64 = low_pass.iter().enumerate().map(|(k, tap)| tap * cosine(f, k)).sum();
            let averaged = (PI * factor as f64 * f).sin() / (factor as f64 * (PI * f).sin());
            (f, passed / averaged.powi(2))
        })
        .collect();
    of_sum_1((0..low_pass.len()).map(|k| wanted.iter().map(|(f, gain)| gain * cosine(*f, k)).sum()).collect())
}

/// The same, letting a constant through unchanged.
fn of_sum_1(mut taps: Vec<f64>) -> Vec<f64> {
    let sum: f64 = taps.iter().sum();
    taps.iter_mut().for_each(|tap| *tap /= sum);
    taps
}

/// The signal without its first samples.
fn from(signal: &[f64], skip: usize) -> &[f64] {
    signal.get(skip..).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn segment(of: impl Fn(f64) -> f64) -> Segment {
        let signal: Vec<f64> = (0..400).map(|k| of(f64::from(k) * 0.1)).collect();
        Segment { input: signal.clone(), output: signal, from_rest: true, ..Segment::default() }
    }

    #[test]
    fn a_missing_frame_costs_no_sample_of_the_result() {
        let of = |t: f64| (1.5 * t).sin();
        let thin = |missing: &dyn Fn(usize) -> bool| {
            let mut s = segment(of);
            s.output.iter_mut().enumerate().filter(|(k, _)| missing(*k)).for_each(|(_, y)| *y = f64::NAN);
            decimate(&Record { name: "w".into(), segments: vec![s] }, 4, 0.1).segments.remove(0).output
        };
        let (whole, holes) = (thin(&|_| false), thin(&|k| k % 30 == 7 || k % 90 == 50 || k % 90 == 51));
        assert!(whole.iter().zip(&holes).all(|(a, b)| (a - b).abs() < 2e-4), "{whole:?} {holes:?}");
        let long = thin(&|k| (100..110).contains(&k));
        assert_eq!(long.iter().filter(|y| y.is_nan()).count(), 13, "its filter has 41 taps");
    }

    #[test]
    fn a_line_is_taken_off_whole() {
        let mut s = segment(|t| 3.0 - 0.5 * t);
        let trend = Trend::of(&[s.clone()], 0.1, true);
        assert!((trend.output.slope + 0.5).abs() < 1e-12);
        trend.remove(&mut s, 0.1);
        assert!(s.output.iter().all(|v| v.abs() < 1e-12));
        let mut s = segment(|t| 3.0 - 0.5 * t);
        Trend::of(&[s.clone()], 0.1, false).remove(&mut s, 0.1);
        assert!(s.output.iter().sum::<f64>().abs() < 1e-9 && s.output[0] > 1.0);
    }

    #[test]
    fn slow_waves_pass_decimation_and_fast_ones_do_not() {
        // 10 Hz to 2.5 Hz: Nyquist at 1.25 Hz.
        let wave = |f: f64| Record { name: "w".into(), segments: vec![segment(move |t| (2.0 * PI * f * t).sin())] };
        let slow = decimate(&wave(0.3), 4, 0.1);
        let s = &slow.segments[0];
        let at = |t: f64| (2.0 * PI * 0.3 * t).sin();
        let time = |k: usize| s.start_s + k as f64 * 0.4;
        assert!(s.output.iter().enumerate().all(|(k, v)| (v - at(time(k))).abs() < 0.01));
        // Averaged over four samples from there: the centre is 0.15 s later. Larger by 1/D, D = 0.979.
        assert!(s.input.iter().enumerate().all(|(k, v)| (v - at(time(k) + 0.15) / 0.9789).abs() < 0.01));
        assert_eq!((s.len(), s.input.len()), ((400 - 40) / 4, s.output.len()));
        let fast = decimate(&wave(2.0), 4, 0.1);
        assert!(fast.segments[0].output.iter().all(|v| v.abs() < 0.01));
    }

    /// A wave that is held for a sample, and its response, make the same model as one that is held for `factor`.
    #[test]
    fn a_decimated_input_moves_the_output_as_held_for_the_new_period() {
        for factor in [1, 2, 3, 6] {
            let n = 400 * factor;
            for of_rate in [0.02, 0.1, 0.2, 0.3, 0.4] {
                let f = of_rate / factor as f64;
                let wave = |k: usize, late: f64| (2.0 * PI * f * (k as f64 - late)).sin();
                // An output that is the input itself, held: sinc(f T), half a sample late.
                let passed = (PI * f).sin() / (PI * f);
                let segment = Segment {
                    input: (0..n).map(|k| wave(k, 0.0)).collect(),
                    output: (0..n).map(|k| passed * wave(k, 0.5)).collect(),
                    ..Segment::default()
                };
                let thin = decimate(&Record { name: "w".into(), segments: vec![segment] }, factor, 1.0);
                let thin = &thin.segments[0];
                let amplitude = |signal: &[f64]| {
                    let turned =
                        |(k, v): (usize, &f64)| nalgebra::Complex::from_polar(*v, -2.0 * PI * of_rate * k as f64);
                    signal.iter().take(200).enumerate().map(turned).sum::<nalgebra::Complex<f64>>()
                };
                let gain = amplitude(&thin.output) / amplitude(&thin.input);
                // Held for the new period.
                let held = nalgebra::Complex::from_polar((PI * of_rate).sin() / (PI * of_rate), -PI * of_rate);
                assert!((gain / held - 1.0).norm() < 2e-3, "{factor}, {of_rate}: {}", gain / held);
            }
        }
    }

    /// A hole of any length leaves what follows at its time, counted in whole samples of the result.
    #[test]
    fn decimated_segments_stay_on_one_grid() {
        let wave = segment(|t| (2.0 * PI * 0.3 * t).sin());
        for hole in 0..4 {
            let from = 100 + hole;
            let parts = vec![wave.part(0, 100, 0.1), wave.part(from, 400, 0.1)];
            let thin = decimate(&Record { name: "w".into(), segments: parts }, 4, 0.1);
            for s in &thin.segments {
                assert!((s.start_s - s.first as f64 * 0.4).abs() < 1e-9, "{hole}: {} at {} s", s.first, s.start_s);
                let at = |k: usize| (2.0 * PI * 0.3 * (s.start_s + k as f64 * 0.4)).sin();
                assert!(s.output.iter().enumerate().all(|(k, v)| (v - at(k)).abs() < 0.01), "{hole}");
            }
        }
    }
}
