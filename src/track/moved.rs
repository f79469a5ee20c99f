//! Notices a camera, mirror or tank that was moved during the run, by a knock or little by little, seen at the base
//! band, which rests but for what the tube bends it.
//!
//! Method. A line is fitted to the base band's positions over the direction of the coil, with which a band that is not
//! quite at the clamp moves. The mean of its latest positions is compared with this line. Both have the same errors of
//! rig and image model. By how much it is off is the error of all positions, if the rig still is where it was at first,
//! and belongs into their covariance; the line stays as it is from then on.
//!
//! Cannot tell: moves before the run or that the base band does not see (the tally's drift alarms see some of them);
//! which of both moments the rig is right for; a creep over all of a run, of which half is taken for rest.

use crate::estimate::Position;
use nalgebra::{Matrix3, Matrix4, Matrix4x3, Vector3, Vector4};
use std::collections::VecDeque;

/// Frames of the latest mean, and the fewest that the line is fitted to.
const LATEST: usize = 15;
const MIN_FITTED: usize = 15;
/// So many positions in a row may have the same error, where a coder leaves a band as it was.
const ALIKE: f64 = 15.0;
/// Prior σ of how far the band moves when the coil turns, metres per radian: a fiftieth of a tube's length.
const BENT_M: f64 = 2e-3;
/// Square of the distance over the covariance of a single position beyond which the band has moved. Measured where
/// nothing moved: up to 0.6 in lossless recordings, up to 7 in coded ones.
const MIN_CHI2: f64 = 12.0;
/// The same below which a band that had moved is back.
const BACK_CHI2: f64 = 1.0;

/// The base band's positions.
#[derive(Debug, Default)]
pub(crate) struct Moved {
    /// The first, from which all others are counted.
    first: Option<(Vector3<f64>, Vector3<f64>)>,
    /// Normal equations of the line: its offset, and its slope along the three coordinates of the direction.
    normal: Matrix4<f64>,
    right: Matrix4x3<f64>,
    fitted: usize,
    latest: VecDeque<Sample>,
    /// Whether it has moved since it began.
    is_off: bool,
    seen: bool,
}

/// One position, from the first, with the direction of the coil, from the first, behind a 1.
#[derive(Debug, Clone, Copy)]
struct Sample {
    by: Vector4<f64>,
    position: Vector3<f64>,
    covariance: Matrix3<f64>,
}

impl Moved {
    /// Whether it has ever moved.
    pub(crate) fn is_seen(&self) -> bool {
        self.seen
    }

    /// Begins anew.
    pub(crate) fn forget(&mut self) {
        *self = Self { seen: self.seen, ..Self::default() };
    }

    /// Adds a position of the base band, with the direction of the coil.
    pub(crate) fn add(&mut self, base: &Position, direction: &Vector3<f64>) {
        let (place, turn) = *self.first.get_or_insert((base.point.coords, *direction));
        let by = (direction - turn).insert_row(0, 1.0);
        self.latest.push_back(Sample { by, position: base.point.coords - place, covariance: base.covariance });
        if self.latest.len() > LATEST
            && let Some(Sample { by, position, covariance }) = self.latest.pop_front()
            && !self.is_off
        {
            let weight = 3.0 / covariance.trace() / ALIKE;
            self.normal += by * by.transpose() * weight;
            self.right += by * position.transpose() * weight;
            self.fitted += 1;
        }
    }

    /// The covariance of the move, m²; zero if there is none.
    pub(crate) fn covariance(&mut self) -> Matrix3<f64> {
        let Some((off, chi2)) = self.off() else { return Matrix3::zeros() };
        if chi2 < if self.is_off { BACK_CHI2 } else { MIN_CHI2 } {
            return Matrix3::zeros();
        }
        (self.is_off, self.seen) = (true, true);
        off * off.transpose()
    }

    /// How far the latest positions are from the line, metres, and the square of that over its covariance; `None` with
    /// too few positions.
    fn off(&self) -> Option<(Vector3<f64>, f64)> {
        if self.latest.len() < LATEST || self.fitted < MIN_FITTED {
            return None;
        }
        let count = LATEST as f64;
        let by = self.latest.iter().map(|sample| sample.by).sum::<Vector4<f64>>() / count;
        let position = self.latest.iter().map(|sample| sample.position).sum::<Vector3<f64>>() / count;
        let own = self.latest.iter().map(|sample| sample.covariance).sum::<Matrix3<f64>>() / count;
        let known = self.normal + Matrix4::from_diagonal(&Vector3::repeat(BENT_M.powi(-2)).insert_row(0, 0.0));
        let inverse = known.cholesky()?.inverse();
        let off = position - (inverse * self.right).tr_mul(&by);
        let variance = own + Matrix3::from_diagonal_element((by.transpose() * inverse * by)[0]);
        Some((off, off.dot(&variance.cholesky()?.solve(&off))))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::random::Random;
    use nalgebra::Point3;

    const SD_M: f64 = 3e-5;

    fn base(point: Point3<f64>) -> Position {
        let covariance = Matrix3::from_diagonal_element(SD_M * SD_M);
        Position { point, covariance, bound: covariance }
    }

    /// The covariances that a base adds which is where this tells, by frame, and whether it is seen to move; the coil
    /// swings by half a radian.
    fn follow(frames: usize, at: impl Fn(usize) -> Vector3<f64>) -> (Vec<Matrix3<f64>>, bool) {
        let (mut moved, mut random) = (Moved::default(), Random::new(5));
        let frame = |k: usize| {
            let error = Vector3::from_fn(|_, _| SD_M * random.normal());
            let point = Point3::new(0.1, 0.2, 1.4) + at(k) + error;
            let base = base(point);
            let (sin, cos) = swing(k).sin_cos();
            moved.add(&base, &Vector3::new(sin, cos, 0.0));
            moved.covariance()
        };
        ((0..frames).map(frame).collect(), moved.is_seen())
    }

    fn swing(k: usize) -> f64 {
        0.5 * (0.1 * k as f64).sin()
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
        assert!(seen && (0.4..1.1).contains(&part), "{part}");
    }

    #[test]
    fn it_begins_anew_when_positions_change_by_themselves() {
        let mut moved = Moved::default();
        let at = |x: f64| base(Point3::new(x, 0.0, 1.4));
        (0..60).for_each(|_| moved.add(&at(0.0), &Vector3::y()));
        moved.forget();
        (0..60).for_each(|_| moved.add(&at(1e-3), &Vector3::y()));
        assert!(moved.covariance().trace() == 0.0 && !moved.is_seen());
    }
}
