//! Whether a block's coefficients are possible for 8-bit samples.
//!
//! Samples have 8 bits, and each coefficient of the original picture lies within one quantization step (T.81, A.3.4) of
//! the stored one. The transform is orthonormal and keeps distances, so the stored block can be no further from one
//! with samples in range than the steps allow.

use super::codes::Block;
use std::f32::consts::{FRAC_1_SQRT_2, PI};
use std::iter;

/// Largest distance of a sample from mid-range, with the decoder's rounding.
const MAX_DEVIATION: f32 = 128.5;
/// Largest error of an encoder, in steps: half is rounding, and some drop small coefficients.
const MAX_CODER_ERROR: f32 = 0.75;

/// Row and column of the k-th coefficient of a scan (T.81, figure A.6).
pub(super) const ZIGZAG: [u8; 64] = [
    0, 1, 8, 16, 9, 2, 3, 10, 17, 24, 32, 25, 18, 11, 4, 5, 12, 19, 26, 33, 40, 48, 41, 34, 27, 20, 13, 6, 7, 14, 21,
    28, 35, 42, 49, 56, 57, 50, 43, 36, 29, 22, 15, 23, 30, 37, 44, 51, 58, 59, 52, 45, 38, 31, 39, 46, 53, 60, 61, 54,
    47, 55, 62, 63,
];

/// The samples that a quantization table allows.
#[derive(Clone)]
pub(super) struct Samples {
    /// cos((2x + 1) u π / 16) with the transform's factors, indexed by u and x.
    waves: [[f32; 8]; 8],
    /// Square of the largest deviation of a sound block's samples.
    tolerance: f32,
}

impl Samples {
    pub(super) fn new(quantization: &[i32; 64]) -> Self {
        let waves = std::array::from_fn(|u| {
            std::array::from_fn(|x| {
                let factor = if u == 0 { FRAC_1_SQRT_2 } else { 1.0 };
                factor / 2.0 * ((2 * x + 1) as f32 * u as f32 * PI / 16.0).cos()
            })
        });
        Self { waves, tolerance: quantization.iter().map(|q| (MAX_CODER_ERROR * *q as f32).powi(2)).sum() }
    }

    /// Whether a block is possible for 8-bit samples.
    #[inline]
    pub(super) fn allow(&self, block: &Block) -> bool {
        // Most blocks are far from either end of the range.
        block.mean.unsigned_abs() as f32 / 8.0 + block.sum as f32 / 4.0 <= MAX_DEVIATION || self.allow_samples(block)
    }

    #[cold]
    fn allow_samples(&self, block: &Block) -> bool {
        let mut rows = [[0.0; 8]; 8];
        for (k, value) in iter::once((0, block.mean)).chain(block.waves()) {
            let Some((v, u)) = ZIGZAG.get(k).map(|at| (usize::from(at / 8), usize::from(at % 8))) else { continue };
            add(&mut rows[v], &self.waves[u], value as f32);
        }
        let mut off = [0.0; 8];
        for y in 0..8 {
            let mut samples = [0.0; 8];
            rows.iter().zip(&self.waves).for_each(|(row, wave)| add(&mut samples, row, wave[y]));
            off.iter_mut().zip(samples).for_each(|(off, s)| *off += (s.abs() - MAX_DEVIATION).max(0.0).powi(2));
        }
        off.iter().sum::<f32>() <= self.tolerance
    }
}

/// Adds a row, multiplied by `by`, to another.
fn add(to: &mut [f32; 8], row: &[f32; 8], by: f32) {
    to.iter_mut().zip(row).for_each(|(to, value)| *to += by * value);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn samples_in_range_are_allowed_and_others_are_not() {
        let fine = Samples::new(&[4; 64]);
        // The brightest field, a black and white board, and values out of range by less than the steps.
        assert!(fine.allow(&Block::of(&[(0, 1016)])));
        assert!(fine.allow(&Block::of(&[(0, 1040)])));
        let edge = [0, 1, 2, 3, 4, 5, 6, 7].map(|x| if x < 4 { -128.0 } else { 127.0 });
        let of_edge: Vec<(usize, i32)> = (0..8)
            .map(|u| {
                let sum: f32 = (0..8).map(|x| fine.waves[u][x] * edge[x]).sum();
                let k = ZIGZAG.iter().position(|at| usize::from(*at) == u).unwrap();
                (k, (sum * 8.0 * fine.waves[0][0]).round() as i32)
            })
            .collect();
        assert!(fine.allow(&Block::of(&of_edge)), "{of_edge:?}");
        // A far too bright mean, alone and with a large wave on it.
        assert!(!fine.allow(&Block::of(&[(0, 1200)])));
        assert!(!fine.allow(&Block::of(&[(0, 700), (1, 700)])));
        assert!(Samples::new(&[99; 64]).allow(&Block::of(&[(0, 700), (1, 700)])));
    }
}
