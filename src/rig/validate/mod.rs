//! From the file's numbers to a [`Draft`]: every value is checked here, with its key, and converted to metres. What a
//! draft must have to be a [`Rig`] is checked here too.

mod base;
mod camera;
mod markers;
mod views;

pub(crate) use markers::longest_stiff_m;

use super::error::nearest;
use super::file::RigFile;
use super::{Draft, Rig, RigError, covariance, own_lens};
use crate::optics::UNIT_TOLERANCE;
use nalgebra::Vector3;
use std::collections::BTreeMap;
use std::fmt::Display;
use std::path::Path;

/// Checks and converts a whole file; `file` is named in the messages.
pub(super) fn validate(raw: RigFile, file: &Path) -> Result<Draft, RigError> {
    let check = Check { file };
    let camera = check.camera(&raw.camera)?;
    let mut surfaces = BTreeMap::new();
    for (name, surface) in &raw.surfaces {
        surfaces.insert(name.clone(), check.surface(name, surface)?);
    }
    check.count("view", raw.views.len(), MAX_VIEWS)?;
    check.count("marker", raw.markers.len(), MAX_MARKERS)?;
    check.names("view", raw.views.iter().map(|v| v.name.as_str()))?;
    check.names("marker", raw.markers.iter().map(|m| m.name.as_str()))?;
    let views = raw.views.into_iter().map(|v| check.view(v, &camera, &surfaces)).collect::<Result<Vec<_>, _>>()?;
    let markers = raw.markers.into_iter().map(|m| check.marker(m, &views)).collect::<Result<Vec<_>, _>>()?;
    check.bands_apart(&markers)?;
    let catheter = raw.catheter.map(|catheter| check.catheter(&catheter, &markers)).transpose()?;
    let base = raw.base.map(|base| check.base(&base)).transpose()?;
    let wrong = covariance::wrong(&raw.provenance, &camera.lens).or_else(|| own_lens::wrong(&raw.provenance));
    if let Some(covariance::Wrong { key, value, expected }) = wrong {
        return Err(check.value(key, value, expected));
    }
    Ok(Draft { camera, surfaces, views, markers, catheter, base, provenance: raw.provenance })
}

/// A draft that has all parts is a rig; `file` is named in the message about a missing one.
pub(super) fn complete(draft: Draft, file: &Path) -> Result<Rig, RigError> {
    let Draft { camera, surfaces, views, markers, catheter, base, provenance } = draft;
    let check = Check { file };
    if views.is_empty() {
        return Err(check.key("view", "expected at least one [[view]]: `catoptra calibrate rig` adds them"));
    }
    if markers.is_empty() {
        return Err(check.no_marker());
    }
    let Some(catheter) = catheter else {
        return Err(check.key("catheter", "missing: `catoptra calibrate markers` adds it"));
    };
    Ok(Rig { camera, surfaces, views, markers, catheter, base, provenance })
}

/// Checks the values of one file.
struct Check<'a> {
    file: &'a Path,
}

/// Nothing is further away: 100 m.
const FARTHEST_MM: f64 = 1e5;
/// Most views and markers: the assignment tries every pair of a marker's places in two views.
const MAX_VIEWS: usize = 8;
const MAX_MARKERS: usize = 16;

impl Check<'_> {
    fn value(&self, key: impl Display, value: impl Display, expected: impl Display) -> RigError {
        RigError::Value {
            file: self.file.to_path_buf(),
            key: key.to_string(),
            value: value.to_string(),
            expected: expected.to_string(),
        }
    }

    fn key(&self, key: impl Display, problem: impl Display) -> RigError {
        RigError::Key { file: self.file.to_path_buf(), key: key.to_string(), problem: problem.to_string() }
    }

    fn no_marker(&self) -> RigError {
        self.key("marker", "expected at least one [[marker]]: `catoptra calibrate markers` adds them")
    }

    fn finite(&self, key: impl Display, values: &[f64]) -> Result<(), RigError> {
        match values {
            _ if values.iter().all(|v| v.is_finite()) => Ok(()),
            [value] => Err(self.value(key, value, "a finite number")),
            _ => Err(self.value(key, format!("{values:?}"), "finite numbers")),
        }
    }

    /// Finite numbers from −`most` to `most`.
    fn within(&self, key: impl Display, values: &[f64], most: f64) -> Result<(), RigError> {
        self.finite(&key, values)?;
        match values.iter().find(|v| v.abs() > most) {
            Some(value) => Err(self.value(key, value, format_args!("at most {most}, and at least -{most}"))),
            None => Ok(()),
        }
    }

    fn positive(&self, key: impl Display, value: f64) -> Result<(), RigError> {
        if value.is_finite() && value > 0.0 { Ok(()) } else { Err(self.value(key, value, "a positive number")) }
    }

    /// A unit vector; the rounding of the file is corrected.
    fn unit(&self, key: impl Display, v: [f64; 3]) -> Result<Vector3<f64>, RigError> {
        self.finite(&key, &v)?;
        let length = Vector3::from(v).norm();
        if (length - 1.0).abs() > UNIT_TOLERANCE {
            let unit = v.map(|x| (x / length * 1e6).round() / 1e6);
            let hint = if length > 0.0 { format!(", for this direction {unit:?}") } else { String::new() };
            return Err(self.value(key, format!("{v:?}"), format!("length 1, it is {length:.6}{hint}")));
        }
        Ok(Vector3::from(v) / length)
    }

    fn count(&self, section: &str, found: usize, most: usize) -> Result<(), RigError> {
        if found <= most {
            return Ok(());
        }
        Err(self.value(section, format_args!("{found} of them"), format_args!("{most} at most")))
    }

    /// Names that fit into tables and messages; each used once.
    fn names<'n>(&self, section: &str, names: impl Iterator<Item = &'n str>) -> Result<(), RigError> {
        let mut seen: Vec<&str> = Vec::new();
        for name in names {
            self.name(format_args!("{section}.name"), name)?;
            if seen.contains(&name) {
                return Err(self.value(
                    format_args!("{section}.name"),
                    format_args!("{name:?}"),
                    "a different name for each",
                ));
            }
            seen.push(name);
        }
        Ok(())
    }

    fn name(&self, key: impl Display, name: &str) -> Result<(), RigError> {
        let plain = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '-';
        // Tables and summaries count what is missing by these names.
        if ["tangent", "deflection", "theta"].contains(&name) {
            return Err(self.value(key, format_args!("{name:?}"), "another name: this one is that of a result"));
        }
        if !name.is_empty() && name.chars().all(plain) {
            return Ok(());
        }
        Err(self.value(key, format_args!("{name:?}"), "letters, digits, `_` and `-` (it names columns and topics)"))
    }
}

/// "a surface of this file, did you mean ...?"
pub(super) fn unknown_name<'n>(what: &str, name: &str, known: impl Iterator<Item = &'n str> + Clone) -> String {
    match nearest(name, known.clone()) {
        Some(near) => format!("the name of {what}, did you mean {near:?}?"),
        None => format!("the name of {what}: {}", known.collect::<Vec<_>>().join(", ")),
    }
}
