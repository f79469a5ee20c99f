//! Whether the coils' currents can be told apart.
//!
//! Of currents that change together only the sum of what they do is known: the regression divides it between the coils
//! as the noise, or the rounding of a table, decides. The currents about their means, each scaled to length 1, have
//! singular values: two with the correlation ρ have √(1 ± ρ). The smallest over the largest is the part of the motion
//! that tells them apart, and errors of their responses grow by its inverse.

use super::Motion;
use crate::identify::solve::decompositions::svd;
use nalgebra::DMatrix;

/// Part of a direction's largest coefficient from which a coil takes part in it.
const TAKES_PART: f64 = 0.2;

/// The combination of currents that changes least.
#[derive(Debug, Clone)]
pub(super) struct Together {
    /// Columns of the coils that take part.
    pub(super) coils: Vec<usize>,
    /// How much it changes, relative to the combination that changes most.
    pub(super) ratio: f64,
}

impl Together {
    /// Of records whose means were taken off; `None` for a single coil, and where a current does not change.
    pub(super) fn of(records: &[Motion]) -> Option<Self> {
        let coils = records.first()?.input.ncols();
        let lengths: Vec<f64> = (0..coils)
            .map(|coil| records.iter().map(|record| record.input.column(coil).norm_squared()).sum::<f64>().sqrt())
            .collect();
        if coils < 2 || lengths.iter().any(|length| *length <= 0.0) {
            return None;
        }
        let rows = records.iter().flat_map(|record| record.input.row_iter());
        let scaled = rows.flat_map(|row| row.iter().zip(&lengths).map(|(a, length)| a / length).collect::<Vec<_>>());
        let scaled: Vec<f64> = scaled.collect();
        let found = svd(DMatrix::from_row_slice(scaled.len() / coils, coils, &scaled))?;
        let (at, least) = found.singular_values.argmin();
        let directions = found.v_t?;
        let direction = directions.row(at);
        let largest = direction.amax();
        let coils = (0..coils).filter(|coil| direction[*coil].abs() > TAKES_PART * largest).collect();
        Some(Self { coils, ratio: least / found.singular_values.max() })
    }
}
