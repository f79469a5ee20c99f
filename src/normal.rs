//! Normally distributed random numbers.

use std::f64::consts::TAU;

/// One with mean 0 and variance 1 (Box and Muller, doi:10.1214/aoms/1177706645).
pub(crate) fn normal(random: &mut fastrand::Rng) -> f64 {
    (-2.0 * (1.0 - random.f64()).ln()).sqrt() * (TAU * random.f64()).cos()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn moments_are_those_of_the_normal_distribution() {
        let mut random = fastrand::Rng::with_seed(1);
        let all: Vec<f64> = (0..100_000).map(|_| normal(&mut random)).collect();
        let mean = |power: i32| all.iter().map(|x| x.powi(power)).sum::<f64>() / all.len() as f64;
        // Within four of their σ.
        for (power, expected, variance) in [(1, 0.0, 1.0), (2, 1.0, 2.0), (3, 0.0, 15.0), (4, 3.0, 96.0_f64)] {
            let off = mean(power) - expected;
            assert!(off.abs() < 4.0 * (variance / all.len() as f64).sqrt(), "{power}: {off}");
        }
    }
}
