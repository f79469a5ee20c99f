//! Operations on a rig file that may be incomplete.

use super::{Camera, Draft, Marker, Rig, RigError, View, file, validate, write};
use crate::optics::Lens;
use crate::text_file;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// What is noted of the bands, and of which views their colours are while the file has none.
const MARKERS: &str = "markers";
const COLOUR_VIEWS: &str = "colour_views";

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
    /// new one: they are removed, with their provenance. Bands and tube stay, with what is noted of them. Pictures of
    /// another size are those of another camera: what was measured on the old ones is removed too.
    pub fn with_lens(mut self, size_px: [u32; 2], lens: Lens) -> Self {
        let names = self.colour_views();
        let mut camera = Camera { size_px, lens, ..self.camera.clone() };
        if size_px != self.camera.size_px {
            camera = Camera::new(size_px, lens);
            self.markers.iter_mut().for_each(|marker| marker.usual_residuals.clear());
        }
        let mut provenance = toml::Table::new();
        if let Some(learned) = self.provenance.remove(MARKERS) {
            provenance.insert(MARKERS.to_owned(), learned);
        }
        if let Some(names) = names.filter(|_| self.markers.iter().any(|marker| marker.colours.len() > 1)) {
            provenance.insert(COLOUR_VIEWS.to_owned(), names.into());
        }
        Self { markers: self.markers, catheter: self.catheter, provenance, ..Self::of_camera(camera) }
    }

    /// Whether [`Draft::with_lens`] removes something that was measured on pictures of the old size.
    pub(crate) fn measured_on_pictures(&self) -> bool {
        let of_camera = self.camera != Camera::new(self.camera.size_px, self.camera.lens);
        of_camera || self.markers.iter().any(|marker| !marker.usual_residuals.is_empty())
    }

    /// Names of the views that the bands' colours are for, in their order; `None` where no view is known.
    fn colour_views(&self) -> Option<Vec<String>> {
        if !self.views.is_empty() {
            return Some(self.views.iter().map(|view| view.name.clone()).collect());
        }
        let noted = self.provenance.get(COLOUR_VIEWS)?.as_array()?;
        noted.iter().map(|name| name.as_str().map(str::to_owned)).collect()
    }

    /// Replaces the views. What bands have for each view goes to the view of the same name; bands that lack a colour
    /// for one of the new views lose all of theirs.
    pub(crate) fn set_views(&mut self, views: Vec<View>) {
        let names: Vec<String> = views.iter().map(|view| view.name.clone()).collect();
        // Older files without views do not say whose colours they have: those of `calibrate rig`, in its order.
        let before = self.colour_views().unwrap_or_else(|| names.clone());
        let order: Option<Vec<usize>> =
            names.iter().map(|name| before.iter().position(|known| known == name)).collect();
        for marker in &mut self.markers {
            let Marker { colours, usual_residuals, .. } = marker;
            // A single model is one for all views.
            if colours.len() > 1 {
                *colours = reordered(colours, before.len(), order.as_deref());
            }
            *usual_residuals = reordered(usual_residuals, before.len(), order.as_deref());
        }
        self.provenance.remove(COLOUR_VIEWS);
        self.views = views;
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
        let text = text_file::read(path).map_err(|source| RigError::Read { file: path.to_path_buf(), source })?;
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

/// The values in this order, or none, if there is none or they are not as many as the `count` that it is for.
fn reordered<T: Clone>(values: &[T], count: usize, order: Option<&[usize]>) -> Vec<T> {
    let order = order.filter(|_| values.len() == count).unwrap_or_default();
    order.iter().filter_map(|at| values.get(*at).cloned()).collect()
}

impl From<Rig> for Draft {
    fn from(rig: Rig) -> Self {
        let Rig { camera, surfaces, views, markers, catheter, base, provenance } = rig;
        Self { camera, surfaces, views, markers, catheter: Some(catheter), base, provenance }
    }
}

#[cfg(test)]
mod tests {
    use super::super::ColourModel;
    use super::*;
    use crate::optics::OpticalPath;
    use nalgebra::{Point2, Vector2, Vector3};

    /// The red of a colour that was learned in each view.
    fn reds(draft: &Draft) -> Vec<f64> {
        draft.markers.iter().flat_map(|marker| marker.colours.iter().map(|colour| colour.rgb.x)).collect()
    }

    fn lens() -> Lens {
        Lens {
            focal_px: Vector2::new(1000.0, 1000.0),
            principal_point_px: Point2::new(320.0, 240.0),
            distortion: [0.0; 5],
            denominator: [0.0; 3],
        }
    }

    fn views(names: &[&str]) -> Vec<View> {
        let view = |name: &&str| View {
            name: (*name).to_owned(),
            path: Vec::new(),
            optics: OpticalPath { lens: lens(), surfaces: Vec::new() },
            region_px: Vec::new(),
            blur_px: None,
        };
        names.iter().map(view).collect()
    }

    /// A band whose colours and usual residuals are 0, 1, … in these views.
    fn with_views(names: &[&str]) -> Draft {
        let mut draft = Draft::of_camera(Camera::new([640, 480], lens()));
        draft.views = views(names);
        let red = |view: usize| ColourModel::linear(Vector3::x(), 0.0, Vector3::new(view as f64, 0.0, 0.0));
        draft.markers.push(Marker {
            name: "coil".to_owned(),
            length_m: 0.01,
            centre_m: None,
            colours: (0..names.len()).map(red).collect(),
            usual_residuals: (0..names.len()).map(|view| 1.0 + view as f64).collect(),
        });
        draft
    }

    #[test]
    fn colours_go_to_the_views_of_their_names() {
        let cases: [(&[&str], &[&str], &[f64]); 4] = [
            (&["mirror", "direct"], &["direct", "mirror"], &[1.0, 0.0]),
            (&["direct", "mirror"], &["direct", "mirror"], &[0.0, 1.0]),
            (&["direct", "mirror"], &["direct", "mirror_1", "mirror_2"], &[]),
            (&["direct", "mirror_1", "mirror_2"], &["direct", "mirror_2"], &[0.0, 2.0]),
        ];
        for (before, after, expected) in cases {
            let mut draft = with_views(before);
            draft.set_views(views(after));
            assert_eq!(reds(&draft), expected, "{before:?} {after:?}");
            assert_eq!(draft.markers[0].usual_residuals.len(), expected.len());
            // The same through a file without views, as a new lens leaves it.
            let name = Path::new("rig.toml");
            let mut draft = with_views(before).with_lens([640, 480], lens()).checked(name).unwrap();
            draft.set_views(views(after));
            assert_eq!(reds(&draft), expected, "{before:?} {after:?}, after a new lens");
            assert!(draft.checked(name).is_ok() && draft.provenance.is_empty());
        }
    }
}
