//! How a band is exposed: whether the camera could record its colour.

use nalgebra::Vector3;

/// Exposure of one band in one view.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Exposure {
    /// The value that 95 % of the samples' brightest channels stay below, R'G'B' 0..255.
    pub level: f64,
    /// Fraction of the samples at the end of the scale.
    pub clipped: f64,
}

/// Level from which a channel is saturated, and level below which it is lost in the noise.
const SATURATED: f64 = 251.0;
const DARK: f64 = 60.0;
/// Fractions of clipped samples that are worth a warning, and that leave no colour to learn.
const WARN_FRACTION: f64 = 0.03;
const LOST_FRACTION: f64 = 0.5;

impl Exposure {
    /// `None` without samples.
    pub(crate) fn of(rgb: &[Vector3<f64>]) -> Option<Self> {
        let mut brightest: Vec<f64> = rgb.iter().map(|v| v.max()).collect();
        brightest.sort_by(f64::total_cmp);
        let level = *brightest.get(brightest.len() * 95 / 100)?;
        let clipped = brightest.iter().filter(|v| **v >= SATURATED).count() as f64 / brightest.len() as f64;
        Some(Self { level: level.clamp(0.0, 255.0), clipped })
    }

    /// Whether the band's colour is lost: it is over- or underexposed.
    pub fn is_lost(&self) -> bool {
        self.clipped > LOST_FRACTION
    }

    /// What to do about it; `None` when it is fine.
    pub fn advice(&self) -> Option<String> {
        if self.clipped > WARN_FRACTION {
            return Some(format!(
                "{:.0} % of its pixels are at the end of the scale: halve the exposure",
                self.clipped * 100.0
            ));
        }
        (self.level < DARK)
            .then(|| format!("it reaches {:.0} of 255 only: double the exposure or the light", self.level))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn clipped_dim_and_fine_bands_are_told_apart() {
        let of = |v: f64| Exposure::of(&[Vector3::new(v, v / 2.0, 20.0); 40]).unwrap();
        assert!(of(255.0).is_lost() && of(255.0).advice().unwrap().contains("100 %"));
        assert!(of(40.0).advice().unwrap().contains("40 of 255"));
        assert!(of(150.0).advice().is_none() && !of(150.0).is_lost());
        assert!(Exposure::of(&[]).is_none());
    }
}
