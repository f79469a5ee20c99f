//! An input or output that was recorded as one value for a while, while the real one went on: a sensor or a logger that
//! hung.
//!
//! Two things together say so: the value is repeated far longer than usual in this record, and meanwhile the output
//! does what the model does not explain. Inputs that are held on purpose, outputs at rest, and coarse steps at the
//! crest of a slow wave, have at most the first.

use crate::identify::data::segments::{Record, Segment};
use crate::identify::estimate::noise_colour::Colour;
use crate::identify::model::polynomials::Polynomials;
use crate::identify::model::reproduction::left;
use std::fmt;
use std::ops::Range;

/// A run is long when it has this many samples, and is as much longer than most.
const LONG: usize = 20;
const TIMES_USUAL: usize = 20;
/// Most runs that are examined, the longest first.
const MOST_RUNS: usize = 10;
/// Part of the runs that are no longer than the usual one.
const USUAL_PART: f64 = 0.9;
/// How much larger than elsewhere the residual must be, in mean squares.
const LARGER: f64 = 4.0;
/// Normal quantile of the chance that noise is, one in 100,000.
const BY_CHANCE: f64 = 4.26;

/// Which of a record's signals.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Signal {
    /// What moved it.
    Input,
    /// How it moved.
    Output,
}

impl Signal {
    fn in_segment(self, segment: &Segment) -> &[f64] {
        match self {
            Self::Input => &segment.input,
            Self::Output => &segment.output,
        }
    }
}

/// A run of one value.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Frozen {
    /// The signal.
    pub of: Signal,
    /// Time of its first sample, seconds.
    pub from_s: f64,
    /// Samples.
    pub samples: usize,
    /// The value, unit of the signal.
    pub value: f64,
    /// RMS of the residual meanwhile over that elsewhere.
    pub ratio: f64,
}

impl fmt::Display for Frozen {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { of, from_s, samples, value, ratio } = self;
        let of = match of {
            Signal::Input => "input",
            Signal::Output => "output",
        };
        write!(
            f,
            "the {of} is {value:.6} for {samples} samples from {from_s:.3} s on, far longer than usual, and the error \
             of the model is {ratio:.1} times as large meanwhile: did its sensor or the logging hang? Leave this part \
             out"
        )
    }
}

/// The longest run of a record that is no sound signal's.
pub(super) fn frozen(model: &Polynomials, record: &Record, period_s: f64, of: Signal) -> Option<Frozen> {
    let mut runs = runs(record, of);
    runs.sort_by_key(|run| run.samples.len());
    let usual = runs.get((USUAL_PART * runs.len().checked_sub(1)? as f64) as usize)?.samples.len();
    let long = runs.into_iter().rev().take_while(|run| run.samples.len() >= LONG.max(TIMES_USUAL * usual));
    let left: Vec<Vec<f64>> = record.segments.iter().map(|segment| left(model, segment)).collect();
    // At rest a signal keeps its value longest, and hangs later.
    long.take(MOST_RUNS).find_map(|Run { segment: k, samples }| {
        let ratio = larger_meanwhile(&left, k, samples.clone())?;
        let segment = record.segments.get(k)?;
        Some(Frozen {
            of,
            from_s: segment.start_s + samples.start as f64 * period_s,
            samples: samples.len(),
            value: of.in_segment(segment).get(samples.start).copied().unwrap_or(f64::NAN),
            ratio,
        })
    })
}

/// Where a signal keeps its value.
struct Run {
    segment: usize,
    samples: Range<usize>,
}

fn runs(record: &Record, of: Signal) -> Vec<Run> {
    let mut runs = Vec::new();
    for (segment, signal) in record.segments.iter().map(|segment| of.in_segment(segment)).enumerate() {
        let mut first = 0;
        for run in signal.chunk_by(|a, b| a == b) {
            runs.push(Run { segment, samples: first..first + run.len() });
            first += run.len();
        }
    }
    runs
}

/// RMS of the residual in these samples over that elsewhere, if that is more than noise does.
fn larger_meanwhile(left: &[Vec<f64>], segment: usize, samples: Range<usize>) -> Option<f64> {
    let mut elsewhere = left.to_vec();
    let meanwhile = elsewhere.get_mut(segment)?.get_mut(samples.clone())?;
    let within = meanwhile.to_vec();
    meanwhile.fill(f64::NAN);
    let mean_square = |values: &mut dyn Iterator<Item = f64>| {
        let (sum, count) = values.filter(|e| !e.is_nan()).fold((0.0, 0.0), |(sum, n), e| (sum + e * e, n + 1.0));
        sum / count
    };
    let ratio = mean_square(&mut within.iter().copied()) / mean_square(&mut elsewhere.iter().flatten().copied());
    // The ratio scatters like χ² over its degrees of freedom (Wilson and Hilferty, doi:10.1073/pnas.17.12.684).
    let free = (samples.len() as f64 / Colour::of(&elsewhere).correlated_samples().max(1.0)).max(1.0);
    let spread = 2.0 / (9.0 * free);
    let limit = (1.0 - spread + BY_CHANCE * spread.sqrt()).powi(3).max(LARGER);
    (ratio > limit).then(|| ratio.sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::identify::tests::noise;
    use std::f64::consts::TAU;

    /// A slow wave in steps of `step`, which is recorded as `recorded` says.
    fn found(step: f64, recorded: impl Fn(usize, f64) -> f64) -> Option<Frozen> {
        let model = Polynomials { a: vec![1.0, -0.9], b: vec![0.1], nk: 1 };
        let wave = |t: usize| (TAU * 0.004 * t as f64).sin() + 0.3 * (TAU * 0.05 * t as f64).sin();
        let input: Vec<f64> =
            (0..3000).map(|t| if step > 0.0 { (wave(t) / step).round() * step } else { wave(t) }).collect();
        let noisy = model.simulate(&input).into_iter().zip(noise(1, 3000)).map(|(y, e)| y + 0.02 * e);
        let output = noisy.collect();
        let input = input.iter().enumerate().map(|(t, u)| recorded(t, *u)).collect();
        let segment = Segment { input, output, from_rest: true, start_s: 1.0, ..Segment::default() };
        frozen(&model, &Record { name: "r".to_owned(), segments: vec![segment] }, 0.01, Signal::Input)
    }

    #[test]
    fn an_input_that_hung_is_told_where_it_did() {
        let hung = found(0.0, |t, u| if (1000..1100).contains(&t) { 0.7 } else { u }).unwrap();
        assert!((hung.from_s - 11.0).abs() < 1e-9 && hung.samples == 100 && hung.value == 0.7, "{hung:?}");
        assert!(hung.ratio > 5.0, "{hung:?}");
        assert!(found(0.02, |t, u| if (1000..1100).contains(&t) { 0.0 } else { u }).is_some());
    }

    #[test]
    fn a_longer_rest_does_not_hide_it() {
        let model = Polynomials { a: vec![1.0, -0.9], b: vec![0.1], nk: 1 };
        let moved = |t: usize| if t < 600 { 0.0 } else { (TAU * 0.01 * (t - 600) as f64).sin() };
        let input: Vec<f64> = (0..3000).map(moved).collect();
        let noisy = model.simulate(&input).into_iter().zip(noise(1, 3000)).map(|(y, e)| y + 0.02 * e);
        let output = noisy.collect();
        let input = input.iter().enumerate().map(|(t, u)| if (1000..1300).contains(&t) { 0.7 } else { *u }).collect();
        let segment = Segment { input, output, from_rest: true, ..Segment::default() };
        let record = Record { name: "r".to_owned(), segments: vec![segment] };
        let hung = frozen(&model, &record, 0.01, Signal::Input).unwrap();
        assert!((hung.from_s - 10.0).abs() < 1e-9 && hung.samples == 300, "{hung:?}");
    }

    /// A camera that repeats its last picture, one that shows nothing, and an output at rest.
    #[test]
    fn an_output_that_hung_is_told_and_one_at_rest_is_not() {
        let model = Polynomials { a: vec![1.0, -0.9], b: vec![0.1], nk: 1 };
        let found = |hung: Option<f64>, rest: usize, sd: f64| {
            let input: Vec<f64> =
                (0..3000).map(|t| if t < rest { 0.0 } else { (TAU * 0.01 * t as f64).sin() }).collect();
            let noisy = model.simulate(&input).into_iter().zip(noise(1, 3000)).map(|(y, e)| y + sd * e);
            let mut output: Vec<f64> = noisy.collect();
            let until = if hung.is_some() { 1300 } else { 1000 };
            let value = hung.unwrap_or(0.0);
            output[1000..until].fill(value);
            let segment = Segment { input, output, from_rest: true, ..Segment::default() };
            frozen(&model, &Record { name: "r".to_owned(), segments: vec![segment] }, 0.01, Signal::Output)
        };
        for value in [0.0, 0.8] {
            let hung = found(Some(value), 0, 0.05).unwrap();
            assert!(hung.of == Signal::Output && hung.samples >= 300 && (hung.from_s - 10.0).abs() < 0.02, "{hung:?}");
        }
        assert_eq!(found(None, 0, 0.05), None);
        assert_eq!(found(None, 500, 0.0), None);
    }

    #[test]
    fn held_and_coarse_inputs_and_rest_are_none() {
        assert_eq!(found(0.0, |_, u| u), None);
        assert_eq!(found(0.5, |_, u| u), None);
        let model = Polynomials { a: vec![1.0, -0.9], b: vec![0.1], nk: 1 };
        // At rest for long, then levels.
        for rest in [0, 500] {
            let levels = noise(3, 100);
            let input: Vec<f64> = (0..3000).map(|t| if t < rest { 0.0 } else { levels[t / 30] }).collect();
            let output = model.simulate(&input).into_iter().zip(noise(2, 3000)).map(|(y, e)| y + 0.02 * e).collect();
            let segment = Segment { input, output, from_rest: true, ..Segment::default() };
            let record = Record { name: "r".to_owned(), segments: vec![segment] };
            assert_eq!(frozen(&model, &record, 0.01, Signal::Input), None, "{rest}");
        }
    }
}
