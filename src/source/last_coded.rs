//! How coarsely each block of a picture was last coded.
//!
//! A coder skips blocks in which nothing changes: they are copied from the pictures before, with the errors that they
//! have there. The quantiser that a stream states for such a block was not used. (In still parts of H.264 recordings it
//! states steps of a half to a sixth of what the block was coded with.)

use super::{Picture, Plane, Quantisation};
use std::ops::Range;

/// Remembers the last picture.
#[derive(Default)]
pub(crate) struct LastCoded {
    levels: Vec<u8>,
    before: Option<Picture>,
}

impl LastCoded {
    /// The quantisation of a picture of which the stream states this much: blocks that show what they showed in the
    /// picture before keep their levels.
    pub(crate) fn quantisation(&mut self, picture: &Picture, mut stated: Quantisation) -> Quantisation {
        let before = self.before.replace(picture.clone()).filter(|before| before.size_px() == picture.size_px());
        let Some(before) = before.filter(|_| self.levels.len() == stated.levels.len()) else {
            self.levels.clone_from(&stated.levels);
            return stated;
        };
        // A block of the same level need not be compared.
        let levels = stated.levels.iter().zip(&self.levels);
        let mut coded: Vec<bool> = levels.map(|(level, before)| level == before).collect();
        for (now, before) in (0..3).filter_map(|i| picture.plane(i).zip(before.plane(i))) {
            compare([&now, &before], &stated, &mut coded);
        }
        for ((level, before), coded) in stated.levels.iter_mut().zip(&mut self.levels).zip(coded) {
            if coded {
                *before = *level;
            } else {
                *level = *before;
            }
        }
        stated
    }
}

/// Compares some rows of each block with those of the picture before. Blocks that differ were `coded`.
fn compare([now, before]: [&Plane<'_>; 2], quantisation: &Quantisation, coded: &mut [bool]) {
    let [width, height] = now.scale.map(|scale| (quantisation.block_px / scale) as usize);
    let (block, inner) = (width * now.step, compared(width));
    let inner = inner.start * now.step..inner.end * now.step;
    let columns = quantisation.columns.max(1) as usize;
    for (j, coded) in coded.chunks_mut(columns).enumerate() {
        for y in compared(height).step_by(APART) {
            let [Some(now), Some(before)] = [now, before].map(|plane| plane.row(j * height + y)) else { continue };
            // A compiler that knows the lengths compares in half the time.
            match (block, &inner) {
                (16, Range { start: 3, end: 13 }) => compare_row([now, before], 16, 3..13, coded),
                (8, Range { start: 1, end: 7 }) => compare_row([now, before], 8, 1..7, coded),
                _ => compare_row([now, before], block, inner.clone(), coded),
            }
        }
    }
}

#[inline(always)]
fn compare_row([now, before]: [&[u8]; 2], block: usize, inner: Range<usize>, coded: &mut [bool]) {
    let (now, before) = (now.chunks_exact(block), before.chunks_exact(block));
    // The picture may end within a block.
    let [end, end_before] = [now.remainder(), before.remainder()];
    let part = inner.start..inner.end.min(end.len());
    if let Some(coded) = coded.get_mut(now.len()) {
        *coded |= end.get(part.clone()) != end_before.get(part);
    }
    for (coded, (now, before)) in coded.iter_mut().zip(now.zip(before)) {
        *coded |= now.get(inner.clone()) != before.get(inner.clone());
    }
}

/// The samples of a block's side that are compared: smoothing of the blocks' edges changes the others in skipped blocks
/// too.
fn compared(side: usize) -> Range<usize> {
    let smoothed = if side >= 16 { 3 } else { 1 };
    smoothed..side.saturating_sub(smoothed)
}

/// Rows from one that is compared to the next: the smallest transform has four.
const APART: usize = 3;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::source::{Colour, PixelFormat};

    const SIZE_PX: [u32; 2] = [40, 24];

    /// A 4:2:0 picture that `luma` and `chroma` draw.
    fn picture(luma: impl Fn(usize, usize) -> u8, chroma: impl Fn(usize, usize) -> u8) -> Picture {
        let draw = |[width, height]: [u32; 2], value: &dyn Fn(usize, usize) -> u8| -> Vec<u8> {
            let places = (0..height as usize).flat_map(|y| (0..width as usize).map(move |x| (x, y)));
            places.map(|(x, y)| value(x, y)).collect()
        };
        let half = SIZE_PX.map(|side| side / 2);
        let planes = vec![draw(SIZE_PX, &luma), draw(half, &chroma), draw(half, &chroma)];
        let format = PixelFormat::Yuv { chroma_log2: [1, 1] };
        Picture::from_planes(SIZE_PX[0], SIZE_PX[1], format, Colour::SRGB, planes).unwrap()
    }

    fn stated(level: u8) -> Quantisation {
        Quantisation { block_px: 16, columns: 3, levels: vec![level; 6], channels: [1.0; 3], predicted: true }
    }

    #[test]
    fn a_block_keeps_its_level_until_it_changes() {
        let noise = |x: usize, y: usize| ((x * 31 + y * 17) % 200) as u8;
        let mut coded = LastCoded::default();
        let mut levels = |picture: &Picture, level: u8| coded.quantisation(picture, stated(level)).levels;
        assert_eq!(levels(&picture(noise, noise), 30), [30; 6]);
        assert_eq!(levels(&picture(noise, noise), 12), [30; 6]);
        // A sub-block of luma, and one of chroma, that are coded anew; the edge of a block that is smoothed.
        let luma = |x: usize, y: usize| noise(x, y) + u8::from((20..24).contains(&x) && (4..8).contains(&y));
        let chroma = |x: usize, y: usize| noise(x, y) + u8::from((4..8).contains(&x) && (8..12).contains(&y));
        assert_eq!(levels(&picture(luma, chroma), 14), [30, 14, 30, 14, 30, 30]);
        let smoothed = |x: usize, y: usize| luma(x, y) + u8::from((13..16).contains(&x));
        assert_eq!(levels(&picture(smoothed, chroma), 16), [30, 14, 30, 14, 30, 30]);
        assert_eq!(levels(&picture(|x, y| noise(x, y) + 1, noise), 18), [18; 6]);
    }

    #[test]
    fn after_a_change_of_size_nothing_is_known() {
        let mut coded = LastCoded::default();
        coded.quantisation(&picture(|_, _| 0, |_, _| 0), stated(30));
        let small = |level| Quantisation { columns: 1, levels: vec![level], ..stated(level) };
        let grey = Picture::from_planes(16, 16, PixelFormat::Grey, Colour::SRGB, vec![vec![0; 256]]).unwrap();
        assert_eq!(coded.quantisation(&grey, small(12)).levels, [12]);
        assert_eq!(coded.quantisation(&grey, small(14)).levels, [12]);
    }
}
