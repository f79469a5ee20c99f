//! How much later the output is than the commands say: the constant between two clocks, the amplifier's, and the plant's together.
//!
//! Delays are tried; for each a model of second order is fitted by output error, and the delay of the
//! smallest residual is told. Nothing can tell a delay of the clocks from one of the system: it is shown, and taken out
//! only when the user says so. Delays of parts of a period are told apart by their shape only and are less sure than σ says when
//! the system is not of second order.

use super::arx::Orders;
use super::data::Segment;
use super::model::Polynomials;
use super::output_error;

/// The model that is tried.
const ORDERS: Orders = Orders { na: 2, nb: 2, nk: 1 };
/// Trials go so far, in periods, and in such steps.
const REACH: f64 = 6.0;
const STEP: f64 = 1.0;
/// The smallest residual is looked for to this part of a period.
const SETTLED: f64 = 0.005;
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

/// Tries delays around none. `segments` gives the data with commands that act so much later. Nothing when the model fits none, or
/// best at the end of the trials.
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
    let [before, (_, _, near), after] = models.get(best.checked_sub(1)?..best + 2)? else { return None };
    let (mut low, near, mut high) = (before.0, Some(near), after.0);
    let tried = models.iter().map(|(delay_s, rms, _)| (*delay_s, *rms)).collect();
    // 2. between them by golden section
    let ratio = (5_f64.sqrt() - 1.0) / 2.0;
    let square = |delay_s: f64| Some(residual(&segments(delay_s)?, near)?.0.powi(2));
    let (mut a, mut b) = (high - ratio * (high - low), low + ratio * (high - low));
    let (mut at_a, mut at_b) = (square(a)?, square(b)?);
    while high - low > SETTLED * period_s {
        if at_a < at_b {
            (high, b, at_b) = (b, a, at_a);
            a = high - ratio * (high - low);
            at_a = square(a)?;
        } else {
            (low, a, at_a) = (a, b, at_b);
            b = low + ratio * (high - low);
            at_b = square(b)?;
        }
    }
    // 3. how far to go until the sum of squares has grown by one variance, on average over both sides
    let delay_s = 0.5 * (low + high);
    let least = square(delay_s)?;
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
    let mut starts = output_error::usual_starts(segments, ORDERS);
    starts.extend(near.cloned());
    let found = output_error::refine_from_any(segments, &starts).ok()?.estimated;
    Some((found.noise_variance.sqrt(), found.model))
}

#[cfg(test)]
mod tests {
    use super::super::arx::tests::noise;
    use super::super::hold::Held;
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
