//! Where estimates go: each sink writes one file and can be closed at any moment.
//!
//! - [`McapSink`]: the log, everything there is, for Foxglove and for programs.
//! - [`CsvSink`]: the table, one row a camera frame, for people and spreadsheets.

mod csv;
#[cfg(test)]
mod fixture;
mod mcap;

pub use self::csv::CsvSink;
pub use self::mcap::McapSink;
pub use self::mcap::messages;

use crate::estimate::Estimate;
use crate::rig::Rig;
use crate::source::Picture;
use nalgebra::Isometry3;
use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};

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

/// The frame of reference that positions and directions are written in.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum OutputFrame {
    /// The rig's base frame S.
    #[default]
    Base,
    /// The camera frame.
    Camera,
}

impl OutputFrame {
    /// The transform of points from the camera frame to this one, metres; `None` when the rig has no base frame.
    pub fn output_from_camera(self, rig: &Rig) -> Option<Isometry3<f64>> {
        match self {
            Self::Base => rig.base.as_ref().map(|base| base.base_from_camera),
            Self::Camera => Some(Isometry3::identity()),
        }
    }
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
        source: io::Error,
    },
    /// Positions in the base frame were asked for, from a rig that has none.
    #[error(
        "cannot write {path} in the base frame: the rig has no [base]; measure it with `catoptra calibrate base`, or \
         write the camera frame (--frame camera)"
    )]
    NoBaseFrame {
        /// Which file.
        path: PathBuf,
    },
}

impl SinkError {
    fn io(path: &Path, source: io::Error) -> Self {
        Self::Io { path: path.to_owned(), source }
    }
}

/// Waits until a finished file is on the disk: some file systems report a lost disk only here. Pipes and devices cannot.
fn settle(file: &File) -> io::Result<()> {
    if file.metadata()?.is_file() { file.sync_all() } else { Ok(()) }
}

/// A copy ([`io::Error`] is not `Clone`).
fn same_error(error: &io::Error) -> io::Error {
    match error.raw_os_error() {
        Some(code) => io::Error::from_raw_os_error(code),
        None => io::Error::new(error.kind(), error.to_string()),
    }
}
