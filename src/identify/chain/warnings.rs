//! Warnings to read before using the numbers.

use crate::identify::chain::identification::{Differs, Fit, Identification, left_percent};
use crate::identify::chain::settings::Settings;
use crate::identify::checks::diagnostic::{Diagnostic, WayBack};
use crate::identify::checks::residuals::{Residuals, too_many};
use crate::identify::checks::wrong_values::leaves_sigma;
use crate::identify::data::segments::Data;
use crate::identify::data::spectrum::Spectrum;
use crate::identify::model::continuous::Conversion;
use crate::identify::model::modelled::{ContinuousEstimate, Modelled, Role};
use crate::identify::model::polynomials::{Orders, angle};
use crate::identify::model::reproduction::{InitialState, Kind};

/// Condition number beyond which least squares keeps fewer than five digits.
const ILL_CONDITIONED: f64 = 1e10;
/// Ratio of sampling rate to the output's highest frequency beyond which higher orders are useless.
const OVERSAMPLED: f64 = 10.0;
/// Factor between simulation errors from rest and from another state that is reported.
const MUCH_BETTER: f64 = 2.0;
/// Ratio of mean to standard deviation that is reported.
const OFFSET_RATIO: f64 = 1.0;
/// Distance of a stable pole from the unit circle below which its gain is hardly known.
const NEARLY_UNSTABLE: f64 = 1e-4;

/// Largest deviation of the first period relative to noise: the ratio scatters with few lines.
const FIRST_PERIOD_LIMIT: f64 = 2.0;
/// Significance limit of a residual beyond noise, in σ.
const SIGNIFICANT_SD: f64 = 3.3;
/// Part of a repeating input's lines that may be lost in noise before it is told.
const MANY_LINES: f64 = 0.2;
/// Seconds from sample to sample of hardly any record of a catheter: a unit may be wrong.
const SLOW_S: f64 = 0.2;
const FAST_S: f64 = 5e-4;
/// Number of periods from which the expressions for estimated variances hold (see `periodic`).
const ENOUGH_PERIODS: usize = 7;

/// Simulation error beyond which a model is called poor, percent.
pub(in crate::identify) const POOR_FIT_PERCENT: f64 = 50.0;
/// Simulation error of an output of zero, percent.
pub(in crate::identify) const WORSE_THAN_ZERO_PERCENT: f64 = 100.0;

/// The question about a sampling period so long, or so short, that the times may have another unit.
pub(in crate::identify) fn other_unit(period_s: f64) -> Option<Diagnostic> {
    (!(FAST_S..=SLOW_S).contains(&period_s)).then_some(Diagnostic::OtherUnit { period_s })
}

/// All diagnostics about a result.
pub(super) fn diagnostics(data: &Data, done: &Identification, settings: &Settings) -> Vec<Diagnostic> {
    let Settings { commanded, doubtful, .. } = *settings;
    let mut diagnostics: Vec<Diagnostic> = other_unit(data.period_s).into_iter().collect();
    for model in &done.models {
        let (title, largest_pole) = (model.title.clone(), model.largest_pole);
        if !model.is_stable() {
            diagnostics.push(Diagnostic::Unstable { title, largest_pole });
        } else if largest_pole > 1.0 - NEARLY_UNSTABLE {
            diagnostics.push(Diagnostic::NearlyUnstable { title, largest_pole });
        }
    }
    let simulation = |model: &Modelled| left_percent(&done.fits, model.role);
    let is_poor = |error_percent: &f64| *error_percent > POOR_FIT_PERCENT;
    let other = done.leading().filter(|model| model.is_stable() && simulation(model).is_some_and(|e| !is_poor(&e)));
    for model in done.models.iter().filter(|m| m.is_stable()) {
        if let Some(error_percent) = simulation(model).filter(is_poor) {
            let linear = done.spectrum.as_ref().map(Spectrum::linear_part);
            let (title, other) = (model.title.clone(), other.map(|other| other.title.clone()));
            let has_sigma = model.covariance.is_some();
            diagnostics.push(Diagnostic::Poor { title, error_percent, linear, other, has_sigma });
        }
    }
    diagnostics.extend(strange_records(done));
    diagnostics.extend(at_edge(done));
    if done.best_orders != done.orders {
        diagnostics.push(Diagnostic::LowerOrders { best: done.best_orders, used: done.orders });
    }
    if done.unstable_in_band {
        diagnostics.push(Diagnostic::UnstableInBand);
    }
    for model in &done.models {
        if model.continuous.as_ref().is_some_and(|h| h.model.conversion == Conversion::Tustin) {
            diagnostics.push(Diagnostic::NotHeld { title: model.title.clone() });
        }
    }
    if done.arx.condition > ILL_CONDITIONED {
        diagnostics.push(Diagnostic::IllConditioned { condition: done.arx.condition });
    }
    let rate_hz = 1.0 / data.period_s;
    match &done.spectrum {
        Some(spectrum) => {
            let output_hz = spectrum.output_ends_hz;
            let factor = (rate_hz / (OVERSAMPLED * output_hz)).floor() as usize;
            // Noise does not decide the refined model: it is as good at any rate.
            if factor >= 2 && done.model(Role::Refined).is_none() {
                diagnostics.push(Diagnostic::Oversampled { output_hz, rate_hz, factor });
            }
        }
        None => diagnostics.push(Diagnostic::NoSpectrum),
    }
    diagnostics.extend(off_centre(data));
    // A model that was fitted from the wrong state is bent, and fits each record by another gain; one that lacks a part
    // of the response has another gain at each frequency, and so at each time of a chirp.
    let not_at_rest = not_at_rest(data, done);
    let follows = |told: &&Diagnostic| match told {
        Diagnostic::Gains { .. } => not_at_rest.is_some() || done.model_error.is_some(),
        Diagnostic::GainDrift { .. } | Diagnostic::GainChange { .. } => done.model_error.is_some(),
        _ => false,
    };
    let wrong_values: Vec<Diagnostic> = done.wrong_values.iter().filter(|told| !follows(told)).cloned().collect();
    let is_nonlinear = wrong_values.iter().any(|told| matches!(told, Diagnostic::Nonlinear { .. }));
    diagnostics.extend(wrong_values);
    if doubtful || done.wrong_values.iter().any(|told| !leaves_sigma(told)) {
        let fitted = done.models.iter().filter(|model| matches!(model.role, Role::Refined | Role::Periodic));
        diagnostics.extend(fitted.map(|model| Diagnostic::OfWrongValues { title: model.title.clone() }));
    }
    diagnostics.extend(not_at_rest);
    diagnostics.extend(against_torque(data, done));
    if let Some(residuals) = &done.residuals {
        let has_instrument = data.training.iter().flat_map(|r| &r.segments).any(|s| s.instrument.is_some());
        let way = match (commanded, has_instrument) {
            (true, _) => WayBack::Open,
            (false, true) => WayBack::Instrument,
            (false, false) => WayBack::Unknown,
        };
        // What is not linear follows the input.
        let follows = |told: &Diagnostic| commanded && is_nonlinear && !matches!(told, Diagnostic::Coloured { .. });
        diagnostics.extend(correlated(residuals, way).into_iter().filter(|told| !follows(told)));
    }
    if let Ok(reduced) = &done.reduced
        && let Some(asked) = reduced.asked_for_more
    {
        diagnostics.push(Diagnostic::FewerStates { asked, has: reduced.model.order() });
    }
    if let Err(why) = &done.reduced {
        diagnostics.push(Diagnostic::NotReduced { why: why.clone() });
    } else if let Err(why) = &done.refined {
        diagnostics.push(Diagnostic::NotRefined { why: why.clone() });
    }
    let by_periods = done.periodic.as_ref().map_or(&[][..], |found| &found.other_delays);
    for (role, others) in [(Role::Refined, &done.other_delays[..]), (Role::Periodic, by_periods)] {
        if let Some(model) = done.model(role).filter(|_| !others.is_empty()) {
            let (title, nk, others) = (model.title.clone(), model.model.nk, others.to_vec());
            diagnostics.push(Diagnostic::OtherDelays { title, nk, others });
        }
    }
    if let Some((model, error)) = done.model(Role::Refined).zip(done.model_error) {
        diagnostics.push(Diagnostic::ModelError { title: model.title.clone(), error });
    }
    diagnostics.extend(left_of(done, commanded));
    if let Some((model, Differs { sigmas })) = done.model(Role::Reduced).zip(done.reduced_differs) {
        diagnostics.push(Diagnostic::ReducedDiffers { title: model.title.clone(), sigmas });
    }
    if let Some(model) = done.leading() {
        diagnostics.extend(model.continuous.as_ref().and_then(|h| delaying_zero(&model.title, h, data.period_s)));
    }
    diagnostics.extend(of_periods(data, done));
    let refined = done.refined.as_ref().ok().map(|r| (Role::Refined, r));
    let refined = refined.into_iter().chain(done.periodic.as_ref().map(|p| (Role::Periodic, &p.refined)));
    for (role, refined) in done.full.as_ref().map(|r| (Role::Full, r)).into_iter().chain(refined) {
        let title = done.model(role).map_or_else(String::new, |m| m.title.clone());
        if !refined.converged {
            diagnostics.push(Diagnostic::NotConverged { title, steps: refined.steps });
        }
    }
    diagnostics
}

/// What the residual of the refined model tells.
fn left_of(done: &Identification, commanded: bool) -> Vec<Diagnostic> {
    let Some(title) = done.model(Role::Refined).map(|model| model.title.clone()) else { return Vec::new() };
    // That of one row too late is another response, and what it leaves follows from that.
    if let Some(nk) = done.earlier_delay {
        return vec![Diagnostic::Sooner { title, nk }];
    }
    if let Some(order) = done.higher_order {
        return vec![Diagnostic::HigherOrder { title, order }];
    }
    let Some(left) = done.left else { return Vec::new() };
    if left.is_off_centre() {
        return vec![Diagnostic::Straight { title, times: left.straight }];
    }
    if let Some(order) = done.lower_order {
        return vec![Diagnostic::LowerOrder { title, order }];
    }
    // What follows the input before may seem to follow that after, which is like it.
    // A response that the order lacks is in both.
    if left.is_fed_back() && left.ahead > left.past && !commanded && done.model_error.is_none() {
        return vec![Diagnostic::InInput { title, times: left.ahead }];
    }
    let told = left.follows() && done.model_error.is_none();
    told.then_some(Diagnostic::Follows { title, times: left.past }).into_iter().collect()
}

/// Diagnostics of averaged periods.
fn of_periods(data: &Data, done: &Identification) -> Vec<Diagnostic> {
    let Some(found) = &done.periodic else { return Vec::new() };
    let mut diagnostics = Vec::new();
    let worst = found.records.iter().max_by(|a, b| a.first_off.total_cmp(&b.first_off));
    if let Some(record) = worst.filter(|r| r.first_off > FIRST_PERIOD_LIMIT) {
        diagnostics.push(Diagnostic::NotSteady { off: record.first_off, skipped: record.skipped });
    }
    for (record, averaged) in data.training.iter().zip(&found.records) {
        let (noisy, of) = (averaged.noisy, averaged.noisy + averaged.lines.len());
        if noisy as f64 > MANY_LINES * of as f64 {
            diagnostics.push(Diagnostic::NoisyLines { record: record.name.clone(), noisy, of });
        }
    }
    if found.left > 1.0 + SIGNIFICANT_SD * found.left_sd {
        let has_sigma = done.model(Role::Periodic).is_some_and(|model| model.covariance.is_some());
        diagnostics.push(Diagnostic::BeyondNoise { left: found.left, has_sigma });
    }
    let fewest = found.records.iter().map(|r| r.periods).min().unwrap_or(0);
    if fewest < ENOUGH_PERIODS {
        diagnostics.push(Diagnostic::FewPeriods { periods: fewest });
    }
    diagnostics
}

/// Records to judge by that a model simulates worse than zero would, although it simulates those it was fitted to.
fn strange_records(done: &Identification) -> Vec<Diagnostic> {
    let Some(model) = done.models.iter().rfind(|m| m.is_stable()) else { return Vec::new() };
    let mut records: Vec<Diagnostic> = Vec::new();
    let simulated = done.fits.iter().filter(|f| f.role == model.role && matches!(f.kind, Kind::Simulation(_)));
    let (fitted, judging): (Vec<_>, Vec<_>) = simulated.partition(|f| f.training);
    if fitted.iter().any(|f| f.error.error_percent > POOR_FIT_PERCENT) {
        return records;
    }
    for fit in judging.into_iter().filter(|f| f.error.error_percent > WORSE_THAN_ZERO_PERCENT) {
        let known = |d: &Diagnostic| matches!(d, Diagnostic::StrangeRecord { record, .. } if *record == fit.record);
        if !records.iter().any(known) {
            let (title, record) = (model.title.clone(), fit.record.clone());
            records.push(Diagnostic::StrangeRecord { title, record, error_percent: fit.error.error_percent });
        }
    }
    records
}

/// Orders and delay at a limit of the search that could be extended.
fn at_edge(done: &Identification) -> Vec<Diagnostic> {
    type Part = fn(&Orders) -> usize;
    let of: [(&'static str, Part, &'static str); 3] =
        [("na", |o| o.na, "--order or --na"), ("nb", |o| o.nb, "--order or --nb"), ("nk", |o| o.nk, "--nk")];
    let last = |(what, of, option): (&'static str, Part, &'static str)| {
        let values = || done.candidates.iter().map(|c| of(&c.orders));
        let (value, largest, least) = (of(&done.best_orders), values().max()?, values().min()?);
        (largest > least && value == largest).then_some(Diagnostic::AtEdge { what, value, option })
    };
    let mut edges: Vec<Diagnostic> = of.into_iter().filter_map(last).collect();
    // na = nb is one search.
    if done.candidates.iter().all(|c| c.orders.na == c.orders.nb) {
        edges.retain(|edge| !matches!(edge, Diagnostic::AtEdge { what: "nb", .. }));
    }
    edges
}

fn off_centre(data: &Data) -> Vec<Diagnostic> {
    let ratio = |signal: &dyn Fn(&crate::identify::data::segments::Segment) -> Vec<f64>| {
        let values: Vec<f64> =
            data.training.iter().flat_map(|r| &r.segments).flat_map(signal).filter(|v| !v.is_nan()).collect();
        let n = values.len() as f64;
        let mean = values.iter().sum::<f64>() / n;
        let sd = (values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / n).sqrt();
        mean.abs() / sd
    };
    let of = [("input", ratio(&|s| s.input.clone())), ("output", ratio(&|s| s.output.clone()))];
    of.into_iter()
        .filter(|(_, ratio)| *ratio > OFFSET_RATIO)
        .map(|(what, ratio)| Diagnostic::OffCentre { what, ratio })
        .collect()
}

/// Whether the refined model simulates the fitted records much better from another state than from rest.
fn not_at_rest(data: &Data, done: &Identification) -> Option<Diagnostic> {
    let name = &data.training.iter().find(|record| record.is_from_rest())?.name;
    // The first is the one asked for.
    let asked = done.fits.iter().find(|f| f.training && f.role == Role::Refined)?;
    if asked.kind != Kind::Simulation(InitialState::Rest) {
        return None;
    }
    let error = |state: InitialState| {
        let of =
            |f: &&Fit| f.training && f.role == Role::Refined && f.record == *name && f.kind == Kind::Simulation(state);
        done.fits.iter().find(of).map(|f| f.error.error_percent)
    };
    let (from_rest, from_estimated) = (error(InitialState::Rest)?, error(InitialState::Estimated)?);
    (from_rest > MUCH_BETTER * from_estimated).then_some(Diagnostic::NotAtRest { from_rest, from_estimated })
}

/// Whether Eq. 6 has a wrong sign: the refined model's angle leads the torque by more than a quarter turn where the
/// excitation begins.
fn against_torque(data: &Data, done: &Identification) -> Option<Diagnostic> {
    let of_torque = data.training.iter().flat_map(|r| &r.segments).any(|s| s.instrument.is_some());
    let explains = |f: &&Fit| f.training && f.role == Role::Refined && f.error.error_percent < POOR_FIT_PERCENT;
    let model = done.model(Role::Refined).filter(|_| of_torque && done.fits.iter().any(|f| explains(&f)))?;
    let frequency_hz = done.spectrum.as_ref()?.excited_hz.0;
    let phase_deg = model.model.response(angle(frequency_hz, data.period_s)).arg().to_degrees();
    let title = model.title.clone();
    (phase_deg > 90.0).then_some(Diagnostic::AgainstTorque { title, phase_deg, frequency_hz })
}

/// Whether the numerator b₁ s + b₀ of H(s) has a zero that is known and acts like a delay −b₁ / b₀ below a sample.
fn delaying_zero(title: &str, found: &ContinuousEstimate, period_s: f64) -> Option<Diagnostic> {
    let [b1, b0] = found.model.num[..] else { return None };
    let sd = found.standard_errors.as_ref()?.first()?;
    let delay_s = -b1 / b0;
    let told = found.model.conversion == Conversion::Hold
        && delay_s > 0.0
        && delay_s < period_s
        && b1.abs() > SIGNIFICANT_SD * sd;
    told.then(|| Diagnostic::DelayingZero { title: title.to_owned(), delay_s })
}

fn correlated(residuals: &Residuals, way: WayBack) -> Vec<Diagnostic> {
    let mut diagnostics = Vec::new();
    if too_many(residuals.auto_outside()) {
        diagnostics.push(Diagnostic::Coloured { outside: residuals.auto_outside() });
    }
    if too_many(residuals.cross_outside()) {
        diagnostics.push(Diagnostic::Unexplained { outside: residuals.cross_outside() });
    }
    // Unexplained response is correlated with the input at all lags, since the input is autocorrelated: that is no sign
    // of feedback.
    if too_many(residuals.fed_back()) && !too_many(residuals.cross_outside()) {
        diagnostics.push(Diagnostic::FedBack { outside: residuals.fed_back(), way });
    }
    diagnostics
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::identify::model::continuous::Continuous;

    #[test]
    fn a_zero_that_acts_like_a_part_of_a_sample_is_told() {
        let with = |b1: f64, sd: f64| {
            let (num, den) = (vec![b1, 108.0], vec![1.0, 3.6, 36.0]);
            let model = Continuous { num, den, delay_s: 0.0, conversion: Conversion::Hold };
            let standard_errors = Some(vec![sd, 0.2, 0.01, 0.05]);
            delaying_zero("refined", &ContinuousEstimate { model, standard_errors }, 1.0 / 60.0)
        };
        let told = with(-0.54, 0.03);
        assert!(matches!(told, Some(Diagnostic::DelayingZero { delay_s, .. }) if (delay_s - 0.005).abs() < 1e-9));
        assert_eq!(with(-0.54, 0.3), None);
        assert_eq!(with(0.54, 0.03), None);
        assert_eq!(with(-3.0, 0.03), None);
    }
}
