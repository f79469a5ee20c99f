//! Where estimates go. A [`Sink`] takes the estimates of a run one by one and writes a file, sends datagrams or serves
//! subscribers. However a run ends, what was written stays readable.
//!
//! - [`McapSink`]: the log with everything, for Foxglove and for programs.
//! - [`PublishSink`]: the topics of the log to live subscribers; [`UdpSink`]: θ to controllers.
//! - [`CsvSink`]: the table, one row per camera frame, for people and spreadsheets.
//! - [`OverlaySink`]: the recording with the results drawn into it; [`PictureVideo`]: the pictures themselves.

mod csv;
mod mcap;

pub use self::csv::CsvSink;
pub(crate) use self::mcap::{FileMessage, FileTopic, RosLog, add_all};
pub use self::mcap::{McapSink, Profile};

mod clock;
mod colour;
#[cfg(feature = "ros2")]
pub(crate) mod dds;
mod encode;
mod encoder;
mod gate;
mod images;
mod jpeg;
mod overlay;
mod palette;
mod pictures;
mod publish;
mod ros2;
mod udp;
mod windows;

pub(crate) use clock::Origin;
pub(crate) use colour::{ConvertError, ToBgr};
#[cfg(feature = "ros2")]
pub use dds::RosSink;
pub(crate) use images::{ImageTaker, LoggedImage};
pub use overlay::OverlaySink;
pub(crate) use overlay::{StillError, Stills};
pub(crate) use palette::{Palette, Rgb};
pub(crate) use pictures::can_hold;
pub use pictures::{PictureCodec, PictureVideo};
pub use publish::PublishSink;
pub use udp::UdpSink;
pub use windows::PictureCount;

pub use crate::source::CurrentSample;
pub(crate) use windows::WindowRecorder;

use crate::estimate::Estimate;
use crate::log::schema::messages::PictureWindows;
use crate::rig::Rig;
use crate::source::Picture;
use crate::tally::{Tally, Totals};
use nalgebra::Isometry3;
use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};

/// Takes the estimates of a run, one camera frame after another.
pub trait Sink {
    /// Writes one frame. Live runs do not keep the picture: a sink that draws into it cannot be used there.
    ///
    /// # Errors
    /// [`SinkError`] when it cannot be written; what was written before stays readable after [`Sink::finish`].
    fn write(&mut self, estimate: &Estimate, picture: Option<&Picture>) -> Result<(), SinkError>;

    /// Writes a coil current; only the log stores them.
    ///
    /// # Errors
    /// As [`Sink::write`].
    fn write_current(&mut self, _: &CurrentSample) -> Result<(), SinkError> {
        Ok(())
    }

    /// Writes the recorded windows of a picture, some frames after its estimate; only the log stores them. Returns
    /// whether this sink did.
    ///
    /// # Errors
    /// As [`Sink::write`].
    fn write_windows(&mut self, _: &PictureWindows) -> Result<bool, SinkError> {
        Ok(false)
    }

    /// Writes the count of the run so far: whenever [`Tally::add`] asks for it, about once a second.
    ///
    /// # Errors
    /// As [`Sink::write`].
    fn write_totals(&mut self, _: &Totals) -> Result<(), SinkError> {
        Ok(())
    }

    /// Whether what it is given is in its file soon; a page is written at its end.
    fn writes_at_once(&self) -> bool {
        true
    }

    /// Completes the file, with the count of the whole run. Called exactly once, also after an interrupt or an error.
    ///
    /// # Errors
    /// [`SinkError`] when the end cannot be written.
    fn finish(&mut self, tally: &Tally) -> Result<(), SinkError>;
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
    /// The file system reported an error.
    #[error("cannot write {path}: {source}")]
    Io {
        /// Which file.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// Positions in the base frame were requested with a rig that has none.
    #[error(
        "cannot write {path} in the base frame: the rig has no [base]; measure it with `catoptra calibrate base`, or \
         write the camera frame (--frame camera)"
    )]
    NoBaseFrame {
        /// Which file.
        path: PathBuf,
    },
    /// The video library reported an error.
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
    #[error("cannot write {path}: picture of {}x{} pixels, the rig's camera has \
        {}x{}", found[0], found[1], expected[0], expected[1])]
    PictureSize {
        /// Which file.
        path: PathBuf,
        /// Width and height of the picture.
        found: [u32; 2],
        /// Width and height in the rig.
        expected: [u32; 2],
    },
    /// The server cannot be opened.
    #[error("cannot publish at {address}: {reason}; choose another address or port with --publish")]
    Publish {
        /// Where.
        address: std::net::SocketAddr,
        /// What the system said.
        reason: String,
    },
    /// A DDS participant cannot be created.
    #[cfg(feature = "ros2")]
    #[error("cannot publish to ROS 2 in domain {domain}: {reason}")]
    Ros {
        /// Which domain.
        domain: u16,
        /// What the library said.
        reason: String,
    },
    /// A message that cannot be encoded.
    #[error("cannot encode a message of {topic}: {reason}")]
    Encode {
        /// Its topic.
        topic: &'static str,
        /// Why.
        reason: String,
    },
    /// A sink that draws into pictures was given none.
    #[error("cannot write {path}: the run does not keep its pictures")]
    NoPicture {
        /// Which file.
        path: PathBuf,
    },
    /// Pictures of another size or format than those before in a video.
    #[error("cannot write {path}: pictures are {after} now, and were {before}: a video has one format")]
    PictureChanged {
        /// Which file.
        path: PathBuf,
        /// Size and format of its pictures.
        before: String,
        /// Of the next one.
        after: String,
    },
    /// A picture whose samples cannot be converted to colours.
    #[error("cannot write {path}: no conversion to RGB from {format}")]
    PixelFormat {
        /// Which file.
        path: PathBuf,
        /// Its storage.
        format: String,
    },
}

impl SinkError {
    fn io(path: &Path, source: io::Error) -> Self {
        Self::Io { path: path.to_owned(), source }
    }
}

/// Waits until a finished file is on the disk: some file systems report a lost disk only here. Does nothing for pipes
/// and devices.
fn settle(file: &File) -> io::Result<()> {
    if file.metadata()?.is_file() { file.sync_all() } else { Ok(()) }
}

/// The same of a file that a library has written.
fn settle_written(path: &Path) -> Result<(), SinkError> {
    // A pipe would wait for a writer.
    let settled = path.metadata().and_then(|there| if there.is_file() { settle(&File::open(path)?) } else { Ok(()) });
    settled.map_err(|error| SinkError::io(path, error))
}

/// A copy ([`io::Error`] is not `Clone`).
fn same_error(error: &io::Error) -> io::Error {
    match error.raw_os_error() {
        Some(code) => io::Error::from_raw_os_error(code),
        None => io::Error::new(error.kind(), error.to_string()),
    }
}
