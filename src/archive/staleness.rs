//! [`staleness`]: whether the results in a folder are those that a run would give now, and why not.

use super::{FileRecord, Hashes, Outcome, RunSummary, SUMMARY, SummaryError, hash};
use std::fmt;
use std::path::Path;

/// The current inputs of a run.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct CurrentInputs {
    pub(crate) sha256: Hashes,
    pub(crate) libraries: String,
}

/// Whether a run must be done, and why.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Staleness {
    /// The folder is empty.
    New,
    /// A run was started there but not finished.
    Unfinished,
    /// These inputs have changed.
    Changed(Vec<&'static str>),
    /// Nothing is known to have changed, but these inputs could not be read, then or now.
    Unknown(Vec<&'static str>),
    /// A result file is missing or was changed.
    File(String),
    /// The summary cannot be parsed.
    Summary(String),
    /// It failed, but may succeed now.
    Failed(String),
    /// It is up to date.
    Same(Box<RunSummary>),
}

impl Staleness {
    /// The summary, if the run need not be repeated.
    pub(crate) fn same(self) -> Result<RunSummary, Self> {
        match self {
            Self::Same(summary) => Ok(*summary),
            other => Err(other),
        }
    }
}

/// Why the run must be done, or not.
impl fmt::Display for Staleness {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::New => f.write_str("new"),
            Self::Unfinished => f.write_str("begun and not finished"),
            Self::Changed(parts) => write!(f, "{} changed", parts.join(", ")),
            Self::Unknown(parts) => write!(f, "not known whether {} changed", parts.join(", ")),
            Self::File(name) => write!(f, "{name} is gone or changed"),
            Self::Summary(why) => write!(f, "its summary cannot be used: {why}"),
            Self::Failed(why) => write!(f, "failed before, may pass now: {why}"),
            Self::Same(summary) => match (&summary.outcome, &summary.failure) {
                (Outcome::Tracked, _) => f.write_str("done"),
                (_, Some(failure)) => {
                    write!(f, "failed before, nothing has changed: {}", failure.message.lines().next().unwrap_or(""))
                }
                (_, None) => f.write_str("failed before, nothing has changed"),
            },
        }
    }
}

/// Compares the results in `folder` with the current inputs `now`. Names and columns of a manifest do not count:
/// results do not depend on them.
pub(crate) fn staleness(folder: &Path, now: &CurrentInputs) -> Staleness {
    let summary = match RunSummary::read(folder) {
        Ok(Some(summary)) => summary,
        Ok(None) => {
            let empty = std::fs::read_dir(folder).map_or(true, |mut entries| entries.next().is_none());
            return if empty { Staleness::New } else { Staleness::Unfinished };
        }
        Err(error @ SummaryError::Read { .. }) => return Staleness::Summary(error.to_string()),
        Err(SummaryError::Form { reason, .. }) => return Staleness::Summary(reason),
    };
    let (then, now_hashes) = (&summary.sha256, &now.sha256);
    // A run fails in the same way as long as its recording or rig cannot be read.
    let failed = summary.outcome == Outcome::Failed;
    let same = |then: &Option<String>, now: &Option<String>, may_be_missing: bool| match (then, now) {
        (None, None) => may_be_missing.then_some(true),
        (then, now) => Some(then == now),
    };
    let parts = [
        ("recording", same(&then.recording, &now_hashes.recording, failed)),
        ("rig", same(&then.rig, &now_hashes.rig, failed)),
        ("options", same(&then.options, &now_hashes.options, false)),
        ("program", same(&then.program, &now_hashes.program, false)),
        ("libraries", Some(summary.libraries == now.libraries)),
    ];
    let those = |answer: Option<bool>| -> Vec<_> {
        parts.iter().filter(|(_, same)| *same == answer).map(|(name, _)| *name).collect()
    };
    let (changed, unknown) = (those(Some(false)), those(None));
    if !changed.is_empty() {
        return Staleness::Changed(changed);
    }
    if !unknown.is_empty() {
        return Staleness::Unknown(unknown);
    }
    if let Some(failure) = summary.failure.as_ref().filter(|failure| failure.retryable) {
        return Staleness::Failed(failure.message.lines().next().unwrap_or("").to_owned());
    }
    match changed_file(folder, &summary) {
        Some(name) => Staleness::File(name),
        None => Staleness::Same(Box::new(summary)),
    }
}

/// A result file that is missing or was changed, if there is one.
fn changed_file(folder: &Path, summary: &RunSummary) -> Option<String> {
    let whole = |file: &&FileRecord| file.name == SUMMARY || is_as_recorded(folder, file);
    summary.files.iter().find(|file| !whole(file)).map(|file| file.name.clone())
}

/// Whether a file in `folder` has the length, and the hash if there is one, that its run recorded.
pub(crate) fn is_as_recorded(folder: &Path, file: &FileRecord) -> bool {
    let path = folder.join(&file.name);
    let is_same = |then: &String| hash::of_file(&path).is_ok_and(|now| now == *then);
    std::fs::metadata(&path).is_ok_and(|found| found.is_file() && found.len() == file.bytes)
        && file.sha256.as_ref().is_none_or(is_same)
}

/// Whether `folder` has complete results of the recording with this whole path, of whatever rig and options.
pub(crate) fn is_complete(folder: &Path, recording: &str) -> bool {
    let complete = |summary: &RunSummary| {
        summary.outcome != Outcome::Failed && summary.recording == recording && changed_file(folder, summary).is_none()
    };
    RunSummary::read(folder).is_ok_and(|summary| summary.as_ref().is_some_and(complete))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::archive::Failed;

    #[test]
    fn what_was_never_read_is_not_taken_for_unchanged() {
        let folder = tempfile::tempdir().unwrap();
        let known = |text: &str| Some(text.repeat(32));
        let all = Hashes { recording: known("01"), rig: known("02"), options: known("03"), program: known("04") };
        let found = |hashes: &Hashes, outcome: Outcome| {
            let failed = Failed { message: "no such file".into(), retryable: false };
            let failure = (outcome == Outcome::Failed).then_some(failed);
            let summary =
                RunSummary { sha256: hashes.clone(), outcome, failure, files: Vec::new(), ..RunSummary::example() };
            summary.write(folder.path()).unwrap();
            let now = CurrentInputs { sha256: hashes.clone(), libraries: summary.libraries };
            staleness(folder.path(), &now).to_string()
        };
        assert_eq!(found(&all, Outcome::Tracked), "done");
        let without_program = Hashes { program: None, ..all.clone() };
        assert_eq!(found(&without_program, Outcome::Tracked), "not known whether program changed");
        assert_eq!(found(&without_program, Outcome::Failed), "not known whether program changed");
        let without_recording = Hashes { recording: None, options: None, ..all.clone() };
        assert_eq!(found(&without_recording, Outcome::Tracked), "not known whether recording, options changed");
        // A recording that is not there fails as before.
        let absent = Hashes { recording: None, ..all };
        assert_eq!(found(&absent, Outcome::Failed), "failed before, nothing has changed: no such file");
    }
}
