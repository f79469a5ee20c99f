//! Whether what the refined model leaves has to do with its input: tests that need no other model.
//!
//! In: the data, the refined model. Out: two χ² of what its residual follows: the input before, through the model's own
//! poles, as a model of higher order would ([`Left::past`]); and the input after, which no system can know
//! ([`Left::ahead`]): it was computed from the output. And one of a mean and a trend ([`Left::straight`]).
//!
//! Cannot tell: a response to the input of the same sample from an input computed from that sample. What is not linear
//! follows the input, too.

use crate::identify::checks::whitened_simulation::Whitened;
use crate::identify::data::prepare::Line;
use crate::identify::data::segments::Segment;
use crate::identify::estimate::noise_colour::Colour;
use crate::identify::estimate::output_error::{Derivatives, derivatives_and_residual, linearised};
use crate::identify::model::polynomials::{Polynomials, all_pole};
use nalgebra::DMatrix;

/// Further lags of the input through the poles, and further lags of the output.
const INPUTS: usize = 5;
const OUTPUTS: usize = 2;
pub(super) const FURTHER: usize = INPUTS + OUTPUTS;
/// Lags of the input after the output.
const AHEAD: usize = 5;
/// What noise explains in all but one of 10⁵ records, of 7, 1 and 5 degrees of freedom.
const LIMIT_PAST: f64 = 35.3;
const LIMIT_NEXT: f64 = 19.5;
const LIMIT_AHEAD: f64 = 30.9;
/// The same of 2.
const LIMIT_STRAIGHT: f64 = 23.0;
/// Less than this of the output's energy is told by no one: rounding, or a record without noise.
const LEAST: f64 = 1e-6;

/// What is left.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Left {
    /// χ² of the input before, over its limit.
    pub past: f64,
    /// The same of the input after, if that says anything: it does not where the output is known to be in the input.
    pub ahead: f64,
    /// The same of a straight line: a mean or trend that was not removed.
    pub straight: f64,
}

impl Left {
    /// `None` without noise, and where there are too few samples. `shortest`: the least delay that may be.
    pub(in crate::identify) fn of(segments: &[Segment], model: &Polynomials, shortest: usize) -> Option<Self> {
        let residuals = residuals(segments, model)?;
        let colour = Colour::of(&residuals);
        let of_model = model.parameters().len();
        let further: Vec<DMatrix<f64>> = segments
            .iter()
            .map(|segment| {
                // The input now, then those after; at the end the last one is held.
                let after = |k: usize, t: usize| {
                    let t = (t + k).min(segment.len().saturating_sub(1));
                    segment.input.get(t).copied().unwrap_or_default()
                };
                let order = of_higher_order(segment, model, shortest);
                let of = |t: usize, k: usize| order.get((t, k)).copied().unwrap_or_else(|| after(k - FURTHER, t));
                DMatrix::from_fn(segment.len(), FURTHER + 1 + AHEAD, of)
            })
            .collect();
        let whitened = Whitened::of(segments, model, &further, &colour)?;
        let last = segments.iter().map(|s| s.first + s.len()).max()?.max(1) as f64;
        let line = |s: &Segment| {
            DMatrix::from_fn(s.len(), 2, |t, column| if column == 0 { 1.0 } else { (s.first + t) as f64 / last })
        };
        let beside_it = Colour::of(&residuals.iter().map(|e| without_line(e)).collect::<Vec<_>>());
        let by_line = Whitened::of(segments, model, &segments.iter().map(line).collect::<Vec<_>>(), &beside_it)?;
        let straight = by_line.explained_by(of_model..of_model + 2) / LIMIT_STRAIGHT;
        let freedom = whitened.freedom();
        let past = of_model..of_model + FURTHER;
        let ahead = past.end + 1..past.end + 1 + AHEAD;
        let over = |columns: std::ops::Range<usize>, limit: f64| {
            let count = columns.len() as f64;
            // The limit of F for few samples, by its first term.
            whitened.explained_by(columns) / (limit * (1.0 + (limit - count + 2.0) / (2.0 * freedom)))
        };
        // The next lag alone shows a delay of a fraction of a sample.
        let next = over(of_model..of_model + 1, LIMIT_NEXT);
        let past = over(past, LIMIT_PAST).max(next);
        (freedom > 50.0).then(|| Self { past, ahead: over(ahead, LIMIT_AHEAD), straight })
    }

    /// Whether it follows the input before.
    pub(in crate::identify) fn follows(&self) -> bool {
        self.past > 1.0
    }

    /// Whether a mean or trend was not removed.
    pub(in crate::identify) fn is_off_centre(&self) -> bool {
        self.straight > 1.0
    }

    /// Whether it is in the input after.
    pub(in crate::identify) fn is_fed_back(&self) -> bool {
        self.ahead > 1.0
    }
}

/// What a model of higher order, or of another delay of no less than `shortest`, has besides: [`FURTHER`] columns.
pub(super) fn of_higher_order(segment: &Segment, model: &Polynomials, shortest: usize) -> DMatrix<f64> {
    // What is before a delay that was chosen.
    let earlier = model.nk.saturating_sub(1).max(shortest);
    let inputs = INPUTS - usize::from(earlier < model.nk);
    let by_input = all_pole(&model.a, segment.input.clone());
    let by_output = all_pole(&model.a, model.simulate(&segment.input));
    let at = |signal: &[f64], t: usize, lag: usize| {
        t.checked_sub(lag).and_then(|t| signal.get(t)).copied().unwrap_or_default()
    };
    let of = |t: usize, column: usize| match column {
        k if k < inputs => at(&by_input, t, model.nk + model.nb() + k),
        k if k < INPUTS => at(&by_input, t, earlier),
        k => at(&by_output, t, model.na() + 1 + k - INPUTS),
    };
    DMatrix::from_fn(segment.len(), FURTHER, of)
}

/// The colour of what a model leaves in simulation; `None` where that is next to nothing.
pub(in crate::identify) fn colour(segments: &[Segment], model: &Polynomials) -> Option<Colour> {
    residuals(segments, model).map(|residuals| Colour::of(&residuals))
}

fn residuals(segments: &[Segment], model: &Polynomials) -> Option<Vec<Vec<f64>>> {
    let rows = linearised(segments, model, Derivatives::None);
    let residuals: Vec<Vec<f64>> =
        segments.iter().zip(rows).map(|(segment, rows)| derivatives_and_residual(segment, rows).1).collect();
    let squares = |values: &mut dyn Iterator<Item = f64>| values.filter(|v| !v.is_nan()).map(|v| v * v).sum::<f64>();
    let left = squares(&mut residuals.iter().flatten().copied());
    let all = squares(&mut segments.iter().flat_map(|segment| &segment.output).copied());
    (left > LEAST * all).then_some(residuals)
}

/// A residual without its mean and trend, which would be taken for noise that lasts.
fn without_line(residual: &[f64]) -> Vec<f64> {
    let timed = || residual.iter().enumerate().map(|(t, e)| (t as f64, *e));
    let line = Line::through(timed().filter(|(_, e)| !e.is_nan()), true);
    timed().map(|(t, e)| e - line.at(t)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::identify::chain::identification::Identification;
    use crate::identify::chain::settings::Choice;
    use crate::identify::chain::steps::identify;
    use crate::identify::checks::diagnostic::Diagnostic;
    use crate::identify::data::segments::{Data, Record};
    use crate::identify::estimate::output_error::refine;
    use crate::identify::model::modelled::Role;
    use crate::identify::model::polynomials::Orders;
    use crate::identify::tests::{noise, settings};

    /// Damped by 0.4 at 1 Hz, sampled at 50 Hz.
    fn second_order() -> Polynomials {
        Polynomials { a: vec![1.0, -1.890_75, 0.904_38], b: vec![0.006_93, 0.006_7], nk: 1 }
    }

    /// Steps up or down, each value held for `hold` samples.
    fn steps(seed: u64, samples: usize, hold: usize) -> Vec<f64> {
        noise(seed + 7000, samples / hold + 1).iter().flat_map(|e| vec![e.signum(); hold]).take(samples).collect()
    }

    fn record(seed: u64, truth: &Polynomials, rho: f64, sd: f64) -> Segment {
        let input = steps(seed, 1500, 5);
        let disturbance = all_pole(&[1.0, -rho], noise(seed, input.len()));
        let output = truth.simulate(&input).iter().zip(disturbance).map(|(y, e)| y + sd * e).collect();
        Segment { input, output, from_rest: true, ..Segment::default() }
    }

    fn left(segment: Segment) -> Left {
        let segments = [segment];
        let model = refine(&segments, &second_order()).unwrap().estimated.model;
        Left::of(&segments, &model, 1).unwrap()
    }

    fn identified(segment: Segment) -> Identification {
        let training = vec![Record { name: "record".to_owned(), segments: vec![segment] }];
        let data = Data { training, period_s: 0.02, ..Data::default() };
        let candidates = (1..=4).flat_map(|n| (1..=3).map(move |nk| Orders { na: n, nb: n, nk })).collect();
        identify(&data, &settings(Choice::Search { candidates, criterion: None })).unwrap()
    }

    fn has_sigma(found: &Identification) -> bool {
        found.model(Role::Refined).is_some_and(|model| model.covariance.is_some())
    }

    #[test]
    fn noise_of_any_colour_follows_no_input() {
        for (rho, sd) in [(0.0, 0.05), (0.9, 0.05), (0.98, 0.02), (1.0, 0.01)] {
            let found: Vec<Left> = (0..100).map(|seed| left(record(seed, &second_order(), rho, sd))).collect();
            assert!(found.iter().all(|left| !left.follows() && !left.is_fed_back()), "{rho}: {found:?}");
            // A walk has a trend, whatever becomes of it.
            assert!(rho > 0.99 || !found.iter().any(Left::is_off_centre), "{rho}: {found:?}");
            // Mean χ² of 7 and 5 degrees of freedom, over the limits.
            let mean = |of: fn(&Left) -> f64| found.iter().map(of).sum::<f64>() / 100.0;
            let (past, ahead) = (mean(|l| l.past) * LIMIT_PAST / 7.0, mean(|l| l.ahead) * LIMIT_AHEAD / 5.0);
            assert!((0.6..1.5).contains(&past) && (0.6..1.5).contains(&ahead), "{rho}: {past} {ahead}");
        }
    }

    /// Loud noise while the input is large, and little of both later.
    #[test]
    fn noise_that_varies_with_the_input_follows_none() {
        for seed in 0..50 {
            let mut one = record(seed, &second_order(), 0.0, 0.0);
            let loud = |t: usize| if t < 300 { 1.0 } else { 0.05 };
            one.input.iter_mut().enumerate().for_each(|(t, u)| *u *= loud(t));
            let clean = second_order().simulate(&one.input);
            let noisy = clean.iter().zip(noise(seed, 1500)).enumerate().map(|(t, (y, e))| y + 0.2 * loud(t) * e);
            one.output = noisy.collect();
            let found = left(one);
            assert!(!found.follows() && !found.is_fed_back(), "{seed}: {found:?}");
        }
    }

    /// With holes, and a state that it began with.
    #[test]
    fn parts_of_a_record_are_tested_too() {
        for seed in 0..30 {
            let mut whole = record(seed, &second_order(), 0.8, 0.05);
            whole.output.iter_mut().skip(17).step_by(40).for_each(|y| *y = f64::NAN);
            let parts = [whole.part(100, 600, 0.02), whole.part(620, 1500, 0.02)];
            let model = refine(&parts, &second_order()).unwrap().estimated.model;
            let found = Left::of(&parts, &model, 1).unwrap();
            assert!(!found.follows() && !found.is_fed_back(), "{seed}: {found:?}");
        }
    }

    /// A third pole, of which the full model knows as little as the refined one: it leaves hardly more.
    #[test]
    fn a_pole_that_the_model_lacks_is_told_and_there_is_no_sigma() {
        // (1 − 0.6 q⁻¹) (1 − 1.89 q⁻¹ + 0.904 q⁻²), with the same gain.
        let (p, two) = (0.606_53, second_order());
        let a = vec![1.0, two.a[1] - p, two.a[2] - p * two.a[1], -p * two.a[2]];
        let third = Polynomials { a, b: two.b.iter().map(|b| b * (1.0 - p)).collect(), nk: 1 };
        for seed in 0..5 {
            let found = identified(record(seed, &third, 0.0, 0.05));
            assert!(!has_sigma(&found), "{seed}: {:?}", found.left);
            let told = found
                .diagnostics
                .iter()
                .any(|d| matches!(d, Diagnostic::Follows { .. } | Diagnostic::ModelError { .. }));
            assert!(told, "{:?}", found.diagnostics);
        }
    }

    /// From a tenth of the output's spread on, coefficients are off by more than 3 σ.
    #[test]
    fn a_mean_or_trend_that_was_not_taken_off_is_told_and_there_is_no_sigma() {
        for seed in 0..5 {
            for (mean, trend) in [(0.1, 0.0), (0.5, 0.0), (3.0, 0.0), (0.0, 0.5)] {
                let mut one = record(seed, &second_order(), 0.0, 0.03);
                one.output.iter_mut().enumerate().for_each(|(t, y)| *y += mean + trend * t as f64 / 1500.0);
                let found = identified(one);
                assert!(!has_sigma(&found), "{seed} {mean} {trend}: {:?}", found.left);
            }
        }
    }

    /// A second mode, of a fiftieth of the gain.
    #[test]
    fn a_weak_mode_that_the_model_lacks_is_told_and_one_too_many_too() {
        for seed in 0..6 {
            let weak = Polynomials { a: vec![1.0, -1.8265, 0.963], b: vec![0.001_38, 0.001_36], nk: 1 };
            let mut two = record(seed, &second_order(), 0.0, 0.05);
            let input = steps(seed, 1500, 3);
            let both = weak.simulate(&input).into_iter().zip(second_order().simulate(&input));
            two.output = both.zip(noise(seed, 1500)).map(|((w, y), e)| w + y + 0.02 * e).collect();
            two.input = input;
            let found = identified(two);
            assert!(!has_sigma(&found), "{seed}: {:?}", found.left);
            assert!(!found.diagnostics.iter().any(|d| matches!(d, Diagnostic::InInput { .. })), "{seed}");
            let one = Polynomials { a: vec![1.0, -0.95], b: vec![0.05], nk: 1 };
            let found = identified(record(seed, &one, 0.0, 0.05));
            assert!(found.lower_order == Some(1) && has_sigma(&found), "{seed}: {:?}", found.lower_order);
            let found = identified(record(seed, &second_order(), 0.8, 0.05));
            assert!(found.lower_order.is_none() && found.higher_order.is_none(), "{seed}");
        }
    }

    #[test]
    fn an_output_that_comes_a_row_early_is_told_and_one_in_time_is_not() {
        for seed in 0..5 {
            let in_time = record(seed, &second_order(), 0.0, 0.02);
            let found = identified(in_time.clone());
            assert!(found.earlier_delay.is_none() && has_sigma(&found), "{seed}: {:?}", found.left);
            let mut early = in_time;
            early.output.remove(0);
            early.input.pop();
            let found = identified(early);
            assert!(found.earlier_delay == Some(0) && !has_sigma(&found), "{seed}: {:?}", found.left);
            assert!(found.diagnostics.iter().any(|d| d.to_string().contains("seems to come before the input: nk 0")));
        }
    }

    /// A controller that sees the output a sample late, and a disturbance that lasts.
    #[test]
    fn an_input_that_was_computed_from_the_output_is_told() {
        for seed in 0..5 {
            let (model, target) = (second_order(), steps(seed, 3000, 25));
            let disturbance = all_pole(&[1.0, -0.95], noise(seed, 3000));
            let (mut input, mut clean, mut output) = (Vec::new(), Vec::<f64>::new(), Vec::<f64>::new());
            for t in 0..3000_usize {
                let at = |signal: &[f64], lag: usize| t.checked_sub(lag).map_or(0.0, |k| signal[k]);
                let moved = model.b[0] * at(&input, 1) + model.b[1] * at(&input, 2);
                let now = moved - model.a[1] * at(&clean, 1) - model.a[2] * at(&clean, 2);
                input.push(1.5 * (target[t] - at(&output, 1)));
                clean.push(now);
                output.push(now + 0.1 * disturbance[t]);
            }
            let found = identified(Segment { input, output, from_rest: true, ..Segment::default() });
            assert!(!has_sigma(&found), "{seed}: {:?}", found.left);
            assert!(found.diagnostics.iter().any(|d| matches!(d, Diagnostic::InInput { .. })), "{:?}", found.left);
        }
    }

    /// Noise that lasts made a false delay look better by more than white noise could.
    #[test]
    fn the_delay_is_right_in_noise_that_lasts() {
        for seed in 0..30 {
            let found = identified(record(seed, &second_order(), 0.98, 0.02));
            assert_eq!(found.refined.as_ref().unwrap().estimated.model.nk, 1, "{seed}");
        }
    }
}
