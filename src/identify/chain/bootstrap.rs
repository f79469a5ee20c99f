//! Scatter of a result if the experiment were repeated: residual bootstrap.
//!
//! The model's residuals are resampled in blocks, which keep their remaining correlation, and added to the model's
//! output; then everything is estimated again (Künsch, Annals of Statistics 17, 1989, doi:10.1214/aos/1176347265).
//! Inputs are unchanged, but for commands whose delay was estimated: that an input computed by Eq. 6 would also carry
//! the new noise is neglected.

use crate::identify::data::segments::Segment;
use crate::identify::estimate::noise_colour::Colour;
use crate::identify::model::polynomials::{Noise, Polynomials, all_pole};
use crate::normal::normal;
use fastrand::Rng;
use std::collections::BTreeMap;

/// Samples per block at least, and for each that are correlated; as a part of all at most.
const BLOCK: usize = 32;
const BLOCK_PER_CORRELATED: f64 = 4.0;
const LONGEST_BLOCK: usize = 8;
/// Least number of repetitions for an interval: one more value is beyond the ends of 39 in 5 % of cases.
const MIN_REPETITIONS: usize = 39;
const SEED: u64 = 0x00CA_7097;

/// Estimates `of` from `count` repetitions of the experiment. Repetitions for which `of` fails are left out.
pub(super) fn repeat<T: Send>(
    segments: &[Segment],
    model: &Polynomials,
    noise: Noise,
    count: usize,
    of: impl Fn(&[Segment]) -> Option<T> + Sync,
) -> Vec<T> {
    use rayon::prelude::*;
    let parts = segments.iter().map(|s| clean_and_residual(s, model, noise));
    let (clean, residuals): (Vec<_>, Vec<_>) = parts.unzip();
    let block = (BLOCK_PER_CORRELATED * Colour::of(&residuals).correlated_samples()).ceil() as usize;
    let repetition = |number: usize| {
        // Each has its own random numbers, independent of the thread.
        let mut rng = Rng::with_seed(SEED + number as u64);
        let drawn: Vec<Segment> = segments
            .iter()
            .zip(clean.iter().zip(&residuals))
            .map(|(s, (clean, left))| redrawn(s, clean, left, block, model, noise, &mut rng))
            .collect();
        let mut delays: BTreeMap<usize, f64> = BTreeMap::new();
        let delayed = |s: Segment| s.delayed(*delays.entry(s.record).or_insert_with(|| normal(&mut rng)));
        of(&drawn.into_iter().map(delayed).collect::<Vec<_>>())
    };
    (0..count).into_par_iter().filter_map(repetition).collect()
}

/// The model's noise-free output, and the noise.
fn clean_and_residual(segment: &Segment, model: &Polynomials, noise: Noise) -> (Vec<f64>, Vec<f64>) {
    use crate::identify::model::reproduction::{InitialState, Kind, output};
    match noise {
        Noise::Output => {
            let clean = output(model, segment, Kind::Simulation(InitialState::Rest));
            let left = segment.output.iter().zip(&clean).map(|(y, c)| y - c).filter(|e| !e.is_nan()).collect();
            (clean, left)
        }
        Noise::Equation => {
            // All of A y − B u, with the beginning unchanged, so that a segment with its own noise is reproduced.
            let from_input = moved(model, &segment.input);
            let all = from_output(model, &segment.output);
            let left = all.iter().zip(&from_input).map(|(y, u)| y - u).filter(|e| !e.is_nan()).collect();
            (from_input, left)
        }
    }
}

fn redrawn(
    segment: &Segment,
    clean: &[f64],
    left: &[f64],
    block: usize,
    model: &Polynomials,
    noise: Noise,
    rng: &mut Rng,
) -> Segment {
    let begin = if noise == Noise::Equation { model.memory().min(left.len()) } else { 0 };
    let pool = &left[begin..];
    let mut drawn = left[..begin].to_vec();
    while drawn.len() < clean.len() && !pool.is_empty() {
        let block = block.min(pool.len() / LONGEST_BLOCK).max(BLOCK).min(pool.len());
        let from = rng.usize(0..=pool.len() - block);
        drawn.extend(&pool[from..from + block]);
    }
    let sum = clean.iter().zip(&drawn).map(|(c, e)| c + e).collect();
    let mut output = if noise == Noise::Equation { all_pole(&model.a, sum) } else { sum };
    // Outputs that were not observed remain so in a repetition.
    output.iter_mut().zip(&segment.output).filter(|(_, y)| y.is_nan()).for_each(|(again, _)| *again = f64::NAN);
    output.resize(segment.len(), f64::NAN);
    Segment { output, ..segment.clone() }
}

/// B u.
fn moved(model: &Polynomials, input: &[f64]) -> Vec<f64> {
    Polynomials { a: vec![1.0], b: model.b.clone(), nk: model.nk }.simulate(input)
}

/// A y.
fn from_output(model: &Polynomials, output: &[f64]) -> Vec<f64> {
    Polynomials { a: vec![1.0], b: model.a.clone(), nk: 0 }.simulate(output)
}

/// The interval that contains one more such value with a probability of 95 %: of N, the ones at 0.025 (N + 1) and
/// 0.975 (N + 1) by size. `None` for too few.
pub(super) fn middle_95(mut values: Vec<f64>) -> Option<(f64, f64)> {
    if values.len() < MIN_REPETITIONS {
        return None;
    }
    values.sort_by(f64::total_cmp);
    let at = |part: f64| {
        let place = (part * (values.len() + 1) as f64 - 1.0).clamp(0.0, (values.len() - 1) as f64);
        let (low, rest) = (place.floor() as usize, place.fract());
        let high = (low + 1).min(values.len() - 1);
        values[low] + rest * (values[high] - values[low])
    };
    Some((at(0.025), at(0.975)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::identify::estimate::arx::fit;
    use crate::identify::model::polynomials::Orders;
    use crate::identify::tests::noise;

    #[test]
    fn it_scatters_as_the_covariance_says() {
        let truth = Polynomials { a: vec![1.0, -1.5, 0.7], b: vec![1.0, 0.5], nk: 1 };
        let input = noise(3, 800);
        let disturbance = all_pole(&truth.a, noise(4, 800));
        let output = truth.simulate(&input).iter().zip(disturbance).map(|(y, e)| y + 0.3 * e).collect();
        let segments = [Segment { input, output, from_rest: true, ..Segment::default() }];
        let orders = Orders { na: 2, nb: 2, nk: 1 };
        let found = fit(&segments, orders).unwrap();
        let draws = repeat(&segments, &found.model, Noise::Equation, 200, |s| {
            fit(s, orders).ok().map(|f| f.model.parameters())
        });
        assert_eq!(draws.len(), 200);
        for (k, sd) in found.standard_errors().into_iter().enumerate() {
            let spread = draws.iter().map(|d| (d[k] - found.model.parameters()[k]).powi(2)).sum::<f64>() / 200.0;
            assert!((0.8..1.25).contains(&(spread.sqrt() / sd)), "{k}: {} {sd}", spread.sqrt());
        }
        let (low, high) = middle_95(draws.iter().map(|d| d[0]).collect()).unwrap();
        let sd = found.standard_errors()[0];
        assert!(((high - low) / (3.92 * sd) - 1.0).abs() < 0.25);
    }

    /// One more of them is outside of an interval of 100 in 5 % of cases, not in the 7 % beyond the quantiles of the
    /// 100.
    #[test]
    fn an_interval_of_few_values_contains_the_next_one() {
        let mut random = crate::testing::random::Random::new(1);
        let mut outside = 0;
        for _ in 0..10_000 {
            let (low, high) = middle_95(random.normals(100)).unwrap();
            outside += usize::from(!(low..=high).contains(&random.normal()));
        }
        assert!((440..560).contains(&outside), "{outside}");
        assert_eq!(middle_95(vec![1.0; 38]), None);
        assert_eq!(middle_95((0..39).map(f64::from).collect()), Some((0.0, 38.0)));
    }

    #[test]
    fn output_noise_is_put_on_the_output() {
        let truth = Polynomials { a: vec![1.0, -0.9], b: vec![1.0], nk: 1 };
        let input = noise(5, 500);
        let output: Vec<f64> = truth.simulate(&input).iter().zip(noise(6, 500)).map(|(y, e)| y + e).collect();
        let segments = [Segment { input: input.clone(), output, from_rest: true, ..Segment::default() }];
        let clean = truth.simulate(&input);
        let rms = |s: &[Segment]| {
            let sum: f64 = s[0].output.iter().zip(&clean).map(|(y, c)| (y - c).powi(2)).sum();
            Some((sum / 500.0).sqrt())
        };
        let spread = repeat(&segments, &truth, Noise::Output, 30, rms);
        assert!(spread.iter().all(|r| (0.85..1.15).contains(r)), "{spread:?}");
    }
}
