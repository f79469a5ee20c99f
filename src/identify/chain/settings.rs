//! Settings of `identify`.

use crate::identify::estimate::search::Criterion;
use crate::identify::model::polynomials::{Noise, Orders};
use crate::identify::model::reproduction::InitialState;
use crate::identify::periodic::Repeats;
use crate::identify::reduce::truncation::{Removal, Target};

/// How the full model is estimated.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Estimator {
    /// By least squares, as in the paper.
    #[default]
    Arx,
    /// By output error, started from ARX.
    OutputError,
    /// By instrumental variables, started from ARX.
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
        /// The criterion; by default simulation of the validation data, or minimum description length if there are
        /// none.
        criterion: Option<Criterion>,
    },
}

impl Choice {
    /// The same, with the past outputs and inputs of one: only the delay is searched.
    pub(in crate::identify) fn of_orders(&self, found: Orders) -> Self {
        match self {
            Self::Fixed(orders) => Self::Fixed(*orders),
            Self::Search { candidates, criterion } => {
                let is_like = |orders: &&Orders| (orders.na, orders.nb) == (found.na, found.nb);
                Self::Search { candidates: candidates.iter().filter(is_like).copied().collect(), criterion: *criterion }
            }
        }
    }
}

/// Settings of an identification.
#[derive(Debug, Clone, PartialEq)]
pub struct Settings {
    /// Orders and delay.
    pub choice: Choice,
    /// How the full model is estimated.
    pub estimator: Estimator,
    /// Initial state of simulations.
    pub initial_state: InitialState,
    /// Target of the reduction.
    pub target: Target,
    /// How states are removed.
    pub removal: Removal,
    /// Whether to reduce for all frequencies, as in the paper, instead of only for the excited band.
    pub all_frequencies: bool,
    /// Repetitions of the bootstrap.
    pub bootstrap: usize,
    /// Declares that the input of the fitted data repeats: its periods are then also averaged, and a model is fitted to
    /// their lines.
    pub repeats: Option<Repeats>,
    /// Whether the input was told to the system: nothing of the output can be in it.
    pub commanded: bool,
    /// Declares that rows of a fitted record seem to be shifted, or commands lacking: what follows has no σ.
    pub doubtful: bool,
}

impl Estimator {
    /// Where it assumes the noise to enter.
    pub fn noise(self) -> Noise {
        match self {
            Self::Arx => Noise::Equation,
            Self::OutputError | Self::Instrumental => Noise::Output,
        }
    }

    /// The name for people.
    pub fn words(self) -> &'static str {
        match self {
            Self::Arx => "ARX",
            Self::OutputError => "output error",
            Self::Instrumental => "instrumental variables",
        }
    }
}
