//! Delay of the output after the commands: the sum of the offset between two clocks, the amplifier's delay and the
//! plant's. These cannot be separated, so the sum is reported, and removed only on request.
//!
//! In: the data as a function of a delay of the commands. Out: the delay with which a second-order model fits best, by
//! output error; delay and model are fitted together.
//!
//! The sum of squares has many local minima. In most of them one state of the model imitates a delay and only the other
//! describes the plant: the delay is then wrong by some milliseconds, with a hardly larger residual. Searches therefore
//! start at delays over the whole range, each with models whose two states have clearly different time constants and
//! with the best of a grid of plants, and the best result is taken. Where another delay explains the record about as
//! well (a narrow band of frequencies, commands that are missing), the data do not tell which is right: the one nearest
//! to the times as given is taken, and the others are named. None of them need be right: σ of a minimum says nothing
//! of the others, and half the distance of the outermost ones is added to it.
//!
//! To first order a zero of H(s) is a delay. Sampled, a pendulum has its zero near z = −1, and there the gain |1 + c/z|
//! hardly depends on c, and is the same for c and 1/c: with a free zero the sum of squares has two minima of the same
//! depth, some milliseconds before and after the true delay, or a flat one. Therefore each minimum is searched again
//! with models without a zero, H(s) = b₀ / (s² + a₁ s + a₂), and of first order, of which a fast second pole is a
//! delay. The simplest that explains the record as well is taken: a zero that only acts like a delay counts as one. So
//! does a pole, and where a second pole does as well, σ contains how far the two delays are apart.
//!
//! σ holds for residuals of any colour (see `noise_colour`), and where parts of the record contradict each other. The
//! possible shift of the delay from averaging the current between frames is added in quadrature.

use crate::digits::fixed;
use crate::identify::data::prepare::Line;
use crate::identify::data::segments::Segment;
use crate::identify::estimate::arx;
use crate::identify::estimate::between_samples::{self, Answer, MAX_PASSES};
use crate::identify::estimate::noise_colour::Colour;
use crate::identify::estimate::output_error::{
    self, Derivatives, derivatives_and_residual, fitted_besides, linearised, squares, triangle,
};
use crate::identify::estimate::shortest_delay::BY_NOISE;
use crate::identify::estimate::unknown_zero::{self, Zero};
use crate::identify::model::continuous::{Continuous, Conversion};
use crate::identify::model::covariance::Covariance;
use crate::identify::model::polynomials::{Orders, Polynomials};
use crate::identify::solve::descent::{Descent, Lowest};
use crate::identify::solve::regression::solve;
use nalgebra::{Complex, DMatrix, DVector};
use rayon::prelude::*;
use std::cell::RefCell;

/// Largest delay searched, either way, in periods.
pub(crate) const MAX_DELAY: f64 = 6.0;
/// Spacing of the starting delays, in periods.
const START_SPACING: f64 = 2.0;
/// Initial time constants of the second state, in periods.
const TIME_CONSTANTS: [f64; 3] = [100.0, 10.0, 2.0];
/// Initial zero of that state, as a fraction of its pole: it starts weak.
const NEARLY_CANCELLED: f64 = 0.998;
/// Plants that are tried as starts: natural frequencies, radians per sample, each half of the one before, and damping
/// ratios.
const FASTEST: f64 = 1.0;
const FREQUENCIES: i32 = 10;
const DAMPING: [f64; 3] = [0.2, 0.7, 2.0];
/// Half step of the difference for the derivative with respect to the delay, in periods.
const HALF_STEP: f64 = 0.005;
/// Most steps of a first search, and of the final one.
const FIRST_STEPS: usize = 25;
const FINAL_STEPS: usize = 100;
const DESCENT: Descent = Descent { first_damping: 1e-3, tolerance: 1e-9, max_steps: FINAL_STEPS };
/// Largest drift of a clock: that of a loop that takes a little longer than planned.
const MAX_DRIFT: f64 = 0.01;
/// Significance limit of a drift, and of an output that comes before the commands, in σ.
const SIGNIFICANT_SD: f64 = 4.0;
/// Number of first searches that are continued.
const CONTINUED_SEARCHES: usize = 3;
/// A delay whose sum of squares is larger than the least by no more than this factor explains the record about as well:
/// errors of the model and of the commands have as large an effect. With commands over the whole band it is 2.8 for the
/// second best; with half the band, or 2 s of commands missing, a wrong delay was the best by 1.06 and 1.01.
const AS_WELL: f64 = 1.25;
/// Delays closer than this are one, in periods.
const SAME: f64 = 0.1;
/// Relative step of a number for the derivatives of a model without a zero; poles of T s closer than this are equal.
const NUMBER_STEP: f64 = 1e-6;
const EQUAL_POLES: f64 = 1e-4;
/// The step of a number that is 0 is that of this one.
const LEAST_NUMBER: f64 = 1e-100;
/// Parts of a record that are left out in turn.
const BLOCKS: usize = 10;
/// Systematic error of the method, in periods. Simulated over all phases between amplifier and camera: 0.2 % to 0.6 %
/// of a period.
const METHOD_ERROR: f64 = 0.005;
/// The delay no longer changes with what is taken off between samples, in periods: a fiftieth of that error.
const SETTLED: f64 = 1e-4;

/// A delay between commands and output.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Delay {
    /// Seconds; positive when the output is late.
    pub delay_s: f64,
    /// Its standard error, seconds; with others, it covers them.
    pub sd_s: f64,
    /// Other delays that explain the record about as well, seconds, the best first.
    pub others_s: Vec<f64>,
    /// Drift of the commands' clock, if they have their own.
    pub drift: Option<Drift>,
    /// The output's zero, if it was fitted along with the delay.
    pub zero: Option<Zero>,
    /// Root mean square of the residual, unit of the output.
    pub residual_rms: f64,
}

impl Delay {
    /// The others in words, milliseconds, if there are any.
    pub(crate) fn others_in_words(&self) -> Option<String> {
        let mut rising = self.others_s.clone();
        rising.sort_by(f64::total_cmp);
        let others: Vec<String> = rising.iter().map(|other| fixed(other * 1e3, 1)).collect();
        (!others.is_empty()).then(|| format!("{} ms", others.join(", ")))
    }

    /// Whether the output still comes before the commands when these act `removed_s` later.
    pub(crate) fn is_before(&self, removed_s: f64) -> bool {
        self.delay_s - removed_s < -SIGNIFICANT_SD * self.sd_s
    }
}

/// How fast a clock runs away from another.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Drift {
    /// Seconds per second; positive when the commands' clock is slow, so that they act later and later.
    pub rate: f64,
    /// Its standard error.
    pub sd: f64,
}

impl Drift {
    /// Whether it is more than chance explains.
    pub(crate) fn is_significant(&self) -> bool {
        self.rate.abs() > SIGNIFICANT_SD * self.sd
    }
}

/// When commands act.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct Timing {
    /// How much later than their times, in the middle of the record, seconds.
    pub delay_s: f64,
    /// How much later still for each second from the middle on: 1e-6 if their clock is fast by 1 ppm.
    pub drift: f64,
}

/// How inputs are given: held at their means from sample to sample, or with what they do in between.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Inputs {
    /// At their means.
    Held,
    /// With [`Segment::within`], if they change.
    Changing,
}

/// Which models are searched, the simplest first.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Form {
    /// Of first order.
    First,
    /// Of second order, those of an H(s) without a zero.
    WithoutZero,
    /// Of second order.
    Second,
}

impl Form {
    /// The numbers that a model of this form has: its coefficients, or a₁, a₂ and the sum of b.
    fn numbers(self, model: &Polynomials) -> Vec<f64> {
        match self {
            Self::WithoutZero => model.a.iter().skip(1).copied().chain([model.b.iter().sum()]).collect(),
            Self::First | Self::Second => model.parameters().as_slice().to_vec(),
        }
    }

    /// The model with these numbers; `None` where it has no H(s).
    fn model(self, numbers: &[f64]) -> Option<Polynomials> {
        match (self, numbers) {
            (Self::WithoutZero, [a1, a2, sum]) => without_zero(*a1, *a2, *sum),
            (Self::WithoutZero, _) => None,
            (Self::First, _) => Some(Polynomials::of(numbers, 1, 1)),
            (Self::Second, _) => Some(Polynomials::of(numbers, 2, 1)),
        }
    }

    /// A model of this form near one of second order.
    fn near(self, model: &Polynomials) -> Option<Polynomials> {
        match self {
            Self::First => {
                let slowest = model.poles().iter().map(|pole| pole.re).fold(0.0, f64::max);
                Some(Polynomials { a: vec![1.0, -slowest], b: vec![model.gain() * (1.0 - slowest)], nk: 1 })
            }
            Self::WithoutZero | Self::Second => self.model(&self.numbers(model)),
        }
    }

    /// Derivatives of the model's coefficients, a row each, with respect to its numbers.
    fn derivatives(self, model: &Polynomials) -> Option<DMatrix<f64>> {
        let numbers = self.numbers(model);
        if self != Self::WithoutZero {
            return Some(DMatrix::identity(numbers.len(), numbers.len()));
        }
        let column = |k: usize| {
            let step = NUMBER_STEP * numbers.get(k)?.abs().max(LEAST_NUMBER);
            let at = |by: f64| {
                let moved = numbers.iter().enumerate().map(|(i, number)| if i == k { number + by } else { *number });
                Some(self.model(&moved.collect::<Vec<_>>())?.parameters())
            };
            Some((at(step)? - at(-step)?) / (2.0 * step))
        };
        let columns = (0..numbers.len()).map(column).collect::<Option<Vec<_>>>()?;
        Some(DMatrix::from_columns(&columns))
    }
}

/// H(s) = b₀ / (s² + …), held between samples, from the denominator of the samples and the sum of their numerator. With
/// the poles p and q of T s, the first sample of its step response is 1 − (q eᵖ − p e^q) / (q − p) of its last.
fn without_zero(a1: f64, a2: f64, sum: f64) -> Option<Polynomials> {
    let root = Complex::new(a1 * a1 - 4.0 * a2, 0.0).sqrt();
    let poles = [(root - a1) * 0.5, (-root - a1) * 0.5];
    if poles.iter().any(|pole| pole.im == 0.0 && pole.re <= 0.0) {
        return None;
    }
    let [p, q] = poles.map(Complex::ln);
    let both = (p + q) * 0.5;
    let are_equal = (q - p).norm() < EQUAL_POLES;
    let left = if are_equal { (1.0 - both) * both.exp() } else { (q * p.exp() - p * q.exp()) / (q - p) };
    let first = sum * (1.0 - left.re) / (1.0 + a1 + a2);
    Some(Polynomials { a: vec![1.0, a1, a2], b: vec![first, sum - first], nk: 1 })
}

/// Current timing and model of a search.
#[derive(Debug, Clone)]
struct State {
    timing: Timing,
    model: Polynomials,
    form: Form,
}

impl State {
    /// By a step of the model's numbers, then of the delay, then of the drift if that is free.
    fn moved(&self, step: &DVector<f64>) -> Self {
        let numbers = self.form.numbers(&self.model);
        let further = |k: usize| step.get(numbers.len() + k).copied().unwrap_or(0.0);
        let moved: Vec<f64> = numbers.iter().zip(step.iter()).map(|(number, by)| number + by).collect();
        let timing = Timing { delay_s: self.timing.delay_s + further(0), drift: self.timing.drift + further(1) };
        // Where there is no such H(s) the search does not go, as where a model is not stable.
        let nowhere = || Polynomials { a: vec![1.0, 0.0, 2.0], b: vec![0.0; 2], nk: 1 };
        Self { timing, model: self.form.model(&moved).unwrap_or_else(nowhere), form: self.form }
    }
}

/// Estimates the delay within [`MAX_DELAY`] periods. `segments` gives the data for a timing of the commands: the same
/// samples for every timing. If the commands have a clock of their own, its drift is estimated too: `own_clock` is then
/// the middle of the record, seconds. `None` when no model fits, or the best delay is outside the range or uncertain by
/// more.
pub(crate) fn estimate(
    period_s: f64,
    own_clock: Option<f64>,
    segments: impl Fn(Timing, Inputs) -> Option<Vec<Segment>> + Sync,
) -> Option<Delay> {
    let held = |timing| segments(timing, Inputs::Held);
    let search = Search { period_s, own_clock, segments: &held };
    // 1. from many delays and models
    let steps = (MAX_DELAY / START_SPACING) as i32;
    let delays: Vec<f64> = (-steps..=steps).map(|k| f64::from(k) * START_SPACING * period_s).collect();
    let mut found: Vec<Lowest<State>> = delays
        .par_iter()
        .flat_map(|delay_s| {
            let timing = Timing { delay_s: *delay_s, drift: 0.0 };
            let models = initial(&held(timing).unwrap_or_default());
            let search = &search;
            let state = move |model| State { timing, model, form: Form::Second };
            models.into_par_iter().filter_map(move |model| search.run(state(model), FIRST_STEPS))
        })
        .collect();
    found.sort_by(|a, b| a.cost.total_cmp(&b.cost));
    let least = found.first()?.cost;
    let delay_of = |lowest: &Lowest<State>| lowest.at.timing.delay_s;
    let is_new = |known: &[Lowest<State>], lowest: &Lowest<State>| {
        known.iter().all(|known| (delay_of(known) - delay_of(lowest)).abs() > SAME * period_s)
    };
    // 2. the best ones to the end, and others about as good
    let mut continued: Vec<Lowest<State>> = Vec::new();
    for (k, first) in found.into_iter().enumerate() {
        if k < CONTINUED_SEARCHES || (first.cost <= AS_WELL * least && is_new(&continued, &first)) {
            continued.push(first);
        }
    }
    let mut ends: Vec<_> = continued.into_par_iter().filter_map(|first| search.run(first.at, FINAL_STEPS)).collect();
    ends.sort_by(|a, b| a.cost.total_cmp(&b.cost));
    let distinct = |ends: Vec<Lowest<State>>| {
        let least = ends.first().map_or(f64::INFINITY, |best| best.cost);
        let mut as_well: Vec<Lowest<State>> = Vec::new();
        for end in ends {
            if end.cost <= AS_WELL * least && is_new(&as_well, &end) {
                as_well.push(end);
            }
        }
        as_well
    };
    let ends = distinct(ends);
    if delay_of(ends.first()?).abs() > MAX_DELAY * period_s {
        return None;
    }
    // 3. the same with what the commands do between samples, by the models found: it may tell them apart
    let changes = between_samples::is_in(&segments(ends.first()?.at.timing, Inputs::Changing)?);
    let refined = |mut best: Lowest<State>| {
        let mut answer = None;
        for pass in 0..if changes { MAX_PASSES } else { 0 } {
            let own = Continuous::of(&best.at.model, period_s).and_then(|model| Answer::of(&model, period_s));
            let Some(own) = own else { break };
            let without = |timing| without(&segments, timing, &own);
            let search = Search { period_s, own_clock, segments: &without };
            let Some(next) = search.run(best.at.clone(), FINAL_STEPS) else { break };
            let moved_s = (delay_of(&next) - delay_of(&best)).abs();
            best = next;
            answer = Some(own);
            if pass > 0 && moved_s < SETTLED * period_s {
                break;
            }
        }
        (best, answer)
    };
    let refined_all = |ends: Vec<Lowest<State>>| -> Vec<(Lowest<State>, Option<Answer>)> {
        let mut all: Vec<_> = ends.into_par_iter().map(refined).collect();
        all.sort_by(|(a, _), (b, _)| a.cost.total_cmp(&b.cost));
        all
    };
    let simpler = |form: Form| {
        let again = |end: &Lowest<State>| {
            search.run(State { model: form.near(&end.at.model)?, form, ..end.at.clone() }, FINAL_STEPS)
        };
        let mut ends: Vec<Lowest<State>> = ends.par_iter().filter_map(again).collect();
        ends.sort_by(|a, b| a.cost.total_cmp(&b.cost));
        refined_all(distinct(ends))
    };
    let simpler = || rayon::join(|| simpler(Form::First), || simpler(Form::WithoutZero));
    let (mut as_well, (first, without_zero)) = rayon::join(|| refined_all(ends.clone()), simpler);
    // 4. the simplest form that explains the record as well
    let data = |answer: Option<&Answer>, timing| match answer {
        Some(answer) => without(&segments, timing, answer),
        None => held(timing),
    };
    let (best, answer) = as_well.first()?;
    let of_best = |timing| data(answer.as_ref(), timing);
    let independent = Search { period_s, own_clock, segments: &of_best }.independent(&best.at)?;
    // Of noise that lasts, few samples are independent.
    let is_as_good = |(end, _): &(Lowest<State>, _)| {
        end.cost <= AS_WELL * best.cost && independent * (end.cost / best.cost).ln() <= BY_NOISE
    };
    let simple = [first, without_zero].into_iter().filter(|found| found.first().is_some_and(is_as_good));
    let simple: Vec<_> = simple.collect();
    // Whether what is a delay with a model of first order is a second pole is then open.
    let apart_s = match simple.as_slice() {
        [one, other] => (delay_of(&one.first()?.0) - delay_of(&other.first()?.0)).abs(),
        _ => 0.0,
    };
    if let Some(simplest) = simple.into_iter().next() {
        as_well = simplest;
    }
    let least = as_well.iter().map(|(end, _)| end.cost).min_by(f64::total_cmp)?;
    as_well.retain(|(end, _)| end.cost <= AS_WELL * least);
    let away = |k: usize| delay_of(&as_well[k].0).abs();
    let nearest = (0..as_well.len()).min_by(|a, b| away(*a).total_cmp(&away(*b)))?;
    let (best, answer) = as_well.remove(nearest);
    let others_s: Vec<f64> = as_well
        .iter()
        .map(|(end, _)| delay_of(end))
        .filter(|other_s| (other_s - delay_of(&best)).abs() > SAME * period_s)
        .collect();
    let Lowest { at: best, cost, .. } = best;
    let taken_s = best.timing.delay_s;
    let (first_s, last_s) = others_s.iter().fold((taken_s, taken_s), |(f, l), other| (f.min(*other), l.max(*other)));
    // 5. uncertainty
    let of_best = |timing| data(answer.as_ref(), timing);
    let found = Search { period_s, own_clock, segments: &of_best }.uncertainty(&best)?;
    let Uncertainty { of_delay_s, of_drift, zero, samples } = found;
    let sd_s = of_delay_s.hypot(METHOD_ERROR * period_s).hypot(0.5 * (last_s - first_s)).hypot(apart_s);
    if sd_s.max(taken_s.abs()) > MAX_DELAY * period_s {
        return None;
    }
    // The systematic error may change over the record.
    let of_method = METHOD_ERROR / samples as f64 * 12_f64.sqrt();
    let drift = of_drift.map(|sd| Drift { rate: best.timing.drift, sd: sd.hypot(of_method) });
    let residual_rms = (cost / samples as f64).sqrt();
    Some(Delay { delay_s: taken_s, sd_s, others_s, drift, zero, residual_rms })
}

/// The data for a timing, without how a model answers to what the commands do between samples.
fn without(
    segments: &impl Fn(Timing, Inputs) -> Option<Vec<Segment>>,
    timing: Timing,
    answer: &Answer,
) -> Option<Vec<Segment>> {
    Some(segments(timing, Inputs::Changing)?.iter().map(|segment| answer.taken_off(segment)).collect())
}

/// Initial models: ARX of second order, ARX of first order with a second, nearly cancelled state, and the best plant of
/// a grid.
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
    second.into_iter().chain(two_states).chain(best_plant(data)).collect()
}

/// The plant of a grid that leaves least, its gain fitted. Where frames are many times as fast as the plant, noise
/// makes all of ARX useless as a start.
fn best_plant(data: &[Segment]) -> Option<Polynomials> {
    let plant = |frequency: f64, damping: f64| {
        let square = frequency * frequency;
        let (num, den) = (vec![square], vec![1.0, 2.0 * damping * frequency, square]);
        let unit = Continuous { num, den, delay_s: 0.0, conversion: Conversion::Hold }.sampled(1.0);
        let gain = best_gain(data, &unit)?;
        Some(Polynomials { b: unit.b.iter().map(|b| b * gain).collect(), ..unit })
    };
    let frequencies = (0..FREQUENCIES).map(|k| FASTEST * 0.5_f64.powi(k));
    let plants = frequencies.flat_map(|frequency| DAMPING.iter().filter_map(move |damping| plant(frequency, *damping)));
    let judged = plants.map(|plant| (squares(data, &plant), plant));
    let (_, best) = judged.min_by(|(a, _), (b, _)| a.total_cmp(b))?;
    // Fitted together with the delay at once, a plant this far off drives it out of the range.
    output_error::nearest(data, &best).ok().map(|found| found.model)
}

/// By how much a model's output, from rest, is to be multiplied to be nearest to the data, means apart.
fn best_gain(data: &[Segment], model: &Polynomials) -> Option<f64> {
    let simulated = data.iter().map(|segment| model.simulate(&segment.input));
    let pairs = simulated.zip(data).flat_map(|(simulated, segment)| simulated.into_iter().zip(&segment.output));
    let pairs: Vec<(f64, f64)> = pairs.map(|(x, y)| (x, *y)).filter(|(_, y)| !y.is_nan()).collect();
    let gain = Line::through(pairs.iter().copied(), true).slope;
    (gain.is_finite() && gain != 0.0).then_some(gain)
}

/// σ of what was found.
struct Uncertainty {
    of_delay_s: f64,
    of_drift: Option<f64>,
    zero: Option<Zero>,
    samples: usize,
}

struct Search<'a, F> {
    period_s: f64,
    own_clock: Option<f64>,
    segments: &'a F,
}

impl<F: Fn(Timing) -> Option<Vec<Segment>> + Sync> Search<'_, F> {
    /// Whether a search does not go there, so far outside the range, or with a model that is not stable.
    fn is_outside(&self, State { timing, model, .. }: &State) -> bool {
        timing.delay_s.abs() > (MAX_DELAY + START_SPACING) * self.period_s
            || timing.drift.abs() > MAX_DRIFT
            || !model.is_stable()
    }

    /// Derivatives of the simulated output with respect to the delay, per second, and to the drift if that is free.
    fn by_timing(&self, State { timing, model, .. }: &State, data: &[Segment]) -> Option<Vec<DMatrix<f64>>> {
        let step = HALF_STEP * self.period_s;
        let at = |by: f64| (self.segments)(Timing { delay_s: timing.delay_s + by, ..*timing });
        let (later, earlier) = (at(step)?, at(-step)?);
        let same = |s: &Segment, other: &Segment| s.first == other.first && s.len() == other.len();
        let pairs = || data.iter().zip(later.iter().zip(&earlier));
        if later.len() != data.len() || !pairs().all(|(s, (l, e))| same(s, l) && same(s, e)) {
            return None;
        }
        let change = |segment: &Segment, later: &Segment, earlier: &Segment| {
            let change = later.input.iter().zip(&earlier.input).map(|(l, e)| (l - e) / (2.0 * step));
            let change: Vec<f64> = change.collect();
            let mut columns = vec![DVector::from_vec(model.simulate(&change))];
            columns.extend(self.own_clock.map(|middle_s| {
                let times = (0..change.len()).map(|k| segment.start_s + k as f64 * self.period_s - middle_s);
                let growing: Vec<f64> = change.iter().zip(times).map(|(change, t)| change * t).collect();
                DVector::from_vec(model.simulate(&growing))
            }));
            DMatrix::from_columns(&columns)
        };
        Some(pairs().map(|(s, (l, e))| change(s, l, e)).collect())
    }

    /// The rows of [`linearised`], by the numbers that are searched.
    fn rows(&self, state: &State, data: &[Segment]) -> Option<Vec<DMatrix<f64>>> {
        let by_timing = self.by_timing(state, data)?;
        let rows = linearised(data, &state.model, Derivatives::And(&by_timing));
        let by_numbers = state.form.derivatives(&state.model)?;
        let (coefficients, numbers) = by_numbers.shape();
        let of_numbers = |rows: &DMatrix<f64>| {
            let further = rows.columns(coefficients, rows.ncols() - coefficients);
            let mut same = DMatrix::zeros(rows.nrows(), numbers + further.ncols());
            same.columns_mut(0, numbers).copy_from(&(rows.columns(0, coefficients) * &by_numbers));
            same.columns_mut(numbers, further.ncols()).copy_from(&further);
            same
        };
        Some(rows.iter().map(of_numbers).collect())
    }

    /// How many independent samples the residuals are worth.
    fn independent(&self, state: &State) -> Option<f64> {
        let data = (self.segments)(state.timing)?;
        let rows = linearised(&data, &state.model, Derivatives::None);
        let residuals = data.iter().zip(rows).map(|(segment, rows)| derivatives_and_residual(segment, rows).1);
        let samples: usize = data.iter().map(Segment::observed).sum();
        Some(samples as f64 / Colour::of(&residuals.collect::<Vec<_>>()).correlated_samples().max(1.0))
    }

    fn run(&self, start: State, max_steps: usize) -> Option<Lowest<State>> {
        // A step that is taken is linearised with the data by which it was judged.
        let judged: RefCell<Option<(Timing, Vec<Segment>)>> = RefCell::default();
        let cost = |state: &State| {
            let data = if self.is_outside(state) { None } else { (self.segments)(state.timing) };
            let Some(data) = data else { return f64::INFINITY };
            let cost = squares(&data, &state.model);
            judged.replace(Some((state.timing, data)));
            cost
        };
        let derivatives = |state: &State| {
            let data = match judged.take() {
                Some((timing, data)) if timing == state.timing => data,
                _ => (self.segments)(state.timing)?,
            };
            Some(triangle(&data, &self.rows(state, &data)?))
        };
        Descent { max_steps, ..DESCENT }.run(start, cost, derivatives, State::moved)
    }

    fn uncertainty(&self, state: &State) -> Option<Uncertainty> {
        let data = (self.segments)(state.timing)?;
        let rows = self.rows(state, &data)?;
        let solution = solve(triangle(&data, &rows))?;
        let parts = data.iter().zip(rows).map(|(segment, rows)| derivatives_and_residual(segment, rows));
        let (derivatives, residuals): (Vec<_>, Vec<_>) = parts.unzip();
        let samples: usize = data.iter().map(Segment::observed).sum();
        let fitted = derivatives.first()?.ncols() + fitted_besides(&data, &state.model);
        let freedom = samples.checked_sub(fitted).filter(|n| *n > 0)?;
        let variance = solution.residual / freedom as f64;
        let colour = Colour::of(&residuals);
        let covariance = Covariance::from_factor(colour.factor(&derivatives, &solution.inverse) * variance.sqrt());
        let model = state.form.numbers(&state.model);
        let sds = covariance.standard_errors();
        let by_blocks = without_blocks(&derivatives, &residuals)?;
        let sd = |k: usize| Some(sds.get(k)?.max(*by_blocks.get(k)?));
        let (of_delay_s, of_drift) = (sd(model.len())?, sd(model.len() + 1));
        let timing = [state.timing.delay_s, state.timing.drift];
        let parameters: Vec<f64> = model.iter().copied().chain(timing).take(sds.len()).collect();
        let residual = |p: &[f64]| {
            let (of_model, of_timing) = p.split_at_checked(model.len())?;
            let timing = Timing { delay_s: *of_timing.first()?, drift: of_timing.get(1).copied().unwrap_or_default() };
            Some(output_error::residuals(&(self.segments)(timing)?, &state.form.model(of_model)?))
        };
        let zero = unknown_zero::zero(&parameters, &covariance, residual, (&colour, variance));
        Some(Uncertainty { of_delay_s, of_drift, zero, samples })
    }
}

/// σ of all parameters by the jackknife over [`BLOCKS`] parts of the record, to first order (Efron, The Jackknife,
/// doi:10.1137/1.9781611970319). It is larger than that of stationary residuals where a part contradicts the others.
/// `None` where the parameters are not determined without some part.
fn without_blocks(derivatives: &[DMatrix<f64>], residuals: &[Vec<f64>]) -> Option<Vec<f64>> {
    let samples: usize = residuals.iter().map(Vec::len).sum();
    let count = derivatives.first()?.ncols();
    let mut blocks = vec![(DMatrix::zeros(count, count), DVector::zeros(count)); BLOCKS];
    let rows = derivatives.iter().zip(residuals).flat_map(|(by, residuals)| by.row_iter().zip(residuals.iter()));
    for (k, (row, residual)) in rows.enumerate().filter(|(_, (_, residual))| !residual.is_nan()) {
        let (information, gradient) = &mut blocks[k * BLOCKS / samples];
        information.ger(1.0, &row.transpose(), &row.transpose(), 1.0);
        gradient.axpy(*residual, &row.transpose(), 1.0);
    }
    let information: DMatrix<f64> = blocks.iter().map(|block| &block.0).sum();
    let gradient: DVector<f64> = blocks.iter().map(|block| &block.1).sum();
    // To one scale, for the sake of rounding.
    let scale = information.diagonal().map(|squares| if squares > 0.0 { squares.sqrt().recip() } else { 0.0 });
    let mut squares = DVector::zeros(count);
    for (of_block, pull) in blocks {
        let mut left = &information - of_block;
        for (i, j) in (0..count).flat_map(|i| (0..count).map(move |j| (i, j))) {
            left[(i, j)] *= scale[i] * scale[j];
        }
        let moved = left.cholesky()?.solve(&(&gradient - pull).component_mul(&scale)).component_mul(&scale);
        squares += moved.component_mul(&moved);
    }
    let share = (BLOCKS - 1) as f64 / BLOCKS as f64;
    Some(squares.iter().map(|squares| (share * squares).sqrt()).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::identify::data::hold::Held;
    use crate::identify::data::segments::PARTS;
    use crate::identify::tests::noise;
    use std::f64::consts::TAU;
    use std::ops::Range;

    const PERIOD_S: f64 = 1.0 / 60.0;
    const SAMPLES: usize = 1800;

    /// A chirp commanded at 60 Hz drives Eq. 7 of the paper; the camera has its own 60 Hz clock and sees the commands
    /// act `delay_s` later, and later by `drift` from the middle on. θ is `zero` too high. The commands `missing` are
    /// not told.
    fn estimated(delay_s: f64, drift: f64, zero: f64, seed: u64, missing: &Range<usize>) -> Option<Delay> {
        let chirp = |k: usize| {
            let t = k as f64 * PERIOD_S;
            (TAU * (0.5 * t + 7.5 * t * t / 62.0)).sin()
        };
        let commands = || (0..SAMPLES + 60).map(|k| (k as f64 * PERIOD_S, chirp(k)));
        let held = Held::new(commands().collect());
        let told = Held::new(commands().enumerate().filter(|(k, _)| !missing.contains(k)).map(|(_, c)| c).collect());
        let plant = Polynomials { a: vec![1.0, -1.926_049, 0.926_353], b: vec![283.4, -281.7], nk: 1 };
        let middle_s = 0.5 * SAMPLES as f64 * PERIOD_S;
        let drive = |held: &Held, timing: Timing| -> Vec<f64> {
            let held = held.drifted(timing.drift, middle_s + 0.2);
            let at = |k: usize| 0.2 + (k as f64 + 0.3) * PERIOD_S - timing.delay_s;
            let mut integrals = held.integrals();
            (0..SAMPLES).filter_map(|k| Some(2.4e-4 * integrals.mean(at(k), at(k + 1))?)).collect()
        };
        let noisy = noise(seed, SAMPLES);
        let clean = plant.simulate(&drive(&held, Timing { delay_s, drift }));
        let output: Vec<f64> = clean.iter().zip(noisy).map(|(y, e)| y + zero + 0.002 * e).collect();
        estimate(PERIOD_S, (drift != 0.0).then_some(middle_s), |timing, _| {
            let by_zero = Some(vec![0.0; SAMPLES]);
            Some(vec![Segment { input: drive(&told, timing), output: output.clone(), by_zero, ..Segment::default() }])
        })
    }

    #[test]
    fn the_delay_is_found_wherever_it_is() {
        for k in 0..25 {
            let truth = -0.03 + 0.005 * f64::from(k);
            let found = estimated(truth, 0.0, 0.0, 1, &(0..0)).unwrap();
            assert!((found.delay_s - truth).abs() < 4.0 * found.sd_s && found.sd_s < 3e-4, "{truth}: {found:?}");
            assert!(found.others_s.is_empty(), "{truth}: {found:?}");
        }
    }

    /// Where 2 s of them are missing, a wrong delay may explain the record better than the right one.
    #[test]
    fn with_commands_missing_sigma_covers_the_error_and_other_delays_are_named() {
        let mut ambiguous = 0;
        for first in (200..1700).step_by(100) {
            // None is an answer, too.
            let Some(found) = estimated(0.002, 2e-6, 0.0, 1, &(first..first + 120)) else { continue };
            let drift = found.drift.unwrap();
            assert!((found.delay_s - 0.002).abs() < 3.0 * found.sd_s, "from {first}: {found:?}");
            assert!((drift.rate - 2e-6).abs() < 3.0 * drift.sd, "from {first}: {found:?}");
            assert!(found.others_s.iter().all(|other| (other - found.delay_s).abs() > SAME * PERIOD_S), "{found:?}");
            ambiguous += usize::from(!found.others_s.is_empty());
        }
        assert!(ambiguous >= 5, "{ambiguous}");
    }

    /// ARX, which noise bends the more the more frames there are, tells none of this plant then.
    #[test]
    fn the_delay_is_found_where_frames_are_fast_for_the_plant() {
        let (period_s, samples, truth_s) = (1.0 / 240.0, 4800, 0.008);
        let sines = |t: f64| (1..=20).map(|k| (TAU * 0.2 * f64::from(k) * t + f64::from(k * k)).cos()).sum::<f64>();
        let held = Held::new((0..1300).map(|k| k as f64 * PERIOD_S).map(|t| (t, 0.02 * sines(t))).collect());
        let drive = |delay_s: f64| -> Vec<f64> {
            let at = |k: usize| 0.2 + (k as f64 + 0.3) * period_s - delay_s;
            let mut integrals = held.integrals();
            (0..samples).filter_map(|k| integrals.mean(at(k), at(k + 1))).collect()
        };
        let (num, den) = (vec![288.0], vec![1.0, 4.8, 36.0]);
        let plant = Continuous { num, den, delay_s: 0.0, conversion: Conversion::Hold }.sampled(period_s);
        for seed in 1..=3 {
            let clean = plant.simulate(&drive(truth_s));
            let output: Vec<f64> = clean.iter().zip(noise(seed, samples)).map(|(y, e)| y + 0.002 * e).collect();
            let found = estimate(period_s, None, |timing, _| {
                Some(vec![Segment { input: drive(timing.delay_s), output: output.clone(), ..Segment::default() }])
            });
            let found = found.unwrap();
            assert!((found.delay_s - truth_s).abs() < 4.0 * found.sd_s && found.sd_s < 1e-3, "{seed}: {found:?}");
        }
    }

    /// Commands that hardly move anything say nothing of the delay.
    #[test]
    fn a_delay_that_the_data_do_not_tell_is_none() {
        let output = noise(3, 300);
        let drive = |delay_s: f64| -> Vec<f64> {
            (0..300).map(|k| 1e-12 * (TAU * 3.0 * (f64::from(k) * PERIOD_S - delay_s)).sin()).collect()
        };
        let found = estimate(PERIOD_S, None, |timing, _| {
            Some(vec![Segment { input: drive(timing.delay_s), output: output.clone(), ..Segment::default() }])
        });
        assert_eq!(found, None);
    }

    #[test]
    fn errors_are_as_large_as_the_noise_says() {
        let mut squares = [0.0; 3];
        for seed in 1..=20 {
            let found = estimated(0.02, 2e-4, 0.01, seed, &(0..0)).unwrap();
            // Here the model is exact: the method adds nothing.
            let of_noise = (found.sd_s.powi(2) - (METHOD_ERROR * PERIOD_S).powi(2)).sqrt();
            let (drift, zero) = (found.drift.unwrap(), found.zero.unwrap());
            let drift_sd = (drift.sd.powi(2) - 12.0 * (METHOD_ERROR / SAMPLES as f64).powi(2)).sqrt();
            let errors =
                [(found.delay_s - 0.02) / of_noise, (drift.rate - 2e-4) / drift_sd, (zero.offset - 0.01) / zero.sd];
            squares.iter_mut().zip(errors).for_each(|(sum, error)| *sum += error.powi(2) / 20.0);
            assert!(drift.is_significant() && zero.is_off(), "{found:?}");
        }
        assert!(squares.iter().all(|s| (0.4..1.9).contains(s)), "{squares:?}");
    }

    #[test]
    fn a_model_without_a_zero_is_that_of_its_h() {
        for den in [[1.0, 11.3, 355.3], [1.0, 40.0, 300.0], [1.0, 20.0, 100.0]] {
            let h = Continuous { num: vec![5.0], den: den.to_vec(), delay_s: 0.0, conversion: Conversion::Hold };
            let sampled = h.sampled(PERIOD_S);
            let found = Form::WithoutZero.near(&sampled).unwrap();
            let off = (found.parameters() - sampled.parameters()).amax();
            assert!(off < 1e-7 * sampled.b[0], "{den:?}: {off}");
        }
        assert_eq!(without_zero(0.5, 0.04, 1.0), None);
    }

    /// A pendulum of 6 rad/s hardly moves above 2 Hz, so that a zero of the model would imitate a delay: it has none.
    #[test]
    fn the_delay_is_told_where_a_zero_would_imitate_it() {
        let chirp = |k: usize| {
            let t = k as f64 * PERIOD_S;
            0.1 * (TAU * (0.2 * t + 1.9 * t * t / 40.0)).sin()
        };
        let held = Held::new((0..2460).map(|k| (k as f64 * PERIOD_S, chirp(k))).collect());
        let truth_s = 0.005;
        let (period_s, camera_s) = (1.0 / 59.97, 0.2);
        let mut squares = 0.0;
        for seed in 1..=5 {
            // Commands act in between frames, which their mean does not tell.
            let (mut angle, mut speed, mut frame) = (0.0_f64, 0.0_f64, 0);
            let noisy = noise(seed, 2300);
            let mut output = Vec::new();
            let step_s = PERIOD_S / 100.0;
            for k in 0.. {
                let t = k as f64 * step_s;
                if t >= camera_s + f64::from(frame) * period_s {
                    let Some(e) = noisy.get(output.len()) else { break };
                    output.push(angle + 0.0019 * e);
                    frame += 1;
                }
                let told = ((t - truth_s + 1e-9) / PERIOD_S).floor();
                let current = if told < 0.0 { 0.0 } else { chirp(told as usize) };
                speed += step_s * (108.0 * current - 3.6 * speed - 36.0 * angle);
                angle += step_s * speed;
            }
            let found = estimate(period_s, None, |timing, inputs| {
                let at = |k: usize| camera_s + k as f64 * period_s - timing.delay_s;
                let mut integrals = held.integrals();
                let input: Option<Vec<f64>> = (0..2300).map(|k| integrals.mean(at(k), at(k + 1))).collect();
                let input = input?;
                let part_s = period_s / PARTS as f64;
                let mut beyond = |k: usize, i: usize| {
                    let from = at(k) + i as f64 * part_s;
                    integrals.mean(from, from + part_s).unwrap_or(input[k]) - input[k]
                };
                let within = || (0..2300).map(|k| std::array::from_fn(|i| beyond(k, i))).collect();
                let within = (inputs == Inputs::Changing).then(within);
                Some(vec![Segment { within, input, output: output.clone(), ..Segment::default() }])
            })
            .unwrap();
            squares += ((found.delay_s - truth_s) / found.sd_s).powi(2) / 5.0;
            assert!(found.others_s.is_empty() && found.sd_s < 1e-3, "{found:?}");
        }
        assert!(squares < 2.5, "{squares}");
    }
}
