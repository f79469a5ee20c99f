//! The picture as cells of 2x2 pixels: the sum of four samples of each channel, in any format.
//!
//! In subsampled channels each sample counts once for every pixel of the cell that it covers, so that a cell's sums
//! mean the same in all formats. At the right and lower edge of a picture of odd size the last pixel counts twice.

use super::SegmentError;
use crate::source::{LARGEST_SIDE_PX, Picture, Plane};
use multiversion::multiversion;
use nalgebra::Vector2;

/// Cells summed and classified together: as many as an integer has bits.
pub(super) const BLOCK: usize = 32;

/// Sums of one channel over `N` cells, 0..=1020.
pub(super) type Sums<const N: usize> = [i16; N];

/// A picture as cells.
pub(super) struct Grid<'a> {
    planes: [Plane<'a>; 3],
    size_px: [u32; 2],
    chroma_offset_px: Vector2<f64>,
    /// Each cell has one sample of channels 1 and 2.
    chroma_per_cell: bool,
}

impl<'a> Grid<'a> {
    pub(super) fn new(picture: &'a Picture, chroma_offset_px: Vector2<f64>) -> Result<Self, SegmentError> {
        let size_px = picture.size_px();
        if size_px.iter().any(|&n| n > LARGEST_SIDE_PX) {
            return Err(SegmentError::TooLarge(size_px[0], size_px[1]));
        }
        match (picture.plane(0), picture.plane(1), picture.plane(2)) {
            (Some(a), Some(b), Some(c)) => Ok(Self {
                planes: [a, b, c],
                size_px,
                chroma_offset_px,
                chroma_per_cell: b.scale == [2, 2] && c.scale == [2, 2] && b.step == c.step,
            }),
            _ => Err(SegmentError::Grey),
        }
    }

    /// Cells per row.
    pub(super) fn width(&self) -> usize {
        self.size_px[0].div_ceil(2) as usize
    }

    /// Rows of cells.
    pub(super) fn height(&self) -> usize {
        self.size_px[1].div_ceil(2) as usize
    }

    /// Width and height, pixels.
    pub(super) fn size_px(&self) -> [u32; 2] {
        self.size_px
    }

    /// Position of the samples of channels 1 and 2 relative to the centre of their cell, pixels.
    pub(super) fn chroma_shift_px(&self) -> Vector2<f64> {
        let p = &self.planes[1];
        let shift = |scale: u32, offset: f64| offset - (f64::from(scale) - 1.0) / 2.0;
        if p.scale == [1, 1] {
            return Vector2::zeros();
        }
        Vector2::new(shift(p.scale[0], p.offset[0]), shift(p.scale[1], p.offset[1])) + self.chroma_offset_px
    }

    /// One row of cells.
    pub(super) fn row(&self, j: usize) -> CellRow<'a> {
        let width = self.width();
        let [a, b, c] = &self.planes;
        CellRow {
            channels: [RowPair::new(a, j, width), RowPair::new(b, j, width), RowPair::new(c, j, width)],
            chroma_per_cell: self.chroma_per_cell,
        }
    }
}

/// The sums of a picture's cells, taken a block at a time when first asked for: the cells of a component and of the
/// ring around it are asked for again and again.
#[derive(Debug, Default)]
pub(super) struct CellSums {
    /// Per channel; rows end with a block that stays unknown.
    channels: [Vec<i16>; 3],
    /// For each block.
    known: Vec<bool>,
    blocks_per_row: usize,
}

impl CellSums {
    /// Forgets the last picture.
    pub(super) fn clear(&mut self, grid: &Grid<'_>) {
        self.blocks_per_row = grid.width().div_ceil(BLOCK) + 1;
        let blocks = self.blocks_per_row * grid.height();
        self.known.clear();
        self.known.resize(blocks, false);
        self.channels.iter_mut().for_each(|channel| channel.resize(blocks * BLOCK, 0));
    }

    /// Sums of all channels over `cells` cells from cell (x, y) on, at most `N` and within the picture; the rest of
    /// the `N` is arbitrary.
    #[inline(always)]
    pub(super) fn of<const N: usize>(&mut self, grid: &Grid<'_>, x: usize, y: usize, cells: usize) -> [&Sums<N>; 3] {
        let row = y * self.blocks_per_row;
        for block in x / BLOCK..(x + cells).div_ceil(BLOCK) {
            if let Some(known) = self.known.get_mut(row + block)
                && !std::mem::replace(known, true)
            {
                sum(&grid.row(y), block, (row + block) * BLOCK, &mut self.channels);
            }
        }
        let at = row * BLOCK + x;
        let [a, b, c] = &self.channels;
        [part(a, at), part(b, at), part(c, at)]
    }
}

#[inline(always)]
fn part<const N: usize>(channel: &[i16], at: usize) -> &Sums<N> {
    channel.get(at..).and_then(<[_]>::first_chunk).unwrap_or(const { &[0; N] })
}

/// Writes the sums of a block of a row to place `at` of the channels.
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512dq+avx512vl", "x86_64+avx2"))]
fn sum(row: &CellRow<'_>, block: usize, at: usize, channels: &mut [Vec<i16>; 3]) {
    for (channel, sums) in channels.iter_mut().zip(row.sums(block * BLOCK)) {
        if let Some(place) = channel.get_mut(at..at + BLOCK) {
            place.copy_from_slice(&sums);
        }
    }
}

/// One row of cells.
pub(super) struct CellRow<'a> {
    channels: [RowPair<'a>; 3],
    chroma_per_cell: bool,
}

impl CellRow<'_> {
    /// Sums of all channels over the cells from `first` on; cells outside the picture repeat the last one.
    #[inline(always)]
    fn sums(&self, first: usize) -> [Sums<BLOCK>; 3] {
        let [a, b, c] = &self.channels;
        [a.sums(first), b.sums(first), c.sums(first)]
    }

    /// For cells x0..x1, appends the samples of channels 1 and 2 less 128, when each cell has one sample of both;
    /// otherwise appends nothing and returns false.
    pub(super) fn chroma(&self, x0: usize, x1: usize, channels: &mut [Vec<i16>; 3]) -> bool {
        if !self.chroma_per_cell {
            return false;
        }
        for (pair, values) in self.channels.iter().zip(channels).skip(1) {
            match pair.step {
                1 => pair.samples::<1>(x0, x1, values),
                _ => pair.samples::<2>(x0, x1, values),
            }
        }
        true
    }

    /// For cells x0..x1, appends the mean samples of all channels, rounded, less 128.
    pub(super) fn means(&self, x0: usize, x1: usize, channels: &mut [Vec<i16>; 3]) {
        for (pair, values) in self.channels.iter().zip(channels) {
            for first in (x0..x1).step_by(BLOCK) {
                values.extend(pair.sums(first).iter().take(x1 - first).map(|sum| ((sum + 2) >> 2) - 128));
            }
        }
    }
}

/// The two rows of samples of one channel that a row of cells covers.
struct RowPair<'a> {
    top: &'a [u8],
    bottom: &'a [u8],
    step: usize,
    scale_x: usize,
    /// Samples per row.
    samples: usize,
    /// Cells per row.
    cells: usize,
}

impl<'a> RowPair<'a> {
    fn new(plane: &Plane<'a>, j: usize, cells: usize) -> Self {
        let last = plane.height.saturating_sub(1);
        let scale = plane.scale[1].max(1) as usize;
        let row = |y: usize| {
            let start = (y / scale).min(last) * plane.stride;
            let length = plane.width.saturating_sub(1) * plane.step + 1;
            plane.data.get(start..start + length).unwrap_or_default()
        };
        Self {
            top: row(2 * j),
            bottom: row(2 * j + 1),
            step: plane.step,
            scale_x: plane.scale[0].max(1) as usize,
            samples: plane.width,
            cells,
        }
    }

    #[inline(always)]
    fn sums(&self, first: usize) -> Sums<BLOCK> {
        let fast = match (self.scale_x, self.step) {
            (1, 1) => self.whole_block::<2, 1>(first),
            (1, 3) => self.whole_block::<6, 3>(first),
            (1, 4) => self.whole_block::<8, 4>(first),
            (2, 1) => self.whole_block::<1, 0>(first),
            (2, 2) => self.whole_block::<2, 0>(first),
            _ => None,
        };
        fast.unwrap_or_else(|| self.any_block(first))
    }

    /// Sums where a cell takes `BYTES` of a row and has its samples at bytes 0 and `SECOND`; `None` near the edge.
    #[inline(always)]
    fn whole_block<const BYTES: usize, const SECOND: usize>(&self, first: usize) -> Option<Sums<BLOCK>> {
        let range = first * BYTES..(first + BLOCK) * BYTES;
        let (top, _) = self.top.get(range.clone())?.as_chunks::<BYTES>();
        let (bottom, _) = self.bottom.get(range)?.as_chunks::<BYTES>();
        let mut sums = [0; BLOCK];
        for (sum, (t, b)) in sums.iter_mut().zip(top.iter().zip(bottom)) {
            *sum = i16::from(t[0]) + i16::from(t[SECOND]) + i16::from(b[0]) + i16::from(b[SECOND]);
        }
        Some(sums)
    }

    fn any_block(&self, first: usize) -> Sums<BLOCK> {
        let at = |row: &[u8], x: usize| {
            let sample = (x / self.scale_x).min(self.samples.saturating_sub(1));
            row.get(sample * self.step).map_or(0, |&v| i16::from(v))
        };
        let mut sums = [0; BLOCK];
        for (k, sum) in sums.iter_mut().enumerate() {
            let x = 2 * (first + k).min(self.cells.saturating_sub(1));
            *sum = at(self.top, x) + at(self.top, x + 1) + at(self.bottom, x) + at(self.bottom, x + 1);
        }
        sums
    }

    /// Appends one sample per cell, `STEP` bytes apart, less 128.
    #[inline]
    fn samples<const STEP: usize>(&self, x0: usize, x1: usize, values: &mut Vec<i16>) {
        let (samples, rest) = self.top.get(x0 * STEP..).unwrap_or_default().as_chunks::<STEP>();
        values.extend(samples.iter().take(x1 - x0).map(|sample| i16::from(sample[0]) - 128));
        // The last sample of a row may be followed by nothing.
        values.extend(rest.first().filter(|_| samples.len() < x1 - x0).map(|&sample| i16::from(sample) - 128));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::source::PixelFormat;
    use crate::testing::bands::{VIDEO, YUV420};

    #[test]
    fn sums_are_those_of_any_block() {
        let (width, height) = (131, 5);
        let mut random = fastrand::Rng::with_seed(1);
        let mut sums = CellSums::default();
        for (format, chroma) in [(YUV420, 66 * 3), (PixelFormat::Yuv { chroma_log2: [0, 0] }, 131 * 5)] {
            let planes = [131 * 5, chroma, chroma].map(|n| (0..n).map(|_| random.u8(..)).collect::<Vec<_>>());
            let picture = Picture::from_planes(width, height, format, VIDEO, planes.to_vec()).unwrap();
            let grid = Grid::new(&picture, Vector2::zeros()).unwrap();
            // The second picture is not mixed up with the first.
            sums.clear(&grid);
            for y in 0..grid.height() {
                let row = grid.row(y);
                for (x, cells) in (0..grid.width()).flat_map(|x| (1..=8).map(move |cells| (x, cells))) {
                    let cells = cells.min(grid.width() - x);
                    for (found, pair) in sums.of::<8>(&grid, x, y, cells).iter().zip(&row.channels) {
                        assert_eq!(found[..cells], pair.any_block(x)[..cells], "{cells} cells from ({x}, {y}) on");
                    }
                }
            }
        }
    }
}
