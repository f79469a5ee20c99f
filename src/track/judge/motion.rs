//! Rejects implausible motion: a position that the earlier motion does not allow becomes a miss.
//!
//! In: an estimate, and which bands were fitted together. Each position, and the coil's direction, is predicted from
//! the last two accepted (position and velocity). A deviation that both σ, errors of the stamps and accelerations
//! cannot explain is refused, together with all bands of the same fit. The largest acceleration is learned from the
//! recording itself: a multiple of the typical second difference of all measurements, refused or not, but never less
//! than a catheter can reach from rest.
//!
//! A real position recurs: when [`MIN_AGREEING`] measurements in a row are consistent, the motion continues from them.
//! After [`MEMORY_S`] without a measurement, or when time goes backwards, anything is possible again.
//!
//! Cannot detect: errors that move a band by less than that (5.6 mm from rest at 60 Hz, more at lower rates and after
//! gaps); a wrong position that persists; jumps where more than one measurement in ten is wrong; anything in the first
//! frames.

use crate::estimate::{Estimate, MarkerEstimate, Miss, Position};
use crate::source::Timestamp;
use nalgebra::Vector3;
use std::collections::VecDeque;

/// Motion before this is forgotten.
const MEMORY_S: f64 = 0.25;
/// Acceleration of bands that is always possible, m/s², and of the unit direction, rad/s²: twice that of the fastest
/// recordings.
const ALWAYS_POSSIBLE: (f64, f64) = (20.0, 300.0);
/// Two thirds of the accelerations are below the usual one, and up to this multiple of it is possible. The peak is 1.2
/// times the usual one in a steady swing, and 4 times in intermittent swings.
const MAX_TIMES_USUAL: f64 = 8.0;
/// Number of recent second differences that define the usual one, and the fewest needed.
const HISTORY_LENGTH: usize = 61;
const MIN_HISTORY: usize = 8;
/// Largest error of the stamps.
const STAMP_ERROR_S: f64 = 0.015;
/// Standard deviations attributable to chance.
const CHANCE_SD: f64 = 6.0;
/// Correct predictions in a row needed among refused measurements.
const MIN_AGREEING: u32 = 2;

/// Motion of a rig's bands and of its coil's direction.
#[derive(Debug)]
pub(in crate::track) struct Motion {
    markers: Vec<QuantityMotion>,
    tangent: QuantityMotion,
    coil: usize,
}

impl Motion {
    /// For this many markers, of which `coil` has the direction.
    pub(in crate::track) fn new(markers: usize, coil: usize) -> Self {
        Self {
            markers: vec![QuantityMotion::new(ALWAYS_POSSIBLE.0); markers],
            tangent: QuantityMotion::new(ALWAYS_POSSIBLE.1),
            coil,
        }
    }

    /// Turns implausible measurements of an estimate into misses; `together` are the markers that were fitted together.
    pub(in crate::track) fn check<'a>(
        &mut self,
        estimate: &mut Estimate,
        together: impl Iterator<Item = &'a [(usize, f64)]>,
    ) {
        let stamp = estimate.stamp;
        let mut times: Vec<Option<f64>> = Vec::with_capacity(self.markers.len());
        for (course, marker) in self.markers.iter_mut().zip(&estimate.markers) {
            let place = marker.position.as_ref().ok();
            times.push(place.and_then(|position| course.judge(Place::of(position, stamp))));
        }
        let direction = estimate.tangent.as_ref().ok();
        let turned = direction.and_then(|t| self.tangent.judge(Place::new(t.direction, t.covariance.trace(), stamp)));
        for group in together {
            let has_coil = group.iter().any(|(m, _)| *m == self.coil);
            let members = group.iter().filter_map(|(m, _)| times.get(*m).copied().flatten());
            let worst = members.chain(turned.filter(|_| has_coil)).reduce(f64::max);
            let Some(times) = worst else { continue };
            let miss = Miss::ImplausibleMotion { times };
            for (m, _) in group {
                if let Some(marker) = estimate.markers.get_mut(*m).filter(|marker| marker.position.is_ok()) {
                    *marker = MarkerEstimate::missed(&miss, marker.views.len());
                }
            }
            if has_coil && estimate.tangent.is_ok() {
                (estimate.tangent, estimate.deflection) = (Err(miss.clone()), Err(miss));
            }
        }
    }
}

/// A position, in its own unit.
#[derive(Debug, Clone, Copy)]
pub(in crate::track) struct Place {
    pub at: Vector3<f64>,
    /// Sum over all coordinates.
    pub variance: f64,
    stamp: Timestamp,
}

impl Place {
    fn new(at: Vector3<f64>, variance: f64, stamp: Timestamp) -> Self {
        Self { at, variance, stamp }
    }

    /// That of a band, m.
    pub(in crate::track) fn of(position: &Position, stamp: Timestamp) -> Self {
        Self::new(position.point.coords, position.covariance.trace(), stamp)
    }

    /// Whether it is further from another than so many standard deviations of their difference.
    pub(in crate::track) fn is_off(&self, other: &Self, sd: f64) -> bool {
        (self.at - other.at).norm_squared() > sd.powi(2) * (self.variance + other.variance)
    }

    pub(in crate::track) fn seconds_since(&self, before: &Self) -> f64 {
        self.stamp.seconds_since(before.stamp)
    }
}

/// The last positions, latest first: two for the prediction, and one more for the speed.
#[derive(Debug, Clone, Copy, Default)]
struct Last([Option<Place>; 3]);

/// A position compared with its prediction.
struct Deviation {
    off: f64,
    /// Deviation that σ and stamps explain.
    explained: f64,
    /// Distance per unit of acceleration.
    per_acceleration: f64,
}

impl Last {
    fn push(&mut self, place: Place) {
        self.0 = [Some(place), self.0[0], self.0[1]];
    }

    /// `None` when nothing can be predicted.
    fn beside(&self, place: &Place) -> Option<Deviation> {
        let [last, before, earlier] = self.0;
        let (last, before) = (last?, before?);
        let (ahead_s, step_s) = (place.seconds_since(&last), last.seconds_since(&before));
        if !(ahead_s > 0.0 && ahead_s < MEMORY_S && step_s > 0.0 && step_s < MEMORY_S) {
            return None;
        }
        let ratio = ahead_s / step_s;
        let velocity = (last.at - before.at) / step_s;
        // A repeated picture shows no motion.
        let earlier = earlier.map_or(0.0, |earlier| (before.at - earlier.at).norm() / before.seconds_since(&earlier));
        let speed = if earlier.is_finite() { velocity.norm().max(earlier) } else { velocity.norm() };
        let variance = place.variance + (1.0 + ratio).powi(2) * last.variance + ratio.powi(2) * before.variance;
        Some(Deviation {
            off: (last.at + velocity * ahead_s - place.at).norm(),
            explained: CHANCE_SD * variance.sqrt() + STAMP_ERROR_S * speed,
            per_acceleration: ahead_s * (ahead_s + step_s) / 2.0,
        })
    }
}

/// The motion of one quantity.
#[derive(Debug, Clone)]
struct QuantityMotion {
    always_possible: f64,
    accepted: Last,
    /// All measured positions.
    measured: Last,
    accelerations: VecDeque<f64>,
    /// Correct predictions in a row from what was measured.
    agree: u32,
}

impl QuantityMotion {
    fn new(always_possible: f64) -> Self {
        let (accepted, measured) = (Last::default(), Last::default());
        Self { always_possible, accepted, measured, accelerations: VecDeque::new(), agree: 0 }
    }

    /// `None` if plausible; else its deviation as a multiple of what is possible.
    fn judge(&mut self, place: Place) -> Option<f64> {
        let possible = self.possible();
        let times = |beside: &Deviation| beside.off / (beside.explained + possible * beside.per_acceleration);
        match self.measured.beside(&place) {
            Some(beside) => {
                self.agree = if times(&beside) <= 1.0 { self.agree + 1 } else { 0 };
                if self.accelerations.len() == HISTORY_LENGTH {
                    self.accelerations.pop_front();
                }
                self.accelerations.push_back(beside.off / beside.per_acceleration);
            }
            None => self.agree = 0,
        }
        self.measured.push(place);
        let refused = self.accepted.beside(&place).map(|beside| times(&beside)).filter(|times| *times > 1.0);
        if refused.is_some() && self.agree >= MIN_AGREEING {
            self.accepted = self.measured;
            return None;
        }
        if refused.is_none() {
            self.accepted.push(place);
        }
        refused
    }

    /// The largest plausible acceleration.
    fn possible(&self) -> f64 {
        if self.accelerations.len() < MIN_HISTORY {
            return f64::INFINITY;
        }
        let mut sorted: Vec<f64> = self.accelerations.iter().copied().collect();
        let index = sorted.len() * 2 / 3;
        let (_, usual, _) = sorted.select_nth_unstable_by(index, f64::total_cmp);
        (MAX_TIMES_USUAL * *usual).max(self.always_possible)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::random::Random;

    const SD_M: f64 = 5e-5;
    const NONE: [usize; 0] = [];

    fn stamp(t_s: f64) -> Timestamp {
        Timestamp { ns: (t_s * 1e9) as i64, clock: crate::source::Clock::Container }
    }

    /// Indices of the refused among positions at given times, with noise.
    fn refused(places: impl IntoIterator<Item = (f64, Vector3<f64>)>) -> Vec<usize> {
        let mut random = Random::new(4);
        let mut course = QuantityMotion::new(ALWAYS_POSSIBLE.0);
        let judged = places.into_iter().map(|(t_s, at)| {
            let at = at + Vector3::from_fn(|_, _| SD_M * random.normal());
            course.judge(Place::new(at, 3.0 * SD_M * SD_M, stamp(t_s))).is_some()
        });
        judged.enumerate().filter(|(_, refused)| *refused).map(|(k, _)| k).collect()
    }

    fn frames(count: usize) -> impl Iterator<Item = f64> {
        (0..count).map(|k| k as f64 / 60.0)
    }

    /// A swing of this amplitude and frequency.
    fn swing(amplitude_m: f64, hz: f64) -> impl Fn(f64) -> Vector3<f64> {
        move |t_s| Vector3::new(0.0, 0.0, 1.3 + amplitude_m * (std::f64::consts::TAU * hz * t_s).sin())
    }

    #[test]
    fn motions_of_catheters_are_plausible_from_their_first_frame_on() {
        // The last is a vibration of 17 g, which no earlier frame foretells.
        for (amplitude_m, hz) in [(0.0, 0.0), (0.04, 0.3), (0.04, 3.0), (0.01, 8.0), (0.02, 15.0)] {
            let at = swing(amplitude_m, hz);
            assert_eq!(refused(frames(600).map(|t| (t, at(t)))), NONE, "{amplitude_m} m, {hz} Hz");
            let lossy = frames(600).enumerate().filter(|(k, _)| k * 7919 % 10 > 2).map(|(_, t)| (t, at(t)));
            assert_eq!(refused(lossy), NONE, "{amplitude_m} m, {hz} Hz, frames lost");
        }
        // A start after a long rest: a step of the current, critically damped, 40 mm at 3 Hz.
        let rate = std::f64::consts::TAU * 3.0;
        let step = |t: f64| 0.04 * (1.0 - (1.0 + rate * t) * (-rate * t).exp());
        let from_rest = frames(600).map(|t| (t, Vector3::new(step((t - 5.0).max(0.0)), 0.0, 1.3)));
        assert_eq!(refused(from_rest), NONE);
    }

    /// The true motions of the sample recordings, complete and with lost frames, starting at any frame.
    #[test]
    fn no_motion_of_the_samples_is_refused() {
        for name in ["planar", "circle", "rest"] {
            let path = format!("{}/sample_frames/truth/{name}.csv", env!("CARGO_MANIFEST_DIR"));
            let mut table = csv::Reader::from_path(path).unwrap();
            let rows: Vec<std::collections::HashMap<String, f64>> = table.deserialize().map(Result::unwrap).collect();
            for (what, unit, always, sd) in [
                ("base", 1e-3, 20.0, 5e-5),
                ("coil", 1e-3, 20.0, 5e-5),
                ("tip", 1e-3, 20.0, 1e-4),
                ("tan", 1.0, 300.0, 4e-3),
            ] {
                for (first, every, lost) in [(0, 1, 0), (37, 1, 0), (11, 2, 0), (5, 1, 3), (20, 3, 2), (50, 4, 0)] {
                    let mut random = Random::new(first as u64);
                    let mut course = QuantityMotion::new(always);
                    for (k, row) in rows.iter().enumerate().skip(first).step_by(every) {
                        if lost > 0 && k * 7919 % 10 < lost {
                            continue;
                        }
                        let at =
                            ["x", "y", "z"].map(|axis| unit * row[&format!("{what}_{axis}")] + sd * random.normal());
                        let place = Place::new(at.into(), 3.0 * sd * sd, stamp(row["t_s"]));
                        let times = course.judge(place);
                        assert_eq!(times, None, "{name}, {what}, frame {k}, every {every}. from {first} on");
                    }
                }
            }
        }
    }

    #[test]
    fn stamps_of_arrival_and_pictures_shown_twice_are_plausible() {
        let mut random = Random::new(9);
        let at = swing(0.03, 1.2);
        let arriving: Vec<_> = frames(600).map(|t| (t + 0.006 * random.uniform(), at(t))).collect();
        assert_eq!(refused(arriving), NONE);
        let twice = frames(600).enumerate().map(|(k, t)| (t, at(if k % 50 == 0 { t - 1.0 / 60.0 } else { t })));
        assert_eq!(refused(twice), NONE);
    }

    #[test]
    fn a_jump_is_refused_and_what_follows_is_not() {
        for hz in [0.0, 1.5] {
            let at = swing(0.03, hz);
            let off = |k: usize| if [200, 300, 301, 400].contains(&k) { 0.03 } else { 0.0 };
            let jumping = frames(600).enumerate().map(|(k, t)| (t, at(t) + Vector3::x() * off(k)));
            assert_eq!(refused(jumping), [200, 300, 301, 400], "{hz} Hz");
        }
    }

    #[test]
    fn a_place_that_stays_is_accepted_soon_and_one_after_a_gap_at_once() {
        let moved = frames(200).map(|t| (t, Vector3::new(if t < 1.0 { 0.0 } else { 0.05 }, 0.0, 1.3)));
        assert_eq!(refused(moved), [60, 61]);
        let away = |t: f64| if t < 1.0 { (t, Vector3::zeros()) } else { (t + 0.4, Vector3::x() * 0.05) };
        assert_eq!(refused(frames(200).map(away)), NONE);
        let set_back = |t: f64| if t < 1.0 { (t, Vector3::zeros()) } else { (t - 5.0, Vector3::x() * 0.05) };
        assert_eq!(refused(frames(200).map(set_back)), NONE);
    }

    #[test]
    fn what_was_fitted_together_is_refused_together() {
        use crate::testing::fixture;
        let mut motion = Motion::new(3, 1);
        let groups: [&[(usize, f64)]; 2] = [&[(0, 0.0)], &[(1, 0.0), (2, 0.02)]];
        let mut step = |seq: u64, off_m: f64| {
            let mut estimate = fixture::complete(0, seq as i64 * 16_666_667);
            if let Ok(position) = &mut estimate.markers[2].position {
                position.point.x += off_m;
            }
            motion.check(&mut estimate, groups.into_iter());
            estimate
        };
        for seq in 0..20 {
            let estimate = step(seq, 0.0);
            assert!(estimate.markers.iter().all(|m| m.position.is_ok()) && estimate.deflection.is_ok(), "{seq}");
        }
        let estimate = step(20, 0.05);
        let is_refused = |miss: &Miss| matches!(miss, Miss::ImplausibleMotion { times } if *times > 2.0);
        assert!(estimate.markers[0].position.is_ok());
        assert!(estimate.markers[1..].iter().all(|m| m.position.as_ref().is_err_and(is_refused)));
        assert!(estimate.tangent.is_err_and(|miss| is_refused(&miss)));
        assert!(estimate.deflection.is_err_and(|miss| is_refused(&miss)));
    }
}
