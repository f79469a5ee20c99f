//! Notices pictures in the wrong order: two neighbours that were exchanged, by a converter or by their file names.
//!
//! Method. A band that moves evenly goes ahead, back, and ahead again where two pictures are exchanged. Of ten pictures
//! in a row the second differences are compared with those of the same with the middle two exchanged: if these are far
//! smaller, and noise is not the reason, the order is wrong. A vibration is no such case: of no frequency, on top of an
//! even motion, does an exchange lower the sum of their squares to less than a sixth.
//!
//! Cannot detect: exchanges in which nothing moves, of pictures that are not neighbours, of all pictures by twos, and
//! less than ten pictures from another exchange, or five from a lost one or a band that was not seen; and any where the
//! stamps are uneven.

use crate::estimate::Estimate;
use crate::track::judge::Place;
use std::collections::VecDeque;

/// Pictures that are compared.
const COUNT: usize = 10;
/// Sum of the squared second differences after the exchange over that before: less than half of what vibrations reach.
const MOST_LEFT: f64 = 1.0 / 14.0;
/// The sum before the exchange over that of noise.
const CLEAR: f64 = 25.0;
/// Second differences need even steps: the longest over the shortest.
const EVEN: f64 = 1.5;

/// The last places of the markers.
#[derive(Debug, Default)]
pub(in crate::track) struct Order {
    markers: Vec<VecDeque<Place>>,
    wrong: bool,
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
            places.push_back(Place::of(position, estimate.stamp));
            if places.len() > COUNT {
                places.pop_front();
            }
            self.wrong |= <&[Place; COUNT]>::try_from(&*places.make_contiguous()).is_ok_and(is_exchanged);
        }
    }

    /// Whether pictures came in the wrong order.
    pub(in crate::track) fn is_wrong(&self) -> bool {
        self.wrong
    }
}

/// Whether the middle two of these were exchanged.
fn is_exchanged(places: &[Place; COUNT]) -> bool {
    let steps = places.windows(2).map(|pair| pair[1].seconds_since(&pair[0]));
    let (least, most) = steps.fold((f64::INFINITY, 0.0_f64), |(least, most), step| (least.min(step), most.max(step)));
    if !(least > 0.0 && most < EVEN * least) {
        return false;
    }
    let roughness = |places: &[Place; COUNT]| -> f64 {
        places.windows(3).map(|three| (three[0].at - three[1].at * 2.0 + three[2].at).norm_squared()).sum()
    };
    let mut exchanged = *places;
    exchanged.swap(COUNT / 2 - 1, COUNT / 2);
    // A second difference has six times the variance of a place.
    let noise = 6.0 * places[1..COUNT - 1].iter().map(|place| place.variance).sum::<f64>();
    let now = roughness(places);
    now > CLEAR * noise && roughness(&exchanged) < MOST_LEFT * now
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::fixture;
    use crate::testing::random::Random;
    use nalgebra::{Matrix3, Point3, Vector3};
    use std::f64::consts::TAU;

    const SD_M: f64 = 5e-5;

    /// Whether the order is found wrong when the coil is at these places.
    fn is_wrong(places: impl IntoIterator<Item = Vector3<f64>>) -> bool {
        let (mut order, mut random) = (Order::default(), Random::new(6));
        for (k, place) in (0..).zip(places) {
            let mut estimate = fixture::complete(k, k as i64 * 16_666_667);
            let position = estimate.markers[1].position.as_mut().unwrap();
            position.point = Point3::from(place) + Vector3::from_fn(|_, _| SD_M * random.normal());
            position.covariance = Matrix3::from_diagonal_element(SD_M * SD_M);
            order.add(&estimate);
        }
        order.is_wrong()
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
        assert!(!is_wrong((0..200).map(|k| swing(if k == 100 { 99 } else { k }))), "shown twice");
    }
}
