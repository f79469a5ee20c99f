//! [`MarkersError`].

use crate::segment::{LearnError, SegmentError};
use crate::source::SourceError;
use crate::track::TrackError;

/// Why the markers cannot be calibrated.
#[derive(Debug, thiserror::Error)]
pub enum MarkersError {
    /// The recording broke.
    #[error(transparent)]
    Source(#[from] SourceError),
    /// No frame at all.
    #[error("the recording has no frame")]
    NoFrame,
    /// A click for a marker that the rig does not have.
    #[error("no pick for marker `{0}` of the rig: every marker needs one")]
    NoPick(String),
    /// A click outside the picture.
    #[error("pick {name}@{x},{y} lies outside the picture of {width}x{height} pixels")]
    Outside {
        /// Marker.
        name: String,
        /// Pixel.
        x: f64,
        /// Pixel.
        y: f64,
        /// Of the picture.
        width: u32,
        /// Of the picture.
        height: u32,
    },
    /// A click beside the view that it should be in.
    #[error("pick {name}@{x},{y} lies outside region_px of view `{view}`{}", also_in(other.as_deref()))]
    OutsideView {
        /// Marker.
        name: String,
        /// Pixel.
        x: f64,
        /// Pixel.
        y: f64,
        /// The view it should be in.
        view: String,
        /// The view it is in.
        other: Option<String>,
    },
    /// The colours cannot be learned.
    #[error("the colours cannot be told apart: {0}")]
    Learn(#[from] LearnError),
    /// No blob under the click.
    #[error("nothing of a colour of its own at {x},{y}, where `{name}` was picked: click on the middle of the band")]
    NoBlob {
        /// Marker.
        name: String,
        /// Pixel.
        x: f64,
        /// Pixel.
        y: f64,
    },
    /// The band is not found in another view, or found elsewhere.
    #[error("`{name}` was picked at {x},{y} but cannot be measured in the first frame: {reason}")]
    NotMeasured {
        /// Marker.
        name: String,
        /// Pixel.
        x: f64,
        /// Pixel.
        y: f64,
        /// Why.
        reason: String,
    },
    /// The picture does not belong to the rig.
    #[error(transparent)]
    Track(#[from] TrackError),
    /// The picture cannot be segmented.
    #[error(transparent)]
    Segment(#[from] SegmentError),
}

fn also_in(other: Option<&str>) -> String {
    other.map_or(String::new(), |other| format!("; it lies in that of `{other}`, say so with --view if all picks do"))
}
