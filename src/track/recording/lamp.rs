//! A lamp in the picture that goes on or off with every command: the count of commands, modulo 2, frame by frame.
//!
//! In: a picture, and where the lamp is. Out: 0 or 1, which changes when the lamp does. How bright the disc is, on
//! average, is compared with how bright it was: a first change is one beyond [`MIN_CHANGE`] and beyond what it varies
//! from frame to frame; then both levels are known, are followed slowly, and a change goes beyond their middle by
//! [`HYSTERESIS`] of their distance. An exposure that the change falls into counts for the one or the other.
//!
//! An exposure or a light that changes takes both levels elsewhere, and what is followed is one of them only: the disc
//! is then between the two for longer than a change takes. That level counts as the one that it has, and the other is
//! learned anew, by the next change.
//!
//! Before the first change a lamp counts as on when it is brighter than half of full scale. Where that is wrong the
//! count begins at the other number; its changes are right.
//!
//! Cannot tell: two changes between two frames; a lamp from daylight that comes and goes.

use crate::estimate::{Spot, Tick};
use crate::source::{Picture, Window};

/// Stored units (of 255) that a first change makes at least.
const MIN_CHANGE: f64 = 12.0;
/// The same by the standard deviation from frame to frame.
const MIN_CHANGE_SD: f64 = 8.0;
/// Part of the levels' distance beyond their middle.
const HYSTERESIS: f64 = 0.15;
/// By how much a level follows what is seen.
const ADAPTATION: f64 = 0.05;
/// Part of the levels' distance, and of the standard deviation from frame to frame, further from a level than which it
/// does not follow; and by how much of them the disc changes at most from one frame to the next while it stays.
const FAR: (f64, f64) = (0.2, 4.0);
const STAYS: (f64, f64) = (0.15, 3.0);
/// Part of the frames that may be between the levels, and stay there: 6 frames in sequence.
const BETWEEN: f64 = 0.25;
/// Brighter than this counts as on before anything has changed.
const HALF: f64 = 128.0;

/// Follows a lamp.
#[derive(Debug, Clone)]
pub(in crate::track) struct Lamp {
    spot: Spot,
    /// The count, and how bright the disc is with it.
    now: Option<(u8, f64)>,
    /// How bright it is with the other count.
    other: Option<f64>,
    /// Mean square of what changes from frame to frame.
    variance: f64,
    /// How bright the disc was in the frame before.
    before: f64,
    /// Part of the last frames that stay between the levels.
    between: f64,
    relearned: bool,
}

impl Lamp {
    pub(in crate::track) fn new(spot: Spot) -> Self {
        Self { spot, now: None, other: None, variance: 0.0, before: 0.0, between: 0.0, relearned: false }
    }

    /// Whether levels were found to have changed, and learned anew.
    pub(in crate::track) fn has_changed(&self) -> bool {
        self.relearned
    }

    /// The count in this picture; `None` where the lamp was not recorded.
    pub(in crate::track) fn step(&mut self, picture: &Picture) -> Option<Tick> {
        let level = brightness(picture, self.spot)?;
        let count = self.take(level);
        Some(Tick { count, level, spot: self.spot })
    }

    fn take(&mut self, level: f64) -> u8 {
        let step = (level - std::mem::replace(&mut self.before, level)).abs();
        let Some((count, usual)) = self.now else {
            let count = u8::from(level > HALF);
            self.now = Some((count, level));
            return count;
        };
        let (off, sd) = (level - usual, self.variance.sqrt());
        let changed = match self.other {
            None => off.abs() > MIN_CHANGE.max(MIN_CHANGE_SD * sd),
            // Away from the level it has by more than half of the way to the other.
            Some(other) => off / (other - usual) > 0.5 + HYSTERESIS,
        };
        if changed {
            let level = self.other.map_or(level, |other| other + ADAPTATION * (level - other));
            self.other = Some(usual);
            self.now = Some((1 - count, level));
            self.between -= ADAPTATION * self.between;
            return 1 - count;
        }
        if let Some(other) = self.other {
            let distance = (other - usual).abs();
            let is_far = off.abs() > (FAR.0 * distance).max(FAR.1 * sd);
            let stays = step < (STAYS.0 * distance).max(STAYS.1 * sd);
            let towards = off * (other - usual) > 0.0;
            self.between += ADAPTATION * (f64::from(u8::from(is_far && towards && stays)) - self.between);
            if self.between > BETWEEN {
                (self.now, self.other, self.between, self.relearned) = (Some((count, level)), None, 0.0, true);
                return count;
            }
            if is_far {
                // Away from the other it only becomes clearer.
                if !towards && stays {
                    self.now = Some((count, level));
                }
                return count;
            }
        }
        self.variance += ADAPTATION * (off * off - self.variance);
        self.now = Some((count, usual + ADAPTATION * off));
        count
    }
}

/// Mean of luma, or green, over a disc, stored units; `None` where it is not there.
fn brightness(picture: &Picture, spot: Spot) -> Option<f64> {
    let [width, height] = picture.size_px();
    let Spot { x_px, y_px, radius_px } = spot;
    let end = |at: u32, most: u32| at.saturating_add(radius_px).saturating_add(1).min(most);
    let area = Window {
        x0: x_px.saturating_sub(radius_px),
        y0: y_px.saturating_sub(radius_px),
        x1: end(x_px, width),
        y1: end(y_px, height),
    };
    picture.declare_read(area).ok()?;
    let plane = picture.plane(usize::from(!picture.format().is_yuv() && picture.format().channels() > 1))?;
    let reach = u64::from(radius_px).pow(2);
    let (mut sum, mut count) = (0_u64, 0_u64);
    for y in area.y0..area.y1 {
        let row = plane.row(y as usize)?;
        for x in area.x0..area.x1 {
            let off = u64::from(x.abs_diff(x_px)).pow(2) + u64::from(y.abs_diff(y_px)).pow(2);
            if off <= reach {
                sum += u64::from(*row.get(x as usize * plane.step)?);
                count += 1;
            }
        }
    }
    (count > 0).then(|| sum as f64 / count as f64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::source::{Colour, PixelFormat};
    use crate::testing::random::Random;

    const SPOT: Spot = Spot { x_px: 12, y_px: 9, radius_px: 3 };

    fn counts(levels: impl IntoIterator<Item = f64>) -> Vec<u8> {
        let mut lamp = Lamp::new(SPOT);
        levels.into_iter().map(|level| lamp.take(level)).collect()
    }

    #[test]
    fn every_change_is_one_whatever_the_levels_and_the_noise_and_nothing_else_is() {
        for (dark, bright, noise) in [(10.0, 250.0, 3.0), (60.0, 80.0, 1.0), (150.0, 200.0, 2.0)] {
            let mut random = Random::new(5);
            // A second dark, then on and off every fourth frame, all of it fading by a tenth.
            let on = |k: usize| k >= 60 && (k / 4) % 2 == 1;
            let level = |k: usize| if on(k) { bright } else { dark } * (1.0 - 0.1 * k as f64 / 600.0);
            let found = counts((0..600).map(|k| level(k) + noise * random.normal()));
            for (k, pair) in found.windows(2).enumerate() {
                assert_eq!(pair[0] != pair[1], on(k) != on(k + 1), "{dark} {bright}: frame {}", k + 1);
            }
        }
        let mut random = Random::new(6);
        assert!(counts((0..600).map(|_| 90.0 + 2.0 * random.normal())).iter().all(|count| *count == 0));
        // A frame that the change falls into counts for one or the other.
        let smeared = counts([20.0, 20.0, 200.0, 200.0, 110.0, 20.0, 20.0, 110.0, 200.0]);
        assert_eq!(smeared.windows(2).filter(|pair| pair[0] != pair[1]).count(), 3, "{smeared:?}");
    }

    /// Levels before and after frame 400, both at once: another exposure, another light.
    #[test]
    fn levels_that_change_are_learned_anew_whatever_is_switched_meanwhile() {
        for (before, after) in [
            ((40.0, 200.0), (22.0, 110.0)),
            ((22.0, 110.0), (40.0, 200.0)),
            ((20.0, 160.0), (100.0, 240.0)),
            ((100.0, 240.0), (20.0, 160.0)),
        ] {
            for held in [3, 4, 8, 30, 120] {
                let mut random = Random::new(held as u64);
                let on = |k: usize| k >= 60 && (k / held) % 2 == 1;
                let mut lamp = Lamp::new(SPOT);
                let found: Vec<u8> = (0..1200)
                    .map(|k| {
                        let (dark, bright) = if k < 400 { before } else { after };
                        lamp.take(if on(k) { bright } else { dark } + 2.0 * random.normal())
                    })
                    .collect();
                let missed = (1..1200).filter(|k| (on(*k) != on(k - 1)) != (found[*k] != found[k - 1])).count();
                // What is switched while it is learned may be missed, for half a second; or the change that shows it.
                assert!(missed <= 1 || missed * held <= 30, "{before:?} {after:?}, held for {held}: {missed} missed");
                assert!(missed == 0 || lamp.has_changed());
            }
        }
        // Changes that fall into exposures, and levels as close as they may be, are none of that.
        let mut random = Random::new(3);
        let (mut smeared, mut close) = (Lamp::new(SPOT), Lamp::new(SPOT));
        for k in 0..4000 {
            let on = |k: usize| (k / 4) % 2 == 1;
            let level = if k > 0 && on(k) != on(k - 1) { 110.0 } else { 20.0 + 180.0 * f64::from(u8::from(on(k))) };
            smeared.take(level + 2.0 * random.normal());
            close.take(100.0 + 24.0 * f64::from(u8::from(k > 60 && on(k))) + 2.0 * random.normal());
        }
        assert!(!smeared.has_changed() && !close.has_changed() && close.other.is_some());
    }

    #[test]
    fn the_disc_alone_counts_in_any_format_and_what_was_not_recorded_is_not_known() {
        let inside = |x: i64, y: i64| (x - 12).pow(2) + (y - 9).pow(2) <= 9;
        let value = |k: i64| if inside(k % 32, k / 32) { 200 } else { 20 };
        let samples: Vec<u8> = (0..32 * 24).map(value).collect();
        let grey = |planes| Picture::from_planes(32, 24, PixelFormat::Grey, Colour::SRGB, planes).unwrap();
        assert_eq!(brightness(&grey(vec![samples.clone()]), SPOT), Some(200.0));
        let packed = samples.iter().flat_map(|v| [0, *v, 90]).collect();
        let format = PixelFormat::RgbPacked { step: 3, order: [0, 1, 2] };
        let picture = Picture::from_planes(32, 24, format, Colour::SRGB, vec![packed]).unwrap();
        assert_eq!(brightness(&picture, SPOT), Some(200.0));
        let elsewhere = grey(vec![samples]).of_parts(vec![Window { x0: 0, y0: 0, x1: 12, y1: 24 }]);
        assert_eq!(brightness(&elsewhere, SPOT), None);
    }
}
