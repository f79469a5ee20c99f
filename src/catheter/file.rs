//! `catheter.toml`: the catheter as a file that people edit. Lengths in mm, moduli in MPa, currents in mA.

use super::error::CatheterError;
use super::model::{Bands, Catheter, CoilSet, Motion, Surroundings, Tube};
use crate::text_file;
use nalgebra::{Matrix3, Rotation3, Vector3};
use serde::Deserialize;
use std::path::Path;

/// Largest field, tesla, and curvature at rest, 1/m, that are no slip of the pen.
const MAX_FIELD_T: f64 = 30.0;
const MAX_CURVATURE: f64 = 100.0;

impl Catheter {
    /// Reads `catheter.toml`.
    ///
    /// # Errors
    /// [`CatheterError`] when it cannot be read, is no such file, or a value cannot be right.
    pub fn load(path: &Path) -> Result<Self, CatheterError> {
        let text = text_file::read(path).map_err(|source| CatheterError::Read { file: path.to_owned(), source })?;
        let raw: Raw = toml::from_str(&text).map_err(|e| {
            let (line, message) = text_file::toml_error(&text, &e);
            CatheterError::Syntax { file: path.to_owned(), line, message }
        })?;
        raw.check(path)?;
        Ok(raw.catheter())
    }
}

impl Catheter {
    /// The text of a `catheter.toml`. `heading`: a line for people.
    pub fn to_toml(&self, heading: &str) -> String {
        let Self { tube, coils, surroundings, motion, bands, .. } = self;
        let depth = surroundings.depth_m.map_or_else(String::new, |m| format!("tank_depth_mm = {:?}\n", m * 1e3));
        let bands = bands.map_or_else(String::new, |Bands { base_m, tip_m }| {
            format!("\n[bands]\nbase_mm = {:?}\ntip_mm = {:?}\n", base_m * 1e3, tip_m * 1e3)
        });
        let vector = |v: &Vector3<f64>| format!("[{:?}, {:?}, {:?}]", v.x, v.y, v.z);
        let n = (coils.moment_per_ampere_m2 * 1e6).transpose();
        let rows = n.column_iter().map(|row| format!("    {},\n", vector(&row.into_owned()))).collect::<String>();
        format!(
            "# {}\n\n[tube]\nouter_radius_mm = {:?}\ninner_radius_mm = {:?}\nflexible_mm = {:?}\ntail_mm = {:?}\n\
             young_mpa = {:?}\nshear_mpa = {:?}\ndensity_kg_m3 = {:?}\nrest_curvature_per_m = {}\n\n\
             [coils]\nlength_mm = {:?}\nmoment_per_ampere_mm2 = [\n{rows}]\nmass_g = {:?}\nvolume_mm3 = {:?}\n\
             limit_ma = {:?}\n\n[surroundings]\nb0_t = {}\ngravity_m_s2 = {}\nfluid_kg_m3 = {:?}\n{depth}\n[motion]\n\
             damping_s = {:?}\nadded_mass = {:?}\ndrag = {:?}\nlinear_drag_pa_s = {:?}\n{bands}",
            heading.replace(['\n', '\r'], " "),
            tube.outer_radius_m * 1e3,
            tube.inner_radius_m * 1e3,
            self.flexible_m * 1e3,
            self.tail_m * 1e3,
            tube.young_pa / 1e6,
            tube.shear_pa / 1e6,
            tube.density_kg_m3,
            vector(&tube.rest_curvature_per_m),
            self.coil_m * 1e3,
            coils.mass_kg * 1e3,
            coils.volume_m3 * 1e9,
            coils.limit_a * 1e3,
            vector(&surroundings.b0_t),
            vector(&surroundings.gravity_m_s2),
            surroundings.fluid_kg_m3,
            motion.damping_s,
            motion.added_mass,
            motion.drag,
            motion.linear_drag_pa_s,
        )
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Raw {
    tube: RawTube,
    coils: RawCoils,
    surroundings: RawSurroundings,
    motion: RawMotion,
    #[serde(default)]
    bands: Option<RawBands>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawTube {
    outer_radius_mm: f64,
    inner_radius_mm: f64,
    flexible_mm: f64,
    tail_mm: f64,
    young_mpa: f64,
    shear_mpa: f64,
    density_kg_m3: f64,
    #[serde(default)]
    rest_curvature_per_m: [f64; 3],
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawCoils {
    length_mm: f64,
    /// Row by row; each column is a coil.
    moment_per_ampere_mm2: [[f64; 3]; 3],
    #[serde(default)]
    alignment_deg: f64,
    #[serde(default)]
    mass_g: f64,
    #[serde(default)]
    volume_mm3: f64,
    limit_ma: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawSurroundings {
    b0_t: [f64; 3],
    gravity_m_s2: [f64; 3],
    fluid_kg_m3: f64,
    #[serde(default)]
    tank_depth_mm: Option<f64>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawMotion {
    damping_s: f64,
    added_mass: f64,
    drag: f64,
    linear_drag_pa_s: f64,
}

/// From the clamp to the bands' middles.
#[derive(Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields)]
struct RawBands {
    base_mm: f64,
    tip_mm: f64,
}

impl Raw {
    /// Whether every value can be that of a catheter.
    fn check(&self, file: &Path) -> Result<(), CatheterError> {
        let Self { tube, coils, surroundings, motion, bands } = self;
        let wrong = |key: &'static str, value: String, expected: &'static str| {
            Err(CatheterError::Value { file: file.to_owned(), key, value, expected })
        };
        for (key, value) in [
            ("tube.outer_radius_mm", tube.outer_radius_mm),
            ("tube.flexible_mm", tube.flexible_mm),
            ("tube.tail_mm", tube.tail_mm),
            ("tube.young_mpa", tube.young_mpa),
            ("tube.shear_mpa", tube.shear_mpa),
            ("tube.density_kg_m3", tube.density_kg_m3),
            ("coils.length_mm", coils.length_mm),
            ("coils.limit_ma", coils.limit_ma),
        ] {
            if !(value.is_finite() && value > 0.0) {
                return wrong(key, value.to_string(), "a number above 0");
            }
        }
        for (key, value) in [
            ("tube.inner_radius_mm", tube.inner_radius_mm),
            ("coils.mass_g", coils.mass_g),
            ("coils.volume_mm3", coils.volume_mm3),
            ("surroundings.fluid_kg_m3", surroundings.fluid_kg_m3),
            ("motion.damping_s", motion.damping_s),
            ("motion.added_mass", motion.added_mass),
            ("motion.drag", motion.drag),
            ("motion.linear_drag_pa_s", motion.linear_drag_pa_s),
        ] {
            if !(value.is_finite() && value >= 0.0) {
                return wrong(key, value.to_string(), "a number not below 0");
            }
        }
        if tube.inner_radius_mm >= tube.outer_radius_mm {
            return wrong("tube.inner_radius_mm", tube.inner_radius_mm.to_string(), "less than tube.outer_radius_mm");
        }
        if let Some(depth_mm) = surroundings.tank_depth_mm {
            let length_mm = tube.flexible_mm + coils.length_mm + tube.tail_mm;
            if !(depth_mm.is_finite() && depth_mm > 0.0) {
                return wrong("surroundings.tank_depth_mm", depth_mm.to_string(), "a number above 0");
            }
            if length_mm > depth_mm {
                return Err(CatheterError::Tank { file: file.to_owned(), length_mm, depth_mm });
            }
        }
        if let Some(RawBands { base_mm, tip_mm }) = *bands {
            let coil_mm = tube.flexible_mm..=tube.flexible_mm + coils.length_mm;
            if !(base_mm >= 0.0 && base_mm < *coil_mm.start()) {
                return wrong("bands.base_mm", base_mm.to_string(), "a place from the clamp (0) to tube.flexible_mm");
            }
            if !(tip_mm > *coil_mm.end() && tip_mm <= coil_mm.end() + tube.tail_mm) {
                return wrong("bands.tip_mm", tip_mm.to_string(), "a place on the tail, counted from the clamp");
            }
        }
        let moments = coils.moment_per_ampere_mm2;
        if !moments.as_flattened().iter().all(|v| v.is_finite()) {
            return wrong("coils.moment_per_ampere_mm2", format!("{moments:?}"), "nine numbers");
        }
        if !coils.alignment_deg.is_finite() {
            return wrong("coils.alignment_deg", coils.alignment_deg.to_string(), "an angle in degrees");
        }
        for (key, vector, most, expected) in [
            ("tube.rest_curvature_per_m", tube.rest_curvature_per_m, MAX_CURVATURE, "numbers between -100 and 100"),
            ("surroundings.b0_t", surroundings.b0_t, MAX_FIELD_T, "three numbers, tesla, of 30 T at most"),
            ("surroundings.gravity_m_s2", surroundings.gravity_m_s2, 100.0, "three numbers, m/s²"),
        ] {
            if !vector.iter().all(|v| v.abs() <= most) {
                return wrong(key, format!("{vector:?}"), expected);
            }
        }
        Ok(())
    }

    /// In SI units.
    fn catheter(&self) -> Catheter {
        let Self { tube, coils, surroundings, motion, bands } = self;
        let mm = |value: f64| value / 1e3;
        let turn = Rotation3::from_axis_angle(&Vector3::z_axis(), coils.alignment_deg.to_radians());
        Catheter {
            tube: Tube {
                outer_radius_m: mm(tube.outer_radius_mm),
                inner_radius_m: mm(tube.inner_radius_mm),
                young_pa: tube.young_mpa * 1e6,
                shear_pa: tube.shear_mpa * 1e6,
                density_kg_m3: tube.density_kg_m3,
                rest_curvature_per_m: tube.rest_curvature_per_m.into(),
            },
            flexible_m: mm(tube.flexible_mm),
            coil_m: mm(coils.length_mm),
            tail_m: mm(tube.tail_mm),
            coils: CoilSet {
                moment_per_ampere_m2: turn * Matrix3::from_row_slice(coils.moment_per_ampere_mm2.as_flattened()) / 1e6,
                mass_kg: coils.mass_g / 1e3,
                volume_m3: coils.volume_mm3 / 1e9,
                limit_a: coils.limit_ma / 1e3,
            },
            surroundings: Surroundings {
                b0_t: surroundings.b0_t.into(),
                gravity_m_s2: surroundings.gravity_m_s2.into(),
                fluid_kg_m3: surroundings.fluid_kg_m3,
                depth_m: surroundings.tank_depth_mm.map(mm),
            },
            motion: Motion {
                damping_s: motion.damping_s,
                added_mass: motion.added_mass,
                drag: motion.drag,
                linear_drag_pa_s: motion.linear_drag_pa_s,
            },
            bands: bands.map(|bands| Bands { base_m: mm(bands.base_mm), tip_m: mm(bands.tip_mm) }),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::PathBuf;

    fn sample() -> PathBuf {
        Path::new(env!("CARGO_MANIFEST_DIR")).join("sample_dynamics/catheter.toml")
    }

    #[test]
    fn the_sample_is_the_prototype() {
        let (read, expected) = (Catheter::load(&sample()).unwrap(), Catheter::prototype());
        let near = |a: f64, b: f64| (a - b).abs() <= 2e-4 * b.abs();
        assert!(near(read.coils.mass_kg, expected.coils.mass_kg), "{} {}", read.coils.mass_kg, expected.coils.mass_kg);
        assert!(near(read.coils.volume_m3, expected.coils.volume_m3), "{}", expected.coils.volume_m3);
        let off = (read.coils.moment_per_ampere_m2 - expected.coils.moment_per_ampere_m2).amax();
        assert!(off < 1e-7, "{}", expected.coils.moment_per_ampere_m2);
        assert!(near(read.tube.bending_nm2(), expected.tube.bending_nm2()));
        assert!(near(read.tube.torsion_nm2(), expected.tube.torsion_nm2()));
        assert!((read.length_m() - expected.length_m()).abs() < 1e-12);
        assert_eq!(read.surroundings, expected.surroundings);
        assert_eq!(read.motion, expected.motion);
    }

    #[test]
    fn what_is_written_is_read_back() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("catheter.toml");
        let mut catheter = Catheter::prototype();
        catheter.coils.moment_per_ampere_m2[(0, 1)] = 1e-5;
        catheter.bands = Some(Bands { base_m: 6e-3, tip_m: 0.11 });
        std::fs::write(&file, catheter.to_toml("of this test")).unwrap();
        let read = Catheter::load(&file).unwrap();
        assert!((read.coils.moment_per_ampere_m2 - catheter.coils.moment_per_ampere_m2).amax() < 1e-15);
        assert!((read.tube.bending_nm2() / catheter.tube.bending_nm2() - 1.0).abs() < 1e-12);
        assert_eq!((read.surroundings, read.motion), (catheter.surroundings, catheter.motion));
        assert_eq!(read.bands, catheter.bands);
    }

    #[test]
    fn values_that_cannot_be_right_are_named() {
        let sample = std::fs::read_to_string(sample()).unwrap();
        for (from, to, expected) in [
            ("young_mpa = 5.39", "young_mpa = 0.0", "tube.young_mpa is 0, expected a number above 0"),
            ("inner_radius_mm = 0.9906", "inner_radius_mm = 2.0", "tube.inner_radius_mm is 2, expected less than"),
            ("limit_ma = 100.0", "limit_ma = nan", "coils.limit_ma is NaN, expected a number above 0"),
            ("b0_t = [3.0", "b0_t = [3000.0", "expected three numbers, tesla, of 30 T at most"),
            ("tail_mm", "tial_mm", "unknown field `tial_mm`"),
            ("flexible_mm = 82.65", "flexible_mm = 282.65", "the catheter is 319.65 mm long, the tank 267 mm deep"),
            (
                "[motion]",
                "[bands]\nbase_mm = 90.0\ntip_mm = 110.0\n[motion]",
                "bands.base_mm is 90, expected a place from the clamp (0) to tube.flexible_mm",
            ),
            (
                "[motion]",
                "[bands]\nbase_mm = 6.0\ntip_mm = 120.0\n[motion]",
                "bands.tip_mm is 120, expected a place on the tail, counted from the clamp",
            ),
            (
                "tank_depth_mm = 267.0",
                "tank_depth_mm = -1.0",
                "surroundings.tank_depth_mm is -1, expected a number above 0",
            ),
        ] {
            assert!(sample.contains(from), "{from}");
            let folder = tempfile::tempdir().unwrap();
            let path = folder.path().join("catheter.toml");
            std::fs::write(&path, sample.replacen(from, to, 1)).unwrap();
            let error = Catheter::load(&path).unwrap_err().to_string();
            assert!(error.contains("catheter.toml") && error.contains(expected), "{error}");
        }
    }
}
