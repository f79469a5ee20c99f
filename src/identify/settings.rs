//! What `identify` is asked for.

use super::fit::InitialState;
use super::model::{Noise, Orders};
use super::periodic::Repeats;
use super::reduce::{Removal, Target};
use super::search::Criterion;

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
    pub initial_state: InitialState,
    /// How far to reduce.
    pub target: Target,
    /// How states are removed.
    pub removal: Removal,
    /// Whether to reduce for all frequencies alike, as the paper does, and not for the excited band alone.
    pub all_frequencies: bool,
    /// Repetitions of the bootstrap.
    pub bootstrap: usize,
    /// That the input of the data fitted repeats: its periods are averaged too, and a model is fitted to their lines.
    pub repeats: Option<Repeats>,
}

impl Estimator {
    /// Where it takes the noise to enter.
    pub fn noise(self) -> Noise {
        match self {
            Self::Arx => Noise::Equation,
            Self::OutputError | Self::Instrumental => Noise::Output,
        }
    }

    /// As people have it.
    pub fn words(self) -> &'static str {
        match self {
            Self::Arx => "ARX",
            Self::OutputError => "output error",
            Self::Instrumental => "instrumental variables",
        }
    }
}
