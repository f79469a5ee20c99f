//! Where estimates go: each sink writes one file and can be closed at any moment.

mod clock;
mod colour;
mod encode;
mod overlay;
mod palette;

pub(crate) use clock::Origin;
pub use overlay::OverlaySink;
pub(crate) use palette::{Palette, Rgb};

use crate::estimate::Estimate;
use crate::source::Picture;
use std::path::PathBuf;

/// The word of a miss ([`crate::estimate::Miss::word`]) as people say it.
pub(crate) fn spoken(word: &str) -> String {
    word.replace("not_seen_", "not seen in ").replace('_', " ")
}

/// Takes the estimates of a run, one camera frame after the other.
pub trait Sink {
    /// Writes one frame.
    ///
    /// # Errors
    /// [`SinkError`] when it cannot be written; what was written before stays readable after [`Sink::finish`].
    fn write(&mut self, estimate: &Estimate, picture: &Picture) -> Result<(), SinkError>;

    /// Completes the file. Called exactly once, after an interrupt or an error too.
    ///
    /// # Errors
    /// [`SinkError`] when the end cannot be written.
    fn finish(&mut self) -> Result<(), SinkError>;
}

/// Why a result cannot be written.
#[derive(Debug, thiserror::Error)]
pub enum SinkError {
    /// The file system refused.
    #[error("cannot write {path}: {source}")]
    Io {
        /// Which file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The video library refused.
    #[error("cannot write video {path}: {doing}: {source}")]
    Video {
        /// Which file.
        path: PathBuf,
        /// What was being done.
        doing: &'static str,
        /// What libav said.
        source: ffmpeg_the_third::Error,
    },
    /// None of the encoders tried is built into the video library.
    #[error("cannot write video {path}: libav has none of the encoders {tried}")]
    NoEncoder {
        /// Which file.
        path: PathBuf,
        /// Names of the encoders.
        tried: String,
    },
    /// Drawing into a picture failed.
    #[error("cannot draw the overlay for {path}: {source}")]
    Draw {
        /// Which file.
        path: PathBuf,
        /// What OpenCV said.
        source: opencv::Error,
    },
    /// A picture that does not fit the rig.
    #[error("cannot write {path}: picture of {}x{} pixels, the rig's camera has {}x{}", found[0], found[1], expected[0], expected[1])]
    PictureSize {
        /// Which file.
        path: PathBuf,
        /// Width and height of the picture.
        found: [u32; 2],
        /// Width and height in the rig.
        expected: [u32; 2],
    },
    /// A picture whose samples cannot be turned into colours.
    #[error("cannot write {path}: no conversion to RGB from {format}")]
    PixelFormat {
        /// Which file.
        path: PathBuf,
        /// Its storage.
        format: String,
    },
}
