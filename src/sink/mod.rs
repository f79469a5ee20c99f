//! Where estimates go: each sink writes one file and can be closed at any moment.

use crate::estimate::Estimate;
use crate::source::Picture;
use std::path::PathBuf;

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
}
