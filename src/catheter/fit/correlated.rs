//! Residuals that hang together from frame to frame, or are larger in some frames than in others, and how much wider
//! that makes σ.
//!
//! In: residuals at the solution, their derivatives, and which of them follow each other in time. Out: for each
//! parameter, its variance over that for independent residuals of one size, 1 or more.
//!
//! With derivatives J and C = (JᵀJ)⁻¹, errors e of the frames move a parameter by aᵀe, a being its column of J C. For
//! independent errors of variance 1 that has the variance aᵀa; for a stationary error with the autocorrelation ρ it is
//! Σ a(t) a(t + k) ρ(k) over all pairs of frames. So slow errors widen what slow changes tell, and hardly the damping.
//! ρ is that of all residuals together, up to the first lag at which it is not clearly above 0: errors of the model
//! that change slowly count as well.
//!
//! Where errors have different sizes, that widens σ as well ([`crate::varying_noise`]): a fast motion has larger
//! errors, and it alone tells a delay.
//!
//! Cannot tell: errors that last as long as the runs themselves.

use super::Run;
use super::search::Found;
use crate::varying_noise::excess_variance;
use nalgebra::{DMatrix, DVector};

/// A correlation counts from so many of its standard deviations on.
const SIGNIFICANT: f64 = 2.0;
/// Longest lag, as a part of the longest run.
const LONGEST_LAG: f64 = 0.25;

/// The residuals of one coordinate in one run: for each frame its row, if it was seen.
pub(super) type Series = Vec<Option<usize>>;

/// The series of runs, in the order of [`super::still::push`]: three coordinates of the coil, three of the tip, two of
/// the direction.
pub(super) fn series(runs: &[Run]) -> Vec<Series> {
    let mut all = Vec::new();
    let mut next_row = 0;
    for run in runs {
        let mut own: [Series; 8] = Default::default();
        for seen in &run.sightings {
            let (coil, tip, tangent) = (seen.coil.is_some(), seen.tip.is_some(), seen.tangent.is_some());
            for (series, is_seen) in own.iter_mut().zip([coil, coil, coil, tip, tip, tip, tangent, tangent]) {
                series.push(is_seen.then_some(next_row));
                next_row += usize::from(is_seen);
            }
        }
        all.extend(own);
    }
    all
}

/// For each parameter, its variance over that for independent residuals.
pub(super) fn widening(found: &Found, covariance: &DMatrix<f64>, series: &[Series]) -> Vec<f64> {
    let correlation = autocorrelation(&found.residuals, series);
    let of_one_size = &found.residuals / (found.residuals.norm_squared() / found.residuals.len() as f64).sqrt();
    let weights = &found.jacobian * covariance;
    let of_parameter = |weight: DVector<f64>| {
        let lags = correlation.iter().zip(1..);
        let pairs: f64 = lags.map(|(correlation, lag)| correlation * products(&weight, series, lag).0).sum();
        let alike = (1.0 + 2.0 * pairs / weight.norm_squared()).max(1.0);
        alike * excess_variance(weight.iter().copied().zip(of_one_size.iter().copied()), alike)
    };
    weights.column_iter().map(|weight| of_parameter(weight.into_owned())).collect()
}

/// From a lag of one frame on.
fn autocorrelation(residuals: &DVector<f64>, series: &[Series]) -> Vec<f64> {
    let longest = series.iter().map(Vec::len).max().unwrap_or(0);
    let (squares, count) = products(residuals, series, 0);
    let variance = squares / count as f64;
    let at = |lag: usize| {
        let (sum, count) = products(residuals, series, lag);
        let correlation = sum / (count as f64 * variance);
        (correlation > SIGNIFICANT / (count as f64).sqrt()).then_some(correlation)
    };
    (1..=(longest as f64 * LONGEST_LAG) as usize).map_while(at).collect()
}

/// The sum of the products of values that are `lag` frames apart, and their number.
fn products(values: &DVector<f64>, series: &[Series], lag: usize) -> (f64, usize) {
    let pairs = series.iter().flat_map(|rows| rows.iter().zip(rows.iter().skip(lag)));
    let value = |row: &Option<usize>| row.and_then(|row| values.get(row));
    pairs.filter_map(|(a, b)| Some(value(a)? * value(b)?)).fold((0.0, 0), |(sum, count), new| (sum + new, count + 1))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::random::Random;

    /// Variances of two parameters over those of errors of one size: the first is told by frames 0..100, the second by
    /// the others; errors of the first frames are so many times as large.
    fn widening_of(times: f64) -> Vec<f64> {
        const FRAMES: usize = 1000;
        let mut random = Random::new(3);
        let residuals = DVector::from_fn(FRAMES, |t, _| random.normal() * if t < 100 { times } else { 1.0 });
        let jacobian = DMatrix::from_fn(FRAMES, 2, |t, k| f64::from(u8::from((t < 100) == (k == 0))));
        let covariance = (jacobian.transpose() * &jacobian).try_inverse().unwrap();
        let (coordinates, information) = (DVector::zeros(2), DMatrix::zeros(2, 2));
        let found = Found { coordinates, residuals, jacobian, information, settled: true };
        widening(&found, &covariance, &[(0..FRAMES).map(Some).collect()])
    }

    #[test]
    fn larger_errors_widen_what_their_frames_tell_and_smaller_ones_narrow_nothing() {
        // Variances 9 and 1 by turns: 1.8 on the average.
        let [first, second] = widening_of(3.0)[..] else { panic!() };
        assert!((4.0..6.5).contains(&first) && second == 1.0, "{first} {second}");
        assert_eq!(widening_of(1.0), [1.0, 1.0]);
    }
}
