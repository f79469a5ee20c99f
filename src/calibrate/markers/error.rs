//! [`MarkersError`].

use crate::segment::{LearnError, SegmentError};
use crate::source::SourceError;
use crate::track::TrackError;

/// Why the markers cannot be calibrated.
#[derive(Debug, thiserror::Error)]
pub enum MarkersError {
    /// The recording failed.
    #[error(transparent)]
    Source(#[from] SourceError),
    /// The exposure that was stated is longer than a frame.
    #[error(
        "an exposure of {exposure_ms:.3} ms is longer than the time from frame to frame, {interval_ms:.3} ms: state it \
         with its unit, as --exposure 8.5ms, or correct `exposure_ms` in the rig"
    )]
    Exposure {
        /// As stated.
        exposure_ms: f64,
        /// From a frame to the next, at least.
        interval_ms: f64,
    },
    /// No frame at all.
    #[error("the recording has no frame")]
    NoFrame,
    /// The frame with the clicks would be after the last.
    #[error("there is no frame {at_s} s after the first (--at): the last one is {length_s} s after it")]
    BeyondEnd {
        /// From the first frame to the one asked for, seconds.
        at_s: f64,
        /// From the first frame to the last, seconds.
        length_s: f64,
    },
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
        /// Size of the picture.
        width: u32,
        /// Size of the picture.
        height: u32,
    },
    /// A click outside its view.
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
    /// Nothing like a band near the click.
    #[error(
        "nothing like {band} near {x:.0},{y:.0} in view `{view}`, where `{name}` was picked: click on the band, and \
         see whether its length, the tube's diameter and the frame (--at) are right"
    )]
    NoBand {
        /// Marker.
        name: String,
        /// View.
        view: String,
        /// Pixel.
        x: f64,
        /// Pixel.
        y: f64,
        /// What was searched for.
        band: String,
    },
    /// Two bands clicked at one place.
    #[error("`{}` and `{}` were picked on one band: pick each on its own", names[0], names[1])]
    OneBand {
        /// Markers.
        names: [String; 2],
    },
    /// Bands in another order along the tube.
    #[error(
        "the tube would fold back between the bands in the order {names}: give the picks in their order along the \
         tube, from the clamp to the tip"
    )]
    Order {
        /// Markers, as given.
        names: String,
    },
    /// Places that no tube connects.
    #[error(
        "what was picked is not on one tube: nothing on the lines of sight is as near to each other as its bands are"
    )]
    NoTube,
    /// Views that see nothing in common.
    #[error(
        "no place on the lines of sight of the picks is in the region of another view: are the regions right, and \
         mirror and walls where they were?"
    )]
    NoVolume,
    /// A band that is over- or underexposed.
    #[error("`{name}` is overexposed in view `{view}`: {advice}")]
    Overexposed {
        /// Marker.
        name: String,
        /// View.
        view: String,
        /// What to do.
        advice: String,
    },
    /// Bands whose colours cannot be told apart.
    #[error(
        "colours that cannot be told apart: {0}. Choose bands of purer or other colours, more even light, or take the \
         other thing of that colour out of the picture"
    )]
    Alike(String),
    /// A band that is measured too seldom.
    #[error("`{name}` was measured in only {answered} of {frames} frames{reason}")]
    TooSeldom {
        /// Marker.
        name: String,
        /// Frames in which it was measured.
        answered: usize,
        /// Frames looked at.
        frames: usize,
        /// The first miss, in words.
        reason: String,
    },
    /// The band is not found in another view, or found elsewhere.
    #[error(
        "`{name}` was picked at {x},{y} but cannot be measured in that frame: {reason}; was the band itself clicked, \
         and not the tube beside it?"
    )]
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
    other.map_or(String::new(), |other| format!("; it is in view `{other}`: write --pick NAME@{other}:X,Y"))
}
