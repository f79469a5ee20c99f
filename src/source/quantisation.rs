//! How coarsely a coder quantised a picture.
//!
//! A coder rounds the coefficients of its transform to whole steps, and drops what is not worth the bits. The stream
//! states the steps, block by block; libav's decoders export them for H.264, VP9, MPEG-2 and MPEG-4. Of H.265 and AV1
//! the headers state one for the whole picture (headers.rs), of JPEG the tables (jpeg). The transforms are orthonormal,
//! so a step of a coefficient is also one of stored values.

use ffmpeg_the_third::frame::Video;
use ffmpeg_the_third::frame::side_data::Type;

use super::jpeg::Steps;

/// Quantiser steps, block by block. A level q means a step of 2^((q − 4) / 6) stored units, as in H.264 (ITU-T H.264,
/// table 8-15): six levels double it.
#[derive(Debug, Clone, PartialEq)]
pub struct Quantisation {
    /// Side of a block, pixels.
    pub block_px: u32,
    /// Blocks per row.
    pub columns: u32,
    /// Levels, row-major.
    pub levels: Vec<u8>,
    /// Steps of the stored channels, relative to those of the levels.
    pub channels: [f64; 3],
    /// Whether pictures are predicted from others, so that errors may persist.
    pub predicted: bool,
}

/// What a packet states of its quantiser.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Stated {
    /// A JPEG: its tables.
    Jpeg(Steps),
    /// The level of the whole picture.
    Level(u8),
}

/// Step of a level, stored units.
fn step(level: u8) -> f64 {
    ((f64::from(level) - 4.0) / 6.0).exp2()
}

/// The level nearest to a step.
fn level(step: f64) -> u8 {
    // `as` saturates.
    (4.0 + 6.0 * step.max(1e-3).log2()).round() as u8
}

impl Quantisation {
    /// Step of luma at a pixel, stored units; `None` when it lies outside.
    pub fn step_at(&self, [x, y]: [u32; 2]) -> Option<f64> {
        let [column, row] = [x, y].map(|at| at / self.block_px);
        let level = self.levels.get(row as usize * self.columns as usize + column as usize);
        Some(step(*level.filter(|_| column < self.columns)?))
    }

    /// Steps of the stored channels there.
    pub fn steps_at(&self, pixel: [u32; 2]) -> Option<[f64; 3]> {
        let step = self.step_at(pixel)?;
        Some(self.channels.map(|by| by * step))
    }

    /// Whether its steps are larger than another's, as far as the first block tells.
    pub(crate) fn is_coarser_than(&self, other: &Self) -> bool {
        self.step_at([0, 0]) > other.step_at([0, 0])
    }

    /// The same level in all blocks of a picture that may be predicted from others.
    pub(crate) fn of_level(level: u8, [width, height]: [u32; 2]) -> Self {
        let columns = width.div_ceil(BLOCK_PX);
        let levels = vec![level; columns as usize * height.div_ceil(BLOCK_PX) as usize];
        Self { block_px: BLOCK_PX, columns, levels, channels: [1.0; 3], predicted: true }
    }

    /// The same steps everywhere, in an intra-coded picture, of luma and of each stored channel.
    pub(crate) fn of_steps(luma: f64, channels: [f64; 3], size_px: [u32; 2]) -> Self {
        let level = level(luma);
        let channels = channels.map(|channel| channel / step(level));
        Self { predicted: false, channels, ..Self::uniform(level, size_px) }
    }

    fn uniform(level: u8, [width, height]: [u32; 2]) -> Self {
        Self {
            block_px: width.max(height).max(1),
            columns: 1,
            levels: vec![level],
            channels: [1.0; 3],
            predicted: true,
        }
    }

    /// Assumed for a coder whose quantisation is unknown: what H.264 has around edges at crf 22 or so.
    pub(crate) fn assumed(size_px: [u32; 2]) -> Self {
        Self::uniform(ASSUMED, size_px)
    }

    /// The quantisation that the decoder exports for a frame with samples of so many bits, for its samples reduced to
    /// 8; `None` when it exports none, and for lossless pictures.
    pub(crate) fn of(frame: &Video, bits: i32) -> Option<Self> {
        let data = frame.side_data(Type::VIDEO_ENC_PARAMS)?;
        Self::parsed(data.data(), [frame.width(), frame.height()], bits)
    }

    /// From libav's `AVVideoEncParams`, which states where its blocks start and how large they are.
    fn parsed(data: &[u8], [width, height]: [u32; 2], bits: i32) -> Option<Self> {
        const WORD: usize = size_of::<usize>();
        let int = |at: usize| Some(i32::from_ne_bytes(data.get(at..at + 4)?.try_into().ok()?));
        let size = |at: usize| Some(usize::from_ne_bytes(data.get(at..at + WORD)?.try_into().ok()?));
        let count = usize::try_from(int(0)?).ok()?;
        let (first, length) = (size(WORD)?, size(2 * WORD)?);
        let (kind, base) = (int(3 * WORD)?, int(3 * WORD + 4)?);
        let level_of: fn(i32) -> u8 = match kind {
            VP9 => |index| vp9_level(index.into()),
            H264 => |qp| h26x_level(qp.into()),
            // Steps of 2 q where the matrix is flat (ITU-T H.263, 6.2.1).
            MPEG2 => |q| level(2.0 * f64::from(q)),
            _ => return None,
        };
        // libav's quantiser of H.264 is QP' (ITU-T H.264, 7.4.5): its steps are those of samples with all their bits.
        let base = if kind == H264 { base.saturating_sub(6 * (bits - 8)) } else { base };
        let mut all = Self::of_level(level_of(base), [width, height]);
        let Self { columns, levels, .. } = &mut all;
        // Neighbours often have the same quantiser.
        let mut last = (0, level_of(base));
        for i in 0..count {
            let at = first.checked_add(i.checked_mul(length)?)?;
            let block: &[_; 5] = data.get(at..)?.as_chunks().0.first_chunk()?;
            let [x, y, w, h, beyond_base] = block.map(i32::from_ne_bytes);
            let [x, y, w, h] = [x, y, w, h].map(|v| v.max(0).cast_unsigned());
            if last.0 != beyond_base {
                last = (beyond_base, level_of(base.saturating_add(beyond_base)));
            }
            let of_row = |row: u32| {
                let column = |x: u32| row as usize * *columns as usize + x as usize;
                column(x / BLOCK_PX)..column(x.saturating_add(w).min(width).div_ceil(BLOCK_PX))
            };
            for row in (y / BLOCK_PX)..y.saturating_add(h).min(height).div_ceil(BLOCK_PX) {
                if let Some(levels) = levels.get_mut(of_row(row)) {
                    levels.fill(last.1);
                }
            }
        }
        Some(all)
    }
}

/// Level assumed for a coder that does not state it.
const ASSUMED: u8 = 29;
/// Side of a macroblock.
const BLOCK_PX: u32 = 16;
/// `AVVideoEncParamsType`.
const VP9: i32 = 0;
const H264: i32 = 1;
const MPEG2: i32 = 2;

/// The level of a quantiser of H.264 or H.265.
pub(super) fn h26x_level(qp: i64) -> u8 {
    qp.clamp(0, 51) as u8
}

/// The level of VP9's quantiser, and AV1's, for an index of 0 to 255.
pub(super) fn vp9_level(index: i64) -> u8 {
    level(vp9_step(index))
}

/// Step of that quantiser: its table for coefficients other than the mean, eight times as large (VP9
/// Bitstream Specification 0.6, `ac_qlookup`), is matched to within 10 %.
fn vp9_step(index: i64) -> f64 {
    let i = index.clamp(0, 255) as f64;
    if i <= 95.0 { (i + 7.0) / 8.0 } else { 102.0 / 8.0 * ((i - 95.0) * VP9_GROWTH).exp() }
}

/// From 102 at index 95 to 1828 at 255.
const VP9_GROWTH: f64 = 0.018_04;

#[cfg(test)]
mod tests {
    use super::*;

    /// libav's structure: a macroblock pair of its own beside a base level.
    fn encoded(kind: i32, base: i32, blocks: &[[i32; 5]]) -> Vec<u8> {
        let word = |n: usize| n.to_ne_bytes().to_vec();
        let mut bytes = word(blocks.len());
        bytes.extend(word(4 * size_of::<usize>() + 40));
        bytes.extend(word(20));
        bytes.extend([kind, base].iter().flat_map(|v| v.to_ne_bytes()));
        bytes.resize(4 * size_of::<usize>() + 40, 0);
        bytes.extend(blocks.iter().flatten().flat_map(|v| v.to_ne_bytes()));
        bytes
    }

    #[test]
    fn the_step_at_a_pixel_is_that_of_its_block() {
        let bytes = encoded(H264, 22, &[[16, 0, 16, 16, 6], [0, 16, 32, 16, -6]]);
        let found = Quantisation::parsed(&bytes, [40, 30], 8).unwrap();
        assert_eq!((found.columns, &found.levels), (3, &vec![22, 28, 22, 16, 16, 22]));
        // H.264, table 8-15: level 22 has a step of 8, six more double it.
        for (pixel, step) in [([0, 0], 8.0), ([16, 0], 16.0), ([31, 15], 16.0), ([4, 20], 4.0), ([39, 29], 8.0)] {
            let at = found.steps_at(pixel).unwrap();
            assert!(at.iter().all(|at| (at - step).abs() < 1e-9), "{pixel:?}: {at:?}");
        }
        assert_eq!([found.steps_at([48, 0]), found.steps_at([0, 32])], [None, None]);
        // Of 10 bits: the same steps are a quarter as large in 8.
        let deep = encoded(H264, 22 + 12, &[[16, 0, 16, 16, 6], [0, 16, 32, 16, -6]]);
        assert_eq!(Quantisation::parsed(&deep, [40, 30], 10), Some(found));
    }

    #[test]
    fn without_blocks_the_base_holds_everywhere_and_what_is_cut_off_says_nothing() {
        let step = |kind, base| {
            let found = Quantisation::parsed(&encoded(kind, base, &[]), [640, 480], 8).unwrap();
            assert_eq!(found.steps_at([0, 0]), found.steps_at([639, 479]));
            found.steps_at([0, 0]).unwrap()[0]
        };
        assert!((step(MPEG2, 4) / 8.0 - 1.0).abs() < 0.06);
        // VP9's table: 32 at index 25, 203 at 137, 1828 at 255.
        for (index, eighths) in [(25, 32.0), (137, 203.0), (255, 1828.0)] {
            assert!((step(VP9, index) * 8.0 / eighths - 1.0).abs() < 0.15, "{index}: {}", step(VP9, index) * 8.0);
        }
        let bytes = encoded(H264, 22, &[[0, 0, 16, 16, 6]]);
        for cut in 0..bytes.len() {
            assert_eq!(Quantisation::parsed(&bytes[..cut], [32, 32], 8), None, "{cut} bytes");
        }
        assert_eq!(Quantisation::parsed(&encoded(9, 22, &[]), [32, 32], 8), None);
    }
}
