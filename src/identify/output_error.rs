//! Output error: y(t) = B(q)/A(q) u(t) + e(t), by Gauss-Newton on the simulated output.
//!
//! In: stretches, a stable model to start from. Out: the model whose simulation is nearest to the output, with covariance.
//! White noise on the measured output is just this case, where ARX is biased. Derivatives are filtered signals (Ljung, 2nd
//! ed., section 10.3): ∂ŷ/∂b_j = q^−(nk+j)/A u, ∂ŷ/∂a_i = −q^−i/A ŷ. Steps are damped after Levenberg and Marquardt; a step to
//! an unstable model is never taken. The state at the beginning of a stretch that does not begin at rest is fitted along.
//!
//! Finds a local minimum. Its covariance holds for white e, and for an input without noise.

use super::arx::Estimated;
use super::data::Segment;
use super::fit::free_part;
use super::model::{Polynomials, all_pole};
use super::regression::{Triangle, solve};
use super::IdentifyError;
use nalgebra::DMatrix;

const MOST_STEPS: usize = 100;
/// A step that lowers the sum of squares by less than this part ends the search.
const SETTLED: f64 = 1e-12;

/// A model refined, and how the search went.
#[derive(Debug, Clone)]
pub struct Refined {
    /// The model.
    pub estimated: Estimated,
    /// Steps taken.
    pub steps: usize,
    /// Whether it settled within the steps allowed.
    pub settled: bool,
}

/// Refines `start`, keeping its orders and delay.
///
/// # Errors
/// [`IdentifyError::Unstable`] when `start` is, [`IdentifyError::TooShort`] and [`IdentifyError::Dependent`] as for ARX.
pub fn refine(segments: &[Segment], start: &Polynomials) -> Result<Refined, IdentifyError> {
    let orders = super::arx::Orders { na: start.na(), nb: start.nb(), nk: start.nk };
    if !start.is_stable() {
        return Err(IdentifyError::Unstable { orders, largest_pole: start.largest_pole() });
    }
    let samples: usize = segments.iter().map(Segment::len).sum();
    let parameters = orders.parameters();
    if samples <= parameters {
        let longest = segments.iter().map(Segment::len).max().unwrap_or(0);
        return Err(IdentifyError::TooShort { orders, rows: samples, longest });
    }
    let mut model = start.clone();
    let mut triangle = linearise(segments, &model);
    let mut cost = squares(segments, &model);
    let (mut damping, mut steps, mut settled) = (1e-4, 0, false);
    while steps < MOST_STEPS && !settled {
        steps += 1;
        let step = damped_step(&triangle, damping).ok_or(IdentifyError::Dependent { orders })?;
        let trial = model.with_parameters((model.parameters() + step).as_slice());
        let trial_cost = if trial.is_stable() { squares(segments, &trial) } else { f64::INFINITY };
        if trial_cost < cost {
            settled = cost - trial_cost <= SETTLED * cost;
            (model, cost) = (trial, trial_cost);
            triangle = linearise(segments, &model);
            damping = f64::max(damping * 0.1, 1e-12);
        } else {
            // So small a step that nothing gets better: the bottom.
            settled = damping > 1e8;
            damping *= 10.0;
        }
    }
    let solution = solve(triangle).ok_or(IdentifyError::Dependent { orders })?;
    let noise_variance = cost / (samples - parameters) as f64;
    let estimated = Estimated {
        model,
        covariance: solution.cofactor * noise_variance,
        noise_variance,
        samples,
        condition: solution.condition,
    };
    Ok(Refined { estimated, steps, settled })
}

/// Simulated output of a stretch: from rest, or with the state at its beginning fitted.
fn simulated(segment: &Segment, model: &Polynomials) -> Vec<f64> {
    let mut output = model.simulate(&segment.input);
    if !segment.from_rest
        && let Some(free) = free_part(model, segment, &output)
    {
        output.iter_mut().zip(free).for_each(|(y, free)| *y += free);
    }
    output
}

fn squares(segments: &[Segment], model: &Polynomials) -> f64 {
    let of = |segment: &Segment| -> f64 {
        simulated(segment, model).iter().zip(&segment.output).map(|(m, y)| (y - m) * (y - m)).sum()
    };
    let sum: f64 = segments.iter().map(of).sum();
    if sum.is_finite() { sum } else { f64::INFINITY }
}

/// Derivatives and residual of all samples as a triangle.
fn linearise(segments: &[Segment], model: &Polynomials) -> DMatrix<f64> {
    let (na, nb, nk) = (model.na(), model.nb(), model.nk);
    let mut triangle = Triangle::new(na + nb + 1);
    for segment in segments {
        let output = simulated(segment, model);
        let by_input = all_pole(&model.a, segment.input.clone());
        let by_output = all_pole(&model.a, output.clone());
        let lagged = |signal: &[f64], t: usize, lag: usize| t.checked_sub(lag).map_or(0.0, |t| signal[t]);
        for t in 0..segment.len() {
            let outputs = (1..=na).map(|lag| -lagged(&by_output, t, lag));
            let inputs = (nk..nk + nb).map(|lag| lagged(&by_input, t, lag));
            triangle.push(outputs.chain(inputs).chain([segment.output[t] - output[t]]));
        }
    }
    triangle.finish()
}

/// Solves with the columns' own lengths, times √damping, below the triangle.
fn damped_step(triangle: &DMatrix<f64>, damping: f64) -> Option<nalgebra::DVector<f64>> {
    let p = triangle.ncols() - 1;
    let mut columns = triangle.clone().resize_vertically(triangle.nrows() + p, 0.0);
    for k in 0..p {
        columns[(triangle.nrows() + k, k)] = triangle.column(k).norm() * f64::sqrt(damping);
    }
    solve(columns).map(|solution| solution.parameters)
}
