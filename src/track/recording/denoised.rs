//! Notices noise reduction over time, as cameras have it ("3D noise reduction"): a picture takes over much of the one
//! before wherever they hardly differ. Strong edges move at once, weak ones follow late, and bands with them.
//!
//! Method. A sensor's noise is another one in each picture; reduced over time it lasts. Small blocks are compared
//! around the base band, which rests, each without its mean, as light flickers: with the picture before, and with the
//! one four before. What lasts is one less the ratio of the squares of both differences. Beside the tube, which bends,
//! more than noise changes slowly: so many blocks have to tell, and what counts is their lower quartile.
//!
//! A weak difference is late by as many frames as a mean over time of such noise reaches back. But a band does not stay
//! behind by more than a part of a pixel: then its edges are no weak difference any more.
//!
//! A copy of a compressed video (copied.rs) looks the same, and what its coder left as it was is late, too.
//!
//! Cannot detect: noise reduction in pictures that were coded by a coder that predicts, which makes noise last too; in
//! chroma alone (chroma_lag.rs); where a JPEG or the reduction itself leaves no noise.

use crate::track::recording::blocks::{Block, Compared, SIDE, differences};
use std::collections::BTreeMap;

/// Fewest frames of a block that tell.
const LEAST_FRAMES: u32 = 8;
/// Fewest blocks that tell.
const LEAST_BLOCKS: usize = 12;
/// Least mean square of the later difference of a sample: less is rounding.
const LEAST_SQUARE: f64 = 0.1;
/// Part of the noise that lasts for a frame from which on it was reduced. Measured: -0.05 to 0.05 in lossless
/// recordings, 0.45 to 0.6 in reduced noise.
const LASTS: f64 = 0.25;
/// How far a band stays behind at most, pixels. Measured: 0.1 to 0.5, at thresholds of three to ten standard deviations
/// of the noise.
const BEHIND_PX: f64 = 0.25;

/// What pictures have shown so far.
#[derive(Debug, Default)]
pub(in crate::track) struct Denoised {
    blocks: BTreeMap<[u32; 2], Noise>,
    /// How many frames a mean over time reaches back.
    back: Option<f64>,
    /// Size of a pixel at the coil, metres.
    pub pixel_m: f64,
}

/// Sums over the differences of a block from the frame before, and from four before.
#[derive(Debug, Default)]
struct Noise {
    near: f64,
    far: f64,
    frames: u32,
}

impl Noise {
    /// What lasts of its noise for a frame; `None` where it does not tell.
    fn lasts(&self) -> Option<f64> {
        let samples = (SIDE * SIDE) as f64 * f64::from(self.frames);
        let tells = self.frames >= LEAST_FRAMES && self.far >= LEAST_SQUARE * samples;
        tells.then(|| 1.0 - self.near / self.far)
    }
}

/// Squares of the differences about their mean.
fn squares(one: &Block, other: &Block) -> f64 {
    let (sum, squares) = differences(one, other);
    f64::from(squares) - f64::from(sum).powi(2) / one.len() as f64
}

impl Denoised {
    /// Whether noise was reduced over time.
    pub(in crate::track) fn is_seen(&self) -> bool {
        self.back.is_some()
    }

    /// How late a position is shown that has moved so many metres since the last frame, frames.
    pub(in crate::track) fn late(&self, way_m: f64) -> f64 {
        self.back.map_or(0.0, |back| back.min(BEHIND_PX * self.pixel_m / way_m))
    }

    /// Adds the blocks of a picture whose coder does not predict.
    pub(in crate::track) fn add(&mut self, blocks: &[Compared]) {
        if blocks.is_empty() || self.back.is_some() {
            return;
        }
        for Compared { corner, now, before, earlier } in blocks {
            let noise = self.blocks.entry(*corner).or_default();
            noise.near += squares(now, before);
            noise.far += squares(now, earlier);
            noise.frames += 1;
        }
        let mut lasts: Vec<f64> = self.blocks.values().filter_map(Noise::lasts).collect();
        lasts.sort_by(f64::total_cmp);
        let low = lasts.get(lasts.len() / 4).filter(|low| lasts.len() >= LEAST_BLOCKS && **low > LASTS);
        self.back = low.map(|low| low / (1.0 - low));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::source::{Colour, Picture, PixelFormat, Window};
    use crate::testing::random::Random;
    use crate::track::recording::blocks::Blocks;

    const SIZE: u32 = 96;
    const BASE: Window = Window { x0: 40, y0: 40, x1: 56, y1: 56 };

    /// After so many frames with an edge, of which each takes over a part of the one before where it differs by less
    /// than `weak`, and light that flickers.
    fn after(frames: u32, takes: f64, weak: f64, noise: f64) -> Denoised {
        after_shown(1, frames, takes, weak, noise)
    }

    /// The same where each is shown several times.
    fn after_shown(times: u32, frames: u32, takes: f64, weak: f64, noise: f64) -> Denoised {
        let (mut denoised, mut random) = (Denoised { pixel_m: 0.5e-3, ..Denoised::default() }, Random::new(5));
        let mut blocks = Blocks::default();
        let mut shown: Vec<f64> = Vec::new();
        for frame in 0..frames {
            let flicker = 3.0 * f64::from(frame).sin();
            let light = |i: u32| flicker + if i % SIZE < 48 { 60.0 } else { 140.0 };
            let own: Vec<f64> = (0..SIZE * SIZE).map(|i| light(i) + noise * random.normal()).collect();
            let reduced = |(own, before): (&f64, &f64)| {
                own + (before - own) * if (own - before).abs() < weak { takes } else { 0.0 }
            };
            shown = if shown.is_empty() { own } else { own.iter().zip(&shown).map(reduced).collect() };
            let planes = vec![shown.iter().map(|value| value.round() as u8).collect()];
            let picture = Picture::from_planes(SIZE, SIZE, PixelFormat::Grey, Colour::SRGB, planes).unwrap();
            (0..times).for_each(|k| denoised.add(&blocks.add(&picture, [BASE].into_iter(), || k > 0)));
        }
        denoised
    }

    #[test]
    fn noise_that_lasts_is_told_from_noise_of_each_picture() {
        for noise in [0.3, 1.5, 6.0] {
            assert!(!after(130, 0.0, 0.0, noise).is_seen(), "noise of {noise}");
            assert!(!after_shown(2, 130, 0.0, 0.0, noise).is_seen(), "shown twice, noise of {noise}");
        }
        for (takes, noise) in [(0.5, 1.5), (0.75, 1.5), (0.75, 6.0)] {
            assert!(after(20, takes, 8.0 * noise, noise).is_seen(), "{takes}, noise of {noise}");
        }
    }

    #[test]
    fn a_slow_band_is_late_by_frames_and_a_fast_one_by_a_part_of_a_pixel() {
        let denoised = after(20, 0.6, 50.0, 2.0);
        // A mean over time that takes over 0.6 of itself reaches back by 1.5 frames.
        assert!((denoised.late(1e-6) - 1.5).abs() < 0.5, "{}", denoised.late(1e-6));
        assert!((denoised.late(1e-3) * 1e-3 - BEHIND_PX * 0.5e-3).abs() < 1e-12);
        assert!(after(20, 0.0, 0.0, 2.0).late(1e-6) == 0.0);
    }
}
