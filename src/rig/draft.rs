//! Operations on a rig file that may be incomplete.

use super::{Camera, Draft, Rig, RigError, View, file, validate, write};
use crate::optics::Lens;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

impl Draft {
    /// A draft with only a camera.
    pub fn of_camera(camera: Camera) -> Self {
        Self {
            camera,
            surfaces: BTreeMap::new(),
            views: Vec::new(),
            markers: Vec::new(),
            catheter: None,
            base: None,
            provenance: toml::Table::new(),
        }
    }

    /// The same with another lens. Surfaces, views and base frame were calibrated with the old one and do not fit the
    /// new one: they are removed, with their provenance. Bands and tube stay.
    pub fn with_lens(self, size_px: [u32; 2], lens: Lens) -> Self {
        let camera = Camera { size_px, lens, ..self.camera };
        Self { markers: self.markers, catheter: self.catheter, ..Self::of_camera(camera) }
    }

    /// The view of this name; `file` is named in the error when there is none.
    ///
    /// # Errors
    /// [`RigError::Value`] with the nearest name.
    pub fn view(&self, name: &str, file: &Path) -> Result<&View, RigError> {
        let expected = || match self.views.is_empty() {
            true => "no view: this rig has none yet".to_owned(),
            false => validate::unknown_name("a view of this rig", name, self.views.iter().map(|v| v.name.as_str())),
        };
        self.views.iter().find(|view| view.name == name).ok_or_else(|| RigError::Value {
            file: file.to_path_buf(),
            key: "view".to_owned(),
            value: format!("{name:?}"),
            expected: expected(),
        })
    }

    /// Reads and checks a `rig.toml` that need not be complete.
    ///
    /// # Errors
    /// [`RigError`] with the file, the key, its value and what would be right.
    pub fn load(path: &Path) -> Result<Self, RigError> {
        let text =
            std::fs::read_to_string(path).map_err(|source| RigError::Read { file: path.to_path_buf(), source })?;
        Self::from_toml_str(&text, path)
    }

    /// As [`Draft::load`] from text; `name` is the file in error messages.
    ///
    /// # Errors
    /// [`RigError`], as [`Draft::load`].
    pub fn from_toml_str(text: &str, name: &Path) -> Result<Self, RigError> {
        validate::validate(file::parse(text, name)?, name)
    }

    /// The same draft, checked as if it had been read from a file; `name` is the file in error messages.
    ///
    /// # Errors
    /// [`RigError`], as [`Draft::load`].
    pub fn checked(&self, name: &Path) -> Result<Self, RigError> {
        Self::from_toml_str(&self.to_toml_string(), name)
    }

    /// The parts that a rig still needs, in the order of calibration, each with the command that finds it; empty when
    /// complete.
    pub fn missing(&self) -> Vec<(&'static str, &'static str)> {
        [
            (self.views.is_empty(), "mirrors, walls and views", "catoptra calibrate rig"),
            (self.markers.is_empty() || self.catheter.is_none(), "bands and tube", "catoptra calibrate markers"),
            (self.base.is_none(), "base frame and B0", "catoptra calibrate base"),
        ]
        .into_iter()
        .filter_map(|(lacks, what, command)| lacks.then_some((what, command)))
        .collect()
    }

    /// σ of a parameter as the calibrations recorded it: `focal_x_px`, …, `k3` for the lens, `NAME_offset_m` for a
    /// surface; `None` when they did not.
    pub fn noted_sd(&self, parameter: &str) -> Option<f64> {
        const LENS: [&str; 12] = [
            "focal_x_px",
            "focal_y_px",
            "principal_point_x_px",
            "principal_point_y_px",
            "k1",
            "k2",
            "p1",
            "p2",
            "k3",
            "k4",
            "k5",
            "k6",
        ];
        let of_rig = || {
            let (names, covariance) = self.rig_covariance()?;
            let at = names.iter().position(|name| *name == parameter)?;
            covariance.get((at, at)).copied()
        };
        let of_camera = || {
            let at = LENS.iter().position(|name| *name == parameter)?;
            self.lens_covariance()?.get((at, at)).copied()
        };
        of_rig().or_else(of_camera).filter(|variance| *variance >= 0.0).map(f64::sqrt)
    }

    /// The doubts that calibrations recorded about what they found: the step (`rig`, `mirror`, `base`), and each of its
    /// doubts.
    pub fn noted_doubts(&self) -> impl Iterator<Item = (&str, &str)> {
        self.provenance.iter().flat_map(|(step, noted)| {
            let doubts = noted.get("doubts").and_then(toml::Value::as_array);
            doubts.into_iter().flatten().filter_map(move |doubt| Some((step.as_str(), doubt.as_str()?)))
        })
    }

    /// The rig, when all its parts are there; `name` is the file in error messages.
    ///
    /// # Errors
    /// [`RigError::Key`] with the missing part.
    pub fn complete(self, name: &Path) -> Result<Rig, RigError> {
        validate::complete(self, name)
    }

    /// Writes `rig.toml`: into a new file beside `path`, which then replaces it, so that a reader finds the old or the
    /// new file, never half of one. Comments of the old file are not kept.
    ///
    /// # Errors
    /// [`RigError`] when this draft would not be accepted by [`Draft::load`], or on an error of the file system.
    pub fn save(&self, path: &Path) -> Result<(), RigError> {
        write::save(self, path, false).map(|_| ())
    }

    /// As [`Draft::save`]; a different rig that was at `path` is kept beside it, as `RIG.toml.bak`, `RIG.toml.bak2`, …:
    /// no backup replaces another. Returns the backup's name, if one was needed.
    ///
    /// # Errors
    /// As [`Draft::save`]. When the disk is full, no file has changed.
    pub fn save_with_backup(&self, path: &Path) -> Result<Option<PathBuf>, RigError> {
        write::save(self, path, true)
    }

    /// The text of `rig.toml`: lengths to 1e-9 mm, directions to 1e-12. Reading this text and writing it again gives
    /// the same text.
    pub fn to_toml_string(&self) -> String {
        write::to_text(self)
    }
}

impl From<Rig> for Draft {
    fn from(rig: Rig) -> Self {
        let Rig { camera, surfaces, views, markers, catheter, base, provenance } = rig;
        Self { camera, surfaces, views, markers, catheter: Some(catheter), base, provenance }
    }
}
