//! Usual values for a band in a view, to notice when something is wrong: how well the image model fits its pictures,
//! and how large its blob is.
//!
//! An object in front of part of a band, or a coder that did not follow it, leaves residuals that the model cannot
//! explain, or shows less of the band, and shifts it by more than noise would. The logarithm of each quantity is
//! compared with those of earlier frames and their scatter.
//!
//! Cannot detect: anything present from the first frame on, or that looks like the band.

use crate::rig::Rig;

/// Frames before the first comparison, and frames to average over.
const MIN_FRAMES: f64 = 8.0;
const AVERAGED_FRAMES: f64 = 60.0;
/// Least standard deviation assumed: 5 % or less is chance.
const MIN_SD: f64 = 0.05;

#[derive(Debug, Clone, Copy, Default)]
struct Level {
    frames: f64,
    mean: f64,
    variance: f64,
}

/// For each marker that is the reference of a stretch, in each view.
#[derive(Debug)]
pub(crate) struct Usual {
    levels: Vec<Vec<Level>>,
}

impl Usual {
    pub(crate) fn new(rig: &Rig) -> Self {
        Self { levels: vec![vec![Level::default(); rig.views.len()]; rig.markers.len()] }
    }

    /// Standard deviations by which a value exceeds the usual one; 0 below it, and while too little is known.
    pub(crate) fn above(&self, marker: usize, view: usize, value: f64) -> f64 {
        match self.levels.get(marker).and_then(|views| views.get(view)) {
            Some(level) if level.frames >= MIN_FRAMES => {
                ((value.ln() - level.mean) / level.variance.sqrt().max(MIN_SD)).max(0.0)
            }
            _ => 0.0,
        }
    }

    /// Adds an accepted value.
    pub(crate) fn add(&mut self, marker: usize, view: usize, value: f64) {
        let Some(level) = self.levels.get_mut(marker).and_then(|views| views.get_mut(view)) else { return };
        level.frames = (level.frames + 1.0).min(AVERAGED_FRAMES);
        let off = value.max(f64::MIN_POSITIVE).ln() - level.mean;
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
        assert!(usual.above(1, 0, 100.0) < 1e-12, "nothing is known yet");
        for i in 0..40 {
            usual.add(1, 0, 4.0 + 0.4 * f64::from(i * 7 % 5 - 2));
        }
        assert!(usual.above(1, 0, 5.2) < 4.0 && usual.above(1, 0, 8.0) > 4.0);
        assert!(usual.above(1, 1, 8.0) < 1e-12 && usual.above(9, 9, 8.0) < 1e-12);
    }
}
