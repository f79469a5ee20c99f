//! Whether pictures with full chroma were made from ones with subsampled chroma.
//!
//! Most programs that turn a video into RGB give both pixels of a pair the same chroma. What the video's coder lost is
//! then lost in these pictures too, and nothing in their files says so. Compared, around all bands so far: changes of
//! chroma from one pixel to the next, within pairs and between them. In a camera's own RGB their squares differ by less
//! than a third; in converted pictures there are none within pairs.
//!
//! Cannot detect: chroma that was interpolated, and pictures that were resized after the conversion.

use crate::segment::Blob;
use crate::source::{Picture, Window};

/// Changes are smaller where chroma is the same: by rounding alone, a hundredth of the others' squares.
const MOST_WITHIN: f64 = 0.05;
/// Squares that tell: those of a dim band, whose chroma is ten stored units from its surroundings'.
const LEAST_BETWEEN: f64 = 1000.0;
/// Pixels beside a blob in which chroma changes; the segmentation has read them.
const BESIDE_PX: u32 = 2;

/// Squared changes of chroma from a pixel to the next: from an even column, and from an odd one.
#[derive(Debug, Default)]
pub(in crate::track) struct Pairs {
    changes: [f64; 2],
}

impl Pairs {
    /// Adds the surroundings of blobs, if the picture has full chroma.
    pub(in crate::track) fn add(&mut self, picture: &Picture, blobs: &[Blob]) {
        for blob in blobs {
            // Other pictures tell nothing.
            let _ = self.add_window(picture, &blob.bounds);
        }
    }

    /// `None` when the picture has no full chroma.
    fn add_window(&mut self, picture: &Picture, bounds: &Window) -> Option<()> {
        let planes = [picture.plane(0)?, picture.plane(1)?, picture.plane(2)?];
        if picture.format().is_subsampled() {
            return None;
        }
        let [width, height] = picture.size_px();
        let (from, to) = (bounds.x0.saturating_sub(BESIDE_PX), (bounds.x1 + BESIDE_PX).min(width));
        for y in bounds.y0..bounds.y1.min(height) {
            let rows = [planes[0].row(y as usize)?, planes[1].row(y as usize)?, planes[2].row(y as usize)?];
            let stored = |c: usize, x: u32| rows[c].get(x as usize * planes[c].step).map(|v| f64::from(*v));
            let chroma = |x: u32| {
                let [a, b, c] = [stored(0, x)?, stored(1, x)?, stored(2, x)?];
                Some(if picture.format().is_yuv() { [b, c] } else { [a - b, c - b] })
            };
            let mut last = chroma(from)?;
            for x in from + 1..to {
                let next = chroma(x)?;
                let change = (next[0] - last[0]).powi(2) + (next[1] - last[1]).powi(2);
                self.changes[usize::from(x % 2 == 0)] += change;
                last = next;
            }
        }
        Some(())
    }

    /// Whether both pixels of each pair have the same chroma. Pictures that were cut may begin with the second of a
    /// pair.
    pub(in crate::track) fn are_alike(&self) -> bool {
        let [even, odd] = self.changes;
        even.max(odd) > LEAST_BETWEEN && even.min(odd) < MOST_WITHIN * even.max(odd)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulate::Sensor;
    use crate::source::{Colour, PixelFormat};
    use crate::testing::two_views::Tube;
    use nalgebra::Vector3;

    /// The chroma of each pixel, or of the first of each pair, from a column on.
    fn copied(from: &Picture, pairs_from: Option<usize>) -> Picture {
        let [width, height] = from.size_px();
        let of = |c: usize, x: usize, y: usize| {
            let plane = from.plane(c).unwrap();
            f64::from(plane.row(y).unwrap()[x * plane.step])
        };
        let luma = |x: usize, y: usize| 0.2126 * of(0, x, y) + 0.7152 * of(1, x, y) + 0.0722 * of(2, x, y);
        let value = |c: usize, x: usize, y: usize| {
            let first = pairs_from.map_or(x, |at| if x < at { x } else { x - (x - at) % 2 });
            (luma(x, y) + of(c, first, y) - luma(first, y)).round().clamp(0.0, 255.0) as u8
        };
        let places = || (0..height as usize).flat_map(|y| (0..width as usize).map(move |x| (x, y)));
        let planes = (0..3).map(|c| places().map(|(x, y)| value(c, x, y)).collect()).collect();
        Picture::from_planes(width, height, PixelFormat::RgbPlanar, from.colour(), planes).unwrap()
    }

    #[test]
    fn pictures_whose_pairs_have_one_chroma_are_told_from_a_camera_s_own() {
        let directions = [Vector3::new(0.1, 1.0, 0.05), Vector3::new(0.0, 1.0, 0.0), Vector3::new(-0.4, 1.0, 0.2)];
        for (seed, direction) in directions.into_iter().enumerate() {
            let own = Tube::along(direction).picture(Sensor::default(), seed as u64);
            let [width, height] = own.size_px();
            let alike = |picture: &Picture| {
                let mut pairs = Pairs::default();
                pairs.add_window(picture, &Window { x0: 0, y0: 0, x1: width, y1: height }).unwrap();
                pairs.are_alike()
            };
            assert!(!alike(&own) && !alike(&copied(&own, None)), "{direction}");
            assert!(alike(&copied(&own, Some(0))) && alike(&copied(&own, Some(1))), "{direction}");
        }
    }

    #[test]
    fn grey_and_subsampled_pictures_tell_nothing() {
        let subsampled = (PixelFormat::Yuv { chroma_log2: [1, 1] }, vec![vec![9; 8], vec![1, 200], vec![1, 200]]);
        let grey = (PixelFormat::Grey, vec![vec![1, 1, 200, 200, 1, 1, 200, 200]]);
        for (format, planes) in [subsampled, grey] {
            let picture = Picture::from_planes(4, 2, format, Colour::SRGB, planes).unwrap();
            let mut pairs = Pairs::default();
            assert_eq!(pairs.add_window(&picture, &Window { x0: 0, y0: 0, x1: 4, y1: 2 }), None);
            assert!(!pairs.are_alike());
        }
    }
}
