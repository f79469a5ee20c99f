//! The motion that several periods have in common: how each of them differs from it in time and place, and where the
//! points lie that are missing.
//!
//! In: the points of each period, and where in it they are; some may be missing. Out: the lag and the offset of each
//! period, from a mean that is the same for all.
//!
//! Method. The common motion is a Fourier series through the points of all periods, each without its own lag and
//! offset; those are found from it by least squares, in turns. A mean of the points of each command would not do: where
//! points are missing it is that of other periods, with their lags, and it has the noise of the period that is compared
//! with it, which draws lags towards 0.

use nalgebra::{DMatrix, DVector, Matrix4, Point3, Vector3, Vector4};
use std::collections::BTreeSet;
use std::f64::consts::TAU;

/// Most harmonics of the common motion; a path of few points has fewer.
const HARMONICS: usize = 50;
/// Points per harmonic, of all periods together, at least.
const POINTS: usize = 8;
/// Harmonics of a motion, for each of its path: a catheter is not quite linear.
const MADE: usize = 3;
/// A path has the harmonics with this part of the power of its largest.
const LEAST_POWER: f64 = 1e-4;
/// How often in a period lags swing by which slow errors are measured.
const SWINGS: std::ops::RangeInclusive<u8> = 2..=5;
/// Rounds in turns.
const ROUNDS: usize = 8;

/// A period: its points, and where it lies from the common motion.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Shifted {
    /// Its number, from 1, with those left out at the beginning.
    pub(super) number: usize,
    /// Where in the period, in commands, and places, metres.
    pub(super) points: Vec<(f64, Vector3<f64>)>,
    /// In points; positive: late.
    pub(super) lag: f64,
    /// Metres.
    pub(super) offset_m: Vector3<f64>,
}

impl Shifted {
    /// Root mean square distance of its points from their mean, metres.
    pub(super) fn size_m(&self) -> f64 {
        let count = self.points.len() as f64;
        let middle = self.points.iter().map(|(_, point)| point).sum::<Vector3<f64>>() / count;
        (self.points.iter().map(|(_, point)| (point - middle).norm_squared()).sum::<f64>() / count).sqrt()
    }
}

/// Improves lags and offsets of periods of a path.
///
/// The common motion has as many harmonics as a catheter makes of the path's: with more, its slope is mostly noise, and
/// so are the lags.
///
/// Returns σ of a coordinate of a point, as far as errors are as slow as the motion: that of independent errors which
/// move a lag by as much as these. `None` where there is no common motion, or a single period.
pub(super) fn align(periods: &mut [Shifted], path: &[Point3<f64>]) -> Option<f64> {
    let length = path.len();
    let points: usize = periods.iter().map(|period| period.points.len()).sum();
    let harmonics = (MADE * harmonics(path)).min(length / 4).min(points / POINTS).clamp(1, HARMONICS);
    let mut last = None;
    for _ in 0..ROUNDS {
        let motion = Motion::through(periods, length, harmonics)?;
        periods.iter_mut().for_each(|period| motion.shift(period));
        last = Some(motion);
    }
    last?.slow_sd_m(periods)
}

/// The points of whole periods of a path, those that are missing by a Fourier series through the others, with the
/// path's own harmonics: without them the size of a motion, and its lag, would be those of the part of it that was
/// seen. `None` where a hole that all periods have is too wide for that.
pub(super) fn filled(path: &[Point3<f64>], observed: &[Option<Point3<f64>>]) -> Option<Vec<Point3<f64>>> {
    let length = path.len();
    let known = observed.iter().enumerate().filter_map(|(k, point)| Some((k, (*point)?)));
    if observed.iter().all(Option::is_some) {
        return Some(known.map(|(_, point)| point).collect());
    }
    let harmonics = harmonics(path);
    if 2 * harmonics * widest_hole(length, known.clone().map(|(k, _)| k % length).collect()) > length {
        return None;
    }
    let points = known.map(|(k, point)| (k as f64, point.coords)).collect();
    let all = Shifted { number: 0, points, lag: 0.0, offset_m: Vector3::zeros() };
    let motion = Motion::through(&[all], length, harmonics)?;
    let place = |k: usize| Point3::from(motion.at(k as f64 * motion.per_point).0);
    Some(observed.iter().enumerate().map(|(k, point)| point.unwrap_or_else(|| place(k))).collect())
}

/// The highest harmonic that a path has.
fn harmonics(path: &[Point3<f64>]) -> usize {
    let per_point = TAU / path.len() as f64;
    let power = |harmonic: usize| {
        let sum = |wave: fn(f64) -> f64| {
            let angle = |k: usize| (harmonic * k) as f64 * per_point;
            path.iter().enumerate().map(|(k, point)| point.coords * wave(angle(k))).sum::<Vector3<f64>>()
        };
        sum(f64::cos).norm_squared() + sum(f64::sin).norm_squared()
    };
    let powers: Vec<f64> = (1..=HARMONICS.min(path.len() / 2)).map(power).collect();
    let most = powers.iter().copied().fold(0.0, f64::max);
    powers.iter().rposition(|power| *power >= LEAST_POWER * most).map_or(1, |at| at + 1)
}

/// Most commands one after another, the last before the first, of which none is among the `known`.
fn widest_hole(length: usize, known: BTreeSet<usize>) -> usize {
    let next = known.iter().skip(1).copied().chain(known.first().map(|first| first + length));
    known.iter().zip(next).map(|(one, next)| next - one - 1).max().unwrap_or(length)
}

/// A Fourier series over a period.
struct Motion {
    per_point: f64,
    /// Coefficients of 1, and of cos and sin of each harmonic; for x, y, z.
    coefficients: DMatrix<f64>,
}

impl Motion {
    /// `None` where the points do not determine it.
    fn through(periods: &[Shifted], length: usize, harmonics: usize) -> Option<Self> {
        let terms = 1 + 2 * harmonics;
        let per_point = TAU / length as f64;
        let (mut normal, mut right) = (DMatrix::zeros(terms, terms), DMatrix::zeros(terms, 3));
        for Shifted { points, lag, offset_m, .. } in periods {
            for (k, point) in points {
                let row = waves(terms, (k - lag) * per_point);
                normal.ger(1.0, &row, &row, 1.0);
                right.ger(1.0, &row, &(point - offset_m), 1.0);
            }
        }
        Some(Self { per_point, coefficients: normal.cholesky()?.solve(&right) })
    }

    /// The place at an angle of the period, and its change per point.
    fn at(&self, angle: f64) -> (Vector3<f64>, Vector3<f64>) {
        let terms = self.coefficients.nrows();
        let row = waves(terms, angle);
        let slopes = DVector::from_fn(terms, |i, _| match i {
            0 => 0.0,
            i if i % 2 == 1 => -((i / 2 + 1) as f64) * row[i + 1],
            i => (i / 2) as f64 * row[i - 1],
        });
        let sum = |by: &DVector<f64>| Vector3::from_fn(|axis, _| self.coefficients.column(axis).dot(by));
        (sum(&row), sum(&slopes) * self.per_point)
    }

    /// σ of slow errors, from what periods leave of a motion whose lag swings a few times in each: a steady lag, and
    /// what all have in common, is taken out.
    fn slow_sd_m(&self, periods: &[Shifted]) -> Option<f64> {
        let (mut squares, mut count) = (0.0, 0.0);
        for Shifted { points, lag, offset_m, .. } in periods {
            let left = points.iter().map(|(k, point)| {
                let (place, slope) = self.at((k - lag) * self.per_point);
                (k * self.per_point, point - offset_m - place, slope)
            });
            let left: Vec<_> = left.collect();
            for (swings, quarter) in SWINGS.flat_map(|swings| [(swings, 0.0), (swings, 0.25)]) {
                let (mut both, mut own) = (0.0, 0.0);
                for (angle, off, slope) in &left {
                    let way = slope * (f64::from(swings) * angle - quarter * TAU).cos();
                    both += way.dot(off);
                    own += way.norm_squared();
                }
                squares += both * both / own;
                count += 1.0;
            }
        }
        // The common motion follows each period's errors in part.
        let of_others = 1.0 - 1.0 / periods.len() as f64;
        let sd_m = (squares / count / of_others).sqrt();
        sd_m.is_finite().then_some(sd_m)
    }

    /// One step of Gauss and Newton for the lag and the offset.
    fn shift(&self, period: &mut Shifted) {
        let (mut normal, mut right) = (Matrix4::zeros(), Vector4::zeros());
        for (k, point) in &period.points {
            let (place, slope) = self.at((k - period.lag) * self.per_point);
            let left = point - period.offset_m - place;
            for axis in 0..3 {
                let mut row = Vector4::zeros();
                row[axis] = 1.0;
                row[3] = -slope[axis];
                normal += row * row.transpose();
                right += row * left[axis];
            }
        }
        let Some(step) = normal.cholesky().map(|normal| normal.solve(&right)) else { return };
        period.offset_m += step.xyz();
        period.lag += step.w;
    }
}

/// 1, and cos and sin of the multiples of an angle.
fn waves(terms: usize, angle: f64) -> DVector<f64> {
    DVector::from_fn(terms, |i, _| match i {
        0 => 1.0,
        i if i % 2 == 1 => ((i / 2 + 1) as f64 * angle).cos(),
        i => ((i / 2) as f64 * angle).sin(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::random::Random;

    #[test]
    fn missing_points_are_where_the_motion_leads_and_wide_holes_stay_open() {
        let length = 200;
        let eight = |k: usize| {
            let t = TAU * (k as f64 - 9.0) / length as f64;
            Point3::new(9.0 * t.sin(), 4.0 * (2.0 * t).sin(), 1.0)
        };
        let path: Vec<Point3<f64>> = (0..length).map(|k| eight(k + 9)).collect();
        let seen = |is_seen: &dyn Fn(usize) -> bool| -> Vec<Option<Point3<f64>>> {
            (0..3 * length).map(|k| is_seen(k).then(|| eight(k))).collect()
        };
        let near = |found: Vec<Point3<f64>>| found.iter().enumerate().all(|(k, p)| (p - eight(k)).norm() < 1e-6);
        assert!(near(filled(&path, &seen(&|_| true)).unwrap()));
        assert!(near(filled(&path, &seen(&|k| k % 7 != 3)).unwrap()));
        assert!(near(filled(&path, &seen(&|k| k % length >= 40)).unwrap()));
        assert!(near(filled(&path, &seen(&|k| k > length)).unwrap()));
        assert_eq!(filled(&path, &seen(&|k| k % length >= 60)), None);
        assert_eq!(filled(&path, &seen(&|_| false)), None);
    }

    /// Four periods of 200 points with other lags and middles; a fifth of the points is missing.
    #[test]
    fn lags_and_offsets_are_found_whatever_is_missing() {
        let (length, radius) = (200, 10.0);
        let place = |x: f64| {
            let t = TAU * x / length as f64;
            Vector3::new(radius * t.cos(), radius * t.sin(), (2.0 * t).sin())
        };
        let mut random = Random::new(5);
        let shifts = [(0.0, 0.0), (2.0, 0.3), (4.1, -0.2), (6.2, 0.1)];
        let mut periods: Vec<Shifted> = shifts
            .iter()
            .map(|(lag, offset)| Shifted {
                number: 0,
                points: (0..length)
                    .filter(|_| random.uniform() > 0.2)
                    .map(|k| (k as f64, place(k as f64 - lag) + Vector3::repeat(*offset)))
                    .collect(),
                lag: 0.0,
                offset_m: Vector3::zeros(),
            })
            .collect();
        let path: Vec<Point3<f64>> = (0..length).map(|k| place(k as f64).into()).collect();
        let slow_sd_m = align(&mut periods, &path).unwrap();
        assert!(slow_sd_m < 1e-3, "without errors: {slow_sd_m}");
        for (period, (lag, offset)) in periods.iter().zip(shifts) {
            let (lag_off, offset_off) = (period.lag - periods[0].lag - lag, period.offset_m - periods[0].offset_m);
            assert!(lag_off.abs() < 1e-3, "{lag}: {}", period.lag);
            assert!((offset_off - Vector3::repeat(offset)).amax() < 1e-3, "{offset}: {offset_off}");
        }
    }
}
