//! What a log is (`schema`), what is in one ([`Info`]), and one that was cut off made whole ([`repair()`]).
//!
//! Logs are read record by record, however large they are. Messages are decoded by the schemas that travel with them,
//! field by name: logs of other versions are understood as far as the names are the same.

pub(crate) mod decoder;
mod error;
pub(crate) mod fields;
mod info;
pub(crate) mod records;
mod repair;
pub(crate) mod ros2;
pub(crate) mod schema;
pub(crate) mod typed;

use std::io::Read as _;
use std::path::Path;

pub use error::LogError;
pub use info::{Info, TopicInfo};
pub use records::{Condition, Damage};
pub use repair::{Repaired, repair};

/// Whether the file at `path` begins as logs do.
pub fn is_log(path: &Path) -> bool {
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

/// The profile that the log at `path` says it is of; empty for those of this program but `ros2`.
///
/// # Errors
/// When the log cannot be read, or is none.
pub(crate) fn profile(path: &Path) -> Result<String, LogError> {
    let mut records = records::Records::open(path)?;
    while let Some(record) = records.next()? {
        if let mcap::records::Record::Header(header) = &record {
            return Ok(header.profile.clone());
        }
    }
    Ok(String::new())
}

/// The text file called `name` that is attached to the log at `path`, if there is one.
///
/// # Errors
/// When the log cannot be read, or is none.
pub fn attached(path: &Path, name: &str) -> Result<Option<String>, LogError> {
    let mut records = records::Records::open(path)?;
    while let Some(record) = records.next()? {
        if let mcap::records::Record::Attachment { header, data, .. } = &record
            && header.name == name
        {
            return Ok(Some(String::from_utf8_lossy(data).into_owned()));
        }
    }
    Ok(None)
}
