//! Least squares over few parameters, and what the data leave open.
//!
//! Levenberg and Marquardt's method; derivatives are central differences. Coordinates are in units of how far off a
//! parameter may be before anything is measured ([`Parameter::open`]): the data's information is then compared with 1.
//! What an eigenvector of it tells with less than [`DETERMINED_INFORMATION`] is left open.

use super::parameter::Parameter;
use nalgebra::{DMatrix, DVector, SymmetricEigen};
use rayon::prelude::*;

/// A direction is determined when the data narrow it to less than a fifth of what is open beforehand.
const DETERMINED_INFORMATION: f64 = 25.0;
/// What has a share of at least this in a direction is named with it.
const NAMED_SHARE: f64 = 0.4;
const MAX_STEPS: usize = 25;
/// After so many steps what the data determine is at its end, or near: along what they do not determine a search goes
/// on for long.
const STEPS_WHILE_OPEN: usize = 8;
/// A step that promises to lower the sum of squares by less than this is the last; where residuals are larger than the
/// noise, by less than this times their mean square, as σ are wider by that too.
const COST_TOLERANCE: f64 = 1e-3;

/// Residuals in standard deviations at a point; `None` where the model has none (a shape that snaps).
pub(super) trait Residuals: Sync {
    fn at(&self, coordinates: &DVector<f64>) -> Option<DVector<f64>>;
}

/// Where the sum of squares is least.
#[derive(Debug, Clone)]
pub(super) struct Found {
    pub(super) coordinates: DVector<f64>,
    pub(super) residuals: DVector<f64>,
    /// Derivatives of the residuals, in units of [`Parameter::open`].
    pub(super) jacobian: DMatrix<f64>,
    /// In units of [`Parameter::open`].
    pub(super) information: DMatrix<f64>,
    /// False when the search was given up before: often in a valley of what the data do not determine.
    pub(super) settled: bool,
}

impl Found {
    /// √(χ²/n).
    pub(super) fn misfit(&self) -> f64 {
        let free = self.residuals.len().saturating_sub(self.jacobian.ncols()).max(1);
        (self.residuals.norm_squared() / free as f64).sqrt()
    }
}

/// Parameters that the data cannot tell.
#[derive(Debug, Clone, PartialEq)]
pub struct Open {
    /// The one that is left at its start.
    pub parameter: Parameter,
    /// Those that it cannot be told from; empty when nothing at all is said of it.
    pub with: Vec<Parameter>,
}

impl Open {
    /// What is open, and what would close it.
    pub fn sentence(&self) -> String {
        let parameter = self.parameter;
        let with: Vec<&str> = self.with.iter().map(|p| p.words()).collect();
        let beside =
            if with.is_empty() { String::new() } else { format!(", only together with {}", with.join(" and ")) };
        format!("the runs do not determine {}{beside}: {}", parameter.words(), parameter.experiment())
    }
}

/// Jacobian in units of [`Parameter::open`].
fn jacobian(parameters: &[Parameter], model: &impl Residuals, at: &DVector<f64>, rows: usize) -> Option<DMatrix<f64>> {
    let columns: Option<Vec<DVector<f64>>> = parameters
        .par_iter()
        .enumerate()
        .map(|(k, parameter)| {
            let side = |sign: f64| {
                let mut moved = at.clone();
                moved[k] += sign * parameter.step();
                model.at(&moved)
            };
            Some((side(1.0)? - side(-1.0)?) * (parameter.open() / (2.0 * parameter.step())))
        })
        .collect();
    let columns = columns?;
    Some(if columns.is_empty() { DMatrix::zeros(rows, 0) } else { DMatrix::from_columns(&columns) })
}

/// Goes from `start` to where the sum of squares is least; `None` when the model has no residuals there.
pub(super) fn minimise(parameters: &[Parameter], model: &impl Residuals, start: DVector<f64>) -> Option<Found> {
    let open = DVector::from_iterator(parameters.len(), parameters.iter().map(|p| p.open()));
    let mut at = start;
    let mut residuals = model.at(&at)?;
    let mut damping = 1e-3;
    let mut steps = 0;
    loop {
        let by = jacobian(parameters, model, &at, residuals.len())?;
        let information = by.tr_mul(&by);
        let is_open = || least_determined(parameters, &information).is_some();
        if steps == MAX_STEPS || steps >= STEPS_WHILE_OPEN && is_open() {
            return Some(Found { coordinates: at, residuals, jacobian: by, information, settled: false });
        }
        let gradient = -by.tr_mul(&residuals);
        let cost = residuals.norm_squared();
        // At the edge of where the model has residuals, short steps are no sign of a minimum.
        let (mut moved, mut outside) = (false, false);
        while damping < 1e8 {
            // What nothing is known of stays where it is.
            let mut matrix = information.clone();
            for k in 0..parameters.len() {
                matrix[(k, k)] += damping * (information[(k, k)] + 1.0);
            }
            let Some(step) = matrix.cholesky().map(|matrix| matrix.solve(&gradient)) else { break };
            let predicted_decrease = step.dot(&gradient);
            if predicted_decrease < COST_TOLERANCE * f64::max(1.0, cost / residuals.len() as f64) {
                return Some(Found { coordinates: at, residuals, jacobian: by, information, settled: !outside });
            }
            let next = &at + step.component_mul(&open);
            let there = model.at(&next);
            outside = there.is_none();
            match there.filter(|there| there.norm_squared() < cost) {
                Some(better) => {
                    (at, residuals, moved) = (next, better, true);
                    damping = f64::max(damping * 0.1, 1e-9);
                    break;
                }
                None => damping *= 10.0,
            }
        }
        if !moved {
            // Rounding of the model: nowhere is lower.
            return Some(Found { coordinates: at, residuals, jacobian: by, information, settled: !outside });
        }
        steps += 1;
    }
}

/// The parameter that the data tell least of, if they do not determine it.
pub(super) fn least_determined(parameters: &[Parameter], information: &DMatrix<f64>) -> Option<Open> {
    if parameters.is_empty() {
        return None;
    }
    let eigen = SymmetricEigen::new(information.clone());
    let (least, value) = eigen.eigenvalues.iter().enumerate().min_by(|a, b| a.1.total_cmp(b.1))?;
    if *value >= DETERMINED_INFORMATION {
        return None;
    }
    let direction = eigen.eigenvectors.column(least).into_owned();
    let mut shares: Vec<(f64, Parameter)> = direction.iter().map(|v| v.abs()).zip(parameters.iter().copied()).collect();
    shares.sort_by(|a, b| b.0.total_cmp(&a.0));
    let (_, parameter) = *shares.first()?;
    let with = shares.iter().skip(1).filter(|(share, _)| *share >= NAMED_SHARE).map(|(_, p)| *p).collect();
    Some(Open { parameter, with })
}
