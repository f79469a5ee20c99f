//! How much later the output is than the commands say: the constant between two clocks, the amplifier's, and the
//! plant's together.
//!
//! Delays are tried; for each a model of second order is fitted by output error, and the delay of the smallest residual
//! is told. Nothing can tell a delay of the clocks from one of the system: it is shown, and taken out only when the
//! user says so. Delays of parts of a period are told apart by their shape only and are less sure than σ says when the
//! system is not of second order.

use super::data::Segment;
use super::initial::initial_models;
use super::model::{Orders, Polynomials};
use super::output_error;

/// The model that is tried.
const ORDERS: Orders = Orders { na: 2, nb: 2, nk: 1 };
/// Trials go so far, in periods, and in such steps.
const REACH: f64 = 6.0;
const STEP: f64 = 1.0;
/// The smallest residual is looked for to this part of a period.
const SETTLED: f64 = 0.002;
/// Steps away from it grow by this factor.
const FURTHER: f64 = 1.3;

/// A delay between commands and output.
#[derive(Debug, Clone, PartialEq)]
pub struct Delay {
    /// Seconds; positive when the output is late.
    pub delay_s: f64,
    /// Its standard error, from where the residual begins to rise, seconds.
    pub sd_s: f64,
    /// What was tried: seconds, and root mean square of the residual.
    pub tried: Vec<(f64, f64)>,
}

/// Tries delays around none. `segments` gives the data with commands that act so much later. Nothing when the model
/// fits none, or best at the end of the trials.
pub fn estimate(period_s: f64, segments: impl Fn(f64) -> Option<Vec<Segment>>) -> Option<Delay> {
    // 1. the smallest on the coarse trials, which must have neighbours
    let steps = (REACH / STEP) as i32;
    let mut models: Vec<(f64, f64, Polynomials)> = Vec::new();
    for k in -steps..=steps {
        let delay_s = f64::from(k) * STEP * period_s;
        let near = models.last().map(|(_, _, model)| model);
        if let Some((rms, model)) = segments(delay_s).and_then(|s| residual(&s, near)) {
            models.push((delay_s, rms, model));
        }
    }
    let best = (0..models.len()).min_by(|i, j| models[*i].1.total_cmp(&models[*j].1))?;
    // 2. around it in ever smaller steps: the residual may have a narrow dip in a wide one, where a state that models
    //    delay becomes free to model the system
    let &(mut delay_s, _, ref near) = models.get(best).filter(|_| best > 0 && best + 1 < models.len())?;
    let square = |delay_s: f64| Some(residual(&segments(delay_s)?, Some(near))?.0.powi(2));
    let (mut least, mut step) = (square(delay_s)?, 0.5 * STEP * period_s);
    while step > SETTLED * period_s {
        let mut moved = false;
        for to in [delay_s - step, delay_s + step] {
            let there = square(to)?;
            if there < least {
                (delay_s, least, moved) = (to, there, true);
            }
        }
        if !moved {
            step *= 0.5;
        }
    }
    let tried = models.iter().map(|(delay_s, rms, _)| (*delay_s, *rms)).collect();
    // 3. how far to go until the sum of squares has grown by one variance, on average over both sides
    let samples: usize = segments(delay_s)?.iter().map(Segment::observed).sum();
    let risen = least / samples as f64;
    let reach = |sign: f64| {
        let mut step = SETTLED * period_s;
        while square(delay_s + sign * step)? - least < risen {
            step *= FURTHER;
            if step > REACH * period_s {
                return None;
            }
        }
        Some(step)
    };
    Some(Delay { delay_s, sd_s: 0.5 * (reach(1.0)? + reach(-1.0)?), tried })
}

/// Root mean square that the model of second order leaves, from its usual starts or from the model of the trial before.
fn residual(segments: &[Segment], near: Option<&Polynomials>) -> Option<(f64, Polynomials)> {
    let mut initial = initial_models(segments, ORDERS);
    initial.extend(near.cloned());
    let found = output_error::refine_from_any(segments, &initial).ok()?.estimated;
    Some((found.noise_variance.sqrt(), found.model))
}

#[cfg(test)]
mod tests {
    use super::super::hold::Held;
    use super::super::tests::noise;
    use super::*;
    use std::f64::consts::TAU;

    #[test]
    fn a_delay_is_found_to_a_fraction_of_a_period() {
        let period_s = 1.0 / 60.0;
        let plant = Polynomials { a: vec![1.0, -1.9, 0.91], b: vec![0.02, 0.01], nk: 1 };
        // A chirp commanded at 60 Hz; the system hears it 23 ms later, at frames that are not the amplifier's.
        let chirp = |k: usize| {
            let t = k as f64 * period_s;
            (TAU * (0.5 * t + 7.5 * t * t / 120.0)).sin()
        };
        let held = Held::new((0..3700).map(|k| (k as f64 * period_s, chirp(k))).collect());
        let drive = |delay_s: f64| -> Vec<f64> {
            let at = |k: usize| 1.0 + k as f64 * period_s - delay_s;
            (0..3500).filter_map(|k| held.mean(at(k), at(k + 1))).collect()
        };
        let output: Vec<f64> =
            plant.simulate(&drive(0.023)).iter().zip(noise(1, 3500)).map(|(y, e)| y + 0.003 * e).collect();
        let found = estimate(period_s, |delay_s| {
            Some(vec![Segment { input: drive(delay_s), output: output.clone(), ..Segment::default() }])
        })
        .unwrap();
        assert!((found.delay_s - 0.023).abs() < 3.0 * found.sd_s && found.sd_s < 2e-3, "{found:?}");
    }
}
