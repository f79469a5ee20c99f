//! Reasons why a result is less reliable than it looks, in words.

use crate::identify::checks::frozen::Frozen;
use crate::identify::checks::gain_change::GainChange;
use crate::identify::checks::gain_drift::GainDrift;
use crate::identify::checks::jump::Jump;
use crate::identify::checks::model_error::ModelError;
use crate::identify::checks::nonlinear::Nonlinear;
use crate::identify::checks::outliers::Outliers;
use crate::identify::model::polynomials::Orders;
use crate::plural::plural;
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
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Diagnostic {
    /// A model is unstable.
    #[error(
        "{title}: unstable, its largest pole is {largest_pole:.5}; simulations with it run away. Choose other orders, \
         remove trends (--detrend), or use fewer samples per second (--decimate)"
    )]
    Unstable {
        /// The model.
        title: String,
        /// Modulus of its largest pole.
        largest_pole: f64,
    },
    /// A model's largest pole is barely inside the unit circle.
    #[error(
        "{title}: the largest pole is {largest_pole:.6}, nearly 1; gain and phase at low frequencies are hardly known"
    )]
    NearlyUnstable {
        /// The model.
        title: String,
        /// Modulus of its largest pole.
        largest_pole: f64,
    },
    /// The input changes between samples, and there is no H(s) that tells what that does to the output.
    #[error(
        "the commands change between frames: a model of samples takes their means as held, and its gain is too large, \
         the more the faster they change; without a refined model whose H(s) settles this is not corrected, and there \
         is no σ"
    )]
    BetweenSamples,
    /// A model explains little of the data it was fitted to.
    #[error(
        "{title}: {}its simulation leaves {} of the energy of the data it was fitted to: {}{}",
        if *.error_percent > 100.0 { "does not describe the data, " } else { "" }, left_over(*.error_percent),
        .other.as_ref().map_or_else(|| why_poor(*.linear), |other| format!("use {other}, which describes them")),
        if *.has_sigma { "" } else { "; it has no σ" }
    )]
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
    #[error(
        "{record}: {title} simulates it worse than zero would ({} of the energy left), but not the data it was fitted \
         to: are units, coil, delay and signs the same? Orders were judged by it too",
        left_over(*.error_percent)
    )]
    StrangeRecord {
        /// The model.
        title: String,
        /// The record.
        record: String,
        /// Simulation error, % of the energy.
        error_percent: f64,
    },
    /// Coils whose currents nearly always change together.
    #[error(
        "the currents of {} change almost only together ({:.1} % of it apart): which of them moves the catheter is \
         hardly known, and their responses have errors larger than they look; let each change on its own (catoptra \
         excite multisine, with other seeds)",
        .coils.join(" and "), 100.0 * .ratio
    )]
    Together {
        /// The coils.
        coils: Vec<String>,
        /// How much of the currents' motion tells them apart, relative to what they do together.
        ratio: f64,
    },
    /// The regressors are nearly dependent.
    #[error("the regressors nearly depend on each other (condition {condition:.1e}): lower orders would do")]
    IllConditioned {
        /// Condition number.
        condition: f64,
    },
    /// The sampling is much faster than the output moves.
    #[error(
        "the output moves below {output_hz:.3} Hz and is sampled at {rate_hz:.1} Hz: noise then decides the \
         coefficients of Eq. 6; --decimate {factor} keeps all that moves"
    )]
    Oversampled {
        /// 99 % of the output's energy lie below, Hz.
        output_hz: f64,
        /// Samples per second.
        rate_hz: f64,
        /// Suggested value of `--decimate`.
        factor: usize,
    },
    /// The signals have a mean that the model must explain.
    #[error("the mean of the {what} is {ratio:.1} times its spread: --detrend mean removes it")]
    OffCentre {
        /// `input` or `output`.
        what: &'static str,
        /// Mean over standard deviation.
        ratio: f64,
    },
    /// Outputs that are far from their neighbours.
    #[error("{record}: {outliers}")]
    Outlying {
        /// The record.
        record: String,
        /// How many, and the worst.
        outliers: Outliers,
    },
    /// Records that the common model fits best with different factors.
    #[error(
        "{} would fit the common model best times {:.3}, {} times {:.3}{}: other units, another coil or amplifier \
         range, or a response that depends on the size of the motion? Identify them one by one",
        .records[1].0, .records[1].1, .records[0].0, .records[0].1, if *.certain { "" } else { ", by noise or not" }
    )]
    Gains {
        /// The records that differ most, each with its factor.
        records: [(String, f64); 2],
        /// Whether that is beyond noise.
        certain: bool,
    },
    /// An output that lies elsewhere from some moment on.
    #[error("{record}: {jump}")]
    Jumps {
        /// The record.
        record: String,
        /// Where, and by how much.
        jump: Jump,
    },
    /// An input or output that was recorded as one value while the real one moved.
    #[error("{record}: {frozen}")]
    Frozen {
        /// The record.
        record: String,
        /// Where, and how long.
        frozen: Frozen,
    },
    /// An output that is larger or smaller by a factor from some moment on.
    #[error("{record}: {change}")]
    GainChange {
        /// The record.
        record: String,
        /// Where, and by which factor.
        change: GainChange,
    },
    /// The gain of a record drifts.
    #[error("{record}: {drift}")]
    GainDrift {
        /// The record.
        record: String,
        /// How it does.
        drift: GainDrift,
    },
    /// What is told of the records leaves the refined model no σ.
    #[error("{title}: it has no σ, since the problems reported for the records bias its coefficients")]
    OfWrongValues {
        /// Its name.
        title: String,
    },
    /// A system that is not linear.
    #[error("{record}: {found}")]
    Nonlinear {
        /// The record.
        record: String,
        /// What is not.
        found: Nonlinear,
    },
    /// An output that stays at its limit.
    #[error(
        "{record}: {count} outputs are exactly {value:.6}, and none is beyond: where a scale ends the model is wrong; \
         leave these cells empty"
    )]
    AtLimit {
        /// The record.
        record: String,
        /// How often.
        count: usize,
        /// The limit, unit of the output.
        value: f64,
    },
    /// The system was not at rest when the record began.
    #[error(
        "simulated from rest the refined model leaves {from_rest:.3} % of the energy, and {from_estimated:.3} % from \
         the state that fits best: the records do not begin at rest; use --start estimated"
    )]
    NotAtRest {
        /// Simulation error from rest, % of the energy.
        from_rest: f64,
        /// The same from the state that fits best.
        from_estimated: f64,
    },
    /// A torque moves the angle against its direction.
    #[error(
        "{title}: at {frequency_hz:.2} Hz the angle leads the torque by {phase_deg:.0}°, so that a torque moves it the \
         wrong way: is the sign of the current or of θ wrong?"
    )]
    AgainstTorque {
        /// The model.
        title: String,
        /// Phase of the response, degrees.
        phase_deg: f64,
        /// At this frequency, Hz.
        frequency_hz: f64,
    },
    /// The best orders are the largest of those searched.
    #[error("{what} {value} is the last that was searched: a better one may lie beyond, search further with {option}")]
    AtEdge {
        /// `na`, `nb` or `nk`.
        what: &'static str,
        /// Its value.
        value: usize,
        /// The option that searches further.
        option: &'static str,
    },
    /// The estimator failed for the best orders.
    #[error(
        "the estimator has no answer for the best orders (na {}, nb {}, nk {}): na {}, nb {}, nk {} are used",
        .best.na, .best.nb, .best.nk, .used.na, .used.nb, .used.nk
    )]
    LowerOrders {
        /// The best orders.
        best: Orders,
        /// The orders used.
        used: Orders,
    },
    /// The model would be unstable if reduced for the excited band.
    #[error("reduced for the excited band the model is unstable: it is reduced for all frequencies")]
    UnstableInBand,
    /// H(s) of the reduced model is an approximation.
    #[error(
        "{title}: no H(s) with a held input has this response, since a real pole of the discrete model is not \
         positive; what is given is Tustin's approximation, for low frequencies only"
    )]
    NotHeld {
        /// The model.
        title: String,
    },
    /// The zero of H(s) acts like a delay of less than a sample.
    #[error(
        "{title}: the zero of its H(s) acts like a delay of {:.1} ms, less than a sample: it may be that, and none of \
         the system's own",
        .delay_s * 1e3
    )]
    DelayingZero {
        /// The model.
        title: String,
        /// The delay, seconds.
        delay_s: f64,
    },
    /// Residuals of the full model are not white.
    #[error(
        "residuals of the full model are not white ({} of {} lags outside the 99 % bound): its standard errors are too \
         small, and it may be biased",
        .outside.0, .outside.1
    )]
    Coloured {
        /// Lags beyond the bound, and the total number.
        outside: (usize, usize),
    },
    /// Residuals of the full model are correlated with the input.
    #[error(
        "residuals of the full model are correlated with the input ({} of {} lags outside the 99 % bound): it leaves \
         something unexplained",
        .outside.0, .outside.1
    )]
    Unexplained {
        /// Lags beyond the bound, and the total number.
        outside: (usize, usize),
    },
    /// The input carries the output's noise.
    #[error(
        "the input is correlated with earlier residuals ({} of {} lags outside the 99 % bound): {way}",
        .outside.0, .outside.1
    )]
    FedBack {
        /// Lags beyond the bound, and the total number.
        outside: (usize, usize),
        /// How it could have come there.
        way: WayBack,
    },
    /// What the refined model leaves follows the input: it has no σ.
    #[error(
        "{title}: what its simulation leaves still follows the input, {times:.1} times as much as noise does at most: \
         its order is too low, its delay not of whole samples, or the system not linear. It has no σ, since its \
         coefficients are off by more than noise explains; raise --reduce"
    )]
    Follows {
        /// The model.
        title: String,
        /// χ² of that over its limit.
        times: f64,
    },
    /// What the refined model leaves is in the input that comes after it: it has no σ.
    #[error(
        "{title}: what it leaves of the output is in the input that comes after, {times:.1} times as much as chance \
         explains: the input was computed from the output. It has no σ, since feedback biases it where the noise of \
         the output is not white, and ARX where its own residuals are not; use a record without feedback"
    )]
    InInput {
        /// The model.
        title: String,
        /// χ² of that over its limit.
        times: f64,
    },
    /// What the refined model leaves has a mean or trend: it has no σ.
    #[error(
        "{title}: what its simulation leaves has a mean or trend, {times:.1} times as much as noise explains: it has \
         no σ, since that biases its coefficients. --detrend mean or --detrend linear removes it"
    )]
    Straight {
        /// The model.
        title: String,
        /// χ² of that over its limit.
        times: f64,
    },
    /// A lower order explains the data about as well.
    #[error(
        "{title}: a model of order {order} explains the data about as well: what this one has more is hardly known. \
         --reduce {order} gives it, and a smaller σ"
    )]
    LowerOrder {
        /// The model.
        title: String,
        /// The order.
        order: usize,
    },
    /// A higher order explains the data clearly better: the refined model has no σ.
    #[error(
        "{title}: a model of order {order} explains the data better by more than noise does: this one lacks a mode. It \
         has no σ, since its coefficients are off by that; raise --reduce"
    )]
    HigherOrder {
        /// The model.
        title: String,
        /// The order.
        order: usize,
    },
    /// The refined model does not confirm the reduced one, which has no σ.
    #[error("{title}: {}", how_reduced_differs(*.sigmas))]
    ReducedDiffers {
        /// The model.
        title: String,
        /// By how much, in σ; `None` where the refined model has none either.
        sigmas: Option<f64>,
    },
    /// The output answers sooner than the shortest delay that was searched: the refined model has no σ.
    #[error(
        "{title}: the output seems to come before the input: nk {nk}, less than was searched, explains the data \
         clearly better. It has no σ. Are input and output a row apart (--nk {nk} then takes them as they are), was \
         the input computed from this output, or is the order too low (--reduce)?"
    )]
    Sooner {
        /// The model.
        title: String,
        /// The delay that explains the data clearly better, samples (nk).
        nk: usize,
    },
    /// The refined model's order is too low: it has no σ.
    #[error("{title}: {error}")]
    ModelError {
        /// The model.
        title: String,
        /// What it and the full model leave.
        error: ModelError,
    },
    /// There is no reduced model.
    #[error("there is no reduced model: {why}")]
    NotReduced {
        /// Why.
        why: String,
    },
    /// The model has fewer significant states than requested.
    #[error(
        "reduced to order {asked}: the full model has only {} that matter{}",
        plural(*.has, "state"), if *.has == 1 { "s, and it is kept" } else { ", and they are all kept" }
    )]
    FewerStates {
        /// The requested order.
        asked: usize,
        /// The model's order.
        has: usize,
    },
    /// There is no refined model.
    #[error("there is no refined model: {why}")]
    NotRefined {
        /// Why.
        why: String,
    },
    /// Other delays explain the data about as well.
    #[error(
        "{title}: nk {} would explain the data about as well as nk {nk}, the shortest, which is taken; its numerator \
         and σ hold for that delay. Where it is known, give it with --nk",
        .others.iter().map(usize::to_string).collect::<Vec<_>>().join(", ")
    )]
    OtherDelays {
        /// The model.
        title: String,
        /// Its delay, samples (nk).
        nk: usize,
        /// The others.
        others: Vec<usize>,
    },
    /// A search for the smallest error did not converge.
    #[error("{title}: the search did not converge in {steps} steps")]
    NotConverged {
        /// The model.
        title: String,
        /// Steps taken.
        steps: usize,
    },
    /// The system has not settled when averaging begins.
    #[error(
        "the first period that is averaged differs from the others {off:.1} times more than noise explains: leave out \
         more than {skipped} with --repeats T:{}",
        .skipped + 1
    )]
    NotSteady {
        /// Deviation of the first period, relative to noise.
        off: f64,
        /// Periods left out.
        skipped: usize,
    },
    /// The spectral lines contain something that model and noise do not explain.
    #[error(
        "what the model leaves of the periods' lines is {left:.2} times what noise explains: what repeats is not \
         linear, or of a higher order (--reduce); {}",
        if *.has_sigma { "σ is widened by the root of that" } else { "it has no σ, which noise would not decide" }
    )]
    BeyondNoise {
        /// Residual relative to noise.
        left: f64,
        /// Whether there is a σ all the same.
        has_sigma: bool,
    },
    /// Many lines of a repeating input do not stand out of its noise.
    #[error(
        "{record}: {noisy} of {of} lines of the input do not stand out of its noise and are left out: if the input has \
         these lines, average more periods"
    )]
    NoisyLines {
        /// The record.
        record: String,
        /// How many.
        noisy: usize,
        /// Of how many.
        of: usize,
    },
    /// Too few periods for reliable σ.
    #[error("{periods} periods are averaged: from 7 on their noise is known well enough for the σ of H(s)")]
    FewPeriods {
        /// How many.
        periods: usize,
    },
    /// The record is too short for a frequency response without a model.
    #[error("no stretch is long enough for a frequency response without a model; the excited band is not known")]
    NoSpectrum,
    /// Samples so far apart, or so close, that the times may have another unit.
    #[error(
        "samples are {} s apart: are the times {}? They are taken as seconds",
        if *.period_s < 1e-3 { format!("{:.1e}", .period_s) } else { format!("{:.4}", .period_s) },
        likely_unit(*.period_s)
    )]
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

/// By how much the reduced model differs from the refined one, in σ, and what that means.
fn how_reduced_differs(sigmas: Option<f64>) -> String {
    let Some(sigmas) = sigmas else { return "it has no σ, since the refined model has none".to_owned() };
    let up_to = if sigmas < MOST_SIGMAS { format!("up to {sigmas:.1}") } else { "many".to_owned() };
    format!(
        "its response differs from that of the refined model by {up_to} σ: it has no σ, which would not contain what \
         noise of the output biases ARX by. Use the refined model"
    )
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
