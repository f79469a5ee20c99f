//! Flat drawings for tests of segmentation and of picture formats: rotated rectangles of colour, coverage by
//! supersampling, stored in any format, with noise.
//!
//! No renderer of rigs, which is [`catoptra::simulate`]: these tests need blobs of which centre, axis, length and width
//! in pixels are exact, and every way to store samples that a decoder may hand on.

use super::random::Random;
use catoptra::rig::ColourModel;
use catoptra::segment::{ClassSamples, learn};
use catoptra::source::{ChromaSiting, Colour, Matrix, Picture, PixelFormat, Range, Transfer};
use nalgebra::{Point2, Vector2, Vector3};

pub(crate) const YUV420: PixelFormat = PixelFormat::Yuv { chroma_log2: [1, 1] };

pub(crate) const VIDEO: Colour =
    Colour { matrix: Matrix::Bt709, range: Range::Limited, transfer: Transfer::Bt709, siting: ChromaSiting::Left };

/// Yellow, green and blue: base, coil, tip.
pub(crate) const COLOURS: [[f64; 3]; 3] = [[200.0, 160.0, 40.0], [40.0, 140.0, 70.0], [50.0, 80.0, 190.0]];

pub(crate) const GREY: [f64; 3] = [110.0, 110.0, 112.0];

/// A rotated rectangle.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Band {
    pub centre: Point2<f64>,
    pub angle: f64,
    pub length: f64,
    pub width: f64,
    pub rgb: [f64; 3],
}

impl Band {
    pub(crate) fn new(marker: usize, x: f64, y: f64, angle: f64, length: f64, width: f64) -> Self {
        Self { centre: Point2::new(x, y), angle, length, width, rgb: COLOURS[marker] }
    }

    pub(crate) fn axis(&self) -> Vector2<f64> {
        Vector2::new(self.angle.cos(), self.angle.sin())
    }

    fn covers(&self, p: Point2<f64>) -> bool {
        let (d, a) = (p - self.centre, self.axis());
        d.dot(&a).abs() < self.length / 2.0 && (d.y * a.x - d.x * a.y).abs() < self.width / 2.0
    }
}

/// A picture in R'G'B'.
pub(crate) struct Scene {
    pub width: usize,
    pub height: usize,
    pub rgb: Vec<Vector3<f64>>,
}

impl Scene {
    /// Bands in front of a background that is slightly darker on the left.
    pub(crate) fn new(width: usize, height: usize, bands: &[Band]) -> Self {
        const FINE: usize = 8;
        let mut rgb = Vec::with_capacity(width * height);
        for y in 0..height {
            for x in 0..width {
                let shade = 0.9 + 0.2 * x as f64 / width as f64;
                let mut pixel = Vector3::from(GREY) * shade;
                for band in bands {
                    let reach = band.length.max(band.width) + 2.0;
                    if (x as f64 - band.centre.x).abs() > reach || (y as f64 - band.centre.y).abs() > reach {
                        continue;
                    }
                    let sub = |i: usize| (i as f64 + 0.5) / FINE as f64 - 0.5;
                    let hits = (0..FINE * FINE)
                        .filter(|i| band.covers(Point2::new(x as f64 + sub(i % FINE), y as f64 + sub(i / FINE))))
                        .count();
                    let alpha = hits as f64 / (FINE * FINE) as f64;
                    pixel = pixel * (1.0 - alpha) + Vector3::from(band.rgb) * alpha;
                }
                rgb.push(pixel);
            }
        }
        Self { width, height, rgb }
    }

    /// Adds Gaussian noise on all channels, reproducible by seed.
    pub(crate) fn noisy(mut self, sd: f64, seed: u64) -> Self {
        let mut random = Random::new(seed);
        for pixel in &mut self.rgb {
            for channel in pixel.iter_mut() {
                *channel += sd * random.normal();
            }
        }
        self
    }

    fn at(&self, x: isize, y: isize) -> Vector3<f64> {
        let x = x.clamp(0, self.width as isize - 1) as usize;
        let y = y.clamp(0, self.height as isize - 1) as usize;
        self.rgb[y * self.width + x]
    }

    /// The scene as a camera or decoder would store it.
    pub(crate) fn stored(&self, format: PixelFormat, colour: Colour) -> Picture {
        let value = |channel: usize, rgb: Vector3<f64>| {
            let (w, c) = colour.channel_from_rgb(format, channel);
            (Vector3::from(w).dot(&rgb) + c).round().clamp(0.0, 255.0) as u8
        };
        let plane = |channel: usize, log2: [u8; 2]| {
            let (sx, sy) = (1 << log2[0], 1 << log2[1]);
            let mut samples = Vec::new();
            for j in 0..self.height.div_ceil(sy) as isize {
                for i in 0..self.width.div_ceil(sx) as isize {
                    let (x, y) = (i * sx as isize, j * sy as isize);
                    let mut mean = Vector3::zeros();
                    for dy in 0..sy as isize {
                        mean += match (sx, colour.siting) {
                            (2, ChromaSiting::Left) => {
                                (self.at(x - 1, y + dy) + self.at(x, y + dy) * 2.0 + self.at(x + 1, y + dy)) / 4.0
                            }
                            _ => (0..sx as isize).map(|dx| self.at(x + dx, y + dy)).sum::<Vector3<f64>>() / sx as f64,
                        };
                    }
                    samples.push(value(channel, mean / sy as f64));
                }
            }
            samples
        };
        let interleave =
            |planes: &[Vec<u8>]| (0..planes[0].len()).flat_map(|i| planes.iter().map(move |p| p[i])).collect();
        let planes = match format {
            PixelFormat::Yuv { chroma_log2 } => vec![plane(0, [0, 0]), plane(1, chroma_log2), plane(2, chroma_log2)],
            PixelFormat::Nv12 => vec![plane(0, [0, 0]), interleave(&[plane(1, [1, 1]), plane(2, [1, 1])])],
            PixelFormat::RgbPlanar => (0..3).map(|c| plane(c, [0, 0])).collect(),
            PixelFormat::RgbPacked { step, order } => {
                let filler = vec![255; self.width * self.height];
                let mut planes = vec![filler; usize::from(step)];
                for (channel, &byte) in order.iter().enumerate() {
                    planes[usize::from(byte)] = plane(channel, [0, 0]);
                }
                vec![interleave(&planes)]
            }
            PixelFormat::Grey => vec![plane(0, [0, 0])],
        };
        Picture::from_planes(self.width as u32, self.height as u32, format, colour, planes).unwrap()
    }
}

/// Samples of the three colours, of white and of grey, shaded and noisy.
pub(crate) fn samples() -> Vec<ClassSamples> {
    let class = |name: &str, is_marker: bool, colour: [f64; 3]| ClassSamples {
        name: name.into(),
        is_marker,
        rgb: (0..200)
            .map(|i| {
                let wobble = |k: usize| f64::from(i as u32 * 7919 % (97 + k as u32) % 13) / 13.0 - 0.5;
                Vector3::from(colour) * (0.85 + 0.3 * f64::from(i) / 199.0)
                    + Vector3::new(wobble(0), wobble(3), wobble(9)) * 8.0
            })
            .collect(),
    };
    vec![
        class("base", true, COLOURS[0]),
        class("coil", true, COLOURS[1]),
        class("tip", true, COLOURS[2]),
        class("tube", false, [190.0, 190.0, 186.0]),
        class("background", false, GREY),
    ]
}

pub(crate) fn models() -> Vec<ColourModel> {
    learn(&samples()).unwrap().models
}
