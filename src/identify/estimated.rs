//! A model as an estimator returns it: coefficients, their covariance, and how the search went.

use super::model::Polynomials;
use super::uncertainty::Covariance;

/// A model with what is known of its errors.
#[derive(Debug, Clone)]
pub struct Estimated {
    /// The model.
    pub model: Polynomials,
    /// Covariance of [`Polynomials::parameters`], in their order.
    pub covariance: Covariance,
    /// Variance of the residual, degrees of freedom taken off.
    pub noise_variance: f64,
    /// Samples that were fitted.
    pub samples: usize,
    /// Condition number of the regressors, each scaled to length 1.
    pub condition: f64,
}

impl Estimated {
    /// Standard errors of [`Polynomials::parameters`].
    pub fn standard_errors(&self) -> Vec<f64> {
        self.covariance.standard_errors()
    }
}

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
