//! From signals to models: the whole chain, with its steps in order.

use crate::identify::IdentifyError;
use crate::identify::chain::bootstrap::{middle_95, repeat};
use crate::identify::chain::full::{Chosen, choose, fit_full, refitted, with_delays};
use crate::identify::chain::identification::{Fit, Identification, left_percent};
use crate::identify::chain::refinement::{
    Attempt, Objections, has_noise_of_output, reduced_covariance, reduced_differs,
};
use crate::identify::chain::settings::{Choice, Estimator, Settings};
use crate::identify::chain::usable::{can_judge, moves, repeats};
use crate::identify::chain::warnings::diagnostics;
use crate::identify::checks::diagnostic::{Diagnostic, leaves_more_than_noise};
use crate::identify::checks::other_orders;
use crate::identify::checks::residuals::Residuals;
use crate::identify::checks::wrong_values::{leaves_sigma, wrong_values};
use crate::identify::data::segments::{Data, Record, Segment};
use crate::identify::data::spectrum::{Spectrum, spectrum};
use crate::identify::estimate::between_samples::{self, Answer, MAX_PASSES, is_settled};
use crate::identify::estimate::estimated::{Estimated, Refined};
use crate::identify::estimate::output_error;
use crate::identify::estimate::search::{Candidate, Criterion};
use crate::identify::model::continuous::Continuous;
use crate::identify::model::modelled::{Modelled, Role, bandwidths};
use crate::identify::model::polynomials::{Noise, Orders, Polynomials, angle};
use crate::identify::model::reproduction::{InitialState, Kind, compare};
use crate::identify::periodic::{self, Periodic};
use crate::identify::reduce::truncation::{Reduction, Target, reduce};

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
    let found = Found::of(data, settings, &|_| {})?;
    let excited_hz = found.excited_hz;
    let mut orders = Settings { choice: settings.choice.of_orders(found.orders), ..settings.clone() };
    let own = |found: &Found| Continuous::of(&found.refined()?.estimated.model, data.period_s);
    let Some(mut last) = own(&found) else { return Ok(None) };
    for pass in 1..=MAX_PASSES {
        let Some(answer) = Answer::of(&last, data.period_s) else { break };
        let without = answer.taken_off_all(data);
        let Ok(found) = Found::of(&without, &orders, &|_| {}) else { break };
        let Some(next) = own(&found) else { break };
        if is_settled(&last, &next, excited_hz) {
            return Ok(Some(without));
        }
        if let (2, Some(refined)) = (pass, found.refined()) {
            // Two delays that explain the data about as well must not alternate.
            orders.choice = Choice::Fixed(Orders { nk: refined.estimated.model.nk, ..found.orders });
        }
        last = next;
    }
    Ok(None)
}

/// The models, and what they were found in.
struct Found {
    /// The records fitted, as they begin, and their segments.
    records: Vec<Record>,
    training: Vec<Segment>,
    candidates: Vec<Candidate>,
    criterion: Option<Criterion>,
    best: Orders,
    orders: Orders,
    arx: Estimated,
    full: Option<Refined>,
    spectrum: Option<Spectrum>,
    excited_hz: (f64, f64),
    taken: Attempt,
}

impl Found {
    /// The first three steps, with inputs that are held between samples.
    fn of(data: &Data, settings: &Settings, progress: &dyn Fn(&str)) -> Result<Self, IdentifyError> {
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
        let spectrum = spectrum(&training, data.period_s);
        let excited_hz = spectrum.as_ref().map_or((0.0, 0.5 / data.period_s), |spectrum| spectrum.excited_hz);
        // 3. fewer states, and the same order fitted to the data itself
        let excited = (angle(excited_hz.0, data.period_s), angle(excited_hz.1, data.period_s));
        let band = (!settings.all_frequencies).then_some(excited);
        let estimated = full.as_ref().map_or(&arx, |refined| &refined.estimated);
        let delays = delays(&settings.choice);
        let attempt = |target: Target| {
            progress("fitting the refined model");
            Attempt::of(&training, estimated, Reduction { target, removal: settings.removal, band }, excited, &delays)
        };
        let mut taken = attempt(settings.target);
        if settings.target == Target::Auto
            && let Some(order) = lower_order(&training, &taken)
        {
            taken = attempt(Target::Order(order));
        }
        Ok(Self { records, training, candidates, criterion, best, orders, arx, full, spectrum, excited_hz, taken })
    }

    fn refined(&self) -> Option<&Refined> {
        self.taken.refined.as_ref().ok().map(|found| &found.refined)
    }
}

/// A lower order than the refined model's with which the data are explained about as well.
fn lower_order(training: &[Segment], taken: &Attempt) -> Option<usize> {
    let found = taken.refined.as_ref().ok().filter(|_| !has_noise_of_output(training))?;
    other_orders::lowest(training, &found.refined)
}

/// Identifies with inputs that are held between samples. `measured`: the records to be fitted, with their outputs as
/// they were measured.
fn identify_held(
    data: &Data,
    measured: &[Record],
    settings: &Settings,
    progress: &dyn Fn(&str),
) -> Result<Identification, IdentifyError> {
    let found = Found::of(data, settings, progress)?;
    let Found { records, training, candidates, criterion, best, orders, arx, full, spectrum, excited_hz, taken } =
        found;
    let estimated = full.as_ref().map_or(&arx, |refined| &refined.estimated);
    let modelled = |role, title, model: &Polynomials, covariance| {
        Modelled::new(role, title, model.clone(), covariance, data.period_s, excited_hz)
    };
    let title = format!("{}, order {}", settings.estimator.words(), estimated.model.na());
    let mut models = vec![modelled(Role::Full, title, &estimated.model, Some(estimated.covariance.clone()))];
    let of_output = has_noise_of_output(&training);
    let lower_order = if settings.target == Target::Auto { None } else { lower_order(&training, &taken) };
    let Attempt { how, unstable_in_band, reduced, refined: found } = taken;
    if let Ok(reduced) = &reduced {
        let covariance = reduced_covariance(estimated, reduced, how);
        let title = format!("reduced, order {}", reduced.model.order());
        models.push(modelled(Role::Reduced, title, &reduced.model, covariance));
    }
    // 4. the refined model, and what speaks against its σ
    let (refined, other_delays, earlier_delay) = match found {
        Ok(found) => (Ok(found.refined), found.others, found.earlier.filter(|_| !of_output)),
        Err(why) => (Err(why), Vec::new(), None),
    };
    let mut objections = Objections::default();
    if let Ok(refined) = &refined {
        let Estimated { model, covariance, .. } = &refined.estimated;
        let shortest = delays(&settings.choice).first().copied().unwrap_or(model.nk);
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
