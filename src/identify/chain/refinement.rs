//! From the full model to one of fewer states, reduced and refined; and what speaks against the σ of both.

use crate::identify::IdentifyError;
use crate::identify::chain::full::refitted;
use crate::identify::chain::identification::Differs;
use crate::identify::chain::settings::{Estimator, Settings};
use crate::identify::checks::follows_input::{self, Left};
use crate::identify::checks::model_error::ModelError;
use crate::identify::checks::other_orders::{self, compared};
use crate::identify::data::segments::Segment;
use crate::identify::estimate::estimated::{Estimated, Refined};
use crate::identify::estimate::initial_models::initial_models;
use crate::identify::estimate::output_error;
use crate::identify::estimate::shortest_delay::{as_well, is_better, shortest};
use crate::identify::model::covariance::Covariance;
use crate::identify::model::modelled::{BodePoint, Modelled, Role};
use crate::identify::model::polynomials::Polynomials;
use crate::identify::reduce::truncation::{Reduced, Reduction, Target, reduce, reduce_in_band};
use std::f64::consts::TAU;

/// Difference of the reduced model from the refined one, in σ, from which its σ is not given. Where σ is right, fewer
/// than one in twenty lie beyond.
const DIFFERS_SD: f64 = 2.0;

/// A reduction and what came of refining it.
pub(super) struct Attempt {
    pub(super) how: Reduction,
    pub(super) unstable_in_band: bool,
    pub(super) reduced: Result<Reduced, String>,
    pub(super) refined: Result<RefinedDelays, String>,
}

impl Attempt {
    pub(super) fn of(
        training: &[Segment],
        full: &Estimated,
        how: Reduction,
        excited: (f64, f64),
        delays: &[usize],
    ) -> Self {
        let reduced = reduce_in_band(&full.model, how);
        let unstable_in_band = matches!(reduced, Ok((_, true)));
        let how = if unstable_in_band { Reduction { band: None, ..how } } else { how };
        let reduced = reduced.map(|(reduced, _)| reduced).map_err(|e| e.to_string());
        let in_band = Reduction { band: how.band.or(Some(excited)), ..how };
        let refined = match &reduced {
            Ok(reduced) => refine_reduced(training, full, reduced, in_band, delays).map_err(|e| e.to_string()),
            Err(_) => Err("there is no reduced model to begin from".to_owned()),
        };
        Self { how, unstable_in_band, reduced, refined }
    }
}

/// What came of refining.
pub(super) struct RefinedDelays {
    pub(super) refined: Refined,
    /// Other delays that explain the data about as well.
    pub(super) others: Vec<usize>,
    /// A delay below those searched that explains them clearly better.
    pub(super) earlier: Option<usize>,
}

/// Output error of the reduced model's orders, and other delays with which it explains the data about as well. The
/// reduction for the excited band is often closer to the data than the requested one. The full model's delay need not
/// be that of a model with fewer coefficients: those next to one that explains the data are tried. Of those that do
/// about as well, noise decides which does best; the shortest is taken.
fn refine_reduced(
    training: &[Segment],
    full: &Estimated,
    reduced: &Reduced,
    in_band: Reduction,
    delays: &[usize],
) -> Result<RefinedDelays, IdentifyError> {
    let in_band = Reduction { target: Target::Order(reduced.model.order()), ..in_band };
    let mut initial = vec![reduced.model.clone()];
    initial.extend(reduce(&full.model, in_band).ok().map(|r| r.model));
    initial.extend(initial_models(training, reduced.model.orders()));
    let first = output_error::refine_from_any(training, &initial)?;
    let mut tried = vec![first.estimated.model.nk];
    let mut found = vec![first];
    let again = |model: Polynomials| {
        let mut initial = initial_models(training, model.orders());
        initial.push(model);
        output_error::refine_from_any(training, &initial).ok()
    };
    let (refined, others) = loop {
        let by_colour = compared(training, &found);
        let next = as_well(&by_colour).find_map(|tried_one| {
            let here = &tried_one.refined.estimated.model;
            let nk = delays.iter().find(|nk| nk.abs_diff(here.nk) == 1 && !tried.contains(nk))?;
            Some(Polynomials { nk: *nk, ..here.clone() })
        });
        let Some(delayed) = next else {
            let (taken, others) = shortest(&by_colour).ok_or(IdentifyError::NoneDetermined)?;
            break (taken.refined, others);
        };
        tried.push(delayed.nk);
        found.extend(again(delayed));
    };
    let nearest = |delayed: &[Segment], model: &Polynomials| refitted(delayed, model, Estimator::OutputError);
    let refined = Refined { estimated: refined.estimated.with_delays(training, nearest), ..refined };
    // A system may answer sooner than was searched.
    let model = &refined.estimated.model;
    let sooner = model.nk.checked_sub(1).filter(|_| delays.iter().all(|nk| *nk >= model.nk));
    let sooner = sooner.filter(|_| follows_input::colour(training, model).is_some());
    let earlier = sooner.and_then(|nk| {
        let other = again(Polynomials { nk, ..model.clone() })?;
        let both = compared(training, &[refined.clone(), other]);
        is_better(both.last()?, both.first()?).then_some(nk)
    });
    Ok(RefinedDelays { refined, others, earlier })
}

/// Covariance of the reduced model's coefficients, from that of the full model's.
pub(super) fn reduced_covariance(full: &Estimated, reduced: &Reduced, how: Reduction) -> Option<Covariance> {
    // With the same number of states, whatever `auto` would choose for a nearby model.
    let same = Reduction { target: Target::Order(reduced.model.order()), ..how };
    let parameters = |p: &[f64]| {
        let moved = reduce(&full.model.with_parameters(p), same).ok()?.model;
        (moved.nk == reduced.model.nk).then(|| moved.parameters().as_slice().to_vec())
    };
    full.covariance.propagate(full.model.parameters().as_slice(), parameters)
}

/// Whether the output's noise is in its own input, as by Eq. 6.
pub(super) fn has_noise_of_output(training: &[Segment]) -> bool {
    training.iter().any(|segment| segment.instrument.is_some())
}

/// What speaks against σ of the refined model: its errors may be those of its order, of a mean, of rows that are
/// shifted, or of feedback, and a σ of noise would be wrong.
#[derive(Default)]
pub(super) struct Objections {
    pub(super) model_error: Option<ModelError>,
    pub(super) left: Option<Left>,
    pub(super) higher_order: Option<usize>,
    pub(super) is_sound: bool,
}

impl Objections {
    /// `full`: the full model; `shortest`: the shortest delay searched; `is_late`: an earlier one is better.
    pub(super) fn to(
        refined: &Refined,
        training: &[Segment],
        full: &Estimated,
        settings: &Settings,
        shortest: usize,
        is_late: bool,
    ) -> Self {
        let model_error = ModelError::of(training, full, &refined.estimated, settings.initial_state);
        // By Eq. 6 what is left follows the input by its own noise.
        let of_output = has_noise_of_output(training);
        let left = if of_output { None } else { Left::of(training, &refined.estimated.model, shortest) };
        let doubted = left
            .is_some_and(|left| left.follows() || left.is_off_centre() || !settings.commanded && left.is_fed_back());
        let sound = model_error.is_none() && !is_late && !doubted;
        let higher_order = if sound && !of_output { other_orders::higher(training, refined) } else { None };
        Self { model_error, left, higher_order, is_sound: sound && higher_order.is_none() }
    }
}

/// Takes σ from the reduced model where the refined one differs from it by more than that allows, or has none: σ of ARX
/// does not contain what noise of the output biases it by. Returns by how many σ, where that is known.
pub(super) fn reduced_differs(models: &mut [Modelled], excited_hz: (f64, f64)) -> Option<Differs> {
    let refined = models.iter().find(|m| m.role == Role::Refined)?.clone();
    let reduced = models.iter_mut().find(|m| m.role == Role::Reduced && m.covariance.is_some())?;
    let sigmas = refined.covariance.as_ref().map(|_| {
        // Of a band without a point, the nearest one.
        let beside = |p: &BodePoint| (excited_hz.0 - p.frequency_hz).max(p.frequency_hz - excited_hz.1).max(0.0);
        let least = refined.bode.iter().map(beside).fold(f64::INFINITY, f64::min);
        let in_band = |p: &BodePoint| beside(p) <= least;
        let both = reduced.bode.iter().zip(&refined.bode).filter(|(p, _)| in_band(p));
        let off = both.filter_map(|(p, q)| {
            let (gain_sd, phase_sd) = p.sd?;
            let turn = (p.phase_rad - q.phase_rad).rem_euclid(TAU);
            Some(((p.magnitude / q.magnitude).ln().abs() / gain_sd).max(turn.min(TAU - turn) / phase_sd))
        });
        off.fold(0.0, f64::max)
    });
    if sigmas.is_some_and(|sigmas| sigmas < DIFFERS_SD) {
        return None;
    }
    reduced.forget_sigma();
    Some(Differs { sigmas })
}
