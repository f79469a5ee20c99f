//! Why mirrors and walls cannot be calibrated.

use super::sufficient::Lacking;
use crate::calibrate::bundle::NoSolution;
use crate::calibrate::bundle::outliers::left_out_lines;
use crate::calibrate::geometry::Geometry;
use crate::optics::PlaneError;

/// Fewest pictures with two images of the board.
pub(super) const FEWEST_PICTURES: usize = 3;

/// Why there is no calibration.
#[derive(Debug, thiserror::Error)]
pub enum RigCalibrationError {
    /// Too few usable pictures.
    #[error("{found} pictures show the board directly and in a mirror, at least {FEWEST_PICTURES} are needed, 10 to 20 are good{}", left_out_lines(.left_out))]
    TooFew {
        /// How many.
        found: usize,
        /// Those that do not, and why.
        left_out: Vec<(String, String)>,
    },
    /// Fewer mirrors than asked for.
    #[error("mirrors that show the board in the pictures: {found}, asked for were {expected} (--mirrors)")]
    Mirrors {
        /// How many.
        found: usize,
        /// How many there should be.
        expected: usize,
    },
    /// Pictures that are not enough.
    #[error(transparent)]
    Lacking(#[from] Lacking),
    /// Boards before the wall behind which they are.
    #[error(
        "by the size of its squares the board ({board}) of {name} is {nearest_mm:.0} mm from the camera, before front_wall at \
         {distance_mm:.0} mm: is one of the two wrong?"
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
    /// A distance, or a board, of a surface that does not exist.
    #[error("there is no surface `{name}`; there are {known}")]
    NoSurface {
        /// As asked for.
        name: String,
        /// Those there are.
        known: String,
    },
    /// A taped board that is not seen as its wall is.
    #[error("{name}: the board on {wall} is {}", if *.mirrored { "seen directly, that wall in the mirror" } else { "seen in a \
        mirror, that wall directly" })]
    Taped {
        /// The picture.
        name: String,
        /// The wall.
        wall: String,
        /// Whether it should be mirrored.
        mirrored: bool,
    },
    /// OpenCV refused.
    #[error("no first guess: {0}")]
    OpenCv(#[from] opencv::Error),
    /// No plane.
    #[error("no first guess: {0}")]
    Plane(#[from] PlaneError),
    /// The covariance of the lens is none.
    #[error("the covariance of the lens is not positive")]
    LensCovariance,
    /// The adjustment failed.
    #[error(
        "the pictures do not determine the rig ({0}): are tank, distances and mirrors as they were given? If so, take more \
         pictures, tilted to all sides, near and far"
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
