//! The coil in the field and the pendulum that hangs from it: Eq. 6 of the paper, and the file `plant.toml`.

use crate::text_file;
use serde::Deserialize;
use std::path::{Path, PathBuf};

/// Standard gravity.
const GRAVITY_M_S2: f64 = 9.806_65;

/// Converts current and angle to torque.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Plant {
    /// A N B0: torque of one ampere across the field, N·m/A.
    pub torque_per_ampere_nm: f64,
    /// m g L: torque of gravity at 90°, N·m.
    pub weight_torque_nm: f64,
}

impl Plant {
    /// Net torque of Eq. 6, i A N B0 cos θ − m g L sin θ, N·m.
    pub fn torque_nm(&self, current_a: f64, theta_rad: f64) -> f64 {
        current_a * self.torque_by_current(theta_rad) - self.weight_torque_nm * theta_rad.sin()
    }

    /// Change of the torque with the current, N·m/A.
    pub(super) fn torque_by_current(&self, theta_rad: f64) -> f64 {
        self.torque_per_ampere_nm * theta_rad.cos()
    }

    /// Change of the torque when the angle is measured from a zero that lies higher: −∂torque/∂θ, N·m per rad.
    pub(super) fn torque_by_zero(&self, current_a: f64, theta_rad: f64) -> f64 {
        current_a * self.torque_per_ampere_nm * theta_rad.sin() + self.weight_torque_nm * theta_rad.cos()
    }

    /// Reads `plant.toml`.
    ///
    /// # Errors
    /// When it cannot be read, is not such a file, or a value cannot be right.
    pub fn load(path: &Path) -> Result<Self, PlantError> {
        let file = || path.to_owned();
        let text = text_file::read(path).map_err(|source| PlantError::Read { file: file(), source })?;
        let raw: Raw = toml::from_str(&text).map_err(|e| {
            let (line, message) = text_file::toml_error(&text, &e);
            PlantError::Syntax { file: file(), line, message }
        })?;
        for (key, value, zero_allowed) in [
            ("turns", raw.turns, false),
            ("area_mm2", raw.area_mm2, false),
            ("b0_t", raw.b0_t, false),
            ("mass_g", raw.mass_g, true),
            ("length_mm", raw.length_mm, true),
            ("gravity_m_s2", raw.gravity_m_s2.unwrap_or(GRAVITY_M_S2), true),
        ] {
            if !(value.is_finite() && (value > 0.0 || zero_allowed && value == 0.0)) {
                let expected = if zero_allowed { "a number not below 0" } else { "a number above 0" };
                return Err(PlantError::Value { file: file(), key, value, expected });
            }
        }
        Ok(Self {
            torque_per_ampere_nm: raw.turns * raw.area_mm2 * 1e-6 * raw.b0_t,
            weight_torque_nm: raw.mass_g * 1e-3 * raw.gravity_m_s2.unwrap_or(GRAVITY_M_S2) * raw.length_mm * 1e-3,
        })
    }
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Raw {
    turns: f64,
    area_mm2: f64,
    b0_t: f64,
    mass_g: f64,
    length_mm: f64,
    gravity_m_s2: Option<f64>,
}

/// Why a plant file cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum PlantError {
    /// The file cannot be read.
    #[error("cannot read plant file {}", file.display())]
    Read {
        /// Which file.
        file: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// Not TOML, a key missing or unknown, or a value of the wrong type.
    #[error("{}:{line}: {message}; the keys are turns, area_mm2, b0_t, mass_g, length_mm and, if wanted, \
        gravity_m_s2", file.display())]
    Syntax {
        /// Which file.
        file: PathBuf,
        /// Line, from 1.
        line: usize,
        /// What the parser said.
        message: String,
    },
    /// A value that cannot be right.
    #[error("{}: {key} = {value}: expected {expected}", file.display())]
    Value {
        /// Which file.
        file: PathBuf,
        /// The key.
        key: &'static str,
        /// Its value.
        value: f64,
        /// What would be right.
        expected: &'static str,
    },
}

#[cfg(test)]
mod tests {
    use super::*;

    fn load(text: &str) -> Result<Plant, String> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("plant.toml");
        std::fs::write(&path, text).unwrap();
        Plant::load(&path).map_err(|e| e.to_string().replace(&path.display().to_string(), "plant.toml"))
    }

    const GOOD: &str = "turns = 100\narea_mm2 = 8\nb0_t = 3.0\nmass_g = 0.5\nlength_mm = 100\n";

    #[test]
    fn eq_6_by_hand() {
        let plant = load(GOOD).unwrap();
        assert!((plant.torque_per_ampere_nm - 2.4e-3).abs() < 1e-18);
        assert!((plant.weight_torque_nm - 0.5e-3 * 9.80665 * 0.1).abs() < 1e-18);
        let torque = plant.torque_nm(0.1, std::f64::consts::FRAC_PI_6);
        assert!((torque - (2.4e-4 * 0.75_f64.sqrt() - 0.5 * plant.weight_torque_nm)).abs() < 1e-15);
        let change = plant.torque_nm(0.1, 0.3 - 1e-6) - plant.torque_nm(0.1, 0.3 + 1e-6);
        assert!((change / 2e-6 - plant.torque_by_zero(0.1, 0.3)).abs() < 1e-12);
    }

    #[test]
    fn what_cannot_be_right_is_named() {
        let error = load(&GOOD.replace("b0_t = 3.0", "b0_t = -3")).unwrap_err();
        assert_eq!(error, "plant.toml: b0_t = -3: expected a number above 0");
        let error = load(&GOOD.replace("turns", "turn")).unwrap_err();
        assert!(error.starts_with("plant.toml:1: unknown field `turn`"), "{error}");
        let error = load(&GOOD.replace("mass_g", "mas_g")).unwrap_err();
        assert!(error.starts_with("plant.toml:4: unknown field `mas_g`"), "{error}");
        let error = load("turns = 1\n").unwrap_err();
        assert!(error.contains("missing field `area_mm2`"), "{error}");
        assert!(load(&GOOD.replace("100\na", "nan\na")).unwrap_err().contains("turns = NaN"));
        assert!(Plant::load(Path::new("nowhere/plant.toml")).unwrap_err().to_string().contains("nowhere/plant.toml"));
    }
}
