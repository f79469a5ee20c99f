//! Colour of the noise at the output: what it does to the covariance of a least-squares estimate.
//!
//! With coloured noise e = w / C, w white, the estimate of least squares scatters by (JᵀJ)⁻¹ Jᵀ Σ J (JᵀJ)⁻¹, Σ the
//! covariance of e (Ljung, System Identification, 2nd ed., section 9.3). C is an autoregression of the residuals, by
//! Levinson's recursion; its order is that of minimum description length, and 0 for white noise. Σ = C⁻¹ C⁻ᵀ, so that
//! Jᵀ Σ J is the square of J filtered by 1 / C backwards in time.

use crate::identify::model::polynomials::all_pole;
use crate::identify::solve::regression::Triangle;
use nalgebra::DMatrix;

/// Highest order, and samples for each coefficient.
const MAX_ORDER: usize = 20;
const SAMPLES_PER_COEFFICIENT: usize = 20;

/// Autoregression C of a noise.
#[derive(Debug, Clone, PartialEq)]
pub(in crate::identify) struct Colour {
    /// Coefficients of C, 1 first.
    c: Vec<f64>,
    /// Variance of w over that of e.
    innovation: f64,
}

impl Colour {
    /// That of residuals, each part without a hole in time, NaN where nothing was observed.
    pub(in crate::identify) fn of(parts: &[Vec<f64>]) -> Self {
        let samples = parts.iter().flatten().filter(|e| !e.is_nan()).count();
        let mut colour = Self { c: vec![1.0], innovation: 1.0 };
        let most = MAX_ORDER.min(samples / SAMPLES_PER_COEFFICIENT);
        // Products at a lag: their mean, tapered so that the recursion stays stable.
        let covariance = |lag: usize| {
            let pairs = parts.iter().flat_map(|e| e.iter().zip(e.iter().skip(lag)).map(|(a, b)| a * b));
            let (sum, count) = pairs.filter(|v| !v.is_nan()).fold((0.0, 0_usize), |(s, n), v| (s + v, n + 1));
            sum / count.max(1) as f64 * (1.0 - lag as f64 / samples.max(1) as f64)
        };
        let at_rest = covariance(0);
        if !(at_rest > 0.0 && at_rest.is_finite()) {
            return colour;
        }
        let correlation: Vec<f64> = (0..=most).map(|lag| covariance(lag) / at_rest).collect();
        let description = |innovation: f64, order: usize| {
            let n = samples as f64;
            n * innovation.ln() + order as f64 * n.ln()
        };
        let (mut c, mut innovation) = (vec![1.0], 1.0);
        let mut shortest = 0.0;
        for order in 1..=most {
            let ahead: f64 = c.iter().zip(correlation[1..=order].iter().rev()).map(|(c, r)| c * r).sum();
            let reflection = -ahead / innovation;
            if reflection.is_nan() || reflection.abs() >= 1.0 {
                break;
            }
            c.push(0.0);
            let before = c.clone();
            c.iter_mut().zip(before.iter().rev()).for_each(|(c, mirrored)| *c += reflection * mirrored);
            innovation *= 1.0 - reflection * reflection;
            if description(innovation, order) < shortest {
                shortest = description(innovation, order);
                colour = Self { c: c.clone(), innovation };
            }
        }
        colour
    }

    /// Coefficients of C, 1 first: e times C(q) is white.
    pub(in crate::identify) fn filter(&self) -> &[f64] {
        &self.c
    }

    /// Sum of the correlations over all lags: the number of samples that say as much as one of white noise about a
    /// mean.
    pub(in crate::identify) fn correlated_samples(&self) -> f64 {
        self.innovation / self.c.iter().sum::<f64>().powi(2)
    }

    /// A factor of the covariance for this noise, of variance 1, from R⁻¹, that for white noise. `derivatives` are J of
    /// each part, a row a sample, zero where nothing was observed.
    pub(in crate::identify) fn factor(&self, derivatives: &[DMatrix<f64>], inverse: &DMatrix<f64>) -> DMatrix<f64> {
        if self.c.len() == 1 {
            return inverse.clone();
        }
        let mut triangle = Triangle::new(inverse.ncols());
        for part in derivatives {
            let mut filtered = part * inverse;
            for mut column in filtered.column_iter_mut() {
                let backwards = all_pole(&self.c, column.iter().rev().copied().collect());
                column.iter_mut().rev().zip(backwards).for_each(|(v, by)| *v = by * self.innovation.sqrt());
            }
            filtered.row_iter().for_each(|row| triangle.push(row.iter().copied()));
        }
        inverse * triangle.finish().transpose()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::random::Random;

    /// Noise e(t) = ρ e(t−1) + w(t) of variance 1.
    fn noise(rho: f64, samples: usize, seed: u64) -> Vec<f64> {
        let mut random = Random::new(seed);
        let mut e = random.normal();
        let mut next = || {
            e = rho * e + (1.0 - rho * rho).sqrt() * random.normal();
            e
        };
        (0..samples).map(|_| next()).collect()
    }

    #[test]
    fn white_noise_has_no_colour_and_coloured_noise_its_own() {
        for seed in 0..10 {
            assert_eq!(Colour::of(&[noise(0.0, 2000, seed)]).c, [1.0], "{seed}");
            let mut gappy = noise(0.9, 4000, seed);
            gappy.iter_mut().step_by(7).for_each(|e| *e = f64::NAN);
            let colour = Colour::of(&[gappy]);
            let summed = colour.correlated_samples();
            assert!((10.0..40.0).contains(&summed), "{seed}: {summed}, not 19");
        }
        assert_eq!(Colour::of(&[vec![0.0; 100]]).c, [1.0]);
        assert_eq!(Colour::of(&[]).c, [1.0]);
    }

    /// The mean and the slope of a line through noise, drawn many times.
    #[test]
    fn estimates_scatter_by_their_covariance() {
        const SAMPLES: usize = 600;
        let line = DMatrix::from_fn(SAMPLES, 2, |t, k| if k == 0 { 1.0 } else { t as f64 / 300.0 - 1.0 });
        let mut triangle = Triangle::new(2);
        line.row_iter().for_each(|row| triangle.push(row.iter().copied()));
        let inverse = triangle.finish().try_inverse().unwrap();
        let solved = &inverse * inverse.transpose() * line.transpose();
        for rho in [0.0, 0.9] {
            let mut z2 = [0.0; 2];
            for seed in 0..200 {
                let e = noise(rho, SAMPLES, seed);
                let found = &solved * DMatrix::from_column_slice(SAMPLES, 1, &e);
                let factor = Colour::of(&[e]).factor(std::slice::from_ref(&line), &inverse);
                for (k, z2) in z2.iter_mut().enumerate() {
                    *z2 += found[k].powi(2) / factor.row(k).norm_squared() / 200.0;
                }
            }
            assert!(z2.iter().all(|z2| (0.7..1.5).contains(z2)), "{rho}: {z2:?}");
        }
    }
}
