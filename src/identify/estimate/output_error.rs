//! Output error: y(t) = B(q)/A(q) u(t) + e(t), by Gauss-Newton on the simulated output.
//!
//! In: segments, a stable initial model. Out: the model whose simulation is nearest to the output, with covariance.
//! This is the right model for white noise on the measured output, where ARX is biased. Derivatives are filtered
//! signals (Ljung, 2nd ed., section 10.3): ∂ŷ/∂b_j = q^−(nk+j)/A u, ∂ŷ/∂a_i = −q^−i/A ŷ. A step to an unstable model is
//! never taken. The initial state of a segment that does not begin at rest is also fitted, and the output's zero
//! where it is not known.
//!
//! Finds a local minimum. Its covariance holds for noise of any colour (`noise_colour`), also where it varies with the
//! excitation ([`excess_variance`]), and for an input without noise.

use crate::identify::IdentifyError;
use crate::identify::data::segments::Segment;
use crate::identify::estimate::estimated::{Estimated, Refined};
use crate::identify::estimate::noise_colour::Colour;
use crate::identify::estimate::unknown_zero::{self, Columns};
use crate::identify::model::covariance::Covariance;
use crate::identify::model::polynomials::{Polynomials, all_pole};
use crate::identify::solve::descent::Descent;
use crate::identify::solve::regression::{Triangle, solve};
use crate::varying_noise::excess_variance;
use nalgebra::{DMatrix, DVector, DVectorViewMut};
use rayon::prelude::*;
use std::collections::BTreeMap;

const DESCENT: Descent = Descent { first_damping: 1e-4, tolerance: 1e-12, max_steps: 100 };

/// Refines each of `initial` and returns the result nearest to the output: the sum of squares has several minima.
///
/// # Errors
/// When none can be refined: that of [`nearest`] for one of them, or [`IdentifyError::Dependent`].
pub(in crate::identify) fn refine_from_any(
    segments: &[Segment],
    initial: &[Polynomials],
) -> Result<Refined, IdentifyError> {
    let searched: Vec<_> = initial.par_iter().map(|model| nearest(segments, model)).collect();
    let (mut ends, mut errors) = (Vec::new(), Vec::new());
    for end in searched {
        match end {
            Ok(end) => ends.push(end),
            Err(error) => errors.push(error),
        }
    }
    ends.sort_by(|a, b| a.noise_variance.total_cmp(&b.noise_variance));
    for end in ends {
        match end.refined(segments) {
            Ok(found) => return Ok(found),
            Err(error) => errors.push(error),
        }
    }
    Err(errors.into_iter().next().unwrap_or(IdentifyError::Nothing { name: "output error".to_owned() }))
}

/// Refines `initial`, keeping its orders and delay.
///
/// # Errors
/// As [`nearest`], and [`IdentifyError::Dependent`] when the derivatives do not determine the parameters.
#[cfg(test)]
pub(in crate::identify) fn refine(segments: &[Segment], initial: &Polynomials) -> Result<Refined, IdentifyError> {
    nearest(segments, initial)?.refined(segments)
}

/// The model nearest to the output, without its uncertainty.
#[derive(Debug, Clone)]
pub(in crate::identify) struct Nearest {
    pub(in crate::identify) model: Polynomials,
    noise_variance: f64,
    samples: usize,
    steps: usize,
    converged: bool,
}

impl Nearest {
    /// The same with its uncertainty.
    ///
    /// # Errors
    /// [`IdentifyError::Dependent`] when the derivatives do not determine the parameters.
    fn refined(self, segments: &[Segment]) -> Result<Refined, IdentifyError> {
        let Self { model, noise_variance, samples, steps, converged } = self;
        let linearised = linearised(segments, &model, Derivatives::OfModel);
        let dependent = || IdentifyError::Dependent { orders: model.orders() };
        let solution = solve(triangle(segments, &linearised)).ok_or_else(dependent)?;
        let parts = segments.iter().zip(linearised).map(|(segment, rows)| derivatives_and_residual(segment, rows));
        let (derivatives, residuals): (Vec<_>, Vec<_>) = parts.unzip();
        let colour = Colour::of(&residuals);
        let mut factor = colour.factor(&derivatives, &solution.inverse);
        let alike = colour.correlated_samples();
        let back = &solution.inverse * solution.inverse.transpose();
        let moves: Vec<DMatrix<f64>> = derivatives.iter().map(|rows| rows * &back).collect();
        let sd = noise_variance.sqrt();
        for (k, mut row) in factor.row_iter_mut().enumerate() {
            let samples = moves.iter().zip(&residuals).flat_map(|(moves, residuals)| {
                residuals.iter().enumerate().map(move |(t, residual)| (moves[(t, k)], residual / sd))
            });
            row *= excess_variance(samples.filter(|(_, residual)| !residual.is_nan()), alike).sqrt();
        }
        let estimated = Estimated {
            model,
            covariance: Covariance::from_factor(factor * sd),
            noise_variance,
            samples,
            condition: solution.condition,
        };
        Ok(Refined { estimated, steps, converged })
    }
}

/// Searches from `initial`, keeping its orders and delay.
///
/// # Errors
/// [`IdentifyError::Unstable`] when `initial` is, [`IdentifyError::TooShort`] and [`IdentifyError::Dependent`] as for
/// ARX.
pub(in crate::identify) fn nearest(segments: &[Segment], initial: &Polynomials) -> Result<Nearest, IdentifyError> {
    let orders = initial.orders();
    if !initial.is_stable() {
        return Err(IdentifyError::Unstable { orders, largest_pole: initial.largest_pole() });
    }
    let samples: usize = segments.iter().map(Segment::observed).sum();
    let parameters = orders.parameters() + fitted_besides(segments, initial);
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

/// Numbers that are fitted besides the model: initial states and zeros, which are projected out.
pub(super) fn fitted_besides(segments: &[Segment], model: &Polynomials) -> usize {
    // Each segment that does not begin at rest has its own initial state.
    let states: usize = segments.iter().filter_map(|s| free_initial_state(s, model)).map(|open| open.ncols()).sum();
    let zeros = segments.iter().filter(|s| s.by_zero.is_some());
    let zeros: BTreeMap<usize, usize> = zeros.map(|s| (s.record, 1 + usize::from(s.zero_drifts))).collect();
    states + zeros.values().sum::<usize>()
}

/// Possible contributions of the initial state to the output of a segment that does not begin at rest: orthonormal
/// columns. They are projected out of residual and derivatives, which implicitly fits the state (variable projection;
/// Kaufman, BIT 15, 1975, doi:10.1007/BF01932995). Of a segment with no more samples than its state has numbers nothing
/// is left: some state explains all of it.
fn free_initial_state(segment: &Segment, model: &Polynomials) -> Option<DMatrix<f64>> {
    if segment.from_rest || model.memory() == 0 {
        return None;
    }
    let observed: Vec<usize> = (0..segment.len()).filter(|t| !segment.output[*t].is_nan()).collect();
    if observed.len() <= model.memory() {
        return Some(DMatrix::from_fn(segment.len(), observed.len(), |t, k| f64::from(observed[k] == t)));
    }
    let at = model.free_responses(segment.len());
    let known = |t: usize, state: usize| if segment.output[t].is_nan() { 0.0 } else { at(t, state) };
    Some(DMatrix::from_fn(segment.len(), model.memory(), known).qr().q())
}

/// Residuals from which the output's zero is not projected out, as one column for each segment.
pub(super) fn residuals(segments: &[Segment], model: &Polynomials) -> Vec<Columns> {
    segments.iter().map(|segment| columns(segment, model, Derivatives::None, None)).collect()
}

/// Derivatives and residual apart; the residual is NaN where nothing was observed.
pub(in crate::identify) fn derivatives_and_residual(segment: &Segment, rows: DMatrix<f64>) -> (DMatrix<f64>, Vec<f64>) {
    let last = rows.ncols() - 1;
    let seen = |(left, y): (&f64, &f64)| if y.is_nan() { f64::NAN } else { *left };
    let residual = rows.column(last).iter().zip(&segment.output).map(seen).collect();
    (rows.remove_column(last), residual)
}

/// Removes the part of `signal` in the span of `open`; returns the removed part.
fn project_out(open: &DMatrix<f64>, signal: &mut DVectorViewMut<'_, f64>) -> DVector<f64> {
    let part = open * open.tr_mul(signal);
    *signal -= &part;
    part
}

/// Sum of squared residuals; infinite where the simulation diverges.
pub(super) fn squares(segments: &[Segment], model: &Polynomials) -> f64 {
    let sum: f64 = linearised(segments, model, Derivatives::None).iter().map(DMatrix::norm_squared).sum();
    if sum.is_finite() { sum } else { f64::INFINITY }
}

/// Derivatives and residual of all samples as a triangle.
fn linearise(segments: &[Segment], model: &Polynomials) -> DMatrix<f64> {
    triangle(segments, &linearised(segments, model, Derivatives::OfModel))
}

/// The rows of the observed samples as a triangle.
pub(super) fn triangle(segments: &[Segment], rows: &[DMatrix<f64>]) -> DMatrix<f64> {
    let mut triangle = Triangle::new(rows.first().map_or(0, DMatrix::ncols));
    for (segment, rows) in segments.iter().zip(rows) {
        for (_, row) in rows.row_iter().enumerate().filter(|(t, _)| !segment.output[*t].is_nan()) {
            triangle.push(row.iter().copied());
        }
    }
    triangle.finish()
}

/// Which derivatives of the simulated output are wanted.
#[derive(Debug, Clone, Copy)]
pub(in crate::identify) enum Derivatives<'a> {
    None,
    /// With respect to [`Polynomials::parameters`].
    OfModel,
    /// These, and then those with respect to further parameters, a column each, given for each segment.
    And(&'a [DMatrix<f64>]),
}

/// For each segment a row per sample: the derivatives of the simulated output, then the residual; zero where nothing
/// was observed. Initial states and the output's zero are projected out where they are free.
pub(in crate::identify) fn linearised(
    segments: &[Segment],
    model: &Polynomials,
    wanted: Derivatives<'_>,
) -> Vec<DMatrix<f64>> {
    let further = |k: usize| if let Derivatives::And(further) = wanted { further.get(k) } else { None };
    let of = |(k, segment)| columns(segment, model, wanted, further(k));
    let mut all: Vec<Columns> = segments.iter().enumerate().map(of).collect();
    unknown_zero::project_out(&mut all);
    all.into_iter().map(|columns| columns.matrix).collect()
}

/// The columns of one segment, without its initial state.
fn columns(segment: &Segment, model: &Polynomials, wanted: Derivatives<'_>, further: Option<&DMatrix<f64>>) -> Columns {
    let (na, nb, nk) = (model.na(), model.nb(), model.nk);
    let open = free_initial_state(segment, model);
    let mut output = model.simulate(&segment.input);
    let seen = |t: usize, value: f64| if segment.output[t].is_nan() { 0.0 } else { value };
    let mut left = DVector::from_fn(segment.len(), |t, _| seen(t, segment.output[t] - output[t]));
    let mut by_zero = unknown_zero::response(segment, model);
    if let Some(open) = &open {
        let free = project_out(open, &mut left.column_mut(0));
        output.iter_mut().zip(free.iter()).for_each(|(y, free)| *y += free);
        let columns = by_zero.iter_mut().flat_map(DMatrix::column_iter_mut);
        columns.for_each(|mut column| drop(project_out(open, &mut column)));
    }
    let derivatives = match wanted {
        Derivatives::None => 0,
        Derivatives::OfModel => na + nb,
        Derivatives::And(_) => na + nb + further.map_or(0, DMatrix::ncols),
    };
    let mut matrix = DMatrix::zeros(segment.len(), derivatives + 1);
    matrix.set_column(derivatives, &left);
    if derivatives > 0 {
        let by_input = all_pole(&model.a, segment.input.clone());
        let by_output = all_pole(&model.a, output);
        let lagged = |signal: &[f64], t: usize, lag: usize| t.checked_sub(lag).map_or(0.0, |t| signal[t]);
        let derivative = |t: usize, k: usize| match k.checked_sub(na) {
            None => -lagged(&by_output, t, k + 1),
            Some(j) if j < nb => lagged(&by_input, t, nk + j),
            Some(j) => further.and_then(|further| further.get((t, j - nb))).copied().unwrap_or(0.0),
        };
        for (k, mut column) in matrix.column_iter_mut().enumerate().take(derivatives) {
            column.iter_mut().enumerate().for_each(|(t, place)| *place = seen(t, derivative(t, k)));
            open.iter().for_each(|open| drop(project_out(open, &mut column)));
        }
    }
    Columns { record: segment.record, matrix, by_zero }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::identify::tests::noise;

    #[test]
    fn initial_states_and_zeros_are_counted() {
        let model = Polynomials { a: vec![1.0, -1.5, 0.7], b: vec![1.0, 0.5], nk: 1 };
        let segment = |record: usize, from_rest: bool| {
            let by_zero = Some(vec![0.0; 50]);
            Segment { input: noise(1, 50), output: noise(2, 50), by_zero, record, from_rest, ..Segment::default() }
        };
        // Two states in each of two segments, and the zeros of two records.
        assert_eq!(fitted_besides(&[segment(0, true), segment(0, false), segment(1, false)], &model), 6);
    }

    /// Rows that are lost close together leave a stretch too short to tell its own state.
    #[test]
    fn a_stretch_shorter_than_the_memory_tells_nothing() {
        let model = Polynomials { a: vec![1.0, -1.5, 0.7], b: vec![1.0, 0.5], nk: 2 };
        let (input, error) = (noise(1, 400), noise(2, 400));
        let output: Vec<f64> = model.simulate(&input).iter().zip(&error).map(|(y, e)| y + 0.01 * e).collect();
        let part = |from: usize, to: usize| Segment {
            input: input[from..to].to_vec(),
            output: output[from..to].to_vec(),
            from_rest: from == 0,
            ..Segment::default()
        };
        let (whole, short) = ([part(0, 200), part(205, 400)], [part(0, 200), part(201, 204), part(205, 400)]);
        let [without, with] = [&whole[..], &short[..]].map(|segments| refine(segments, &model).unwrap().estimated);
        assert!((without.model.parameters() - with.model.parameters()).norm() < 1e-9);
        assert!((without.noise_variance / with.noise_variance - 1.0).abs() < 1e-9);
        let sd = |of: &Estimated| of.covariance.matrix().trace().sqrt();
        assert!((sd(&with) / sd(&without) - 1.0).abs() < 0.05, "{} {}", sd(&with), sd(&without));
    }
}
