//! The work of a batch: a few threads, each taking one recording after another.
//!
//! A recording that fails or panics does not affect the others. A library that kills the whole process ends all running
//! ones; finished ones remain, and `--resume` continues after them.

use super::super::provenance;
use super::super::results::unique_text;
use super::super::run::finished::{self, FinishedRun};
use super::super::run::folder::Files;
use super::super::run::pool;
use super::super::warned::{Warnings, Work};
use super::one::{self, LoadedRig, Request};
use super::options::Options;
use super::{Exit, Failure};
use crate::archive::{CurrentInputs, Entry, Hashes, RunSummary, Staleness, hash, is_complete, staleness};
use crate::catch_panic::catch_panic;
use parking_lot::Mutex;
use rayon::ThreadPool;
use std::collections::HashMap;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::mpsc::{Sender, channel};
use std::sync::{Arc, OnceLock};
use std::time::Instant;

/// A recording of the batch.
pub(super) struct Job {
    pub(super) entry: Entry,
    pub(super) options: Options,
    /// Where its results go.
    pub(super) folder: PathBuf,
}

/// Outcome of one recording.
pub(super) enum Done {
    /// Would be done, and why; or not.
    Planned {
        run: bool,
        why: String,
    },
    /// Its results are there.
    LeftOut(Box<RunSummary>),
    Tracked {
        frames: u64,
    },
    Failed {
        message: String,
        retryable: bool,
    },
    Interrupted,
}

impl From<&Failure> for Done {
    fn from(failure: &Failure) -> Self {
        match failure.exit() {
            Exit::Interrupted => Self::Interrupted,
            _ => Self::Failed { message: failure.message(), retryable: failure.is_transient() },
        }
    }
}

/// The whole batch.
pub(super) struct Batch<'a> {
    pub(super) jobs: &'a [Job],
    /// Of each recording.
    pub(super) threads: usize,
    pub(super) resume: bool,
    pub(super) dry_run: bool,
    pub(super) interrupt: &'a AtomicBool,
}

/// Data shared by several recordings.
struct Common {
    program: Option<String>,
    libraries: String,
    rigs: Mutex<HashMap<(PathBuf, &'static str), Arc<SharedRig>>>,
}

/// A rig file, read once.
type SharedRig = OnceLock<(Option<String>, Result<LoadedRig, Failure>)>;

impl Batch<'_> {
    /// Does all of it, `at_once` at a time; `done` is told of each, in the thread of the caller.
    ///
    /// # Errors
    /// When the system cannot start a thread; recordings that fail are reported, and are not an error.
    pub(super) fn run(&self, at_once: usize, mut done: impl FnMut(usize, Done)) -> Result<(), Failure> {
        let common =
            Common { program: hash::of_program().ok(), libraries: finished::libraries(), rigs: Mutex::default() };
        let next = AtomicUsize::new(0);
        let pools = (0..at_once.max(1)).map(|_| pool(self.threads)).collect::<Result<Vec<_>, _>>()?;
        std::thread::scope(|scope| {
            let (sender, receiver) = channel();
            for pool in &pools {
                let (sender, next, common) = (sender.clone(), &next, &common);
                std::thread::Builder::new()
                    .name("job".to_owned())
                    .spawn_scoped(scope, move || self.work(pool, next, common, &sender))
                    .map_err(|e| Failure::because(Exit::Failed, format!("cannot start a thread: {e}"), e))?;
            }
            drop(sender);
            receiver.into_iter().for_each(|(at, what)| done(at, what));
            Ok(())
        })
    }

    /// Takes one job after another, until there are none or it is interrupted.
    fn work(&self, pool: &ThreadPool, next: &AtomicUsize, common: &Common, sender: &Sender<(usize, Done)>) {
        loop {
            let at = next.fetch_add(1, Ordering::Relaxed);
            let Some(job) = self.jobs.get(at) else { return };
            let what = if self.interrupt.load(Ordering::Relaxed) {
                Done::Interrupted
            } else {
                catch_panic(|| self.job(job, pool, common)).unwrap_or_else(|| Done::Failed {
                    message: format!(
                        "{}: makes the program panic, which is a fault of the program; please report it",
                        job.entry.recording.display()
                    ),
                    retryable: false,
                })
            };
            if sender.send((at, what)).is_err() {
                return;
            }
        }
    }

    fn job(&self, job: &Job, pool: &ThreadPool, common: &Common) -> Done {
        let began = Instant::now();
        let recording = hash::of_recording(&job.entry.recording);
        let rig = common.rig(job);
        let (rig_hash, loaded) = match rig.get() {
            Some((hash, loaded)) => (hash.clone(), Some(loaded)),
            None => (None, None),
        };
        let hashes = Hashes {
            recording: recording.as_ref().ok().cloned(),
            rig: rig_hash,
            options: finished::hash_of(&job.options.named()),
            program: common.program.clone(),
        };
        if self.resume || self.dry_run {
            let now = CurrentInputs { sha256: hashes.clone(), libraries: common.libraries.clone() };
            let found = staleness(&job.folder, &now);
            if self.dry_run {
                let same = matches!(found, Staleness::Same(_));
                let again = if same && !self.resume { "; without --resume it is done again" } else { "" };
                return Done::Planned { run: !same || !self.resume, why: format!("{found}{again}") };
            }
            if let Ok(summary) = found.same() {
                return with_columns(summary, job);
            }
        }
        // Shown before each of its warnings: several recordings are tracked at once.
        let _of = tracing::warn_span!("recording", "{}", job.entry.recording.display()).entered();
        let work = Work::new();
        let attempt = Attempt { job, pool, threads: self.threads, work: &work, hashes, began };
        match (recording, loaded) {
            (Err(error), _) => attempt.refused(&recording_error(&job.entry.recording, error), &[]),
            (Ok(_), Some(Ok(rig))) => attempt.track(rig, self.interrupt),
            (Ok(_), Some(Err(failure))) => attempt.refused(failure, &[]),
            (Ok(_), None) => attempt.refused(&Failure::new(Exit::Failed, "the rig was not read"), &[]),
        }
    }
}

/// With the same message as the source would give.
fn recording_error(recording: &Path, error: io::Error) -> Failure {
    match error.kind() {
        io::ErrorKind::NotFound => Failure::usage(format!("{}: no such file or folder", recording.display())),
        _ => Failure::because(Exit::Usage, format!("{}: cannot be read: {error}", recording.display()), error),
    }
}

/// Existing results: only the manifest's columns may be new.
fn with_columns(mut summary: RunSummary, job: &Job) -> Done {
    if summary.manifest != job.entry.columns || summary.name != job.entry.name {
        summary.manifest.clone_from(&job.entry.columns);
        summary.name.clone_from(&job.entry.name);
        if let Err(failure) = finished::save(&summary, &job.folder) {
            return Done::from(&failure);
        }
    }
    Done::LeftOut(Box::new(summary))
}

impl Common {
    /// The rig of a job, read once for all jobs with the same.
    fn rig(&self, job: &Job) -> Arc<SharedRig> {
        let file = job.entry.rig.clone();
        let key = (file.clone().unwrap_or_else(|| job.entry.recording.clone()), job.options.frame().word());
        let shared = {
            let mut rigs = self.rigs.lock();
            match file {
                // The rig of a log is not shared.
                None => Arc::default(),
                Some(_) => Arc::clone(rigs.entry(key).or_default()),
            }
        };
        shared.get_or_init(|| {
            let read = LoadedRig::read(file.as_deref(), &job.entry.recording, &job.options);
            let hash = match (&read, &file) {
                (Ok(rig), _) => Some(hash::of_bytes(rig.toml.as_bytes())),
                (Err(_), Some(file)) => hash::of_file(file).ok(),
                (Err(_), None) => None,
            };
            if let Ok(rig) = &read {
                rig.warnings.iter().for_each(|warning| tracing::warn!("{warning}"));
            }
            (hash, read)
        });
        shared
    }
}

/// A recording being tracked.
struct Attempt<'a> {
    job: &'a Job,
    pool: &'a ThreadPool,
    threads: usize,
    work: &'a Work,
    hashes: Hashes,
    began: Instant,
}

impl Attempt<'_> {
    fn files(&self) -> Files {
        let Job { options, folder, .. } = self.job;
        Files::new(folder, None, options.overlay).recording(options.record)
    }

    /// Tracks it.
    fn track(self, rig: &LoadedRig, interrupt: &AtomicBool) -> Done {
        let Job { entry, options, folder } = self.job;
        let (files, source) = (self.files(), entry.recording.as_path());
        let words = ["track".to_owned(), unique_text(source), "--rig".to_owned(), unique_text(&rig.file)];
        let words = words.into_iter().chain(options.words());
        let command = provenance::of_command(words.chain(["-o".to_owned(), unique_text(folder)]));
        let (threads, pool) = (self.threads, self.pool);
        let request = Request { source, rig, options, files: &files, threads, pool, repeatable: true, command };
        let ready = match self.work.within(|| request.open()) {
            Ok(ready) => ready,
            Err(failure) => return self.refused(&failure, &rig.warnings),
        };
        let _held = match request.prepare() {
            Ok(held) => held,
            // The folder belongs to something else: nothing is written there, not even the reason.
            Err(failure) => return Done::from(&failure),
        };
        let alarms = one::alarms(source.display().to_string());
        let (measured, verdict) = match request.track(ready, self.work, interrupt, alarms) {
            Ok(tracked) => {
                let (measured, verdict) = one::judged(&request, tracked, self.work);
                (Some(measured), verdict)
            }
            Err(failure) => (None, Err(failure)),
        };
        let frames = measured.as_ref().map_or(0, |(measured, _)| measured.frames);
        self.over(&files, verdict.as_ref().err(), measured, (&rig.file, rig.warnings.clone()), frames)
    }

    /// Records in its folder why it cannot be tracked. Complete results are left as they are: a recording on a disk
    /// that is not mounted, or a rig that is being written, would take hours of work with them.
    fn refused(self, failure: &Failure, warnings: &[String]) -> Done {
        let Job { entry, options, folder } = self.job;
        let files = self.files();
        let rig = entry.rig.clone().unwrap_or_else(|| entry.recording.clone());
        let run = one::described(&entry.recording, &rig, options);
        if is_complete(folder, &run.recording) {
            let Done::Failed { message, retryable } = Done::from(failure) else { return Done::Interrupted };
            let message = format!("{message}; the results of an earlier run are kept in {}", folder.display());
            return Done::Failed { message, retryable };
        }
        let _held = match files.prepare(&run, &[&entry.recording, &rig]) {
            Ok(held) => held,
            Err(other) => {
                let Done::Failed { message, retryable } = Done::from(failure) else { return Done::from(&other) };
                let message = format!("{message}; {}", other.message());
                return Done::Failed { message, retryable };
            }
        };
        self.over(&files, Some(failure), None, (&rig, warnings.to_vec()), 0)
    }

    /// Writes the summary, last.
    fn over(
        self,
        files: &Files,
        failure: Option<&Failure>,
        measured: Option<(crate::archive::Measured, Option<String>)>,
        (rig, rig_warnings): (&Path, Vec<String>),
        frames: u64,
    ) -> Done {
        let Job { entry, options, folder } = self.job;
        let warned: Warnings = self.work.warned();
        let over = FinishedRun {
            name: entry.name.clone(),
            run: one::described(&entry.recording, rig, options),
            options: options.named(),
            columns: entry.columns.clone(),
            hashes: self.hashes,
            measured,
            warned: (rig_warnings, warned),
            began: self.began,
            repeatable: true,
        };
        let saved = over.summary(files, failure).and_then(|summary| match summary {
            Some(summary) => finished::save(&summary, folder),
            None => Ok(()),
        });
        match (failure, &saved) {
            (Some(failure), _) | (None, Err(failure)) => Done::from(failure),
            (None, Ok(())) => Done::Tracked { frames },
        }
    }
}
