//! A gain that drifts in the course of a record: a coil or an amplifier that warms up.
//!
//! The model has the mean gain, and σ says nothing of the drift. Method: a factor that grows with time is tested for
//! in what the model leaves of its simulation (a score test, as in follows_input.rs), after what a model of higher
//! order has besides: where the frequency of the input changes with time, an error of the response would look like it.
//!
//! Cannot tell: of Eq. 6, whose input has the output's noise in it.

use super::follows_input::{FURTHER, colour, of_higher_order};
use super::whitened_simulation::Whitened;
use crate::identify::data::segments::{Record, Segment};
use crate::identify::model::polynomials::Polynomials;
use nalgebra::{DMatrix, DVector};
use std::fmt;

/// What noise explains in all but one of 10⁵ records, of one degree of freedom.
const LIMIT: f64 = 19.5;
/// Least drift over a record that is told.
const LEAST: f64 = 0.005;

/// How the gain of a record drifts.
#[derive(Debug, Clone, PartialEq)]
pub struct GainDrift {
    /// Its change from the first to the last sample, as a part of the mean.
    pub change: f64,
    /// Its size over its σ.
    pub sigmas: f64,
}

impl fmt::Display for GainDrift {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { change, sigmas } = self;
        write!(
            f,
            "the gain {} by {:.1} % in the course of the record ({sigmas:.0} σ): does a coil or the amplifier warm \
             up? The model has the mean; identify parts of it (--train) to see how it changes",
            if *change < 0.0 { "falls" } else { "grows" },
            100.0 * change.abs()
        )
    }
}

/// How the gain of a record drifts, as its `model` tells; `None` where it does not.
pub(super) fn gain_drift(model: &Polynomials, record: &Record) -> Option<GainDrift> {
    if record.segments.iter().any(|segment| segment.instrument.is_some()) {
        return None;
    }
    let colour = colour(&record.segments, model)?;
    let span = record.span().max(1) as f64;
    let columns = |segment: &Segment| {
        let modelled = model.simulate(&segment.input);
        // From −½ to ½.
        let time = |t: usize| (segment.first + t) as f64 / span - 0.5;
        let drifting = modelled.iter().enumerate().map(|(t, y)| time(t) * y).take(segment.len());
        let mut columns = of_higher_order(segment, model, 0).insert_column(FURTHER, 0.0);
        columns.set_column(FURTHER, &DVector::from_iterator(segment.len(), drifting));
        columns
    };
    let further: Vec<DMatrix<f64>> = record.segments.iter().map(columns).collect();
    let whitened = Whitened::of(&record.segments, model, &further, &colour)?;
    let at = model.parameters().len() + FURTHER;
    let (change, square) = (whitened.last_coefficient()?, whitened.explained_by(at..at + 1));
    (square > LIMIT && change.abs() > LEAST).then(|| GainDrift { change, sigmas: square.sqrt() })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::identify::estimate::output_error::refine;
    use crate::identify::tests::noise;

    /// Found in a record of this gain over time (0 to 1), with noise of this size, by the model fitted to it.
    fn found(seed: u64, gain: impl Fn(f64) -> f64, sd: f64) -> Option<GainDrift> {
        const SAMPLES: usize = 3000;
        let real = Polynomials { a: vec![1.0, -1.890_75, 0.904_38], b: vec![0.006_93, 0.006_7], nk: 1 };
        let input: Vec<f64> = noise(seed + 50, SAMPLES / 5).iter().flat_map(|e| [e.signum(); 5]).collect();
        let drive: Vec<f64> = input.iter().enumerate().map(|(t, u)| u * gain(t as f64 / SAMPLES as f64)).collect();
        let output = real.simulate(&drive).iter().zip(noise(seed, SAMPLES)).map(|(y, e)| y + sd * e).collect();
        let segment = Segment { input, output, from_rest: true, ..Segment::default() };
        let model = refine(std::slice::from_ref(&segment), &real).unwrap().estimated.model;
        gain_drift(&model, &Record { name: "r".to_owned(), segments: vec![segment] })
    }

    #[test]
    fn a_gain_that_falls_or_settles_is_told_with_its_size() {
        for (change, sd) in [(-0.1, 0.02), (-0.03, 0.02), (0.2, 0.1)] {
            let found = found(1, |t| 1.0 + change * t, sd).unwrap();
            assert!((found.change / change - 1.0).abs() < 0.2, "{change}: {found:?}");
        }
        let settling = found(2, |t| 1.0 - 0.1 * (1.0 - (-2.0 * t).exp()), 0.02).unwrap();
        assert!((-0.1..-0.05).contains(&settling.change), "{settling:?}");
    }

    #[test]
    fn noise_alone_is_none() {
        for seed in 0..40 {
            assert_eq!(found(seed, |_| 1.0, 0.05), None, "{seed}");
        }
    }
}
