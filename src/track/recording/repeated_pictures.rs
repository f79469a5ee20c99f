//! Notices a picture that repeats the one before it while the bands move: a camera or recorder that stalls, or a rate
//! that was raised by showing pictures twice. It shows the bands where they were, and nothing else tells.
//!
//! No two pictures of a camera have the same noise, so a repeated one is equal to the last bit where the bands are. But
//! a coder that predicts pictures from earlier ones also repeats what is at rest. Equal pictures therefore count as
//! repeated only if a band moved between the two different pictures before, or if the noise is known to be new in every
//! picture: a band that always rests, beside the clamp, looked otherwise in each of the last [`FRESH`] pictures. (A
//! swing hardly moves where it turns.) With a coder that predicts they count only for [`AT_REST_S`]: after that the
//! catheter has come to rest.
//!
//! A repeated picture that was coded again, or has noise of its own, is told by its positions: bands that moved, and
//! were not slowing down to a stop, are exactly where they were. A swing that turns slows down first. This too ends
//! after [`AT_REST_S`], as a catheter can be stopped by a wall.
//!
//! Repeated pictures that were coded again while the bands were about to turn show only when they end: bands that moved
//! have stood still, and then jump further than any motion. Their rows are wrong by then, which is told
//! ([`Repeats::stalled`]).
//!
//! Cannot detect: repeated pictures that were coded again while the bands were hardly moving, a stall that begins at
//! rest, and what repeats the first two pictures of a run.

use crate::estimate::{Estimate, Miss, Position};
use crate::source::{Picture, Plane, Timestamp, Window};
use crate::track::judge::Place;
use nalgebra::Vector3;

/// Equal pictures by a coder that predicts, and positions that stay, show after this time that the catheter rests,
/// seconds.
const AT_REST_S: f64 = 0.25;
/// Pictures in a row in which a band at rest looked otherwise, after which none looks the same by chance.
const FRESH: u32 = 12;
/// Standard deviations of the difference of two positions beyond which a band has moved.
const MOVED_SD: f64 = 4.0;
/// A band that moved steadily stands still if it moves by less than this part of what it would have, and may do so with
/// another band if by less than the second: its motion blur is taken for that of a band at rest.
const STILL: f64 = 0.1;
const HARDLY: f64 = 0.25;
/// It moved steadily if, with its present acceleration too, it would move by at least this part of that: by the stamps,
/// and if all its steps took the same time, as stamps of arrival are uncertain.
const STEADY: (f64, f64) = (0.5, 0.35);
/// Its last step was foretold by those before it to this part of it: a motion that is seen in few pictures, as a swing
/// in eight or fewer, may turn between any two of them.
const FORETOLD: f64 = 0.45;

/// Pictures in a row in which the bands stand, before a jump.
const FEWEST_STANDING: u64 = 2;

/// The last picture that was measured.
#[derive(Debug, Default)]
pub(in crate::track) struct Repeats {
    last: Option<Shown>,
    /// Pictures in a row in which the band at rest was not as in the one before, to the last bit.
    fresh: u32,
    bands: Vec<Band>,
    /// Whether the bands have stood still since then.
    standing: bool,
    standstill: Standstill,
    /// Numbers of the first and the last picture of the first stall that was noticed when it ended.
    stalled: Option<(u64, u64)>,
}

/// Bands that stand where they have moved to.
#[derive(Debug, Default)]
struct Standstill {
    /// Where, and in which picture first and last.
    places: Vec<Option<Place>>,
    seqs: (u64, u64),
    /// Of the last picture.
    stamp: Option<Timestamp>,
    /// Pictures after the first.
    count: u64,
    /// Whether they moved to there, from one picture to the next.
    moved: bool,
    /// Whether a jump followed: the next measurement tells if they have left.
    jumped: bool,
}

#[derive(Debug)]
struct Shown {
    stamp: Timestamp,
    /// Where its bands were found, and what it shows there.
    windows: Vec<Window>,
    checksum: u32,
    /// The same of a band that always rests: how many of the windows, from the first, and what they show.
    at_rest: Option<(usize, u32)>,
    /// Whether one of them had moved.
    moving: bool,
}

/// The last place of a band, and three more before it from which it had moved away, latest first.
#[derive(Debug, Clone, Default)]
struct Band([Option<Place>; 4]);

/// Three places, one after the other.
struct Steps {
    /// The latest step and the one before, metres, and how long they took.
    way: Vector3<f64>,
    before: Vector3<f64>,
    took_s: [f64; 2],
}

impl Steps {
    /// Latest first; `None` when one took no time, or too long.
    fn between(last: &Place, before: &Place, earlier: &Place) -> Option<Self> {
        let took_s = [last.seconds_since(before), before.seconds_since(earlier)];
        took_s.iter().all(|time_s| (1e-6..AT_REST_S).contains(time_s)).then(|| Self {
            way: last.at - before.at,
            before: before.at - earlier.at,
            took_s,
        })
    }

    /// The same if all steps took the same time.
    fn even(&self) -> Self {
        Self { took_s: [1.0; 2], ..*self }
    }

    /// The way within the next `ahead_s` at the latest velocity, and with the latest acceleration.
    fn ahead(&self, ahead_s: f64) -> [Vector3<f64>; 2] {
        let [step_s, earlier_s] = self.took_s;
        let velocity = self.way / step_s;
        let acceleration = (velocity - self.before / earlier_s) / ((step_s + earlier_s) / 2.0);
        let steady = velocity * ahead_s;
        [steady, steady + acceleration * (ahead_s * (ahead_s + step_s) / 2.0)]
    }
}

/// What a band that moved does.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Course {
    /// It is where it was, although nothing slowed it down.
    Stands,
    /// It moves on.
    Moves,
    /// It hardly moves, or did not before either.
    Rests,
}

impl Band {
    /// Remembers a place; whether the band has moved to it.
    fn has_moved(&mut self, place: Place) -> bool {
        let [last, before, earlier, _] = self.0;
        let is_off = |from: Option<Place>, place: &Place| from.is_some_and(|from| place.is_off(&from, MOVED_SD));
        match last {
            // Where it stood, or what was a repeated picture, counts once.
            Some(stood) if before.is_some() && !is_off(before, &stood) => self.0[0] = Some(place),
            _ => self.0 = [Some(place), last, before, earlier],
        }
        is_off(last, &place)
    }

    /// What it does if it is at this place now.
    fn course(&self, now: &Place) -> Course {
        let Some(last) = &self.0[0] else { return Course::Moves };
        let moved_m = (now.at - last.at).norm();
        match self.expected_m(now) {
            Some(way_m) if moved_m < STILL * way_m => Course::Stands,
            Some(way_m) if moved_m < HARDLY * way_m => Course::Rests,
            None if !now.is_off(last, MOVED_SD) => Course::Rests,
            _ => Course::Moves,
        }
    }

    /// How far it would have moved by now; `None` if it did not move before, or slowed down, or that is not known.
    fn expected_m(&self, now: &Place) -> Option<f64> {
        let [Some(last), Some(before), Some(earlier), Some(earliest)] = &self.0 else { return None };
        let steps = Steps::between(last, before, earlier)?;
        let steps_before = Steps::between(before, earlier, earliest)?;
        let ahead_s = now.seconds_since(last);
        if !(1e-6..AT_REST_S).contains(&ahead_s) {
            return None;
        }
        let is_steady =
            |[steady, predicted]: [Vector3<f64>; 2], least: f64| predicted.dot(&steady) > least * steady.norm_squared();
        let is_foretold =
            |[_, predicted]: [Vector3<f64>; 2]| (steps.way - predicted).norm() < FORETOLD * steps.way.norm();
        // No further than before: the stamps may lie close together by mistake.
        let [step_s, _] = steps.took_s;
        let expected_m = steps.way.norm() * (ahead_s / step_s).min(1.0);
        let moved = expected_m.powi(2) > MOVED_SD.powi(2) * (last.variance + before.variance);
        let steady = is_steady(steps.ahead(ahead_s), STEADY.0) && is_steady(steps.even().ahead(1.0), STEADY.1);
        let foretold = is_foretold(steps_before.ahead(step_s)) || is_foretold(steps_before.even().ahead(1.0));
        (moved && steady && foretold).then_some(expected_m)
    }
}

impl Repeats {
    /// Whether a picture, `predicted` from others or not, shows again what the last one showed, and cannot be of its
    /// own time.
    pub(in crate::track) fn is_repeated(&self, picture: &Picture, stamp: Timestamp, predicted: bool) -> bool {
        let is_known = |last: &&Shown| last.moving || self.noise_is_new();
        let Some(last) = self.last.as_ref().filter(is_known) else { return false };
        (!predicted || is_recent(stamp, last.stamp)) && self.shows_again(picture)
    }

    /// Whether noise was new in each of the last pictures, where a band always rests.
    pub(in crate::track) fn noise_is_new(&self) -> bool {
        self.fresh >= FRESH
    }

    /// Whether a picture is equal to the last one, to the last bit, wherever a band was.
    pub(in crate::track) fn shows_again(&self, picture: &Picture) -> bool {
        self.last.as_ref().is_some_and(|last| checksum(picture, &last.windows) == Some(last.checksum))
    }

    /// Whether the bands of a picture are where they were in the last one that was measured, although they moved: it
    /// repeats that one, coded again or with other noise. Asked of every picture, before it is remembered.
    pub(in crate::track) fn stands_still(&mut self, estimate: &Estimate) -> bool {
        let recent = self.last.as_ref().is_some_and(|last| is_recent(estimate.stamp, last.stamp));
        let courses = self.bands.iter().zip(places(estimate)).filter_map(|(band, place)| Some(band.course(&place?)));
        let courses: Vec<Course> = courses.collect();
        let stands = courses.contains(&Course::Stands) || self.standing && courses.contains(&Course::Rests);
        self.standing = recent && stands && !courses.contains(&Course::Moves);
        self.standing
    }

    /// Notices a stall that has ended, by bands that stood still, then jumped (implausible motion, which an estimate
    /// has as misses), and are elsewhere now.
    pub(in crate::track) fn notice_stall(&mut self, estimate: &Estimate) {
        let Standstill { places: stood, seqs, stamp, count, moved, jumped } = &mut self.standstill;
        let is_recent = stamp.is_some_and(|stamp| is_recent(estimate.stamp, stamp));
        let jumps = |miss: &Miss| matches!(miss, Miss::ImplausibleMotion { .. });
        if estimate.markers.iter().any(|marker| marker.position.as_ref().is_err_and(jumps)) {
            *jumped |= is_recent && *moved && *count >= FEWEST_STANDING;
            return;
        }
        let pairs = stood.iter().zip(places(estimate));
        let off =
            pairs.filter_map(|(from, now)| Some(now?.is_off(from.as_ref()?, MOVED_SD))).reduce(|any, off| any || off);
        // A band that is back where it stood was another object for a moment.
        if std::mem::take(jumped) && off == Some(true) {
            self.stalled = self.stalled.or(Some((seqs.0 + 1, seqs.1)));
        }
        if is_recent && off == Some(false) {
            (seqs.1, *count) = (estimate.seq, *count + 1);
        } else {
            // In one step: bands that creep seem to stand between pictures.
            let has_moved = is_recent && off == Some(true) && *count == 0;
            (*seqs, *count, *moved) = ((estimate.seq, estimate.seq), 0, has_moved);
            stood.clear();
            stood.extend(places(estimate));
        }
        *stamp = Some(estimate.stamp);
    }

    /// What to say of pictures that probably repeated another, if there were any.
    pub(in crate::track) fn stalled(&self) -> Option<String> {
        let (first, last) = self.stalled?;
        Some(format!("of frames {first} to {last} some probably repeat the one before, coded again"))
    }

    /// Remembers a picture that was measured, its bands in `windows`, the first of which (so many) are of a band that
    /// always rests.
    pub(in crate::track) fn remember(
        &mut self,
        picture: &Picture,
        windows: Vec<Window>,
        at_rest: usize,
        estimate: &Estimate,
    ) {
        let is_fresh = |last: &Shown| {
            let (count, shown) = last.at_rest?;
            Some(checksum(picture, last.windows.get(..count)?)? != shown)
        };
        let is_fresh = self.last.as_ref().and_then(is_fresh) == Some(true);
        self.fresh = if is_fresh { self.fresh.saturating_add(1) } else { 0 };
        self.bands.resize(estimate.markers.len(), Band::default());
        let mut moving = false;
        for (band, place) in self.bands.iter_mut().zip(places(estimate)) {
            if let Some(place) = place {
                moving |= band.has_moved(place);
            }
        }
        let shown_at_rest = windows.get(..at_rest).and_then(|windows| checksum(picture, windows));
        let at_rest = shown_at_rest.map(|shown| (at_rest, shown));
        self.last = checksum(picture, &windows).map(|checksum| Shown {
            stamp: estimate.stamp,
            windows,
            checksum,
            at_rest,
            moving,
        });
    }
}

/// Whether a catheter can hardly have come to rest since then. (A clock may be set back.)
pub(super) fn is_recent(now: Timestamp, then: Timestamp) -> bool {
    (0.0..AT_REST_S).contains(&now.seconds_since(then))
}

/// Where each band of an estimate is.
fn places(estimate: &Estimate) -> impl Iterator<Item = Option<Place>> {
    let place = |position: &Position| Place::of(position, estimate.stamp);
    estimate.markers.iter().map(move |marker| marker.position.as_ref().ok().map(place))
}

/// The bytes of each row of a plane in a window; `None` outside of the plane.
pub(super) fn rows<'a>(plane: &Plane<'a>, window: Window) -> impl ExactSizeIterator<Item = Option<&'a [u8]>> + use<'a> {
    let [across, down] = plane.scale;
    let [first, end] = [window.x0 / across, window.x1.div_ceil(across)].map(|column| column as usize * plane.step);
    let plane = *plane;
    (window.y0 / down..window.y1.div_ceil(down)).map(move |row| {
        let row = plane.row(row as usize)?;
        row.get(first..end.min(row.len()))
    })
}

/// Of the samples in some windows of a picture; `None` when there are none, or not all were recorded.
fn checksum(picture: &Picture, windows: &[Window]) -> Option<u32> {
    if windows.is_empty() {
        return None;
    }
    let mut sum = crc32fast::Hasher::new();
    for window in windows {
        picture.declare_read(*window).ok()?;
        for channel in 0..picture.format().channels() {
            let plane = picture.plane(channel)?;
            for row in rows(&plane, *window) {
                sum.update(row?);
            }
        }
    }
    Some(sum.finalize())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::source::{Clock, Colour, PixelFormat};
    use crate::testing::fixture;
    use crate::testing::random::Random;
    use nalgebra::{Matrix3, Point3};

    /// Of each coordinate.
    const SD_M: f64 = 5e-5;
    const WINDOW: Window = Window { x0: 11, y0: 9, x1: 21, y1: 19 };

    /// Noise in 4:2:0.
    fn noise(seed: u64) -> Picture {
        let mut random = Random::new(seed);
        let mut plane = |samples: usize| (0..samples).map(|_| (random.uniform() * 255.0) as u8).collect();
        let planes = vec![plane(32 * 24), plane(16 * 12), plane(16 * 12)];
        Picture::from_planes(32, 24, PixelFormat::Yuv { chroma_log2: [1, 1] }, Colour::SRGB, planes).unwrap()
    }

    fn stamp(frame: i64) -> Timestamp {
        Timestamp { ns: frame * 16_666_667, clock: Clock::Container }
    }

    /// An estimate of bands that are all here, metres.
    fn estimate(frame: i64, at: Vector3<f64>) -> Estimate {
        let mut estimate = Estimate { stamp: stamp(frame), ..fixture::complete(frame as u64, 0) };
        for position in estimate.markers.iter_mut().filter_map(|marker| marker.position.as_mut().ok()) {
            position.point = Point3::new(0.0, 0.0, 1.3) + at;
            position.covariance = Matrix3::identity() * SD_M * SD_M;
        }
        estimate
    }

    /// After two pictures between which a band moved so far.
    fn after(moved_m: f64) -> Repeats {
        let mut repeats = Repeats::default();
        for (frame, x) in [(0, 0.0), (1, moved_m)] {
            repeats.remember(&noise(frame as u64), vec![WINDOW], 0, &estimate(frame, Vector3::x() * x));
        }
        repeats
    }

    /// Frames whose bands are said to stand still, of a course that is measured with noise.
    fn standing(course: impl Fn(i64) -> Vector3<f64>) -> Vec<i64> {
        standing_with(0.0, course)
    }

    /// The same with stamps that are late by up to this.
    fn standing_with(jitter_s: f64, course: impl Fn(i64) -> Vector3<f64>) -> Vec<i64> {
        let (mut repeats, mut random) = (Repeats::default(), Random::new(8));
        let picture = noise(0);
        let mut stands = |frame: &i64| {
            let off = Vector3::from_fn(|_, _| SD_M / 2.0 * random.normal());
            let mut estimate = estimate(*frame, course(*frame) + off);
            estimate.stamp.ns += (jitter_s * 1e9 * random.uniform()) as i64;
            let stands = repeats.stands_still(&estimate);
            if !stands {
                repeats.remember(&picture, vec![WINDOW], 0, &estimate);
            }
            stands
        };
        (0..240).filter(&mut stands).collect()
    }

    /// 2 cm at so many cycles per frame.
    fn swing(cycles: f64) -> impl Fn(i64) -> Vector3<f64> {
        move |frame| Vector3::x() * 0.02 * (std::f64::consts::TAU * cycles * frame as f64 + 0.3).sin()
    }

    #[test]
    fn the_same_picture_again_is_repeated_if_the_band_moved() {
        let repeats = after(1e-3);
        let is_repeated = |repeats: &Repeats, seed, frame| repeats.is_repeated(&noise(seed), stamp(frame), false);
        assert!(is_repeated(&repeats, 1, 2) && is_repeated(&repeats, 1, 200));
        assert!(!is_repeated(&repeats, 0, 2) && !is_repeated(&repeats, 2, 2));
        assert!(!is_repeated(&after(1e-4), 1, 2), "at rest");
        assert!(!is_repeated(&Repeats::default(), 1, 2));
    }

    /// What is said after a course, at whose end the bands jump and then are here.
    fn stalled(course: impl Fn(i64) -> Vector3<f64>, then: Vector3<f64>) -> Option<String> {
        let (mut repeats, mut random) = (Repeats::default(), Random::new(8));
        let off = |random: &mut Random| Vector3::from_fn(|_, _| SD_M / 2.0 * random.normal());
        for frame in 0..12 {
            repeats.notice_stall(&estimate(frame, course(frame) + off(&mut random)));
        }
        let mut last = estimate(12, Vector3::zeros());
        last.markers[1].position = Err(Miss::ImplausibleMotion { times: 3.0 });
        repeats.notice_stall(&last);
        repeats.notice_stall(&estimate(13, then));
        repeats.stalled()
    }

    #[test]
    fn a_stall_at_a_turning_point_is_told_when_it_ends() {
        let swing = |frame: i64| Vector3::x() * 0.02 * (0.3 * (frame - 8) as f64).cos();
        let elsewhere = Vector3::x() * -0.01;
        let said = stalled(|frame| swing(frame.min(8)), elsewhere);
        assert_eq!(said.as_deref(), Some("of frames 9 to 11 some probably repeat the one before, coded again"));
        assert_eq!(stalled(swing, elsewhere), None, "moving");
        assert_eq!(stalled(|_| Vector3::zeros(), elsewhere), None, "at rest since the beginning");
        assert_eq!(stalled(|frame| swing(frame.min(10)), elsewhere), None, "one picture alone");
        assert_eq!(stalled(|frame| swing(frame.min(8)), swing(8)), None, "another object for a moment");
        assert_eq!(stalled(|frame| Vector3::x() * 1e-4 * frame as f64, elsewhere), None, "creeping");
    }

    #[test]
    fn a_coder_repeats_what_has_come_to_rest() {
        let is_repeated = |frame| after(1e-3).is_repeated(&noise(1), stamp(frame), true);
        assert!(is_repeated(2) && !is_repeated(30));
    }

    #[test]
    fn pictures_shown_twice_are_noticed_by_where_the_bands_are() {
        let at = swing(0.021);
        let twice = standing(|frame| at(frame - frame % 2));
        let true_to_time: Vec<_> = twice.iter().filter(|frame| **frame % 2 == 0).collect();
        assert!(true_to_time.len() < 3, "{true_to_time:?}");
        // The rest are at the turning points.
        assert!(twice.len() > 80, "{} of 120", twice.len());
        let stall = standing(|frame| at(if (45..52).contains(&frame) { 44 } else { frame }));
        assert_eq!(stall, (45..52).collect::<Vec<_>>());
    }

    /// Up to 6 Hz at 60 frames per second.
    #[test]
    fn swings_and_steps_hardly_ever_stand_still() {
        for (jitter_s, most) in [(0.0, 24), (0.015, 240)] {
            let standing_of = |cycles: f64| standing_with(jitter_s, swing(cycles)).len();
            let all: usize = (1..=100).map(|k| standing_of(f64::from(k) * 0.001)).sum();
            assert!(all < most, "{all} of 24,000 with {jitter_s} s");
        }
        // In few pictures, as at 15 frames per second.
        let fast: usize = (1..=80).map(|k| standing(swing(0.1 + f64::from(k) * 0.005)).len()).sum();
        assert!(fast < 192, "{fast} of 19,200");
        // Critically damped, as a step of the current moves it.
        let step = |t: f64| 0.03 * (1.0 - (1.0 + t) * (-t).exp());
        assert_eq!(standing(|frame| Vector3::x() * step(0.3 * (frame - 40).max(0) as f64)), [0; 0]);
    }

    /// It is not answered for a quarter of a second, but then it is.
    #[test]
    fn a_band_that_is_stopped_is_at_rest() {
        let stopped = standing(|frame| Vector3::x() * 1e-3 * frame.min(100) as f64);
        assert_eq!(stopped, (101..115).collect::<Vec<_>>());
    }

    /// As where a swing turns.
    #[test]
    fn where_noise_is_new_in_every_picture_the_same_one_is_repeated_at_rest_too() {
        let rests = |pictures: &[u64]| {
            let mut repeats = Repeats::default();
            for (frame, seed) in (0..).zip(pictures) {
                repeats.remember(&noise(*seed), vec![WINDOW], 1, &estimate(frame, Vector3::zeros()));
            }
            repeats
        };
        let is_repeated =
            |repeats: &Repeats, frame, predicted| repeats.is_repeated(&noise(99), stamp(frame), predicted);
        let new: Vec<u64> = (0..FRESH.into()).chain([99]).collect();
        assert!(is_repeated(&rests(&new), 13, false) && is_repeated(&rests(&new), 13, true));
        assert!(is_repeated(&rests(&new), 200, false) && !is_repeated(&rests(&new), 200, true), "predicted");
        assert!(!is_repeated(&rests(&new[1..]), 13, false), "too few");
        let kept: Vec<u64> = new.iter().map(|seed| seed - seed % 10 % 2).collect();
        assert!(!is_repeated(&rests(&kept), 13, false), "a coder repeats what rests");
    }

    #[test]
    fn what_was_not_recorded_is_not_known_to_be_the_same() {
        let elsewhere = noise(1).of_parts(vec![Window { x0: 0, y0: 0, x1: 8, y1: 8 }]);
        assert!(!after(1e-3).is_repeated(&elsewhere, stamp(2), false));
    }
}
