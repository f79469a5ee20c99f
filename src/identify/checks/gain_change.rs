//! An output that is larger or smaller by a factor from some moment on: other units, another range of sensor or
//! amplifier.
//!
//! The model takes the mean of both. Method: a factor of the simulated output is fitted to what comes before and after
//! a moment, where the two explain most of what one factor leaves: a model that describes nothing has one near zero.

use super::jump::{Sample, simulated};
use crate::identify::data::segments::Record;
use crate::identify::model::polynomials::Polynomials;
use std::fmt;

/// Part of the energy left by one factor that the two must explain. What the model lacks is out of phase with it, or
/// does not last.
const MIN_EXPLAINED: f64 = 0.5;
/// Change of the factor, as a part of the larger one, below which it hardly matters.
const MIN_CHANGE: f64 = 0.02;
/// Energy of the simulated output, as a part of all, that either side must have.
const MIN_SIDE: f64 = 0.05;

/// Part of the samples that either side must have: where a model does not describe the record, the first few fit by any
/// factor.
const MIN_SAMPLES: f64 = 0.05;

/// Where a record's output begins to be larger or smaller.
#[derive(Debug, Clone, PartialEq)]
pub struct GainChange {
    /// Time of the first sample there, seconds.
    pub time_s: f64,
    /// The factor from there on, over that before.
    pub factor: f64,
}

impl fmt::Display for GainChange {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { time_s, factor } = self;
        write!(
            f,
            "from {time_s:.2} s on the output is {factor:.3} times what it was before, compared with the model: other \
             units, or another range of sensor or amplifier? Identify the parts one by one (--train)"
        )
    }
}

/// Where the gain of a record changes, as `model` tells; `None` where it does not.
pub(super) fn gain_change(model: &Polynomials, record: &Record, period_s: f64) -> Option<GainChange> {
    let samples = simulated(model, record, period_s)?;
    let observed: f64 = samples.iter().map(|s| s.observed.powi(2)).sum();
    // Of the observed on the modelled: sums of m m and y m.
    let sums = |(mm, ym): (f64, f64), s: &Sample| (mm + s.modelled * s.modelled, ym + s.observed * s.modelled);
    let (all, both) = samples.iter().fold((0.0, 0.0), sums);
    let (mut before, mut with) = (0.0, 0.0);
    let mut best: Option<(f64, GainChange)> = None;
    let least = (MIN_SAMPLES * samples.len() as f64) as usize;
    for (k, sample) in samples.iter().enumerate() {
        let after = all - before;
        let is_part = k.min(samples.len() - k) >= least;
        if is_part && before.min(after) > MIN_SIDE * all {
            let (first, second) = (with / before, (both - with) / after);
            // More than one factor does.
            let explained = with * first + (both - with) * second - both * both / all;
            let change = (second - first).abs() / first.abs().max(second.abs());
            if change > MIN_CHANGE && best.as_ref().is_none_or(|(most, _)| explained > *most) {
                best = Some((explained, GainChange { time_s: sample.time_s, factor: second / first }));
            }
        }
        (before, with) = sums((before, with), sample);
    }
    let left = observed - both * both / all;
    best.filter(|(explained, _)| *explained > MIN_EXPLAINED * left).map(|(_, change)| change)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::identify::data::segments::Segment;
    use crate::identify::tests::noise;

    fn found(real: &Polynomials, spoil: impl Fn(usize, f64) -> f64) -> Option<GainChange> {
        let model = Polynomials { a: vec![1.0, -0.9], b: vec![0.1], nk: 1 };
        // A chirp, as records mostly are.
        let input: Vec<f64> = (0..2000).map(|t| (f64::from(t) * 0.02 + 2e-5 * f64::from(t * t)).sin()).collect();
        let noisy = real.simulate(&input).into_iter().zip(noise(1, 2000)).map(|(y, e)| y + 0.02 * e);
        let output = noisy.enumerate().map(|(t, y)| spoil(t, y)).collect();
        let segment = Segment { input, output, from_rest: true, start_s: 1.0, ..Segment::default() };
        gain_change(&model, &Record { name: "r".to_owned(), segments: vec![segment] }, 0.01)
    }

    #[test]
    fn a_factor_is_found_where_it_begins() {
        let real = Polynomials { a: vec![1.0, -0.9], b: vec![0.1], nk: 1 };
        // The model fits the mean of both.
        for (before, after) in [(0.9, 1.1), (1.2, 0.8), (57.3, 1.0)] {
            let found = found(&real, |t, y| if t < 700 { before * y } else { after * y }).unwrap();
            assert!((found.time_s - 8.0).abs() < 0.3, "{found:?}");
            assert!((found.factor * before / after - 1.0).abs() < 0.02, "{found:?}");
        }
    }

    #[test]
    fn noise_a_poor_model_and_an_offset_are_none() {
        let real = Polynomials { a: vec![1.0, -0.9], b: vec![0.1], nk: 1 };
        assert_eq!(found(&real, |_, y| y), None);
        assert_eq!(found(&real, |_, y| 1.3 * y), None);
        // The model simulates 300 times too much, of which the best factor leaves nothing.
        assert_eq!(found(&Polynomials { b: vec![3e-4], ..real.clone() }, |t, y| y + (0.9 * t as f64).sin()), None);
        assert_eq!(found(&real, |t, y| if t < 700 { y } else { y + 0.3 }), None);
        assert_eq!(found(&Polynomials { nk: 3, ..real.clone() }, |_, y| y), None);
        // Another time constant, with the same gain at rest.
        assert_eq!(found(&Polynomials { a: vec![1.0, -0.93], b: vec![0.07], nk: 1 }, |_, y| y), None);
    }
}
