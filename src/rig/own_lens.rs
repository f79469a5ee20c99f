//! The lens as `calibrate camera` or `rig import` left it, noted in `[provenance.camera.lens]`. `calibrate rig` adjusts
//! the one under `[camera]`, and must start from this one: started from its own result, the same pictures count again.

use super::covariance::{Wrong, number};
use super::numbers::decimal;
use super::write::{DIRECTION_DECIMALS, PIXEL_DECIMALS};
use super::{Draft, RigError};
use crate::optics::Lens;
use nalgebra::{Point2, Vector2};
use std::path::Path;
use toml::{Table, Value};

/// Names of the parameters by which it shows that a lens was adjusted: all of them are, or none.
const ADJUSTED: &str = "focal_x_px";

/// A lens as it is noted: the numbers that the file has under `[camera]`, to the last digit.
pub(crate) fn lens_note(lens: &Lens) -> Table {
    let list = |values: &[f64], decimals: usize| {
        let as_written = |v: &f64| Value::from(decimal(*v, decimals).parse::<f64>().unwrap_or(*v));
        Value::from(values.iter().map(as_written).collect::<Vec<_>>())
    };
    let mut note = Table::from_iter([
        ("focal_px".to_owned(), list(lens.focal_px.as_slice(), PIXEL_DECIMALS)),
        ("principal_point_px".to_owned(), list(lens.principal_point_px.coords.as_slice(), PIXEL_DECIMALS)),
        ("distortion".to_owned(), list(&lens.distortion, DIRECTION_DECIMALS)),
    ]);
    if lens.is_rational() {
        note.insert("denominator".to_owned(), list(&lens.denominator, DIRECTION_DECIMALS));
    }
    note
}

impl Draft {
    /// Whether `calibrate rig` adjusted the lens, as far as its σ were known, or took it as exact; `None` where it does
    /// not say.
    pub(crate) fn lens_is_adjusted(&self) -> Option<bool> {
        self.rig_covariance().map(|(names, _)| names.contains(&ADJUSTED))
    }

    /// The same with the lens of its own calibration, before `calibrate rig` adjusted it; `name` is the file in the
    /// error.
    ///
    /// # Errors
    /// [`RigError::Key`] when it was adjusted and not noted before, as by older versions.
    pub(crate) fn with_own_lens(mut self, name: &Path) -> Result<Self, RigError> {
        if self.lens_is_adjusted() != Some(true) || self.lens_covariance().is_none() {
            return Ok(self);
        }
        let noted = noted(&self.provenance).and_then(|note| read(note).ok());
        self.camera.lens = noted.ok_or_else(|| RigError::Key {
            file: name.to_path_buf(),
            key: "provenance.camera.lens".to_owned(),
            problem: "missing, as in files of older versions: `calibrate rig` has adjusted the lens, and what \
                      `calibrate camera` found is not known any more. Started from the adjusted one, the same pictures \
                      would count twice: run `catoptra calibrate camera` again, or give the file that it wrote \
                      (RIG.toml.bak, .bak2, …)"
                .to_owned(),
        })?;
        Ok(self)
    }
}

/// What is wrong with the noted lens.
pub(super) fn wrong(provenance: &Table) -> Option<Wrong> {
    read(noted(provenance)?).err()
}

fn noted(provenance: &Table) -> Option<&Value> {
    provenance.get("camera")?.get("lens")
}

fn read(note: &Value) -> Result<Lens, Wrong> {
    let of = |key: &str, value: Option<&Value>, expected: String| Wrong {
        key: format!("provenance.camera.lens{key}"),
        value: value.map_or("missing".to_owned(), Value::to_string),
        expected,
    };
    let lens = Lens {
        focal_px: Vector2::from(numbers(note, "focal_px").map_err(|(value, text)| of(".focal_px", value, text))?),
        principal_point_px: Point2::from(
            numbers(note, "principal_point_px").map_err(|(value, text)| of(".principal_point_px", value, text))?,
        ),
        distortion: numbers(note, "distortion").map_err(|(value, text)| of(".distortion", value, text))?,
        denominator: match note.get("denominator") {
            Some(_) => numbers(note, "denominator").map_err(|(value, text)| of(".denominator", value, text))?,
            None => [0.0; 3],
        },
    };
    lens.validate().map_err(|why| of("", Some(note), format!("a lens: {why}")))?;
    Ok(lens)
}

/// A list of so many finite numbers, or what is there instead and what is expected.
fn numbers<'a, const N: usize>(note: &'a Value, key: &str) -> Result<[f64; N], (Option<&'a Value>, String)> {
    let value = note.get(key);
    let found = value.and_then(Value::as_array).and_then(|list| list.iter().map(number).collect::<Option<Vec<f64>>>());
    let found = found.filter(|list| list.iter().all(|v| v.is_finite())).and_then(|list| list.try_into().ok());
    found.ok_or_else(|| (value, format!("a list of {N} finite numbers")))
}
