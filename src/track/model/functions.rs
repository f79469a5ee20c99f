//! Functions of the image model: the Gaussian integral, and the transfer function from linear light to stored R'G'B'.
//!
//! Each handles one number without branches, so that the compiler vectorises loops over them.

use crate::source::Transfer;

/// e^x to a relative error of 2e-7, for x up to 88: Cephes' `expf` (S. L. Moshier, Methods and Programs for
/// Mathematical Functions, 1989).
#[inline(always)]
pub(super) fn exp(x: f32) -> f32 {
    // Adding and subtracting it rounds to an integer, which is in the lowest bits in between.
    const ROUND: f32 = 12_582_912.0;
    let x = x.clamp(-87.0, 88.0);
    let rounded = x * std::f32::consts::LOG2_E + ROUND;
    let n = rounded - ROUND;
    let r = (x - n * 0.693_359_4) + n * 2.121_944_4e-4;
    let p = 1.987_569_1e-4 * r + 1.398_2e-3;
    let p = ((((p * r + 8.333_452e-3) * r + 4.166_58e-2) * r + 0.166_666_65) * r + 0.5) * r * r + r + 1.0;
    p * f32::from_bits(rounded.to_bits().wrapping_add(127) << 23)
}

/// ln x to 2e-7, for positive x that is not tiny: Cephes' `logf`.
#[inline(always)]
pub(super) fn ln(x: f32) -> f32 {
    // x = m 2^e, m within √½ to √2.
    const OFFSET: u32 = 0x3F35_04F3;
    let bits = x.to_bits().wrapping_sub(OFFSET);
    let e = (bits.cast_signed() >> 23) as f32;
    let t = f32::from_bits((bits & 0x007F_FFFF).wrapping_add(OFFSET)) - 1.0;
    let p = 7.037_683_6e-2 * t - 0.115_146_1;
    let p = (((p * t + 0.116_769_99) * t - 0.124_201_41) * t + 0.142_493_23) * t - 0.166_680_58;
    let p = ((p * t + 0.200_007_15) * t - 0.249_999_94) * t + 0.333_333_3;
    let square = t * t;
    (p * t * square - e * 2.121_944_4e-4 - 0.5 * square) + t + e * 0.693_359_4
}

/// Standard normal distribution and density at `z`, to 3e-7: Abramowitz and Stegun (1964), 7.1.26.
#[inline(always)]
pub(super) fn gauss(z: f32) -> (f32, f32) {
    // Smaller ones mean nothing, and their products would be subnormal, which costs a hundred cycles each.
    const SMALLEST: f32 = -20.0;
    let exp = exp((z * z * -0.5).max(SMALLEST));
    let t = 1.0 / (z.abs() * (0.327_591_1 * std::f32::consts::FRAC_1_SQRT_2) + 1.0);
    let polynomial = t * (t * (t * (t * (t * 1.061_405_4 - 1.453_152) + 1.421_413_7) - 0.284_496_74) + 0.254_829_6);
    let tail = polynomial * exp * 0.5;
    (if z < 0.0 { tail } else { 1.0 - tail }, exp * (0.5 * FRAC_2_SQRT_TAU))
}

/// 2/√(2π).
const FRAC_2_SQRT_TAU: f32 = std::f32::consts::FRAC_2_SQRT_PI * std::f32::consts::FRAC_1_SQRT_2;

/// Linear light (0 black, 1 white) to stored R'G'B' (0..255) and back.
#[derive(Debug, Clone)]
pub(in crate::track) struct Encoding {
    /// The stored value is `scale · light^exponent − offset`, and `slope · light` below `toe`.
    scale: f32,
    exponent: f32,
    offset: f32,
    toe: f32,
    slope: f32,
}

impl Encoding {
    /// ITU-R BT.709-6 item 1.2 and IEC 61966-2-1.
    pub(in crate::track) fn new(transfer: Transfer) -> Self {
        let (scale, exponent, offset, toe, slope) = match transfer {
            Transfer::Bt709 => (1.099, 0.45, 0.099, 0.018, 4.5),
            Transfer::Srgb => (1.055, 1.0 / 2.4, 0.055, 0.003_130_8, 12.92),
            Transfer::Linear => (1.0, 1.0, 0.0, f32::INFINITY, 1.0),
        };
        Self { scale: 255.0 * scale, exponent, offset: 255.0 * offset, toe, slope: 255.0 * slope }
    }

    /// Stored is light to the power of `gamma`, and in proportion to light where that would be too steep.
    pub(in crate::track) fn power(gamma: f64) -> Self {
        const TOE: f64 = 0.002;
        let slope = 255.0 * TOE.powf(gamma - 1.0);
        Self { scale: 255.0, exponent: gamma as f32, offset: 0.0, toe: TOE as f32, slope: slope as f32 }
    }

    /// Stored value and its slope per unit of light.
    #[inline(always)]
    pub(in crate::track) fn encode(&self, light: f32) -> (f32, f32) {
        let light = light.max(0.0);
        let power = self.scale * exp(self.exponent * ln(light));
        let (value, slope) = (power - self.offset, self.exponent * power / light);
        if light < self.toe { (self.slope * light, self.slope) } else { (value, slope) }
    }

    /// Light of a stored value.
    pub(in crate::track) fn decode(&self, stored: f64) -> f64 {
        let [scale, exponent, offset, slope] = [self.scale, self.exponent, self.offset, self.slope].map(f64::from);
        let (stored, in_toe) = (stored.max(0.0), stored.max(0.0) / slope);
        if in_toe < f64::from(self.toe) { in_toe } else { ((stored + offset) / scale).powf(1.0 / exponent) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gauss_agrees_with_erfc_and_exp() {
        for i in -700..700 {
            let z = f64::from(i) * 0.0101;
            let (p, d) = gauss(z as f32);
            let (p, d) = (f64::from(p), f64::from(d));
            let z = f64::from(z as f32);
            let exact = 0.5 * libm::erfc(-z / std::f64::consts::SQRT_2);
            let density = (-0.5 * z * z).exp() / (2.0 * std::f64::consts::PI).sqrt();
            assert!((p - exact).abs() < 1e-6, "Φ({z}) = {p}, not {exact}");
            assert!((d - density).abs() < 2e-6, "φ({z}) = {d}, not {density}");
        }
    }

    #[test]
    fn exp_and_ln_are_those_of_the_library() {
        for i in -8700..8800 {
            let x = (f64::from(i) * 0.01) as f32;
            let error = f64::from(exp(x)) / f64::from(x).exp() - 1.0;
            assert!(error.abs() < 3e-7, "exp({x}): {error}");
            let y = f64::from(x).exp() as f32;
            let error = f64::from(ln(y)) - f64::from(y).ln();
            assert!(error.abs() < 2e-7 * f64::from(x).abs().max(1.0), "ln({y}): {error}");
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
