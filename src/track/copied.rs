//! Notices pictures that are a copy of a video whose coder predicted pictures from each other: stored again without
//! losses, or as JPEGs. What that coder lost is lost in them too, and nothing in their files says so.
//!
//! Method. A coder that predicts leaves what hardly changed as it was, to the last bit, until that costs too much. A
//! sensor's noise changes every part of every picture. Compared: small blocks with contrast around the base band, which
//! rests, from frame to frame. In a copy they repeat, or change by more than rounding, now this and now that: in 0.05
//! to 0.27 of the comparisons both are as frequent, in copies of H.264 at crf 18 to 23. Without losses it is none, and
//! 0.01 in simulated pictures without noise, which change by rounding alone where the tube hardly moves.
//!
//! What is lost is then assumed to be what is usual, as for a coder whose quantisation is unknown. JPEGs of a quality
//! that loses more themselves keep their own.
//!
//! Cannot detect: copies of finely coded videos (crf 14), of videos that were resized or turned, and noise that was
//! added later. A camera that reduces noise over time looks the same.

use crate::source::{Picture, PixelFormat, Quantisation, Window};
use std::collections::BTreeMap;

/// Side of a block: that of a JPEG's; coders that predict have such or larger ones.
const SIDE: usize = 8;
/// Surroundings of a band that are compared, pixels.
const AROUND_PX: u32 = 16;
/// Least contrast of a block that tells, stored units: JPEG makes flatter ones equal.
const CONTRAST: u8 = 24;
/// Fewest comparisons that tell, and how many frames are compared.
const LEAST: u32 = 200;
const FRAMES: u32 = 120;
/// Least part of the comparisons in which a block was as before, or in which it was not, whichever are fewer.
const MIXED: f64 = 0.03;
/// Least squares of a block's changes: a coder that corrects a block changes it by its step, and one of 4 stored units
/// does no harm.
const CHANGED: u32 = 16;

/// The blocks so far.
#[derive(Debug, Default)]
pub(crate) struct Copied {
    blocks: BTreeMap<[u32; 2], Block>,
    frames: u32,
    from: Option<Quantisation>,
}

/// What a block showed last, and in how many frames it was as before, and was not.
#[derive(Debug)]
struct Block {
    samples: [u8; SIDE * SIDE],
    same: u32,
    changed: u32,
}

impl Copied {
    /// What is assumed of the first coder's quantisation, if the pictures are a copy.
    pub(crate) fn from(&self) -> Option<&Quantisation> {
        self.from.as_ref()
    }

    /// Adds a picture, with the windows of the base band in it.
    pub(crate) fn add(&mut self, picture: &Picture, base: impl Iterator<Item = Window>) {
        let own = picture.quantisation();
        if self.frames == FRAMES || own.is_some_and(|own| own.predicted) {
            return;
        }
        let assumed = Quantisation::assumed(picture.size_px());
        if own.is_some_and(|own| own.step_at([0, 0]) >= assumed.step_at([0, 0])) {
            return;
        }
        for window in base {
            let around = window.grown(AROUND_PX, SIDE as u32).clipped(picture.size_px());
            // Recorded windows may end before.
            if picture.declare_read(around).is_ok() {
                self.add_window(picture, around);
            }
        }
        let count = |of: &dyn Fn(&Block) -> u32| self.blocks.values().map(of).sum::<u32>();
        let (all, mixed) = (count(&|block| block.same + block.changed), count(&|block| block.same.min(block.changed)));
        self.frames += 1;
        if all >= LEAST && f64::from(mixed) >= MIXED * f64::from(all) {
            self.from = Some(assumed);
            self.frames = FRAMES;
        }
        if self.frames == FRAMES {
            self.blocks = BTreeMap::new();
        }
    }

    fn add_window(&mut self, picture: &Picture, window: Window) {
        for y in (window.y0..window.y1).step_by(SIDE) {
            for x in (window.x0..window.x1).step_by(SIDE) {
                let Some(samples) = block(picture, [x, y]) else { continue };
                let (darkest, brightest) = samples.iter().fold((u8::MAX, 0), |(a, b), v| (a.min(*v), b.max(*v)));
                if brightest - darkest < CONTRAST {
                    continue;
                }
                let Some(block) = self.blocks.get_mut(&[x, y]) else {
                    self.blocks.insert([x, y], Block { samples, same: 0, changed: 0 });
                    continue;
                };
                let squares = |(a, b): (&u8, &u8)| u32::from(a.abs_diff(*b)).pow(2);
                match block.samples.iter().zip(&samples).map(squares).sum() {
                    0 => block.same += 1,
                    CHANGED.. => block.changed += 1,
                    _ => {}
                }
                block.samples = samples;
            }
        }
    }
}

/// The samples of luma, or green, of the block that begins at a pixel; `None` where it is not wholly inside.
fn block(picture: &Picture, [x, y]: [u32; 2]) -> Option<[u8; SIDE * SIDE]> {
    let has_luma = picture.format().is_yuv() || picture.format() == PixelFormat::Grey;
    let plane = picture.plane(if has_luma { 0 } else { 1 })?;
    let mut samples = [0; SIDE * SIDE];
    for (j, to) in samples.chunks_exact_mut(SIDE).enumerate() {
        let row = plane.row(y as usize + j)?.get(x as usize * plane.step..)?;
        let mut from = row.iter().step_by(plane.step);
        for sample in to {
            *sample = *from.next()?;
        }
    }
    Some(samples)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::source::Colour;
    use crate::testing::random::Random;

    const SIZE: u32 = 96;
    const BASE: Window = Window { x0: 40, y0: 40, x1: 56, y1: 56 };

    /// The samples of a vertical edge, with noise.
    fn edge(at_px: f64, noise: f64, random: &mut Random) -> Vec<u8> {
        let light = |x: u32| 60.0 + 80.0 / (1.0 + (at_px - f64::from(x)).exp());
        (0..SIZE * SIZE).map(|i| (light(i % SIZE) + noise * random.normal()).round() as u8).collect()
    }

    /// A coder that corrects one block of five, others in each picture.
    fn predicted(coded: &mut [u8], own: &[u8], frame: u32) {
        for (i, (to, from)) in coded.iter_mut().zip(own).enumerate() {
            let [x, y] = [i as u32 % SIZE / 16, i as u32 / SIZE / 16];
            if (x + 2 * y + frame).is_multiple_of(5) {
                *to = *from;
            }
        }
    }

    fn looks_copied(picture: impl Fn(Picture) -> Picture, mut samples: impl FnMut(u32) -> Vec<u8>) -> bool {
        let mut copied = Copied::default();
        for frame in 0..60 {
            let planes = vec![samples(frame)];
            let own = Picture::from_planes(SIZE, SIZE, PixelFormat::Grey, Colour::SRGB, planes).unwrap();
            copied.add(&picture(own), [BASE].into_iter());
        }
        copied.from().is_some()
    }

    #[test]
    fn what_a_coder_left_as_it_was_is_told_from_noise_and_from_drawings() {
        let mut random = Random::new(3);
        for noise in [0.4, 2.0, 6.0] {
            assert!(!looks_copied(|own| own, |_| edge(48.3, noise, &mut random)), "noise of {noise}");
        }
        let mut coded = edge(48.3, 2.0, &mut random);
        let mut copy = |frame| {
            predicted(&mut coded, &edge(48.3, 2.0, &mut random), frame);
            coded.clone()
        };
        assert!(looks_copied(|own| own, &mut copy));
        // Of a coder that is known to predict, and JPEGs that lose more.
        let quantised = |by: Quantisation| move |own: Picture| own.quantised(Some(by.clone()));
        let jpeg = |step: f64| Quantisation::of_steps(step, [step; 3], [SIZE; 2]);
        assert!(looks_copied(quantised(jpeg(4.0)), &mut copy) && !looks_copied(quantised(jpeg(30.0)), &mut copy));
        assert!(!looks_copied(quantised(Quantisation::assumed([SIZE; 2])), &mut copy));
    }

    #[test]
    fn drawings_without_noise_are_not_copies() {
        for swing_px in [0.0, 0.003, 0.02] {
            let at_px = |frame: u32| 48.3 + swing_px * (f64::from(frame) / 5.0).sin();
            assert!(!looks_copied(|own| own, |frame| edge(at_px(frame), 0.0, &mut Random::new(1))), "{swing_px} px");
        }
    }
}
