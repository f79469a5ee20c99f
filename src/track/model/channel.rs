//! Stored channels, and their values where chroma lies beside its pixels.
//!
//! Pictures with colour for each pixel are often made from others, and the program that does it may copy chroma to
//! pixels that it does not belong to. A channel is luma and chroma: R = Y + (R − Y). Of each pixel, luma is taken as it
//! is, and chroma from where that of the pixel lies, between pixels by Lanczos' kernel of three lobes (Duchon 1979,
//! doi:10.1175/1520-0450(1979)018<1016:LFIOAT>2.0.CO;2). So the channels remain those that are stored, with their
//! noise.

use crate::source::{Colour, Picture, PixelFormat, Plane, Range};
use std::f64::consts::PI;

/// A stored channel: number, weights of R'G'B', constant.
#[derive(Debug, Clone, Copy)]
pub(in crate::track) struct Channel {
    pub number: u8,
    pub weights: [f32; 3],
    pub constant: f32,
    /// The part of the weights that is chroma: all of U and V, R − Y, none of Y.
    pub chroma: Option<[f32; 3]>,
    /// What of the weights shows red, and blue, that lie apart from luma. Green is then where luma stays.
    pub apart: [[f32; 3]; 2],
}

impl Channel {
    pub(in crate::track) fn of(picture: &Picture, number: usize) -> Self {
        let (format, colour) = (picture.format(), picture.colour());
        let (weights, constant) = colour.channel_from_rgb(format, number);
        let weights = weights.map(|w| w as f32);
        let chroma = match luma(picture) {
            Some(luma) => Some(std::array::from_fn(|c| weights[c] - luma[c])),
            None => (number > 0).then_some(weights),
        };
        let [red, green, blue] = of_luma(picture);
        let apart = [[1.0, -red / green, 0.0], [0.0, -blue / green, 1.0]];
        let apart = apart.map(|moves| std::array::from_fn(|c| weights[c] * moves[c]));
        Self { number: number as u8, weights, constant: constant as f32, chroma, apart }
    }
}

/// Weights of stored R, G and B in luma; `None` where luma is stored.
fn luma(picture: &Picture) -> Option<[f32; 3]> {
    let format = picture.format();
    (format != PixelFormat::Grey && !format.is_yuv()).then(|| of_luma(picture))
}

/// Weights of R, G and B in luma.
fn of_luma(picture: &Picture) -> [f32; 3] {
    let (luma, _) = Colour { range: Range::Full, ..picture.colour() }.channel_from_rgb(PixelFormat::Grey, 0);
    luma.map(|w| w as f32)
}

/// Lobes of the kernel on each side.
const LOBES: f64 = 3.0;

/// Where the chroma of each pixel lies.
pub(in crate::track) struct Beside {
    luma: Option<[f32; 3]>,
    /// Columns and rows from the pixel's, with their weights.
    taps: [Vec<(i64, f32)>; 2],
}

impl Beside {
    /// Chroma that shows what is this far beside its pixels, right and down; `None` if it is at their place, or
    /// subsampled.
    pub(in crate::track) fn of(picture: &Picture, chroma_offset_px: [f64; 2]) -> Option<Self> {
        let is_beside = picture.format().has_chroma_per_pixel() && chroma_offset_px != [0.0; 2];
        is_beside.then(|| Self { luma: luma(picture), taps: chroma_offset_px.map(|offset_px| taps(-offset_px)) })
    }

    /// How far from a pixel its chroma is looked up, pixels.
    pub(in crate::track) fn reach_px(&self) -> u32 {
        let taps = self.taps.iter().flatten();
        taps.map(|(by, _)| by.unsigned_abs() as u32).max().unwrap_or(0)
    }

    /// By how much the values of a pixel change if its own chroma takes the place of that which is stored there.
    pub(in crate::track) fn changes(&self, planes: &[Plane<'_>; 3], at: [usize; 2]) -> [f32; 3] {
        let changes = planes.each_ref().map(|plane| self.change(plane, at));
        match self.luma {
            Some(luma) => {
                let of_luma: f32 = changes.iter().zip(luma).map(|(change, weight)| change * weight).sum();
                changes.map(|change| change - of_luma)
            }
            None => [0.0, changes[1], changes[2]],
        }
    }

    /// The value where a pixel's chroma lies, less that of the pixel. (Beyond the border is what is at the border.)
    fn change(&self, plane: &Plane<'_>, [column, row]: [usize; 2]) -> f32 {
        let held = |at: usize, by: i64, size: usize| (at as i64 + by).clamp(0, size as i64 - 1) as usize;
        let value = |column: usize, row: usize| {
            let stored = plane.data.get(row * plane.stride + column * plane.step);
            stored.map_or(0.0, |stored| f32::from(*stored))
        };
        let of_row = |row: usize| -> f32 {
            self.taps[0].iter().map(|(by, weight)| weight * value(held(column, *by, plane.width), row)).sum()
        };
        let there: f32 = self.taps[1].iter().map(|(by, weight)| weight * of_row(held(row, *by, plane.height))).sum();
        there - value(column, row)
    }
}

/// The pixels from which a value at `at_px` is interpolated, with their weights. (At a pixel, that alone.)
fn taps(at_px: f64) -> Vec<(i64, f32)> {
    let sinc = |x: f64| if x == 0.0 { 1.0 } else { (PI * x).sin() / (PI * x) };
    let weight = |pixel: i64| {
        let x = pixel as f64 - at_px;
        if x.abs() < LOBES { sinc(x) * sinc(x / LOBES) } else { 0.0 }
    };
    let near = (at_px - LOBES).ceil() as i64..=(at_px + LOBES).floor() as i64;
    let sum: f64 = near.clone().map(weight).sum();
    near.map(|pixel| (pixel, (weight(pixel) / sum) as f32)).filter(|(_, weight)| weight.abs() > 1e-6).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    const YUV: PixelFormat = PixelFormat::Yuv { chroma_log2: [0, 0] };

    #[test]
    fn chroma_is_the_part_of_a_channel_that_grey_does_not_have() {
        for format in [PixelFormat::RgbPlanar, YUV] {
            let picture = Picture::from_planes(1, 1, format, Colour::SRGB, vec![vec![0]; 3]).unwrap();
            for number in 0..3 {
                let Channel { weights, chroma, .. } = Channel::of(&picture, number);
                let grey = chroma.map_or(0.0, |chroma| chroma.iter().sum::<f32>());
                assert!(grey.abs() < 1e-6, "{format:?} {number}: {chroma:?}");
                assert_eq!(chroma == Some(weights), format.is_yuv() && number > 0);
                assert_eq!(chroma.is_none(), format.is_yuv() && number == 0);
            }
        }
    }

    /// Smooth luma, and smooth chroma that shows what is `offset_px` beside its pixels.
    fn picture(format: PixelFormat, offset_px: [f64; 2]) -> Picture {
        const SIZE: u32 = 32;
        let wave = |at: [f64; 2], phase: f64| 60.0 * (0.6 * at[0] + 0.45 * at[1] + phase).sin();
        let (y_from_rgb, _) = Colour::SRGB.channel_from_rgb(YUV, 0);
        let value = |channel: usize, x: u32, y: u32| {
            let here = [x, y].map(f64::from);
            let there = [here[0] + offset_px[0], here[1] + offset_px[1]];
            let rgb = [0.0, 1.0, 2.0].map(|phase| 100.0 + wave(there, phase));
            let luma = |rgb: [f64; 3]| rgb.iter().zip(y_from_rgb).map(|(value, weight)| value * weight).sum::<f64>();
            let back = 100.0 + wave(here, 0.5) - luma(rgb);
            let (weights, constant) = Colour::SRGB.channel_from_rgb(format, channel);
            let stored: f64 = rgb.iter().zip(weights).map(|(value, weight)| (value + back) * weight).sum();
            (stored + constant).round().clamp(0.0, 255.0) as u8
        };
        let plane =
            |channel| (0..SIZE).flat_map(|y| (0..SIZE).map(move |x| (x, y))).map(move |(x, y)| value(channel, x, y));
        let planes = (0..3).map(|channel| plane(channel).collect()).collect();
        Picture::from_planes(SIZE, SIZE, format, Colour::SRGB, planes).unwrap()
    }

    #[test]
    fn chroma_is_taken_from_where_it_lies_and_luma_stays() {
        for format in [PixelFormat::RgbPlanar, YUV] {
            let expected = picture(format, [0.0; 2]);
            for offset_px in [[-1.0, 0.0], [0.5, 0.0], [0.3, 0.7], [-1.6, 0.45]] {
                let beside = picture(format, offset_px);
                let planes = [0, 1, 2].map(|c| beside.plane(c).unwrap());
                let right = Beside::of(&beside, offset_px).unwrap();
                assert!((3..=5).contains(&right.reach_px()) || offset_px == [-1.0, 0.0], "{}", right.reach_px());
                let mut wrong = 0.0_f32;
                for at in (6..26).flat_map(|row| (6..26).map(move |column| [column, row])) {
                    let changes = right.changes(&planes, at);
                    for (c, (plane, change)) in planes.iter().zip(changes).enumerate() {
                        let stored = |plane: &Plane<'_>| f32::from(plane.row(at[1]).unwrap()[at[0]]);
                        let off = stored(plane) + change - stored(&expected.plane(c).unwrap());
                        assert!(off.abs() < 2.5, "{format:?}, {offset_px:?}, channel {c} at {at:?}: {off}");
                        wrong = wrong.max((stored(plane) - stored(&expected.plane(c).unwrap())).abs());
                    }
                }
                assert!(wrong > 5.0, "{format:?}, {offset_px:?}: what is put right was not wrong: {wrong}");
            }
            assert!(Beside::of(&expected, [0.0; 2]).is_none());
        }
    }
}
