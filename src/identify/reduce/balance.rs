//! Balanced coordinates of a system's states, in which they are equally controllable and observable (Moore, IEEE TAC
//! 26, 1981, doi:10.1109/TAC.1981.1102568): from the factors of both Gramians, over all frequencies or in a band.

use crate::identify::solve::decompositions::svd;
use nalgebra::DMatrix;

/// Relative singular value below which it is rounding noise.
const RANK: f64 = 1e-14;

/// The coordinates of all significant states.
#[derive(Debug, Clone)]
pub(crate) struct Balanced {
    /// States from balanced ones: a column for each.
    pub(in crate::identify) into: DMatrix<f64>,
    /// Balanced states from those: a row for each.
    pub(crate) from: DMatrix<f64>,
    /// All Hankel singular values, the largest first.
    pub(in crate::identify) values: Vec<f64>,
}

impl Balanced {
    /// From the factors of the controllability and the observability Gramian.
    pub(crate) fn of([driven, seen]: [DMatrix<f64>; 2]) -> Option<Self> {
        if driven.is_empty() {
            // Only a gain, or no stable part.
            return Some(Self { into: DMatrix::zeros(0, 0), from: DMatrix::zeros(0, 0), values: Vec::new() });
        }
        let svd = svd(seen.transpose() * &driven)?;
        let (left, right) = (svd.u?, svd.v_t?);
        let values: Vec<f64> = svd.singular_values.iter().copied().collect();
        let rank = values.iter().filter(|s| **s > RANK * values.first().copied().unwrap_or(0.0)).count();
        let scale =
            |columns: DMatrix<f64>| DMatrix::from_fn(columns.nrows(), rank, |i, j| columns[(i, j)] / values[j].sqrt());
        let into = scale(driven * right.transpose());
        let from = scale(seen * left).transpose();
        Some(Self { into, from, values })
    }
}
