//! The mean of something that should be at rest, and its covariance.
//!
//! Pictures of a motionless scene repeat the same errors: the encoder repeats a picture, and samples and the band's
//! edges do not move. So the covariance of one frame, as predicted by the tracker, is not divided by the number of
//! frames. The empirical estimate is the scatter of the means of [`BLOCKS`] blocks of the recording: noise and tremor
//! average out within a block, slow motion does not, and it is not divided by their number either. The larger of the
//! two counts, in every direction.

use crate::whitening::Whitened;
use nalgebra::{Matrix3, Vector3};

/// Blocks of a recording at rest, and the fewest frames.
pub(super) const BLOCKS: usize = 5;
/// Scatter of single frames that counts as motion, in predicted σ.
const SCATTER_SD: f64 = 3.0;
/// Difference between first and last block that counts as drift, in predicted σ of a difference (√2 of a single σ,
/// because errors may be the same within a block and differ in the next).
const DRIFT_SD: f64 = 4.0;

/// A mean at rest.
#[derive(Debug, Clone, Copy)]
pub(super) struct RestMean {
    pub(super) mean: Vector3<f64>,
    pub(super) covariance: Matrix3<f64>,
}

/// Why it is not at rest. Units of the values given.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum NotAtRest {
    /// Frames scatter (RMS, in the worst direction) by more than `allowed`.
    Scatter { rms: f64, allowed: f64 },
    /// First and last block differ by more than `allowed`.
    Drift { by: f64, allowed: f64 },
}

/// The mean of `values` (each with the covariance predicted for it) in order of time, at least [`BLOCKS`]. Motion below
/// `tolerance`, in their unit, is accepted whatever their σ.
pub(super) fn mean_at_rest(values: &[(Vector3<f64>, Matrix3<f64>)], tolerance: f64) -> Result<RestMean, NotAtRest> {
    let mean = mean_of(values);
    let predicted: Matrix3<f64> = values.iter().map(|(_, c)| c).sum::<Matrix3<f64>>() / values.len() as f64;
    let scatter = scatter_of(values.iter().map(|(v, _)| v - mean));
    let tolerated = Matrix3::identity() * tolerance.powi(2);
    let (ratio, direction) = largest_ratio(&scatter, &(predicted * SCATTER_SD.powi(2) + tolerated));
    if ratio > 1.0 {
        let rms = along(&scatter, &direction);
        return Err(NotAtRest::Scatter { rms, allowed: rms / ratio.sqrt() });
    }
    let blocks: Vec<Vector3<f64>> = (0..BLOCKS)
        .filter_map(|i| values.get(i * values.len() / BLOCKS..(i + 1) * values.len() / BLOCKS))
        .map(mean_of)
        .collect();
    if let (Some(first), Some(last)) = (blocks.first(), blocks.last()) {
        let drift = last - first;
        let outer = drift * drift.transpose();
        let (ratio, _) = largest_ratio(&outer, &(predicted * 2.0 * DRIFT_SD.powi(2) + tolerated));
        if ratio > 1.0 {
            return Err(NotAtRest::Drift { by: drift.norm(), allowed: drift.norm() / ratio.sqrt() });
        }
    }
    let between = scatter_of(blocks.iter().map(|block| block - mean));
    Ok(RestMean { mean, covariance: larger(&predicted, &between) })
}

fn mean_of(values: &[(Vector3<f64>, Matrix3<f64>)]) -> Vector3<f64> {
    values.iter().map(|(v, _)| v).sum::<Vector3<f64>>() / values.len() as f64
}

fn scatter_of(deviations: impl ExactSizeIterator<Item = Vector3<f64>>) -> Matrix3<f64> {
    let count = deviations.len();
    deviations.map(|d| d * d.transpose()).sum::<Matrix3<f64>>() / (count.max(2) - 1) as f64
}

/// σ of a covariance along a unit vector.
fn along(covariance: &Matrix3<f64>, direction: &Vector3<f64>) -> f64 {
    direction.dot(&(covariance * direction)).max(0.0).sqrt()
}

/// The largest of vᵀ·a·v / vᵀ·b·v over all directions v, and the (unit) direction it is in. `b` is positive definite.
fn largest_ratio(a: &Matrix3<f64>, b: &Matrix3<f64>) -> (f64, Vector3<f64>) {
    let Some(Whitened { inverse, ratios, .. }) = Whitened::of(a, b) else { return (f64::INFINITY, Vector3::x()) };
    let at = ratios.eigenvalues.imax();
    (ratios.eigenvalues[at], (inverse.transpose() * ratios.eigenvectors.column(at)).normalize())
}

/// A covariance that is nowhere smaller than `a` or `b`: in the axes in which `a` is the unit matrix and `b` diagonal,
/// the larger of the two on each.
fn larger(a: &Matrix3<f64>, b: &Matrix3<f64>) -> Matrix3<f64> {
    let Some(Whitened { root, ratios, .. }) = Whitened::of(b, a) else { return a + b };
    let axes = root * ratios.eigenvectors;
    axes * Matrix3::from_diagonal(&ratios.eigenvalues.map(|ratio| ratio.max(1.0))) * axes.transpose()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_larger_covariance_in_every_direction() {
        let a = Matrix3::from_diagonal(&Vector3::new(4.0, 1.0, 9.0));
        let b = Matrix3::from_diagonal(&Vector3::new(1.0, 25.0, 9.0));
        let expected = Matrix3::from_diagonal(&Vector3::new(4.0, 25.0, 9.0));
        assert!((larger(&a, &b) - expected).norm() < 1e-12);
        let turned = Matrix3::new(2.0, 0.7, 0.1, 0.7, 3.0, -0.4, 0.1, -0.4, 1.0);
        let both = larger(&a, &turned);
        for v in [Vector3::x(), Vector3::new(1.0, -2.0, 0.5), Vector3::new(-0.3, 0.1, 1.0)] {
            let at = |m: &Matrix3<f64>| v.dot(&(m * v));
            assert!(at(&both) >= at(&a).max(at(&turned)) - 1e-12);
        }
        assert!((larger(&a, &Matrix3::zeros()) - a).norm() < 1e-12);
    }

    #[test]
    fn ratio_and_its_direction() {
        let a = Matrix3::from_diagonal(&Vector3::new(1.0, 8.0, 9.0));
        let b = Matrix3::from_diagonal(&Vector3::new(1.0, 2.0, 9.0));
        let (ratio, direction) = largest_ratio(&a, &b);
        assert!((ratio - 4.0).abs() < 1e-12 && (direction.y.abs() - 1.0).abs() < 1e-12);
    }

    /// `count` values along x: given by `x`, with σ 1.
    fn course(count: usize, x: impl Fn(usize) -> f64) -> Vec<(Vector3<f64>, Matrix3<f64>)> {
        (0..count).map(|i| (Vector3::new(x(i), 0.0, 5.0), Matrix3::identity())).collect()
    }

    #[test]
    fn what_repeats_does_not_average_out_and_what_trembles_does() {
        let still = mean_at_rest(&course(100, |_| 2.0), 0.0).unwrap();
        assert_eq!(still.mean, Vector3::new(2.0, 0.0, 5.0));
        assert!((still.covariance - Matrix3::identity()).norm() < 1e-12);
        // Twice the predicted σ, but from frame to frame: the mean is as good as before.
        let trembling = mean_at_rest(&course(100, |i| if i % 2 == 0 { 2.0 } else { -2.0 }), 0.0).unwrap();
        assert!((trembling.covariance - Matrix3::identity()).norm() < 1e-12);
        // The same in lasting steps: no block knows the mean better than that.
        let stepping = mean_at_rest(&course(100, |i| if (i / 20) % 2 == 0 { 2.0 } else { -2.0 }), 0.0).unwrap();
        assert!((stepping.covariance[(0, 0)] - 4.8).abs() < 1e-9, "{}", stepping.covariance);
        assert!((stepping.covariance[(1, 1)] - 1.0).abs() < 1e-9);
    }

    #[test]
    fn motion_and_drift_are_told_with_their_size_unless_below_the_tolerance() {
        let swinging = course(100, |i| 5.0 * (0.7 * i as f64).sin());
        let Err(NotAtRest::Scatter { rms, allowed }) = mean_at_rest(&swinging, 0.0) else { panic!("it swings") };
        assert!((rms - 12.5_f64.sqrt()).abs() < 0.1 && (allowed - 3.0).abs() < 1e-9, "{rms}, {allowed}");
        assert!(mean_at_rest(&swinging, 5.0).is_ok());
        let creeping = course(100, |i| 0.09 * i as f64);
        let Err(NotAtRest::Drift { by, allowed }) = mean_at_rest(&creeping, 0.0) else { panic!("it drifts") };
        assert!((by - 7.2).abs() < 1e-9 && (allowed - 32_f64.sqrt()).abs() < 1e-9, "{by}, {allowed}");
        assert!(mean_at_rest(&creeping, 5.0).is_ok());
    }
}
