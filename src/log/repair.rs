//! Repairs a damaged or unfinished log: writes all intact records into a new log with an index.
//!
//! Topics of other programs are kept. Damaged parts are left out and listed, also in the new log, which would seem
//! whole otherwise. Chunks are as those of a run.

use super::condition::Condition;
use super::records::{self, LOST, REPAIR};
use super::{CHUNK_BYTES, CHUNK_SPAN, LogError, copy_besides, is_being_written, write_options};
use crate::atomic_file::{NewFile, backup_names};
use mcap::McapError;
use mcap::records::{Channel, Metadata, Record};
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufWriter, ErrorKind};
use std::path::{Path, PathBuf};

/// What was done.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Repaired {
    /// Nothing: the log is whole.
    WasWhole,
    /// The log was repaired.
    Mended {
        /// Messages that were saved.
        messages: u64,
        /// Messages that were left out because their topic is unknown.
        unknown: u64,
        /// What was wrong.
        condition: Condition,
        /// The original file.
        kept_as: PathBuf,
    },
}

/// Repairs the log at `path`. The damaged one is kept beside it with the suffix `.bak` (`.bak2`, … if that exists);
/// nothing is changed until the new one is complete and on the disk.
///
/// # Errors
/// When it cannot be read, is not an MCAP file, is still being written, has no message that can be saved, or the disk
/// has no room for a second file.
pub fn repair(path: &Path) -> Result<Repaired, LogError> {
    if is_being_written(path) {
        return Err(LogError::BeingWritten { path: path.to_owned() });
    }
    // Some damage shows only at the end, and topic names may be only there.
    let mut topics = Topics::default();
    let condition = records::each(path, |record| {
        topics.learn(record);
        Ok(())
    })?;
    if condition.is_whole() {
        return Ok(Repaired::WasWhole);
    }
    if topics.messages == 0 {
        let reason = condition.summary().unwrap_or_default();
        let reason = format!("no message in it can be read ({reason}); it is left as it is");
        return Err(LogError::Repair { path: path.to_owned(), reason });
    }
    let io = |source| LogError::Io { path: path.to_owned(), source };
    let (new, file) = NewFile::begin(path).map_err(io)?;
    let (messages, unknown) = copy(path, file, &topics, condition.lost())?;
    if messages == 0 {
        let reason = format!("the topics of its {unknown} messages are lost; it is left as it is");
        return Err(LogError::Repair { path: path.to_owned(), reason });
    }
    // Of a link, the log that it leads to is kept and replaced.
    let target = std::fs::canonicalize(path).map_err(io)?;
    let path = if path.is_symlink() { &target } else { path };
    let kept_as = backup_names(path).find(|name| !name.exists()).ok_or_else(|| io(ErrorKind::AlreadyExists.into()))?;
    std::fs::rename(path, &kept_as).map_err(io)?;
    if let Err(error) = new.put_in_place() {
        // The log keeps its name.
        std::fs::rename(&kept_as, path).map_err(|source| LogError::Io { path: kept_as, source })?;
        return Err(io(error));
    }
    Ok(Repaired::Mended { messages, unknown, condition, kept_as })
}

/// Schemas and channels of a log.
#[derive(Default)]
struct Topics {
    schemas: BTreeMap<u16, (String, String, Vec<u8>)>,
    channels: BTreeMap<u16, Channel>,
    messages: u64,
    /// The profile stated in the file.
    profile: String,
}

impl Topics {
    fn learn(&mut self, record: &Record<'_>) {
        match record {
            Record::Schema { header, data } => {
                let schema = || (header.name.clone(), header.encoding.clone(), data.to_vec());
                self.schemas.entry(header.id).or_insert_with(schema);
            }
            Record::Channel(channel) => {
                self.channels.entry(channel.id).or_insert_with(|| channel.clone());
            }
            Record::Message { .. } => self.messages += 1,
            Record::Header(header) => self.profile.clone_from(&header.profile),
            _ => {}
        }
    }
}

/// Copies the messages, and notes why some may be `lost`; returns the numbers written and of unknown topics.
fn copy(from: &Path, to: File, topics: &Topics, lost: Option<String>) -> Result<(u64, u64), LogError> {
    let io = |source| LogError::Io { path: from.to_owned(), source };
    let failed = |error: McapError| match error {
        McapError::Io(source) => io(source),
        other => LogError::Repair { path: from.to_owned(), reason: other.to_string() },
    };
    let file = BufWriter::new(to);
    let mut writer = write_options(&topics.profile).chunk_size(Some(CHUNK_BYTES)).create(file).map_err(failed)?;
    for (id, (name, encoding, data)) in topics.schemas.iter().filter(|(id, _)| **id != 0) {
        writer.add_schema_with_id(*id, name, encoding, data).map_err(failed)?;
    }
    for (id, channel) in &topics.channels {
        // A channel whose schema is lost keeps its messages.
        let schema = if topics.schemas.contains_key(&channel.schema_id) { channel.schema_id } else { 0 };
        writer
            .add_channel_with_id(*id, schema, &channel.topic, &channel.message_encoding, &channel.metadata)
            .map_err(failed)?;
    }
    let (mut messages, mut unknown, mut chunk_began_ns) = (0, 0, None);
    records::each(from, |record| {
        match record {
            Record::Message { header, .. } if !topics.channels.contains_key(&header.channel_id) => {
                unknown += 1;
                Ok(())
            }
            Record::Message { header, data } => {
                messages += 1;
                let began_ns = chunk_began_ns.get_or_insert(header.log_time);
                // Another program's topics may each have their own clock.
                if u128::from(header.log_time.saturating_sub(*began_ns)) >= CHUNK_SPAN.as_nanos() {
                    *began_ns = header.log_time;
                    writer.flush().map_err(failed)?;
                }
                writer.write_to_known_channel(header, data)
            }
            // Schemas and channels are already written; indexes and the summary are rebuilt.
            other => copy_besides(&mut writer, other),
        }
        .map_err(failed)
    })?;
    if let Some(lost) = lost {
        let metadata = BTreeMap::from([(LOST.to_owned(), lost)]);
        writer.write_metadata(&Metadata { name: REPAIR.to_owned(), metadata }).map_err(failed)?;
    }
    writer.finish().map_err(failed)?;
    let file = writer.into_inner().into_inner().map_err(|e| io(e.into_error()))?;
    file.sync_all().map_err(io)?;
    Ok((messages, unknown))
}
