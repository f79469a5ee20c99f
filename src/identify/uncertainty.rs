//! The covariance of what is computed from parameters, from theirs.

use nalgebra::DMatrix;

/// How far along each direction the parameters are moved to see what it does, in standard deviations.
const STEP: f64 = 0.05;

/// Covariance of `of(parameters)`, to first order. The parameters are moved along the axes of their error ellipsoid: coefficients
/// of a high order hang together so closely that one moved alone would be another model altogether. Nothing when `of` has no
/// answer, or not always as many values.
pub fn propagate(
    parameters: &[f64],
    covariance: &DMatrix<f64>,
    of: impl Fn(&[f64]) -> Option<Vec<f64>>,
) -> Option<DMatrix<f64>> {
    let values = of(parameters)?.len();
    let axes = covariance.clone().symmetric_eigen();
    let mut sum = DMatrix::zeros(values, values);
    for (variance, axis) in axes.eigenvalues.iter().zip(axes.eigenvectors.column_iter()) {
        let sd = variance.max(0.0).sqrt();
        let moved = |by: f64| {
            let moved: Vec<f64> = parameters.iter().zip(axis.iter()).map(|(p, a)| p + by * sd * a).collect();
            of(&moved).filter(|v| v.len() == values)
        };
        let (plus, minus) = (moved(STEP)?, moved(-STEP)?);
        let change = DMatrix::from_fn(values, 1, |k, _| (plus[k] - minus[k]) / (2.0 * STEP));
        sum += &change * change.transpose();
    }
    sum.iter().all(|v| v.is_finite()).then_some(sum)
}

/// Square roots of the diagonal.
pub fn standard_errors(covariance: &DMatrix<f64>) -> Vec<f64> {
    covariance.diagonal().iter().map(|v| v.max(0.0).sqrt()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn linear_functions_are_exact_and_others_nearly() {
        let covariance = DMatrix::from_row_slice(2, 2, &[0.04, 0.019, 0.019, 0.01]);
        let of = |p: &[f64]| Some(vec![2.0 * p[0] - 3.0 * p[1], p[0].exp()]);
        let found = propagate(&[1.0, 2.0], &covariance, of).unwrap();
        assert!((found[(0, 0)] - (4.0 * 0.04 - 12.0 * 0.019 + 9.0 * 0.01)).abs() < 1e-12);
        assert!((found[(1, 1)].sqrt() - 0.2 * 1_f64.exp()).abs() < 1e-4);
        assert!(propagate(&[1.0, 2.0], &covariance, |_| None).is_none());
    }
}
