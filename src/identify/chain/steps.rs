//! From signals to models: the whole chain, with its steps in order.

use crate::identify::IdentifyError;
use crate::identify::chain::bootstrap::{middle_95, repeat};
use crate::identify::chain::identification::{Differs, Fit, Identification, left_percent};
use crate::identify::chain::settings::{Choice, Estimator, Settings};
use crate::identify::chain::warnings::diagnostics;
use crate::identify::checks::diagnostic::{Diagnostic, leaves_more_than_noise};
use crate::identify::checks::follows_input::{self, Left};
use crate::identify::checks::model_error::ModelError;
use crate::identify::checks::other_orders::{self, compared};
use crate::identify::checks::residuals::Residuals;
use crate::identify::checks::wrong_values::{leaves_sigma, wrong_values};
use crate::identify::data::segments::{Data, Record, Segment};
use crate::identify::data::spectrum::{Spectrum, spectrum};
use crate::identify::estimate::between_samples::{self, Answer, MAX_PASSES, is_settled};
use crate::identify::estimate::estimated::{Estimated, Refined};
use crate::identify::estimate::initial_models::initial_models;
use crate::identify::estimate::search::{Candidate, Criterion, best, search};
use crate::identify::estimate::shortest_delay::{as_well, is_better, shortest};
use crate::identify::estimate::{arx, instrumental, output_error};
use crate::identify::model::covariance::Covariance;
use crate::identify::model::modelled::{BodePoint, Modelled, Role, bandwidths};
use crate::identify::model::polynomials::{Noise, Orders, Polynomials, angle};
use crate::identify::model::reproduction::{InitialState, Kind, compare};
use crate::identify::periodic::{self, Periodic, Repeats};
use crate::identify::reduce::truncation::{Reduced, Reduction, Target, reduce, reduce_in_band};
use std::f64::consts::TAU;

/// Difference of the reduced model from the refined one, in σ, from which its σ is not given. Where σ is right, fewer
/// than one in twenty lie beyond.
const DIFFERS_SD: f64 = 2.0;

/// Identifies.
///
/// # Errors
/// [`IdentifyError`].
pub fn identify(data: &Data, settings: &Settings) -> Result<Identification, IdentifyError> {
    identify_with_progress(data, settings, &|_| {})
}

/// As [`identify`]; calls `progress` at the beginning of each step.
///
/// # Errors
/// As [`identify`].
pub(crate) fn identify_with_progress(
    data: &Data,
    settings: &Settings,
    progress: &dyn Fn(&str),
) -> Result<Identification, IdentifyError> {
    let records = data.training.iter().chain(&data.validation);
    if !between_samples::is_in(records.flat_map(|record| &record.segments)) {
        return identify_held(data, &data.training, settings, progress);
    }
    repeats(data, settings)?;
    progress("identifying as if commands came with the samples");
    let held = taken_off(data, &Settings { bootstrap: 0, repeats: None, ..settings.clone() })?;
    if let Some(held) = held
        && let Ok(done) = identify_held(&held, &data.training, settings, progress)
    {
        return Ok(Identification { held: Some(held), ..done });
    }
    let mut done = identify_held(data, &data.training, settings, progress)?;
    done.models.iter_mut().for_each(Modelled::forget_sigma);
    done.diagnostics.push(Diagnostic::BetweenSamples);
    Ok(done)
}

/// The data without what inputs do between samples, by the refined model of one identification after the other until
/// they agree; `None` where one of them has no H(s), or they do not.
///
/// # Errors
/// Those of the first.
fn taken_off(data: &Data, settings: &Settings) -> Result<Option<Data>, IdentifyError> {
    let found = identify_held(data, &data.training, settings, &|_| {})?;
    let excited_hz = excited_hz(found.spectrum.as_ref(), data.period_s);
    let mut orders = Settings { choice: settings.choice.of_orders(found.orders), ..settings.clone() };
    let own = |found: &Identification| Some(found.model(Role::Refined)?.continuous.as_ref()?.model.clone());
    let Some(mut last) = own(&found) else { return Ok(None) };
    for pass in 1..=MAX_PASSES {
        let Some(answer) = Answer::of(&last, data.period_s) else { break };
        let without = answer.taken_off_all(data);
        let Ok(found) = identify_held(&without, &data.training, &orders, &|_| {}) else { break };
        let Some(next) = own(&found) else { break };
        if is_settled(&last, &next, excited_hz) {
            return Ok(Some(without));
        }
        if let (2, Ok(refined)) = (pass, &found.refined) {
            // Two delays that explain the data about as well must not alternate.
            orders.choice = Choice::Fixed(Orders { nk: refined.estimated.model.nk, ..found.orders });
        }
        last = next;
    }
    Ok(None)
}

/// Identifies with inputs that are held between samples. `measured`: the records to be fitted, with their outputs as
/// they were measured.
fn identify_held(
    data: &Data,
    measured: &[Record],
    settings: &Settings,
    progress: &dyn Fn(&str),
) -> Result<Identification, IdentifyError> {
    let mut records = data.training.clone();
    if settings.initial_state == InitialState::Estimated {
        // Also for fitting, not only for comparing simulations, the initial state is unknown.
        records.iter_mut().flat_map(|record| &mut record.segments).for_each(|segment| segment.from_rest = false);
    }
    let (training, validation) = (segments_of(&records), segments_of(&data.validation));
    moves(&data.training)?;
    can_judge(&validation, &settings.choice)?;
    repeats(data, settings)?;
    // 1. orders and delay
    progress("searching orders and delay");
    let Chosen { candidates, criterion, orders: best } = choose(&training, &validation, settings)?;
    // 2. the full model
    progress("fitting the full model");
    let (orders, arx, full) = fit_full(&training, &candidates, criterion, best, settings.estimator)?;
    let estimated = full.as_ref().map_or(&arx, |refined| &refined.estimated);
    let spectrum = spectrum(&training, data.period_s);
    let excited_hz = excited_hz(spectrum.as_ref(), data.period_s);
    let excited = (angle(excited_hz.0, data.period_s), angle(excited_hz.1, data.period_s));
    let modelled = |role, title, model: &Polynomials, covariance| {
        Modelled::new(role, title, model.clone(), covariance, data.period_s, excited_hz)
    };
    let title = format!("{}, order {}", settings.estimator.words(), estimated.model.na());
    let mut models = vec![modelled(Role::Full, title, &estimated.model, Some(estimated.covariance.clone()))];
    // 3. fewer states
    let band = (!settings.all_frequencies).then_some(excited);
    let of_output = has_noise_of_output(&training);
    let delays = delays(&settings.choice);
    let attempt = |target: Target| {
        progress("fitting the refined model");
        Attempt::of(&training, estimated, Reduction { target, removal: settings.removal, band }, excited, &delays)
    };
    let mut taken = attempt(settings.target);
    let mut lower_order = match &taken.refined {
        Ok(found) if !of_output => other_orders::lowest(&training, &found.refined),
        _ => None,
    };
    if let (Target::Auto, Some(order)) = (settings.target, lower_order) {
        taken = attempt(Target::Order(order));
        lower_order = None;
    }
    let Attempt { how, unstable_in_band, reduced, refined: found } = taken;
    if let Ok(reduced) = &reduced {
        let covariance = reduced_covariance(estimated, reduced, how);
        let title = format!("reduced, order {}", reduced.model.order());
        models.push(modelled(Role::Reduced, title, &reduced.model, covariance));
    }
    // 4. the same order fitted to the data itself
    let (refined, other_delays, earlier_delay) = match found {
        Ok(found) => (Ok(found.refined), found.others, found.earlier.filter(|_| !of_output)),
        Err(why) => (Err(why), Vec::new(), None),
    };
    let mut objections = Objections::default();
    if let Ok(refined) = &refined {
        let Estimated { model, covariance, .. } = &refined.estimated;
        let shortest = delays.first().copied().unwrap_or(model.nk);
        objections = Objections::to(refined, &training, estimated, settings, shortest, earlier_delay.is_some());
        let title = format!("refined, order {}", model.order());
        models.push(modelled(Role::Refined, title, model, objections.is_sound.then(|| covariance.clone())));
    }
    let Objections { model_error, left, higher_order, .. } = objections;
    let wrong_values = wrong_values(&records, measured, &models, data.period_s);
    let right_values = !settings.doubtful && wrong_values.iter().all(leaves_sigma);
    if !right_values {
        models.iter_mut().filter(|m| m.role == Role::Refined).for_each(Modelled::forget_sigma);
    }
    // 5. averaged periods, where the input repeats
    if settings.repeats.is_some() {
        progress("averaging periods");
    }
    let periodic = fit_periods(data, settings, refined.as_ref().ok())?;
    if let Some(found) = &periodic {
        let Estimated { model, covariance, .. } = found.estimated();
        let title = format!("periods, order {}", model.order());
        let sound = right_values && found.explains_lines();
        models.push(modelled(Role::Periodic, title, model, sound.then(|| covariance.clone())));
    }
    // 6. how well they describe the records: what is left is no noise if it follows the input
    progress("comparing the models with the records");
    let fits = fits(&data.training, &data.validation, &models, settings.initial_state);
    let linear = spectrum.as_ref().map(Spectrum::linear_part);
    let is_no_noise = |model: &&mut Modelled| {
        let left = left_percent(&fits, model.role).filter(|_| matches!(model.role, Role::Refined | Role::Periodic));
        left.is_some_and(|left| leaves_more_than_noise(left, linear))
    };
    models.iter_mut().filter(is_no_noise).for_each(Modelled::forget_sigma);
    let reduced_differs = reduced_differs(&mut models, excited_hz);
    // An error of the delay moves the refined model as well: it explains no difference.
    let (arx, full) = with_delays(&training, (arx, full), settings.estimator);
    let estimated = full.as_ref().map_or(&arx, |refined| &refined.estimated);
    if training.iter().any(|segment| segment.by_delay.is_some()) {
        for model in models.iter_mut().filter(|model| model.covariance.is_some()) {
            let covariance = match (model.role, &reduced) {
                (Role::Full, _) => Some(estimated.covariance.clone()),
                (Role::Reduced, Ok(reduced)) => reduced_covariance(estimated, reduced, how),
                _ => continue,
            };
            *model = modelled(model.role, model.title.clone(), &model.model, covariance);
        }
    }
    // 7. uncertainty
    let residuals = Residuals::of(&estimated.model, &training, settings.estimator.noise());
    let biased =
        settings.estimator == Estimator::Arx && (of_output || !residuals.as_ref().is_some_and(Residuals::look_white));
    progress(&format!("repeating the experiment {} times (--bootstrap)", settings.bootstrap));
    let repetitions = intervals(&mut models, &training, data.period_s, excited_hz, how, settings, biased);
    let mut done = Identification {
        candidates,
        criterion,
        orders,
        full,
        reduced,
        refined,
        other_delays,
        earlier_delay,
        model_error,
        lower_order,
        higher_order,
        reduced_differs,
        left,
        wrong_values,
        periodic,
        models,
        fits,
        residuals,
        spectrum,
        repetitions,
        diagnostics: Vec::new(),
        arx,
        best_orders: best,
        unstable_in_band,
        held: None,
    };
    done.diagnostics = diagnostics(data, &done, settings);
    Ok(done)
}

/// The frequencies that inputs excite, hertz: all, where that is not known.
fn excited_hz(spectrum: Option<&Spectrum>, period_s: f64) -> (f64, f64) {
    spectrum.map_or((0.0, 0.5 / period_s), |spectrum| spectrum.excited_hz)
}

/// Orders and delay, and the candidates they were chosen from.
struct Chosen {
    candidates: Vec<Candidate>,
    criterion: Option<Criterion>,
    orders: Orders,
}

fn choose(training: &[Segment], validation: &[Segment], settings: &Settings) -> Result<Chosen, IdentifyError> {
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
fn fit_full(
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

/// What σ of the delays adds to σ of the full models.
fn with_delays(
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

/// The same model of other data.
fn refitted(training: &[Segment], full: &Polynomials, estimator: Estimator) -> Option<Polynomials> {
    match estimator {
        Estimator::Arx => Some(arx::fit(training, full.orders()).ok()?.model),
        Estimator::OutputError => Some(output_error::nearest(training, full).ok()?.model),
        Estimator::Instrumental => Some(instrumental::refine(training, full).ok()?.estimated.model),
    }
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

/// Covariance of the reduced model's coefficients, from that of the full model's.
fn reduced_covariance(full: &Estimated, reduced: &Reduced, how: Reduction) -> Option<Covariance> {
    // With the same number of states, whatever `auto` would choose for a nearby model.
    let same = Reduction { target: Target::Order(reduced.model.order()), ..how };
    let parameters = |p: &[f64]| {
        let moved = reduce(&full.model.with_parameters(p), same).ok()?.model;
        (moved.nk == reduced.model.nk).then(|| moved.parameters().as_slice().to_vec())
    };
    full.covariance.propagate(full.model.parameters().as_slice(), parameters)
}

/// A reduction and what came of refining it.
struct Attempt {
    how: Reduction,
    unstable_in_band: bool,
    reduced: Result<Reduced, String>,
    refined: Result<RefinedDelays, String>,
}

impl Attempt {
    fn of(training: &[Segment], full: &Estimated, how: Reduction, excited: (f64, f64), delays: &[usize]) -> Self {
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

/// Whether the output's noise is in its own input, as by Eq. 6.
fn has_noise_of_output(training: &[Segment]) -> bool {
    training.iter().any(|segment| segment.instrument.is_some())
}

/// What speaks against σ of the refined model: its errors may be those of its order, of a mean, of rows that are
/// shifted, or of feedback, and a σ of noise would be wrong.
#[derive(Default)]
struct Objections {
    model_error: Option<ModelError>,
    left: Option<Left>,
    higher_order: Option<usize>,
    is_sound: bool,
}

impl Objections {
    /// `full`: the full model; `shortest`: the shortest delay searched; `is_late`: an earlier one is better.
    fn to(
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
fn reduced_differs(models: &mut [Modelled], excited_hz: (f64, f64)) -> Option<Differs> {
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

/// What came of refining.
struct RefinedDelays {
    refined: Refined,
    /// Other delays that explain the data about as well.
    others: Vec<usize>,
    /// A delay below those searched that explains them clearly better.
    earlier: Option<usize>,
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

/// The delays that may be chosen, rising.
fn delays(choice: &Choice) -> Vec<usize> {
    let mut delays: Vec<usize> = match choice {
        Choice::Fixed(orders) => vec![orders.nk],
        Choice::Search { candidates, .. } => candidates.iter().map(|orders| orders.nk).collect(),
    };
    delays.sort_unstable();
    delays.dedup();
    delays
}

/// The model of the averaged periods of the data fitted, if their input repeats.
fn fit_periods(data: &Data, settings: &Settings, refined: Option<&Refined>) -> Result<Option<Periodic>, IdentifyError> {
    let Some(repeats) = settings.repeats else { return Ok(None) };
    let delays = delays(&settings.choice);
    let others: Vec<Polynomials> = refined.iter().map(|r| r.estimated.model.clone()).collect();
    let mut found = periodic::fit(&data.training, data.period_s, repeats, settings.target, &delays, &others)
        .map_err(|problem| IdentifyError::NotPeriodic { problem })?;
    let again = |delayed: &[Segment], model: &Polynomials| {
        let own = |k: usize| delayed.iter().filter(|segment| segment.record == k).cloned().collect();
        let records = data.training.iter().enumerate().map(|(k, r)| Record { segments: own(k), ..r.clone() });
        let (records, same) = (records.collect::<Vec<_>>(), Target::Order(model.na()));
        let initial = std::slice::from_ref(model);
        Some(
            periodic::fit(&records, data.period_s, repeats, same, &[model.nk], initial).ok()?.estimated().model.clone(),
        )
    };
    let estimated = found.estimated().clone();
    found.refined.estimated = estimated.with_delays(&segments_of(&data.training), again);
    Ok(Some(found))
}

fn segments_of(records: &[Record]) -> Vec<Segment> {
    let numbered = records.iter().enumerate().flat_map(|(record, r)| r.segments.iter().map(move |s| (record, s)));
    numbered.map(|(record, segment)| Segment { record, ..segment.clone() }).collect()
}

/// Largest values with which sums of squares can be computed.
const USABLE: std::ops::Range<f64> = 1e-100..1e100;

/// Input, output and the current behind the input must change: a torque of a constant current is the output's own.
fn moves(records: &[Record]) -> Result<(), IdentifyError> {
    let name = records.iter().map(|r| r.name.as_str()).collect::<Vec<_>>().join(", ");
    type Signal = fn(&Segment) -> &[f64];
    let signals: [(&'static str, Signal); 3] = [
        ("input", |s| &s.input),
        ("output", |s| &s.output),
        ("coil's current", |s| s.instrument.as_deref().unwrap_or_default()),
    ];
    let has_current = records.iter().flat_map(|r| &r.segments).any(|s| s.instrument.is_some());
    for (what, signal) in signals.into_iter().take(if has_current { 3 } else { 2 }) {
        let all = records.iter().flat_map(|r| &r.segments).flat_map(|s| signal(s).iter().copied());
        let values = all.filter(|v| !v.is_nan());
        let Some(first) = values.clone().next() else { return Err(IdentifyError::Nothing { name }) };
        if values.clone().all(|v| v == first) {
            return Err(IdentifyError::Still { name, what, value: first });
        }
        let largest = values.map(f64::abs).fold(0.0, f64::max);
        if !USABLE.contains(&largest) {
            return Err(IdentifyError::OutOfRange { name, what, largest });
        }
    }
    Ok(())
}

/// Checks that the input of each record repeats, where it is said to.
fn repeats(data: &Data, settings: &Settings) -> Result<(), IdentifyError> {
    let Some(Repeats { every_s, skip }) = settings.repeats else { return Ok(()) };
    for record in &data.training {
        if let Some(unrepeated) = periodic::unrepeated(&record.segments, data.period_s, every_s, skip) {
            let problem = unrepeated.in_words(every_s);
            return Err(IdentifyError::NotRepeated { name: record.name.clone(), every_s, problem });
        }
    }
    Ok(())
}

/// Checks that the validation data, if any, have samples that the largest model can predict.
fn can_judge(validation: &[Segment], choice: &Choice) -> Result<(), IdentifyError> {
    let largest = match choice {
        Choice::Fixed(orders) => Some(orders),
        Choice::Search { candidates, .. } => candidates.iter().max_by_key(|orders| orders.memory()),
    };
    match (largest, validation.iter().map(Segment::len).max()) {
        (Some(orders), Some(longest)) if longest <= orders.memory() => {
            Err(IdentifyError::TooShortToJudge { orders: *orders, longest })
        }
        _ => Ok(()),
    }
}

/// Every model on every record: simulated from both initial states, and predicted.
pub(in crate::identify) fn fits(
    training: &[Record],
    validation: &[Record],
    models: &[Modelled],
    initial_state: InitialState,
) -> Vec<Fit> {
    let other = if initial_state == InitialState::Rest { InitialState::Estimated } else { InitialState::Rest };
    let kinds = [Kind::Simulation(initial_state), Kind::Simulation(other), Kind::Prediction];
    let mut fits = Vec::new();
    let records = training.iter().map(|r| (r, true)).chain(validation.iter().map(|r| (r, false)));
    for (record, training) in records {
        // "From rest" here means from rest even for a part of a record, as in other programs; the result with an
        // estimated initial state is given as well.
        let at_rest = record.at_rest();
        for model in models {
            for kind in kinds {
                let record = if kind == Kind::Simulation(InitialState::Rest) { &at_rest } else { record };
                // Only the full model has a noise model for prediction.
                if kind == Kind::Prediction && model.role != Role::Full {
                    continue;
                }
                let error = compare(&model.model, &record.segments, kind);
                fits.push(Fit { record: record.name.clone(), training, role: model.role, kind, error });
            }
        }
    }
    fits
}

/// Adds intervals to the bandwidths; returns how many repetitions succeeded.
fn intervals(
    models: &mut [Modelled],
    training: &[Segment],
    period_s: f64,
    excited_hz: (f64, f64),
    how: Reduction,
    settings: &Settings,
    biased: bool,
) -> (usize, usize) {
    let of = |role, model: &Polynomials| -> Vec<Option<f64>> {
        bandwidths(role, model, period_s, excited_hz).iter().map(|b| b.frequency_hz).collect()
    };
    let model = |role| models.iter().find(|m| m.role == role).filter(|m| m.is_stable()).map(|m| m.model.clone());
    let mut full_draws = Vec::new();
    if let Some(full) = model(Role::Full) {
        let noise = settings.estimator.noise();
        full_draws = repeat(training, &full, noise, settings.bootstrap, |drawn| {
            let again = refitted(drawn, &full, settings.estimator)?;
            let reduced = reduce(&again, how).ok().map(|r| of(Role::Reduced, &r.model));
            Some((of(Role::Full, &again), reduced))
        });
    }
    let mut refined_draws = Vec::new();
    if let Some(refined) = model(Role::Refined) {
        refined_draws = repeat(training, &refined, Noise::Output, settings.bootstrap, |drawn| {
            let again = output_error::nearest(drawn, &refined).ok()?.model;
            Some(of(Role::Refined, &again))
        });
    }
    for model in models {
        if model.role == Role::Periodic {
            model.intervals_by_covariance(period_s, excited_hz);
            continue;
        }
        let draws: Vec<&Vec<Option<f64>>> = match model.role {
            Role::Full => full_draws.iter().map(|(full, _)| full).collect(),
            Role::Reduced => full_draws.iter().filter_map(|(_, reduced)| reduced.as_ref()).collect(),
            Role::Refined => refined_draws.iter().collect(),
            Role::Periodic | Role::Given => Vec::new(),
        };
        // The scatter of a biased estimate does not tell its error.
        let wrong_order = model.role == Role::Refined && model.covariance.is_none();
        if wrong_order || biased && matches!(model.role, Role::Full | Role::Reduced) {
            continue;
        }
        for (k, estimate) in model.bandwidths.iter_mut().enumerate() {
            // One without a bandwidth lies above all others.
            let hz = draws.iter().filter_map(|d| Some(d.get(k)?.unwrap_or(f64::INFINITY))).collect();
            let interval = middle_95(hz).filter(|(_, high)| high.is_finite());
            estimate.interval_hz = interval.filter(|_| estimate.bandwidth.frequency_hz.is_some());
        }
    }
    (full_draws.len(), refined_draws.len())
}
