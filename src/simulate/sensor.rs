//! From light to bytes: noise, the sensor's mosaic, and how light is stored.

use super::light::Table;
use crate::normal::normal;

/// A camera's sensor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sensor {
    /// Electrons that full white frees: the fewer, the more shot noise. `None`: no noise of light.
    pub full_well_e: Option<f64>,
    /// Noise of reading, electrons (of 10 000 where there is no noise of light).
    pub read_e: f64,
    /// Whether each pixel sees one colour only (R G in even rows, G B in odd ones), the others being interpolated.
    pub mosaic: bool,
}

impl Default for Sensor {
    /// A small industrial camera.
    fn default() -> Self {
        Self { full_well_e: Some(10_000.0), read_e: 5.0, mosaic: false }
    }
}

impl Sensor {
    /// A sensor without noise.
    pub const IDEAL: Self = Self { full_well_e: None, read_e: 0.0, mosaic: false };
}

/// Normal numbers, as many as an index of 13 bits tells apart.
const NORMALS: usize = 1 << 13;

/// Turns rows of light into bytes.
pub(super) struct Reader {
    sensor: Sensor,
    table: Table,
    normals: Vec<f32>,
}

impl Reader {
    pub(super) fn new(sensor: Sensor) -> Self {
        // Quantiles of the normal distribution would do; numbers drawn once are simpler, made to have variance 1.
        let mut random = fastrand::Rng::with_seed(0x006c_6967_6874);
        let drawn: Vec<f64> = (0..NORMALS / 2).map(|_| normal(&mut random)).collect();
        let sd = (drawn.iter().map(|v| v * v).sum::<f64>() / drawn.len() as f64).sqrt();
        // Each with its opposite: their mean is 0.
        let normals = drawn.iter().flat_map(|v| [(v / sd) as f32, (-v / sd) as f32]).collect();
        Self { sensor, table: Table::new(), normals }
    }

    /// Bytes R'G'B' of rows of light; `row` puts each into what it is given, three values per pixel. `seed` is that of
    /// the picture's noise.
    pub(super) fn read(&self, size_px: [usize; 2], seed: u64, mut row: impl FnMut(usize, &mut Vec<f32>)) -> Vec<u8> {
        let [width, height] = size_px;
        let mut bytes = vec![0; 3 * width * height];
        let mut lights = Vec::with_capacity(3 * width);
        if self.sensor.mosaic {
            let mut raw = vec![0.0; width * height];
            for (y, raw) in raw.chunks_mut(width).enumerate() {
                lights.clear();
                row(y, &mut lights);
                for (x, (raw, pixel)) in raw.iter_mut().zip(lights.chunks_exact(3)).enumerate() {
                    *raw = pixel.get(colour_of(x, y)).copied().unwrap_or_default();
                }
                self.add_noise(raw, stream(seed, y));
            }
            for (y, bytes) in bytes.chunks_mut(3 * width).enumerate() {
                for (x, pixel) in bytes.chunks_exact_mut(3).enumerate() {
                    for (colour, byte) in pixel.iter_mut().enumerate() {
                        *byte = self.table.byte(interpolated(&raw, size_px, [x, y], colour));
                    }
                }
            }
            return bytes;
        }
        for (y, bytes) in bytes.chunks_mut(3 * width).enumerate() {
            lights.clear();
            row(y, &mut lights);
            self.add_noise(&mut lights, stream(seed, y));
            bytes.iter_mut().zip(&lights).for_each(|(byte, light)| *byte = self.table.byte(*light));
        }
        bytes
    }

    /// Noise of light and of reading.
    fn add_noise(&self, lights: &mut [f32], mut state: u64) {
        let (by_light, of_reading) = match self.sensor.full_well_e {
            Some(full) => (1.0 / full, self.sensor.read_e / full),
            None => (0.0, self.sensor.read_e / 10_000.0),
        };
        if by_light == 0.0 && of_reading == 0.0 {
            return;
        }
        let (by_light, variance) = (by_light as f32, (of_reading * of_reading) as f32);
        for four in lights.chunks_mut(4) {
            // A step of Weyl's sequence, mixed: Steele, Lea and Flood, doi:10.1145/2714064.2660195.
            state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
            let mut bits = (state ^ (state >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
            bits = (bits ^ (bits >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
            for light in four {
                let normal = self.normals.get(bits as usize % NORMALS).copied().unwrap_or_default();
                bits >>= 16;
                *light += (by_light * light.max(0.0) + variance).sqrt() * normal;
            }
        }
    }
}

/// A seed of its own for each row of each picture, whatever thread draws it.
pub(super) fn stream(seed: u64, row: usize) -> u64 {
    let mut spread = fastrand::Rng::with_seed(seed ^ (row as u64).wrapping_mul(0xd134_2543_de82_ef95));
    spread.u64(..)
}

/// The colour that a pixel of the mosaic sees: 0 R, 1 G, 2 B.
fn colour_of(x: usize, y: usize) -> usize {
    (x & 1) + (y & 1)
}

/// A colour at a pixel of the mosaic: its own, or the mean of its neighbours that see it.
fn interpolated(raw: &[f32], [width, height]: [usize; 2], [x, y]: [usize; 2], colour: usize) -> f32 {
    if colour_of(x, y) == colour {
        return raw.get(y * width + x).copied().unwrap_or_default();
    }
    let (mut sum, mut count) = (0.0, 0.0);
    for j in y.saturating_sub(1)..(y + 2).min(height) {
        for i in x.saturating_sub(1)..(x + 2).min(width) {
            if colour_of(i, j) == colour {
                // Of green only the nearest: those beside, not those across the corners.
                if colour == 1 && i != x && j != y {
                    continue;
                }
                sum += raw.get(j * width + i).copied().unwrap_or_default();
                count += 1.0;
            }
        }
    }
    if count > 0.0 { sum / count } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulate::light::{linear, stored};

    fn flat(sensor: Sensor, light: f32, seed: u64) -> Vec<u8> {
        let row = vec![light; 3 * 100];
        Reader::new(sensor).read([100, 80], seed, |_, to| to.extend_from_slice(&row))
    }

    #[test]
    fn noise_is_that_of_the_electrons_and_the_same_for_a_seed() {
        let light = linear(110.0);
        let sensor = Sensor { full_well_e: Some(4000.0), read_e: 8.0, mosaic: false };
        let bytes = flat(sensor, light as f32, 7);
        assert_eq!(bytes, flat(sensor, light as f32, 7));
        assert_ne!(bytes, flat(sensor, light as f32, 8));
        let mean = bytes.iter().map(|v| f64::from(*v)).sum::<f64>() / bytes.len() as f64;
        let sd = (bytes.iter().map(|v| (f64::from(*v) - mean).powi(2)).sum::<f64>() / bytes.len() as f64).sqrt();
        // σ of the electrons, times what a stored unit is worth there; rounding to bytes adds 1/12.
        let electrons = light * 4000.0;
        let slope = (stored(light + 1e-4) - stored(light - 1e-4)) / 2e-4;
        let expected = ((electrons + 64.0).sqrt() / 4000.0 * slope).hypot(12_f64.sqrt().recip());
        assert!((mean - 110.0).abs() < 0.1 && (sd / expected - 1.0).abs() < 0.03, "{mean} {sd} {expected}");
    }

    #[test]
    fn a_mosaic_of_one_light_is_that_light() {
        let bytes = flat(Sensor { mosaic: true, ..Sensor::IDEAL }, 0.3, 1);
        assert!(bytes.iter().all(|v| *v == bytes[0]));
    }
}
