//! Lag of an observed motion behind the commanded periodic one, in points.
//!
//! In: one period of the desired path; observed points with their command numbers, some possibly missing. Out: the lag
//! with the highest correlation, all three coordinates together, to a fraction of a point.
//!
//! Method. ρ(τ) = Σ (y_k − ȳ)·(x_{k−τ} − x̄) / (|y| |x|), x continued periodically, as commanded; means and norms are
//! those of the available pairs. So every lag is judged by the same points, unlike in a plain cross-correlation of two
//! finite pieces, which favours larger overlap (for four periods of 200 points by 1.3 points, 2.3°). The peak is that
//! of the cosine of the path's period through the best lag and its neighbours, which ρ is for a circle: a parabola
//! would be up to 0.5° off with 8 points.
//!
//! What it cannot know: the number of whole periods (lags are within ± half a period), and whether a circle lags or is
//! rotated about its axis.

use nalgebra::{Point3, Vector3};
use std::f64::consts::TAU;

/// A lag.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Lag {
    /// In points of the path; positive: the observed motion is late.
    pub points: f64,
    /// Correlation at the best whole lag: 1 for motions of the same shape.
    pub correlation: f64,
}

/// The lag of observed points, with command numbers, relative to one period of the path; `None` without motion.
pub(crate) fn lag(period: &[Point3<f64>], observed: &[(usize, Point3<f64>)]) -> Option<Lag> {
    let n = period.len();
    if n < 3 || observed.len() < 3 {
        return None;
    }
    let count = observed.len() as f64;
    let mean_y = observed.iter().map(|(_, y)| y.coords).sum::<Vector3<f64>>() / count;
    let norm_y = observed.iter().map(|(_, y)| (y.coords - mean_y).norm_squared()).sum::<f64>().sqrt();
    let correlation = |lag: usize| {
        let x = |k: usize| period.get((k + n - lag) % n).map_or(Vector3::zeros(), |x| x.coords);
        let mean_x = observed.iter().map(|(k, _)| x(*k)).sum::<Vector3<f64>>() / count;
        let (mut both, mut norm_x) = (0.0, 0.0);
        for (k, y) in observed {
            let x = x(*k) - mean_x;
            both += x.dot(&(y.coords - mean_y));
            norm_x += x.norm_squared();
        }
        both / (norm_y * norm_x.sqrt())
    };
    let all: Vec<f64> = (0..n).map(correlation).collect();
    let (best, peak) =
        all.iter().copied().enumerate().filter(|(_, r)| r.is_finite()).max_by(|a, b| a.1.total_cmp(&b.1))?;
    let (before, after) = (*all.get((best + n - 1) % n)?, *all.get((best + 1) % n)?);
    let (sin, cos) = (TAU / n as f64).sin_cos();
    let (slope, bend) = ((after - before) / sin, (2.0 * peak - before - after) / (1.0 - cos));
    let fraction = if bend > 0.0 { (slope / bend).atan() * n as f64 / TAU } else { 0.0 };
    let points = best as f64 + fraction.clamp(-0.5, 0.5);
    // More than half a period late counts as early.
    let half = n as f64 / 2.0;
    Some(Lag { points: if points > half { points - n as f64 } else { points }, correlation: peak })
}

/// Adds whole turns so that no phase differs by more than half a turn from the previous one, skipping `None`. Degrees.
pub(crate) fn unwrap(phases_deg: &mut [Option<f64>]) {
    let mut last: Option<f64> = None;
    for phase in phases_deg.iter_mut().flatten() {
        if let Some(last) = last {
            *phase -= ((*phase - last) / 360.0).round() * 360.0;
        }
        last = Some(*phase);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn path(k: f64) -> Point3<f64> {
        let t = TAU * k / 200.0;
        Point3::new(0.01 * t.cos(), 0.01 * t.sin(), 0.002 * (2.0 * t).sin())
    }

    fn period() -> Vec<Point3<f64>> {
        (0..200).map(|k| path(f64::from(k))).collect()
    }

    #[test]
    fn fractions_of_a_point_early_and_late_and_with_an_offset() {
        for late in [0.0, 0.3, 7.5, 49.8, 99.6, -0.2, -42.25] {
            let observed: Vec<_> =
                (200..800).map(|k| (k, path(k as f64 - late) + Vector3::new(0.3, -0.1, 0.02))).collect();
            let found = lag(&period(), &observed).unwrap();
            assert!((found.points - late).abs() < 1e-3, "{late}: {}", found.points);
            assert!(found.correlation > 0.999);
        }
    }

    #[test]
    fn a_circle_of_few_points_is_exact() {
        for n in [5, 8, 12] {
            let place = |k: f64| Point3::new((TAU * k / f64::from(n)).cos(), (TAU * k / f64::from(n)).sin(), 0.0);
            let period: Vec<Point3<f64>> = (0..n).map(|k| place(f64::from(k))).collect();
            for late in [0.0, 0.2, 0.4, -0.45, 1.3] {
                let observed: Vec<_> = (0..3 * n as usize).map(|k| (k, place(k as f64 - late))).collect();
                assert!((lag(&period, &observed).unwrap().points - late).abs() < 1e-9, "{n} {late}");
            }
        }
    }

    #[test]
    fn missing_points_and_another_size_do_not_shift_it() {
        let mut random = fastrand::Rng::with_seed(8);
        for late in [3.25, 31.4, 77.7] {
            let observed: Vec<_> = (200..777)
                .filter(|_| random.f64() > 0.2)
                .map(|k| (k, Point3::from(path(k as f64 - late).coords * 0.1)))
                .collect();
            let found = lag(&period(), &observed).unwrap();
            assert!((found.points - late).abs() < 0.02, "{late}: {}", found.points);
        }
    }

    #[test]
    fn what_does_not_move_has_no_lag() {
        let still: Vec<_> = (0..300).map(|k| (k, Point3::origin())).collect();
        assert_eq!(lag(&period(), &still), None);
        assert_eq!(lag(&period(), &still[..2]), None);
        assert_eq!(lag(&period()[..2], &still), None);
    }

    #[test]
    fn phases_follow_each_other_over_more_than_a_turn() {
        let mut phases = [Some(-10.0), Some(-170.0), None, Some(100.0), Some(-20.0), Some(-175.0)];
        unwrap(&mut phases);
        assert_eq!(phases, [Some(-10.0), Some(-170.0), None, Some(-260.0), Some(-380.0), Some(-535.0)]);
    }
}
