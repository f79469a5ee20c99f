//! Dynamic models from recorded input and output: Section III.B of the paper, and current best practice.
//!
//! ```text
//!  log or table ─▶ recorded ─▶ grid ─▶ prepare ─▶ search ─▶ arx ─────────▶ reduce ─▶ continuous
//!                  θ, current  Eq. 6   trends,    orders,   full model     fewer     H(s)
//!                  held        holes   fewer      delay     │              states
//!                                      samples              └ output_error, instrumental
//! ```
//! For a record whose input repeats there is another method: `periodic` averages its periods and fits H(s) to the
//! lines. `saved` reads models back, `applied` compares them with other records.
//!
//! [`chain::identify`] runs it; `export::write` and `crate::report::identification` write the results. Besides the
//! models: `spectrum` (the response without a model), `bandwidth`, `residuals`, `bootstrap`, `delay` (between the
//! clocks), and `diagnostic` (warnings to read before using the numbers).
//!
//! # Conventions
//! - `y(t) + a₁ y(t−1) + … = b₀ u(t−nk) + …`: `nk` counts all samples of delay, see `model`. The input of a sample is
//!   held until the next.
//! - Signals are in segments of known input; an unobserved output is NaN and is left out, see `data`.
//! - Covariances are kept as factors, see `uncertainty`; everything is solved by QR factorisation, see `regression`.

// In the order of the data.
pub(crate) mod data;
pub(crate) mod plant;

pub(crate) mod hold;
pub(crate) mod recorded;

pub(crate) mod delay;
pub(crate) mod grid;
pub(crate) mod prepare;

pub(crate) mod model;
mod model_error;
pub(crate) mod regression;

pub(crate) mod arx;
mod colour;
pub(crate) mod estimated;
pub(crate) mod instrumental;
pub(crate) mod output_error;
pub(crate) mod search;
mod shortest;
mod subspace;
pub(crate) mod zero;

mod balance;
pub(crate) mod gramian;
pub(crate) mod reduce;
pub(crate) mod state_space;

pub(crate) mod continuous;

pub(crate) mod periodic;

pub(crate) mod planes;

pub(crate) mod bandwidth;
pub(crate) mod bootstrap;
mod excited;
pub(crate) mod fit;
mod frozen;
mod gain_change;
mod jump;
mod left;
pub(crate) mod modelled;
mod nonlinear;
mod other_orders;
mod outliers;
pub(crate) mod residuals;
pub(crate) mod spectrum;
pub(crate) mod uncertainty;
mod varying;
mod whitened;
mod wrong_values;

pub(crate) mod applied;
pub(crate) mod chain;
pub(crate) mod diagnostic;
mod diagnostics;
pub(crate) mod export;
pub(crate) mod identification;
pub(crate) mod provenance;
pub(crate) mod settings;
mod tables;

mod decompositions;
mod descent;
mod error;
mod initial;
pub(crate) mod saved;
#[cfg(test)]
pub(crate) mod tests;

pub use arx::fit as fit_arx;
pub use chain::identify;
pub use continuous::{Continuous, Conversion};
pub use data::{Data, Segment};
pub use error::IdentifyError;
pub use fit::InitialState;
pub use identification::Identification;
pub use model::{Orders, Polynomials};
pub use periodic::Repeats;
pub use plant::Plant;
pub use search::search;
pub use settings::Settings;
