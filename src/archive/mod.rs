//! Archives: many recordings, with one folder of results each, and tables of all of them.
//!
//! - [`Manifest`]: the list of recordings, with rigs, options, and whatever else the laboratory records about them.
//! - [`RunSummary`]: `summary.json`, written last into the folder of a run. Without it the run is not finished.
//! - [`hash`]: SHA-256 of the inputs of a run. [`staleness`] compares it with the current ones.
//! - [`study`]: all runs of an archive, and tables of them in Parquet ([`tables`]); [`unusual`]: which of them are
//!   unusual.
//!
//! What it cannot detect: a shared library (libav, OpenCV) that was replaced by another build of the same version.

pub(crate) mod hash;
mod manifest;
mod staleness;
pub(crate) mod study;
#[cfg(test)]
mod study_tests;
mod summary;
#[cfg(test)]
mod summary_tests;
pub(crate) mod tables;
pub(crate) mod transient;
pub(crate) mod unusual;

pub(crate) use manifest::{Entry, Manifest, ManifestError, default_name, is_name};
pub(crate) use staleness::{CurrentInputs, Staleness, is_as_recorded, is_complete, staleness};
#[cfg(test)]
pub(crate) use summary::Alarm;
pub(crate) use summary::{
    Failed, FileRecord, Hashes, Measured, Outcome, RunSummary, SCHEMA, SUMMARY, SummaryError, early_end,
};
