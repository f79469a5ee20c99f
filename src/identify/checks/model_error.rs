//! What a model leaves because its order is too low.
//!
//! In: the full model and the refined one of a lower order, and the data that both were fitted to. Out: what both leave
//! of the output in simulation, if the lower order leaves clearly more. The full model tells the noise: what the other
//! leaves beyond that follows the input, and does not average out. σ of the refined model counts all of it as noise,
//! and would be too small: it is then not given.
//!
//! What it cannot detect: an error of the order that the full model has too.

use crate::identify::data::segments::Segment;
use crate::identify::estimate::estimated::Estimated;
use crate::identify::model::reproduction::{InitialState, Kind, compare};
use std::fmt;

/// Ratio of the mean squares, corrected for the number of coefficients, from which it is told. A test holds that 20
/// systems of second order, with 1000 samples each and a full model of order 8, stay below it.
const RATIO: f64 = 1.25;
/// Less than this of the output's energy is told by no one: rounding, or a record without noise.
const LEAST_PERCENT: f64 = 1e-4;

/// What two models leave of the output, % of its energy.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ModelError {
    /// The refined model.
    pub refined_percent: f64,
    /// The full one.
    pub full_percent: f64,
}

impl fmt::Display for ModelError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { refined_percent, full_percent } = self;
        write!(
            f,
            "its simulation leaves {refined_percent:.2} % of the energy, that of the full model {full_percent:.2} %: \
             most of what it leaves is not noise, but what its order cannot do. It has no σ, since its coefficients \
             are off by that, and by more than noise explains; the same is true of the reduced model. For the gain, \
             raise --reduce"
        )
    }
}

impl ModelError {
    /// `None` where the refined model leaves hardly more than the full one.
    pub(in crate::identify) fn of(
        training: &[Segment],
        full: &Estimated,
        refined: &Estimated,
        initial_state: InitialState,
    ) -> Option<Self> {
        let left = |found: &Estimated| {
            let error = compare(&found.model, training, Kind::Simulation(initial_state));
            let free = error.samples.saturating_sub(found.model.parameters().len()).max(1) as f64;
            (error.error_percent, error.error_percent * error.samples as f64 / free)
        };
        let ((refined_percent, refined), (full_percent, full)) = (left(refined), left(full));
        (refined > LEAST_PERCENT && refined > RATIO * full).then_some(Self { refined_percent, full_percent })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::identify::chain::identification::Identification;
    use crate::identify::chain::settings::Choice;
    use crate::identify::chain::steps::identify;
    use crate::identify::data::segments::{Data, Record};
    use crate::identify::model::modelled::Role;
    use crate::identify::model::polynomials::{Orders, Polynomials, all_pole};
    use crate::identify::tests::{noise, settings};
    use std::f64::consts::TAU;

    /// A chirp through `truth`, with noise of `part` of the output at the output, alike from sample to sample by `rho`.
    fn identified(truth: &Polynomials, seed: u64, part: f64, rho: f64) -> Identification {
        let chirp = |t: f64| (TAU * (0.5 + 0.2 * t) * t).sin();
        let input: Vec<f64> = (0..1000).map(|k| chirp(f64::from(k) * 0.02)).collect();
        let clean = truth.simulate(&input);
        let rms = |v: &[f64]| (v.iter().map(|v| v * v).sum::<f64>() / v.len() as f64).sqrt();
        let disturbance = all_pole(&[1.0, -rho], noise(seed, input.len()));
        let scale = part * rms(&clean) / rms(&disturbance);
        let output = clean.iter().zip(disturbance).map(|(y, e)| y + scale * e).collect();
        let segment = Segment { input, output, from_rest: true, ..Segment::default() };
        let training = vec![Record { name: "record".to_owned(), segments: vec![segment] }];
        let data = Data { training, period_s: 0.02, ..Data::default() };
        identify(&data, &settings(Choice::Fixed(Orders { na: 8, nb: 8, nk: 1 }))).unwrap()
    }

    fn second_order() -> Polynomials {
        Polynomials { a: vec![1.0, -1.887, 0.916], b: vec![0.03, 0.028], nk: 1 }
    }

    #[test]
    fn a_system_of_the_models_order_has_none() {
        for seed in 1..=20 {
            for (part, rho) in [(0.001, 0.0), (0.01, 0.0), (0.2, 0.0), (0.1, 0.9)] {
                let found = identified(&second_order(), seed, part, rho);
                assert_eq!(found.model_error, None, "{seed} {part} {rho}");
                assert!(found.model(Role::Refined).unwrap().covariance.is_some());
            }
        }
    }

    #[test]
    fn one_of_a_higher_order_is_told_and_has_no_sigma() {
        // A second resonance beside the first.
        let second = Polynomials { a: vec![1.0, -1.2, 0.9], b: vec![0.1, 0.1], nk: 1 };
        let (a, b) = (second_order(), second);
        let times = |x: &[f64], y: &[f64]| -> Vec<f64> {
            let mut product = vec![0.0; x.len() + y.len() - 1];
            x.iter().enumerate().for_each(|(i, x)| y.iter().enumerate().for_each(|(j, y)| product[i + j] += x * y));
            product
        };
        let sum = times(&a.b, &b.a).iter().zip(times(&b.b, &a.a)).map(|(x, y)| x + y).collect();
        let truth = Polynomials { a: times(&a.a, &b.a), b: sum, nk: 1 };
        for seed in 1..=5 {
            let found = identified(&truth, seed, 0.02, 0.0);
            let ModelError { refined_percent, full_percent } = found.model_error.unwrap();
            assert!(refined_percent > 3.0 * full_percent, "{refined_percent} {full_percent}");
            let refined = found.model(Role::Refined).unwrap();
            assert!(refined.covariance.is_none() && refined.bode.iter().all(|point| point.sd.is_none()));
            let told = found.diagnostics.iter().any(|d| d.to_string().contains("what its order cannot do"));
            assert!(told, "{:?}", found.diagnostics);
        }
    }
}
