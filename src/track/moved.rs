//! Notices a camera, mirror or tank that was moved during the run, by a knock or little by little, seen at the base band,
//! which rests.
//!
//! Method. The mean of the base band's latest positions is compared with that of the first ones. They have the same errors
//! of rig and image model, so that less than the σ of a single position tells. What it moved by is the error of all
//! positions, if the rig still is where it was at first, and belongs into their covariance.
//!
//! Cannot tell: moves before the run or that the base band does not see (the tally's drift alarms see some of them); which
//! of both moments the rig is right for; moves of a base band so far from its clamp that it moves with the tube.

use nalgebra::{Matrix3, Vector3};
use std::collections::VecDeque;

/// Frames of the first mean, and of the latest.
const FIRST: usize = 30;
const LATEST: usize = 15;
/// Square of the distance of these means over the covariance of a single position beyond which the band has moved.
/// Measured where nothing moved: up to 0.6 in lossless recordings, up to 8 in coded ones, whose errors change slowly.
const MIN_CHI2: f64 = 12.0;

/// The base band's positions.
#[derive(Debug, Default)]
pub(crate) struct Moved {
    first: Vec<(Vector3<f64>, Matrix3<f64>)>,
    latest: VecDeque<(Vector3<f64>, Matrix3<f64>)>,
    seen: bool,
}

impl Moved {
    /// Whether it has ever moved.
    pub(crate) fn is_seen(&self) -> bool {
        self.seen
    }

    /// Begins anew.
    pub(crate) fn forget(&mut self) {
        self.first.clear();
        self.latest.clear();
    }

    /// Adds a position of the base band, m, with its covariance.
    pub(crate) fn add(&mut self, position: Vector3<f64>, covariance: &Matrix3<f64>) {
        if self.first.len() < FIRST {
            self.first.push((position, *covariance));
            return;
        }
        self.latest.push_back((position, *covariance));
        if self.latest.len() > LATEST {
            self.latest.pop_front();
        }
    }

    /// The covariance of the move, m²; zero if there is none.
    pub(crate) fn covariance(&mut self) -> Matrix3<f64> {
        if self.latest.len() < LATEST {
            return Matrix3::zeros();
        }
        let (now, own) = mean(self.latest.iter());
        let moved = now - mean(self.first.iter()).0;
        let chi2 = own.cholesky().map_or(0.0, |own| moved.dot(&own.solve(&moved)));
        if chi2 < MIN_CHI2 {
            return Matrix3::zeros();
        }
        self.seen = true;
        moved * moved.transpose()
    }
}

/// Means of position and covariance.
fn mean<'a>(all: impl ExactSizeIterator<Item = &'a (Vector3<f64>, Matrix3<f64>)>) -> (Vector3<f64>, Matrix3<f64>) {
    let count = all.len() as f64;
    let sum = all.fold((Vector3::zeros(), Matrix3::zeros()), |sum, one| (sum.0 + one.0, sum.1 + one.1));
    (sum.0 / count, sum.1 / count)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::random::Random;

    const SD_M: f64 = 3e-5;

    /// The covariances that a base adds which is where this tells, by frame, and whether it is seen to move.
    fn follow(frames: usize, at: impl Fn(usize) -> Vector3<f64>) -> (Vec<Matrix3<f64>>, bool) {
        let (mut moved, mut random) = (Moved::default(), Random::new(5));
        let frame = |k: usize| {
            let error = Vector3::from_fn(|_, _| SD_M * random.normal());
            moved.add(Vector3::new(0.1, 0.2, 1.4) + at(k) + error, &Matrix3::from_diagonal_element(SD_M * SD_M));
            moved.covariance()
        };
        ((0..frames).map(frame).collect(), moved.is_seen())
    }

    #[test]
    fn rest_and_vibration_are_no_move() {
        let (rest, seen) = follow(2000, |_| Vector3::zeros());
        assert!(!seen && rest.iter().all(|covariance| covariance.trace() == 0.0));
        assert!(!follow(2000, |k| Vector3::x() * 5.0 * SD_M * (0.8 * k as f64).sin()).1);
    }

    #[test]
    fn knocks_and_creep_are_added_as_far_as_they_went() {
        let to = Vector3::new(1e-4, -2e-4, 0.0);
        let (knocked, seen) = follow(200, |k| if k < 100 { Vector3::zeros() } else { to });
        assert!(seen && knocked[99].trace() == 0.0);
        let (crept, seen) = follow(600, |k| to * (k as f64 / 600.0));
        assert!(seen);
        for last in [knocked[199], crept[599]] {
            assert!((last - to * to.transpose()).norm() < 0.3 * to.norm_squared(), "{last}");
        }
    }

    #[test]
    fn it_begins_anew_when_positions_change_by_themselves() {
        let (mut moved, one) = (Moved::default(), Matrix3::from_diagonal_element(SD_M * SD_M));
        (0..FIRST).for_each(|_| moved.add(Vector3::zeros(), &one));
        moved.forget();
        (0..FIRST + LATEST).for_each(|_| moved.add(Vector3::x() * 1e-3, &one));
        assert!(moved.covariance().trace() == 0.0 && !moved.is_seen());
    }
}
