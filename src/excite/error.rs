//! Why a signal cannot be made as requested.

/// Relative excess over a limit attributed to rounding.
pub(super) const ROUNDING: f64 = 1e-9;

/// Milliamperes with one decimal, or what is left of less: never more than it is.
fn rounded_down_ma(amperes: f64) -> String {
    // 0.1 is a little more than it looks like.
    let tenths = (amperes * 1e4 * (1.0 + ROUNDING)).floor();
    if tenths >= 1.0 { format!("{:.1}", tenths / 10.0) } else { format!("{:.4}", (amperes * 1e7).floor() / 1e4) }
}

/// Why a signal cannot be made as requested.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub(crate) enum ExciteError {
    /// A value that must be above 0.
    #[error("{what} is {value} {unit}; it must be above 0")]
    NotPositive {
        /// Which.
        what: &'static str,
        /// Its value.
        value: f64,
        /// Its unit.
        unit: &'static str,
    },
    /// Too few samples for a signal, or too many.
    #[error("{duration_s} s at {rate_hz} samples per second are {:.0} samples; 2 to {most} are \
        possible", duration_s * rate_hz)]
    Samples {
        /// Its length.
        duration_s: f64,
        /// Samples per second.
        rate_hz: f64,
        /// Most samples.
        most: usize,
    },
    /// A frequency that the rate cannot represent.
    #[error("{highest_hz} Hz exceeds the Nyquist frequency of {rate_hz} samples per second; stay below {} Hz, or raise \
        the rate", rate_hz / 2.0)]
    Nyquist {
        /// The highest frequency requested.
        highest_hz: f64,
        /// Samples per second.
        rate_hz: f64,
    },
    /// A band from a higher frequency to a lower one.
    #[error("the band goes from {from_hz} Hz down to {to_hz} Hz: give the lower frequency with --from")]
    Reversed {
        /// From.
        from_hz: f64,
        /// To.
        to_hz: f64,
    },
    /// A band without a line.
    #[error(
        "the band {from_hz} to {to_hz} Hz holds no multiple of {step_hz} Hz, 1 over the period; widen it or lengthen \
         the period"
    )]
    NoLine {
        /// From.
        from_hz: f64,
        /// To.
        to_hz: f64,
        /// Distance of lines.
        step_hz: f64,
    },
    /// A period that is not a whole number of samples.
    #[error("a period of {period_s} s is {:.3} samples at {rate_hz} per second, and must be a whole number: {near_s} s \
        is the nearest", period_s * rate_hz)]
    Period {
        /// The period.
        period_s: f64,
        /// Samples per second.
        rate_hz: f64,
        /// A nearby valid period.
        near_s: f64,
    },
    /// A signal that is shorter than a period.
    #[error(
        "{duration_s} s are less than the period of {period_s} s, and leave sines out: a --duration in whole periods, \
        or a shorter --period"
    )]
    ShorterThanPeriod {
        /// The length asked for.
        duration_s: f64,
        /// The period.
        period_s: f64,
    },
    /// A signal that is zero all the time as its file has it.
    #[error(
        "all of its currents are 0 in the file, whose step is {} mA: choose a larger amplitude, or a table in place of \
         a list", 1e3 * step_a
    )]
    Nothing {
        /// The file's step, amperes.
        step_a: f64,
    },
    /// A sweep on a logarithmic scale from a frequency to itself.
    #[error("a logarithmic sweep needs two frequencies that differ; both are {hz} Hz")]
    NoSweep {
        /// The frequency.
        hz: f64,
    },
    /// Too few different levels.
    #[error("steps need two levels that differ; {found} given")]
    Levels {
        /// How many different levels there are.
        found: usize,
    },
    /// Levels held too short.
    #[error("a level held for {hold_s} s is less than 2 samples at {rate_hz} per second; hold it for {} s or \
        longer", 2.0 / rate_hz)]
    Hold {
        /// The time.
        hold_s: f64,
        /// Samples per second.
        rate_hz: f64,
    },
    /// Levels that are never reached.
    #[error("in {duration_s} s, {fit} of {given} levels fit, each held for {hold_s} s: hold them shorter, or go on for \
        {} s or longer", hold_s * *given as f64)]
    UnusedLevels {
        /// Total length, seconds.
        duration_s: f64,
        /// How many levels are held in that time.
        fit: usize,
        /// How many there are.
        given: usize,
        /// How long each is held, seconds.
        hold_s: f64,
    },
    /// Beyond the limit of current.
    #[error(
        "the current reaches {:.1} mA, and from {at_s:.3} s on exceeds the limit of {limit} mA: an amplitude of \
         {limit} mA keeps it", value_a * 1e3, limit = rounded_down_ma(*limit_a)
    )]
    Current {
        /// Time of the first current beyond the limit, seconds.
        at_s: f64,
        /// The largest current, amperes.
        value_a: f64,
        /// The limit, amperes.
        limit_a: f64,
    },
    /// Beyond the limit of slew.
    #[error(
        "the current changes by up to {slew_a_s:.3} A/s, and from {at_s:.3} s on exceeds the limit of {limit_a_s} A/s: \
         an amplitude of {} mA keeps it{}",
        rounded_down_ma(*fits_a),
        if *.uneven { ", or a rate at which delays are whole ms, such as 250" } else { "" }
    )]
    Slew {
        /// Time of the first slew beyond the limit, seconds.
        at_s: f64,
        /// The largest slew.
        slew_a_s: f64,
        /// The limit.
        limit_a_s: f64,
        /// Amplitude at which the same signal keeps the limit.
        fits_a: f64,
        /// Whether delays are rounded.
        uneven: bool,
    },
    /// A ramp that does not reach the level while it is held.
    #[error(
        "the step at {at_s:.3} s takes {needs_s:.3} s at {limit_a_s} A/s, and levels are held for {hold_s} s: hold \
         them longer, or allow a larger slew"
    )]
    Unreached {
        /// When the step begins.
        at_s: f64,
        /// How long it takes.
        needs_s: f64,
        /// The limit.
        limit_a_s: f64,
        /// How long a level is held.
        hold_s: f64,
    },
}
