//! How far stretch, skew and unevenness of a print are believed: what the pictures say of them against how prints are.
//!
//! In: the adjustment with the print as free as [`Shape::widest`]. Out: its values and covariance, and what this adds
//! to the covariance of everything else when it is held there.
//!
//! Many prints are square and even as far as pictures can tell; some are stretched, by up to a per cent, or their
//! squares grow along the feed. Where pictures leave it open, a stretch takes up the same as a focal length or a
//! mirror's distance, and growing squares the same as the principal point. A prior of one width is wrong either
//! way: a narrow one leaves the error of a stretched print in the lens, a wide one spoils σ of all square ones, to
//! twice its size. Nor may a test decide: a stretch just too small for it would go unnoticed (of an uneven print one
//! does, in `calibrate camera`: what pictures leave open of six terms costs more). The prior is therefore a
//! mixture Σ w N(0, τ²) of kinds of prints, and all of its parts count, each as much as the pictures speak for it.
//!
//! With everything else free the pictures say ŝ, with variance v, and so does the posterior's part of width τ:
//! precision p = 1/v + 1/τ² − 1/widest², mean ŝ/(v p), weight ∝ w/(τ √p) exp(ŝ²/(2 v² p)). The variance of the whole
//! includes the distances of the parts, and is largest where pictures are in two minds. Everything else follows
//! linearly: x = x(ŝ) + K (s − ŝ), K its regression, and its covariance is that with s held, and K cov(s) Kᵀ.
//!
//! Of several parameters each is judged by what the pictures and the judgement of the others say of it, in turn, until
//! all agree: expectation propagation (Minka 2001, arXiv:1301.2294).
//!
//! Sources: Mitchell & Beauchamp, "Bayesian variable selection in linear regression", J. Am. Stat. Assoc. 83 (1988),
//! doi:10.1080/01621459.1988.10478694; Hoeting et al., "Bayesian model averaging: a tutorial", Statist. Sci. 14 (1999),
//! doi:10.1214/ss/1009212519.

use super::clusters::Clustered;
use super::shape::{PRINT, PRINTS, Shape};
use nalgebra::{DMatrix, SVector};

/// A kind of prints: σ of a parameter over its widest, and how many there are.
type Kind = (f64, f64);

/// Half are not stretched, the others as printers stretch: hundredths to tenths of a per cent, each as likely, and one
/// in fifty by up to a whole one. Skew is rarer, and less.
const STRETCHED: [Kind; 5] = [(1e-3, 0.5), (0.03, 0.16), (0.1, 0.16), (0.3, 0.16), (1.0, 0.02)];
const SKEWED: [Kind; 5] = [(1e-3, 0.8), (0.03, 0.07), (0.1, 0.07), (0.3, 0.05), (1.0, 0.01)];
/// Half are even to a hundred thousandth of their half width, the others shift corners by up to a thousandth.
const UNEVEN: [Kind; 4] = [(0.01, 0.5), (0.1, 0.2), (0.3, 0.2), (1.0, 0.1)];

/// Times that every parameter is judged.
const SWEEPS: usize = 5;

/// The print as believed.
pub(super) struct Believed {
    pub(super) print: [f64; PRINTS],
    /// What it adds to the covariance of all unknowns.
    pub(super) covariance: DMatrix<f64>,
}

impl Believed {
    /// Of the print of a shape that was found; `first`: index of the shape's first parameter. `None` if it is
    /// undetermined.
    pub(super) fn of(known: &Clustered, found: &Shape, first: usize) -> Option<Self> {
        let at = first + PRINT;
        let block = |of: &DMatrix<f64>| of.fixed_view::<PRINTS, PRINTS>(at, at).into_owned();
        // In units of the widest.
        let widest = SVector::from(found.widest());
        let units = widest * widest.transpose();
        // As far off as pictures differ, related as in the adjustment.
        let by_search = block(&known.weighted);
        let times = block(&known.covariance).diagonal().component_div(&by_search.diagonal()).map(f64::sqrt);
        let mut covariance = by_search.component_mul(&(times * times.transpose())).component_div(&units);
        let mut print = SVector::from(found.print()).component_div(&widest);
        let mut said = [Said { precision: 1.0, pull: 0.0 }; PRINTS];
        for _ in 0..SWEEPS {
            for (i, said) in said.iter_mut().enumerate() {
                let kinds = [&STRETCHED[..], &SKEWED].get(i).copied().unwrap_or(&UNEVEN);
                let all = Said::of(print[i], covariance[(i, i)]);
                let pictures = Said { precision: all.precision - said.precision, pull: all.pull - said.pull };
                if pictures.precision <= 0.0 {
                    continue;
                }
                let (mean, variance) = posterior(&pictures, kinds);
                let all = Said::of(mean, variance);
                *said = Said { precision: all.precision - pictures.precision, pull: all.pull - pictures.pull };
                // The others follow by their regression.
                let along = covariance.column(i) / covariance[(i, i)];
                print += along * (mean - print[i]);
                covariance += along * along.transpose() * (variance - covariance[(i, i)]);
            }
        }
        covariance.component_mul_assign(&units);
        let by = known.weighted.columns(at, PRINTS) * by_search.try_inverse()?;
        Some(Self { print: print.component_mul(&widest).into(), covariance: &by * covariance * by.transpose() })
    }
}

/// What is said of a value: a Gaussian, as its precision and its precision times its mean.
#[derive(Clone, Copy)]
struct Said {
    precision: f64,
    pull: f64,
}

impl Said {
    fn of(mean: f64, variance: f64) -> Self {
        Self { precision: 1.0 / variance, pull: mean / variance }
    }
}

/// Mean and variance of a value of which pictures say this, for these kinds of prints.
fn posterior(said: &Said, kinds: &[Kind]) -> (f64, f64) {
    let part = |(sd, share): &Kind| {
        let precision = said.precision + 1.0 / (sd * sd);
        let log_weight = (share / sd).ln() - precision.ln() / 2.0 + said.pull * said.pull / precision / 2.0;
        (log_weight, said.pull / precision, 1.0 / precision)
    };
    let parts: Vec<(f64, f64, f64)> = kinds.iter().map(part).collect();
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

    /// What pictures say where the adjustment found a value with this variance.
    fn without_prior(found: f64, variance: f64) -> Said {
        let all = Said::of(found, variance);
        Said { precision: all.precision - 1.0, ..all }
    }

    /// The posterior by integrating prior times likelihood over a fine grid.
    fn integrated(found: f64, variance: f64) -> (f64, f64) {
        let normal = |x: f64, variance: f64| (-x * x / variance / 2.0).exp() / variance.sqrt();
        // The likelihood alone, without the prior of the adjustment.
        let alone = 1.0 / (1.0 / variance - 1.0);
        let says = found * alone / variance;
        let (mut whole, mut first, mut second) = (0.0, 0.0, 0.0);
        for i in -400_000..=400_000 {
            let s = f64::from(i) * 1e-5;
            let prior: f64 = STRETCHED.iter().map(|(sd, share)| share * normal(s, sd * sd)).sum();
            let weight = prior * normal(says - s, alone);
            (whole, first, second) = (whole + weight, first + weight * s, second + weight * s * s);
        }
        (first / whole, second / whole - (first / whole).powi(2))
    }

    #[test]
    fn what_is_believed_is_prior_times_likelihood() {
        for (found, sd) in [(0.0, 0.05), (0.1, 0.05), (0.15, 0.05), (-0.4, 0.1), (0.02, 0.01), (0.3, 0.6)] {
            let ((mean, variance), (expected, spread)) =
                (posterior(&without_prior(found, sd * sd), &STRETCHED), integrated(found, sd * sd));
            assert!((mean - expected).abs() < 1e-3 * spread.sqrt(), "{found} {sd}: {mean}, {expected}");
            assert!((variance / spread - 1.0).abs() < 1e-3, "{found} {sd}: {variance}, {spread}");
        }
    }

    /// A square print is believed, a clear stretch too, and in between σ is large enough for both.
    #[test]
    fn no_stretch_leaves_its_deviation_behind() {
        let sd = 0.05;
        let (mean, variance) = posterior(&without_prior(0.0, sd * sd), &STRETCHED);
        assert!(mean == 0.0 && variance.sqrt() < 0.5 * sd, "{variance}");
        let (mean, variance) = posterior(&without_prior(0.5, sd * sd), &STRETCHED);
        assert!((mean - 0.5).abs() < 0.25 * sd && (variance.sqrt() / sd - 1.0).abs() < 0.05, "{mean} {variance}");
        for times in 0..80 {
            let found = f64::from(times) * 0.1 * sd;
            let (mean, variance) = posterior(&without_prior(found, sd * sd), &STRETCHED);
            assert!((found - mean).powi(2) < variance + sd * sd, "{times}: {mean} {variance}");
        }
    }
}
