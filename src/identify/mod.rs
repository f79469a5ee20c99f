//! Dynamic models from recorded input and output: Section III.B of the paper, and the better practice of today.
//!
//! ```text
//!  log or table ─▶ recorded ─▶ grid ─▶ prepare ─▶ search ─▶ arx ─────────▶ reduce ─▶ continuous
//!                  θ, current  Eq. 6   trends,    orders,   full model     fewer     H(s)
//!                  held        holes   fewer      delay     │              states
//!                                      samples              └ output_error, instrumental
//! ```
//! [`chain::identify`] runs it; [`export::write`] and [`crate::report::identification`] write what came out. Beside the
//! models: [`spectrum`] (the response without a model), [`bandwidth`], [`residuals`], [`bootstrap`], [`delay`] (between
//! the clocks), and [`diagnostic`] (what a user must know before using the numbers).
//!
//! # Conventions
//! - `y(t) + a₁ y(t−1) + … = b₀ u(t−nk) + …`: `nk` counts all samples of delay, see [`model`]. An input of a sample is
//!   held until the next.
//! - Signals are in stretches of known input; an output that was not observed is a NaN and is no data, see [`data`].
//! - Covariances are kept as factors, see [`uncertainty`]; everything is solved by orthogonal triangles, see
//!   [`regression`].

// In the order of the data.
pub mod data;
pub mod plant;

pub mod hold;
pub mod recorded;

pub mod delay;
pub mod grid;
pub mod prepare;

pub mod model;
pub mod regression;

pub mod arx;
pub mod estimated;
pub mod instrumental;
pub mod output_error;
pub mod search;

pub mod gramian;
pub mod reduce;
pub mod state_space;

pub mod continuous;

pub mod bandwidth;
pub mod bootstrap;
pub mod fit;
pub mod modelled;
pub mod residuals;
pub mod spectrum;
pub mod uncertainty;

pub mod chain;
pub mod diagnostic;
mod diagnostics;
pub mod export;
pub mod identification;
pub mod provenance;
pub mod settings;

mod decompositions;
mod error;
mod initial;
#[cfg(test)]
pub(crate) mod tests;

pub use error::IdentifyError;
