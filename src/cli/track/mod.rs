//! `catoptra track`: a recording, or a folder of pictures, to log, table, report and overlay; or many of them.

mod batch;
mod jobs;
mod one;
mod options;

use super::progress::Progress;
use super::run::finished::{self, FinishedRun};
use super::run::folder::{self, Files};
use super::run::{pool, summary};
use super::warned::Work;
use super::{Exit, Failure, interrupt, output, provenance};
use crate::archive::{Hashes, hash};
use crate::tally::Tally;
use clap::builder::RangedU64ValueParser;
use one::{LoadedRig, Request};
use options::Options;
use std::io::Write as _;
use std::path::PathBuf;
use std::time::Instant;

/// Arguments of `catoptra track`.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Videos, folders of pictures with their times in times.csv, or logs with windows
    #[arg(value_name = "VIDEO|DIR|LOG.mcap", required_unless_present = "manifest", conflicts_with = "manifest")]
    sources: Vec<PathBuf>,
    /// The rig file, with colours and base frame; a log brings its own
    #[arg(long, value_name = "RIG.toml")]
    rig: Option<PathBuf>,
    /// Folder for the results [default: NAME-track, here]; of many, each gets a folder in it
    #[arg(short, long, value_name = "OUT")]
    out: Option<PathBuf>,
    /// Write the table to FILE instead of OUT/track.csv; `-` stands for stdout
    #[arg(long, value_name = "FILE", num_args = 0..=1, require_equals = true)]
    csv: Option<Option<PathBuf>>,
    #[command(flatten)]
    options: Options,
    /// Threads for decoder and tracker; results do not depend on it [default: one per core]
    #[arg(long, value_name = "N", allow_hyphen_values = true, value_parser = RangedU64ValueParser::<usize>::new().range(1..=256))]
    threads: Option<usize>,
    /// Many recordings: a table with columns recording, rig and others (docs/cluster.md)
    #[arg(long, value_name = "RUNS.tsv")]
    manifest: Option<PathBuf>,
    /// Many recordings: how many at a time [default: cores / threads]
    #[arg(long, value_name = "N", value_parser = RangedU64ValueParser::<usize>::new().range(1..=256))]
    jobs: Option<usize>,
    /// Leave out recordings whose results would be the same
    #[arg(long)]
    resume: bool,
    /// Say which recordings would be tracked and why, and do nothing
    #[arg(long)]
    dry_run: bool,
}

pub(crate) fn run(args: &Args, quiet: bool) -> Result<(), Failure> {
    match args.sources.as_slice() {
        [source] if !args.is_batch() => single(args, source, quiet),
        _ => batch::run(args, quiet),
    }
}

impl Args {
    /// Whether results that exist may be left as they are, or there may be many.
    fn is_batch(&self) -> bool {
        self.resume || self.dry_run || self.has_folder_for_each()
    }

    /// Whether results go into a folder for each recording, in OUT; those of a single one go into OUT itself.
    fn has_folder_for_each(&self) -> bool {
        self.manifest.is_some() || self.sources.len() > 1 || self.jobs.is_some()
    }
}

/// Tracks one recording.
fn single(args: &Args, source: &PathBuf, quiet: bool) -> Result<(), Failure> {
    let interrupt = interrupt::watch()?;
    let (began, work) = (Instant::now(), Work::new());
    // 1. everything is checked before anything is written
    let options = args.options.clone().of_recording(source);
    let rig = LoadedRig::read(args.rig.as_deref(), source, &options)?;
    let threads = args.threads.unwrap_or(0);
    let pool = pool(threads)?;
    let folder = args.out.clone().unwrap_or_else(|| folder::default_folder(source));
    let files = Files::new(&folder, args.csv.as_ref().and_then(Option::as_deref), options.overlay);
    let files = files.recording(options.record);
    let command = provenance::of_this_run();
    let request = Request {
        source,
        rig: &rig,
        options: &options,
        files: &files,
        threads,
        pool: &pool,
        repeatable: false,
        command,
    };
    let ready = work.within(|| request.open())?;
    rig.warnings.iter().for_each(|warning| tracing::warn!("{warning}"));
    // 2. the files
    let _held = request.prepare()?;
    // 3. the run; its inputs are hashed meanwhile
    let mut progress = Progress::of_frames(ready.frame_count_hint(), quiet);
    let mut alarms = one::alarms(source.display().to_string());
    let watch = |tally: &Tally| {
        progress.at(tally.frames);
        alarms(tally);
    };
    let (tracked, hashes) = std::thread::scope(|scope| {
        let hashes = scope.spawn(|| Hashes {
            recording: hash::of_recording(source).ok(),
            rig: Some(hash::of_bytes(rig.toml.as_bytes())),
            options: finished::hash_of(&options.named()),
            program: hash::of_program().ok(),
        });
        let tracked = request.track(ready, &work, &interrupt, watch);
        (tracked, hashes.join().unwrap_or_default())
    });
    drop(progress);
    // 4. the result
    let mut text = String::new();
    let recording = source.display().to_string();
    let (measured, verdict) = match tracked {
        Ok(tracked) => {
            summary::summary(&mut text, &recording, &tracked, &files, &rig.rig)
                .map_err(|e| Failure::new(Exit::Failed, format!("cannot describe the run: {e}")))?;
            let (measured, verdict) = one::judged(&request, tracked, &work);
            (Some(measured), verdict)
        }
        Err(failure) => (None, Err(failure)),
    };
    let warned = (rig.warnings.clone(), work.warned());
    let columns = std::collections::BTreeMap::new();
    let (name, run) = (folder::name(&folder), one::described(source, &rig.file, &options));
    let options = options.named();
    let over = FinishedRun { name, run, options, columns, hashes, measured, warned, began, repeatable: true };
    let saved = over.summary(&files, verdict.as_ref().err()).and_then(|summary| match summary {
        Some(summary) => finished::save(&summary, &folder),
        None => Ok(()),
    });
    if !quiet && !text.is_empty() {
        // The table may go to stdout.
        if files.table_on_stdout() {
            let _ = write!(super::progress::stderr(), "{text}");
        } else {
            output::print(&text)?;
        }
    }
    // The reason of the failure comes before the reason why it could not be recorded.
    verdict.and(saved)
}
