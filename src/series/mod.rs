//! Reads recorded runs back: frames with camera time, θ, positions and directions, and coil currents.
//!
//! In: a log (`.mcap`) or a table (`.csv`) of this program ([`Recording::read`]), columns of any table of numbers
//! ([`columns`]), tables of coil currents ([`CurrentTable::read`]). Out: series in SI units and radians, each frame
//! once and in order, with the reason where something was not measured. Nothing is interpolated or sorted here, and
//! only samples of currents with another number of coils than most are left out; of a frame that a person has vetoed
//! (`vetoes.csv` beside the file) only the time remains, with the reason `vetoed`.
//!
//! Logs that were cut off are read as far as they go, and [`Recording::cut`] says so. A table does not state its clock
//! or, without its `run.toml` beside it, the frame of reference of its positions.

mod clocks;
mod columns;
mod currents;
mod error;
mod laboratory;
mod log;
pub(crate) mod play;
mod sheet;
mod table;
#[cfg(test)]
mod tests;
mod ticks;

pub use crate::vetoes::VetoError;
pub use clocks::ClockMap;
pub use columns::columns;
pub(crate) use columns::{Three, columns_and, unit_s};
pub use currents::{CurrentClock, CurrentRow, CurrentTable};
pub use error::SeriesError;
pub use ticks::Ticks;

use crate::log::is_log;
use crate::plural::are;
use crate::sink::OutputFrame;
use crate::vetoes::{self, VETOED, Vetoes};
use nalgebra::{Point3, Vector3};
use std::path::{Path, PathBuf};

/// The status of what was measured.
const OK: &str = "ok";

/// A tracked run.
#[derive(Debug, Clone, PartialEq)]
pub struct Recording {
    /// The file it was read from.
    pub path: PathBuf,
    /// Name of the camera's clock; `None` when the file does not state it (a table).
    pub clock: Option<String>,
    /// Frame of reference of positions and tangents; `None` when the file does not state it, as a log without any.
    pub reference: Option<OutputFrame>,
    /// Names of the markers, in the order of [`Frame::places`].
    pub markers: Vec<String>,
    /// The frames in order.
    pub frames: Vec<Frame>,
    /// Coil currents in order, all of as many coils; a table has none.
    pub currents: Vec<Current>,
    /// Why part of the file is missing, if it ends early or is damaged; the rest is here.
    pub cut: Option<String>,
    /// Frames that a person has vetoed: their time alone is here.
    pub vetoed: usize,
    /// Samples of currents that a log lacks, by the numbers that their sender gave them.
    pub currents_lost: u64,
}

/// One camera frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Frame {
    /// Its number among those received.
    pub seq: u64,
    /// Camera time, nanoseconds since the clock's zero.
    pub stamp_ns: i64,
    /// Live: the same on the host's clock, nanoseconds since 1970.
    pub host_ns: Option<i64>,
    /// Camera frames lost before this one.
    pub gap: u64,
    /// Deflection θ, radians.
    pub theta_rad: Option<f64>,
    /// Its standard deviation, radians.
    pub theta_sd_rad: Option<f64>,
    /// Why θ is missing, or `ok`; unknown for tables.
    pub theta_status: Option<String>,
    /// One entry per marker.
    pub places: Vec<Place>,
    /// Unit direction of the coil, base to tip.
    pub tangent: Option<Vector3<f64>>,
    /// Its standard deviation, radians.
    pub tangent_sd_rad: Option<f64>,
    /// Command count visible in the frame, modulo some number: see [`Ticks`].
    pub tick: Option<u64>,
}

/// A marker in one frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Place {
    /// Its position, metres.
    pub point: Option<Point3<f64>>,
    /// Standard deviation of one coordinate on average, metres.
    pub sd_m: Option<f64>,
    /// `ok`, or the reason why there is no position.
    pub status: String,
}

/// Currents of the coils at one moment.
#[derive(Debug, Clone, PartialEq)]
pub struct Current {
    /// On the host's clock, nanoseconds since 1970, if recorded on that.
    pub host_ns: Option<i64>,
    /// The same on the camera's clock; `None` when no frame relates the two clocks.
    pub stamp_ns: Option<i64>,
    /// One entry per coil, amperes.
    pub values_a: Vec<f64>,
}

impl CurrentTable {
    /// Reads a table of coil currents, or a `.play` list of the laboratory's amplifier.
    ///
    /// # Errors
    /// When it cannot be read, lacks a column of times or of a coil, a value is missing or not a number, or times do
    /// not increase.
    pub fn read(path: &Path) -> Result<Self, SeriesError> {
        if play::is_play(path) { play::read(path) } else { Self::of_sheet(path) }
    }
}

impl Recording {
    /// Reads a log, a table, or a run of the laboratory's tracker, recognised by its content.
    ///
    /// # Errors
    /// When the file cannot be read or is neither, or the vetoes beside it cannot be read. A file without a frame is
    /// not an error.
    pub fn read(path: &Path) -> Result<Self, SeriesError> {
        if path.is_dir() {
            let problem = "is a folder; give the log or table in it".to_owned();
            return Err(SeriesError::Content { path: path.to_owned(), problem });
        }
        let mut recording = Self::as_measured(path)?;
        let vetoes = Vetoes::beside(path)?;
        recording.leave_out(&vetoes);
        if let Some(said) = vetoes.without_frame(recording.frames.iter().map(|frame| frame.stamp_ns)) {
            tracing::warn!("{}: {said}", path.display());
        }
        if recording.vetoed > 0 {
            let frames = are(recording.vetoed, "frame");
            tracing::warn!("{}: {frames} left out: vetoed in {}", path.display(), vetoes::FILE);
        }
        Ok(recording)
    }

    /// As [`Recording::read`], with what was measured in frames that were vetoed.
    ///
    /// # Errors
    /// As [`Recording::read`].
    pub fn as_measured(path: &Path) -> Result<Self, SeriesError> {
        if is_log(path) {
            log::read(path)
        } else if laboratory::is_laboratory(path) {
            laboratory::read(path)
        } else {
            table::read(path)
        }
    }

    /// Takes out what was measured in frames that are vetoed.
    fn leave_out(&mut self, vetoes: &Vetoes) {
        for frame in &mut self.frames {
            if vetoes.of(frame.stamp_ns).is_none() {
                continue;
            }
            self.vetoed += 1;
            (frame.theta_rad, frame.theta_sd_rad) = (None, None);
            (frame.tangent, frame.tangent_sd_rad, frame.tick) = (None, None, None);
            frame.theta_status = Some(VETOED.to_owned());
            for place in &mut frame.places {
                *place = Place { point: None, sd_m: None, status: VETOED.to_owned() };
            }
        }
    }

    /// Checks that positions and tangents are not known to be in the camera frame.
    ///
    /// # Errors
    /// When they are; the error says how to get others.
    pub fn in_base_frame(&self) -> Result<(), SeriesError> {
        if self.reference != Some(OutputFrame::Camera) {
            return Ok(());
        }
        let problem = "its positions and tangents are in the camera frame, and needed in the base frame: track it \
            again with a rig that has a [base], and without `--frame camera`";
        Err(SeriesError::Content { path: self.path.clone(), problem: problem.to_owned() })
    }

    /// Index of the marker `name` in [`Frame::places`].
    ///
    /// # Errors
    /// When the run has no such marker; the error lists those it has.
    pub fn marker(&self, name: &str) -> Result<usize, SeriesError> {
        self.markers.iter().position(|marker| marker == name).ok_or_else(|| SeriesError::Content {
            path: self.path.clone(),
            problem: match self.markers.as_slice() {
                [] => format!("has no places of markers, and so no `{name}`"),
                there => format!("has no marker `{name}`; it has {}", there.join(", ")),
            },
        })
    }

    /// The relation of the host's clock to the camera's; `None` when no frame has a host's time (a recording, a table).
    pub fn clocks(&self) -> Option<ClockMap> {
        ClockMap::new(self.frames.iter().filter_map(|frame| Some((frame.host_ns?, frame.stamp_ns))).collect())
    }
}
