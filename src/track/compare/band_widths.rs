//! How wide the bands of a view look, compared with the tube.
//!
//! An object in front of one side of a band, or a straight edge beside it, is the tube's outline there: the fit goes
//! half the way to it, and little of that is left in the residuals, because the colours and the light follow. But the
//! band is then narrower or wider than the tube. A change h of the half width changes a sample by x·t, with x = u/w and
//! t its change for a shift of a pixel across the tube. With the colours eliminated (joint_equations.rs: c = Σ w x t
//! ∂colours, C their matrix),
//!
//! h = Σ w x t r / (Σ w x² t² − cᵀ C⁻¹ c).

use crate::rig::Rig;
use crate::track::compare::joint_equations::Eliminated;
use crate::track::compare::view_equations::{Row, Span, add_colours};
use crate::track::memory::by_band::ByBand;
use crate::track::model::appearance::Layout;
use nalgebra::DVector;

/// Standard deviation of a band's usual width before it was ever seen, of the half width: bands are of tape, and the
/// rig may have the diameter of another tube.
const UNKNOWN: f64 = 0.3;
/// Frames over which the usual width is averaged, at most.
const AVERAGED_FRAMES: f64 = 100.0;
/// Frames over which their scatter is, and the most that can be usual, as a variance over that of the noise.
const SCATTER_FRAMES: f64 = 30.0;
const MAX_SCATTER: f64 = 4.0;
/// Widths beyond this many standard deviations count as if they were there: an edge that comes slowly must not become
/// usual by and by.
const HELD_SD: f64 = 2.0;

/// The half width of a band in a view, beyond that of the tube.
#[derive(Debug, Clone, Copy)]
pub(in crate::track) struct Width {
    pub beyond_px: f64,
    /// Its standard deviation, if the noise were independent.
    pub sd_px: f64,
}

/// Sums over the samples of a span.
#[derive(Clone, Default)]
pub(super) struct Sum {
    /// Σ w x t ∂.
    pub rows: Row,
    /// Σ w x² t² and Σ w x t r.
    pub information: f64,
    pub pull: f64,
}

/// The width of each band of a stretch, from the sums of the spans.
pub(super) fn widths(spans: &[Span], sums: &[Sum], layout: &Layout, view: &Eliminated) -> Vec<Width> {
    let of_band = |band: usize| {
        let (mut colours, mut information, mut pull) = (DVector::zeros(layout.colours()), 0.0, 0.0);
        for (span, sum) in spans.iter().zip(sums).filter(|(span, _)| span.ring / 2 == band) {
            add_colours(&mut colours, &sum.rows, span, layout);
            information += sum.information;
            pull += sum.pull;
        }
        let left = information - view.explained(&colours);
        Width { beyond_px: pull / left, sd_px: left.sqrt().recip() }
    };
    (0..layout.bands()).map(of_band).collect()
}

/// The usual width of each marker in each view, beyond that of the tube.
pub(in crate::track) struct UsualWidths {
    levels: ByBand<Level>,
}

#[derive(Clone, Copy)]
struct Level {
    mean_px: f64,
    /// Of the mean, px²; `None` before the first frame.
    variance_px2: Option<f64>,
    /// Mean square of the widths about the mean over its expectation, not below 1: with coders and noise reduction they
    /// change with the motion.
    scatter: f64,
}

impl UsualWidths {
    pub(in crate::track) fn new(rig: &Rig) -> Self {
        let level = |_, _| Level { mean_px: 0.0, variance_px2: None, scatter: 1.0 };
        Self { levels: ByBand::new(rig, level) }
    }

    /// By how many standard deviations a width differs from the usual one, where the tube's half width is `half_px`.
    pub(in crate::track) fn unusual_sd(&self, marker: usize, view: usize, width: &Width, half_px: f64) -> f64 {
        let level = self.levels.get(marker, view);
        let departure = level.and_then(|level| level.departure(width, half_px));
        departure.zip(level).map_or(0.0, |((off, sd), level)| off.abs() / (sd * level.scatter.sqrt()))
    }

    /// Adds the width of an accepted fit.
    pub(in crate::track) fn add(&mut self, marker: usize, view: usize, width: &Width, half_px: f64) {
        let Some(level) = self.levels.get_mut(marker, view) else { return };
        let Some((off, sd)) = level.departure(width, half_px) else { return };
        let own = width.sd_px.powi(2);
        let before = sd * sd - own;
        let share = (before / (before + own)).max(1.0 / AVERAGED_FRAMES);
        let held = (off / sd).clamp(-HELD_SD * level.scatter.sqrt(), HELD_SD * level.scatter.sqrt());
        level.mean_px += share * held * sd;
        level.variance_px2 = Some(before * own / (before + own));
        level.scatter = (level.scatter + (held * held - level.scatter) / SCATTER_FRAMES).clamp(1.0, MAX_SCATTER);
    }
}

impl Level {
    /// How far a width is from the mean, and the standard deviation of that, pixels; `None` if it was not measured.
    fn departure(&self, width: &Width, half_px: f64) -> Option<(f64, f64)> {
        let variance = self.variance_px2.unwrap_or_else(|| (UNKNOWN * half_px).powi(2));
        let sd = (variance + width.sd_px.powi(2)).sqrt();
        let off = width.beyond_px - self.mean_px;
        (off.is_finite() && sd.is_finite() && sd > 0.0).then_some((off, sd))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::fixture;

    const HALF_PX: f64 = 3.0;

    fn width(beyond_px: f64) -> Width {
        Width { beyond_px, sd_px: 0.02 }
    }

    #[test]
    fn a_band_of_thicker_tape_is_usual_and_one_that_becomes_narrower_is_not() {
        let mut usual = UsualWidths::new(&fixture::rig());
        let mut unusual = |beyond_px: f64| {
            let sd = usual.unusual_sd(1, 0, &width(beyond_px), HALF_PX);
            usual.add(1, 0, &width(beyond_px), HALF_PX);
            sd
        };
        assert!(unusual(0.2) < 2.0, "at first little is known");
        let later: Vec<f64> = (0..30).map(|_| unusual(0.2)).collect();
        assert!(later[20..].iter().all(|sd| *sd < 0.5), "{later:?}");
        assert!(unusual(0.2 - 0.1) > 4.0 && unusual(0.2 + 0.1) > 4.0);
        assert!(unusual(f64::NAN) < 1e-12);
    }

    #[test]
    fn an_edge_that_comes_slowly_does_not_become_usual() {
        let mut usual = UsualWidths::new(&fixture::rig());
        let mut unusual = |beyond_px: f64| {
            let sd = usual.unusual_sd(1, 0, &width(beyond_px), HALF_PX);
            usual.add(1, 0, &width(beyond_px), HALF_PX);
            sd
        };
        (0..50).for_each(|_| assert!(unusual(0.0) < 1e-9));
        let last = (0..60).map(|i| unusual(-0.005 * f64::from(i))).last();
        assert!(last.is_some_and(|sd| sd > 4.5), "{last:?}");
    }

    /// As the motion changes them in pictures that were blended with those before.
    #[test]
    fn widths_that_always_scatter_are_usual() {
        let mut usual = UsualWidths::new(&fixture::rig());
        let beyond_px = |i: u32| 0.08 * (f64::from(i) * 0.5).sin();
        (0..200).for_each(|i| usual.add(1, 0, &width(beyond_px(i)), HALF_PX));
        let most = (200..220).map(|i| usual.unusual_sd(1, 0, &width(beyond_px(i)), HALF_PX)).fold(0.0, f64::max);
        assert!(most < 2.5, "{most}");
    }
}
