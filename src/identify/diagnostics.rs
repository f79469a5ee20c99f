//! What should be known before the numbers are used.

use super::continuous::Conversion;
use super::data::Data;
use super::fit::Kind;
use super::identification::Identification;
use super::model::Orders;
use super::modelled::Role;
use super::residuals::{Residuals, too_many};
use super::spectrum::Spectrum;
use std::fmt;

/// A condition beyond which least squares keeps fewer than five digits.
const ILL_CONDITIONED: f64 = 1e10;
/// Sampled so many times faster than the output moves: orders grow without use.
const OVERSAMPLED: f64 = 10.0;
/// A mean of so many times the spread.
const OFF_CENTRE: f64 = 1.0;
/// A stable pole so near to the unit circle that its gain is hardly known.
const NEARLY_UNSTABLE: f64 = 1e-4;

/// Where more than this part of the output's energy follows the input, the input is the right one.
const FOLLOWS: f64 = 0.5;
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
        /// Part of the output's energy that follows the input linearly, by the spectra; nothing where there are none.
        linear: Option<f64>,
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
    /// The best orders are the largest, or smallest, of those searched.
    AtEdge {
        /// `na`, `nb` or `nk`.
        what: &'static str,
        /// Its value.
        value: usize,
        /// The option that searches further.
        option: &'static str,
    },
    /// The estimator had no answer for the best orders.
    LowerOrders {
        /// The best orders.
        best: Orders,
        /// What was used.
        used: Orders,
    },
    /// Reduced for the excited band the model would be unstable.
    UnstableInBand,
    /// H(s) of the reduced model is an approximation.
    NotHeld {
        /// Which model.
        title: String,
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
        /// Whether there is a signal that moves the input and does not carry it.
        has_instrument: bool,
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
            Self::Poor { title, error_percent, linear } => {
                write!(
                    f,
                    "{title}: its simulation leaves {error_percent:.0} % of the energy of the data it was fitted to: "
                )?;
                match linear {
                    Some(part) if *part > FOLLOWS => write!(
                        f,
                        "{:.0} % of it follow the input, so a higher order, or another delay, would explain more",
                        100.0 * part
                    ),
                    _ => write!(f, "is this the input that moved it?"),
                }
            }
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
            Self::FedBack { outside: (n, of), has_instrument } => {
                write!(
                    f,
                    "the input goes with earlier residuals ({n} of {of} lags out of the 99 % bound): noise of the output is \
                     fed back into it, which biases ARX; compare with "
                )?;
                // Without an instrument the input would be its own, noise and all.
                if *has_instrument { write!(f, "--estimator iv") } else { write!(f, "a record without feedback") }
            }
            Self::AtEdge { what, value, option } => write!(
                f,
                "{what} {value} is the last that was searched: a better one may lie beyond, search further with {option}"
            ),
            Self::LowerOrders { best, used } => write!(
                f,
                "the estimator has no answer for the best orders (na {}, nb {}, nk {}): na {}, nb {}, nk {} are used",
                best.na, best.nb, best.nk, used.na, used.nb, used.nk
            ),
            Self::UnstableInBand => {
                write!(f, "reduced for the excited band the model is unstable: it is reduced for all frequencies")
            }
            Self::NotHeld { title } => write!(
                f,
                "{title}: no H(s) with a held input has this response, since a real pole of the discrete model is not \
                 positive; what is given is Tustin's approximation, for low frequencies only"
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
            let linear = done.spectrum.as_ref().map(Spectrum::linear_part);
            diagnostics.push(Diagnostic::Poor { title: model.title.clone(), error_percent, linear });
        }
    }
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
        let has_instrument = data.training.iter().flat_map(|r| &r.segments).any(|s| s.instrument.is_some());
        diagnostics.extend(correlated(residuals, has_instrument));
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
    let refined = done.refined.as_ref().ok().map(|r| (Role::Refined, r));
    for (role, refined) in done.full.as_ref().map(|r| (Role::Full, r)).into_iter().chain(refined) {
        let title = done.model(role).map_or_else(String::new, |m| m.title.clone());
        if !refined.settled {
            diagnostics.push(Diagnostic::NotSettled { title, steps: refined.steps });
        }
    }
    diagnostics
}

/// Orders and delay at an end of the search that could be moved.
fn at_edge(done: &Identification) -> Vec<Diagnostic> {
    let of: [(&'static str, fn(&Orders) -> usize, &'static str); 3] =
        [("na", |o| o.na, "--order or --na"), ("nb", |o| o.nb, "--order or --nb"), ("nk", |o| o.nk, "--nk")];
    let last = |(what, of, option): (&'static str, fn(&Orders) -> usize, &'static str)| {
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

fn correlated(residuals: &Residuals, has_instrument: bool) -> Vec<Diagnostic> {
    let mut diagnostics = Vec::new();
    if too_many(residuals.auto_outside()) {
        diagnostics.push(Diagnostic::Coloured { outside: residuals.auto_outside() });
    }
    if too_many(residuals.cross_outside()) {
        diagnostics.push(Diagnostic::Unexplained { outside: residuals.cross_outside() });
    }
    // What a model leaves unexplained goes with the input at all lags, since the input goes with itself: that is no
    // sign of feedback.
    if too_many(residuals.fed_back()) && !too_many(residuals.cross_outside()) {
        diagnostics.push(Diagnostic::FedBack { outside: residuals.fed_back(), has_instrument });
    }
    diagnostics
}
