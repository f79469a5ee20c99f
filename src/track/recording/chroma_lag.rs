//! Notices chroma that lags behind luma: noise reduction over time that blends earlier pictures into the colours alone,
//! or a device that delays them. Colour then shows a band that moves where it was.
//!
//! Method. The residuals of the fit tell how far the chroma of the bands has slipped from their luma in each view
//! (chroma_slip.rs). Over frames in which the coil moves by a few pixels, that slip is compared with the way since the
//! last frame: what is in proportion to it, and against it, is a lag, in frames. A slip that stays, another in each
//! view, is none: the lens may show colours at different places. The fit follows luma and chroma both: how its shape
//! responds to chroma that lies behind by the lag times the way belongs into its covariance.
//!
//! Cannot detect: a lag while nothing moves.

use crate::track::compare::chroma_slip::Seen;
use nalgebra::{Matrix2, Vector2};

/// Motion of the frames that count, pixels: of a shorter one noise is larger, of a longer one a band's chroma may lie
/// beside it.
const MOTION_PX: std::ops::Range<f64> = 0.7..5.0;
/// Lag as it is seen beyond which chroma is late, frames. Measured: up to 0.05 in recordings by coders of all kinds.
const LEAST: f64 = 0.12;
/// Part of a lag that is seen at most: a blend leaves most of a band's colour where the band is, and a slip by more
/// than the blur looks smaller than it is. Measured: 0.13 and 0.22 of 0.43 frames (30 % of the picture before), 0.79 of
/// 1.
const SEEN: f64 = 0.5;
/// Standard deviations of its noise that it must exceed.
const CLEAR_SD: f64 = 6.0;
/// Half-life of what was seen, frames that tell.
const FRAMES: f64 = 60.0;

/// What pictures have shown so far.
#[derive(Debug, Default)]
pub(in crate::track) struct Lag {
    views: Vec<Slips>,
    seen: bool,
}

/// Normal equations of a view: of the slip that stays, of the lag, and of both.
#[derive(Debug, Clone, Copy, Default)]
struct Slips {
    information: Matrix2<f64>,
    pull: Vector2<f64>,
    of_lag: f64,
    pull_of_lag: f64,
    both: Vector2<f64>,
}

impl Slips {
    /// Information about the lag alone, and its pull; `None` where nothing is known of the slip.
    fn lag(&self) -> Option<(f64, f64)> {
        let stays = self.information.cholesky()?;
        let both = stays.solve(&self.both);
        Some((self.of_lag - self.both.dot(&both), self.pull_of_lag - both.dot(&self.pull)))
    }
}

impl Lag {
    /// Begins a frame in which the tube has moved so far in the views, pixels. What was seen fades only in frames that
    /// tell.
    pub(in crate::track) fn begin(&mut self, ways_px: &[Vector2<f64>]) {
        if !ways_px.iter().any(|way_px| MOTION_PX.contains(&way_px.norm())) {
            return;
        }
        let by = 0.5_f64.powf(1.0 / FRAMES);
        for Slips { information, pull, of_lag, pull_of_lag, both } in &mut self.views {
            *information *= by;
            *pull *= by;
            *of_lag *= by;
            *pull_of_lag *= by;
            *both *= by;
        }
    }

    /// Adds the frame in a view: the slip of its chroma, and how far its tube has moved since the last one, pixels.
    pub(in crate::track) fn add(&mut self, view: usize, slip: &Seen, way_px: &Vector2<f64>) {
        if !MOTION_PX.contains(&way_px.norm()) {
            return;
        }
        if self.views.len() <= view {
            self.views.resize_with(view + 1, Slips::default);
        }
        let Slips { information, pull, of_lag, pull_of_lag, both } = &mut self.views[view];
        let told = slip.information * way_px;
        *information += slip.information;
        *pull += slip.pull;
        *of_lag += way_px.dot(&told);
        *pull_of_lag -= way_px.dot(&slip.pull);
        *both -= told;
        let (frames, information) = self.frames();
        self.seen |= frames > LEAST.max(CLEAR_SD * information.powf(-0.5));
    }

    /// By how much chroma seems to be late, frames, and the information about that.
    fn frames(&self) -> (f64, f64) {
        let known = self.views.iter().filter_map(Slips::lag);
        let (information, pull) = known.fold((0.0, 0.0), |sum, view| (sum.0 + view.0, sum.1 + view.1));
        if information > 0.0 { (pull / information, information) } else { (0.0, 0.0) }
    }

    /// Whether chroma was ever late.
    pub(in crate::track) fn is_seen(&self) -> bool {
        self.seen
    }

    /// How late chroma may be, frames.
    pub(in crate::track) fn late(&self) -> f64 {
        if self.seen { self.frames().0.max(0.0) / SEEN } else { 0.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::random::Random;

    /// Of a swing whose chroma slips by so much of each way, and by `own_px` besides, the other way in the other view,
    /// after so many frames.
    fn seen(frames: u32, part: f64, way_px: f64, own_px: f64, per_frame: f64) -> Lag {
        const SD_PX: f64 = 0.1;
        let (mut lag, mut random) = (Lag::default(), Random::new(8));
        let information = Matrix2::new(1.0, 0.2, 0.2, 0.5) / SD_PX.powi(2);
        for k in 0..frames {
            let ways = [1.0, -0.8].map(|to| Vector2::new(to, 0.4) * (way_px * (f64::from(k) * per_frame).cos()));
            lag.begin(&ways);
            for (view, (to, way)) in [1.0, -0.8].into_iter().zip(ways).enumerate() {
                let slip = way * -part + Vector2::repeat(own_px * to);
                let noise = Vector2::new(random.normal(), random.normal()) / SD_PX;
                lag.add(view, &Seen { information, pull: information * slip + noise, ..Seen::default() }, &way);
            }
        }
        lag
    }

    #[test]
    fn chroma_that_stays_behind_is_seen_with_its_lag() {
        for part in [0.15, 0.3, 0.8] {
            let lag = seen(120, part, 2.0, 0.3, 0.1);
            assert!(lag.is_seen() && (lag.late() * SEEN - part).abs() < 0.05, "{part}: {lag:?}");
        }
    }

    #[test]
    fn rest_does_not_change_what_was_seen() {
        let mut lag = seen(120, 0.3, 2.0, 0.3, 0.1);
        let before = lag.late();
        (0..100_000).for_each(|_| lag.begin(&[Vector2::new(0.01, 0.0)]));
        assert!((lag.late() - before).abs() < 1e-12 && before > 0.0, "{lag:?}");
    }

    #[test]
    fn other_slips_are_no_lag() {
        for (part, way_px, own_px) in [
            (0.0, 2.0, 0.0),
            (0.05, 3.0, 0.0),
            (-0.3, 2.0, 0.0),
            (0.3, 0.5, 0.0),
            (0.0, 2.0, 0.2),
            (0.0, 2.0, -1.0),
            (0.0, 2.0, 1.0),
        ] {
            // Swings, and one long stroke.
            for per_frame in [0.1, 0.002] {
                let lag = seen(600, part, way_px, own_px, per_frame);
                assert!(!lag.is_seen() && lag.late() == 0.0, "{part}, {way_px} px, {own_px} px: {lag:?}");
            }
        }
    }
}
