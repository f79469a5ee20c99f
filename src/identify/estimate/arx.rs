//! ARX: A(q) y(t) = B(q) u(t) + e(t), by least squares.
//!
//! In: evenly sampled segments, orders, delay. Out: coefficients with their covariance. Every sample with a full past
//! in its own segment is one row; the first samples of a segment serve only as past.
//!
//! Assumes that e is white: only then is the covariance right and the estimate unbiased. White noise only on the output
//! is a different case (see [`output_error`](super::output_error)), and so is an input computed from the noisy output
//! (see [`instrumental`](super::instrumental)). [`residuals`](crate::identify::checks::residuals) detects these,
//! nothing here does.

use crate::identify::IdentifyError;
use crate::identify::data::segments::Segment;
use crate::identify::estimate::estimated::Estimated;
use crate::identify::model::covariance::Covariance;
use crate::identify::model::polynomials::{Orders, Polynomials};
use crate::identify::solve::regression::{Triangle, row, solve};

/// Fits a model of these orders to all segments at once.
///
/// # Errors
/// [`IdentifyError::TooShort`] when there are fewer rows than parameters, [`IdentifyError::Dependent`] when the
/// regressors do not determine the parameters.
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
