//! Noise that varies together with what is estimated, as that of a camera which sees fast motion worse.
//!
//! In: how far an error of each sample moves a parameter, and the samples' residuals. Out: the parameter's variance
//! over that for noise of one variance.
//!
//! Method. A sample moves a parameter by p(t) ε(t), with p a column of J (JᵀJ)⁻¹. The variance is Σ p² ε²
//! (White, Econometrica 48, 1980, doi:10.2307/1912934) instead of s² Σ p². Their ratio is 1 for noise of one
//! variance, but for chance: then its own variance is 2 Σ p⁴ / (Σ p²)², times the samples that say as much as
//! one. Only what exceeds that clearly counts: noise that is smaller where it matters is not counted on.

/// So many standard deviations are no chance.
const CLEARLY: f64 = 4.0;

/// The variance over that for noise of one variance, 1 or more. `samples`: p and the residual ε of each, in units of
/// the standard deviation of all. `alike`: samples that say as much as one.
pub(crate) fn excess_variance(samples: impl Iterator<Item = (f64, f64)>, alike: f64) -> f64 {
    let (mut white, mut equal, mut fourth) = (0.0, 0.0, 0.0);
    for (p, residual) in samples {
        let square = p * p;
        white += square * residual * residual;
        equal += square;
        fourth += square * square;
    }
    let (ratio, sd) = (white / equal, (2.0 * alike.max(1.0) * fourth).sqrt() / equal);
    if ratio > 1.0 + CLEARLY * sd { ratio } else { 1.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::random::Random;

    /// One parameter, whose derivative is large in the first fifth.
    fn factor(loud: f64, quiet: f64, seed: u64) -> f64 {
        let mut random = Random::new(seed);
        let size = |t: usize| if t < 200 { 1.0 } else { 0.05 };
        let derivatives: Vec<f64> = (0..1000).map(|t| size(t) * random.normal()).collect();
        let residuals: Vec<f64> = (0..1000).map(|t| if t < 200 { loud } else { quiet } * random.normal()).collect();
        let sd = (residuals.iter().map(|e| e * e).sum::<f64>() / 1000.0).sqrt();
        excess_variance(derivatives.iter().zip(&residuals).map(|(p, residual)| (*p, residual / sd)), 1.0)
    }

    #[test]
    fn noise_where_the_excitation_is_counts_more_and_noise_of_one_variance_as_it_is() {
        assert!((0..200).all(|seed| factor(0.3, 0.3, seed) == 1.0));
        // The variance is that of the first fifth: five times the mean one.
        let found: Vec<f64> = (0..50).map(|seed| (factor(0.3, 0.0, seed) / 5.0).sqrt()).collect();
        assert!(found.iter().all(|found| (0.6..1.5).contains(found)), "{found:?}");
        let mean = found.iter().sum::<f64>() / 50.0;
        assert!((mean - 1.0).abs() < 0.05, "{mean}");
        // What is quiet where it matters is not counted on.
        assert!((0..50).all(|seed| factor(0.0, 0.3, seed) == 1.0));
    }
}
