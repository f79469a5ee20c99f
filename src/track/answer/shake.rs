//! Shake of the camera, seen at the base band, which rests.
//!
//! A camera, mirror or tank that vibrates moves all bands alike. Of a band that moves itself nothing of this can be
//! told; of the base band it can: what its positions scatter about a straight line of time over half a second, beyond
//! what its covariance explains, is shake, and belongs into the covariance of all positions. The line is there because
//! a base that is pushed steadily does not shake. What neither shakes nor moves along the line rests.
//!
//! A band that is not quite at the clamp moves with the tube: in proportion to the turns of the coil, which shake does
//! not turn. What these explain is no shake either.
//!
//! Cannot tell: vibration that moves only the picture of other bands; motion slower than the half second
//! (moved.rs); shake too small beside the base's own covariance, or in step with the coil.

use crate::estimate::Position;
use crate::source::Timestamp;
use crate::source::times;
use crate::track::answer::moved::{BENT_M, Bends};
use crate::whitening::{Whitened, chi_square};
use nalgebra::{Matrix3, Vector3};
use std::collections::VecDeque;

/// Time over which the scatter is taken, nanoseconds, and the least number of frames in it.
const WINDOW_NS: i64 = 500_000_000;
const MIN_FRAMES: usize = 4;
/// Most frames: more tell little more.
const MAX_FRAMES: usize = 120;
/// So that they last for all of the time at high frame rates, too, of frames closer together only some count.
const MIN_STEP_NS: i64 = WINDOW_NS / MAX_FRAMES as i64;
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
pub(in crate::track) struct Shake {
    recent: VecDeque<Sample>,
    seen: bool,
    rests: bool,
    /// The last shake that was known, m²: it goes on while the band is not seen.
    known: Matrix3<f64>,
}

#[derive(Debug)]
struct Sample {
    ns: i64,
    position: Vector3<f64>,
    covariance: Matrix3<f64>,
    /// Of the coil, if it was seen.
    direction: Option<Vector3<f64>>,
}

impl Shake {
    /// Whether it has ever shaken.
    pub(in crate::track) fn is_seen(&self) -> bool {
        self.seen
    }

    /// Whether the band was seen to rest.
    pub(in crate::track) fn is_at_rest(&self) -> bool {
        self.rests
    }

    /// Begins anew.
    pub(in crate::track) fn forget(&mut self) {
        self.recent.clear();
        self.rests = false;
    }

    /// Adds a position of the base band, m, with its covariance, and the direction of the coil, if it was seen.
    pub(in crate::track) fn add(&mut self, stamp: Timestamp, base: &Position, direction: Option<&Vector3<f64>>) {
        let Position { point, covariance, .. } = *base;
        let is_close = |last: &Sample| (0..MIN_STEP_NS).contains(&stamp.ns.saturating_sub(last.ns));
        if self.recent.back().is_some_and(is_close) {
            return;
        }
        let sample = Sample { ns: stamp.ns, position: point.coords, covariance, direction: direction.copied() };
        self.recent.push_back(sample);
        if self.recent.len() > MAX_FRAMES {
            self.recent.pop_front();
        }
    }

    /// The covariance of the shake at a time, m²; zero if there is none.
    pub(in crate::track) fn at(&mut self, stamp: Timestamp) -> Matrix3<f64> {
        self.recent.retain(|sample| (0..=WINDOW_NS).contains(&stamp.ns.saturating_sub(sample.ns)));
        let course = Course::of(self.recent.iter().collect());
        self.rests = course.as_ref().is_some_and(Course::is_at_rest);
        if let Some(course) = course {
            self.known = course.shake().unwrap_or_else(Matrix3::zeros);
        }
        self.seen |= self.known.trace() > 0.0;
        self.known
    }
}

/// The recent positions compared with a straight line of time.
struct Course<'a> {
    recent: Vec<&'a Sample>,
    /// Mean time of the samples, seconds from the newest, and their squares about it.
    time: f64,
    times: f64,
    line: Line,
    /// Frames beyond those that determine the line.
    freedom: f64,
    /// The covariance expected of a position.
    expected: Matrix3<f64>,
    /// What is off the line.
    scatter: Scatter,
}

/// A straight line of time.
struct Line {
    mean: Vector3<f64>,
    slope: Vector3<f64>,
}

impl Line {
    /// How far a value is off it, at a time from the mean.
    fn off(&self, value: &Vector3<f64>, t: f64) -> Vector3<f64> {
        value - self.mean - self.slope * t
    }
}

/// When a sample was taken, seconds from the newest.
fn seconds(recent: &[&Sample], sample: &Sample) -> f64 {
    recent.last().map_or(0.0, |newest| times::seconds(sample.ns.saturating_sub(newest.ns)))
}

impl<'a> Course<'a> {
    /// `None` with too few positions, or without time between them.
    fn of(recent: Vec<&'a Sample>) -> Option<Self> {
        if recent.len() < MIN_FRAMES {
            return None;
        }
        let count = recent.len() as f64;
        let time = recent.iter().map(|sample| seconds(&recent, sample) / count).sum::<f64>();
        let times = recent.iter().map(|sample| (seconds(&recent, sample) - time).powi(2)).sum();
        let expected = recent.iter().map(|sample| sample.covariance / count).sum();
        let line = line(&recent, time, times, |sample| sample.position);
        // Two frames' worth is in the line.
        let freedom = count - 2.0;
        let off = recent.iter().map(|sample| line.off(&sample.position, seconds(&recent, sample) - time));
        let scatter = Scatter::of(off, freedom, &expected)?;
        Some(Self { recent, time, times, line, freedom, expected, scatter })
    }

    /// Square of the slope in units of its own covariance.
    fn slope_chi2(&self) -> f64 {
        chi_square(&self.line.slope, self.expected).map_or(f64::INFINITY, |chi2| chi2 * self.times)
    }

    fn is_at_rest(&self) -> bool {
        self.freedom >= MIN_FREEDOM_AT_REST && self.slope_chi2() < MOVES_CHI2 && self.scatter.is_chance()
    }

    /// The scatter beyond what is expected and what the turns of the coil explain; `None` when it is chance.
    fn shake(self) -> Option<Matrix3<f64>> {
        if self.scatter.is_chance() {
            return None;
        }
        // Where the coil was not seen, nothing tells how far the tube moved the band.
        let with_coil = self.recent.iter().copied().filter(|sample| sample.direction.is_some()).collect();
        let beside_bends = match Course::of(with_coil) {
            Some(course) => course.beside_bends()?,
            None => self.scatter,
        };
        beside_bends.beyond_chance()
    }

    /// The scatter without what the turns of the coil explain, which all samples have.
    fn beside_bends(&self) -> Option<Scatter> {
        let Self { ref recent, time, times, .. } = *self;
        let direction = |sample: &Sample| sample.direction.unwrap_or_default();
        let turns = line(recent, time, times, direction);
        let off = |sample: &Sample| {
            let t = seconds(recent, sample) - time;
            [self.line.off(&sample.position, t), turns.off(&direction(sample), t)]
        };
        let mut bends = Bends::default();
        for [position, turn] in recent.iter().copied().map(off) {
            bends.add(&turn, &position, 3.0 / self.expected.trace());
        }
        let (slope, uncertain) = bends.slope(BENT_M)?;
        let freedom = self.freedom - (uncertain * bends.squares).trace();
        let rest = recent.iter().copied().map(off).map(|[position, turn]| position - slope.tr_mul(&turn));
        Scatter::of(rest, freedom, &self.expected)
    }
}

/// The line through values of the samples, whose times have this mean and squares about it.
fn line(recent: &[&Sample], time: f64, times: f64, value: impl Fn(&Sample) -> Vector3<f64>) -> Line {
    let count = recent.len() as f64;
    let mean = recent.iter().map(|sample| value(sample) / count).sum::<Vector3<f64>>();
    let moved = |sample: &Sample| (value(sample) - mean) * (seconds(recent, sample) - time);
    Line { mean, slope: recent.iter().copied().map(moved).sum::<Vector3<f64>>() / times }
}

/// How far values scatter.
struct Scatter {
    freedom: f64,
    /// In units of the expected covariance.
    whitened: Whitened,
}

impl Scatter {
    fn of(values: impl Iterator<Item = Vector3<f64>>, freedom: f64, expected: &Matrix3<f64>) -> Option<Self> {
        let scatter: Matrix3<f64> = values.map(|value| value * value.transpose() / freedom).sum();
        if freedom <= 0.0 || !scatter.iter().all(|value| value.is_finite()) {
            return None;
        }
        Some(Self { freedom, whitened: Whitened::of(&scatter, expected)? })
    }

    fn is_chance(&self) -> bool {
        self.whitened.ratios.eigenvalues.iter().all(|ratio| *ratio <= MIN_RATIO + MORE_WITH_FEW / self.freedom)
    }

    /// What is beyond the expected; `None` when it is chance.
    fn beyond_chance(self) -> Option<Matrix3<f64>> {
        if self.is_chance() {
            return None;
        }
        let Whitened { root, mut ratios, .. } = self.whitened;
        ratios.eigenvalues.apply(|ratio| *ratio = (*ratio - 1.0).max(0.0));
        Some(root * ratios.recompose() * root.transpose())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::source::Clock;
    use crate::testing::random::Random;
    use nalgebra::Point3;

    const SD_M: f64 = 3e-5;

    fn base(position: Vector3<f64>) -> Position {
        let covariance = Matrix3::from_diagonal_element(SD_M * SD_M);
        Position { point: Point3::from(position), covariance, bound: covariance }
    }

    /// The covariances of shake for a base that moves as told by the time in seconds, measured with honest errors.
    fn shake(way: impl Fn(f64) -> Vector3<f64>) -> Vec<Matrix3<f64>> {
        shake_turning(|_| 0.0, way)
    }

    /// The same with a coil that turns by the angle, radians, and is seen with honest errors, except in every 50th
    /// frame.
    fn shake_turning(turn: impl Fn(f64) -> f64, way: impl Fn(f64) -> Vector3<f64>) -> Vec<Matrix3<f64>> {
        let (mut dice, mut shake) = (Random::new(3), Shake::default());
        let frame = |i: i64| {
            let error = Vector3::new(dice.normal(), dice.normal(), dice.normal()) * SD_M;
            let stamp = Timestamp { ns: i * 16_666_667, clock: Clock::Container };
            let time = stamp.ns as f64 * 1e-9;
            let position = Vector3::new(0.1, 0.2, 1.4) + way(time) + error;
            let (sin, cos) = (turn(time) + 3e-3 * dice.normal()).sin_cos();
            let direction = Vector3::new(sin, cos, 0.0);
            shake.add(stamp, &base(position), (i % 50 != 49).then_some(&direction));
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
            shake.add(stamp, &base(way(stamp.ns as f64 * 1e-9) + error), None);
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
    fn a_base_that_the_tube_bends_does_not_shake() {
        let turn = |t: f64| 0.6 * (9.0 * t).sin();
        for (mm_per_radian, vibration_m) in [(0.5, 0.0), (3.0, 0.0), (3.0, 2e-4)] {
            let bent = |t: f64| Vector3::new(1e-3 * mm_per_radian * turn(t).sin(), 0.0, 0.0);
            let shake = shake_turning(turn, |t| bent(t) + Vector3::z() * (vibration_m * (50.0 * t).sin()));
            let settled = &shake[40..];
            let shaken = settled.iter().filter(|shake| shake.trace() > 0.0).count();
            let of_vibration = settled.iter().map(Matrix3::trace).sum::<f64>() / settled.len() as f64;
            if vibration_m == 0.0 {
                assert!(shaken < 3, "{shaken} frames at {mm_per_radian} mm per radian");
            } else {
                let part = of_vibration / (vibration_m * vibration_m / 2.0);
                assert!((0.8..1.2).contains(&part), "{part}");
            }
        }
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
            shake.add(stamp, &base(Vector3::x() * x), None);
            shake.at(stamp).trace()
        };
        (0..MIN_FRAMES as i64).for_each(|i| assert_eq!(at(1_000_000_000 + i * 5_000_000, 0.0), 0.0));
        assert_eq!(at(0, 1.0), 0.0);
    }

    /// What hides the band does not hold the camera; and at 1000 frames per second half a second is half a second.
    #[test]
    fn it_goes_on_while_the_band_is_hidden_at_any_frame_rate() {
        for rate in [60, 1000] {
            let mut shake = Shake::default();
            let mut random = Random::new(rate);
            let stamp = |i: u64| Timestamp { ns: (i * 1_000_000_000 / rate) as i64, clock: Clock::Container };
            for i in 0..2 * rate {
                let noise = Vector3::from_fn(|_, _| random.normal() * SD_M);
                let way = Vector3::x() * 2e-4 * (std::f64::consts::TAU * 5.0 * i as f64 / rate as f64).sin();
                shake.add(stamp(i), &base(way + noise), None);
                shake.at(stamp(i));
            }
            let hidden = shake.at(stamp(3 * rate));
            assert!((0.6..1.4).contains(&(hidden.m11 / (2e-4_f64.powi(2) / 2.0))), "{rate}: {hidden}");
        }
    }
}
