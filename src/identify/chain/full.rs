//! The full model: its orders and delay, its estimator, and its σ.

use crate::identify::IdentifyError;
use crate::identify::chain::settings::{Choice, Estimator, Settings};
use crate::identify::data::segments::Segment;
use crate::identify::estimate::estimated::{Estimated, Refined};
use crate::identify::estimate::initial_models::initial_models;
use crate::identify::estimate::search::{Candidate, Criterion, best, search};
use crate::identify::estimate::{arx, instrumental, output_error};
use crate::identify::model::polynomials::{Orders, Polynomials};

/// Orders and delay, and the candidates they were chosen from.
pub(super) struct Chosen {
    pub(super) candidates: Vec<Candidate>,
    pub(super) criterion: Option<Criterion>,
    pub(super) orders: Orders,
}

pub(super) fn choose(
    training: &[Segment],
    validation: &[Segment],
    settings: &Settings,
) -> Result<Chosen, IdentifyError> {
    match &settings.choice {
        Choice::Fixed(orders) => Ok(Chosen { candidates: Vec::new(), criterion: None, orders: *orders }),
        Choice::Search { candidates, criterion } => {
            let usual = if validation.is_empty() { Criterion::Mdl } else { Criterion::Simulation };
            let criterion = criterion.unwrap_or(usual);
            let candidates = search(training, validation, settings.initial_state, candidates)?;
            if candidates.is_empty() {
                return Err(IdentifyError::NoneDetermined);
            }
            let best = best(&candidates, criterion).ok_or(IdentifyError::NoneStable { tried: candidates.len() })?;
            let orders = best.orders;
            Ok(Chosen { candidates, criterion: Some(criterion), orders })
        }
    }
}

/// The full model by least squares and, if requested, by another estimator. If that fails for the orders found, lower
/// ones may be used.
pub(super) fn fit_full(
    training: &[Segment],
    candidates: &[Candidate],
    criterion: Option<Criterion>,
    best: Orders,
    estimator: Estimator,
) -> Result<(Orders, Estimated, Option<Refined>), IdentifyError> {
    let fit = |orders: Orders| -> Result<_, IdentifyError> {
        let arx = arx::fit(training, orders)?;
        let full = full_model(training, &arx, estimator)?;
        Ok((orders, arx, full))
    };
    fit(best).or_else(|error| {
        let smaller = |c: &&Candidate| c.orders.parameters() < best.parameters() && c.largest_pole < 1.0;
        let mut others: Vec<&Candidate> = candidates.iter().filter(smaller).collect();
        let value = |c: &Candidate| criterion.and_then(|by| c.value(by)).unwrap_or(f64::INFINITY);
        others.sort_by(|a, b| value(a).total_cmp(&value(b)));
        others.into_iter().find_map(|candidate| fit(candidate.orders).ok()).ok_or(error)
    })
}

/// The full model by another estimator than least squares, if requested.
fn full_model(training: &[Segment], arx: &Estimated, estimator: Estimator) -> Result<Option<Refined>, IdentifyError> {
    match estimator {
        Estimator::Arx => Ok(None),
        Estimator::OutputError => {
            let initial = initial_models(training, arx.model.orders());
            output_error::refine_from_any(training, &initial).map(Some)
        }
        Estimator::Instrumental => instrumental::refine(training, &arx.model).map(Some),
    }
}

/// The same model of other data.
pub(super) fn refitted(training: &[Segment], full: &Polynomials, estimator: Estimator) -> Option<Polynomials> {
    match estimator {
        Estimator::Arx => Some(arx::fit(training, full.orders()).ok()?.model),
        Estimator::OutputError => Some(output_error::nearest(training, full).ok()?.model),
        Estimator::Instrumental => Some(instrumental::refine(training, full).ok()?.estimated.model),
    }
}

/// What σ of the delays adds to σ of the full models.
pub(super) fn with_delays(
    training: &[Segment],
    (arx, full): (Estimated, Option<Refined>),
    estimator: Estimator,
) -> (Estimated, Option<Refined>) {
    let wider = |found: Estimated, estimator: Estimator| {
        found.with_delays(training, |delayed, model| refitted(delayed, model, estimator))
    };
    let full = full.map(|full| Refined { estimated: wider(full.estimated, estimator), ..full });
    (wider(arx, Estimator::Arx), full)
}
