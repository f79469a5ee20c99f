//! Preparation of the signals: detrending and decimation.

use super::data::{Record, Segment};
use std::f64::consts::PI;

/// Half length of the anti-aliasing filter, in samples of the result.
const HALF_TAPS: usize = 5;
/// Its cutoff, as a fraction of the new Nyquist frequency.
const CORNER: f64 = 0.8;

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
    fn at(&self, t: f64) -> f64 {
        self.offset + self.slope * (t - self.about_s)
    }
}

/// What was removed from one record's input and output.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct Trend {
    /// From the input.
    pub input: Line,
    /// From the output.
    pub output: Line,
}

impl Trend {
    /// The trend of one record's segments, or of several records' without `slope`.
    pub(crate) fn of(segments: &[Segment], period_s: f64, slope: bool) -> Self {
        let line = |signal: fn(&Segment) -> &[f64]| {
            let points = || {
                segments.iter().flat_map(move |s| {
                    let timed = signal(s).iter().enumerate().map(move |(k, v)| (s.start_s + k as f64 * period_s, *v));
                    timed.filter(|(_, v)| !v.is_nan())
                })
            };
            let n = points().count().max(1) as f64;
            let about_s = points().map(|(t, _)| t).sum::<f64>() / n;
            let offset = points().map(|(_, v)| v).sum::<f64>() / n;
            let spread = points().map(|(t, _)| (t - about_s).powi(2)).sum::<f64>();
            let slope = if slope && spread > 0.0 {
                points().map(|(t, v)| (t - about_s) * v).sum::<f64>() / spread
            } else {
                0.0
            };
            Line { offset, slope, about_s }
        };
        Self { input: line(|s| &s.input), output: line(|s| &s.output) }
    }

    /// Removes it.
    pub(crate) fn remove(&self, segment: &mut Segment, period_s: f64) {
        let start_s = segment.start_s;
        let off = |signal: &mut [f64], line: Line| {
            signal.iter_mut().enumerate().for_each(|(k, v)| *v -= line.at(start_s + k as f64 * period_s));
        };
        off(&mut segment.input, self.input);
        off(&mut segment.output, self.output);
        // What remains of the zero is an offset of the output alone.
        segment.by_zero.iter_mut().flatten().for_each(|by_zero| *by_zero = 0.0);
    }
}

/// Every `factor`-th sample after a low-pass filter (windowed sinc, Hamming, zero phase), the same for all signals, so
/// that their relation is unchanged. The input, which is held from sample to sample, is averaged over the new, longer
/// hold. Five samples of the result are lost at both ends of every segment. All segments keep to one grid: that of
/// every `factor`-th place of the record's.
pub(crate) fn decimate(record: &Record, factor: usize, period_s: f64) -> Record {
    let half = HALF_TAPS * factor;
    let corner = CORNER / factor as f64;
    let tap = |k: usize| {
        let x = k as f64 - half as f64;
        let sinc = if x == 0.0 { corner } else { (PI * corner * x).sin() / (PI * x) };
        sinc * (0.54 + 0.46 * (PI * x / half as f64).cos())
    };
    let taps: Vec<f64> = (0..=2 * half).map(tap).collect();
    let sum: f64 = taps.iter().sum();
    let filtered = |signal: &[f64]| -> Vec<f64> {
        signal.windows(taps.len()).map(|w| w.iter().zip(&taps).map(|(v, tap)| v * tap).sum::<f64>() / sum).collect()
    };
    let held = |signal: &[f64]| -> Vec<f64> {
        filtered(signal).chunks_exact(factor).map(|hold| hold.iter().sum::<f64>() / factor as f64).collect()
    };
    let thinned = |segment: &Segment| {
        let first = segment.first.div_ceil(factor);
        let skip = first * factor - segment.first;
        let input = held(from(&segment.input, skip));
        Segment {
            first: first + HALF_TAPS,
            start_s: segment.start_s + (skip + half) as f64 * period_s,
            output: filtered(from(&segment.output, skip)).into_iter().step_by(factor).take(input.len()).collect(),
            instrument: segment.instrument.as_deref().map(|signal| held(from(signal, skip))),
            by_zero: segment.by_zero.as_deref().map(|signal| held(from(signal, skip))),
            record: segment.record,
            input,
            from_rest: false,
        }
    };
    let segments = record.segments.iter().map(thinned).filter(|s| !s.is_empty()).collect();
    Record { name: record.name.clone(), segments }
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
        // Averaged over four samples from there: the centre is 0.15 s later.
        assert!(s.input.iter().enumerate().all(|(k, v)| (v - at(time(k) + 0.15)).abs() < 0.03));
        assert_eq!((s.len(), s.input.len()), ((400 - 40) / 4, s.output.len()));
        let fast = decimate(&wave(2.0), 4, 0.1);
        assert!(fast.segments[0].output.iter().all(|v| v.abs() < 0.01));
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
