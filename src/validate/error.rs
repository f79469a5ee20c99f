//! Why a run cannot be compared with its desired path.

use crate::series::SeriesError;
use std::path::PathBuf;

/// Why a run cannot be compared with its desired path.
#[derive(Debug, thiserror::Error)]
pub(crate) enum ValidateError {
    /// A file that cannot be read.
    #[error(transparent)]
    Series(#[from] SeriesError),
    /// The desired path.
    #[error("{}: {problem}", path.display())]
    Path {
        /// Its file.
        path: PathBuf,
        /// What is wrong with it, and what would be right.
        problem: String,
    },
    /// An observed run that does not fit the request.
    #[error("{}: {problem}", path.display())]
    Run {
        /// Its file.
        path: PathBuf,
        /// What is wrong, and what would be right.
        problem: String,
    },
    /// An observed run with too little in it.
    #[error("{}: {problem}", path.display())]
    Unusable {
        /// Its file.
        path: PathBuf,
        /// What is missing.
        problem: String,
    },
}
