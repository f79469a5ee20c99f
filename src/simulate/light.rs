//! Linear light and how it is stored: ITU-R BT.709-6, item 1.2.

/// R'G'B' of 0 to 255 for linear light, 0 black and 1 white.
pub(super) fn stored(light: f64) -> f64 {
    255.0 * if light < 0.018 { 4.5 * light } else { 1.099 * light.powf(0.45) - 0.099 }
}

/// Linear light of a stored value.
pub(super) fn linear(stored: f64) -> f64 {
    let v = (stored / 255.0).max(0.0);
    if v < 0.081 { v / 4.5 } else { ((v + 0.099) / 1.099).powf(1.0 / 0.45) }
}

/// Linear light of a colour.
pub(super) fn linear_rgb(stored: [f64; 3]) -> [f32; 3] {
    stored.map(|v| linear(v) as f32)
}

/// Stored bytes by linear light, in steps.
pub(super) struct Table(Vec<u8>);

/// Steps by unit of light, and the brightest light that is told from brighter.
const STEPS: f32 = 8192.0;

impl Table {
    pub(super) fn new() -> Self {
        let byte = |i: u32| stored(f64::from(i) / f64::from(STEPS)).round().clamp(0.0, 255.0) as u8;
        Self((0..=STEPS as u32).map(byte).collect())
    }

    /// The byte for light.
    #[inline]
    pub(super) fn byte(&self, light: f32) -> u8 {
        let step = (light * STEPS + 0.5).max(0.0) as usize;
        self.0.get(step).copied().unwrap_or(255)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn light_is_stored_as_the_tracker_reads_it() {
        // BT.709: 1.099·0.5^0.45 − 0.099 = 0.70551.
        assert!((stored(0.5) / 255.0 - 0.70551).abs() < 1e-5);
        let table = Table::new();
        for value in 0..=255_u8 {
            assert!((stored(linear(f64::from(value))) - f64::from(value)).abs() < 1e-9);
            assert_eq!(table.byte(linear(f64::from(value)) as f32), value);
        }
    }
}
