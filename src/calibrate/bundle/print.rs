//! How far stretch and skew of a print are believed: what the pictures say of them against how prints are.
//!
//! In: the adjustment with stretch and skew as free as [`WIDEST`]. Out: their values and covariance, and what this
//! adds to the covariance of everything else when they are held there.
//!
//! Many prints are square as far as pictures can tell; some are stretched, by up to a per cent. Where pictures leave it
//! open, a stretch takes up the same as a focal length or a mirror's distance. A prior of one width is wrong either
//! way: a narrow one leaves the error of a stretched print in the lens, a wide one spoils σ of all square ones, to
//! twice its size. Nor may a test decide: a stretch just too small for it would go unnoticed. The prior is therefore a
//! mixture Σ w N(0, τ²) of [`KINDS`] of prints, and all of its parts count, each as much as the pictures speak for it.
//!
//! With everything else free the pictures say ŝ, with variance v, and so does the posterior's part of width τ:
//! precision p = 1/v + 1/τ² − 1/WIDEST², mean ŝ/(v p), weight ∝ w/(τ √p) exp(ŝ²/(2 v² p)). The variance of the whole
//! includes the distances of the parts, and is largest where pictures are in two minds. Everything else follows
//! linearly: x = x(ŝ) + K (s − ŝ), K its regression, and its covariance is that with s held, and K cov(s) Kᵀ.
//!
//! Sources: Mitchell & Beauchamp, "Bayesian variable selection in linear regression", J. Am. Stat. Assoc. 83 (1988),
//! doi:10.1080/01621459.1988.10478694; Hoeting et al., "Bayesian model averaging: a tutorial", Statist. Sci. 14 (1999),
//! doi:10.1214/ss/1009212519.

use super::clusters::Clustered;
use super::shape::{PRINT, WIDEST};
use nalgebra::{DMatrix, Vector2};

/// σ of stretch or skew of the kinds of prints.
const KINDS: [f64; 5] = [1e-5, 3e-4, 1e-3, 3e-3, WIDEST];
/// How many there are of each kind. Half are not stretched, the others as printers stretch: hundredths to tenths of a
/// per cent, each as likely, and one in fifty by up to a whole one. Skew is rarer, and less.
const STRETCHED: [f64; 5] = [0.5, 0.16, 0.16, 0.16, 0.02];
const SKEWED: [f64; 5] = [0.8, 0.07, 0.07, 0.05, 0.01];

/// Stretch and skew as believed.
pub(super) struct Believed {
    pub(super) print: [f64; 2],
    /// What they add to the covariance of all unknowns.
    pub(super) covariance: DMatrix<f64>,
}

impl Believed {
    /// Of `found` stretch and skew; `shape`: index of the shape's first parameter. `None` if they are undetermined.
    pub(super) fn of(known: &Clustered, found: [f64; 2], shape: usize) -> Option<Self> {
        let at = shape + PRINT;
        let own = known.weighted.fixed_view::<2, 2>(at, at).into_owned();
        let (mut print, mut covariance) =
            (Vector2::from(found), known.covariance.fixed_view::<2, 2>(at, at).into_owned());
        // One after the other: what is learned of the stretch moves the skew.
        for (i, shares) in [STRETCHED, SKEWED].iter().enumerate() {
            let by = own.column(i) / own[(i, i)];
            let with = covariance.column(i).into_owned();
            let (mean, variance) = posterior(print[i], with[i], shares);
            print += by * (mean - print[i]);
            covariance += by * by.transpose() * (with[i] + variance) - by * with.transpose() - with * by.transpose();
        }
        let by = known.weighted.columns(at, 2) * own.try_inverse()?;
        Some(Self { print: print.into(), covariance: &by * covariance * by.transpose() })
    }
}

/// Mean and variance of a value found with this variance under a prior of [`WIDEST`]; `shares`: of the kinds.
fn posterior(found: f64, variance: f64, shares: &[f64; 5]) -> (f64, f64) {
    let pull = found / variance;
    let part = |(sd, share): (f64, f64)| {
        let precision = 1.0 / variance + 1.0 / (sd * sd) - 1.0 / (WIDEST * WIDEST);
        let log_weight = (share / sd).ln() - precision.ln() / 2.0 + pull * pull / precision / 2.0;
        (log_weight, pull / precision, 1.0 / precision)
    };
    let parts: Vec<(f64, f64, f64)> = KINDS.into_iter().zip(*shares).map(part).collect();
    let most = parts.iter().map(|part| part.0).fold(f64::NEG_INFINITY, f64::max);
    let weights: Vec<f64> = parts.iter().map(|part| (part.0 - most).exp()).collect();
    let mean_of = |of: fn(f64, f64) -> f64| {
        let sum: f64 =
            weights.iter().zip(&parts).map(|(weight, (_, mean, variance))| weight * of(*mean, *variance)).sum();
        sum / weights.iter().sum::<f64>()
    };
    let mean = mean_of(|mean, _| mean);
    (mean, mean_of(|mean, variance| mean * mean + variance) - mean * mean)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The posterior by integrating prior times likelihood over a fine grid.
    fn integrated(found: f64, variance: f64) -> (f64, f64) {
        let normal = |x: f64, variance: f64| (-x * x / variance / 2.0).exp() / variance.sqrt();
        // The likelihood alone, without the prior of the adjustment.
        let alone = 1.0 / (1.0 / variance - 1.0 / (WIDEST * WIDEST));
        let says = found * alone / variance;
        let (mut whole, mut first, mut second) = (0.0, 0.0, 0.0);
        for i in -400_000..=400_000 {
            let s = f64::from(i) * 1e-7;
            let prior: f64 = KINDS.iter().zip(STRETCHED).map(|(sd, share)| share * normal(s, sd * sd)).sum();
            let weight = prior * normal(s - says, alone);
            (whole, first, second) = (whole + weight, first + weight * s, second + weight * s * s);
        }
        (first / whole, second / whole - (first / whole).powi(2))
    }

    #[test]
    fn what_is_believed_is_prior_times_likelihood() {
        for (found, sd) in [(0.0, 5e-4), (1e-3, 5e-4), (1.5e-3, 5e-4), (-4e-3, 1e-3), (2e-4, 1e-4), (3e-3, 6e-3)] {
            let ((mean, variance), (expected, spread)) =
                (posterior(found, sd * sd, &STRETCHED), integrated(found, sd * sd));
            assert!((mean - expected).abs() < 1e-3 * spread.sqrt(), "{found} {sd}: {mean}, {expected}");
            assert!((variance / spread - 1.0).abs() < 1e-3, "{found} {sd}: {variance}, {spread}");
        }
    }

    /// A square print is believed, a clear stretch too, and in between σ is large enough for both.
    #[test]
    fn no_stretch_leaves_its_deviation_behind() {
        let sd = 5e-4;
        let (mean, variance) = posterior(0.0, sd * sd, &STRETCHED);
        assert!(mean == 0.0 && variance.sqrt() < 0.5 * sd, "{variance}");
        let (mean, variance) = posterior(5e-3, sd * sd, &STRETCHED);
        assert!((mean - 5e-3).abs() < 0.25 * sd && (variance.sqrt() / sd - 1.0).abs() < 0.05, "{mean} {variance}");
        for times in 0..80 {
            let found = f64::from(times) * 0.1 * sd;
            let (mean, variance) = posterior(found, sd * sd, &STRETCHED);
            assert!((found - mean).powi(2) < variance + sd * sd, "{times}: {mean} {variance}");
        }
    }
}
