//! An estimator's result: model, covariance, and course of the search.

use crate::identify::data::segments::Segment;
use crate::identify::model::covariance::Covariance;
use crate::identify::model::polynomials::Polynomials;
use std::collections::BTreeSet;

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

    /// The same, with what σ of each record's delay adds to the covariance. `again` gives the model of other data, near
    /// this one.
    ///
    /// Both parts are independent: with the delay known, noise moves the model by its part along the derivatives by the
    /// coefficients, and an estimate of the delay together with a model by a part that is orthogonal to these. (Where
    /// the delay is that of a simpler model, b₁ is better known than this says.)
    pub(in crate::identify) fn with_delays(
        self,
        segments: &[Segment],
        again: impl Fn(&[Segment], &Polynomials) -> Option<Polynomials>,
    ) -> Self {
        let uncertain: BTreeSet<usize> = segments.iter().filter(|s| s.by_delay.is_some()).map(|s| s.record).collect();
        let moved = |record: &usize| {
            let delayed = segments.iter().map(|s| s.delayed(f64::from(u8::from(s.record == *record))));
            Some(again(&delayed.collect::<Vec<_>>(), &self.model)?.parameters() - self.model.parameters())
        };
        let moves: Vec<_> = uncertain.iter().filter_map(moved).collect();
        Self { covariance: self.covariance.and(&moves), ..self }
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
