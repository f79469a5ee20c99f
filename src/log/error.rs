//! Why a log cannot be read or repaired.

use super::schema::Topic;
use std::io;
use std::path::PathBuf;

/// Why a log cannot be read or repaired.
#[derive(Debug, thiserror::Error)]
pub enum LogError {
    /// The file system reports an error.
    #[error("{}: {source}", path.display())]
    Io {
        /// Which file.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// Another kind of file.
    #[error("{}: is not a log: an MCAP file begins with the bytes 89 4D 43 41 50 30 0D 0A", path.display())]
    NotMcap {
        /// Which file.
        path: PathBuf,
    },
    /// A log of another program.
    #[error("{}: is an MCAP file, but has no topic {}: it is not a log of this \
        program, or what says so is damaged", path.display(), Topic::Estimate.name())]
    NotOurs {
        /// Which file.
        path: PathBuf,
    },
    /// A run is still writing it.
    #[error("{}: is still being written; stop the run first, and if that was killed, repair the log \
        then", path.display())]
    BeingWritten {
        /// Which file.
        path: PathBuf,
    },
    /// What was read cannot be written again.
    #[error("{}: cannot be repaired: {reason}", path.display())]
    Repair {
        /// Which file.
        path: PathBuf,
        /// Why.
        reason: String,
    },
}
