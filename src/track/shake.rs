//! Shake of the camera, seen at the base band, which rests.
//!
//! A camera, mirror or tank that vibrates moves all bands alike. Of a band that moves itself nothing of this can be
//! told; of the base band it can: what its positions scatter about a straight line of time over half a second, beyond
//! what its covariance explains, is shake, and belongs into the covariance of all positions. The line is there because
//! a base that is pushed steadily does not shake. What neither shakes nor moves along the line rests.
//!
//! Cannot tell: vibration that moves only the picture of other bands; motion slower than the half second
//! (moved.rs); shake too small beside the base's own covariance; shake from a base band so far from its clamp that it
//! moves with the tube.

use crate::source::Timestamp;
use nalgebra::{Matrix3, SymmetricEigen, U3, Vector3};
use std::collections::VecDeque;

/// Time over which the scatter is taken, nanoseconds, and the least number of frames in it.
const WINDOW_NS: i64 = 500_000_000;
const MIN_FRAMES: usize = 4;
/// Most frames: more tell little more.
const MAX_FRAMES: usize = 120;
/// Variance over the expected one, along the axis where that is largest, beyond which it is no chance: with many
/// degrees of freedom, and how much more with few, times their number. Recordings by a camera at rest reach 1.7; with a
/// coder that makes the band jump, 3.3.
const MIN_RATIO: f64 = 4.0;
const MORE_WITH_FEW: f64 = 16.0;
/// Least number of frames beyond two that show rest: with fewer, motion is lost in noise.
const MIN_FREEDOM_AT_REST: f64 = 8.0;
/// A slope with this χ² is motion: of three coordinates, chance exceeds it once in a thousand.
const MOVES_CHI2: f64 = 16.0;

/// Recent positions of the base band.
#[derive(Debug, Default)]
pub(crate) struct Shake {
    recent: VecDeque<(i64, Vector3<f64>, Matrix3<f64>)>,
    seen: bool,
    rests: bool,
}

impl Shake {
    /// Whether it has ever shaken.
    pub(crate) fn is_seen(&self) -> bool {
        self.seen
    }

    /// Whether the band was seen to rest.
    pub(crate) fn is_at_rest(&self) -> bool {
        self.rests
    }

    /// Begins anew.
    pub(crate) fn forget(&mut self) {
        self.recent.clear();
        self.rests = false;
    }

    /// Adds a position of the base band, m, with its covariance.
    pub(crate) fn add(&mut self, stamp: Timestamp, position: Vector3<f64>, covariance: &Matrix3<f64>) {
        self.recent.push_back((stamp.ns, position, *covariance));
        if self.recent.len() > MAX_FRAMES {
            self.recent.pop_front();
        }
    }

    /// The covariance of the shake at a time, m²; zero if there is none.
    pub(crate) fn at(&mut self, stamp: Timestamp) -> Matrix3<f64> {
        self.recent.retain(|(ns, ..)| (0..=WINDOW_NS).contains(&(stamp.ns - ns)));
        let course = self.course();
        self.rests = course.as_ref().is_some_and(Course::is_at_rest);
        let shake = course.and_then(|course| course.shake()).unwrap_or_else(Matrix3::zeros);
        self.seen |= shake.trace() > 0.0;
        shake
    }

    /// The straight line through the recent positions; `None` with too few of them.
    fn course(&self) -> Option<Course> {
        let count = self.recent.len();
        if count < MIN_FRAMES {
            return None;
        }
        let newest = self.recent.back()?.0;
        let seconds = |ns: i64| (ns - newest) as f64 * 1e-9;
        let (mut time, mut mean, mut expected) = (0.0, Vector3::zeros(), Matrix3::zeros());
        for (ns, position, covariance) in &self.recent {
            time += seconds(*ns) / count as f64;
            mean += position / count as f64;
            expected += covariance / count as f64;
        }
        let (mut times, mut slope) = (0.0, Vector3::zeros());
        for (ns, position, _) in &self.recent {
            let t = seconds(*ns) - time;
            times += t * t;
            slope += (position - mean) * t;
        }
        slope /= times;
        // Two frames' worth is in the line.
        let freedom = (count - 2) as f64;
        let mut scatter = Matrix3::zeros();
        for (ns, position, _) in &self.recent {
            let off = position - mean - slope * (seconds(*ns) - time);
            scatter += off * off.transpose() / freedom;
        }
        // Without time between the frames there is no line.
        if !scatter.iter().all(|value| value.is_finite()) {
            return None;
        }
        // In units of the expected covariance that is the identity.
        let own = expected.cholesky()?.l();
        let inverse = own.try_inverse()?;
        let slope_chi2 = (inverse * slope).norm_squared() * times;
        let ratios = (inverse * scatter * inverse.transpose()).symmetric_eigen();
        Some(Course { freedom, slope_chi2, own, ratios })
    }
}

/// The recent positions compared with a straight line of time.
struct Course {
    /// Frames beyond those that determine the line.
    freedom: f64,
    /// Square of the slope in units of its own covariance.
    slope_chi2: f64,
    /// Factor of the covariance expected of a position.
    own: Matrix3<f64>,
    /// The scatter about the line, in units of that covariance.
    ratios: SymmetricEigen<f64, U3>,
}

impl Course {
    /// Whether the scatter may be chance.
    fn is_steady(&self) -> bool {
        self.ratios.eigenvalues.iter().all(|ratio| *ratio <= MIN_RATIO + MORE_WITH_FEW / self.freedom)
    }

    fn is_at_rest(&self) -> bool {
        self.freedom >= MIN_FREEDOM_AT_REST && self.slope_chi2 < MOVES_CHI2 && self.is_steady()
    }

    /// The scatter beyond the expected; `None` when it is chance.
    fn shake(mut self) -> Option<Matrix3<f64>> {
        if self.is_steady() {
            return None;
        }
        self.ratios.eigenvalues.apply(|ratio| *ratio = (*ratio - 1.0).max(0.0));
        Some(self.own * self.ratios.recompose() * self.own.transpose())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::source::Clock;
    use crate::testing::random::Random;

    const SD_M: f64 = 3e-5;

    /// The covariances of shake for a base that moves as told by the time in seconds, measured with honest errors.
    fn shake(way: impl Fn(f64) -> Vector3<f64>) -> Vec<Matrix3<f64>> {
        let (mut dice, mut shake) = (Random::new(3), Shake::default());
        let frame = |i: i64| {
            let error = Vector3::new(dice.normal(), dice.normal(), dice.normal()) * SD_M;
            let stamp = Timestamp { ns: i * 16_666_667, clock: Clock::Container };
            let position = Vector3::new(0.1, 0.2, 1.4) + way(stamp.ns as f64 * 1e-9) + error;
            shake.add(stamp, position, &(Matrix3::identity() * SD_M * SD_M));
            shake.at(stamp)
        };
        (0..600).map(frame).collect()
    }

    #[test]
    fn rest_and_a_steady_push_are_no_shake() {
        for speed in [0.0, 5e-3] {
            let shake = shake(|t| Vector3::new(0.0, speed * t, 0.0));
            let shaken = shake.iter().filter(|shake| shake.trace() > 0.0).count();
            assert!(shaken < 3, "{shaken} of {} frames at {speed} m/s", shake.len());
        }
    }

    /// The part of 600 frames in which a base that moves as told is seen to rest.
    fn at_rest(way: impl Fn(f64) -> Vector3<f64>) -> f64 {
        let (mut dice, mut shake, mut resting) = (Random::new(4), Shake::default(), 0);
        for i in 0..600 {
            let error = Vector3::new(dice.normal(), dice.normal(), dice.normal()) * SD_M;
            let stamp = Timestamp { ns: i * 16_666_667, clock: Clock::Container };
            shake.add(stamp, way(stamp.ns as f64 * 1e-9) + error, &(Matrix3::identity() * SD_M * SD_M));
            shake.at(stamp);
            resting += i32::from(shake.is_at_rest());
        }
        f64::from(resting) / 600.0
    }

    #[test]
    fn rest_is_told_from_pushes_and_vibrations() {
        assert!(at_rest(|_| Vector3::zeros()) > 0.95);
        // A third of a σ from frame to frame; a vibration of five.
        let pushed = at_rest(|t| Vector3::new(6e-4 * t, 0.0, 0.0));
        let vibrating = at_rest(|t| Vector3::y() * (1.5e-4 * (50.0 * t).sin()));
        assert!(pushed < 0.05 && vibrating < 0.05, "{pushed}, {vibrating}");
    }

    #[test]
    fn a_vibration_is_found_with_its_size_and_direction() {
        let (amplitude, way) = (2e-4, Vector3::new(0.6, 0.8, 0.0));
        let shake = shake(|t| way * (amplitude * (50.0 * t).sin()));
        assert!(shake[..MIN_FRAMES - 1].iter().all(|shake| shake.trace() == 0.0));
        for (i, shake) in shake.iter().enumerate().skip(40) {
            let along = (way.transpose() * shake * way)[0] / (amplitude * amplitude / 2.0);
            let aside = shake.m33 / (amplitude * amplitude / 2.0);
            assert!((0.7..1.3).contains(&along) && aside < 0.05, "frame {i}: {along}, {aside}");
        }
    }

    #[test]
    fn it_is_forgotten_after_half_a_second_and_when_the_clock_is_set_back() {
        let still = shake(|t| Vector3::x() * if t < 5.0 { 2e-4 * (50.0 * t).sin() } else { 0.0 });
        assert!(still[290].trace() > 0.0 && still[340].trace() == 0.0);
        let mut shake = Shake::default();
        let mut at = |ns: i64, x: f64| {
            let stamp = Timestamp { ns, clock: Clock::Container };
            shake.add(stamp, Vector3::x() * x, &(Matrix3::identity() * SD_M * SD_M));
            shake.at(stamp).trace()
        };
        (0..MIN_FRAMES as i64).for_each(|i| assert_eq!(at(1_000_000_000 + i * 1_000_000, 0.0), 0.0));
        assert_eq!(at(0, 1.0), 0.0);
    }
}
