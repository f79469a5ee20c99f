//! Output error: y(t) = B(q)/A(q) u(t) + e(t), by Gauss-Newton on the simulated output.
//!
//! In: segments, a stable initial model. Out: the model whose simulation is nearest to the output, with covariance.
//! This is the right model for white noise on the measured output, where ARX is biased. Derivatives are filtered
//! signals (Ljung, 2nd ed., section 10.3): ∂ŷ/∂b_j = q^−(nk+j)/A u, ∂ŷ/∂a_i = −q^−i/A ŷ. A step to an unstable model is
//! never taken. The initial state of a segment that does not begin at rest is also fitted.
//!
//! Finds a local minimum. Its covariance holds for white e, and for an input without noise.

use super::IdentifyError;
use super::colour::Colour;
use super::data::Segment;
use super::descent::Descent;
use super::estimated::{Estimated, Refined};
use super::model::{Polynomials, all_pole};
use super::regression::{Triangle, solve};
use super::uncertainty::Covariance;
use nalgebra::{DMatrix, DVector, DVectorViewMut};

const DESCENT: Descent = Descent { first_damping: 1e-4, tolerance: 1e-12, max_steps: 100 };

/// Refines each of `initial` and returns the result nearest to the output: the sum of squares has several minima.
///
/// # Errors
/// That of [`refine`] for the first, when none can be refined.
pub(crate) fn refine_from_any(segments: &[Segment], initial: &[Polynomials]) -> Result<Refined, IdentifyError> {
    let mut first_error = None;
    let mut best: Option<Refined> = None;
    for model in initial {
        match refine(segments, model) {
            Ok(found) => {
                let nearer = |b: &Refined| found.estimated.noise_variance < b.estimated.noise_variance;
                if best.as_ref().is_none_or(nearer) {
                    best = Some(found);
                }
            }
            Err(error) => {
                first_error.get_or_insert(error);
            }
        }
    }
    best.ok_or_else(|| first_error.unwrap_or(IdentifyError::Nothing { name: "output error".to_owned() }))
}

/// Refines `initial`, keeping its orders and delay.
///
/// # Errors
/// As [`nearest`], and [`IdentifyError::Dependent`] when the derivatives do not determine the parameters.
pub(crate) fn refine(segments: &[Segment], initial: &Polynomials) -> Result<Refined, IdentifyError> {
    let Nearest { model, noise_variance, samples, steps, converged } = nearest(segments, initial)?;
    let parts = segments.iter().map(|segment| derivatives_and_residual(segment, &model));
    let (derivatives, residuals): (Vec<_>, Vec<_>) = parts.unzip();
    let mut triangle = Triangle::new(model.na() + model.nb() + 1);
    for (derivatives, residual) in derivatives.iter().zip(&residuals) {
        let rows = derivatives.row_iter().zip(residual);
        rows.for_each(|(row, left)| triangle.push(row.iter().chain([left]).copied()));
    }
    let dependent = || IdentifyError::Dependent { orders: model.orders() };
    let solution = solve(triangle.finish()).ok_or_else(dependent)?;
    let factor = Colour::of(&residuals).factor(&derivatives, &solution.inverse);
    let estimated = Estimated {
        model,
        covariance: Covariance::from_factor(factor * noise_variance.sqrt()),
        noise_variance,
        samples,
        condition: solution.condition,
    };
    Ok(Refined { estimated, steps, converged })
}

/// The model nearest to the output, without its uncertainty.
#[derive(Debug, Clone)]
pub(crate) struct Nearest {
    pub(crate) model: Polynomials,
    noise_variance: f64,
    samples: usize,
    steps: usize,
    converged: bool,
}

/// Searches from `initial`, keeping its orders and delay.
///
/// # Errors
/// [`IdentifyError::Unstable`] when `initial` is, [`IdentifyError::TooShort`] and [`IdentifyError::Dependent`] as for
/// ARX.
pub(crate) fn nearest(segments: &[Segment], initial: &Polynomials) -> Result<Nearest, IdentifyError> {
    let orders = initial.orders();
    if !initial.is_stable() {
        return Err(IdentifyError::Unstable { orders, largest_pole: initial.largest_pole() });
    }
    let samples: usize = segments.iter().map(Segment::observed).sum();
    // Each segment that does not begin at rest has its own initial state.
    let states: usize = segments.iter().filter_map(|s| free_initial_state(s, initial)).map(|open| open.ncols()).sum();
    let parameters = orders.parameters() + states;
    if samples <= parameters {
        let longest = segments.iter().map(Segment::len).max().unwrap_or(0);
        return Err(IdentifyError::TooShort { orders, rows: samples, longest });
    }
    let cost = |model: &Polynomials| if model.is_stable() { squares(segments, model) } else { f64::INFINITY };
    let triangle = |model: &Polynomials| Some(linearise(segments, model));
    let found =
        DESCENT.run(initial.clone(), cost, triangle, Polynomials::moved).ok_or(IdentifyError::Dependent { orders })?;
    let noise_variance = found.cost / (samples - parameters) as f64;
    Ok(Nearest { model: found.at, noise_variance, samples, steps: found.steps, converged: found.converged })
}

/// Possible contributions of the initial state to the output of a segment that does not begin at rest: orthonormal
/// columns. They are projected out of residual and derivatives, which implicitly fits the state (variable projection;
/// Kaufman, BIT 15, 1975, doi:10.1007/BF01932995).
fn free_initial_state(segment: &Segment, model: &Polynomials) -> Option<DMatrix<f64>> {
    if segment.from_rest || segment.len() <= model.memory() || model.memory() == 0 {
        return None;
    }
    let at = model.free_responses(segment.len());
    let known = |t: usize, state: usize| if segment.output[t].is_nan() { 0.0 } else { at(t, state) };
    Some(DMatrix::from_fn(segment.len(), model.memory(), known).qr().q())
}

/// Removes the part of `signal` in the span of `open`; returns the removed part.
fn project_out(open: &DMatrix<f64>, signal: &mut DVectorViewMut<'_, f64>) -> DVector<f64> {
    let part = open * open.tr_mul(signal);
    *signal -= &part;
    part
}

/// Output from rest, and the residual of the observed output without the free initial state; zero where nothing was
/// observed.
fn residual(segment: &Segment, model: &Polynomials, open: Option<&DMatrix<f64>>) -> (Vec<f64>, DVector<f64>) {
    let mut output = model.simulate(&segment.input);
    let mut left = DVector::from_iterator(
        output.len(),
        segment.output.iter().zip(&output).map(|(y, m)| if y.is_nan() { 0.0 } else { y - m }),
    );
    if let Some(open) = open {
        let free = project_out(open, &mut left.rows_mut(0, output.len()));
        output.iter_mut().zip(free.iter()).for_each(|(y, free)| *y += free);
    }
    (output, left)
}

/// Sum of squared residuals; infinite where the simulation diverges.
pub(super) fn squares(segments: &[Segment], model: &Polynomials) -> f64 {
    let of = |s: &Segment| residual(s, model, free_initial_state(s, model).as_ref()).1.norm_squared();
    let sum: f64 = segments.iter().map(of).sum();
    if sum.is_finite() { sum } else { f64::INFINITY }
}

/// Derivatives and residual of all samples as a triangle.
fn linearise(segments: &[Segment], model: &Polynomials) -> DMatrix<f64> {
    let mut triangle = Triangle::new(model.na() + model.nb() + 1);
    for segment in segments {
        each_row(segment, model, None, |row| triangle.push(row.iter().copied()));
    }
    triangle.finish()
}

/// Derivatives of a segment's samples, a row each, and their residuals; zero and NaN where nothing was observed.
fn derivatives_and_residual(segment: &Segment, model: &Polynomials) -> (DMatrix<f64>, Vec<f64>) {
    let width = model.na() + model.nb();
    let (mut derivatives, mut residual) = (DMatrix::zeros(segment.len(), width), vec![f64::NAN; segment.len()]);
    let mut observed = (0..segment.len()).filter(|t| !segment.output[*t].is_nan());
    each_row(segment, model, None, |row| {
        if let Some(t) = observed.next() {
            derivatives.row_mut(t).iter_mut().zip(row).for_each(|(to, from)| *to = *from);
            residual[t] = row[width];
        }
    });
    (derivatives, residual)
}

/// Passes `take` a row for each observed sample: derivatives of the simulated output with respect to
/// [`Polynomials::parameters`], then `further`, the derivative with respect to one more parameter, then the residual.
pub(super) fn each_row(segment: &Segment, model: &Polynomials, further: Option<&[f64]>, mut take: impl FnMut(&[f64])) {
    let (na, nb, nk) = (model.na(), model.nb(), model.nk);
    let open = free_initial_state(segment, model);
    let (output, left) = residual(segment, model, open.as_ref());
    let by_input = all_pole(&model.a, segment.input.clone());
    let by_output = all_pole(&model.a, output);
    let lagged = |signal: &[f64], t: usize, lag: usize| t.checked_sub(lag).map_or(0.0, |t| signal[t]);
    let derivative = |t: usize, k: usize| match k.checked_sub(na) {
        None => -lagged(&by_output, t, k + 1),
        Some(j) if j < nb => lagged(&by_input, t, nk + j),
        Some(_) => further.and_then(|further| further.get(t)).copied().unwrap_or(0.0),
    };
    let width = na + nb + usize::from(further.is_some());
    let observed = |t: &usize| !segment.output[*t].is_nan();
    let mut row = vec![0.0; width + 1];
    if let Some(open) = open {
        let mut columns =
            DMatrix::from_fn(segment.len(), width, |t, k| if observed(&t) { derivative(t, k) } else { 0.0 });
        columns.column_iter_mut().for_each(|mut column| drop(project_out(&open, &mut column.as_view_mut())));
        for t in (0..segment.len()).filter(observed) {
            row.iter_mut().zip(columns.row(t).iter().chain([&left[t]])).for_each(|(place, value)| *place = *value);
            take(&row);
        }
    } else {
        for t in (0..segment.len()).filter(observed) {
            for (k, place) in row.iter_mut().enumerate() {
                *place = if k < width { derivative(t, k) } else { left[t] };
            }
            take(&row);
        }
    }
}
