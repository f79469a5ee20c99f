//! How coarsely a picture was quantised.

use super::samples::ZIGZAG;

/// Quantiser steps of a picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Steps {
    /// Steps of luma and both chroma channels, stored units: RMS over the coefficients that show where an edge is.
    pub channels: [f64; 3],
    /// Pixels per sample of chroma.
    pub chroma_px: f64,
}

/// Blur of an edge in a sharp picture, pixels.
const EDGE_BLUR_PX: f64 = 0.55;

/// RMS of the steps of a table, weighted by how much each coefficient tells of where an edge is: by the power spectrum
/// of an edge's derivative, r² exp(−(π σ r / 8)²) for r half waves per block and a blur of σ, averaged over all
/// directions.
pub(super) fn step_at_edges(table: &[i32; 64]) -> f64 {
    let (mut weights, mut squares) = (0.0, 0.0);
    for (step, at) in table.iter().zip(ZIGZAG) {
        let r = f64::from(at / 8).hypot(f64::from(at % 8));
        // The coefficients at a distance of r from the mean are as many as r.
        let weight = r * (-(std::f64::consts::PI * EDGE_BLUR_PX / 8.0 * r).powi(2)).exp();
        weights += weight;
        squares += weight * f64::from(*step).powi(2);
    }
    (squares / weights).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_step_is_that_of_the_coefficients_that_edges_have() {
        assert!((step_at_edges(&[7; 64]) - 7.0).abs() < 1e-9);
        let only = |of: &dyn Fn(usize, usize) -> bool| {
            let table = ZIGZAG.map(|at| if of(usize::from(at / 8), usize::from(at % 8)) { 10 } else { 1 });
            step_at_edges(&table)
        };
        // The mean tells nothing, and the finest waves little; most is told by three to six half waves.
        assert!(only(&|v, u| v + u == 0) < 1.0 + 1e-9);
        assert!(only(&|v, u| v.min(u) == 7) < 2.0);
        assert!(only(&|v, u| (3..7).contains(&v.max(u))) > 7.0);
    }
}
