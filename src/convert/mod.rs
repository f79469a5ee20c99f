//! A log as other files: a table (CSV, Parquet), MATLAB's MAT 5, or a log of profile `ros2`.
//!
//! In: a log of this program, of either profile, cut off or damaged as it may be. Out: new files, whole or not at all, and
//! what of the log is not in them ([`Converted::left_out`]). Nothing is computed anew: the numbers are those of the log.

mod columns;
mod mat;
mod ros2;
mod table;

use crate::archive::tables::TableError;
use crate::log::LogError;
use crate::log::decoder::MessageDecoder;
use crate::log::records;
use crate::log::schema::Topic;
use crate::sink::{OutputFrame, SinkError};
use mcap::records::{MessageHeader, Record};
use prost_reflect::DynamicMessage;
use std::collections::BTreeMap;
use std::io;
use std::path::{Path, PathBuf};

/// What a log is turned into.
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

/// What came of it.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(crate) struct Converted {
    /// Frames in the new file.
    pub frames: u64,
    /// Messages of currents in it, or in the file beside it.
    pub currents: u64,
    /// The files.
    pub files: Vec<PathBuf>,
    /// What of the log is not in them, in words.
    pub left_out: Vec<String>,
    /// Why not all of the log could be read, if so.
    pub cut: Option<String>,
}

/// Why a log cannot be converted.
#[derive(Debug, thiserror::Error)]
pub(crate) enum ConvertError {
    /// The log cannot be read.
    #[error(transparent)]
    Log(#[from] LogError),
    /// The log cannot be turned into this.
    #[error("{}: {reason}", path.display())]
    Content {
        /// The log.
        path: PathBuf,
        /// Why.
        reason: String,
    },
    /// There is a file already.
    #[error("{}: is there already; give another name", path.display())]
    Occupied {
        /// Which.
        path: PathBuf,
    },
    /// The file system refuses.
    #[error("{}: cannot be written: {source}", path.display())]
    Write {
        /// Which file.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// A table cannot be written.
    #[error("{0}")]
    Table(String),
    /// A message cannot be written.
    #[error(transparent)]
    Message(#[from] SinkError),
}

impl From<TableError> for ConvertError {
    fn from(error: TableError) -> Self {
        Self::Table(error.to_string())
    }
}

/// Turns the log at `path` into a new file `out`; places and directions of tables are in `frame`.
///
/// # Errors
/// [`ConvertError`]; no file is left then.
pub(crate) fn convert(path: &Path, target: Target, frame: OutputFrame, out: &Path) -> Result<Converted, ConvertError> {
    free(out)?;
    match target {
        Target::Ros2 => ros2::convert(path, out),
        Target::Csv | Target::Parquet | Target::Mat => table::convert(path, target, frame, out),
    }
}

/// Nothing is written over.
fn free(path: &Path) -> Result<(), ConvertError> {
    // A link that leads nowhere is there, too.
    if path.symlink_metadata().is_ok() { Err(ConvertError::Occupied { path: path.to_owned() }) } else { Ok(()) }
}

/// A message of a log.
struct Message<'a> {
    header: &'a MessageHeader,
    topic: &'a str,
    /// `None` of those that cannot be decoded.
    decoded: Option<DynamicMessage>,
    /// As it is in the file.
    data: &'a [u8],
}

/// Gives every message to `take`, which says whether it is in the new files; what is not is counted by topic. Other
/// records go to `other`.
fn each_message(
    path: &Path,
    mut take: impl FnMut(&Message<'_>) -> Result<bool, ConvertError>,
    mut other: impl FnMut(&Record<'_>) -> Result<(), ConvertError>,
) -> Result<(BTreeMap<String, u64>, Option<String>), ConvertError> {
    let mut decoder = MessageDecoder::default();
    let mut left: BTreeMap<String, u64> = BTreeMap::new();
    let mut failed = None;
    let condition = records::each(path, |record| {
        if failed.is_some() {
            return Ok(());
        }
        let done = match record {
            Record::Message { header, data } => {
                let data = data.as_ref();
                let decoded = decoder.decode(header.channel_id, data).ok();
                let topic = decoder.name(header.channel_id).unwrap_or_default().to_owned();
                take(&Message { header, topic: &topic, decoded, data }).map(|taken| {
                    if !taken {
                        *left.entry(topic).or_default() += 1;
                    }
                })
            }
            record => {
                decoder.learn(record);
                other(record)
            }
        };
        failed = done.err();
        Ok(())
    })?;
    if let Some(error) = failed {
        return Err(error);
    }
    if !decoder.channels().any(|(_, topic, _)| topic == Topic::Estimate.name()) {
        return Err(LogError::NotOurs { path: path.to_owned() }.into());
    }
    Ok((left, condition.summary()))
}

/// A line for what is left out of a topic.
fn left_out(topic: &str, messages: u64, why: &str) -> String {
    format!("{topic}, {messages} messages: {why}")
}
