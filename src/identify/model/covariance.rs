//! Covariances, and their propagation through functions of the parameters.
//!
//! A covariance is kept as a factor F with F Fᵀ = covariance. For coefficients of a high order, σ of different
//! combinations differ by more than eight powers of ten; in the covariance itself the small ones are lost, and with
//! them the accuracy of the response where the data determine it best.

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

/// Step along each direction for numerical derivatives, in standard deviations.
const STEP: f64 = 0.05;
/// Standard deviations from the mean within which a normal distribution has 95 %.
const SD_OF_95: f64 = 1.959_964;

/// The covariance of some numbers.
#[derive(Debug, Clone, PartialEq)]
pub struct Covariance {
    /// One row per number; its columns are independent moves by one standard deviation.
    factor: DMatrix<f64>,
}

impl Covariance {
    /// The covariance F Fᵀ.
    pub fn from_factor(factor: DMatrix<f64>) -> Self {
        Self { factor }
    }

    /// The same, and independent moves by one standard deviation for other reasons.
    pub(in crate::identify) fn and(self, moves: &[DVector<f64>]) -> Self {
        let columns: Vec<_> =
            self.factor.column_iter().map(|column| column.into_owned()).chain(moves.to_vec()).collect();
        Self { factor: DMatrix::from_columns(&columns) }
    }

    /// The covariance as a matrix.
    pub fn matrix(&self) -> DMatrix<f64> {
        &self.factor * self.factor.transpose()
    }

    /// Square roots of the diagonal.
    pub fn standard_errors(&self) -> Vec<f64> {
        self.factor.row_iter().map(|row| row.norm()).collect()
    }

    /// Covariance of `of(parameters)`, to first order, if `self` is that of `parameters`. They are moved jointly, along
    /// the columns of the factor: a single coefficient of a high order moved alone would give a completely different
    /// model. `None` when `of` fails, or returns varying numbers of values.
    pub fn propagate(&self, parameters: &[f64], of: impl Fn(&[f64]) -> Option<Vec<f64>> + Sync) -> Option<Self> {
        let values = of(parameters)?.len();
        let along = |k: usize| {
            let direction = self.factor.column(k);
            let moved = |by: f64| {
                let moved: Vec<f64> = parameters.iter().zip(direction.iter()).map(|(p, d)| p + by * d).collect();
                of(&moved).filter(|v| v.len() == values)
            };
            let (plus, minus) = (moved(STEP)?, moved(-STEP)?);
            Some(plus.iter().zip(&minus).map(|(p, m)| (p - m) / (2.0 * STEP)).collect())
        };
        let columns: Option<Vec<Vec<f64>>> = (0..self.factor.ncols()).into_par_iter().map(along).collect();
        let factor = DMatrix::from_vec(values, self.factor.ncols(), columns?.concat());
        factor.iter().all(|v| v.is_finite()).then_some(Self { factor })
    }

    /// The 95 % interval of `of(parameters)`: its values 1.96 σ away on either side, along the direction in which it
    /// changes most. That follows its curvature, as a profile of the likelihood does (Pawitan, In All Likelihood,
    /// section 3.4), to the accuracy of the direction. `None` when `of` has no value there: the interval is open.
    pub(super) fn interval_95(
        &self,
        parameters: &[f64],
        of: impl Fn(&[f64]) -> Option<f64> + Sync,
    ) -> Option<(f64, f64)> {
        let gradient = self.propagate(parameters, |p| of(p).map(|value| vec![value]))?.factor;
        let direction = &self.factor * gradient.transpose() / gradient.norm();
        let at = |by: f64| {
            let moved: Vec<f64> = parameters.iter().zip(direction.iter()).map(|(p, d)| p + by * d).collect();
            of(&moved)
        };
        let (low, middle, high) = (at(-SD_OF_95)?, of(parameters)?, at(SD_OF_95)?);
        (low < middle && middle < high).then_some((low, high))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn linear_functions_are_exact_and_others_nearly() {
        // Of [0.04, 0.019; 0.019, 0.01].
        let factor = DMatrix::from_row_slice(2, 2, &[0.2, 0.0, 0.095, (0.01_f64 - 0.095 * 0.095).sqrt()]);
        let covariance = Covariance::from_factor(factor);
        assert!((covariance.matrix()[(0, 1)] - 0.019).abs() < 1e-15);
        let errors = covariance.standard_errors();
        assert!((errors[0] - 0.2).abs() < 1e-15 && (errors[1] - 0.1).abs() < 1e-15);
        let of = |p: &[f64]| Some(vec![2.0 * p[0] - 3.0 * p[1], p[0].exp()]);
        let found = covariance.propagate(&[1.0, 2.0], of).unwrap();
        assert!((found.matrix()[(0, 0)] - (4.0 * 0.04 - 12.0 * 0.019 + 9.0 * 0.01)).abs() < 1e-12);
        assert!((found.standard_errors()[1] - 0.2 * 1_f64.exp()).abs() < 1e-4);
        assert!(covariance.propagate(&[1.0, 2.0], |_| None).is_none());
    }

    #[test]
    fn an_interval_follows_a_curved_function_and_may_be_open() {
        let covariance = Covariance::from_factor(DMatrix::from_row_slice(2, 2, &[0.3, 0.0, 0.2, 0.1]));
        // The sum has σ = √(0.5² + 0.1²).
        let reach = 1.959_964 * 0.26_f64.sqrt();
        let (low, high) = covariance.interval_95(&[1.0, 1.0], |p| Some((p[0] + p[1]).exp())).unwrap();
        assert!((low - (2.0 - reach).exp()).abs() < 1e-3 && (high - (2.0 + reach).exp()).abs() < 1e-2, "{low} {high}");
        let until = |p: &[f64]| Some(p[0] + p[1]).filter(|sum| *sum < 2.5);
        assert_eq!(covariance.interval_95(&[1.0, 1.0], until), None);
    }

    #[test]
    fn what_is_known_best_keeps_its_sigma() {
        // A sum known to 1e-12, a difference to 1: the covariance itself keeps no digit of the first.
        let factor = DMatrix::from_row_slice(2, 2, &[5e-13, 0.5, 5e-13, -0.5]);
        let of = |p: &[f64]| Some(vec![p[0] + p[1]]);
        let found = Covariance::from_factor(factor).propagate(&[0.0, 0.0], of).unwrap();
        assert!((found.standard_errors()[0] / 1e-12 - 1.0).abs() < 1e-9, "{found:?}");
    }
}
