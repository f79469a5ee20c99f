//! Whether a band can have come from where it was: what the motion before does not allow is a miss and no measurement.
//!
//! In: an estimate, and which bands were fitted together. Each place, and the coil's direction, is predicted from the
//! last two that were accepted (position and velocity, over the time between). What is off by more than σ of both,
//! stamps, and accelerations can explain is refused, and with it what was fitted together with it. The greatest
//! acceleration is learned from the recording itself: so many times what is usual among the second differences of all
//! that was measured, refused or not; never less than a catheter can do that sets out from rest.
//!
//! A place that is real comes again: when [`AGREE`] measurements in a row fit to each other, they are taken for the
//! motion from there on. After [`MEMORY_S`] without a measurement, or when time goes backwards, anything is possible
//! again.
//!
//! Cannot detect: what moves a band by less than that (5.6 mm from rest at 60 Hz, more at lower rates and after gaps);
//! a wrong place that stays; jumps where more than one measurement in ten is wrong; anything in the first frames.

use crate::estimate::{Estimate, MarkerEstimate, Miss};
use crate::source::Timestamp;
use nalgebra::Vector3;
use std::collections::VecDeque;

/// Motion before this is forgotten.
const MEMORY_S: f64 = 0.25;
/// Acceleration of bands that is possible at any time, m/s², and of the unit direction, rad/s²: twice what the fastest
/// recordings have.
const ALWAYS_POSSIBLE: (f64, f64) = (20.0, 300.0);
/// Two of three accelerations are below the usual one, and so many times of it is possible. The largest of a swing is
/// 1.2 times the usual one, of swings that come and go 4 times.
const TIMES_USUAL: f64 = 8.0;
/// Second differences that say what is usual: the last of them, and how few are too few to judge by.
const REMEMBERED: usize = 61;
const ENOUGH: usize = 8;
/// By so much may stamps be off.
const STAMPS_S: f64 = 0.015;
/// Standard deviations that chance may explain.
const CHANCE: f64 = 6.0;
/// So many predictions in a row must come true among refused measurements.
const AGREE: u32 = 2;

/// All that is known of how a rig's bands and its coil's direction move.
#[derive(Debug)]
pub(crate) struct Motion {
    markers: Vec<Course>,
    tangent: Course,
    coil: usize,
}

impl Motion {
    /// For so many markers, of which `coil` has the direction.
    pub(crate) fn new(markers: usize, coil: usize) -> Self {
        Self { markers: vec![Course::new(ALWAYS_POSSIBLE.0); markers], tangent: Course::new(ALWAYS_POSSIBLE.1), coil }
    }

    /// Takes what is not plausible out of an estimate; `together` are the markers that were fitted together.
    pub(crate) fn check<'a>(&mut self, estimate: &mut Estimate, together: impl Iterator<Item = &'a [(usize, f64)]>) {
        let stamp = estimate.stamp;
        let mut times: Vec<Option<f64>> = Vec::with_capacity(self.markers.len());
        for (course, marker) in self.markers.iter_mut().zip(&estimate.markers) {
            let place = marker.position.as_ref().ok();
            times.push(place.and_then(|p| course.judge(Place::new(p.point.coords, p.covariance.trace(), stamp))));
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

/// Where something was, in its own unit.
#[derive(Debug, Clone, Copy)]
struct Place {
    at: Vector3<f64>,
    /// Of all coordinates together.
    variance: f64,
    ns: i64,
}

impl Place {
    fn new(at: Vector3<f64>, variance: f64, stamp: Timestamp) -> Self {
        Self { at, variance, ns: stamp.ns }
    }

    fn seconds_since(&self, before: &Self) -> f64 {
        self.ns.saturating_sub(before.ns) as f64 * 1e-9
    }
}

/// The last places of a motion, the latest first: two to predict from, and one more to know how fast it was.
#[derive(Debug, Clone, Copy, Default)]
struct Last([Option<Place>; 3]);

/// What a place is beside its prediction.
struct Beside {
    off: f64,
    /// What σ and stamps explain.
    explained: f64,
    /// Distance for each unit of acceleration.
    per_acceleration: f64,
}

impl Last {
    fn push(&mut self, place: Place) {
        self.0 = [Some(place), self.0[0], self.0[1]];
    }

    /// `None` when nothing can be predicted.
    fn beside(&self, place: &Place) -> Option<Beside> {
        let [last, before, earlier] = self.0;
        let (last, before) = (last?, before?);
        let (ahead_s, step_s) = (place.seconds_since(&last), last.seconds_since(&before));
        if !(ahead_s > 0.0 && ahead_s < MEMORY_S && step_s > 0.0 && step_s < MEMORY_S) {
            return None;
        }
        let ratio = ahead_s / step_s;
        let velocity = (last.at - before.at) / step_s;
        // A picture that was shown twice stood still.
        let earlier = earlier.map_or(0.0, |earlier| (before.at - earlier.at).norm() / before.seconds_since(&earlier));
        let speed = if earlier.is_finite() { velocity.norm().max(earlier) } else { velocity.norm() };
        let variance = place.variance + (1.0 + ratio).powi(2) * last.variance + ratio.powi(2) * before.variance;
        Some(Beside {
            off: (last.at + velocity * ahead_s - place.at).norm(),
            explained: CHANCE * variance.sqrt() + STAMPS_S * speed,
            per_acceleration: ahead_s * (ahead_s + step_s) / 2.0,
        })
    }
}

/// The course of one thing.
#[derive(Debug, Clone)]
struct Course {
    always_possible: f64,
    accepted: Last,
    /// Of all that was measured.
    measured: Last,
    accelerations: VecDeque<f64>,
    /// Predictions from what was measured that have come true in a row.
    agree: u32,
}

impl Course {
    fn new(always_possible: f64) -> Self {
        let (accepted, measured) = (Last::default(), Last::default());
        Self { always_possible, accepted, measured, accelerations: VecDeque::new(), agree: 0 }
    }

    /// `None` for what is plausible; else how many times what is possible it is off.
    fn judge(&mut self, place: Place) -> Option<f64> {
        let possible = self.possible();
        let times = |beside: &Beside| beside.off / (beside.explained + possible * beside.per_acceleration);
        match self.measured.beside(&place) {
            Some(beside) => {
                self.agree = if times(&beside) <= 1.0 { self.agree + 1 } else { 0 };
                if self.accelerations.len() == REMEMBERED {
                    self.accelerations.pop_front();
                }
                self.accelerations.push_back(beside.off / beside.per_acceleration);
            }
            None => self.agree = 0,
        }
        self.measured.push(place);
        let refused = self.accepted.beside(&place).map(|beside| times(&beside)).filter(|times| *times > 1.0);
        if refused.is_some() && self.agree >= AGREE {
            self.accepted = self.measured;
            return None;
        }
        if refused.is_none() {
            self.accepted.push(place);
        }
        refused
    }

    /// The greatest acceleration that is plausible.
    fn possible(&self) -> f64 {
        if self.accelerations.len() < ENOUGH {
            return f64::INFINITY;
        }
        let mut sorted: Vec<f64> = self.accelerations.iter().copied().collect();
        let index = sorted.len() * 2 / 3;
        let (_, usual, _) = sorted.select_nth_unstable_by(index, f64::total_cmp);
        (TIMES_USUAL * *usual).max(self.always_possible)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::random::Random;

    const SD_M: f64 = 5e-5;
    const NONE: [usize; 0] = [];

    /// Numbers of the refused among places at times, with noise.
    fn refused(places: impl IntoIterator<Item = (f64, Vector3<f64>)>) -> Vec<usize> {
        let mut random = Random::new(4);
        let mut course = Course::new(ALWAYS_POSSIBLE.0);
        let judged = places.into_iter().map(|(t_s, at)| {
            let at = at + Vector3::from_fn(|_, _| SD_M * random.normal());
            course.judge(Place { at, variance: 3.0 * SD_M * SD_M, ns: (t_s * 1e9) as i64 }).is_some()
        });
        judged.enumerate().filter(|(_, refused)| *refused).map(|(k, _)| k).collect()
    }

    fn frames(count: usize) -> impl Iterator<Item = f64> {
        (0..count).map(|k| k as f64 / 60.0)
    }

    /// So far out and back, so many times a second.
    fn swing(amplitude_m: f64, hz: f64) -> impl Fn(f64) -> Vector3<f64> {
        move |t_s| Vector3::new(0.0, 0.0, 1.3 + amplitude_m * (std::f64::consts::TAU * hz * t_s).sin())
    }

    #[test]
    fn motions_of_catheters_are_plausible_from_their_first_frame_on() {
        // The last is a vibration of 17 g, which no frame before tells of.
        for (amplitude_m, hz) in [(0.0, 0.0), (0.04, 0.3), (0.04, 3.0), (0.01, 8.0), (0.02, 15.0)] {
            let at = swing(amplitude_m, hz);
            assert_eq!(refused(frames(600).map(|t| (t, at(t)))), NONE, "{amplitude_m} m, {hz} Hz");
            let lossy = frames(600).enumerate().filter(|(k, _)| k * 7919 % 10 > 2).map(|(_, t)| (t, at(t)));
            assert_eq!(refused(lossy), NONE, "{amplitude_m} m, {hz} Hz, frames lost");
        }
        // It sets out from a long rest: a step of the current, critically damped, 40 mm at 3 Hz.
        let rate = std::f64::consts::TAU * 3.0;
        let step = |t: f64| 0.04 * (1.0 - (1.0 + rate * t) * (-rate * t).exp());
        let from_rest = frames(600).map(|t| (t, Vector3::new(step((t - 5.0).max(0.0)), 0.0, 1.3)));
        assert_eq!(refused(from_rest), NONE);
    }

    /// The true motions of the sample recordings, whole and with frames lost, from any frame on.
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
                    let mut course = Course::new(always);
                    for (k, row) in rows.iter().enumerate().skip(first).step_by(every) {
                        if lost > 0 && k * 7919 % 10 < lost {
                            continue;
                        }
                        let at =
                            ["x", "y", "z"].map(|axis| unit * row[&format!("{what}_{axis}")] + sd * random.normal());
                        let place = Place { at: at.into(), variance: 3.0 * sd * sd, ns: (row["t_s"] * 1e9) as i64 };
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
