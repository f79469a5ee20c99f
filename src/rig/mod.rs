//! [`Rig`]: everything known about camera, mirror, tank, catheter and base frame.
//!
//! Inside: SI units, camera frame. `rig.toml` (read and written by this module, documented in `calibration/README.md`)
//! holds the same in mm and pixels.
//!
//! - [`Rig::load`], [`Rig::save`] and their text forms; [`RigError`] names file, key, value and what would be right.
//! - [`Draft`]: a rig file that may be incomplete. Each calibration reads one and adds its part.
//! - [`check::check`]: what the rig means in words and numbers, and whether its views trace and project consistently.
//! - [`formats`]: cameras read from and written for OpenCV, ROS and Kalibr; views as DLT coefficients.

mod base_doubts;
pub mod check;
mod covariance;
mod draft;
mod error;
mod file;
pub mod formats;
mod numbers;
mod own_lens;
pub(crate) mod polygon;
mod validate;
mod view_check;
mod walk;
mod warnings;
mod write;

pub(crate) use base_doubts::base_doubts;
pub(crate) use covariance::{matrix_note, renew as renew_covariance};
pub use error::RigError;
pub(crate) use error::nearest;
pub(crate) use own_lens::lens_note;
pub(crate) use validate::longest_stiff_m;
pub(crate) use walk::walk;
pub(crate) use warnings::{MIRROR_MOVED, of_camera};

use crate::optics::{Lens, OpticalPath, Surface};
use nalgebra::{Isometry3, Point2, Vector2, Vector3};
use std::collections::BTreeMap;
use std::path::Path;

/// A checked rig.
#[derive(Debug, Clone, PartialEq)]
pub struct Rig {
    /// Picture size and lens.
    pub camera: Camera,
    /// Named surfaces, as the views' paths refer to them.
    pub surfaces: BTreeMap<String, Surface>,
    /// Views, in the file's order.
    pub views: Vec<View>,
    /// Markers, in the file's order (= along the tube from the base).
    pub markers: Vec<Marker>,
    /// The tube.
    pub catheter: Catheter,
    /// The base frame, once known.
    pub base: Option<Base>,
    /// Where the numbers come from: kept as written.
    pub provenance: toml::Table,
}

/// A checked rig file in which parts may be missing: `calibrate camera` begins it, and each later calibration reads it
/// and adds its part. With views, markers and catheter it is a [`Rig`].
#[derive(Debug, Clone, PartialEq)]
pub struct Draft {
    /// Picture size and lens.
    pub camera: Camera,
    /// Named surfaces.
    pub surfaces: BTreeMap<String, Surface>,
    /// Views, in the file's order; none before the mirror is calibrated.
    pub views: Vec<View>,
    /// Markers, in their order along the tube; none before they are picked.
    pub markers: Vec<Marker>,
    /// The tube, known with the markers.
    pub catheter: Option<Catheter>,
    /// The base frame, once known.
    pub base: Option<Base>,
    /// Where the numbers come from: kept as written.
    pub provenance: toml::Table,
}

impl Rig {
    /// Reads and checks a `rig.toml`.
    ///
    /// # Errors
    /// [`RigError`] with the file, the key, its value and what would be right.
    pub fn load(path: &Path) -> Result<Self, RigError> {
        Draft::load(path)?.complete(path)
    }

    /// As [`Rig::load`] from text; `name` is the file in error messages.
    ///
    /// # Errors
    /// [`RigError`], as [`Rig::load`].
    pub fn from_toml_str(text: &str, name: &Path) -> Result<Self, RigError> {
        Draft::from_toml_str(text, name)?.complete(name)
    }

    /// Writes `rig.toml`, see [`Draft::save`].
    ///
    /// # Errors
    /// [`RigError`] when this rig would not be accepted by [`Rig::load`], or on an error of the file system.
    pub fn save(&self, path: &Path) -> Result<(), RigError> {
        Draft::from(self.clone()).save(path)
    }

    /// The text of `rig.toml`, see [`Draft::to_toml_string`].
    pub fn to_toml_string(&self) -> String {
        Draft::from(self.clone()).to_toml_string()
    }

    /// The base frame, if the first band rests at its origin. Where the coil comes first there is no such band.
    pub(crate) fn resting_base(&self) -> Option<&Base> {
        self.base.as_ref().filter(|_| self.catheter.coil != 0)
    }

    /// σ of the base frame's origin along the camera's axes, metres, as `calibrate base` recorded it; `None` when it
    /// did not.
    pub fn origin_sd_m(&self) -> Option<Vector3<f64>> {
        Some(self.sd_of_base("origin_sd_mm")? * 1e-3)
    }

    /// σ of the base frame's axes, turned about each of them, radians; `None` when it was not recorded.
    pub fn axes_sd_rad(&self) -> Option<Vector3<f64>> {
        Some(self.sd_of_base("axes_sd_deg")?.map(f64::to_radians))
    }

    fn sd_of_base(&self, key: &str) -> Option<Vector3<f64>> {
        let recorded = self.provenance.get("base")?.get(key)?.as_array()?;
        let sd: Vec<f64> = recorded.iter().filter_map(covariance::number).collect();
        <[f64; 3]>::try_from(sd).ok().map(Vector3::from)
    }

    /// σ of the distance of a marker from the one before it, metres, as `calibrate markers` recorded it; the largest
    /// one where it did not for all. `None` where all were given.
    pub fn spacing_sd_m(&self, marker: usize) -> Option<f64> {
        let recorded = self.provenance.get("markers")?.get("spacing_sd_mm")?.as_array()?;
        let sd_mm: Vec<f64> = recorded.iter().filter_map(covariance::number).collect();
        let own = sd_mm.get(marker.checked_sub(1)?).filter(|_| sd_mm.len() + 1 == self.markers.len());
        own.copied().or_else(|| sd_mm.into_iter().max_by(f64::total_cmp)).map(|mm| mm * 1e-3)
    }

    /// Index of the marker at the tube's end, or else of the last one.
    pub fn tip(&self) -> usize {
        self.catheter.end.unwrap_or(self.markers.len().saturating_sub(1))
    }

    /// Index of a marker by its name.
    pub fn marker(&self, name: &str) -> Option<usize> {
        self.markers.iter().position(|m| m.name == name)
    }

    /// Index of a view by its name.
    pub fn view(&self, name: &str) -> Option<usize> {
        self.views.iter().position(|v| v.name == name)
    }

    /// Blur of each view along x and y, pixels: its own, or else the camera's; `None` where neither is known.
    pub fn blurs_px(&self) -> impl Iterator<Item = Option<Vector2<f64>>> {
        self.views.iter().map(|view| view.blur_px.or(self.camera.blur_px.map(Vector2::repeat)))
    }
}

impl View {
    /// Whether a pixel belongs to this view: inside its region, or anywhere when it has none.
    pub fn contains(&self, pixel: &Point2<f64>) -> bool {
        self.region_px.is_empty() || polygon::contains(&self.region_px, pixel)
    }
}

/// The camera.
#[derive(Debug, Clone, PartialEq)]
pub struct Camera {
    /// Width and height of its pictures, pixels.
    pub size_px: [u32; 2],
    /// The lens.
    pub lens: Lens,
    /// Blur of lens and sensor: standard deviation of the point spread, pixels, once measured; that of all views that
    /// have none of their own.
    pub blur_px: Option<f64>,
    /// Offset of the chroma samples from where the stream's siting puts them, pixels (right, down): recorders often tag
    /// one siting and sample at another. Zero unless measured.
    pub chroma_offset_px: [f64; 2],
    /// How far subsampled chroma reaches, right and down, in distances between its samples: each is a mean of pixels
    /// up to this far from it, the nearest most. 1 unless measured: weights fall linearly to the next sample. At ½
    /// only the nearest pixels count, as where a camera or a program takes the mean of two, or one of them.
    pub chroma_reach: [f64; 2],
    /// The same in pictures that store colours for each pixel: of chroma from luma, where they were made from others
    /// that had it elsewhere. Zero unless measured.
    pub colour_offset_px: [f64; 2],
    /// Exposure time of a picture, seconds, once known: motion during it blurs the picture.
    pub exposure_s: Option<f64>,
    /// Of a rolling shutter: how much later the row below the last one would be exposed than the first, seconds;
    /// negative if the last row is exposed first. `None`: all rows are exposed at once.
    pub readout_s: Option<f64>,
    /// Stored values are proportional to light raised to this power, once measured; where it is not known, the
    /// recording's own transfer function holds.
    pub gamma: Option<f64>,
}

impl Camera {
    /// One of which no more is known than its lens, for pictures of this size.
    pub fn new(size_px: [u32; 2], lens: Lens) -> Self {
        Self {
            size_px,
            lens,
            blur_px: None,
            chroma_offset_px: [0.0; 2],
            chroma_reach: [1.0; 2],
            colour_offset_px: [0.0; 2],
            exposure_s: None,
            readout_s: None,
            gamma: None,
        }
    }
}

/// One way the camera sees the markers.
#[derive(Debug, Clone, PartialEq)]
pub struct View {
    /// Its name, e.g. `direct`, `mirror`.
    pub name: String,
    /// Names of the surfaces, in the order a camera ray meets them.
    pub path: Vec<String>,
    /// The same path with the surfaces themselves.
    pub optics: OpticalPath,
    /// Where in the picture this view is: polygon, pixels; empty means anywhere.
    pub region_px: Vec<Point2<f64>>,
    /// Its own blur along the picture's x and y, pixels, where it was measured to differ from that of the others (what
    /// is seen in a mirror is farther away, and a mirror may be dirty) or between directions (towards the edge of its
    /// pictures a lens is astigmatic, and scaled pictures are blurred along one side).
    pub blur_px: Option<Vector2<f64>>,
}

/// A blur along x and y for people: one number where both are alike, else `x × y`.
pub(crate) fn blur_in_words(blur_px: &Vector2<f64>) -> String {
    let [x, y] = [blur_px.x, blur_px.y].map(|px| format!("{px:.2}"));
    if x == y { x } else { format!("{x} × {y}") }
}

/// A coloured band.
#[derive(Debug, Clone, PartialEq)]
pub struct Marker {
    /// Its name, e.g. `base`, `coil`, `tip`.
    pub name: String,
    /// Length along the tube, metres.
    pub length_m: f64,
    /// Place of its middle along the tube, metres, once known. Only differences matter: `calibrate markers` counts from
    /// the edge of the first band that is nearer to the clamp.
    pub centre_m: Option<f64>,
    /// Colour models, once learned: one for each view, or one for all; empty before that.
    pub colours: Vec<ColourModel>,
    /// How well the tube's model fits its pictures in each view, once learned: root mean square residual, grey values;
    /// empty before that, and for a band that is not fitted by itself.
    pub usual_residuals: Vec<f64>,
}

impl Marker {
    /// Its colour model in a view.
    pub fn colour(&self, view: usize) -> Option<&ColourModel> {
        self.colours.get(view).or(self.colours.first())
    }
}

/// Distinguishes a band's colour from everything else: the band's colours lie on one side of a few planes in R'G'B'.
#[derive(Debug, Clone, PartialEq)]
pub struct ColourModel {
    /// The planes; at least one.
    pub planes: Vec<ColourPlane>,
    /// Mean colour of the band, R'G'B' 0..255.
    pub rgb: Vector3<f64>,
}

/// A linear discriminant of R'G'B' (0..255, full range): the band against one other colour, or against all others.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ColourPlane {
    /// Weights of R', G', B'.
    pub weights: Vector3<f64>,
    /// score = weights·rgb + bias; on average 1 on the band and 0 on the other colour.
    pub bias: f64,
}

impl ColourPlane {
    /// 1 on the band, 0 on the other colour, on average.
    pub fn score(&self, rgb: &Vector3<f64>) -> f64 {
        self.weights.dot(rgb) + self.bias
    }
}

impl ColourModel {
    /// A model with a single plane.
    pub fn linear(weights: Vector3<f64>, bias: f64, rgb: Vector3<f64>) -> Self {
        Self { planes: vec![ColourPlane { weights, bias }], rgb }
    }

    /// How far another colour scores below one of the band's, by the plane that separates the two best.
    pub fn separation(&self, own: &Vector3<f64>, other: &Vector3<f64>) -> f64 {
        let apart = self.planes.iter().map(|plane| plane.score(own) - plane.score(other));
        apart.fold(f64::NEG_INFINITY, f64::max)
    }

    /// The lowest of the planes' scores: about 1 on the band, below 0.5 elsewhere.
    pub fn score(&self, rgb: &Vector3<f64>) -> f64 {
        self.planes.iter().map(|plane| plane.score(rgb)).fold(f64::INFINITY, f64::min)
    }
}

/// The tube and the roles of its bands.
#[derive(Debug, Clone, PartialEq)]
pub struct Catheter {
    /// Outer diameter, metres.
    pub diameter_m: f64,
    /// Index of the marker whose tangent is wanted (the coil).
    pub coil: usize,
    /// Index of the marker that ends the tube, if one does.
    pub end: Option<usize>,
    /// Length over which its end is rounded, as half an ellipsoid, metres: half the diameter for a half sphere. `None`
    /// for an end that is cut straight.
    pub end_rounding_m: Option<f64>,
    /// Length of the stiff part around the coil's middle, metres, if it is longer than the coil's band.
    pub rigid_m: Option<f64>,
}

/// The base frame S: origin at the base marker at rest, z along the tangent at rest (base to tip), x along B0 made
/// orthogonal to z, y = z × x.
#[derive(Debug, Clone, PartialEq)]
pub struct Base {
    /// Transform of points from the camera frame to the base frame, metres.
    pub base_from_camera: Isometry3<f64>,
    /// Unit direction of the main magnetic field B0, camera frame.
    pub b0: Vector3<f64>,
    /// Unit direction of gravity, camera frame, if known.
    pub gravity: Option<Vector3<f64>>,
}
