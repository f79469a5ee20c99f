//! A run that is over, and its `summary.json`.

use super::super::warned::Warnings;
use super::super::{Exit, Failure, provenance};
use super::folder::{Files, Run};
use crate::archive::{Failed, Hashes, Measured, Outcome, RunSummary, SCHEMA, hash};
use std::collections::BTreeMap;
use std::path::Path;
use std::time::Instant;

/// A run that is over, for its summary.
pub(in crate::cli) struct FinishedRun {
    pub(in crate::cli) name: String,
    pub(in crate::cli) run: Run,
    /// Names and values of the options that results depend on.
    pub(in crate::cli) options: BTreeMap<String, String>,
    pub(in crate::cli) columns: BTreeMap<String, String>,
    pub(in crate::cli) hashes: Hashes,
    /// What was measured, and why the recording ended early.
    pub(in crate::cli) measured: Option<(Measured, Option<String>)>,
    /// Of the rig, then of the run.
    pub(in crate::cli) warned: (Vec<String>, Warnings),
    pub(in crate::cli) began: Instant,
    /// Whether it can be done again: what was live is over.
    pub(in crate::cli) repeatable: bool,
}

impl FinishedRun {
    /// The summary, to be written last. None of a run that was interrupted: it is not over.
    ///
    /// # Errors
    /// [`Exit::Failed`] when the folder cannot be read.
    pub(in crate::cli) fn summary(
        self,
        files: &Files,
        failure: Option<&Failure>,
    ) -> Result<Option<RunSummary>, Failure> {
        let (outcome, failure) = match failure {
            None => (Outcome::Tracked, None),
            Some(failure) => match failure.exit() {
                Exit::Interrupted => return Ok(None),
                Exit::Unusable => (Outcome::Unusable, Some(Failed { message: failure.message(), retryable: false })),
                Exit::Failed | Exit::Usage => {
                    let retryable = self.repeatable && failure.is_transient();
                    (Outcome::Failed, Some(Failed { message: failure.message(), retryable }))
                }
            },
        };
        let cannot = |e: std::io::Error| {
            Failure::because(Exit::Failed, format!("{}: cannot be read: {e}", files.folder.display()), e)
        };
        let run = self.run;
        let (mut warnings, Warnings { warnings: own, more }) = self.warned;
        warnings.extend(own);
        let (measured, ends_early) = self.measured.map_or((None, None), |(measured, early)| (Some(measured), early));
        Ok(Some(RunSummary {
            schema: SCHEMA,
            name: self.name,
            outcome,
            failure,
            ends_early,
            recording: run.recording,
            rig: run.rig,
            options: self.options,
            manifest: self.columns,
            sha256: self.hashes,
            version: run.version,
            libraries: libraries(),
            measured,
            warnings,
            more_warnings: more,
            files: files.written().map_err(cannot)?,
            finished: provenance::now(),
            elapsed_s: self.began.elapsed().as_secs_f64(),
        }))
    }
}

/// Writes the summary of a run.
///
/// # Errors
/// [`Exit::Failed`].
pub(in crate::cli) fn save(summary: &RunSummary, folder: &Path) -> Result<(), Failure> {
    let cannot = |e: std::io::Error| {
        Failure::because(Exit::Failed, format!("{}: the summary cannot be written: {e}", folder.display()), e)
    };
    summary.write(folder).map_err(cannot)
}

/// SHA-256 of options, by their names.
pub(in crate::cli) fn hash_of(options: &BTreeMap<String, String>) -> Option<String> {
    serde_json::to_vec(options).ok().map(|text| hash::of_bytes(&text))
}

/// Libraries that are exchanged without this program, and that decode and draw.
pub(in crate::cli) fn libraries() -> String {
    let version = ffmpeg_the_third::codec::version();
    let libav = format!("libavcodec {}.{}.{}", version >> 16, version >> 8 & 0xff, version & 0xff);
    let opencv = opencv::core::get_version_string().unwrap_or_else(|_| "unknown".to_owned());
    format!("{libav}, OpenCV {opencv}")
}
