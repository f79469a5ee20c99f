//! Notices pictures into which earlier ones were blended: noise reduction over time, conversion of the frame rate. They
//! show what moves where it was, too, so bands are measured too late, and no residual tells.
//!
//! Method. A band is blurred along its way. An exposure lasts for one frame at most: a variance of d²/12, d being the
//! way since the last frame. A blend of two pictures, 70 % and 30 % or more of the older one, has 2.5 to 3 times that,
//! of more pictures more. Some frames in which the coil moves by a few pixels are fitted with the blur of a whole
//! frame's way and with that of √3 of it. If clearly more of them fit better with the second, no exposure explains it;
//! further frames tell how long the way is. Its standard deviation is about how late the bands are, and belongs into
//! their covariance.
//!
//! Cannot detect: blends in which the older picture has less than a fifth, and those that look like a long exposure, as
//! of pairs of pictures shown at half the rate; any while the coil never moves by one and a half pixels per frame, or
//! at less than 17 frames per second, where no motion is kept (last_fit.rs).

use crate::source::Timestamp;
use crate::track::memory::trials::Trials;

/// The way of a blend, in ways since the last frame: between that of the longest exposure, 1, and that of a blend of
/// two equal pictures, √3. From here on it is one.
const LEAST: f64 = 1.316;
/// Less and more are this factor away, and so far it grows at a time; it shrinks by its square root.
const STEP: f64 = 1.316;
const MOST: f64 = 6.0;
/// Motion of the frames that count, pixels. Of a shorter one, a blur of the lens that is a little larger than assumed
/// looks the same; what is further away is not one band any more.
const MOTION_PX: std::ops::Range<f64> = 1.4..4.0;
/// Differences of the misfit beyond which a frame tells which way fits better.
const CLEAR: f64 = 0.01;
/// Frames by which those for one must outnumber those for the other.
const MAJORITY: i32 = 6;

/// What pictures show of earlier ones.
#[derive(Debug)]
pub(in crate::track) struct Blending {
    way: f64,
    trials: Trials,
    /// Frames for more over those for less since the last decision.
    majority: i32,
}

impl Default for Blending {
    fn default() -> Self {
        Self { way: LEAST, trials: Trials::default(), majority: 0 }
    }
}

impl Blending {
    /// Whether the pictures are blended.
    pub(in crate::track) fn is_seen(&self) -> bool {
        self.way > LEAST
    }

    /// The ways with which a frame is to be fitted too, less and more, if it is; in ways since the last frame, by which
    /// its coil moved so many pixels.
    pub(in crate::track) fn tries(&mut self, stamp: Timestamp, moved_px: f64) -> Option<[f64; 2]> {
        let counts = MOTION_PX.contains(&moved_px) && self.trials.are_due(stamp);
        counts.then(|| [self.way / STEP, self.way * STEP])
    }

    /// Adds the misfits of that frame with less and with more; whether the pictures are now known to be blended.
    pub(in crate::track) fn add(&mut self, [less, more]: [f64; 2]) -> bool {
        let is_more = more < less - CLEAR;
        if is_more {
            self.majority += 1;
            self.trials.go_on(true);
        } else if less < more - CLEAR {
            self.majority -= 1;
        }
        if self.majority.abs() < MAJORITY {
            return false;
        }
        let before = self.way;
        self.way = if is_more { self.way * STEP } else { self.way / STEP.sqrt() }.clamp(LEAST, MOST);
        self.majority = 0;
        let changed = self.way.total_cmp(&before).is_ne();
        if changed {
            tracing::debug!("the pictures show the way since {:.2} frames before", self.way);
        }
        self.trials.go_on(changed);
        self.is_seen() && before <= LEAST
    }

    /// How late what moves may be shown, frames.
    pub(in crate::track) fn late(&self) -> f64 {
        if self.is_seen() { self.way / 12_f64.sqrt() } else { 0.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::random::Random;

    /// The way after some decisions on pictures that are blurred along another one, which the misfits tell so clearly.
    fn found(true_way: f64, clearly: f64) -> f64 {
        let (mut blending, mut random) = (Blending::default(), Random::new(3));
        for _ in 0..40 * MAJORITY {
            let misfit = |way: f64| clearly * (way / true_way).ln().powi(2) + 0.003 * random.normal();
            blending.add([blending.way / STEP, blending.way * STEP].map(misfit));
        }
        blending.way
    }

    #[test]
    fn an_exposure_is_no_blend_and_the_way_of_a_blend_is_found() {
        for exposure in [0.1, 0.5, 1.0] {
            assert!(found(exposure, 0.1) <= LEAST, "{exposure}");
        }
        for way in [1.6, 1.73, 2.4, 4.9] {
            let found = found(way, 0.1);
            assert!((found / way).ln().abs() < STEP.ln(), "{found}, not {way}");
        }
        assert!(found(1.73, 1e-4) <= LEAST, "noise alone");
    }
}
