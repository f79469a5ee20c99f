//! Noise that varies together with the excitation, as that of a camera which sees fast motion worse.
//!
//! In: derivatives J and residuals ε of all samples. Out: by how much σ of each parameter is larger than noise of one
//! variance makes it.
//!
//! Method. A sample moves a parameter by p(t) ε(t), with p a row of (JᵀJ)⁻¹ Jᵀ. The variance is Σ p² ε² (White,
//! Econometrica 48, 1980, doi:10.2307/1912934) instead of s² Σ p². Their ratio is 1 for noise of one variance, but for
//! chance: then its own variance is 2 Σ p⁴ / (Σ p²)², times the samples that say as much as one. Only what exceeds that
//! clearly counts.

use nalgebra::{DMatrix, DVector};

/// So many standard deviations are no chance.
const CLEARLY: f64 = 4.0;

/// Factors of the standard deviations, 1 or more. `inverse`: R⁻¹ with RᵀR = JᵀJ; `alike`: samples that say as much as
/// one. Residuals are NaN where nothing was observed.
pub(super) fn factors(
    derivatives: &[DMatrix<f64>],
    residuals: &[Vec<f64>],
    inverse: &DMatrix<f64>,
    noise_variance: f64,
    alike: f64,
) -> DVector<f64> {
    let back = inverse * inverse.transpose();
    let count = inverse.ncols();
    let (mut white, mut seen, mut fourth) = (DVector::zeros(count), DVector::zeros(count), DVector::zeros(count));
    for (part, residuals) in derivatives.iter().zip(residuals) {
        let moves = part * &back;
        for (row, residual) in moves.row_iter().zip(residuals).filter(|(_, residual)| !residual.is_nan()) {
            let squares = row.transpose().map(|p| p * p);
            seen += &squares * (residual * residual / noise_variance);
            fourth += squares.map(|square| square * square);
            white += squares;
        }
    }
    DVector::from_fn(count, |k, _| {
        let (ratio, sd) = (seen[k] / white[k], (2.0 * alike.max(1.0) * fourth[k]).sqrt() / white[k]);
        if ratio > 1.0 + CLEARLY * sd { ratio.sqrt() } else { 1.0 }
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::random::Random;

    /// One parameter, whose derivative is large in the first fifth.
    fn factor(loud: f64, quiet: f64, seed: u64) -> f64 {
        let mut random = Random::new(seed);
        let size = |t: usize| if t < 200 { 1.0 } else { 0.05 };
        let derivatives = DMatrix::from_fn(1000, 1, |t, _| size(t) * random.normal());
        let residuals: Vec<f64> = (0..1000).map(|t| if t < 200 { loud } else { quiet } * random.normal()).collect();
        let variance = residuals.iter().map(|e| e * e).sum::<f64>() / 1000.0;
        let inverse = DMatrix::from_element(1, 1, derivatives.norm().recip());
        factors(&[derivatives], &[residuals], &inverse, variance, 1.0)[0]
    }

    #[test]
    fn noise_where_the_excitation_is_counts_more_and_noise_of_one_variance_as_it_is() {
        assert!((0..200).all(|seed| factor(0.3, 0.3, seed) == 1.0));
        // The variance is that of the first fifth: five times the mean one.
        let found: Vec<f64> = (0..50).map(|seed| factor(0.3, 0.0, seed) / 5_f64.sqrt()).collect();
        assert!(found.iter().all(|found| (0.6..1.5).contains(found)), "{found:?}");
        let mean = found.iter().sum::<f64>() / 50.0;
        assert!((mean - 1.0).abs() < 0.05, "{mean}");
        // What is quiet where it matters is not counted on.
        assert!((0..50).all(|seed| factor(0.0, 0.3, seed) == 1.0));
    }
}
