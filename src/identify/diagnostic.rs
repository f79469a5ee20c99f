//! What makes a result less than it looks, in words.

use std::fmt;

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
