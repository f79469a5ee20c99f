//! Dynamic models from recorded input and output: Section III.B of the paper, and current best practice.
//!
//! ```text
//!  log or table ─▶ from_recording ─▶ grid ─▶ prepare ─▶ search ─▶ arx ─────────▶ truncation ─▶ continuous
//!                  θ, current        Eq. 6   trends,    orders,   full model     fewer         H(s)
//!                  held              holes   fewer      delay     │              states
//!                                            samples              └ output_error, instrumental
//! ```
//! A record goes through these folders:
//!
//! 1. `data/`: segments on an even grid, without what is not of the system;
//! 2. `estimate/`: models of them, each with its covariance. `solve/` has the linear algebra; `model/` says what a
//!    model is and how well it reproduces a record; `reduce/` takes states away, also for where estimators begin;
//! 3. `checks/`: whether to believe record and model;
//! 4. `chain/`: all of these in their order. [`chain::steps::identify`] runs it, and its result has warnings to read
//!    before the numbers;
//! 5. `results/`: what is written of it (`export`; for people `crate::report::identification`), read back (`saved`),
//!    and compared with other records (`applied`).
//!
//! There are two more methods: `periodic/`, a step of the chain for a record whose input repeats, averages its periods
//! and fits H(s) to the lines; `planes/` identifies motion in two planes from several currents.
//!
//! Imports go one way: from `data` up through `solve`, `model`, `reduce` and `estimate` to `checks` and `periodic`,
//! from these to `chain`, and from it to `planes` and `results`.
//!
//! # Conventions
//! - `y(t) + a₁ y(t−1) + … = b₀ u(t−nk) + …`: `nk` counts all samples of delay, see `model::polynomials`. The input of
//!   a sample is held until the next.
//! - Signals are in segments of known input; an unobserved output is NaN and is left out, see `data::segments`.
//! - Covariances are kept as factors, see `model::covariance`; everything is solved by QR factorisation, see
//!   `solve::regression`.

pub(crate) mod chain;
pub(crate) mod checks;
pub(crate) mod data;
mod error;
pub(crate) mod estimate;
pub(crate) mod model;
pub(crate) mod periodic;
pub(crate) mod planes;
pub(crate) mod reduce;
pub(crate) mod results;
pub(crate) mod solve;
#[cfg(test)]
pub(crate) mod tests;

pub use chain::identification::Identification;
pub use chain::settings::Settings;
pub use chain::steps::identify;
pub use data::plant::Plant;
pub use data::segments::{Data, Segment};
pub use error::IdentifyError;
pub use estimate::arx::fit as fit_arx;
pub use estimate::search::search;
pub use model::continuous::{Continuous, Conversion};
pub use model::polynomials::{Orders, Polynomials};
pub use model::reproduction::InitialState;
pub use periodic::Repeats;
