//! A base band that a coder carried along.
//!
//! A coder that predicts may move a block with the motion beside it, if that costs little: then the weak edges of a
//! band at rest creep after the tube that swings, by up to a pixel, and stay there until the next picture that is coded
//! for itself. No residual shows that. But the first picture of a stream is coded for itself, and the band rests: how
//! far it is from where it was first, beyond what both covariances explain, is error.
//!
//! Cannot tell: what was carried by no more than the noise; bands that move; anything when the first picture was
//! predicted, as after a seek.

use crate::whitening::chi_square;
use nalgebra::{Matrix3, Vector3};

/// Expected square of a distance in three dimensions over its covariance.
const CHANCE: f64 = 3.0;

/// The covariance of how far a band was carried, m², if it lies `off` its first place and both places have the
/// covariance `known` between them; zero where chance explains it.
pub(in crate::track) fn covariance(off: &Vector3<f64>, known: &Matrix3<f64>) -> Matrix3<f64> {
    let chi2 = chi_square(off, *known).unwrap_or(0.0);
    if chi2 > CHANCE { off * off.transpose() * (1.0 - CHANCE / chi2) } else { Matrix3::zeros() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_beyond_chance_is_as_likely_as_one_sigma() {
        let own = Matrix3::from_diagonal_element(0.01);
        assert_eq!(covariance(&Vector3::new(0.1, 0.1, 0.05), &own), Matrix3::zeros());
        let off = Vector3::new(0.0, 0.8, 0.6);
        let carried = covariance(&off, &own);
        // Its own part of the covariance is not counted twice.
        assert!(((off.transpose() * carried * off)[0] - (1.0 - 3.0 * 0.01)).abs() < 1e-12);
        assert!(carried[(0, 0)].abs() < 1e-12);
    }
}
