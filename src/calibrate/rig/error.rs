//! Why mirrors and walls cannot be calibrated.

use super::sufficient::InsufficientPictures;
use crate::calibrate::bundle::NoSolution;
use crate::calibrate::bundle::outliers::left_out_lines;
use crate::calibrate::geometry::Geometry;
use crate::optics::PlaneError;
use crate::plural::plural;

/// Fewest pictures with two images of the board.
pub(super) const FEWEST_PICTURES: usize = 3;

/// Why there is no calibration.
#[derive(Debug, thiserror::Error)]
pub enum RigCalibrationError {
    /// Too few usable pictures.
    #[error(
        "{} the board directly and in a mirror, at least {FEWEST_PICTURES} are needed, 10 to 20 are good{}",
        if *found == 1 { "1 picture shows".to_owned() } else { format!("{found} pictures show") },
        left_out_lines(.left_out)
    )]
    TooFew {
        /// How many.
        found: usize,
        /// Pictures that were left out, and why.
        left_out: Vec<(String, String)>,
    },
    /// Fewer mirrors than requested.
    #[error("the pictures show the board in {}, expected {expected} (--mirrors)", plural(*found, "mirror"))]
    Mirrors {
        /// How many.
        found: usize,
        /// How many there should be.
        expected: usize,
    },
    /// Insufficient pictures.
    #[error(transparent)]
    InsufficientPictures(#[from] InsufficientPictures),
    /// Boards in front of the wall that they should be behind.
    #[error(
        "by the size of its squares the board ({board}) of {name} is {nearest_mm:.0} mm from the camera, before \
         front_wall at {distance_mm:.0} mm: is one of the two wrong?"
    )]
    BeforeWall {
        /// The picture.
        name: String,
        /// As given.
        board: String,
        /// Distance of the nearest corner.
        nearest_mm: f64,
        /// Distance of the wall, as given.
        distance_mm: f64,
    },
    /// Boards beyond the tank.
    #[error(
        "by their size the boards ({board}) reach {what}, and the tank is {tank_mm:.0} mm {side}: is --tank \
         WIDTHxDEPTHxHEIGHT right, and the size of the squares? Were pictures flipped or turned?"
    )]
    BeyondTank {
        /// As given.
        board: String,
        /// How far they reach, in words.
        what: String,
        /// Size of the tank in that direction, as given.
        tank_mm: f64,
        /// Which size that is.
        side: &'static str,
    },
    /// A measured distance that the pictures contradict, and with which there is no calibration.
    #[error(
        "by the pictures alone {name} is {found_mm:.0} ± {sd_mm:.0} mm from the camera, and it was given as \
         {given_mm:.0} ± {given_sd_mm:.0} mm: is that right? With it, {why}"
    )]
    Distance {
        /// Name of the surface.
        name: String,
        /// As given.
        given_mm: f64,
        /// Its σ.
        given_sd_mm: f64,
        /// Without it.
        found_mm: f64,
        /// Its σ.
        sd_mm: f64,
        /// What fails with it.
        why: Box<Self>,
    },
    /// Coordinates of points in a left-handed frame.
    #[error(
        "the points fit the pictures only when they are mirrored: x_mm, y_mm and z_mm are coordinates in a left-handed \
         frame. Give one of the three the other sign, in all rows"
    )]
    LeftHanded,
    /// A distance or a board for a surface that does not exist.
    #[error("there is no surface `{name}`; there are {known}")]
    NoSurface {
        /// As requested.
        name: String,
        /// Existing surfaces.
        known: String,
    },
    /// A taped board that is not seen the same way as its wall.
    #[error("{name}: the board on {wall} is {}", if *.mirrored { "seen directly, that wall in the \
        mirror" } else { "seen in a \
        mirror, that wall directly" })]
    Taped {
        /// The picture.
        name: String,
        /// The wall.
        wall: String,
        /// Whether it should be mirrored.
        mirrored: bool,
    },
    /// A taped board without a pose.
    #[error("{name}: no position of the board fits its corners; take the picture again, or leave it out")]
    NoTapedPose {
        /// The picture.
        name: String,
    },
    /// OpenCV failed.
    #[error("no first guess: {0}")]
    OpenCv(#[from] opencv::Error),
    /// Not a plane.
    #[error("no first guess: {0}")]
    Plane(#[from] PlaneError),
    /// The covariance of the lens is invalid.
    #[error("the covariance of the lens is not positive")]
    LensCovariance,
    /// The adjustment failed.
    #[error(
        "the pictures do not determine the rig ({0}): are tank, distances and mirrors as they were given? If so, take \
         more pictures, tilted to all sides, near and far"
    )]
    Solve(#[from] NoSolution),
}

/// Index of a surface by its name.
pub(crate) fn surface(geometry: &Geometry, name: &str) -> Result<usize, RigCalibrationError> {
    geometry.surfaces.iter().position(|(own, _)| own == name).ok_or_else(|| {
        let names: Vec<&str> = geometry.surfaces.iter().map(|(name, _)| name.as_str()).collect();
        RigCalibrationError::NoSurface { name: name.to_owned(), known: names.join(", ") }
    })
}
