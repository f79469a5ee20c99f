//! Archives: many recordings, one folder of results each, and what is known of all of them.
//!
//! - [`Manifest`]: the list of recordings, their rigs, options, and whatever else the laboratory knows of them.
//! - [`RunSummary`]: `summary.json`, written last into the folder of a run. Where there is none, the run is not done.
//! - [`hash`]: SHA-256 of what a run was made from. [`staleness`] compares it with what is there now.
//! - [`study`]: all runs of an archive, and tables of them in Parquet
//!   ([`tables`]); [`outstanding`]: which of them stand out.
//!
//! What it cannot detect: a shared library (libav, OpenCV) that was exchanged for another build of the same version.

pub(crate) mod hash;
mod manifest;
pub(crate) mod outstanding;
pub(crate) mod passing;
mod staleness;
pub(crate) mod study;
mod summary;
#[cfg(test)]
mod summary_tests;
pub(crate) mod tables;

pub(crate) use manifest::{Entry, Manifest, ManifestError, default_name, is_name};
pub(crate) use staleness::{Now, Staleness, staleness};
#[cfg(test)]
pub(crate) use summary::Alarm;
pub(crate) use summary::{
    Failed, FileRecord, Hashes, Measured, Outcome, RunSummary, SCHEMA, SUMMARY, SummaryError, early_end,
};
