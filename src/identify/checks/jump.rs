//! An output that lies elsewhere from some moment on: the camera, the mirror or the base moved, or a zero was set anew.
//!
//! The model takes the difference for its own slow response, and its constant term is the mean of both. Method: the
//! residual of the simulation is divided in two where the means of the parts differ most.

use crate::identify::data::segments::{Record, Segment};
use crate::identify::model::polynomials::Polynomials;
use crate::identify::model::reproduction::{InitialState, Kind, output};
use std::fmt;

/// Part of the residual's variance that the two means must explain. Measured: up to 0.4 in records without a jump,
/// whose slowest response is not modelled well.
const MIN_EXPLAINED: f64 = 0.7;
/// Difference of the means over the standard deviation of the output, below which it hardly matters.
const MIN_PART: f64 = 0.05;
/// Samples, as part of all, that either side must have.
const MIN_SIDE: f64 = 0.05;
/// Fewest samples: what a model leaves of fewer is one slow swing, which looks like a jump, or another gain.
const MIN_SAMPLES: usize = 100;

/// Where a record's output begins to lie elsewhere.
#[derive(Debug, Clone, PartialEq)]
pub struct Jump {
    /// Time of the first sample there, seconds.
    pub time_s: f64,
    /// By how much, unit of the output.
    pub by: f64,
}

impl fmt::Display for Jump {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { time_s, by } = self;
        write!(
            f,
            "from {time_s:.2} s on the output lies {by:+.3} from where it was before, compared with the model: did the \
             camera, the mirror or the base move, or does the output drift? The constant term is wrong by a part of it"
        )
    }
}

/// An observed output.
pub(super) struct Sample {
    /// Its time, seconds.
    pub(super) time_s: f64,
    /// Its value.
    pub(super) observed: f64,
    /// What the model says.
    pub(super) modelled: f64,
}

/// The observed outputs of a record beside those that `model` simulates; `None` if they are too few to be divided.
pub(super) fn simulated(model: &Polynomials, record: &Record, period_s: f64) -> Option<Vec<Sample>> {
    let of_segment = |segment: &Segment| {
        let modelled = output(model, segment, Kind::Simulation(InitialState::Rest));
        let pairs = segment.output.iter().zip(modelled).enumerate();
        let samples = pairs.map(|(t, (observed, modelled))| Sample {
            time_s: segment.start_s + t as f64 * period_s,
            observed: *observed,
            modelled,
        });
        samples.filter(|s| (s.observed - s.modelled).is_finite()).collect::<Vec<_>>()
    };
    let samples: Vec<Sample> = record.segments.iter().flat_map(of_segment).collect();
    (samples.len() >= MIN_SAMPLES).then_some(samples)
}

/// Where the output of a record jumps, as `model` tells; `None` where it does not.
pub(super) fn jump(model: &Polynomials, record: &Record, period_s: f64) -> Option<Jump> {
    let samples = simulated(model, record, period_s)?;
    let left: Vec<f64> = samples.iter().map(|s| s.observed - s.modelled).collect();
    let outputs: Vec<f64> = samples.iter().map(|s| s.observed).collect();
    let count = left.len();
    let (mean, squares) = moments(&left);
    let side = (MIN_SIDE * count as f64) as usize;
    let mut before = 0.0;
    let mut best: Option<(f64, usize, f64)> = None;
    for (k, value) in left.iter().enumerate().take(count - side) {
        if k >= side {
            // Means of the parts before k and from k on, and the sum of squares that they explain.
            let (n, rest) = (k as f64, (count - k) as f64);
            let by = (mean * count as f64 - before) / rest - before / n;
            let explained = by * by * n * rest / count as f64;
            if best.is_none_or(|best| explained > best.0) {
                best = Some((explained, k, by));
            }
        }
        before += value;
    }
    let (explained, k, by) = best?;
    let output_sd = (moments(&outputs).1 / count as f64).sqrt();
    let jumps = explained > MIN_EXPLAINED * squares && by.abs() > MIN_PART * output_sd;
    jumps.then(|| Jump { time_s: samples[k].time_s, by })
}

/// Mean, and sum of squares about it.
fn moments(values: &[f64]) -> (f64, f64) {
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    (mean, values.iter().map(|value| (value - mean).powi(2)).sum())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::identify::tests::noise;

    fn found(spoil: impl Fn(usize, f64) -> f64) -> Option<Jump> {
        let model = Polynomials { a: vec![1.0, -0.9], b: vec![0.1], nk: 1 };
        let input: Vec<f64> = (0..2000).map(|t| (f64::from(t) * 0.02).sin()).collect();
        let noisy = model.simulate(&input).into_iter().zip(noise(1, 2000)).map(|(y, e)| y + 0.02 * e);
        let output = noisy.enumerate().map(|(t, y)| spoil(t, y)).collect();
        let segment = Segment { input, output, from_rest: true, start_s: 1.0, ..Segment::default() };
        jump(&model, &Record { name: "r".to_owned(), segments: vec![segment] }, 0.01)
    }

    #[test]
    fn a_lasting_change_is_found_where_it_begins() {
        let found = found(|t, y| if t < 700 { y } else { y - 0.1 }).unwrap();
        assert!((found.time_s - 8.0).abs() < 0.05 && (found.by + 0.1).abs() < 0.01, "{found:?}");
    }

    #[test]
    fn noise_another_gain_an_outlier_and_a_tiny_change_are_none() {
        assert_eq!(found(|_, y| y), None);
        assert_eq!(found(|_, y| 1.3 * y), None);
        assert_eq!(found(|t, y| if t == 900 { 99.0 } else { y }), None);
        assert_eq!(found(|t, y| if t < 700 { y } else { y + 0.01 }), None);
        assert_eq!(found(|t, y| if t < 700 { y } else { y + 0.1 }).map(|jump| jump.by > 0.0), Some(true));
    }
}
