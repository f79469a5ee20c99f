//! The result of an identification.

use crate::identify::checks::diagnostic::Diagnostic;
use crate::identify::checks::follows_input::Left;
use crate::identify::checks::model_error::ModelError;
use crate::identify::checks::residuals::Residuals;
use crate::identify::data::segments::Data;
use crate::identify::data::spectrum::Spectrum;
use crate::identify::estimate::estimated::{Estimated, Refined};
use crate::identify::estimate::search::{Candidate, Criterion};
use crate::identify::model::modelled::{Modelled, Role};
use crate::identify::model::polynomials::Orders;
use crate::identify::model::reproduction::{FitError, Kind};
use crate::identify::periodic::Periodic;
use crate::identify::reduce::truncation::Reduced;

/// How well one model reproduces one record.
#[derive(Debug, Clone, PartialEq)]
pub struct Fit {
    /// The record.
    pub record: String,
    /// Whether the model was fitted to it.
    pub training: bool,
    /// The model.
    pub role: Role,
    /// Kind of comparison.
    pub kind: Kind,
    /// Size of the difference.
    pub error: FitError,
}

/// A reduced model that the refined one does not confirm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Differs {
    /// Largest difference of their responses in the excited band, in σ of the reduced model; `None` where the refined
    /// model has no σ either.
    pub sigmas: Option<f64>,
}

/// What the simulations of a model leave of the energy of the records that it was fitted to, percent: their mean.
pub(in crate::identify) fn left_percent(fits: &[Fit], role: Role) -> Option<f64> {
    // That with the requested initial state comes first.
    let own = |fit: &&Fit| fit.training && fit.role == role && matches!(fit.kind, Kind::Simulation(_));
    let kind = fits.iter().find(own)?.kind;
    let all = || fits.iter().filter(own).filter(|fit| fit.kind == kind).map(|fit| fit.error.error_percent);
    Some(all().sum::<f64>() / all().count() as f64)
}

/// All results.
#[derive(Debug, Clone)]
pub struct Identification {
    /// What was fitted, if inputs changed between samples: the data without what that did to the outputs.
    pub held: Option<Data>,
    /// The candidates, if orders were searched.
    pub candidates: Vec<Candidate>,
    /// The criterion of the choice, if orders were searched.
    pub criterion: Option<Criterion>,
    /// Orders and delay of the full model.
    pub orders: Orders,
    /// The full model by least squares.
    pub arx: Estimated,
    /// The full model by another estimator, if requested.
    pub full: Option<Refined>,
    /// The reduction, or why there is none.
    pub reduced: Result<Reduced, String>,
    /// Output error of the reduced order, or why there is none.
    pub refined: Result<Refined, String>,
    /// Other delays with which the refined model explains the data about as well, samples (nk), rising.
    pub other_delays: Vec<usize>,
    /// A delay below those searched with which it explains the data clearly better: it then has no σ.
    pub earlier_delay: Option<usize>,
    /// What the refined model's order cannot do, if that is more than noise: it then has no σ.
    pub model_error: Option<ModelError>,
    /// A lower order with which the data are explained about as well.
    pub lower_order: Option<usize>,
    /// A higher order with which they are explained clearly better: the refined model then has no σ.
    pub higher_order: Option<usize>,
    /// Why the reduced model has no σ, where the refined model is the reason.
    pub reduced_differs: Option<Differs>,
    /// Whether what the refined model leaves has to do with the input; `None` where that cannot be tested.
    pub left: Option<Left>,
    /// What of the records that were fitted cannot be right, or is not linear: the refined model then has no σ.
    pub wrong_values: Vec<Diagnostic>,
    /// The model of the lines of averaged periods, if the input was declared to repeat.
    pub periodic: Option<Periodic>,
    /// The models: full, then reduced, refined and periodic where they are.
    pub models: Vec<Modelled>,
    /// Each model on each record.
    pub fits: Vec<Fit>,
    /// Residuals of the full model on the data fitted.
    pub residuals: Option<Residuals>,
    /// Spectrum of the data fitted.
    pub spectrum: Option<Spectrum>,
    /// Successful repetitions of the bootstrap, for the full and the refined model.
    pub repetitions: (usize, usize),
    /// The best orders of the search; differ from [`Identification::orders`] if the estimator failed for them.
    pub best_orders: Orders,
    /// Whether reduction for the excited band gave an unstable model, so that all frequencies were used.
    pub unstable_in_band: bool,
    /// Warnings to read before using the numbers.
    pub diagnostics: Vec<Diagnostic>,
}

impl Identification {
    /// The model to use: that of the averaged periods if there is one, otherwise the refined one, or the next best.
    pub fn leading(&self) -> Option<&Modelled> {
        Role::leading(&self.models, |model| model.role)
    }

    /// Whether a diagnostic is worth interrupting for. That the full model's orders are the last of the search, its
    /// residuals not white, or its simulation far off, comes with many good records, and says nothing of a refined
    /// model that leaves noise only.
    pub fn matters(&self, diagnostic: &Diagnostic) -> bool {
        let refined = self.model(Role::Refined);
        let of_full = match diagnostic {
            // The refined model has a delay of its own.
            Diagnostic::AtEdge { what, value, .. } => *what != "nk" || refined.is_some_and(|r| r.model.nk < *value),
            Diagnostic::Coloured { .. } | Diagnostic::ReducedDiffers { .. } => true,
            Diagnostic::Poor { other, .. } => other.is_some(),
            _ => false,
        };
        let has_sigma = refined.is_some_and(|refined| refined.covariance.is_some());
        !(of_full && has_sigma && self.left.is_some())
    }

    /// The model of a role.
    pub fn model(&self, role: Role) -> Option<&Modelled> {
        self.models.iter().find(|m| m.role == role)
    }
}
