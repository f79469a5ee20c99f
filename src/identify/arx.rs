//! ARX: A(q) y(t) = B(q) u(t) + e(t), by least squares.
//!
//! In: evenly sampled stretches, orders, delay. Out: coefficients with their covariance. Every sample that has a full past in
//! its own stretch is one row; the first of a stretch have none and serve as past only.
//!
//! Assumes that e is white: only then is the covariance right and the estimate free of bias. White noise on the output alone
//! is not that case (see [`output_error`](super::output_error)), nor is an input that was computed from the noisy output
//! (see [`instrumental`](super::instrumental)); [`residuals`](super::residuals) shows it, nothing here does.

use super::IdentifyError;
use super::data::Segment;
use super::model::{Polynomials, memory};
use super::regression::{Triangle, row, solve};
use super::uncertainty::Covariance;

/// Orders and delay of an ARX model.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Orders {
    /// Past outputs.
    pub na: usize,
    /// Inputs.
    pub nb: usize,
    /// Delay, samples.
    pub nk: usize,
}

impl Orders {
    /// Parameters to be estimated.
    pub fn parameters(&self) -> usize {
        self.na + self.nb
    }

    /// Samples without a full past at the beginning of a stretch.
    pub fn memory(&self) -> usize {
        memory(self.na, self.nb, self.nk)
    }
}

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

/// Fits a model of these orders to all stretches at once.
///
/// # Errors
/// [`IdentifyError::TooShort`] when there are fewer rows than parameters, [`IdentifyError::Dependent`] when the regressors do
/// not determine the parameters.
pub fn fit(segments: &[Segment], orders: Orders) -> Result<Estimated, IdentifyError> {
    let Orders { na, nb, nk } = orders;
    let parameters = orders.parameters();
    let mut triangle = Triangle::new(parameters + 1);
    for segment in segments {
        for t in orders.memory()..segment.len() {
            triangle.push(row(segment, t, (na, nb, nk)));
        }
    }
    let samples = triangle.rows();
    if samples <= parameters {
        let longest = segments.iter().map(Segment::len).max().unwrap_or(0);
        return Err(IdentifyError::TooShort { orders, rows: samples, longest });
    }
    let solution = solve(triangle.finish()).ok_or(IdentifyError::Dependent { orders })?;
    let noise_variance = solution.residual / (samples - parameters) as f64;
    Ok(Estimated {
        model: Polynomials::of(solution.parameters.as_slice(), na, nk),
        covariance: Covariance::from_factor(solution.inverse * noise_variance.sqrt()),
        noise_variance,
        samples,
        condition: solution.condition,
    })
}

#[cfg(test)]
#[path = "arx_tests.rs"]
pub(super) mod tests;
