//! What should be known before the numbers are used.

use super::data::Data;
use super::fit::Kind;
use super::identification::Identification;
use super::modelled::Role;
use super::residuals::Residuals;
use std::fmt;

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

/// Something that makes the result less than it looks.
#[derive(Debug, Clone, PartialEq)]
pub enum Diagnostic {
    /// A model is unstable.
    Unstable {
        /// Which.
        title: String,
        /// Modulus of its largest pole.
        largest_pole: f64,
    },
    /// A model's largest pole is hardly inside the unit circle.
    NearlyUnstable {
        /// Which.
        title: String,
        /// Modulus of its largest pole.
        largest_pole: f64,
    },
    /// A model leaves most of what it was fitted to.
    Poor {
        /// Which.
        title: String,
        /// Simulation error, % of the energy.
        error_percent: f64,
    },
    /// The regressors nearly depend on each other.
    IllConditioned {
        /// Condition number.
        condition: f64,
    },
    /// Samples come much faster than the output moves.
    Oversampled {
        /// 99 % of the output's energy lie below, Hz.
        output_hz: f64,
        /// Samples a second.
        rate_hz: f64,
        /// `--decimate` with this would do.
        factor: usize,
    },
    /// The signals have a mean that the model must explain.
    OffCentre {
        /// `input` or `output`.
        what: &'static str,
        /// Mean over standard deviation.
        ratio: f64,
    },
    /// Residuals of the full model are not white.
    Coloured {
        /// Lags out of the bound, and of how many.
        outside: (usize, usize),
    },
    /// Residuals of the full model go with the input.
    Unexplained {
        /// Lags out of the bound, and of how many.
        outside: (usize, usize),
    },
    /// The input carries the output's noise.
    FedBack {
        /// Lags out of the bound, and of how many.
        outside: (usize, usize),
    },
    /// There is no reduced model.
    NotReduced {
        /// Why.
        why: String,
    },
    /// A model of the order asked for has no more to give.
    FewerStates {
        /// The order asked for.
        asked: usize,
        /// What the model has.
        has: usize,
    },
    /// There is no refined model.
    NotRefined {
        /// Why.
        why: String,
    },
    /// A search for the smallest error did not come to rest.
    NotSettled {
        /// Of which model.
        title: String,
        /// Steps taken.
        steps: usize,
    },
    /// The record is too short for a frequency response without a model.
    NoSpectrum,
}

impl fmt::Display for Diagnostic {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Unstable { title, largest_pole } => write!(
                f,
                "{title}: unstable, its largest pole is {largest_pole:.5}; simulations with it run away. Choose other orders, \
                 take trends off (--detrend), or fewer samples a second (--decimate)"
            ),
            Self::NearlyUnstable { title, largest_pole } => {
                write!(
                    f,
                    "{title}: the largest pole is {largest_pole:.6}, nearly 1; gain and phase at low frequencies are hardly known"
                )
            }
            Self::Poor { title, error_percent } => write!(
                f,
                "{title}: its simulation leaves {error_percent:.0} % of the energy of the data it was fitted to: is this the input that moved it?"
            ),
            Self::IllConditioned { condition } => {
                write!(
                    f,
                    "the regressors nearly depend on each other (condition {condition:.1e}): lower orders would do"
                )
            }
            Self::Oversampled { output_hz, rate_hz, factor } => write!(
                f,
                "the output moves below {output_hz:.3} Hz and is sampled at {rate_hz:.1} Hz: noise then decides the coefficients; \
                 --decimate {factor} keeps all that moves"
            ),
            Self::OffCentre { what, ratio } => {
                write!(f, "the mean of the {what} is {ratio:.1} times its spread: --detrend mean takes it off")
            }
            Self::Coloured { outside: (n, of) } => write!(
                f,
                "residuals of the full model are not white ({n} of {of} lags out of the 99 % bound): its standard errors are too \
                 small, and it may be biased"
            ),
            Self::Unexplained { outside: (n, of) } => {
                write!(
                    f,
                    "residuals of the full model go with the input ({n} of {of} lags out of the 99 % bound): it leaves something unexplained"
                )
            }
            Self::FedBack { outside: (n, of) } => write!(
                f,
                "the input goes with earlier residuals ({n} of {of} lags out of the 99 % bound): noise of the output is fed back \
                 into it, which biases ARX; compare with --estimator iv"
            ),
            Self::NotReduced { why } => write!(f, "there is no reduced model: {why}"),
            Self::FewerStates { asked, has } => write!(
                f,
                "reduced to order {asked}: the full model has only {has} states that matter, and they are all kept"
            ),
            Self::NotRefined { why } => write!(f, "there is no refined model: {why}"),
            Self::NotSettled { title, steps } => write!(f, "{title}: the search did not come to rest in {steps} steps"),
            Self::NoSpectrum => {
                write!(
                    f,
                    "no stretch is long enough for a frequency response without a model; the excited band is not known"
                )
            }
        }
    }
}

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
