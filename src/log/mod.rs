//! What a log is (`schema`), what is in one ([`Info`]), and the repair of one that was cut off ([`repair()`]).
//!
//! Logs are read record by record, whatever their size. Messages are decoded with the schemas stored in the log, fields
//! by name: logs of other versions can be read as far as their names agree.

mod condition;
pub(crate) mod decoder;
mod error;
pub(crate) mod fields;
mod heads;
mod info;
pub(crate) mod records;
mod repair;
pub(crate) mod ros2;
pub(crate) mod schema;
pub(crate) mod sequence;
pub(crate) mod typed;

use mcap::records::Record;
use mcap::{McapError, McapResult};
use std::borrow::Cow;
use std::io::{self, Read as _};
use std::path::Path;
use std::time::Duration;

pub use condition::{Condition, Damage};
pub use error::LogError;
pub use info::{Info, TopicInfo};
pub use repair::{Repaired, repair};

/// Most time between the messages of a chunk: damage costs its chunk.
pub(crate) const CHUNK_SPAN: Duration = Duration::from_millis(500);
/// Most bytes of a chunk. More than [`CHUNK_SPAN`] of 60 Hz tracking.
pub(crate) const CHUNK_BYTES: u64 = 1 << 20;

/// How this program writes logs: with `profile` in their header, chunks compressed by the writing thread.
pub(crate) fn write_options(profile: &str) -> mcap::WriteOptions {
    mcap::WriteOptions::new()
        .profile(profile)
        .library(format!("catoptra/{} {}", env!("CARGO_PKG_VERSION"), mcap::LIBRARY_IDENTIFIER))
        .compression(Some(mcap::Compression::Zstd))
        .compression_threads(0)
}

/// Copies what a log holds besides topics and messages: attachments and metadata.
///
/// # Errors
/// The writer's.
pub(crate) fn copy_besides<W: io::Write + io::Seek>(
    writer: &mut mcap::Writer<W>,
    record: &Record<'_>,
) -> McapResult<()> {
    match record {
        Record::Attachment { header, data, .. } => writer.attach(&mcap::Attachment {
            log_time: header.log_time,
            create_time: header.create_time,
            name: header.name.clone(),
            media_type: header.media_type.clone(),
            data: Cow::Borrowed(data.as_ref()),
        }),
        Record::Metadata(metadata) => writer.write_metadata(metadata),
        _ => Ok(()),
    }
}

/// The system's error, without the wrapper that hides it.
pub(crate) fn system_error(error: McapError) -> io::Error {
    match error {
        McapError::Io(source) => source,
        other => io::Error::other(other),
    }
}

/// Whether the file at `path` begins as logs do, or is named as they are: its first bytes may be damaged. Pipes and
/// devices are not opened: they may wait, and what is read of them is lost.
pub fn is_log(path: &Path) -> bool {
    if !path.is_file() {
        return false;
    }
    if path.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("mcap")) {
        return true;
    }
    let mut begin = [0; mcap::MAGIC.len()];
    std::fs::File::open(path).and_then(|mut file| file.read_exact(&mut begin)).is_ok() && begin == mcap::MAGIC
}

/// Whether another program, a live run for example, is still writing the log at `path`: it holds a lock on it.
pub fn is_being_written(path: &Path) -> bool {
    #[cfg(unix)]
    {
        use rustix::fs::{FlockOperation, flock};
        let Ok(file) = std::fs::File::open(path) else { return false };
        flock(&file, FlockOperation::NonBlockingLockShared) == Err(rustix::io::Errno::WOULDBLOCK)
    }
    #[cfg(not(unix))]
    {
        let _ = path;
        false
    }
}

/// The profile stated in the log at `path`; for this program's logs empty or `ros2`.
///
/// # Errors
/// When the log cannot be read, or is not a log.
pub(crate) fn profile(path: &Path) -> Result<String, LogError> {
    let mut records = records::Records::open(path)?;
    while let Some(record) = records.next()? {
        if let Record::Header(header) = &record {
            return Ok(header.profile.clone());
        }
    }
    Ok(String::new())
}

/// The text file called `name` that is attached to the log at `path`, if there is one.
///
/// # Errors
/// When the log cannot be read, or is not a log.
pub fn attached(path: &Path, name: &str) -> Result<Option<String>, LogError> {
    let mut records = records::Records::open(path)?;
    while let Some(record) = records.next()? {
        if let Record::Attachment { header, data, .. } = &record
            && header.name == name
        {
            return Ok(Some(String::from_utf8_lossy(data).into_owned()));
        }
    }
    Ok(None)
}

/// What to say of a log in which frame `seq` comes after frame `last`.
pub(crate) fn restarted(seq: u64, last: u64) -> String {
    format!(
        "frame {seq} comes after frame {last}: more than one run is in the log (was it merged?), or part of one twice; \
         all is taken as one run, with the rig of the first: use the runs' own logs"
    )
}
