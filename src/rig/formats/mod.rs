//! Cameras as other tools write them: OpenCV, ROS, Kalibr; and a view as DLT coefficients.
//!
//! Text in, text out, no files. The first three hold a camera: picture size, focal lengths, principal point,
//! distortion, but no mirrors or walls: they cannot express a reflected or refracted ray. [`dlt`] holds a view with all
//! its mirrors, but neither walls nor distortion. What a format cannot hold is refused, with the numbers.
//!
//! All of them count pixels from the centre of the top-left one, as a rig does.

pub mod dlt;
mod kalibr;
mod model;
mod opencv;
mod ros;
mod yaml;

use super::{Camera, Draft, RigError};
use crate::optics::{Lens, Surface};
use nalgebra::{Point2, Vector2};
use std::fmt;
use std::path::Path;
use yaml::Node;

/// A format that holds a camera.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Format {
    /// YAML of OpenCV's `FileStorage`, with the names of its calibration samples.
    OpenCv,
    /// ROS's camera_info, as `camera_calibration` saves it or `topic echo` shows it.
    Ros,
    /// Kalibr's camchain, of one camera.
    Kalibr,
}

impl fmt::Display for Format {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::OpenCv => "OpenCV YAML",
            Self::Ros => "ROS camera_info",
            Self::Kalibr => "Kalibr camchain",
        })
    }
}

impl Format {
    /// Which format a text is in; `name` is the file in error messages.
    ///
    /// # Errors
    /// [`RigError::Syntax`] when it is not YAML, or has no key of any of the formats.
    pub fn guess(text: &str, name: &Path) -> Result<Self, RigError> {
        let yaml = yaml::parse(text, name)?;
        let root = Node::root(&yaml, name);
        let has = |names: &[&str]| root.get(names).is_some();
        // Old ROS drivers wrote through OpenCV: keys that only ROS uses are checked before OpenCV's.
        if !kalibr::cameras(&root).is_empty() {
            Ok(Self::Kalibr)
        } else if has(&["distortion_model", "camera_name", "rectification_matrix"]) {
            Ok(Self::Ros)
        } else if has(&["camera_matrix"]) {
            Ok(Self::OpenCv)
        } else {
            Err(RigError::Syntax {
                file: name.to_path_buf(),
                line: 1,
                message: "expected a camera_matrix as OpenCV and ROS write it, or a cam0 as Kalibr does".to_owned(),
            })
        }
    }

    /// The camera in a text of this format; `name` is the file in error messages.
    ///
    /// # Errors
    /// [`RigError`] with key and value: a text not in this format, or a lens that a rig cannot hold.
    pub fn read(self, text: &str, name: &Path) -> Result<Camera, RigError> {
        let yaml = yaml::parse(text, name)?;
        let root = Node::root(&yaml, name);
        match self {
            Self::OpenCv => opencv::read(&root),
            Self::Ros => ros::read(&root),
            Self::Kalibr => kalibr::read(&root),
        }
    }

    /// The camera of a rig as a text in this format, with all digits; `name` is the rig in error messages.
    ///
    /// `view`, if given, must be seen directly and in air: these formats hold only a camera.
    ///
    /// # Errors
    /// [`RigError::Value`] with what the format cannot hold.
    pub fn write(self, rig: &Draft, view: Option<&str>, name: &Path) -> Result<String, RigError> {
        if let Some(view) = view {
            let view = rig.view(view, name)?;
            if !view.path.is_empty() {
                let mirrors = view.optics.surfaces.iter().all(|s| matches!(s, Surface::Mirror(_)));
                let instead = if mirrors { "; DLT coefficients can hold this view" } else { "" };
                return Err(RigError::Value {
                    file: name.to_path_buf(),
                    key: format!("view.{}.path", view.name),
                    value: format!("{:?}", view.path),
                    expected: format!(
                        "no mirror and no wall: {self} holds the camera alone, no reflection, no refraction{instead}"
                    ),
                });
            }
        }
        match self {
            Self::OpenCv => Ok(opencv::write(&rig.camera)),
            Self::Ros => Ok(ros::write(&rig.camera)),
            Self::Kalibr => kalibr::write(&rig.camera, name),
        }
    }
}

/// A camera from the matrices that OpenCV and ROS both write.
fn from_matrices(root: &Node<'_>) -> Result<Camera, RigError> {
    model::of_a_rig(root)?;
    let matrix = root.need(&["camera_matrix", "k"], "the camera's matrix of 3 x 3 numbers")?;
    let &[fx, skew, cx, zero, fy, cy, a, b, one] = matrix.numbers()?.as_slice() else {
        return Err(matrix.wrong("a matrix of 3 x 3 numbers"));
    };
    if [skew, zero, a, b, one] != [0.0, 0.0, 0.0, 0.0, 1.0] {
        return Err(matrix.wrong("the form [fx, 0, cx, 0, fy, cy, 0, 0, 1]"));
    }
    let size = |names: &[&str]| root.need(names, "the size of the pictures in pixels")?.pixels();
    let size_px = [size(&["image_width", "width"])?, size(&["image_height", "height"])?];
    let coefficients = root.need(
        &["distortion_coefficients", "dist_coeffs", "dist_coeff", "d"],
        "the lens's distortion k1, k2, p1, p2, k3",
    )?;
    of_whole_pictures(root, size_px)?;
    camera(&matrix, size_px, [fx, fy, cx, cy], distortion(&coefficients)?)
}

/// The matrix of a ROS message is that of its sensor's whole pictures, which those that are recorded may not be.
fn of_whole_pictures(root: &Node<'_>, size_px: [u32; 2]) -> Result<(), RigError> {
    for name in ["binning_x", "binning_y"] {
        if let Some(binning) = root.get(&[name])
            && binning.number()? > 1.0
        {
            return Err(binning.wrong(
                "0 or 1: the matrix is that of pictures without binning; calibrate with those that you record",
            ));
        }
    }
    let Some(roi) = root.get(&["roi"]) else { return Ok(()) };
    for (name, whole) in [("width", size_px[0]), ("height", size_px[1])] {
        if let Some(side) = roi.get(&[name])
            && ![0.0, f64::from(whole)].contains(&side.number()?)
        {
            return Err(side.wrong(format!(
                "0 or {whole}: the matrix is that of whole pictures; calibrate with those that you record"
            )));
        }
    }
    Ok(())
}

/// OpenCV's names of distortion coefficients, in its order.
const COEFFICIENTS: [&str; 14] =
    ["k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6", "s1", "s2", "s3", "s4", "tau_x", "tau_y"];

/// k1, k2, p1, p2, k3 and k4, k5, k6 from a list that may be shorter, or longer if the rest is zero.
fn distortion(node: &Node<'_>) -> Result<([f64; 5], [f64; 3]), RigError> {
    let values = node.numbers()?;
    if !matches!(values.len(), 4 | 5 | 8 | 12 | 14) {
        return Err(node.wrong(format!("4, 5, 8, 12 or 14 coefficients, there are {}", values.len())));
    }
    let named = COEFFICIENTS.iter().zip(&values).skip(8).filter(|(_, value)| **value != 0.0);
    let beyond: Vec<String> = named.map(|(name, value)| format!("{name} = {value}")).collect();
    if !beyond.is_empty() {
        let expected =
            format!("k1, k2, p1, p2, k3, k4, k5, k6 and nothing but zeros beyond, there is {}", beyond.join(", "));
        return Err(node.wrong(format!("{expected}: calibrate without prism and tilt models")));
    }
    let (mut distortion, mut denominator) = ([0.0; 5], [0.0; 3]);
    for (to, from) in distortion.iter_mut().chain(&mut denominator).zip(values) {
        *to = from;
    }
    Ok((distortion, denominator))
}

/// A camera whose numbers describe a lens; `node` is their place in the file.
fn camera(
    node: &Node<'_>,
    size_px: [u32; 2],
    [fx, fy, cx, cy]: [f64; 4],
    (distortion, denominator): ([f64; 5], [f64; 3]),
) -> Result<Camera, RigError> {
    let lens =
        Lens { focal_px: Vector2::new(fx, fy), principal_point_px: Point2::new(cx, cy), distortion, denominator };
    lens.validate().map_err(|e| node.wrong(format!("a lens: {e}")))?;
    Ok(Camera::new(size_px, lens))
}

/// Numbers with all their digits, `1, 2.5` as `1.0, 2.5`. Never with an exponent: YAML 1.1 readers take 1e-5 for a
/// string.
fn list(values: &[f64]) -> String {
    let shown = values.iter().map(|v| if v.fract() == 0.0 { format!("{v:.1}") } else { v.to_string() });
    shown.collect::<Vec<_>>().join(", ")
}
