//! Instrumental variables: ARX's equation solved by correlation with signals that are independent of the noise.
//!
//! Eq. 6 computes the torque from the measured θ, so the input carries the output's noise and ARX is biased. The
//! instruments here are made from the coil current alone (or from the input, if there is no feedback): its past
//! replaces the input's, and the output simulated from it replaces the output's. All signals are filtered by 1/A of the
//! previous model, which makes the estimate nearly as good as output error for white noise on the output (simplified
//! refined instrumental variables; Young, Recursive Estimation and Time-Series Analysis, 2nd ed., chapter 7).
//!
//! In: segments with `instrument`, a stable initial model. Out: a model of the same orders with covariance.

use crate::identify::IdentifyError;
use crate::identify::data::segments::Segment;
use crate::identify::estimate::arx;
use crate::identify::estimate::estimated::{Estimated, Refined};
use crate::identify::model::covariance::Covariance;
use crate::identify::model::polynomials::{Orders, Polynomials, all_pole};
use crate::identify::model::reproduction::free_response;
use crate::identify::solve::decompositions::extreme_singular_values;
use crate::identify::solve::regression::{Triangle, row};

const MAX_STEPS: usize = 50;
/// Converged when parameters change by less than this fraction of their standard errors.
const PARAMETER_TOLERANCE: f64 = 1e-6;

/// Refines `initial`, keeping its orders and delay.
///
/// # Errors
/// [`IdentifyError::Unstable`] when `initial` is or becomes unstable, [`IdentifyError::Dependent`] when the instruments
/// do not determine the parameters, [`IdentifyError::TooShort`] as for ARX.
pub(in crate::identify) fn refine(segments: &[Segment], initial: &Polynomials) -> Result<Refined, IdentifyError> {
    let orders = initial.orders();
    let drivers: Vec<Segment> = segments.iter().map(driven_by_instrument).collect();
    // The response of the output to the instrument: linear here, whatever the true feedback. An instrument needs no
    // more.
    let auxiliary = arx::fit(&drivers, orders)?.model;
    let auxiliary = if auxiliary.is_stable() { auxiliary } else { initial.clone() };
    let mut current: Option<Estimated> = None;
    let mut model = initial.clone();
    for steps in 1..=MAX_STEPS {
        if !model.is_stable() {
            return Err(IdentifyError::Unstable { orders, largest_pole: model.largest_pole() });
        }
        let next = step(segments, &drivers, &model, &auxiliary, orders)?;
        let change = (next.model.parameters() - model.parameters()).abs();
        let converged =
            change.iter().zip(next.standard_errors()).all(|(change, sd)| *change <= PARAMETER_TOLERANCE * sd);
        model = next.model.clone();
        if converged {
            return Ok(Refined { estimated: next, steps, converged });
        }
        current = Some(next);
    }
    match current {
        Some(estimated) if model.is_stable() => Ok(Refined { estimated, steps: MAX_STEPS, converged: false }),
        _ => Err(IdentifyError::Unstable { orders, largest_pole: model.largest_pole() }),
    }
}

fn driven_by_instrument(segment: &Segment) -> Segment {
    let input = segment.instrument.clone().unwrap_or_else(|| segment.input.clone());
    Segment { input, ..segment.clone() }
}

/// One solution with filters and instruments from `model`.
fn step(
    segments: &[Segment],
    drivers: &[Segment],
    model: &Polynomials,
    auxiliary: &Polynomials,
    orders: Orders,
) -> Result<Estimated, IdentifyError> {
    let Orders { na, nb, nk } = orders;
    let p = orders.parameters();
    // QR of instruments, regressors and output together: with Z = Q R the first rows of the rest are QᵀΦ and Qᵀy.
    let mut triangle = Triangle::new(2 * p + 1);
    let filtered = |segment: &Segment, output: Vec<f64>| Segment {
        input: all_pole(&model.a, segment.input.clone()),
        output: all_pole(&model.a, output),
        ..Segment::default()
    };
    for (segment, driver) in segments.iter().zip(drivers) {
        let instruments = filtered(driver, auxiliary.simulate(&driver.input));
        let simulated = model.simulate(&segment.input);
        let free = if segment.from_rest { None } else { free_response(model, segment, &simulated) };
        let free = free.unwrap_or_else(|| vec![0.0; segment.len()]);
        // The filters bridge unobserved outputs with the model's; their rows are left out.
        let known = |t: usize| !segment.output[t].is_nan();
        let output =
            (0..segment.len()).map(|t| if known(t) { segment.output[t] - free[t] } else { simulated[t] }).collect();
        let regressors = filtered(segment, output);
        for t in (orders.memory()..segment.len()).filter(|t| (t - na..=*t).all(known)) {
            let instruments = row(&instruments, t, (na, nb, nk)).take(p);
            triangle.push(instruments.chain(row(&regressors, t, (na, nb, nk))));
        }
    }
    let samples = triangle.rows();
    if samples <= p {
        let longest = segments.iter().map(Segment::len).max().unwrap_or(0);
        return Err(IdentifyError::TooShort { orders, rows: samples, longest });
    }
    let r = triangle.finish();
    let dependent = || IdentifyError::Dependent { orders };
    let correlation = r.view((0, p), (p, p)).into_owned();
    let mut scaled = correlation.clone();
    scaled.column_iter_mut().for_each(|mut column| column /= column.norm());
    let (largest, smallest) = extreme_singular_values(scaled).ok_or_else(dependent)?;
    let inverse = correlation.try_inverse().ok_or_else(dependent)?;
    let parameters = &inverse * r.view((0, 2 * p), (p, 1));
    if parameters.iter().any(|v| !v.is_finite()) {
        return Err(dependent());
    }
    // The residual is that of all rows, not only of the instruments'.
    let left = r.view((0, 2 * p), (2 * p + 1, 1)) - r.view((0, p), (2 * p + 1, p)) * &parameters;
    let noise_variance = left.norm_squared() / (samples - p) as f64;
    Ok(Estimated {
        model: Polynomials::of(parameters.as_slice(), na, nk),
        covariance: Covariance::from_factor(inverse * noise_variance.sqrt()),
        noise_variance,
        samples,
        condition: largest / smallest,
    })
}
