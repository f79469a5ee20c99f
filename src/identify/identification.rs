//! The result of an identification.

use super::diagnostic::Diagnostic;
use super::estimated::{Estimated, Refined};
use super::fit::{FitError, Kind};
use super::model::Orders;
use super::modelled::{Modelled, Role};
use super::periodic::Periodic;
use super::reduce::Reduced;
use super::residuals::Residuals;
use super::search::{Candidate, Criterion};
use super::spectrum::Spectrum;

/// How well one model reproduces one record.
#[derive(Debug, Clone, PartialEq)]
pub struct Fit {
    /// The record.
    pub record: String,
    /// Whether the model was fitted to it.
    pub training: bool,
    /// The model.
    pub role: Role,
    /// What was compared.
    pub kind: Kind,
    /// How large the difference is.
    pub error: FitError,
}

/// All that came out.
#[derive(Debug, Clone)]
pub struct Identification {
    /// What was searched, if it was.
    pub candidates: Vec<Candidate>,
    /// By what the best was chosen, if it was.
    pub criterion: Option<Criterion>,
    /// Orders and delay of the full model.
    pub orders: Orders,
    /// The full model by least squares.
    pub arx: Estimated,
    /// The full model by another estimator, if that was asked for.
    pub full: Option<Refined>,
    /// The reduction, or why there is none.
    pub reduced: Result<Reduced, String>,
    /// Output error of the reduced order, or why there is none.
    pub refined: Result<Refined, String>,
    /// Of the lines of averaged periods, where the input was said to repeat.
    pub periodic: Option<Periodic>,
    /// The models: full, then reduced, refined and periodic where they are.
    pub models: Vec<Modelled>,
    /// Each model on each record.
    pub fits: Vec<Fit>,
    /// Of the full model on the data fitted.
    pub residuals: Option<Residuals>,
    /// Of the data fitted.
    pub spectrum: Option<Spectrum>,
    /// Repetitions of the bootstrap that gave an answer, of the full and of the refined model.
    pub repetitions: (usize, usize),
    /// Those that the search found best; other than [`Identification::orders`] where the estimator had no answer there.
    pub best_orders: Orders,
    /// Whether reduction for the excited band was unstable, so that it was done for all frequencies.
    pub unstable_in_band: bool,
    /// What should be known before the numbers are used.
    pub diagnostics: Vec<Diagnostic>,
}

impl Identification {
    /// The model to use: of the averaged periods where there are any, refined otherwise, or what there is in its place.
    pub fn leading(&self) -> Option<&Modelled> {
        Role::LEADING.into_iter().find_map(|role| self.model(role))
    }

    /// The model of a role.
    pub fn model(&self, role: Role) -> Option<&Modelled> {
        self.models.iter().find(|m| m.role == role)
    }
}
