//! From signals to models: the whole chain, its steps in their order.

use super::IdentifyError;
use super::arx::{self, Estimated, Orders};
use super::bootstrap::{Noise, middle_95, repeat};
use super::data::{Record, Segment};
use super::doubts::{Doubt, doubts};
use super::fit::{FitError, Kind, Start, compare};
use super::model::{Polynomials, angle};
use super::modelled::{Modelled, Role, bandwidths};
use super::output_error::Refined;
use super::reduce::{Reduced, Reduction, Removal, Target, reduce};
use super::residuals::Residuals;
use super::search::{Candidate, Criterion, best, search};
use super::spectrum::{Spectrum, spectrum};
use super::{instrumental, output_error};

/// How the full model is estimated.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Estimator {
    /// By least squares, as the paper does.
    #[default]
    Arx,
    /// By output error, from ARX on.
    OutputError,
    /// By instrumental variables, from ARX on.
    Instrumental,
}

/// Which orders.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Choice {
    /// These.
    Fixed(Orders),
    /// The best of these.
    Search {
        /// All of them.
        candidates: Vec<Orders>,
        /// By what; by default simulation of the other data, or minimum description length where there are none.
        criterion: Option<Criterion>,
    },
}

/// What is to be done.
#[derive(Debug, Clone, PartialEq)]
pub struct Settings {
    /// Orders and delay.
    pub choice: Choice,
    /// How the full model is estimated.
    pub estimator: Estimator,
    /// Where simulations begin.
    pub start: Start,
    /// How far to reduce.
    pub target: Target,
    /// How states are removed.
    pub removal: Removal,
    /// Whether to balance for the excited band alone.
    pub weighted: bool,
    /// Repetitions of the bootstrap.
    pub bootstrap: usize,
}

/// What is identified from, made ready.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Data {
    /// Seconds between samples, the same for all records.
    pub period_s: f64,
    /// Fitted.
    pub training: Vec<Record>,
    /// Not fitted: to judge by.
    pub validation: Vec<Record>,
}

/// How well one model reproduces one record.
#[derive(Debug, Clone, PartialEq)]
pub struct Fit {
    /// The record.
    pub record: String,
    /// Whether the model was fitted to it.
    pub training: bool,
    /// The model.
    pub role: Role,
    /// What was compared.
    pub kind: Kind,
    /// How large the difference is.
    pub error: FitError,
}

/// All that came out.
#[derive(Debug, Clone)]
pub struct Identification {
    /// What was searched, if it was.
    pub candidates: Vec<Candidate>,
    /// By what the best was chosen, if it was.
    pub criterion: Option<Criterion>,
    /// Orders and delay of the full model.
    pub orders: Orders,
    /// The full model by least squares.
    pub arx: Estimated,
    /// The full model by another estimator, if that was asked for.
    pub full: Option<Refined>,
    /// The reduction, or why there is none.
    pub reduced: Result<Reduced, String>,
    /// Output error of the reduced order, or why there is none.
    pub refined: Result<Refined, String>,
    /// The models: full, then reduced and refined where they are.
    pub models: Vec<Modelled>,
    /// Each model on each record.
    pub fits: Vec<Fit>,
    /// Of the full model on the data fitted.
    pub residuals: Option<Residuals>,
    /// Of the data fitted.
    pub spectrum: Option<Spectrum>,
    /// Repetitions of the bootstrap that gave an answer, of the full and of the refined model.
    pub repetitions: (usize, usize),
    /// What should be known before the numbers are used.
    pub doubts: Vec<Doubt>,
}

impl Identification {
    /// The model of a role.
    pub fn model(&self, role: Role) -> Option<&Modelled> {
        self.models.iter().find(|m| m.role == role)
    }
}

/// Identifies.
///
/// # Errors
/// [`IdentifyError`].
pub fn identify(data: &Data, settings: &Settings) -> Result<Identification, IdentifyError> {
    let training = stretches(&data.training);
    let validation = stretches(&data.validation);
    moves(&data.training)?;
    can_judge(&validation, &settings.choice)?;
    // 1. orders and delay
    let (candidates, criterion, orders) = match &settings.choice {
        Choice::Fixed(orders) => (Vec::new(), None, *orders),
        Choice::Search { candidates, criterion } => {
            let usual = if validation.is_empty() { Criterion::Mdl } else { Criterion::Simulation };
            let criterion = criterion.unwrap_or(usual);
            let candidates = search(&training, &validation, settings.start, candidates)?;
            if candidates.is_empty() {
                return Err(IdentifyError::NoneDetermined);
            }
            let best = best(&candidates, criterion).ok_or(IdentifyError::NoneStable { tried: candidates.len() })?;
            let orders = best.orders;
            (candidates, Some(criterion), orders)
        }
    };
    // 2. the full model
    let arx = arx::fit(&training, orders)?;
    let full = match settings.estimator {
        Estimator::Arx => None,
        Estimator::OutputError => {
            let starts = output_error::usual_starts(&training, orders);
            Some(output_error::refine_from_any(&training, &starts)?)
        }
        Estimator::Instrumental => Some(instrumental::refine(&training, &arx.model)?),
    };
    let estimated = full.as_ref().map_or(&arx, |refined| &refined.estimated);
    let spectrum = spectrum(&training, data.period_s);
    let nyquist = 0.5 / data.period_s;
    let excited_hz = spectrum.as_ref().map_or((0.0, nyquist), |s| s.excited_hz);
    let excited = (angle(excited_hz.0, data.period_s), angle(excited_hz.1, data.period_s));
    let band = settings.weighted.then_some(excited);
    let modelled = |role, title, model: &Polynomials, covariance| {
        Modelled::new(role, title, model.clone(), covariance, data.period_s, excited_hz)
    };
    let title = format!("{}, order {}", settings.estimator.words(), estimated.model.na());
    let mut models = vec![modelled(Role::Full, title, &estimated.model, Some(estimated.covariance.clone()))];
    // 3. fewer states
    let how = Reduction { target: settings.target, removal: settings.removal, band };
    let reduced = reduce(&estimated.model, how).map_err(|e| e.to_string());
    let mut refined = Err("there is no reduced model to begin from".to_owned());
    if let Ok(reduced) = &reduced {
        // Of the same number of states, whatever `auto` would take for a model nearby.
        let same = Reduction { target: Target::Order(reduced.model.memory()), ..how };
        let parameters = |p: &[f64]| {
            let moved = reduce(&estimated.model.with_parameters(p), same).ok()?.model;
            (moved.nk == reduced.model.nk).then(|| moved.parameters().as_slice().to_vec())
        };
        let covariance = estimated.covariance.propagate(estimated.model.parameters().as_slice(), parameters);
        let title = format!("reduced, order {}", reduced.model.memory());
        models.push(modelled(Role::Reduced, title, &reduced.model, covariance));
        // 4. the same order fitted to the data itself; the excited band's reduction is often nearer to them
        let in_band = Reduction { band: band.or(Some(excited)), ..same };
        let order = Orders { na: reduced.model.na(), nb: reduced.model.nb(), nk: reduced.model.nk };
        let mut starts = vec![reduced.model.clone()];
        starts.extend(reduce(&estimated.model, in_band).ok().map(|r| r.model));
        starts.extend(output_error::usual_starts(&training, order));
        refined = output_error::refine_from_any(&training, &starts).map_err(|e| e.to_string());
    }
    if let Ok(refined) = &refined {
        let Estimated { model, covariance, .. } = &refined.estimated;
        let title = format!("output error, order {}", model.memory());
        models.push(modelled(Role::Refined, title, model, Some(covariance.clone())));
    }
    // 5. how sure
    let repetitions = intervals(&mut models, &training, data.period_s, excited_hz, orders, how, settings);
    let residuals = Residuals::of(&estimated.model, &training);
    let fits = fits(data, &models, settings.start);
    let mut done = Identification {
        candidates,
        criterion,
        orders,
        full,
        reduced,
        refined,
        models,
        fits,
        residuals,
        spectrum,
        repetitions,
        doubts: Vec::new(),
        arx,
    };
    done.doubts = doubts(data, &done);
    Ok(done)
}

impl Estimator {
    /// As people have it.
    pub fn words(self) -> &'static str {
        match self {
            Self::Arx => "ARX",
            Self::OutputError => "output error",
            Self::Instrumental => "instrumental variables",
        }
    }
}

fn stretches(records: &[Record]) -> Vec<Segment> {
    records.iter().flat_map(|r| r.segments.iter().cloned()).collect()
}

/// Input and output must change.
fn moves(records: &[Record]) -> Result<(), IdentifyError> {
    let name = records.iter().map(|r| r.name.as_str()).collect::<Vec<_>>().join(", ");
    type Signal = fn(&Segment) -> &[f64];
    let signals: [(&'static str, Signal); 2] = [("input", |s| &s.input), ("output", |s| &s.output)];
    for (what, signal) in signals {
        let all = records.iter().flat_map(|r| &r.segments).flat_map(|s| signal(s).iter().copied());
        let mut values = all.filter(|v| !v.is_nan());
        let Some(first) = values.next() else { return Err(IdentifyError::Nothing { name }) };
        if values.all(|v| v == first) {
            return Err(IdentifyError::Still { name, what, value: first });
        }
    }
    Ok(())
}

/// The data to judge by, if there are any, must have samples that the largest model can predict.
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

/// Every model on every record: simulated both ways, and predicted.
fn fits(data: &Data, models: &[Modelled], start: Start) -> Vec<Fit> {
    let other = if start == Start::Rest { Start::Estimated } else { Start::Rest };
    let kinds = [Kind::Simulation(start), Kind::Simulation(other), Kind::Prediction];
    let mut fits = Vec::new();
    let records = data.training.iter().map(|r| (r, true)).chain(data.validation.iter().map(|r| (r, false)));
    for (record, training) in records {
        // From rest is from rest here, also for a part of a record: the number of other programs. With its start estimated it stands
        // beside it.
        let at_rest = record.at_rest();
        for model in models {
            for kind in kinds {
                let record = if kind == Kind::Simulation(Start::Rest) { &at_rest } else { record };
                // Only the full model has a model of the noise to predict with.
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

/// Puts intervals on the bandwidths, and says how many repetitions gave an answer.
fn intervals(
    models: &mut [Modelled],
    training: &[Segment],
    period_s: f64,
    excited_hz: (f64, f64),
    orders: Orders,
    how: Reduction,
    settings: &Settings,
) -> (usize, usize) {
    let of = |role, model: &Polynomials| -> Vec<Option<f64>> {
        bandwidths(role, model, period_s, excited_hz).iter().map(|b| b.frequency_hz).collect()
    };
    let model = |role| models.iter().find(|m| m.role == role).filter(|m| m.is_stable()).map(|m| m.model.clone());
    let mut full_draws = Vec::new();
    if let Some(full) = model(Role::Full) {
        let noise = if settings.estimator == Estimator::Arx { Noise::Equation } else { Noise::Output };
        full_draws = repeat(training, &full, noise, settings.bootstrap, |drawn| {
            let again = match settings.estimator {
                Estimator::Arx => arx::fit(drawn, orders).ok()?.model,
                Estimator::OutputError => output_error::refine(drawn, &full).ok()?.estimated.model,
                Estimator::Instrumental => instrumental::refine(drawn, &full).ok()?.estimated.model,
            };
            let reduced = reduce(&again, how).ok().map(|r| of(Role::Reduced, &r.model));
            Some((of(Role::Full, &again), reduced))
        });
    }
    let mut refined_draws = Vec::new();
    if let Some(refined) = model(Role::Refined) {
        refined_draws = repeat(training, &refined, Noise::Output, settings.bootstrap, |drawn| {
            let again = output_error::refine(drawn, &refined).ok()?.estimated.model;
            Some(of(Role::Refined, &again))
        });
    }
    for model in models {
        let draws: Vec<&Vec<Option<f64>>> = match model.role {
            Role::Full => full_draws.iter().map(|(full, _)| full).collect(),
            Role::Reduced => full_draws.iter().filter_map(|(_, reduced)| reduced.as_ref()).collect(),
            Role::Refined => refined_draws.iter().collect(),
        };
        for (k, estimate) in model.bandwidths.iter_mut().enumerate() {
            estimate.interval_hz = middle_95(draws.iter().filter_map(|d| d.get(k).copied().flatten()).collect());
        }
    }
    (full_draws.len(), refined_draws.len())
}
