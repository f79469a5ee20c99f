//! Why a recording cannot be read back.

use crate::log::LogError;
use crate::vetoes::VetoError;
use std::io;
use std::path::PathBuf;

/// Why a recording or a table cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum SeriesError {
    /// The file system reports an error.
    #[error("{}: {source}", path.display())]
    Io {
        /// Which file.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// A log that cannot be read.
    #[error(transparent)]
    Log(#[from] LogError),
    /// Vetoes that cannot be read.
    #[error(transparent)]
    Vetoes(#[from] VetoError),
    /// Invalid content of a file.
    #[error("{}: {problem}", path.display())]
    Content {
        /// Which file.
        path: PathBuf,
        /// What is wrong with it, and what would be right.
        problem: String,
    },
    /// Invalid content of one line of a table.
    #[error("{}, line {line}: {problem}", path.display())]
    Line {
        /// Which file.
        path: PathBuf,
        /// Which line, from 1.
        line: u64,
        /// What is wrong with it, and what would be right.
        problem: String,
    },
}

impl SeriesError {
    /// Whether the file does not exist: a mistake of the user, not of the system.
    pub fn is_missing(&self) -> bool {
        match self {
            Self::Io { source, .. } | Self::Log(LogError::Io { source, .. }) => {
                source.kind() == io::ErrorKind::NotFound
            }
            _ => false,
        }
    }

    /// Whether the file system failed; otherwise the file itself is invalid.
    pub fn is_io(&self) -> bool {
        matches!(self, Self::Io { .. } | Self::Log(LogError::Io { .. }))
    }
}
