//! How far stretch, skew and unevenness of a print are believed: what the pictures say of them against how prints are.
//!
//! In: the adjustment with the print as free as [`Shape::widest`]. Out: its values and covariance, and what this adds
//! to the covariance of everything else when it is held there.
//!
//! Many prints are square and even as far as pictures can tell; some are stretched, by up to a per cent, or their
//! squares grow along the feed. Where pictures leave it open, a stretch takes up the same as a focal length or a
//! mirror's distance, and growing squares the same as the principal point. A prior of one width is wrong either
//! way: a narrow one leaves the error of a stretched print in the lens, a wide one spoils σ of all square ones, to
//! twice its size. Nor may a test decide: a stretch just too small for it would go unnoticed. The prior is therefore a
//! mixture Σ w N(0, τ²) of kinds of prints, and all of its parts count, each as much as the pictures speak for it. The
//! six terms of an uneven print have one τ: were each judged by itself, six chances to be uneven would widen σ of an
//! even one.
//!
//! Where pictures and the judgement of the others say of d values the mean m with the covariance V, the posterior's
//! part of width τ has the precision P = V⁻¹ + 1/τ², the mean P⁻¹V⁻¹m and the weight ∝ w τ^−d |P|^−½
//! exp(mᵀV⁻¹P⁻¹V⁻¹m / 2). The covariance of the whole includes the distances of the parts, and is largest where
//! pictures are in two minds. Everything else follows linearly: x = x(m) + K (s − m), K its regression, and its
//! covariance is that with s held, and K cov(s) Kᵀ.
//!
//! Stretch, skew and unevenness are each judged by what the pictures and the judgement of the others say of it, in
//! turn, until all agree: expectation propagation (Minka 2001, arXiv:1301.2294).
//!
//! Sources: Mitchell & Beauchamp, "Bayesian variable selection in linear regression", J. Am. Stat. Assoc. 83 (1988),
//! doi:10.1080/01621459.1988.10478694; Hoeting et al., "Bayesian model averaging: a tutorial", Statist. Sci. 14 (1999),
//! doi:10.1214/ss/1009212519.

use super::clusters::Clustered;
use super::shape::{PRINT, PRINTS, Shape};
use nalgebra::{DMatrix, DVector};
use std::ops::AddAssign as _;

/// A kind of prints: σ of each parameter over its widest, and how many there are.
type Kind = (f64, f64);

/// Half are not stretched, the others as printers stretch: hundredths to tenths of a per cent, each as likely, and one
/// in fifty by up to a whole one. Skew is rarer, and less.
const STRETCHED: [Kind; 5] = [(1e-3, 0.5), (0.03, 0.16), (0.1, 0.16), (0.3, 0.16), (1.0, 0.02)];
const SKEWED: [Kind; 5] = [(1e-3, 0.8), (0.03, 0.07), (0.1, 0.07), (0.3, 0.05), (1.0, 0.01)];
/// A quarter are even to some millionths of their half width, the others shift corners by up to a thousandth.
const UNEVEN: [Kind; 5] = [(0.003, 0.25), (0.03, 0.15), (0.1, 0.35), (0.3, 0.15), (1.0, 0.1)];

/// Parameters that are judged together: first, number, and the kinds.
const JUDGED: [(usize, usize, &[Kind]); 3] = [(0, 1, &STRETCHED), (1, 1, &SKEWED), (2, PRINTS - 2, &UNEVEN)];

/// Times that all of them are judged.
const SWEEPS: usize = 5;
/// Least information of pictures, over that of the widest prior; least variance of what they say, over that of
/// independent corners.
const LEAST_SEEN: f64 = 1e-6;
const LEAST_SCATTER: f64 = 0.1;

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
        // In units of the widest.
        let widest = DVector::from_row_slice(&found.widest());
        let units = &widest * widest.transpose();
        let block = |of: &DMatrix<f64>| of.view((at, at), (PRINTS, PRINTS)).component_div(&units);
        let all = Said::of(&DVector::from_row_slice(&found.print()).component_div(&widest), &block(&known.weighted))?;
        let pictures = pictures(&all, &block(&known.covariance))?;
        let mut said = JUDGED.map(|(_, count, _)| Said::widest(count));
        let mut believed = together(&pictures, &said)?;
        for _ in 0..SWEEPS {
            for (k, (at, count, kinds)) in JUDGED.into_iter().enumerate() {
                let own = |of: &(DVector<f64>, DMatrix<f64>)| {
                    Said::of(&of.0.rows(at, count).into_owned(), &of.1.view((at, at), (count, count)).into_owned())
                };
                let of_others = own(&believed)?.without(&said[k]);
                let Some((mean, covariance)) = posterior(&of_others, kinds) else { continue };
                said[k] = Said::of(&mean, &covariance)?.without(&of_others);
                believed = together(&pictures, &said)?;
            }
        }
        let (print, covariance) = (believed.0.component_mul(&widest), believed.1.component_mul(&units));
        let of_print = known.weighted.view((at, at), (PRINTS, PRINTS)).into_owned().try_inverse()?;
        let by = known.weighted.columns(at, PRINTS) * of_print;
        Some(Self { print: std::array::from_fn(|i| print[i]), covariance: &by * covariance * by.transpose() })
    }
}

/// What pictures say without the adjustment's prior, from what they say together, and the covariance of that: as far
/// off as pictures differ, related as in the adjustment.
///
/// With V = (P + 1)⁻¹ by the adjustment, P the information of independent corners, and E the real scatter of their
/// pulls, the covariance is V (E + 1) V, and that of what pictures say alone P⁻¹ E P⁻¹.
fn pictures(all: &Said, covariance: &DMatrix<f64>) -> Option<Said> {
    let one = DMatrix::identity(PRINTS, PRINTS);
    let information = &all.precision - &one * (1.0 - LEAST_SEEN);
    let alone = information.clone().cholesky()?.inverse();
    let pulls = &all.precision * covariance * &all.precision - one;
    let scatter = &alone * pulls * &alone;
    let times = scatter.diagonal().component_div(&alone.diagonal()).map(|ratio| ratio.max(LEAST_SCATTER).sqrt());
    let precision = information.component_div(&(&times * times.transpose()));
    Some(Said { pull: &precision * (alone * &all.pull), precision })
}

/// Mean and covariance of all by what pictures say and by how prints are.
fn together(pictures: &Said, prints: &[Said]) -> Option<(DVector<f64>, DMatrix<f64>)> {
    let (mut precision, mut pull) = (pictures.precision.clone(), pictures.pull.clone());
    for ((at, count, _), said) in JUDGED.into_iter().zip(prints) {
        precision.view_mut((at, at), (count, count)).add_assign(&said.precision);
        pull.rows_mut(at, count).add_assign(&said.pull);
    }
    let covariance = precision.cholesky()?.inverse();
    Some((&covariance * pull, covariance))
}

/// What is said of some values: a Gaussian, as its precision and its precision times its mean.
struct Said {
    precision: DMatrix<f64>,
    pull: DVector<f64>,
}

impl Said {
    /// What the adjustment's prior says of so many values.
    fn widest(count: usize) -> Self {
        Self { precision: DMatrix::identity(count, count), pull: DVector::zeros(count) }
    }

    /// `None` if the covariance is that of no Gaussian.
    fn of(mean: &DVector<f64>, covariance: &DMatrix<f64>) -> Option<Self> {
        let precision = covariance.clone().cholesky()?.inverse();
        Some(Self { pull: &precision * mean, precision })
    }

    /// What the rest says.
    fn without(self, part: &Self) -> Self {
        Self { precision: self.precision - &part.precision, pull: self.pull - &part.pull }
    }
}

/// Mean and covariance of values of which pictures say this, for these kinds of prints; `None` if pictures say nothing.
fn posterior(said: &Said, kinds: &[Kind]) -> Option<(DVector<f64>, DMatrix<f64>)> {
    let count = said.pull.len();
    said.precision.clone().cholesky()?;
    let part = |(sd, share): &Kind| {
        let precision = (&said.precision + DMatrix::identity(count, count) / (sd * sd)).cholesky()?;
        let mean = precision.solve(&said.pull);
        let log_weight =
            (share / sd.powi(count as i32)).ln() - precision.ln_determinant() / 2.0 + said.pull.dot(&mean) / 2.0;
        Some((log_weight, mean, precision.inverse()))
    };
    let parts = kinds.iter().map(part).collect::<Option<Vec<_>>>()?;
    let most = parts.iter().map(|part| part.0).fold(f64::NEG_INFINITY, f64::max);
    let weights: Vec<f64> = parts.iter().map(|part| (part.0 - most).exp()).collect();
    let all: f64 = weights.iter().sum();
    let weighted = || weights.iter().map(|weight| weight / all).zip(&parts);
    let mean = weighted().fold(DVector::zeros(count), |sum, (weight, (_, mean, _))| sum + mean * weight);
    let spread = weighted().fold(DMatrix::zeros(count, count), |sum, (weight, (_, own, covariance))| {
        let off = own - &mean;
        sum + (covariance + &off * off.transpose()) * weight
    });
    Some((mean, spread))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What pictures say where the adjustment found a value with this variance.
    fn without_prior(found: f64, variance: f64) -> Said {
        let of = |value: f64| DMatrix::from_element(1, 1, value);
        let all = Said::of(&DVector::from_element(1, found), &of(variance)).unwrap();
        Said { precision: all.precision - of(1.0), ..all }
    }

    fn believed(found: f64, variance: f64) -> (f64, f64) {
        let (mean, covariance) = posterior(&without_prior(found, variance), &STRETCHED).unwrap();
        (mean[0], covariance[(0, 0)])
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
            let ((mean, variance), (expected, spread)) = (believed(found, sd * sd), integrated(found, sd * sd));
            assert!((mean - expected).abs() < 1e-3 * spread.sqrt(), "{found} {sd}: {mean}, {expected}");
            assert!((variance / spread - 1.0).abs() < 1e-3, "{found} {sd}: {variance}, {spread}");
        }
    }

    /// A square print is believed, a clear stretch too, and in between σ is large enough for both.
    #[test]
    fn no_stretch_leaves_its_deviation_behind() {
        let sd = 0.05;
        let (mean, variance) = believed(0.0, sd * sd);
        assert!(mean == 0.0 && variance.sqrt() < 0.5 * sd, "{variance}");
        let (mean, variance) = believed(0.5, sd * sd);
        assert!((mean - 0.5).abs() < 0.25 * sd && (variance.sqrt() / sd - 1.0).abs() < 0.05, "{mean} {variance}");
        for times in 0..80 {
            let found = f64::from(times) * 0.1 * sd;
            let (mean, variance) = believed(found, sd * sd);
            assert!((found - mean).powi(2) < variance + sd * sd, "{times}: {mean} {variance}");
        }
    }
}
