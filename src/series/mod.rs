//! What was recorded, read back: frames with their camera time, θ, places and directions, and coil currents.
//!
//! In: a log (`.mcap`) or a table (`.csv`) of this program ([`Recording::read`]), columns of any table of numbers
//! ([`columns`]), tables of coil currents ([`CurrentTable::read`]). Out: series in SI units and radians, each frame
//! once and in its order, with the reason where something was not measured. Nothing is interpolated, sorted, or left
//! out here.
//!
//! Logs that were cut off are read as far as they go, and [`Recording::cut`] says so. A table does not say its clock,
//! nor, unless its `run.toml` stands beside it, the frame of reference of its places; it looks the same in any frame.

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

pub use clocks::ClockMap;
pub use columns::columns;
pub use currents::{CurrentClock, CurrentRow, CurrentTable};
pub use error::SeriesError;
pub use ticks::Ticks;

use crate::log::is_log;
use crate::sink::OutputFrame;
use nalgebra::{Point3, Vector3};
use std::path::{Path, PathBuf};

/// A tracked run.
#[derive(Debug, Clone, PartialEq)]
pub struct Recording {
    /// The file it was read from.
    pub path: PathBuf,
    /// Name of the camera's clock; `None` when the file does not tell (a table).
    pub clock: Option<String>,
    /// Frame of reference of places and tangents; `None` when the file does not tell.
    pub reference: Option<OutputFrame>,
    /// Names of the markers, in the order of [`Frame::places`].
    pub markers: Vec<String>,
    /// The frames in their order.
    pub frames: Vec<Frame>,
    /// Coil currents in their order; a table has none.
    pub currents: Vec<Current>,
    /// Why not all of the file is here, if it ends early or is damaged; the rest is.
    pub cut: Option<String>,
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
    /// Why θ is missing, or `ok`; tables do not tell.
    pub theta_status: Option<String>,
    /// One entry a marker.
    pub places: Vec<Place>,
    /// Unit direction of the coil, base to tip.
    pub tangent: Option<Vector3<f64>>,
    /// Its standard deviation, radians.
    pub tangent_sd_rad: Option<f64>,
    /// Count of commands that the frame shows, modulo something: see [`Ticks`].
    pub tick: Option<u64>,
}

/// A marker in one frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Place {
    /// Where it is, metres.
    pub point: Option<Point3<f64>>,
    /// Standard deviation of one coordinate on average, metres.
    pub sd_m: Option<f64>,
    /// `ok`, or the word of the reason why there is no place.
    pub status: String,
}

/// Currents of the coils at one moment.
#[derive(Debug, Clone, PartialEq)]
pub struct Current {
    /// On the host's clock, nanoseconds since 1970, where it was recorded on that.
    pub host_ns: Option<i64>,
    /// The same on the camera's clock; `None` when no frame tells how the two clocks stand to each other.
    pub stamp_ns: Option<i64>,
    /// One entry a coil, amperes.
    pub values_a: Vec<f64>,
}

impl CurrentTable {
    /// Reads a table of coil currents, or a `.play` list of the laboratory's amplifier.
    ///
    /// # Errors
    /// When it cannot be read, has no column of times or none of a coil, a value is missing or no number, or times do
    /// not rise.
    pub fn read(path: &Path) -> Result<Self, SeriesError> {
        if play::is_play(path) { play::read(path) } else { Self::of_sheet(path) }
    }
}

impl Recording {
    /// Reads a log, a table, or a run of the laboratory's own tracker; which it is, its content tells.
    ///
    /// # Errors
    /// When the file cannot be read or is neither. A file without a frame is no error.
    pub fn read(path: &Path) -> Result<Self, SeriesError> {
        if is_log(path) {
            log::read(path)
        } else if laboratory::is_laboratory(path) {
            laboratory::read(path)
        } else {
            table::read(path)
        }
    }

    /// Index of the marker `name` in [`Frame::places`].
    ///
    /// # Errors
    /// When the run has no such marker; the error names those it has.
    pub fn marker(&self, name: &str) -> Result<usize, SeriesError> {
        self.markers.iter().position(|marker| marker == name).ok_or_else(|| SeriesError::Content {
            path: self.path.clone(),
            problem: match self.markers.as_slice() {
                [] => format!("has no places of markers, and so no `{name}`"),
                there => format!("has no marker `{name}`; it has {}", there.join(", ")),
            },
        })
    }

    /// How the host's clock and the camera's stand to each other; `None` when no frame has a host's time (a recording,
    /// a table).
    pub fn clocks(&self) -> Option<ClockMap> {
        ClockMap::new(self.frames.iter().filter_map(|frame| Some((frame.host_ns?, frame.stamp_ns))).collect())
    }
}
