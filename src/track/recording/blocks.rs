//! Small blocks of pixels around a band that rests, compared from frame to frame.

use crate::source::{Picture, PixelFormat, Window};
use std::collections::{BTreeMap, VecDeque};

/// Side of a block: that of a JPEG's; coders that predict have such or larger ones.
pub(super) const SIDE: usize = 8;
/// Surroundings of a band that are looked at, pixels.
const AROUND_PX: u32 = 16;

/// The samples of a block, row after row.
pub(super) type Block = [u8; SIDE * SIDE];

/// The sum of the differences of all samples, and that of their squares.
pub(super) fn differences(one: &Block, other: &Block) -> (i32, i32) {
    let differences = one.iter().zip(other).map(|(a, b)| i32::from(*a) - i32::from(*b));
    differences.fold((0, 0), |(sum, squares), d| (sum + d, squares + d * d))
}

/// Frames in which blocks are compared.
const FRAMES: u32 = 120;
/// How many frames before is the earlier one that a block is compared with.
const EARLIER: usize = 4;

/// The blocks of the last frames.
#[derive(Debug, Default)]
pub(in crate::track) struct Blocks {
    last: BTreeMap<[u32; 2], Last>,
    frames: u64,
    compared: u32,
}

/// A block of the last frames in a row, newest first, and when the newest was.
#[derive(Debug, Default)]
struct Last {
    samples: VecDeque<Block>,
    frame: u64,
}

/// A block, the same in the frame before, and four frames before.
#[derive(Debug)]
pub(in crate::track) struct Compared {
    /// The pixel at which it begins.
    pub corner: [u32; 2],
    pub now: Block,
    pub before: Block,
    pub earlier: Block,
}

impl Blocks {
    /// Adds a picture: luma, or green, of all blocks around windows. What it is compared with; nothing once enough was,
    /// and for one that shows the picture before `again`, which tells nothing and is asked only until then.
    pub(in crate::track) fn add(
        &mut self,
        picture: &Picture,
        windows: impl Iterator<Item = Window>,
        again: impl FnOnce() -> bool,
    ) -> Vec<Compared> {
        if self.compared == FRAMES || again() {
            return Vec::new();
        }
        let around = windows.map(|window| window.grown(AROUND_PX, SIDE as u32).clipped(picture.size_px()));
        // Recorded windows may end before.
        let read = around.filter(|window| picture.declare_read(*window).is_ok());
        let corners = read.flat_map(|window| {
            let columns = (window.x0..window.x1).step_by(SIDE);
            (window.y0..window.y1).step_by(SIDE).flat_map(move |y| columns.clone().map(move |x| [x, y]))
        });
        // Windows may overlap.
        let blocks: BTreeMap<[u32; 2], Block> =
            corners.filter_map(|corner| Some((corner, block(picture, corner)?))).collect();
        self.frames += 1;
        let mut compared = Vec::new();
        for (corner, now) in blocks {
            let Last { samples, frame } = self.last.entry(corner).or_default();
            if self.frames != *frame + 1 {
                samples.clear();
            }
            if let (Some(before), Some(earlier)) = (samples.front(), samples.get(EARLIER - 1)) {
                compared.push(Compared { corner, now, before: *before, earlier: *earlier });
            }
            samples.push_front(now);
            samples.truncate(EARLIER);
            *frame = self.frames;
        }
        self.compared += u32::from(!compared.is_empty());
        if self.compared == FRAMES {
            self.last = BTreeMap::new();
        }
        compared
    }
}

/// `None` where it is not wholly inside.
fn block(picture: &Picture, [x, y]: [u32; 2]) -> Option<Block> {
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
