//! An estimator's result: model, covariance, and course of the search.

use crate::identify::model::covariance::Covariance;
use crate::identify::model::polynomials::Polynomials;

/// A model with its uncertainty.
#[derive(Debug, Clone)]
pub struct Estimated {
    /// The model.
    pub model: Polynomials,
    /// Covariance of [`Polynomials::parameters`], in their order.
    pub covariance: Covariance,
    /// Variance of the residual, corrected for degrees of freedom.
    pub noise_variance: f64,
    /// Samples fitted.
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

/// A refined model, and the course of the search.
#[derive(Debug, Clone)]
pub struct Refined {
    /// The model.
    pub estimated: Estimated,
    /// Steps taken.
    pub steps: usize,
    /// Whether it converged within the allowed steps.
    pub converged: bool,
}
