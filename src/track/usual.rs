//! How well the image model usually explains the pictures of a band in a view, to know when something is wrong.
//!
//! A thing in front of a part of a band, or a coder that did not follow it, leaves residuals that the model has no words for,
//! and pulls the band aside by more than their noise would. Their root mean square is compared with that of the frames
//! before, as a logarithm with its own scatter.
//!
//! Cannot detect: what was there from the first frame on, or looks like the band.

use crate::rig::Rig;

/// Frames before the first comparison, and over which is averaged.
const FIRST: f64 = 8.0;
const MOST: f64 = 60.0;
/// Standard deviations above the mean that are too much, and the least of them ever assumed: 5 % and less is chance.
const TOO_MANY: f64 = 4.0;
const LEAST_SD: f64 = 0.05;

#[derive(Debug, Clone, Copy, Default)]
struct Level {
    frames: f64,
    mean: f64,
    variance: f64,
}

/// Of each marker that is the reference of a stretch, in each view.
#[derive(Debug)]
pub(crate) struct Usual {
    levels: Vec<Vec<Level>>,
}

impl Usual {
    pub(crate) fn new(rig: &Rig) -> Self {
        Self { levels: vec![vec![Level::default(); rig.views.len()]; rig.markers.len()] }
    }

    /// Whether a root mean square of residuals is more than usual.
    pub(crate) fn exceeds(&self, marker: usize, view: usize, rms: f64) -> bool {
        self.levels.get(marker).and_then(|views| views.get(view)).is_some_and(|level| {
            let sd = level.variance.sqrt().max(LEAST_SD);
            level.frames >= FIRST && rms.ln() > level.mean + TOO_MANY * sd
        })
    }

    /// Adds one that was accepted.
    pub(crate) fn add(&mut self, marker: usize, view: usize, rms: f64) {
        let Some(level) = self.levels.get_mut(marker).and_then(|views| views.get_mut(view)) else { return };
        level.frames = (level.frames + 1.0).min(MOST);
        let off = rms.max(f64::MIN_POSITIVE).ln() - level.mean;
        level.mean += off / level.frames;
        level.variance += (off * off * (1.0 - 1.0 / level.frames) - level.variance) / level.frames;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::fixture;

    #[test]
    fn what_is_twice_the_usual_is_too_much_and_scatter_is_not() {
        let mut usual = Usual::new(&fixture::rig());
        assert!(!usual.exceeds(1, 0, 100.0), "nothing is known yet");
        for i in 0..40 {
            usual.add(1, 0, 4.0 + 0.4 * f64::from(i * 7 % 5 - 2));
        }
        assert!(!usual.exceeds(1, 0, 5.2) && usual.exceeds(1, 0, 8.0));
        assert!(!usual.exceeds(1, 1, 8.0) && !usual.exceeds(9, 9, 8.0));
    }
}
