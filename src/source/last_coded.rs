//! How coarsely each block of a picture was last coded.
//!
//! A coder skips blocks in which nothing changes: they are copied from the pictures before, with the errors that they
//! have there. The quantiser that a stream states for such a block was not used. (In still parts of H.264 recordings it
//! states steps of a half to a sixth of what the block was coded with.)

use super::{Picture, Plane, Quantisation};
use std::hint::black_box;
use std::ops::Range;

/// Remembers the last picture.
#[derive(Default)]
pub(crate) struct LastCoded {
    size_px: [u32; 2],
    levels: Vec<u8>,
    /// Of each block, a checksum of what it showed: a picture that another core has decoded is slow to read.
    shown: Vec<u64>,
}

impl LastCoded {
    /// The quantisation of a picture of which the stream states this much: blocks that show what they showed in the
    /// picture before keep their levels.
    pub(crate) fn quantisation(&mut self, picture: &Picture, mut stated: Quantisation) -> Quantisation {
        let mut shown = vec![0; stated.levels.len()];
        for plane in (0..3).filter_map(|i| picture.plane(i)) {
            add(&plane, &stated, &mut shown);
        }
        let before = std::mem::replace(&mut self.shown, shown);
        let size_before_px = std::mem::replace(&mut self.size_px, picture.size_px());
        if before.len() != self.shown.len() || size_before_px != self.size_px {
            self.levels.clone_from(&stated.levels);
            return stated;
        }
        let is_kept = self.shown.iter().zip(&before).map(|(now, before)| now == before);
        for ((level, before), is_kept) in stated.levels.iter_mut().zip(&mut self.levels).zip(is_kept) {
            if is_kept {
                *level = *before;
            } else {
                *before = *level;
            }
        }
        stated
    }
}

/// Adds some rows of each block to its checksum.
fn add(plane: &Plane<'_>, quantisation: &Quantisation, shown: &mut [u64]) {
    let [width, height] = plane.scale.map(|scale| (quantisation.block_px / scale) as usize);
    let (block, inner) = (width * plane.step, added(width));
    let inner = inner.start * plane.step..inner.end * plane.step;
    let columns = quantisation.columns.max(1) as usize;
    for (j, shown) in shown.chunks_mut(columns).enumerate() {
        let rows = || added(height).step_by(APART).filter_map(|y| plane.row(j * height + y));
        rows().for_each(fetch);
        for row in rows() {
            // A compiler that knows the lengths needs half the time.
            match (block, &inner) {
                (16, Range { start: 3, end: 13 }) => add_row(row, 16, 3..13, shown),
                (8, Range { start: 1, end: 7 }) => add_row(row, 8, 1..7, shown),
                _ => add_row(row, block, inner.clone(), shown),
            }
        }
    }
}

/// Has a row brought near: one access to each cache line, all of them under way at once. What another core has decoded
/// comes slowly, and the checksum itself would wait for one line after the other.
fn fetch(row: &[u8]) {
    const LINE: usize = 64;
    black_box(row.iter().step_by(LINE).fold(0, |all, sample| all | sample));
}

#[inline(always)]
fn add_row(row: &[u8], block: usize, inner: Range<usize>, shown: &mut [u64]) {
    let blocks = row.chunks_exact(block);
    // The picture may end within a block.
    let end = blocks.remainder();
    if let (Some(sum), Some(part)) = (shown.get_mut(blocks.len()), end.get(inner.start..inner.end.min(end.len()))) {
        *sum = with(*sum, part);
    }
    for (sum, block) in shown.iter_mut().zip(blocks) {
        *sum = block.get(inner.clone()).map_or(*sum, |part| with(*sum, part));
    }
}

/// A checksum and some bytes more: other samples practically always give another sum.
#[inline(always)]
fn with(sum: u64, bytes: &[u8]) -> u64 {
    // An odd number without a pattern: 2⁶⁴ over the golden ratio.
    const FACTOR: u64 = 0x9e37_79b9_7f4a_7c15;
    let (words, rest) = bytes.as_chunks::<8>();
    let mut last = [0; 8];
    last[..rest.len()].copy_from_slice(rest);
    let words = words.iter().chain([&last]).map(|word| u64::from_le_bytes(*word));
    words.fold(sum, |sum, word| (sum.rotate_left(29) ^ word).wrapping_mul(FACTOR))
}

/// The samples of a block's side that are looked at: smoothing of the blocks' edges changes the others in skipped
/// blocks too.
fn added(side: usize) -> Range<usize> {
    let smoothed = if side >= 16 { 3 } else { 1 };
    smoothed..side.saturating_sub(smoothed)
}

/// Rows from one that is looked at to the next: the smallest transform has four.
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
