//! Notices pictures that are a copy of a video whose coder predicted pictures from each other: stored again without
//! losses, or as JPEGs. What that coder lost is lost in them too, and nothing in their files says so.
//!
//! Method. A coder that predicts leaves what hardly changed as it was, to the last bit, until that costs too much. A
//! sensor's noise changes every part of every picture. Compared: small blocks with contrast around the base band, which
//! rests, from frame to frame. In a copy they repeat, or change by more than rounding, now this and now that: in 0.05
//! to 0.27 of the comparisons both are as frequent, in copies of H.264 at crf 18 to 23. Without losses it is none, and
//! 0.01 in simulated pictures without noise, which change by rounding alone where the tube hardly moves. A JPEG of
//! little noise repeats by chance, too, but it comes back to what it was: four frames later it is as often the same, or
//! another, as one frame later. What a coder has changed stays: four frames later it is another more often.
//!
//! What is lost is then assumed to be what is usual, as for a coder whose quantisation is unknown. JPEGs of a quality
//! that loses more themselves keep their own.
//!
//! Cannot detect: copies of finely coded videos (crf 14), of videos that were resized or turned, and noise that was
//! added later. A camera that reduces noise over time looks the same.

use crate::source::{Picture, Quantisation};
use crate::track::recording::blocks::{Compared, differences};
use std::collections::BTreeMap;

/// Least contrast of a block that tells, stored units: JPEG makes flatter ones equal.
const CONTRAST: u8 = 24;
/// Fewest comparisons that tell.
const LEAST: f64 = 200.0;
/// Least part of the comparisons in which a block was as before, or in which it was not, whichever are fewer.
const MIXED: f64 = 0.03;
/// Least squares of a block's changes: a coder that corrects a block changes it by its step, and one of 4 stored units
/// does no harm.
const CHANGED: i32 = 16;
/// How many times as often blocks are another after four frames as after one, counted by the rarer of both, at least,
/// and by how many standard deviations. Measured: 1.55 to 3.7 in copies, 1.0 to 1.45 in JPEGs.
const STAYS: f64 = 1.4;
const CLEAR_SD: f64 = 3.0;

/// The blocks so far.
#[derive(Debug, Default)]
pub(in crate::track) struct Copied {
    blocks: BTreeMap<[u32; 2], Count>,
    from: Option<Quantisation>,
}

/// In how many frames a block was as in the one before, and was not; and the same of the one four before.
#[derive(Debug, Default)]
struct Count {
    same: u32,
    changed: u32,
    same_later: u32,
    changed_later: u32,
}

impl Count {
    /// Counts of one kind that say that changes stay, and that they do not: equally many by chance.
    fn stay(&self) -> [u32; 2] {
        match self.same < self.changed {
            true => [self.same, self.same_later],
            false => [self.changed_later, self.changed],
        }
    }

    fn add([same, changed]: [&mut u32; 2], squares: i32) {
        match squares {
            0 => *same += 1,
            CHANGED.. => *changed += 1,
            _ => {}
        }
    }
}

impl Copied {
    /// What is assumed of the first coder's quantisation, if the pictures are a copy.
    pub(in crate::track) fn from(&self) -> Option<&Quantisation> {
        self.from.as_ref()
    }

    /// Adds the blocks of a picture whose coder does not predict.
    pub(in crate::track) fn add(&mut self, picture: &Picture, blocks: &[Compared]) {
        let own = picture.quantisation();
        if blocks.is_empty() || self.from.is_some() {
            return;
        }
        let assumed = Quantisation::assumed(picture.size_px());
        if own.is_some_and(|own| !assumed.is_coarser_than(own)) {
            return;
        }
        for Compared { corner, now, before, earlier } in blocks {
            let (darkest, brightest) = now.iter().fold((u8::MAX, 0), |(a, b), v| (a.min(*v), b.max(*v)));
            if brightest - darkest < CONTRAST {
                continue;
            }
            let Count { same, changed, same_later, changed_later } = self.blocks.entry(*corner).or_default();
            Count::add([same, changed], differences(now, before).1);
            Count::add([same_later, changed_later], differences(now, earlier).1);
        }
        let sum = |of: &dyn Fn(&Count) -> u32| f64::from(self.blocks.values().map(of).sum::<u32>());
        let all = sum(&|block| block.same + block.changed);
        let mixed = sum(&|block| block.same.min(block.changed));
        let [stay, not] = [0, 1].map(|kind| sum(&|block| block.stay()[kind]));
        let stays = stay > STAYS * not && stay - not > CLEAR_SD * (stay + not).sqrt();
        if all >= LEAST && mixed >= MIXED * all && stays {
            self.from = Some(assumed);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::source::{Colour, PixelFormat, Window};
    use crate::testing::random::Random;
    use crate::track::recording::blocks::{Blocks, SIDE};

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
        let (mut copied, mut blocks, mut before) = (Copied::default(), Blocks::default(), Vec::new());
        for frame in 0..60 {
            let luma = samples(frame);
            let again = luma == before;
            before.clone_from(&luma);
            let own = Picture::from_planes(SIZE, SIZE, PixelFormat::Grey, Colour::SRGB, vec![luma]).unwrap();
            let own = picture(own);
            copied.add(&own, &blocks.add(&own, [BASE].into_iter(), || again));
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
        // JPEGs that lose more.
        let quantised = |by: Quantisation| move |own: Picture| own.quantised(Some(by.clone()));
        let jpeg = |step: f64| Quantisation::of_steps(step, [step; 3], [SIZE; 2]);
        assert!(looks_copied(quantised(jpeg(4.0)), &mut copy) && !looks_copied(quantised(jpeg(30.0)), &mut copy));
    }

    /// Of little noise a JPEG leaves one coefficient of some blocks, in some pictures.
    #[test]
    fn jpegs_that_come_back_to_what_they_were_are_no_copies() {
        let mut random = Random::new(9);
        let blocks = SIZE as usize / SIDE;
        for often in [0.1, 0.3, 0.5] {
            let jpeg = |_| {
                let left: Vec<u8> = (0..blocks * blocks).map(|_| u8::from(random.uniform() < often) * 4).collect();
                let mut samples = edge(48.3, 0.0, &mut Random::new(1));
                for (i, sample) in samples.iter_mut().enumerate() {
                    let (x, y) = (i % SIZE as usize, i / SIZE as usize);
                    *sample += left[y / SIDE * blocks + x / SIDE];
                }
                samples
            };
            assert!(!looks_copied(|own| own, jpeg), "{often}");
        }
    }

    /// A rate raised from 58 to 60, or doubled, while the base rests.
    #[test]
    fn pictures_shown_twice_are_not_copies() {
        for every in [2, 20, 30] {
            let (mut random, mut shown) = (Random::new(4), Vec::new());
            let samples = |frame: u32| {
                if shown.is_empty() || !frame.is_multiple_of(every) || frame == 0 {
                    shown = edge(48.3, 2.0, &mut random);
                }
                shown.clone()
            };
            assert!(!looks_copied(|own| own, samples), "every {every}th");
        }
    }

    #[test]
    fn drawings_without_noise_are_not_copies() {
        for swing_px in [0.0, 0.003, 0.02] {
            let at_px = |frame: u32| 48.3 + swing_px * (f64::from(frame) / 5.0).sin();
            assert!(!looks_copied(|own| own, |frame| edge(at_px(frame), 0.0, &mut Random::new(1))), "{swing_px} px");
        }
    }
}
