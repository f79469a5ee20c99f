//! Functions of the image model: the Gaussian integral, and the transfer function from linear light to stored R'G'B'.

use crate::source::Transfer;
use wide::{CmpLt, f32x4};

/// Standard normal distribution and density at `z`, to 3e-7: Abramowitz and Stegun (1964), 7.1.26.
#[inline]
pub(crate) fn gauss(z: f32x4) -> (f32x4, f32x4) {
    let exp = (z * z * -0.5).exp();
    let t = f32x4::ONE / (z.abs() * (0.327_591_1 * std::f32::consts::FRAC_1_SQRT_2) + 1.0);
    let polynomial = t * (t * (t * (t * (t * 1.061_405_4 - 1.453_152) + 1.421_413_7) - 0.284_496_74) + 0.254_829_6);
    let tail = polynomial * exp * 0.5;
    (z.cmp_lt(f32x4::ZERO).blend(tail, f32x4::ONE - tail), exp * (0.5 * FRAC_2_SQRT_TAU))
}

/// 2/√(2π).
const FRAC_2_SQRT_TAU: f32 = std::f32::consts::FRAC_2_SQRT_PI * std::f32::consts::FRAC_1_SQRT_2;

/// Linear light (0 black, 1 white) to stored R'G'B' (0..255) and back.
#[derive(Debug)]
pub(crate) struct Encoding {
    transfer: Transfer,
    /// (value, slope per unit of light) at multiples of 1/STEPS.
    table: Vec<(f32, f32)>,
}

/// Table nodes per unit of light, and the brightest light tabulated.
const STEPS: f32 = 2048.0;
const BRIGHTEST: f32 = 1.5;

impl Encoding {
    pub(crate) fn new(transfer: Transfer) -> Self {
        let node = |i: usize| encode(transfer, i as f64 / f64::from(STEPS));
        let single = |(value, slope): (f64, f64)| (value as f32, slope as f32);
        Self { transfer, table: (0..=(STEPS * BRIGHTEST) as usize).map(|i| single(node(i))).collect() }
    }

    /// Stored value and its slope per unit of light. Between nodes the slope changes linearly.
    #[inline]
    pub(crate) fn encode(&self, light: f32) -> (f32, f32) {
        let at = light.max(0.0) * STEPS;
        let i = at as usize;
        match (self.table.get(i), self.table.get(i + 1)) {
            (Some(&(value, slope)), Some(&(_, next))) => {
                let f = at - i as f32;
                let change = (next - slope) * f;
                (value + (slope + 0.5 * change) * f * (1.0 / STEPS), slope + change)
            }
            _ => {
                let (value, slope) = encode(self.transfer, f64::from(light));
                (value as f32, slope as f32)
            }
        }
    }

    /// Light of a stored value.
    pub(crate) fn decode(&self, stored: f64) -> f64 {
        let v = (stored / 255.0).max(0.0);
        match self.transfer {
            Transfer::Bt709 if v < 0.081 => v / 4.5,
            Transfer::Bt709 => ((v + 0.099) / 1.099).powf(1.0 / 0.45),
            Transfer::Srgb if v < 0.04045 => v / 12.92,
            Transfer::Srgb => ((v + 0.055) / 1.055).powf(2.4),
            Transfer::Linear => v,
        }
    }
}

/// ITU-R BT.709-6 item 1.2 and IEC 61966-2-1.
fn encode(transfer: Transfer, light: f64) -> (f64, f64) {
    let power = |scale: f64, exponent: f64, toe: f64| {
        let p = light.powf(exponent);
        (255.0 * (scale * p - toe), 255.0 * scale * exponent * p / light)
    };
    match transfer {
        Transfer::Bt709 if light < 0.018 => (255.0 * 4.5 * light, 255.0 * 4.5),
        Transfer::Bt709 => power(1.099, 0.45, 0.099),
        Transfer::Srgb if light < 0.003_130_8 => (255.0 * 12.92 * light, 255.0 * 12.92),
        Transfer::Srgb => power(1.055, 1.0 / 2.4, 0.055),
        Transfer::Linear => (255.0 * light, 255.0),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gauss_agrees_with_erfc_and_exp() {
        for i in -700..700 {
            let z = f64::from(i) * 0.0101;
            let (p, d) = gauss(f32x4::splat(z as f32));
            let (p, d) = (f64::from(p.to_array()[0]), f64::from(d.to_array()[0]));
            let z = f64::from(z as f32);
            let exact = 0.5 * libm::erfc(-z / std::f64::consts::SQRT_2);
            let density = (-0.5 * z * z).exp() / (2.0 * std::f64::consts::PI).sqrt();
            assert!((p - exact).abs() < 1e-6, "Φ({z}) = {p}, not {exact}");
            assert!((d - density).abs() < 2e-6, "φ({z}) = {d}, not {density}");
        }
    }

    #[test]
    fn half_grey_of_each_transfer_and_back() {
        // BT.709: 1.099·0.5^0.45 − 0.099 = 0.70551; sRGB: 1.055·0.5^(1/2.4) − 0.055 = 0.73536.
        for (transfer, expected) in [(Transfer::Bt709, 0.70551), (Transfer::Srgb, 0.73536), (Transfer::Linear, 0.5)] {
            let encoding = Encoding::new(transfer);
            assert!((f64::from(encoding.encode(0.5).0) / 255.0 - expected).abs() < 1e-4);
            for light in [0.001, 0.01, 0.0175, 0.05, 0.3, 0.99, 2.0] {
                let encode = |light: f64| {
                    let (value, slope) = encoding.encode(light as f32);
                    (f64::from(value), f64::from(slope))
                };
                let (value, slope) = encode(light);
                assert!((encoding.decode(value) - light).abs() < 2e-5 * (1.0 + light), "{transfer:?} {light}");
                let step = encode(light + 1e-4).0 - value;
                assert!((step / 1e-4 - slope).abs() < 0.03 * slope + 1.0, "{transfer:?} {light}: {step} {slope}");
            }
        }
    }
}
