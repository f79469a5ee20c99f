//! Delay of the output after the commands: the sum of the offset between two clocks, the amplifier's delay and the
//! plant's. These cannot be separated, so the sum is reported, and removed only on request.
//!
//! In: the data as a function of a delay of the commands. Out: the delay with which a second-order model fits best, by
//! output error; delay and model are fitted together.
//!
//! The sum of squares has many local minima. In most of them one state of the model imitates a delay and only the other
//! describes the plant: the delay is then wrong by some milliseconds, with a hardly larger residual. Searches therefore
//! start at delays over the whole range, each with models whose two states have clearly different time constants, and
//! the best result is taken.
//!
//! σ holds for residuals of any colour: it is computed from their correlation with the derivatives (Newey and West,
//! Econometrica 55, 1987, doi:10.2307/1913610). The possible shift of the delay from averaging the current between
//! frames is added in quadrature.

use super::arx;
use super::data::Segment;
use super::descent::{Descent, Lowest};
use super::model::{Orders, Polynomials};
use super::output_error::{each_row, squares};
use super::regression::{Triangle, solve};
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

/// Largest delay searched, either way, in periods.
pub(crate) const MAX_DELAY: f64 = 6.0;
/// Spacing of the starting delays, in periods.
const START_SPACING: f64 = 2.0;
/// Initial time constants of the second state, in periods.
const TIME_CONSTANTS: [f64; 3] = [100.0, 10.0, 2.0];
/// Initial zero of that state, as a fraction of its pole: it starts weak.
const NEARLY_CANCELLED: f64 = 0.998;
/// Half step of the difference for the derivative with respect to the delay, in periods.
const HALF_STEP: f64 = 0.005;
/// Most steps of a first search, and of the final one.
const FIRST_STEPS: usize = 25;
const FINAL_STEPS: usize = 100;
const DESCENT: Descent = Descent { first_damping: 1e-3, tolerance: 1e-9, max_steps: FINAL_STEPS };
/// Number of first searches that are continued.
const CONTINUED_SEARCHES: usize = 3;
/// Systematic error of the method, in periods. Simulated over all phases between amplifier and camera: 0.2 % to 0.6 %
/// of a period.
const METHOD_ERROR: f64 = 0.005;

/// A delay between commands and output.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Delay {
    /// Seconds; positive when the output is late.
    pub delay_s: f64,
    /// Its standard error, seconds.
    pub sd_s: f64,
    /// Root mean square of the residual, unit of the output.
    pub residual_rms: f64,
}

/// Current delay and model of a search.
#[derive(Debug, Clone)]
struct State {
    delay_s: f64,
    model: Polynomials,
}

impl State {
    /// By a step of the model's parameters and then of the delay.
    fn moved(&self, step: &DVector<f64>) -> Self {
        let of_model = self.model.parameters().len();
        Self {
            delay_s: self.delay_s + step.get(of_model).copied().unwrap_or(0.0),
            model: self.model.moved(&step.rows(0, of_model).into_owned()),
        }
    }
}

/// Estimates the delay within [`MAX_DELAY`] periods. `segments` gives the data for a delay of the commands: the same
/// samples for every delay. `None` when no model fits, or the best delay is outside the range or uncertain by more.
pub(crate) fn estimate(period_s: f64, segments: impl Fn(f64) -> Option<Vec<Segment>> + Sync) -> Option<Delay> {
    let search = Search { period_s, segments: &segments };
    // 1. from many delays and models
    let steps = (MAX_DELAY / START_SPACING) as i32;
    let delays: Vec<f64> = (-steps..=steps).map(|k| f64::from(k) * START_SPACING * period_s).collect();
    let mut found: Vec<Lowest<State>> = delays
        .par_iter()
        .flat_map(|delay_s| {
            let models = initial(&segments(*delay_s).unwrap_or_default());
            models.into_par_iter().filter_map(|model| search.run(State { delay_s: *delay_s, model }, FIRST_STEPS))
        })
        .collect();
    found.sort_by(|a, b| a.cost.total_cmp(&b.cost));
    // 2. the best ones to the end
    let best = found
        .into_iter()
        .take(CONTINUED_SEARCHES)
        .filter_map(|first| search.run(first.at, FINAL_STEPS))
        .min_by(|a, b| a.cost.total_cmp(&b.cost))?;
    let (best, cost) = (best.at, best.cost);
    if best.delay_s.abs() > MAX_DELAY * period_s {
        return None;
    }
    // 3. uncertainty
    let samples: usize = segments(best.delay_s)?.iter().map(Segment::observed).sum();
    let sd_s = search.standard_error(&best)?.hypot(METHOD_ERROR * period_s);
    if sd_s > MAX_DELAY * period_s {
        return None;
    }
    Some(Delay { delay_s: best.delay_s, sd_s, residual_rms: (cost / samples as f64).sqrt() })
}

/// Initial models: ARX of second order, and ARX of first order with a second, nearly cancelled state.
fn initial(data: &[Segment]) -> Vec<Polynomials> {
    let second = arx::fit(data, Orders { na: 2, nb: 2, nk: 1 }).ok().map(|found| found.model);
    let first = arx::fit(data, Orders { na: 1, nb: 1, nk: 1 }).ok().map(|found| found.model);
    let with_state = |first: &Polynomials, time_constant: f64| -> Option<Polynomials> {
        // A wrong delay may make it unstable; a stable one nearby is as good a start.
        let (pole, gain) = ((-first.a.get(1)?).clamp(-0.95, 0.98), *first.b.first()?);
        let state = (-1.0 / time_constant).exp();
        let zero = state * NEARLY_CANCELLED;
        Some(Polynomials { a: vec![1.0, -pole - state, pole * state], b: vec![gain, -gain * zero], nk: 1 })
    };
    let two_states = first.iter().flat_map(|first| TIME_CONSTANTS.iter().filter_map(|t| with_state(first, *t)));
    second.into_iter().chain(two_states).collect()
}

/// Derivatives with respect to model and delay, and residual, of all samples as a triangle.
fn linearise(data: &[Segment], model: &Polynomials, by_delay: &[Vec<f64>]) -> DMatrix<f64> {
    let mut triangle = Triangle::new(model.na() + model.nb() + 2);
    for (segment, by_delay) in data.iter().zip(by_delay) {
        each_row(segment, model, Some(by_delay), |row| triangle.push(row.iter().copied()));
    }
    triangle.finish()
}

struct Search<'a, F> {
    period_s: f64,
    segments: &'a F,
}

impl<F: Fn(f64) -> Option<Vec<Segment>> + Sync> Search<'_, F> {
    fn cost(&self, State { delay_s, model }: &State) -> f64 {
        // The search does not go far outside the range.
        if delay_s.abs() > (MAX_DELAY + START_SPACING) * self.period_s || !model.is_stable() {
            return f64::INFINITY;
        }
        (self.segments)(*delay_s).map_or(f64::INFINITY, |data| squares(&data, model))
    }

    /// Derivative of the simulated output with respect to the delay, per second.
    fn by_delay(&self, State { delay_s, model }: &State, data: &[Segment]) -> Option<Vec<Vec<f64>>> {
        let step = HALF_STEP * self.period_s;
        let (later, earlier) = ((self.segments)(delay_s + step)?, (self.segments)(delay_s - step)?);
        let same = |s: &Segment, other: &Segment| s.first == other.first && s.len() == other.len();
        let pairs = || data.iter().zip(later.iter().zip(&earlier));
        if later.len() != data.len() || !pairs().all(|(s, (l, e))| same(s, l) && same(s, e)) {
            return None;
        }
        let change = |later: &Segment, earlier: &Segment| -> Vec<f64> {
            let change =
                later.input.iter().zip(&earlier.input).map(|(l, e)| (l - e) / (2.0 * step)).collect::<Vec<_>>();
            model.simulate(&change)
        };
        Some(pairs().map(|(_, (l, e))| change(l, e)).collect())
    }

    fn run(&self, start: State, max_steps: usize) -> Option<Lowest<State>> {
        let triangle = |state: &State| {
            let data = (self.segments)(state.delay_s)?;
            let by_delay = self.by_delay(state, &data)?;
            Some(linearise(&data, &state.model, &by_delay))
        };
        Descent { max_steps, ..DESCENT }.run(start, |state| self.cost(state), triangle, State::moved)
    }

    /// Standard error of the delay, from the scores of all samples and their correlation over time.
    fn standard_error(&self, state: &State) -> Option<f64> {
        let data = (self.segments)(state.delay_s)?;
        let by_delay = self.by_delay(state, &data)?;
        let solution = solve(linearise(&data, &state.model, &by_delay))?;
        // The last row of R⁻¹ R⁻ᵀ, applied to a row of derivatives, is that sample's weight in the delay.
        let weights = &solution.inverse * solution.inverse.row(solution.inverse.nrows() - 1).transpose();
        let mut variance = 0.0;
        for (segment, by_delay) in data.iter().zip(&by_delay) {
            let mut scores = Vec::with_capacity(segment.len());
            each_row(segment, &state.model, Some(by_delay), |row| {
                let (residual, derivatives) = row.split_last().unwrap_or((&0.0, &[]));
                scores.push(residual * derivatives.iter().zip(weights.iter()).map(|(d, w)| d * w).sum::<f64>());
            });
            let lags = (4.0 * (scores.len() as f64 / 100.0).powf(2.0 / 9.0)).ceil() as usize;
            let at_lag = |lag: usize| scores.iter().zip(scores.iter().skip(lag)).map(|(a, b)| a * b).sum::<f64>();
            let bartlett = |lag: usize| 1.0 - lag as f64 / (lags + 1) as f64;
            variance += at_lag(0) + (1..=lags).map(|lag| 2.0 * bartlett(lag) * at_lag(lag)).sum::<f64>();
        }
        (variance > 0.0).then(|| variance.sqrt())
    }
}

#[cfg(test)]
mod tests {
    use super::super::hold::Held;
    use super::super::tests::noise;
    use super::*;
    use std::f64::consts::TAU;

    const PERIOD_S: f64 = 1.0 / 60.0;
    const SAMPLES: usize = 1800;

    /// A chirp commanded at 60 Hz drives Eq. 7 of the paper; the camera has its own 60 Hz clock and sees the commands
    /// act `delay_s` later.
    fn estimated(delay_s: f64, seed: u64) -> Delay {
        let chirp = |k: usize| {
            let t = k as f64 * PERIOD_S;
            (TAU * (0.5 * t + 7.5 * t * t / 62.0)).sin()
        };
        let held = Held::new((0..SAMPLES + 60).map(|k| (k as f64 * PERIOD_S, chirp(k))).collect());
        let plant = Polynomials { a: vec![1.0, -1.926_049, 0.926_353], b: vec![283.4, -281.7], nk: 1 };
        let drive = |delay_s: f64| -> Vec<f64> {
            let at = |k: usize| 0.2 + (k as f64 + 0.3) * PERIOD_S - delay_s;
            (0..SAMPLES).filter_map(|k| Some(2.4e-4 * held.mean(at(k), at(k + 1))?)).collect()
        };
        let noisy = noise(seed, SAMPLES);
        let output: Vec<f64> = plant.simulate(&drive(delay_s)).iter().zip(noisy).map(|(y, e)| y + 0.002 * e).collect();
        estimate(PERIOD_S, |delay_s| {
            Some(vec![Segment { input: drive(delay_s), output: output.clone(), ..Segment::default() }])
        })
        .unwrap()
    }

    #[test]
    fn the_delay_is_found_wherever_it_is() {
        for k in 0..25 {
            let truth = -0.03 + 0.005 * f64::from(k);
            let found = estimated(truth, 1);
            assert!((found.delay_s - truth).abs() < 4.0 * found.sd_s && found.sd_s < 3e-4, "{truth}: {found:?}");
        }
    }

    /// Commands that hardly move anything say nothing of the delay.
    #[test]
    fn a_delay_that_the_data_do_not_tell_is_none() {
        let output = noise(3, 300);
        let drive = |delay_s: f64| -> Vec<f64> {
            (0..300).map(|k| 1e-12 * (TAU * 3.0 * (f64::from(k) * PERIOD_S - delay_s)).sin()).collect()
        };
        let found = estimate(PERIOD_S, |delay_s| {
            Some(vec![Segment { input: drive(delay_s), output: output.clone(), ..Segment::default() }])
        });
        assert_eq!(found, None);
    }

    #[test]
    fn errors_are_as_large_as_the_noise_says() {
        let mut squares = 0.0;
        for seed in 1..=20 {
            let found = estimated(0.02, seed);
            // Here the model is exact: the method adds nothing.
            let of_noise = (found.sd_s.powi(2) - (METHOD_ERROR * PERIOD_S).powi(2)).sqrt();
            squares += ((found.delay_s - 0.02) / of_noise).powi(2) / 20.0;
        }
        assert!((0.4..1.9).contains(&squares), "{squares}");
    }
}
