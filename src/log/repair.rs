//! A log without its end gets one: all records that are whole, written again with index and summary.

use super::LogError;
use super::records::{self, Extent};
use mcap::records::Record;
use mcap::{Attachment, McapError, WriteOptions, Writer};
use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};

/// What was done.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Repaired {
    /// Nothing: the log is whole.
    WasWhole,
    /// The log has an end again.
    Mended {
        /// Messages that were saved.
        messages: u64,
        /// How it was broken.
        why: String,
        /// The file as it was.
        kept_as: PathBuf,
    },
}

/// Makes the log at `path` whole. The broken one is kept beside it, its name ending in `.bak`; until the new one is
/// complete and on the disk, nothing is changed.
///
/// # Errors
/// When it cannot be read, is no MCAP file, or the disk has no place for a second one.
pub fn repair(path: &Path) -> Result<Repaired, LogError> {
    let beside = |ending: &str| {
        let mut name = path.as_os_str().to_owned();
        name.push(ending);
        PathBuf::from(name)
    };
    // Whether it is whole shows only at its end.
    let Extent::Cut { why } = records::each(path, |_| Ok(()))? else { return Ok(Repaired::WasWhole) };
    let (new, kept_as) = (beside(".repaired"), beside(".bak"));
    let messages = match copy(path, &new) {
        Ok(messages) => messages,
        Err(error) => {
            // What stands there is of no use; that it cannot be removed changes nothing.
            let _ = std::fs::remove_file(&new);
            return Err(error);
        }
    };
    let renamed = std::fs::rename(path, &kept_as).and_then(|()| std::fs::rename(&new, path));
    renamed.map_err(|source| LogError::Io { path: path.to_owned(), source })?;
    Ok(Repaired::Mended { messages, why, kept_as })
}

fn copy(from: &Path, to: &Path) -> Result<u64, LogError> {
    let io = |source| LogError::Io { path: to.to_owned(), source };
    let failed = |error: McapError| match error {
        McapError::Io(source) => LogError::Io { path: to.to_owned(), source },
        other => LogError::Repair { path: from.to_owned(), reason: other.to_string() },
    };
    let file = BufWriter::new(File::create(to).map_err(io)?);
    let library = format!("catoptra/{} {}", env!("CARGO_PKG_VERSION"), mcap::LIBRARY_IDENTIFIER);
    let mut writer: Writer<_> = WriteOptions::new().library(library).compression(None).create(file).map_err(failed)?;
    let mut messages = 0;
    records::each(from, |record| {
        match record {
            Record::Schema { header, data } => {
                writer.add_schema_with_id(header.id, &header.name, &header.encoding, data).map(drop)
            }
            Record::Channel(c) => {
                writer.add_channel_with_id(c.id, c.schema_id, &c.topic, &c.message_encoding, &c.metadata).map(drop)
            }
            Record::Message { header, data } => {
                messages += 1;
                writer.write_to_known_channel(header, data)
            }
            Record::Attachment { header, data, .. } => writer.attach(&Attachment {
                log_time: header.log_time,
                create_time: header.create_time,
                name: header.name.clone(),
                media_type: header.media_type.clone(),
                data: data.clone(),
            }),
            Record::Metadata(metadata) => writer.write_metadata(metadata),
            // Indexes and the summary are made anew.
            _ => Ok(()),
        }
        .map_err(failed)
    })?;
    writer.finish().map_err(failed)?;
    let file = writer.into_inner().into_inner().map_err(|e| io(e.into_error()))?;
    file.sync_all().map_err(io)?;
    Ok(messages)
}
