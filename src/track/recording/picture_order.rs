//! Notices pictures in the wrong order: one that comes up to three places too early or too late, by a converter or by
//! the files' names; and single pictures of another time, as an old one that a buffer gives once more.
//!
//! Method. A band that moves evenly goes ahead, back, and ahead again where a picture is in the wrong place. Of ten
//! pictures in a row the second differences are compared with those of the same with one of the middle ones in another
//! place, or where its neighbours say it should be: if these are far smaller, and noise is not the reason, the order is
//! wrong. A vibration is no such case: of no frequency, on top of an even motion, does another order lower the sum of
//! their squares to less than a sixth.
//!
//! Cannot detect: pictures out of place while nothing moves, all pictures by twos, and less than ten pictures from
//! another such place, or five from a lost one or a band that was not seen; and any where the stamps are uneven. A true
//! twitch that lasts for one frame looks like a picture of another time.

use crate::estimate::Estimate;
use crate::track::judge::Place;
use std::collections::VecDeque;

/// Pictures that are compared.
const COUNT: usize = 10;
/// Which of them is tried in another place: from where, to where.
const MISPLACED: [(usize, usize); 5] = [(4, 5), (3, 5), (5, 3), (3, 6), (6, 3)];
/// The one that may be of another time.
const MIDDLE: usize = COUNT / 2;
/// Sum of the squared second differences with another order over that before: less than half of what vibrations reach.
const MOST_LEFT: f64 = 1.0 / 14.0;
/// The sum as they came over that of noise.
const CLEAR: f64 = 25.0;
/// Second differences need even steps: the longest over the shortest.
const EVEN: f64 = 1.5;

/// The last places of the markers, with the numbers of their frames.
#[derive(Debug, Default)]
pub(in crate::track) struct Order {
    markers: Vec<VecDeque<(u64, Place)>>,
    wrong: bool,
    foreign: Option<u64>,
}

/// What is wrong with the order of pictures.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Wrong {
    /// One is in the wrong place.
    Misplaced,
    /// The middle one is of another time.
    Foreign,
}

impl Order {
    /// Adds an estimate before any of its positions is refused as implausible.
    pub(in crate::track) fn add(&mut self, estimate: &Estimate) {
        self.markers.resize_with(estimate.markers.len(), VecDeque::new);
        for (places, marker) in self.markers.iter_mut().zip(&estimate.markers) {
            let Ok(position) = &marker.position else {
                places.clear();
                continue;
            };
            places.push_back((estimate.seq, Place::of(position, estimate.stamp)));
            if places.len() > COUNT {
                places.pop_front();
            }
            let Ok(places) = <&[(u64, Place); COUNT]>::try_from(&*places.make_contiguous()) else { continue };
            match wrong(&places.map(|(_, place)| place)) {
                Some(Wrong::Misplaced) => self.wrong = true,
                Some(Wrong::Foreign) => self.foreign = self.foreign.or(Some(places[MIDDLE].0)),
                None => {}
            }
        }
    }

    /// Whether pictures came in the wrong order.
    pub(in crate::track) fn is_wrong(&self) -> bool {
        self.wrong
    }

    /// Frame of the first picture of another time, if there was one.
    pub(in crate::track) fn foreign(&self) -> Option<u64> {
        self.foreign
    }
}

/// What is wrong with these.
fn wrong(places: &[Place; COUNT]) -> Option<Wrong> {
    let steps = places.windows(2).map(|pair| pair[1].seconds_since(&pair[0]));
    let (least, most) = steps.fold((f64::INFINITY, 0.0_f64), |(least, most), step| (least.min(step), most.max(step)));
    if !(least > 0.0 && most < EVEN * least) {
        return None;
    }
    let roughness = |places: &[Place; COUNT]| -> f64 {
        places.windows(3).map(|three| (three[0].at - three[1].at * 2.0 + three[2].at).norm_squared()).sum()
    };
    // A second difference has six times the variance of a place.
    let noise = 6.0 * places[1..COUNT - 1].iter().map(|place| place.variance).sum::<f64>();
    let now = roughness(places);
    if now <= CLEAR * noise {
        return None;
    }
    let moved = MISPLACED.into_iter().map(|(from, to)| {
        let mut moved = *places;
        if from < to {
            moved[from..=to].rotate_left(1);
        } else {
            moved[to..=from].rotate_right(1);
        }
        (roughness(&moved), Wrong::Misplaced)
    });
    let mut replaced = *places;
    let beside = |by: usize| places[MIDDLE - by].at + places[MIDDLE + by].at;
    // The cubic polynomial through two on each side.
    replaced[MIDDLE].at = (beside(1) * 4.0 - beside(2)) / 6.0;
    let all = moved.chain([(roughness(&replaced), Wrong::Foreign)]);
    let (least, wrong) = all.min_by(|a, b| a.0.total_cmp(&b.0))?;
    (least < MOST_LEFT * now).then_some(wrong)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::fixture;
    use crate::testing::random::Random;
    use nalgebra::{Matrix3, Point3, Vector3};
    use std::f64::consts::TAU;

    const SD_M: f64 = 5e-5;

    /// Whether the order is found wrong when the coil is at these places, or a picture of another time.
    fn is_wrong(places: impl IntoIterator<Item = Vector3<f64>>) -> bool {
        let order = looked_at(places);
        order.is_wrong() || order.foreign.is_some()
    }

    fn looked_at(places: impl IntoIterator<Item = Vector3<f64>>) -> Order {
        let (mut order, mut random) = (Order::default(), Random::new(6));
        for (k, place) in (0..).zip(places) {
            let mut estimate = fixture::complete(k, k as i64 * 16_666_667);
            let position = estimate.markers[1].position.as_mut().unwrap();
            position.point = Point3::from(place) + Vector3::from_fn(|_, _| SD_M * random.normal());
            position.covariance = Matrix3::from_diagonal_element(SD_M * SD_M);
            order.add(&estimate);
        }
        order
    }

    /// A swing of 30 mm and 1 Hz, as the sample's.
    fn swing(k: usize) -> Vector3<f64> {
        Vector3::new(0.03 * (TAU * k as f64 / 60.0).sin(), 0.0, 0.01 * (TAU * k as f64 / 60.0).cos())
    }

    #[test]
    fn two_exchanged_pictures_are_noticed_wherever_the_coil_moves() {
        assert!(!is_wrong((0..600).map(swing)));
        let mut noticed = 0;
        for at in 100..160 {
            let exchanged = |k: usize| {
                swing(if k == at {
                    at + 1
                } else if k == at + 1 {
                    at
                } else {
                    k
                })
            };
            noticed += usize::from(is_wrong((0..200).map(exchanged)));
        }
        assert!(noticed > 50, "{noticed} of 60");
    }

    #[test]
    fn a_picture_that_comes_too_early_or_too_late_is_noticed() {
        for (from, to) in [(3, 0), (0, 3), (2, 0), (0, 2)] {
            let mut noticed = 0;
            for at in 100..160 {
                let mut order: Vec<usize> = (0..200).collect();
                let late = order.remove(at + from);
                order.insert(at + to, late);
                noticed += usize::from(looked_at(order.into_iter().map(swing)).is_wrong());
            }
            assert!(noticed > 50, "from {from} to {to}: {noticed} of 60");
        }
    }

    #[test]
    fn an_old_picture_is_named() {
        let mut named = 0;
        for at in 100..160 {
            let order = looked_at((0..200).map(|k| swing(if k == at { at - 40 } else { k })));
            // Where the swing was at the same place, it is right.
            let is_old = (swing(at) - swing(at - 40)).norm() > 0.01;
            named += usize::from(!is_old || order.foreign == Some(at as u64));
            assert!(order.foreign.is_none_or(|frame| frame == at as u64), "{:?} for {at}", order.foreign);
        }
        assert_eq!(named, 60);
    }

    #[test]
    fn no_vibration_looks_so() {
        for step in 0..=240 {
            let per_frame = TAU / 2.0 * f64::from(step) / 240.0;
            for trend in [-2.0, -0.8, -0.4, -0.2, 0.0, 0.2, 0.4, 0.8, 2.0] {
                let at = |k: usize| 1e-2 * ((per_frame * k as f64 + 0.3).sin() + trend * k as f64);
                assert!(!is_wrong((0..120).map(|k| Vector3::x() * at(k))), "{per_frame} rad, {trend}");
            }
        }
    }

    #[test]
    fn noise_steps_and_lost_pictures_do_not_look_so() {
        assert!(!is_wrong((0..2000).map(|_| Vector3::zeros())));
        assert!(!is_wrong((0..200).map(|k| Vector3::x() * if k < 100 { 0.0 } else { 0.02 })));
        assert!(!is_wrong((0..200).map(|k| swing(if k < 100 { k } else { k + 3 }))));
        let twice = looked_at((0..200).map(|k| swing(if k == 100 { 99 } else { k })));
        assert!(!twice.is_wrong(), "shown twice");
        assert!(twice.foreign.is_none_or(|frame| frame == 100), "{:?}", twice.foreign);
    }
}
