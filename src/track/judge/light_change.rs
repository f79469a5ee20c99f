//! What changes residuals without anything in front of a band: the light, and the noise.
//!
//! Errors of the image model grow with the light: as far as a band became brighter without changing its hue, larger
//! residuals are no sign of an object. Noise grows with the camera's gain: residuals that are larger in all bands and
//! views, and remain so, become usual.

use crate::rig::Rig;
use crate::track::fit::tube_fit::ViewFit;
use crate::track::memory::by_band::ByBand;
use crate::track::model::appearance::{PER_SEGMENT, segment_at};
use crate::track::model::functions::Encoding;
use crate::track::model::stretch::Group;
use nalgebra::Vector3;

/// Frames before the first comparison of a colour, and frames to average over; after them it stays.
const MIN_FRAMES: f64 = 8.0;
const AVERAGED_FRAMES: f64 = 60.0;
/// Largest change of hue, as a part of the change of brightness: lamps differ in their colour. What is in front of part
/// of a band changes mostly the hue.
const MAX_HUE_CHANGE: f64 = 0.25;
/// ln of a factor that is no chance when all residuals have it, and frames for which it must last.
const CHANGED: f64 = 0.1;
const LASTING_FRAMES: u32 = 30;

/// The colour of each marker in each view in the first frames, in linear light.
pub(super) struct FirstColours {
    levels: ByBand<Level>,
}

#[derive(Clone, Copy, Default)]
struct Level {
    frames: f64,
    mean: Vector3<f64>,
}

impl FirstColours {
    pub(super) fn new(rig: &Rig) -> Self {
        Self { levels: ByBand::new(rig, |_, _| Level::default()) }
    }

    /// By what to multiply a residual, so that it is that in the light of the first frames, where `difference` is ln of
    /// its factor to the usual one. Noise does not grow with the light: the factor is no more than that.
    pub(super) fn factor(&self, seen: (&Group, usize, &ViewFit), encoding: &Encoding, difference: Option<f64>) -> f64 {
        let light = self.light(seen, encoding);
        (-difference.unwrap_or(0.0).clamp(light.min(0.0), light.max(0.0))).exp()
    }

    /// ln of the factor by which all bands of a fit are stored brighter than in the first frames; 0 where a hue
    /// changed, or too little is known.
    fn light(&self, (group, view, fit): (&Group, usize, &ViewFit), encoding: &Encoding) -> f64 {
        let changes = bands(group, fit).map(|(marker, colour)| {
            let level = self.levels.get(marker, view).filter(|level| level.frames >= MIN_FRAMES)?;
            brighter(&level.mean, &colour, encoding)
        });
        changes.collect::<Option<Vec<_>>>().map_or(0.0, |changes| common(&changes))
    }

    /// Adds the colours of an accepted fit.
    pub(super) fn add(&mut self, (group, view, fit): (&Group, usize, &ViewFit)) {
        for (marker, colour) in bands(group, fit) {
            if let Some(level) = self.levels.get_mut(marker, view)
                && level.frames < AVERAGED_FRAMES
            {
                level.frames += 1.0;
                level.mean += (colour - level.mean) / level.frames;
            }
        }
    }
}

/// ln of the factor by which a colour is stored brighter than another; `None` if the hue changed.
fn brighter(before: &Vector3<f64>, now: &Vector3<f64>, encoding: &Encoding) -> Option<f64> {
    let along = before.try_normalize(0.0)?;
    let change = now - before;
    let brighter = change.dot(&along);
    let hue = (change - along * brighter).norm();
    let stored = |colour: &Vector3<f64>| colour.map(|c| f64::from(encoding.encode(c as f32).0)).norm();
    (hue <= MAX_HUE_CHANGE * brighter.abs()).then(|| (stored(now) / stored(before)).ln())
}

/// The markers of a fit, and the fitted colours of their bands.
fn bands<'a>(group: &'a Group, fit: &'a ViewFit) -> impl Iterator<Item = (usize, Vector3<f64>)> + 'a {
    group.members.iter().enumerate().filter_map(|(member, (marker, _))| {
        let at = segment_at(2 * member + 1);
        Some((*marker, Vector3::from_column_slice(fit.look.colours.get(at..at + PER_SEGMENT)?)))
    })
}

/// Counts frames in which all residuals are larger than usual.
#[derive(Default)]
pub(super) struct Noisier {
    frames: u32,
}

impl Noisier {
    /// ln of the factor by which residuals became larger for good, if they did, from those of each fit of a frame. A
    /// single fit tells nothing: what is in front of it may last.
    pub(super) fn lasting(&mut self, differences: &[Vec<f64>]) -> Option<f64> {
        if differences.iter().filter(|of_fit| !of_fit.is_empty()).count() < 2 {
            return None;
        }
        let least = common(&differences.concat());
        self.frames = if least > CHANGED { self.frames + 1 } else { 0 };
        if self.frames < LASTING_FRAMES {
            return None;
        }
        self.frames = 0;
        Some(least)
    }
}

/// The smallest of some changes, if all are in one direction.
fn common(changes: &[f64]) -> f64 {
    let least = |sign: f64| changes.iter().map(|change| sign * change).fold(f64::INFINITY, f64::min).max(0.0);
    if changes.is_empty() { 0.0 } else { least(1.0) - least(-1.0) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::source::Transfer;

    #[test]
    fn more_light_is_told_from_a_grey_object_in_front() {
        let encoding = Encoding::new(Transfer::Linear);
        let red = Vector3::new(0.4, 0.1, 0.05);
        assert!(brighter(&red, &(red * 1.6), &encoding).is_some_and(|ln| (ln - 1.6_f64.ln()).abs() < 1e-6));
        assert!(brighter(&red, &(red * 0.5), &encoding).is_some_and(|ln| (ln - 0.5_f64.ln()).abs() < 1e-6));
        let half_hidden = red * 0.5 + Vector3::repeat(0.6) * 0.5;
        assert_eq!(brighter(&red, &half_hidden, &encoding), None);
    }

    #[test]
    fn what_all_bands_show_for_long_is_usual_and_what_one_shows_is_not() {
        let lasting = |differences: [Vec<f64>; 2]| {
            let mut noisier = Noisier::default();
            (0..2 * LASTING_FRAMES).find_map(|_| noisier.lasting(&differences))
        };
        assert_eq!(lasting([vec![0.4, 0.5], vec![0.3]]), Some(0.3));
        assert_eq!(lasting([vec![0.4, 0.5], vec![0.01]]), None);
        assert_eq!(lasting([vec![0.4, 0.5], vec![]]), None);
    }
}
