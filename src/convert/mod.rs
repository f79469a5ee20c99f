//! A log as other files: a table (CSV, Parquet), MATLAB's MAT 5, or a log of profile `ros2`.
//!
//! In: a log of this program, of either profile, possibly cut off or damaged. Out: new files, complete or not at all,
//! and what of the log is not in them ([`Converted::left_out`]). Nothing is recomputed: the numbers are those of the
//! log.

mod columns;
mod mat;
mod ros2;
mod table;

use crate::archive::tables::TableError;
use crate::log::LogError;
use crate::log::decoder::MessageDecoder;
use crate::log::records;
use crate::log::schema::Topic;
use crate::plural::plural;
use crate::sink::{OutputFrame, SinkError};
use mcap::records::{MessageHeader, Record};
use prost_reflect::DynamicMessage;
use std::collections::BTreeMap;
use std::io;
use std::path::{Path, PathBuf};

/// Target format.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Target {
    /// The table of the run.
    Csv,
    /// The same in Parquet, not rounded.
    Parquet,
    /// The same in MATLAB's MAT 5, not rounded.
    Mat,
    /// A log that rosbag2 reads.
    Ros2,
}

/// Result of a conversion.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(crate) struct Converted {
    /// Frames in the new file.
    pub frames: u64,
    /// Messages of currents in it, or in the file beside it.
    pub currents: u64,
    /// The files.
    pub files: Vec<PathBuf>,
    /// Parts of the log that are not in them, in words.
    pub left_out: Vec<String>,
    /// Why part of the log could not be read, if so.
    pub cut: Option<String>,
}

/// Why a log cannot be converted.
#[derive(Debug, thiserror::Error)]
pub(crate) enum ConvertError {
    /// The log cannot be read.
    #[error(transparent)]
    Log(#[from] LogError),
    /// The log cannot be converted to this format.
    #[error("{}: {reason}", path.display())]
    Content {
        /// The log.
        path: PathBuf,
        /// Why.
        reason: String,
    },
    /// The file already exists.
    #[error("{}: already exists; choose another name", path.display())]
    Occupied {
        /// Which.
        path: PathBuf,
    },
    /// The file system reports an error.
    #[error("{}: cannot be written: {source}", path.display())]
    Write {
        /// Which file.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// A table cannot be written.
    #[error(transparent)]
    Table(#[from] TableError),
    /// A message cannot be written.
    #[error(transparent)]
    Message(#[from] SinkError),
}

/// Converts the log at `path` to a new file `out`; positions and directions of tables are in `frame`, or in that of the
/// run's own table.
///
/// # Errors
/// [`ConvertError`]; no file is left then.
pub(crate) fn convert(
    path: &Path,
    target: Target,
    frame: Option<OutputFrame>,
    out: &Path,
) -> Result<Converted, ConvertError> {
    free(out)?;
    match target {
        Target::Ros2 => ros2::convert(path, out),
        Target::Csv | Target::Parquet | Target::Mat => table::convert(path, target, frame, out),
    }
}

/// Existing files are not overwritten.
fn free(path: &Path) -> Result<(), ConvertError> {
    // A dangling link also counts as existing.
    if path.symlink_metadata().is_ok() { Err(ConvertError::Occupied { path: path.to_owned() }) } else { Ok(()) }
}

/// A message of a log.
struct Message<'a> {
    header: &'a MessageHeader,
    topic: &'a str,
    /// `None` if it cannot be decoded.
    decoded: Option<DynamicMessage>,
    /// As it is in the file.
    data: &'a [u8],
}

/// Passes every message to `take`, which returns whether it is in the new files; the others are counted by topic. Other
/// records go to `other`.
fn each_message(
    path: &Path,
    mut take: impl FnMut(&Message<'_>) -> Result<bool, ConvertError>,
    mut other: impl FnMut(&Record<'_>) -> Result<(), ConvertError>,
) -> Result<(BTreeMap<String, u64>, Option<String>), ConvertError> {
    let mut decoder = MessageDecoder::default();
    let mut left: BTreeMap<String, u64> = BTreeMap::new();
    let condition = records::each(path, |record| {
        if let Record::Message { header, data } = record {
            let data = data.as_ref();
            let decoded = decoder.decode(header.channel_id, data).ok();
            let topic = decoder.name(header.channel_id).unwrap_or_default().to_owned();
            if !take(&Message { header, topic: &topic, decoded, data })? {
                *left.entry(topic).or_default() += 1;
            }
            return Ok(());
        }
        decoder.learn(record);
        other(record)
    })?;
    if !decoder.channels().any(|(_, topic, _)| topic == Topic::Estimate.name()) {
        return Err(LogError::NotOurs { path: path.to_owned() }.into());
    }
    Ok((left, condition.summary()))
}

/// A line about messages of a topic that are left out.
fn left_out(topic: &str, messages: u64, why: &str) -> String {
    format!("{topic}, {}: {why}", plural(messages, "message"))
}
