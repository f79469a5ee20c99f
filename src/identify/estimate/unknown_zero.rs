//! The unknown zero of the output: each record's measured angle is off by a constant.
//!
//! A catheter hangs at rest where nobody knows θ to better than the base frame's σ. Measured from a zero that lies δ
//! too low, the angle is θ + δ, and Eq. 6 gives a torque that is too small by δ w with w = −∂torque/∂θ. To first order
//! the output is then `G u + δ d` with `d = 1 + G w`. Left out, δ would be taken for a slow pole, which integrates it.
//!
//! The output is linear in δ, so that `d` is projected out of residual and derivatives of the whole record, which fits
//! δ along with the model (variable projection, as for initial states in [`output_error`](super::output_error)).
//!
//! Where means or lines were taken off input and output (`--detrend`), what is left of both together is such a zero of
//! the output alone, d = 1, or a line.

use crate::identify::data::segments::Segment;
use crate::identify::estimate::noise_colour::Colour;
use crate::identify::model::covariance::Covariance;
use crate::identify::model::polynomials::Polynomials;
use nalgebra::DMatrix;
use std::collections::BTreeMap;

/// Significance limit, in σ.
const SIGNIFICANT_SD: f64 = 3.3;

/// By how much the measured output of a record is too high.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Zero {
    /// Unit of the output.
    pub offset: f64,
    /// Its standard error.
    pub sd: f64,
}

impl Zero {
    /// Whether it is off by more than chance explains.
    pub(crate) fn is_off(&self) -> bool {
        self.offset.abs() > SIGNIFICANT_SD * self.sd
    }
}

/// Columns of a segment with a row for each sample, zero where nothing was observed.
#[derive(Debug, Clone)]
pub(super) struct Columns {
    pub(super) record: usize,
    pub(super) matrix: DMatrix<f64>,
    /// d, if the zero is fitted, and the record's time, if it drifts.
    pub(super) by_zero: Option<DMatrix<f64>>,
}

/// d without the initial state, and the time in thousands of samples, if the zero drifts.
pub(super) fn response(segment: &Segment, model: &Polynomials) -> Option<DMatrix<f64>> {
    let by_input = model.simulate(segment.by_zero.as_deref()?);
    let at = |t: usize, column: usize| match column {
        _ if segment.output[t].is_nan() => 0.0,
        0 => 1.0 + by_input[t],
        _ => 1e-3 * (segment.first + t) as f64,
    };
    Some(DMatrix::from_fn(segment.len(), 1 + usize::from(segment.zero_drifts), at))
}

/// Takes d out of the columns of each record.
pub(super) fn project_out(segments: &mut [Columns]) {
    let parts = parts(segments);
    for Columns { record, matrix, by_zero } in segments {
        if let (Some(by_zero), Some((part, _))) = (by_zero, parts.get(record)) {
            matrix.gemm(-1.0, by_zero, part, 1.0);
        }
    }
}

/// The multiples of d nearest to each column, and the squares of d, of each record whose zero is fitted.
fn parts(segments: &[Columns]) -> BTreeMap<usize, (DMatrix<f64>, DMatrix<f64>)> {
    let mut sums: BTreeMap<usize, (DMatrix<f64>, DMatrix<f64>)> = BTreeMap::new();
    for Columns { record, matrix, by_zero } in segments {
        if let Some(by_zero) = by_zero {
            let free = by_zero.ncols();
            let none = || (DMatrix::zeros(free, matrix.ncols()), DMatrix::zeros(free, free));
            let (products, squares) = sums.entry(*record).or_insert_with(none);
            *products += by_zero.tr_mul(matrix);
            *squares += by_zero.tr_mul(by_zero);
        }
    }
    let nearest = |(record, (products, squares)): (usize, (DMatrix<f64>, DMatrix<f64>))| {
        let multiples = squares.clone().cholesky()?.solve(&products);
        Some((record, (multiples, squares)))
    };
    sums.into_iter().filter_map(nearest).collect()
}

/// The zero of one record that goes with the parameters of a model and more. `residual` gives the residuals of any
/// parameters, as one column; `colour` and `noise_variance` are those of the residuals with the zero fitted.
pub(super) fn zero(
    parameters: &[f64],
    covariance: &Covariance,
    residual: impl Fn(&[f64]) -> Option<Vec<Columns>> + Sync,
    (colour, noise_variance): (&Colour, f64),
) -> Option<Zero> {
    let nearest = |p: &[f64]| parts(&residual(p)?).into_values().next();
    let (offset, squares) = nearest(parameters)?;
    let of_model = covariance.propagate(parameters, |p| Some(vec![nearest(p)?.0.sum()]))?;
    let of_noise = noise_variance * colour.correlated_samples() / squares.sum();
    let sd = (of_model.standard_errors().first()?.powi(2) + of_noise).sqrt();
    Some(Zero { offset: offset.sum(), sd })
}
