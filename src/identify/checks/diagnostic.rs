//! Reasons why a result is less reliable than it looks, in words.

use crate::identify::checks::frozen::Frozen;
use crate::identify::checks::gain_change::GainChange;
use crate::identify::checks::gain_drift::GainDrift;
use crate::identify::checks::jump::Jump;
use crate::identify::checks::model_error::ModelError;
use crate::identify::checks::nonlinear::Nonlinear;
use crate::identify::checks::outliers::Outliers;
use crate::identify::model::polynomials::Orders;
use std::fmt;

/// Fraction of the output's energy that follows the input above which the input is the right one.
const MIN_EXPLAINED: f64 = 0.5;
/// So many times what does not follow the input is no noise.
const MORE_THAN_NOISE: f64 = 2.0;
/// Largest error that is told as a number, percent.
const MOST_PERCENT: f64 = 1000.0;
/// The same in σ.
const MOST_SIGMAS: f64 = 1000.0;

/// A reason why the result is less reliable than it looks.
#[derive(Debug, Clone, PartialEq)]
pub enum Diagnostic {
    /// A model is unstable.
    Unstable {
        /// The model.
        title: String,
        /// Modulus of its largest pole.
        largest_pole: f64,
    },
    /// A model's largest pole is barely inside the unit circle.
    NearlyUnstable {
        /// The model.
        title: String,
        /// Modulus of its largest pole.
        largest_pole: f64,
    },
    /// The input changes between samples, and there is no H(s) that tells what that does to the output.
    BetweenSamples,
    /// A model explains little of the data it was fitted to.
    Poor {
        /// The model.
        title: String,
        /// Simulation error, % of the energy.
        error_percent: f64,
        /// Fraction of the output's energy that follows the input linearly, from the spectra, if there are any.
        linear: Option<f64>,
        /// The model to use, if that explains more.
        other: Option<String>,
        /// Whether it has a σ all the same: what it leaves may be noise.
        has_sigma: bool,
    },
    /// A record to judge by is unlike those that were fitted.
    StrangeRecord {
        /// The model.
        title: String,
        /// The record.
        record: String,
        /// Simulation error, % of the energy.
        error_percent: f64,
    },
    /// Coils whose currents nearly always change together.
    Together {
        /// The coils.
        coils: Vec<String>,
        /// How much of the currents' motion tells them apart, relative to what they do together.
        ratio: f64,
    },
    /// The regressors are nearly dependent.
    IllConditioned {
        /// Condition number.
        condition: f64,
    },
    /// The sampling is much faster than the output moves.
    Oversampled {
        /// 99 % of the output's energy lie below, Hz.
        output_hz: f64,
        /// Samples per second.
        rate_hz: f64,
        /// Suggested value of `--decimate`.
        factor: usize,
    },
    /// The signals have a mean that the model must explain.
    OffCentre {
        /// `input` or `output`.
        what: &'static str,
        /// Mean over standard deviation.
        ratio: f64,
    },
    /// Outputs that are far from their neighbours.
    Outlying {
        /// The record.
        record: String,
        /// How many, and the worst.
        outliers: Outliers,
    },
    /// Records that the common model fits best with different factors.
    Gains {
        /// The records that differ most, each with its factor.
        records: [(String, f64); 2],
        /// Whether that is beyond noise.
        certain: bool,
    },
    /// An output that lies elsewhere from some moment on.
    Jumps {
        /// The record.
        record: String,
        /// Where, and by how much.
        jump: Jump,
    },
    /// An input or output that was recorded as one value while the real one moved.
    Frozen {
        /// The record.
        record: String,
        /// Where, and how long.
        frozen: Frozen,
    },
    /// An output that is larger or smaller by a factor from some moment on.
    GainChange {
        /// The record.
        record: String,
        /// Where, and by which factor.
        change: GainChange,
    },
    /// The gain of a record drifts.
    GainDrift {
        /// The record.
        record: String,
        /// How it does.
        drift: GainDrift,
    },
    /// What is told of the records leaves the refined model no σ.
    OfWrongValues {
        /// Its name.
        title: String,
    },
    /// A system that is not linear.
    Nonlinear {
        /// The record.
        record: String,
        /// What is not.
        found: Nonlinear,
    },
    /// An output that stays at its limit.
    AtLimit {
        /// The record.
        record: String,
        /// How often.
        count: usize,
        /// The limit, unit of the output.
        value: f64,
    },
    /// The system was not at rest when the record began.
    NotAtRest {
        /// Simulation error from rest, % of the energy.
        from_rest: f64,
        /// The same from the state that fits best.
        from_estimated: f64,
    },
    /// A torque moves the angle against its direction.
    AgainstTorque {
        /// The model.
        title: String,
        /// Phase of the response, degrees.
        phase_deg: f64,
        /// At this frequency, Hz.
        frequency_hz: f64,
    },
    /// The best orders are the largest of those searched.
    AtEdge {
        /// `na`, `nb` or `nk`.
        what: &'static str,
        /// Its value.
        value: usize,
        /// The option that searches further.
        option: &'static str,
    },
    /// The estimator failed for the best orders.
    LowerOrders {
        /// The best orders.
        best: Orders,
        /// The orders used.
        used: Orders,
    },
    /// The model would be unstable if reduced for the excited band.
    UnstableInBand,
    /// H(s) of the reduced model is an approximation.
    NotHeld {
        /// The model.
        title: String,
    },
    /// The zero of H(s) acts like a delay of less than a sample.
    DelayingZero {
        /// The model.
        title: String,
        /// The delay, seconds.
        delay_s: f64,
    },
    /// Residuals of the full model are not white.
    Coloured {
        /// Lags beyond the bound, and the total number.
        outside: (usize, usize),
    },
    /// Residuals of the full model are correlated with the input.
    Unexplained {
        /// Lags beyond the bound, and the total number.
        outside: (usize, usize),
    },
    /// The input carries the output's noise.
    FedBack {
        /// Lags beyond the bound, and the total number.
        outside: (usize, usize),
        /// How it could have come there.
        way: WayBack,
    },
    /// What the refined model leaves follows the input: it has no σ.
    Follows {
        /// The model.
        title: String,
        /// χ² of that over its limit.
        times: f64,
    },
    /// What the refined model leaves is in the input that comes after it: it has no σ.
    InInput {
        /// The model.
        title: String,
        /// χ² of that over its limit.
        times: f64,
    },
    /// What the refined model leaves has a mean or trend: it has no σ.
    Straight {
        /// The model.
        title: String,
        /// χ² of that over its limit.
        times: f64,
    },
    /// A lower order explains the data about as well.
    LowerOrder {
        /// The model.
        title: String,
        /// The order.
        order: usize,
    },
    /// A higher order explains the data clearly better: the refined model has no σ.
    HigherOrder {
        /// The model.
        title: String,
        /// The order.
        order: usize,
    },
    /// The refined model does not confirm the reduced one, which has no σ.
    ReducedDiffers {
        /// The model.
        title: String,
        /// By how much, in σ; `None` where the refined model has none either.
        sigmas: Option<f64>,
    },
    /// The output answers sooner than the shortest delay that was searched: the refined model has no σ.
    Sooner {
        /// The model.
        title: String,
        /// The delay that explains the data clearly better, samples (nk).
        nk: usize,
    },
    /// The refined model's order is too low: it has no σ.
    ModelError {
        /// The model.
        title: String,
        /// What it and the full model leave.
        error: ModelError,
    },
    /// There is no reduced model.
    NotReduced {
        /// Why.
        why: String,
    },
    /// The model has fewer significant states than requested.
    FewerStates {
        /// The requested order.
        asked: usize,
        /// The model's order.
        has: usize,
    },
    /// There is no refined model.
    NotRefined {
        /// Why.
        why: String,
    },
    /// Other delays explain the data about as well.
    OtherDelays {
        /// The model.
        title: String,
        /// Its delay, samples (nk).
        nk: usize,
        /// The others.
        others: Vec<usize>,
    },
    /// A search for the smallest error did not converge.
    NotConverged {
        /// The model.
        title: String,
        /// Steps taken.
        steps: usize,
    },
    /// The system has not settled when averaging begins.
    NotSteady {
        /// Deviation of the first period, relative to noise.
        off: f64,
        /// Periods left out.
        skipped: usize,
    },
    /// The spectral lines contain something that model and noise do not explain.
    BeyondNoise {
        /// Residual relative to noise.
        left: f64,
        /// Whether there is a σ all the same.
        has_sigma: bool,
    },
    /// Many lines of a repeating input do not stand out of its noise.
    NoisyLines {
        /// The record.
        record: String,
        /// How many.
        noisy: usize,
        /// Of how many.
        of: usize,
    },
    /// Too few periods for reliable σ.
    FewPeriods {
        /// How many.
        periods: usize,
    },
    /// The record is too short for a frequency response without a model.
    NoSpectrum,
    /// Samples so far apart, or so close, that the times may have another unit.
    OtherUnit {
        /// Seconds from sample to sample.
        period_s: f64,
    },
}

/// A way from the output back to the input.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum WayBack {
    /// None: the input was commanded.
    Open,
    /// There is one, and a signal that drives the input without the output's noise.
    Instrument,
    /// Not known.
    Unknown,
}

/// An error, of which large figures say nothing.
fn left_over(error_percent: f64) -> String {
    if error_percent > MOST_PERCENT {
        return format!("more than {MOST_PERCENT:.0} %");
    }
    format!("{error_percent:.0} %")
}

/// Whether a simulation leaves so much of the output's energy, percent, that it is not noise that it leaves: more than
/// half, and more than [`MORE_THAN_NOISE`] times what does not follow the input (`linear`: the fraction that does).
pub(in crate::identify) fn leaves_more_than_noise(error_percent: f64, linear: Option<f64>) -> bool {
    let left = error_percent / 100.0;
    left > MIN_EXPLAINED && linear.is_some_and(|follows| left > MORE_THAN_NOISE * (1.0 - follows))
}

/// Whether a model that explains little is of too low an order, or of another input.
fn why_poor(linear: Option<f64>) -> String {
    match linear {
        Some(part) if part > MIN_EXPLAINED => {
            let percent = 100.0 * part;
            format!("{percent:.0} % of it follow the input, so a higher order, or another delay, would explain more")
        }
        _ => "is this the input that moved it?".to_owned(),
    }
}

/// What times are probably in that give so long a period as seconds: samples are 10 to 10,000 times a second.
fn likely_unit(period_s: f64) -> &'static str {
    match period_s {
        ..=1e-5 => "days",
        ..=1e-2 => "minutes",
        ..=100.0 => "milliseconds",
        ..=1e5 => "microseconds",
        _ => "nanoseconds",
    }
}

impl fmt::Display for WayBack {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let fed_back = "noise of the output is fed back into it, which biases ARX where its residuals are not white, \
                        and the refined model where the noise at the output is not; compare with";
        match self {
            Self::Open => write!(
                f,
                "currents that were commanded know nothing of the output, so that their times are late (--delay), or \
                 an input that repeats is alike at other lags"
            ),
            Self::Instrument => write!(f, "{fed_back} --estimator iv"),
            // Without an instrument the input would be its own, including the noise.
            Self::Unknown => write!(f, "{fed_back} a record without feedback"),
        }
    }
}

impl fmt::Display for Diagnostic {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Unstable { title, largest_pole } => write!(
                f,
                "{title}: unstable, its largest pole is {largest_pole:.5}; simulations with it run away. Choose other \
                 orders, remove trends (--detrend), or use fewer samples per second (--decimate)"
            ),
            Self::NearlyUnstable { title, largest_pole } => {
                write!(
                    f,
                    "{title}: the largest pole is {largest_pole:.6}, nearly 1; gain and phase at low frequencies are \
                     hardly known"
                )
            }
            Self::BetweenSamples => f.write_str(
                "the commands change between frames: a model of samples takes their means as held, and its gain is too \
                 large, the more the faster they change; without a refined model whose H(s) settles this is not \
                 corrected, and there is no σ",
            ),
            Self::StrangeRecord { title, record, error_percent } => write!(
                f,
                "{record}: {title} simulates it worse than zero would ({} of the energy left), but not the data it was \
                 fitted to: are units, coil, delay and signs the same? Orders were judged by it too",
                left_over(*error_percent)
            ),
            Self::Poor { title, error_percent, linear, other, has_sigma } => write!(
                f,
                "{title}: {}its simulation leaves {} of the energy of the data it was fitted to: {}{}",
                if *error_percent > 100.0 { "does not describe the data, " } else { "" },
                left_over(*error_percent),
                other.as_ref().map_or_else(|| why_poor(*linear), |other| format!("use {other}, which describes them")),
                if *has_sigma { "" } else { "; it has no σ" }
            ),
            Self::Together { coils, ratio } => write!(
                f,
                "the currents of {} change almost only together ({:.1} % of it apart): which of them moves the \
                 catheter is hardly known, and their responses have errors larger than they look; let each change on \
                 its own (catoptra excite multisine, with other seeds)",
                coils.join(" and "),
                100.0 * ratio
            ),
            Self::IllConditioned { condition } => {
                write!(
                    f,
                    "the regressors nearly depend on each other (condition {condition:.1e}): lower orders would do"
                )
            }
            Self::Oversampled { output_hz, rate_hz, factor } => write!(
                f,
                "the output moves below {output_hz:.3} Hz and is sampled at {rate_hz:.1} Hz: noise then decides the \
                 coefficients of Eq. 6; --decimate {factor} keeps all that moves"
            ),
            Self::OffCentre { what, ratio } => {
                write!(f, "the mean of the {what} is {ratio:.1} times its spread: --detrend mean removes it")
            }
            Self::Outlying { record, outliers } => write!(f, "{record}: {outliers}"),
            Self::Gains { records: [(less, least), (more, most)], certain } => write!(
                f,
                "{more} would fit the common model best times {most:.3}, {less} times {least:.3}{}: other units, \
                 another coil or amplifier range, or a response that depends on the size of the motion? Identify them \
                 one by one",
                if *certain { "" } else { ", by noise or not" }
            ),
            Self::Jumps { record, jump } => write!(f, "{record}: {jump}"),
            Self::Frozen { record, frozen } => write!(f, "{record}: {frozen}"),
            Self::GainChange { record, change } => write!(f, "{record}: {change}"),
            Self::GainDrift { record, drift } => write!(f, "{record}: {drift}"),
            Self::Nonlinear { record, found } => write!(f, "{record}: {found}"),
            Self::OfWrongValues { title } => {
                write!(f, "{title}: it has no σ, since the problems reported for the records bias its coefficients")
            }
            Self::AtLimit { record, count, value } => write!(
                f,
                "{record}: {count} outputs are exactly {value:.6}, and none is beyond: where a scale ends the model \
                 is wrong; leave these cells empty"
            ),
            Self::NotAtRest { from_rest, from_estimated } => write!(
                f,
                "simulated from rest the refined model leaves {from_rest:.3} % of the energy, and {from_estimated:.3} \
                 % from the state that fits best: the records do not begin at rest; use --start estimated"
            ),
            Self::AgainstTorque { title, phase_deg, frequency_hz } => write!(
                f,
                "{title}: at {frequency_hz:.2} Hz the angle leads the torque by {phase_deg:.0}°, so that a torque \
                 moves it the wrong way: is the sign of the current or of θ wrong?"
            ),
            Self::Coloured { outside: (n, of) } => write!(
                f,
                "residuals of the full model are not white ({n} of {of} lags outside the 99 % bound): its standard \
                 errors are too small, and it may be biased"
            ),
            Self::Unexplained { outside: (n, of) } => {
                write!(
                    f,
                    "residuals of the full model are correlated with the input ({n} of {of} lags outside the 99 % \
                     bound): it leaves something unexplained"
                )
            }
            Self::FedBack { outside: (n, of), way } => write!(
                f,
                "the input is correlated with earlier residuals ({n} of {of} lags outside the 99 % bound): {way}"
            ),
            Self::Follows { title, times } => write!(
                f,
                "{title}: what its simulation leaves still follows the input, {times:.1} times as much as noise does \
                 at most: its order is too low, its delay not of whole samples, or the system not linear. It has no σ, \
                 since its coefficients are off by more than noise explains; raise --reduce"
            ),
            Self::InInput { title, times } => write!(
                f,
                "{title}: what it leaves of the output is in the input that comes after, {times:.1} times as much as \
                 chance explains: the input was computed from the output. It has no σ, since feedback biases it where \
                 the noise of the output is not white, and ARX where its own residuals are not; use a record without \
                 feedback"
            ),
            Self::Straight { title, times } => write!(
                f,
                "{title}: what its simulation leaves has a mean or trend, {times:.1} times as much as noise explains: \
                 it has no σ, since that biases its coefficients. --detrend mean or --detrend linear removes it"
            ),
            Self::LowerOrder { title, order } => write!(
                f,
                "{title}: a model of order {order} explains the data about as well: what this one has more is hardly \
                 known. --reduce {order} gives it, and a smaller σ"
            ),
            Self::HigherOrder { title, order } => write!(
                f,
                "{title}: a model of order {order} explains the data better by more than noise does: this one lacks a \
                 mode. It has no σ, since its coefficients are off by that; raise --reduce"
            ),
            Self::ReducedDiffers { title, sigmas: Some(sigmas) } => {
                let up_to = if *sigmas < MOST_SIGMAS { format!("up to {sigmas:.1}") } else { "many".to_owned() };
                write!(
                    f,
                    "{title}: its response differs from that of the refined model by {up_to} σ: it has no σ, which \
                     would not contain what noise of the output biases ARX by. Use the refined model"
                )
            }
            Self::ReducedDiffers { title, sigmas: None } => {
                write!(f, "{title}: it has no σ, since the refined model has none")
            }
            Self::Sooner { title, nk } => write!(
                f,
                "{title}: the output seems to come before the input: nk {nk}, less than was searched, explains the \
                 data clearly better. It has no σ. Are input and output a row apart (--nk {nk} then takes them as they \
                 are), was the input computed from this output, or is the order too low (--reduce)?"
            ),
            Self::ModelError { title, error } => write!(f, "{title}: {error}"),
            Self::AtEdge { what, value, option } => write!(
                f,
                "{what} {value} is the last that was searched: a better one may lie beyond, search further with \
                 {option}"
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
            Self::DelayingZero { title, delay_s } => write!(
                f,
                "{title}: the zero of its H(s) acts like a delay of {:.1} ms, less than a sample: it may be that, and \
                 none of the system's own",
                delay_s * 1e3
            ),
            Self::NotReduced { why } => write!(f, "there is no reduced model: {why}"),
            Self::FewerStates { asked, has: 1 } => {
                write!(f, "reduced to order {asked}: the full model has only 1 state that matters, and it is kept")
            }
            Self::FewerStates { asked, has } => write!(
                f,
                "reduced to order {asked}: the full model has only {has} states that matter, and they are all kept"
            ),
            Self::NotRefined { why } => write!(f, "there is no refined model: {why}"),
            Self::OtherDelays { title, nk, others } => write!(
                f,
                "{title}: nk {} would explain the data about as well as nk {nk}, the shortest, which is taken; its \
                 numerator and σ hold for that delay. Where it is known, give it with --nk",
                others.iter().map(usize::to_string).collect::<Vec<_>>().join(", ")
            ),
            Self::NotConverged { title, steps } => write!(f, "{title}: the search did not converge in {steps} steps"),
            Self::NotSteady { off, skipped } => write!(
                f,
                "the first period that is averaged differs from the others {off:.1} times more than noise explains: \
                 leave out more than {skipped} with --repeats T:{}",
                skipped + 1
            ),
            Self::BeyondNoise { left, has_sigma } => write!(
                f,
                "what the model leaves of the periods' lines is {left:.2} times what noise explains: what repeats is \
                 not linear, or of a higher order (--reduce); {}",
                if *has_sigma {
                    "σ is widened by the root of that"
                } else {
                    "it has no σ, which noise would not decide"
                }
            ),
            Self::NoisyLines { record, noisy, of } => write!(
                f,
                "{record}: {noisy} of {of} lines of the input do not stand out of its noise and are left out: if the \
                 input has these lines, average more periods"
            ),
            Self::FewPeriods { periods } => {
                write!(
                    f,
                    "{periods} periods are averaged: from 7 on their noise is known well enough for the σ of H(s)"
                )
            }
            Self::OtherUnit { period_s } => write!(
                f,
                "samples are {} s apart: are the times {}? They are taken as seconds",
                if *period_s < 1e-3 { format!("{period_s:.1e}") } else { format!("{period_s:.4}") },
                likely_unit(*period_s)
            ),
            Self::NoSpectrum => {
                write!(
                    f,
                    "no stretch is long enough for a frequency response without a model; the excited band is not known"
                )
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_left_of_an_output_that_follows_its_input_is_no_noise() {
        assert!(leaves_more_than_noise(87.0, Some(0.95)));
        // Mostly noise; a good model; nothing known of the noise.
        for (error_percent, follows) in [(87.0, Some(0.2)), (30.0, Some(1.0)), (87.0, None)] {
            assert!(!leaves_more_than_noise(error_percent, follows), "{error_percent}, {follows:?}");
        }
    }

    #[test]
    fn a_model_that_describes_nothing_is_not_given_a_number() {
        let poor = |error_percent| {
            Diagnostic::Poor { title: "ARX".to_owned(), error_percent, linear: None, other: None, has_sigma: true }
                .to_string()
        };
        assert!(poor(1e12).starts_with("ARX: does not describe the data, its simulation leaves more than 1000 % of"));
        assert!(poor(60.0).starts_with("ARX: its simulation leaves 60 % of the energy"));
    }
}
