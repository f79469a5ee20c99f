//! What should be known before the numbers are used.

use super::data::Data;
use super::diagnostic::Diagnostic;
use super::fit::Kind;
use super::identification::Identification;
use super::modelled::Role;
use super::residuals::Residuals;

/// A condition beyond which least squares keeps fewer than five digits.
const ILL_CONDITIONED: f64 = 1e10;
/// Sampled so many times faster than the output moves: orders grow without use.
const OVERSAMPLED: f64 = 10.0;
/// A mean of so many times the spread.
const OFF_CENTRE: f64 = 1.0;
/// Of the correlations that 99 % should keep within the bound, this part may be out before it is said.
const OUTSIDE: f64 = 0.1;
/// A stable pole so near to the unit circle that its gain is hardly known.
const NEARLY_UNSTABLE: f64 = 1e-4;

/// A model that leaves more of the energy than this is called poor, percent.
const POOR: f64 = 50.0;

/// All diagnostics about a result.
pub(super) fn diagnostics(data: &Data, done: &Identification) -> Vec<Diagnostic> {
    let mut diagnostics = Vec::new();
    for model in &done.models {
        let (title, largest_pole) = (model.title.clone(), model.largest_pole);
        if !model.is_stable() {
            diagnostics.push(Diagnostic::Unstable { title, largest_pole });
        } else if largest_pole > 1.0 - NEARLY_UNSTABLE {
            diagnostics.push(Diagnostic::NearlyUnstable { title, largest_pole });
        }
    }
    for model in done.models.iter().filter(|m| m.is_stable()) {
        let led =
            done.fits.iter().find(|f| f.training && f.role == model.role && matches!(f.kind, Kind::Simulation(_)));
        if let Some(error_percent) = led.map(|f| f.error.error_percent).filter(|e| *e > POOR) {
            diagnostics.push(Diagnostic::Poor { title: model.title.clone(), error_percent });
        }
    }
    if done.arx.condition > ILL_CONDITIONED {
        diagnostics.push(Diagnostic::IllConditioned { condition: done.arx.condition });
    }
    let rate_hz = 1.0 / data.period_s;
    match &done.spectrum {
        Some(spectrum) => {
            let output_hz = spectrum.output_ends_hz().max(spectrum.resolution_hz);
            let factor = (rate_hz / (OVERSAMPLED * output_hz)).floor() as usize;
            if factor >= 2 {
                diagnostics.push(Diagnostic::Oversampled { output_hz, rate_hz, factor });
            }
        }
        None => diagnostics.push(Diagnostic::NoSpectrum),
    }
    diagnostics.extend(off_centre(data));
    if let Some(residuals) = &done.residuals {
        diagnostics.extend(correlated(residuals));
    }
    if let Ok(reduced) = &done.reduced
        && let Some(asked) = reduced.asked_for_more
    {
        diagnostics.push(Diagnostic::FewerStates { asked, has: reduced.model.memory() });
    }
    if let Err(why) = &done.reduced {
        diagnostics.push(Diagnostic::NotReduced { why: why.clone() });
    } else if let Err(why) = &done.refined {
        diagnostics.push(Diagnostic::NotRefined { why: why.clone() });
    }
    let refined = done.refined.as_ref().ok().map(|r| (Role::Refined, r));
    for (role, refined) in done.full.as_ref().map(|r| (Role::Full, r)).into_iter().chain(refined) {
        let title = done.model(role).map_or_else(String::new, |m| m.title.clone());
        if !refined.settled {
            diagnostics.push(Diagnostic::NotSettled { title, steps: refined.steps });
        }
    }
    diagnostics
}

fn off_centre(data: &Data) -> Vec<Diagnostic> {
    let ratio = |signal: &dyn Fn(&super::data::Segment) -> Vec<f64>| {
        let values: Vec<f64> =
            data.training.iter().flat_map(|r| &r.segments).flat_map(signal).filter(|v| !v.is_nan()).collect();
        let n = values.len() as f64;
        let mean = values.iter().sum::<f64>() / n;
        let sd = (values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / n).sqrt();
        mean.abs() / sd
    };
    let of = [("input", ratio(&|s| s.input.clone())), ("output", ratio(&|s| s.output.clone()))];
    of.into_iter()
        .filter(|(_, ratio)| *ratio > OFF_CENTRE)
        .map(|(what, ratio)| Diagnostic::OffCentre { what, ratio })
        .collect()
}

fn correlated(residuals: &Residuals) -> Vec<Diagnostic> {
    let too_many = |(n, of): (usize, usize)| n as f64 > OUTSIDE * of as f64;
    let mut diagnostics = Vec::new();
    if too_many(residuals.auto_outside()) {
        diagnostics.push(Diagnostic::Coloured { outside: residuals.auto_outside() });
    }
    if too_many(residuals.cross_outside()) {
        diagnostics.push(Diagnostic::Unexplained { outside: residuals.cross_outside() });
    }
    if too_many(residuals.fed_back()) {
        diagnostics.push(Diagnostic::FedBack { outside: residuals.fed_back() });
    }
    diagnostics
}
