//! A colour model as linear functions of the stored channels, and their bounds in 16-bit integers.

use super::THRESHOLD;
use super::cells::Sums;
use crate::rig::{ColourModel, ColourPlane};
use crate::source::Picture;
use nalgebra::{Matrix3, Vector3};

/// The minimum of its planes' scores.
#[derive(Debug, Clone)]
pub(super) struct Discriminant {
    pub planes: Vec<Plane>,
}

/// score = weights·sums + bias, for the sums of a cell's four samples of each channel.
#[derive(Debug, Clone, Copy)]
pub(super) struct Plane {
    weights: [f32; 3],
    bias: f32,
    pub screen: Screen,
}

/// The same in 16 bits, for the cell's mean samples less 128: Σ weight·value + offset is ≥ 0 wherever the score exceeds
/// the threshold or is slightly below it. No partial sum overflows.
#[derive(Debug, Clone, Copy)]
pub(super) struct Screen {
    pub weights: [i16; 3],
    /// The offset for the rounded means of all channels.
    pub offset: i16,
    /// The offset for exact means of channels 1 and 2, and any value of the first channel.
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
        let weights_from_rgb = stored_from_rgb.try_inverse()?.transpose();
        let plane = |plane: &ColourPlane| {
            let weights = weights_from_rgb * plane.weights;
            let bias = plane.bias - weights.dot(&offset);
            Plane {
                weights: [weights.x, weights.y, weights.z].map(|w| (w / 4.0) as f32),
                bias: bias as f32,
                screen: Screen::new(&weights, bias),
            }
        };
        Some(Self { planes: model.planes.iter().map(plane).collect() })
    }

    /// The score of one cell.
    #[cfg(test)]
    pub(super) fn score(&self, a: f32, b: f32, c: f32) -> f32 {
        self.planes.iter().map(|plane| plane.score(a, b, c)).fold(f32::INFINITY, f32::min)
    }

    /// The scores of the first `n` cells.
    #[inline(always)]
    pub(super) fn scores<const N: usize>(&self, n: usize, [a, b, c]: [&Sums<N>; 3]) -> [f32; N] {
        let mut scores = [f32::INFINITY; N];
        for plane in &self.planes {
            for i in 0..n.min(N) {
                scores[i] = scores[i].min(plane.score(a[i].into(), b[i].into(), c[i].into()));
            }
        }
        scores
    }

    /// The scores of the first `n` cells, and what channels 1 and 2 contribute to them, in the planes that decide them.
    #[inline(always)]
    pub(super) fn scores_and_chroma<const N: usize>(&self, n: usize, [a, b, c]: [&Sums<N>; 3]) -> [[f32; N]; 2] {
        let mut scores = [f32::INFINITY; N];
        let mut chroma = [0.0; N];
        for plane in &self.planes {
            for i in 0..n.min(N) {
                let score = plane.score(a[i].into(), b[i].into(), c[i].into());
                let decides = score < scores[i];
                scores[i] = if decides { score } else { scores[i] };
                chroma[i] = if decides { plane.chroma(b[i].into(), c[i].into()) } else { chroma[i] };
            }
        }
        [scores, chroma]
    }
}

impl Plane {
    /// The score of one cell. The order of the operations is part of the result: all scores come from here.
    #[inline(always)]
    pub(super) fn score(&self, a: f32, b: f32, c: f32) -> f32 {
        (self.weights[0] * a + self.weights[1] * b) + self.weights[2] * c + self.bias
    }

    /// What channels 1 and 2 contribute to it.
    #[inline(always)]
    fn chroma(&self, b: f32, c: f32) -> f32 {
        self.weights[1] * b + self.weights[2] * c
    }
}

impl Screen {
    fn new(weights: &Vector3<f64>, bias: f64) -> Self {
        let zero = bias - f64::from(THRESHOLD);
        let sizes = weights.abs();
        // Σ w·(value + 128) + zero, with the first channel's values or their largest contribution (they end at 255).
        let offset = zero + 128.0 * weights.sum();
        let without_first = zero + 128.0 * (weights.y + weights.z) + 255.0 * weights.x.max(0.0);
        // The unit of the score, as fine as 16 bits allow; 1500 are reserved for the slacks below.
        let unit = (31_000.0 / (offset.abs().max(without_first.abs()) + 128.0 * sizes.sum())).min(8192.0);
        let scaled = weights * unit;
        let rounded = scaled.map(f64::round);
        // Largest loss by rounding the weights and by rounding the means; one more for rounding the offset.
        let by_weights = (scaled - rounded).abs() * 128.0;
        let by_means = sizes.sum() * unit * 0.5;
        let stored = |v: f64| v as i16;
        Self {
            weights: [rounded.x, rounded.y, rounded.z].map(stored),
            offset: stored((offset * unit + by_weights.sum() + by_means).ceil() + 1.0),
            offset_without_first: stored((without_first * unit + by_weights.y + by_weights.z).ceil() + 1.0),
        }
    }
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
            let model = ColourModel::linear(Vector3::from(w), bias, Vector3::zeros());
            let d = Discriminant::new(&model, &picture).unwrap();
            let stored = [0, 1, 2].map(|i| {
                let (cw, c) = picture.colour().channel_from_rgb(format, i);
                (4.0 * (cw[0] * rgb[0] + cw[1] * rgb[1] + cw[2] * rgb[2] + c)) as f32
            });
            let expected = model.score(&Vector3::from(rgb));
            prop_assert!((f64::from(d.score(stored[0], stored[1], stored[2])) - expected).abs() < 1e-4);
        }

        #[test]
        fn the_screen_misses_nothing_and_lets_little_through(
            w in prop::array::uniform3(-0.02..0.02), scale in prop::sample::select(vec![1e-6, 0.1, 1.0, 1e4]),
            bias in -1.5..1.5, sums in prop::array::uniform3(0_i16..=1020),
        ) {
            let picture = picture(PixelFormat::RgbPacked { step: 3, order: [0, 1, 2] }, Matrix::Bt601, Range::Full);
            let weights = Vector3::from(w) * scale;
            let model = ColourModel::linear(weights, bias, Vector3::zeros());
            let d = Discriminant::new(&model, &picture).unwrap();
            let s = d.planes[0].screen;
            let sum = |values: &[i16; 3], channels: std::ops::Range<usize>, offset: i16| {
                channels.fold(i32::from(offset), |sum, i| sum + i32::from(values[i]) * i32::from(s.weights[i]))
            };
            let means = sums.map(|v| (v + 2) / 4 - 128);
            let full = sum(&means, 0..3, s.offset);
            prop_assert!(i16::try_from(full).is_ok());
            let score = d.score(sums[0].into(), sums[1].into(), sums[2].into());
            if score > THRESHOLD {
                prop_assert!(full >= 0);
            }
            if scale == 1.0 && score < THRESHOLD - 0.3 {
                prop_assert!(full < 0, "score {score}");
            }
            // One sample per cell: sums are multiples of 4.
            let exact = [sums[0], sums[1] / 4 * 4, sums[2] / 4 * 4];
            let without = sum(&exact.map(|v| v / 4 - 128), 1..3, s.offset_without_first);
            prop_assert!(i16::try_from(without).is_ok());
            if d.score(exact[0].into(), exact[1].into(), exact[2].into()) > THRESHOLD {
                prop_assert!(without >= 0);
            }
        }
    }
}
