//! Notices a camera, mirror or tank that was moved during the run, by a knock or little by little, seen at the base
//! band, which rests but for what the tube bends it.
//!
//! Method. Where the band was in its first frames, and a line over the direction of the coil through there, with which
//! a band that is not quite at the clamp moves, tell where it should be. The line's slope is fitted to all positions,
//! but only to how they differ within a second or two, so that it does not take a creep for rest. The mean of the
//! latest positions is compared with this line. Both have the same errors of rig and image model. By how much it is off
//! is the error of all positions, if the rig still is where it was at first, and belongs into their covariance; the
//! slope stays as it is as long as it is off. While the coil is not seen, its direction is any of those before.
//! A knock must not pass for a bend that sets in with it: where two short means, one right after the other, differ by
//! more than the slope known so far tells, positions before are not compared with those behind. If they differ by far
//! more, that step is the error until the line tells whether the band is off it.
//! The same sums tell how far a single position is from the first, less what the tube bends it (carried.rs), and how
//! far the band swings with the coil. Beside a clamp it hardly does; a picture that moves with the coil looks the same.
//!
//! Cannot tell: moves before the run or that the base band does not see (the tally's drift alarms see some of them);
//! which of both moments the rig is right for; all of a move among the first frames; anything before the coil was seen
//! for the first time.

use crate::estimate::Position;
use crate::source::Timestamp;
use crate::whitening::chi_square;
use nalgebra::{Matrix3, Vector3};
use std::collections::VecDeque;

/// Fewest frames of the latest mean, and the time that they must span, so that a vibration averages out, nanoseconds.
const LATEST: usize = 15;
const LATEST_NS: i64 = 200_000_000;
/// First frames, and frames within which later positions are compared.
const FIRST: usize = 30;
const TOGETHER: usize = 90;
/// So many positions in a row may have the same error, where a coder leaves a band as it was.
const ALIKE: f64 = 15.0;
/// Prior σ of how far the band moves when the coil turns, metres per radian: a fiftieth of a tube's length.
pub(super) const BENT_M: f64 = 2e-3;
/// The same of a band beside the clamp: an evenly bent tube of 85 mm moves a band 7 mm from its end by so much.
const BENT_BESIDE_CLAMP_M: f64 = 0.3e-3;
/// How far a band beside its clamp does not swing with the coil, metres, in how many frames it must have been further,
/// and how many σ of the slope that must be.
const SWINGS_M: f64 = 0.5e-3;
const SWINGING: u32 = 30;
const SWINGS_SD: f64 = 5.0;
/// Square of the distance over the covariance of a single position beyond which the band has moved. Measured where
/// nothing moved, from a line through all earlier positions: up to 0.6 in lossless recordings, up to 7 in coded ones.
const MIN_CHI2: f64 = 12.0;
/// The same below which a band that had moved is back.
const BACK_CHI2: f64 = 1.0;
/// The same of a step between two short means beyond which positions on both sides are not compared (that costs little
/// where it is none), and beyond which it is an error until the line tells; and by how much more the line must be
/// against the step than against rest, then.
const STEP_CHI2: f64 = 4.0;
const LARGE_STEP_CHI2: f64 = 7.0;
const NO_STEP_CHI2: f64 = 4.0;

/// The base band's positions.
#[derive(Debug, Default)]
pub(in crate::track) struct Moved {
    /// The first, from which all others are counted.
    origin: Option<Origin>,
    /// The first frames, those that are added now, and all.
    first: Sums,
    now: Sums,
    all: Sums,
    /// How positions differ within the frames before these.
    bends: Bends,
    latest: VecDeque<Sample>,
    /// How far it had moved when it began anew, metres.
    before: Vector3<f64>,
    /// The largest step that may be a knock, metres, until the line is against it, and the square of it over its
    /// covariance.
    step: Option<(Vector3<f64>, f64)>,
    /// Whether it is off the line.
    is_off: bool,
    seen: bool,
    /// Frames in which it was swung further than a clamp allows.
    swinging: u32,
}

/// The first position, and the direction of the coil.
#[derive(Debug, Clone, Copy)]
struct Origin {
    position: Vector3<f64>,
    covariance: Matrix3<f64>,
    direction: Vector3<f64>,
}

/// One position, and the direction of the coil, if it was seen, both from the first.
#[derive(Debug, Clone, Copy)]
struct Sample {
    ns: i64,
    direction: Option<Vector3<f64>>,
    position: Vector3<f64>,
    covariance: Matrix3<f64>,
    /// Whether a step may be here.
    at_step: bool,
}

/// Sums over positions p and directions d, weighted.
#[derive(Debug, Default, Clone, Copy)]
struct Sums {
    frames: usize,
    weight: f64,
    direction: Vector3<f64>,
    position: Vector3<f64>,
    /// Σ d dᵀ and Σ d pᵀ.
    bends: Bends,
}

/// Products of directions with themselves and with positions.
#[derive(Debug, Default, Clone, Copy)]
pub(super) struct Bends {
    pub squares: Matrix3<f64>,
    products: Matrix3<f64>,
}

impl Bends {
    pub(super) fn add(&mut self, direction: &Vector3<f64>, position: &Vector3<f64>, weight: f64) {
        self.squares += direction * direction.transpose() * weight;
        self.products += direction * position.transpose() * weight;
    }

    /// How far positions move when directions turn (its transpose, applied to a turn, gives a way), and how uncertain
    /// that is for each coordinate, with weights that are one over variances, m²; a prior of this σ is in both.
    pub(super) fn slope(&self, prior_m: f64) -> Option<(Matrix3<f64>, Matrix3<f64>)> {
        let uncertain = (self.squares + Matrix3::from_diagonal_element(prior_m.powi(-2))).cholesky()?.inverse();
        Some((uncertain * self.products, uncertain))
    }
}

impl std::ops::Add for Bends {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self { squares: self.squares + other.squares, products: self.products + other.products }
    }
}

impl Sums {
    fn add(&mut self, direction: &Vector3<f64>, position: &Vector3<f64>, weight: f64) {
        self.frames += 1;
        self.weight += weight;
        self.direction += direction * weight;
        self.position += position * weight;
        self.bends.add(direction, position, weight);
    }

    /// The products about the means.
    fn scatter(&self) -> Bends {
        if self.weight == 0.0 {
            return Bends::default();
        }
        let Self { weight, direction, position, bends, .. } = self;
        Bends {
            squares: bends.squares - direction * direction.transpose() / *weight,
            products: bends.products - direction * position.transpose() / *weight,
        }
    }
}

impl Moved {
    /// Whether it has ever moved.
    pub(in crate::track) fn is_seen(&self) -> bool {
        self.seen
    }

    /// Whether it swings with the coil, further than beside a clamp.
    pub(in crate::track) fn swings(&self) -> bool {
        self.swinging >= SWINGING
    }

    /// Begins anew, because positions change by themselves. A move that was found stays.
    pub(in crate::track) fn forget(&mut self) {
        let off = self.off().filter(|_| self.is_off).map_or_else(Vector3::zeros, |(off, _)| off);
        *self = Self { before: self.before + off, seen: self.seen, ..Self::default() };
    }

    /// Adds a position of the base band, with the direction of the coil, if it was seen.
    pub(in crate::track) fn add(&mut self, stamp: Timestamp, base: &Position, direction: Option<&Vector3<f64>>) {
        let Position { point, covariance, .. } = *base;
        let first = || Some(Origin { position: point.coords, covariance, direction: *direction? });
        let Some(origin) = self.origin.or_else(first) else { return };
        self.origin = Some(origin);
        let (direction, position) = (direction.map(|to| to - origin.direction), point.coords - origin.position);
        self.latest.push_back(Sample { ns: stamp.ns, direction, position, covariance, at_step: false });
        // (A clock that is set back ends the mean, too.)
        let is_long = |latest: &VecDeque<Sample>| {
            latest.len() > LATEST
                && latest.get(1).is_some_and(|next| !(0..LATEST_NS).contains(&stamp.ns.saturating_sub(next.ns)))
        };
        while is_long(&self.latest)
            && let Some(Sample { direction, position, covariance, at_step, .. }) = self.latest.pop_front()
        {
            if at_step {
                self.bends = self.bends + std::mem::take(&mut self.now).scatter();
                continue;
            }
            let Some(direction) = direction.filter(|_| !self.is_off) else { continue };
            let weight = 3.0 / covariance.trace() / ALIKE;
            self.all.add(&direction, &position, weight);
            if self.first.frames < FIRST {
                self.first.add(&direction, &position, weight);
                continue;
            }
            self.now.add(&direction, &position, weight);
            if self.now.frames == TOGETHER {
                self.bends = self.bends + std::mem::take(&mut self.now).scatter();
            }
        }
        self.look_for_step();
        self.swinging = self.swinging.saturating_add(u32::from(self.swing_m() > Some(SWINGS_M)));
    }

    /// The covariance of the move, m²; zero if there is none.
    pub(in crate::track) fn covariance(&mut self) -> Matrix3<f64> {
        let (mut off, variance) = self.off().unwrap_or_default();
        let chi2 = chi_square(&off, variance).unwrap_or_default();
        self.is_off = chi2 > if self.is_off { BACK_CHI2 } else { MIN_CHI2 };
        self.seen |= self.is_off;
        let against = |step: &Vector3<f64>| Some(chi_square(&(off - step), variance)? - chi2);
        let is_open = |step: &Vector3<f64>| against(step).is_some_and(|more| more < NO_STEP_CHI2);
        self.step = self.step.filter(|(step, _)| is_open(step));
        if !self.is_off {
            off = self.step.map_or_else(Vector3::zeros, |(step, _)| step);
        }
        off += self.before;
        off * off.transpose()
    }

    /// Compares the older half of the latest positions with the newer.
    fn look_for_step(&mut self) {
        let middle = self.latest.len() / 2;
        let Some((step, chi2)) = self.step_at(middle).filter(|(_, chi2)| *chi2 > STEP_CHI2) else { return };
        if let Some(sample) = self.latest.get_mut(middle) {
            sample.at_step = true;
        }
        if chi2 > self.step.map_or(LARGE_STEP_CHI2, |(_, most)| most) {
            self.step = Some((step, chi2));
        }
    }

    /// How far the mean of the latest positions from `middle` on is from that of those before, less what the tube bent
    /// the band, metres, and the square of that over its covariance; `None` with too few positions, or where the coil
    /// was not seen.
    fn step_at(&self, middle: usize) -> Option<(Vector3<f64>, f64)> {
        if self.latest.len() < LATEST || self.first.frames < LATEST || self.is_off {
            return None;
        }
        let mean = |samples: [usize; 2]| {
            let mut sums = (Vector3::zeros(), Vector3::zeros(), Matrix3::zeros());
            for sample in self.latest.range(samples[0]..samples[1]) {
                sums = (sums.0 + sample.position, sums.1 + sample.direction?, sums.2 + sample.covariance);
            }
            let count = (samples[1] - samples[0]) as f64;
            Some((sums.0 / count, sums.1 / count, sums.2 / count))
        };
        let (before, from, own_before) = mean([0, middle])?;
        let (now, to, own) = mean([middle, self.latest.len()])?;
        let (slope, uncertain) = self.slope(BENT_M)?;
        let turned = to - from;
        let step = now - before - slope.tr_mul(&turned);
        // As for the line, of many positions that may have the same error.
        let variance = (own_before + own) / 2.0 + Matrix3::from_diagonal_element(turned.dot(&(uncertain * turned)));
        Some((step, chi_square(&step, variance)?))
    }

    /// How the band moves when the coil turns, and how uncertain that is ([`Bends::slope`]).
    fn slope(&self, prior_m: f64) -> Option<(Matrix3<f64>, Matrix3<f64>)> {
        (self.first.scatter() + self.bends + self.now.scatter()).slope(prior_m)
    }

    /// How far the last position is from the first, less what the tube bent it as far as that is known, metres, with
    /// the covariance of both; `None` where the coil was not seen.
    pub(in crate::track) fn since_first(&self) -> Option<(Vector3<f64>, Matrix3<f64>)> {
        let Sample { direction, position, covariance, .. } = self.latest.back()?;
        let (slope, _) = self.slope(BENT_BESIDE_CLAMP_M)?;
        Some((position - slope.tr_mul(direction.as_ref()?), covariance + self.origin?.covariance))
    }

    /// How far the last direction of the coil has swung the band from the mean, metres, if that is known.
    fn swing_m(&self) -> Option<f64> {
        let turned = self.latest.back()?.direction? - self.all.direction / self.all.weight;
        let (slope, uncertain) = self.slope(BENT_M)?;
        let (way_m, variance) = (slope.tr_mul(&turned).norm(), turned.dot(&(uncertain * turned)));
        (way_m > SWINGS_SD * variance.sqrt()).then_some(way_m)
    }

    /// How far the latest positions are from the line, metres, and the covariance of that; `None` with too few
    /// positions.
    fn off(&self) -> Option<(Vector3<f64>, Matrix3<f64>)> {
        if self.latest.len() < LATEST || self.first.frames < LATEST {
            return None;
        }
        let count = self.latest.len() as f64;
        let (slope, uncertain) = self.slope(BENT_M)?;
        let usual = self.all.direction / self.all.weight;
        let sum = self.latest.iter().map(|sample| sample.direction.unwrap_or(usual)).sum::<Vector3<f64>>();
        let turned = sum / count - self.first.direction / self.first.weight;
        let position = self.latest.iter().map(|sample| sample.position).sum::<Vector3<f64>>() / count;
        let off = position - self.first.position / self.first.weight - slope.tr_mul(&turned);
        let own = self.latest.iter().map(|sample| sample.covariance).sum::<Matrix3<f64>>() / count;
        let of_line = 1.0 / self.first.weight + turned.dot(&(uncertain * turned));
        let mut variance = own + Matrix3::from_diagonal_element(of_line);
        let hidden = self.latest.iter().filter(|sample| sample.direction.is_none()).count() as f64 / count;
        if hidden > 0.0 {
            // Of unknown directions, as they scattered so far.
            let scatter = self.all.scatter().squares / self.all.weight;
            let bent = slope.tr_mul(&(scatter * slope)) + Matrix3::from_diagonal_element((uncertain * scatter).trace());
            variance += bent * hidden;
        }
        Some((off, variance))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::source::Clock;
    use crate::testing::random::Random;
    use nalgebra::Point3;
    use std::ops::Range;

    const SD_M: f64 = 3e-5;

    fn base(point: Point3<f64>) -> Position {
        let covariance = Matrix3::from_diagonal_element(SD_M * SD_M);
        Position { point, covariance, bound: covariance }
    }

    /// The covariances that a base adds which is where this tells, by frame, and whether it is seen to move; the coil
    /// swings by half a radian.
    fn follow(frames: usize, at: impl Fn(usize) -> Vector3<f64>) -> (Vec<Matrix3<f64>>, bool) {
        follow_hidden(frames, 0..0, at)
    }

    /// The same with the coil hidden in some frames.
    fn follow_hidden(
        frames: usize,
        hidden: Range<usize>,
        at: impl Fn(usize) -> Vector3<f64>,
    ) -> (Vec<Matrix3<f64>>, bool) {
        let (mut moved, mut random) = (Moved::default(), Random::new(5));
        let frame = |k: usize| {
            let error = Vector3::from_fn(|_, _| SD_M * random.normal());
            let point = Point3::new(0.1, 0.2, 1.4) + at(k) + error;
            let base = base(point);
            let (sin, cos) = swing(k).sin_cos();
            let direction = Vector3::new(sin, cos, 0.0);
            moved.add(stamp(k), &base, (!hidden.contains(&k)).then_some(&direction));
            moved.covariance()
        };
        ((0..frames).map(frame).collect(), moved.is_seen())
    }

    fn stamp(k: usize) -> Timestamp {
        Timestamp { ns: k as i64 * 16_666_667, clock: Clock::Container }
    }

    fn swing(k: usize) -> f64 {
        0.5 * (0.1 * k as f64).sin()
    }

    #[test]
    fn what_swings_further_than_beside_a_clamp_is_noticed() {
        let swings = |m_per_rad: f64| {
            let (mut moved, mut random) = (Moved::default(), Random::new(5));
            for k in 0..300 {
                let (sin, cos) = swing(k).sin_cos();
                let error = Vector3::from_fn(|_, _| SD_M * random.normal());
                let point = Point3::from(Vector3::x() * m_per_rad * sin + error);
                moved.add(stamp(k), &base(point), Some(&Vector3::new(sin, cos, 0.0)));
                moved.covariance();
            }
            moved.swings()
        };
        assert!(!swings(0.0) && !swings(3e-4) && !swings(5e-4) && swings(1.5e-3));
    }

    #[test]
    fn what_left_its_first_place_is_off_it_and_what_bends_with_the_tube_is_not() {
        let last = |at: &dyn Fn(usize) -> Vector3<f64>| {
            let mut moved = Moved::default();
            for k in 0..200 {
                let (sin, cos) = swing(k).sin_cos();
                moved.add(stamp(k), &base(Point3::from(at(k))), Some(&Vector3::new(sin, cos, 0.0)));
            }
            moved.since_first().unwrap()
        };
        let (off, covariance) = last(&|k| if k == 0 { Vector3::zeros() } else { Vector3::y() * 4e-4 });
        assert!((off - Vector3::y() * 4e-4).norm() < 1e-5, "{off}");
        assert!((covariance[(0, 0)] - 2.0 * SD_M * SD_M).abs() < 1e-15);
        let (off, _) = last(&|k| Vector3::x() * 2e-4 * swing(k));
        assert!(off.norm() < 3e-5, "{off} of {}", 2e-4 * swing(199));
        // The coil is hidden: what the tube bends is not known.
        let mut moved = Moved::default();
        moved.add(stamp(0), &base(Point3::origin()), Some(&Vector3::y()));
        moved.add(stamp(1), &base(Point3::origin()), None);
        assert!(moved.since_first().is_none());
    }

    #[test]
    fn rest_vibration_and_bends_are_no_move() {
        let (rest, seen) = follow(2000, |_| Vector3::zeros());
        assert!(!seen && rest.iter().all(|covariance| covariance.trace() == 0.0));
        assert!(!follow(2000, |k| Vector3::x() * 5.0 * SD_M * (0.8 * k as f64).sin()).1);
        // By half a millimetre, with the tube.
        assert!(!follow(2000, |k| Vector3::x() * 1e-3 * swing(k)).1);
    }

    #[test]
    fn knocks_and_creep_are_added_as_far_as_they_went() {
        let to = Vector3::new(1e-4, -2e-4, 0.0);
        let bent = |k: usize| Vector3::z() * 4e-4 * swing(k);
        let (knocked, seen) = follow(200, |k| bent(k) + if k < 100 { Vector3::zeros() } else { to });
        assert!(seen && knocked[99].trace() == 0.0);
        let last = knocked[199];
        assert!((last - to * to.transpose()).norm() < 0.3 * to.norm_squared(), "{last}");
        let (crept, seen) = follow(600, |k| bent(k) + to * (k as f64 / 600.0));
        let part = (crept[599].trace() / to.norm_squared()).sqrt();
        assert!(seen && (0.85..1.1).contains(&part), "{part}");
    }

    /// In the middle of a swing that grows: a bend that sets in with the knock would explain it for a while.
    #[test]
    fn a_knock_in_a_growing_swing_is_no_bend() {
        let to = Vector3::new(1.8e-4, 0.0, -1.8e-4);
        let added = |at: &dyn Fn(usize) -> Vector3<f64>| {
            let (mut moved, mut random) = (Moved::default(), Random::new(5));
            let mut of_frame = |k: usize| {
                let angle = 2.5e-3 * k.min(180) as f64 * (0.1 * k as f64).sin();
                let error = Vector3::from_fn(|_, _| 0.2 * SD_M * random.normal());
                let (sin, cos) = angle.sin_cos();
                moved.add(stamp(k), &base(Point3::from(at(k) + error)), Some(&Vector3::new(sin, cos, 0.0)));
                moved.covariance()
            };
            (0..240).map(&mut of_frame).map(|covariance| covariance.trace().sqrt()).collect::<Vec<_>>()
        };
        let least = |knock: usize| {
            let added = added(&|k| if k < knock { Vector3::zeros() } else { to });
            assert!(added[..knock].iter().all(|added| *added == 0.0), "{knock}");
            added[knock + 10..].iter().copied().fold(f64::INFINITY, f64::min) / to.norm()
        };
        let least = [70, 80, 90, 100, 110, 120].map(least);
        assert!(least.iter().all(|least| *least > 0.5), "{least:?}");
        assert!(added(&|_| Vector3::zeros()).iter().all(|added| *added == 0.0));
    }

    #[test]
    fn a_hidden_coil_hides_no_knock() {
        let to = Vector3::new(1e-4, -2e-4, 0.0);
        let (knocked, seen) = follow_hidden(200, 70..200, |k| if k < 100 { Vector3::zeros() } else { to });
        let last = knocked[199];
        assert!(seen && (last - to * to.transpose()).norm() < 0.3 * to.norm_squared(), "{last}");
        // It may have bent the base: to where it was before.
        let (bent, seen) = follow_hidden(200, 70..200, |k| Vector3::x() * 1e-3 * swing(if k < 70 { k } else { 47 }));
        assert!(!seen && bent.iter().all(|covariance| covariance.trace() == 0.0));
    }

    #[test]
    fn a_band_that_is_back_adds_nothing_and_is_compared_as_before() {
        let jumps = |k: usize| Vector3::x() * if (100..140).contains(&k) { 3e-4 } else { 0.0 };
        let (knocked, seen) = follow(2000, jumps);
        assert!(seen && knocked[139].trace() > 5e-8 && knocked[160..].iter().all(|added| added.trace() == 0.0));
    }

    #[test]
    fn it_begins_anew_when_positions_change_by_themselves() {
        let (mut moved, mut frame) = (Moved::default(), 0);
        let mut stay = |moved: &mut Moved, x: f64| {
            let mut added = 0.0;
            for _ in 0..60 {
                moved.add(stamp(frame), &base(Point3::new(x, 0.0, 1.4)), Some(&Vector3::y()));
                added = moved.covariance().trace();
                frame += 1;
            }
            added
        };
        assert_eq!(stay(&mut moved, 0.0), 0.0);
        moved.forget();
        assert_eq!(stay(&mut moved, 1e-3), 0.0);
        assert!(!moved.is_seen());
        // A move that was found is not forgotten, nor one back after that.
        let off = |variance: f64| (variance.sqrt() - 2e-3).abs() < 1e-6;
        assert!(off(stay(&mut moved, 3e-3)));
        moved.forget();
        assert!(off(moved.covariance().trace()) && off(stay(&mut moved, 4e-3)));
        assert!(stay(&mut moved, 2e-3) < 1e-12);
    }
}
