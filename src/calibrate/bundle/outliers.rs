//! Residuals of each picture, and which picture is inconsistent with the others.

use crate::median::upper_median;
use nalgebra::{Isometry3, Point2, Vector2};

/// A picture is left out if its RMS residual is this many times that of the median picture and also exceeds this many
/// pixels.
const OUTLIER: (f64, f64) = (4.0, 0.3);

/// A picture's part in the solution.
#[derive(Debug, Clone)]
pub struct UsedPicture {
    /// Its name.
    pub name: String,
    /// camera_from_board, origin at the board's centre, metres.
    pub pose: Isometry3<f64>,
    /// For each corner: where it was found, and found − projected, pixels.
    pub corners: Vec<(Point2<f64>, Vector2<f64>)>,
}

impl UsedPicture {
    /// RMS of one coordinate of the residuals, pixels.
    pub fn rms_px(&self) -> f64 {
        rms(self.corners.iter().map(|(_, residual)| *residual))
    }
}

/// Why a picture was left out.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum LeftOut {
    /// Its corners fit badly.
    #[error(
        "its corners are {rms_px:.2} px off, those of the median picture {median_px:.2} px: moved, blurred or bent?"
    )]
    Off {
        /// RMS of its residuals.
        rms_px: f64,
        /// That of the median picture.
        median_px: f64,
    },
    /// It was taken with another lens.
    #[error(
        "its focal length or principal point differs from that of the others, by chance in less than one of {} sets: \
         is it of another camera, zoom or focus, was it cropped or stabilised, or the board carried before a rolling \
         shutter?",
        10_f64.powf((1.0 / .chance).min(1e6).log10().floor())
    )]
    OtherLens {
        /// In how many sets of one lens a picture seems to differ as much.
        chance: f64,
    },
    /// It is not sharp.
    #[error(
        "it is blurred: edges {edge_px:.0} px wide on squares of {square_px:.0} px; hold the board still, focus, more \
         light"
    )]
    Blurred {
        /// Width of its edges.
        edge_px: f64,
        /// Side of a square.
        square_px: f64,
    },
    /// The board is seen in a mirror.
    #[error("its board is mirrored: pictures must be taken without a mirror, and by a camera that does not flip them")]
    Mirrored,
    /// It was already given.
    #[error("it shows the board where {0} does")]
    Duplicate(String),
}

/// Pictures left out, one line each.
pub(crate) fn left_out_lines<T: std::fmt::Display>(left_out: &[(String, T)]) -> String {
    left_out.iter().map(|(name, why)| format!("\n  {name}: {why}")).collect()
}

/// RMS of one coordinate, pixels.
pub(crate) fn rms(residuals: impl Iterator<Item = Vector2<f64>>) -> f64 {
    let (sum, count) = residuals.fold((0.0, 0_usize), |(sum, count), r| (sum + r.norm_squared(), count + 2));
    (sum / count.max(1) as f64).sqrt()
}

/// The picture that fits much worse than the others.
pub(crate) fn worst_picture(pictures: &[UsedPicture]) -> Option<(usize, LeftOut)> {
    let median_px = upper_median(pictures.iter().map(UsedPicture::rms_px))?;
    let (index, rms_px) = pictures.iter().map(UsedPicture::rms_px).enumerate().max_by(|a, b| a.1.total_cmp(&b.1))?;
    let off = rms_px > OUTLIER.0 * median_px && rms_px > OUTLIER.1;
    off.then_some((index, LeftOut::Off { rms_px, median_px }))
}
