//! A colour model as a linear function of the stored channels, and a bound of it in 16-bit integers.

use super::THRESHOLD;
use super::cells::SHIFTED_MAX;
use crate::rig::ColourModel;
use crate::source::Picture;
use nalgebra::{Matrix3, Vector3};

/// score = weights·sums + bias, for the sums of a cell's four samples of each channel.
#[derive(Debug, Clone, Copy)]
pub(super) struct Discriminant {
    pub weights: [f32; 3],
    pub bias: f32,
    pub screen: Screen,
}

/// The same in 16 bits: Σ (weights·shifted sums >> 16) + offset is ≥ 0 wherever the score exceeds the threshold (and
/// slightly below it).
#[derive(Debug, Clone, Copy)]
pub(super) struct Screen {
    pub weights: [i16; 3],
    pub offset: i16,
    /// Instead of the first channel's term and `offset`: what they are at most.
    pub offset_without_first: i16,
}

impl Discriminant {
    /// `None` when the picture has no three channels.
    pub(super) fn new(model: &ColourModel, picture: &Picture) -> Option<Self> {
        let format = picture.format();
        if format.channels() != 3 {
            return None;
        }
        let mut stored_from_rgb = Matrix3::zeros();
        let mut offset = Vector3::zeros();
        for i in 0..3 {
            let (weights, constant) = picture.colour().channel_from_rgb(format, i);
            stored_from_rgb.set_row(i, &Vector3::from(weights).transpose());
            offset[i] = constant;
        }
        let weights = stored_from_rgb.try_inverse()?.transpose() * model.weights;
        let bias = model.bias - weights.dot(&offset);
        Some(Self {
            weights: [weights.x, weights.y, weights.z].map(|w| (w / 4.0) as f32),
            bias: bias as f32,
            screen: Screen::new(&weights, bias),
        })
    }

    /// The score of one cell. The order of the operations is part of the result: all scores come from here.
    #[inline(always)]
    pub(super) fn score(&self, a: f32, b: f32, c: f32) -> f32 {
        (self.weights[0] * a + self.weights[1] * b) + self.weights[2] * c + self.bias
    }
}

impl Screen {
    /// Rounding of three weights (0.25 each), of the products (down by less than 1 each) and of the offset, rounded up.
    const SLACK: f64 = 6.0;

    fn new(weights: &Vector3<f64>, bias: f64) -> Self {
        let offset = bias - f64::from(THRESHOLD);
        // The unit of the score: as fine as the weights and all partial sums allow in 16 bits.
        let range = weights.abs().sum() * 255.0 + offset.abs();
        let unit = (60.0 / weights.amax()).min(30_000.0 / range).min(8192.0);
        // sum << 5 times a weight of 512·unit·w, >> 16, is w·sum/4 in that unit.
        let stored = |v: f64| v as i16;
        let first_at_most = weights.x.max(0.0) * f64::from(SHIFTED_MAX) / 128.0;
        Self {
            weights: [weights.x, weights.y, weights.z].map(|w| stored((w * unit * 512.0).round())),
            offset: stored((offset * unit + Self::SLACK).floor()),
            offset_without_first: stored(((offset + first_at_most) * unit + Self::SLACK).ceil()),
        }
    }
}

/// The high half of a product.
#[inline(always)]
pub(super) fn high(a: i16, b: i16) -> i16 {
    ((i32::from(a) * i32::from(b)) >> 16) as i16
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::source::{Colour, Matrix, PixelFormat, Range};
    use proptest::prelude::*;

    fn picture(format: PixelFormat, matrix: Matrix, range: Range) -> Picture {
        let planes = match format {
            PixelFormat::Yuv { .. } => vec![vec![0; 4], vec![0; 1], vec![0; 1]],
            _ => vec![vec![0; 12]],
        };
        Picture::from_planes(2, 2, format, Colour { matrix, range, ..Colour::SRGB }, planes).unwrap()
    }

    proptest! {
        #[test]
        fn scores_stored_samples_as_the_model_scores_their_colour(
            w in prop::array::uniform3(-0.03..0.03), bias in -2.0..2.0, rgb in prop::array::uniform3(0.0..255.0),
            limited: bool, packed: bool,
        ) {
            let range = if limited { Range::Limited } else { Range::Full };
            let format = if packed { PixelFormat::RgbPacked { step: 3, order: [2, 1, 0] } }
                else { PixelFormat::Yuv { chroma_log2: [1, 1] } };
            let picture = picture(format, Matrix::Bt709, range);
            let model = ColourModel { weights: w.into(), bias, rgb: Vector3::zeros() };
            let d = Discriminant::new(&model, &picture).unwrap();
            let stored = [0, 1, 2].map(|i| {
                let (cw, c) = picture.colour().channel_from_rgb(format, i);
                (4.0 * (cw[0] * rgb[0] + cw[1] * rgb[1] + cw[2] * rgb[2] + c)) as f32
            });
            let expected = model.weights.dot(&rgb.into()) + bias;
            prop_assert!((f64::from(d.score(stored[0], stored[1], stored[2])) - expected).abs() < 1e-4);
        }

        #[test]
        fn the_screen_misses_nothing_and_lets_little_through(
            w in prop::array::uniform3(-0.1..0.1), bias in -5.0..5.0, sums in prop::array::uniform3(0_i16..=1020),
        ) {
            let picture = picture(PixelFormat::Yuv { chroma_log2: [1, 1] }, Matrix::Bt601, Range::Full);
            let d = Discriminant::new(&ColourModel { weights: w.into(), bias, rgb: Vector3::zeros() }, &picture).unwrap();
            let [a, b, c] = sums.map(f32::from);
            let score = d.score(a, b, c);
            let [a, b, c] = sums.map(|v| v << 5);
            let s = d.screen;
            let chroma = i32::from(high(b, s.weights[1])) + i32::from(high(c, s.weights[2]));
            let full = chroma + i32::from(high(a, s.weights[0])) + i32::from(s.offset);
            let without = chroma + i32::from(s.offset_without_first);
            prop_assert!(full.abs() < 32_000 && without.abs() < 32_000);
            prop_assert!(without >= full);
            if score > THRESHOLD {
                prop_assert!(full >= 0);
            }
            let unit = 30_000.0 / 160.0;
            if score < THRESHOLD - 10.0 / unit {
                prop_assert!(full < 0, "score {score}");
            }
        }
    }
}
