//! `catoptra collect`: the runs of an archive to tables and a page.

use super::output::REPORT;
use super::progress::Progress;
use super::results::Results;
use super::{Exit, Failure, interrupt, output, provenance};
use crate::archive::Outcome;
use crate::archive::study::{Study, StudyError};
use crate::archive::unusual::unusual_runs;
use crate::plural::plural;
use crate::report::study;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;

/// Arguments of `catoptra collect`.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Folders with the results of `track` or `live`: of runs, or of many of them
    #[arg(value_name = "DIR", required = true)]
    folders: Vec<PathBuf>,
    /// Folder for tables and page
    #[arg(short, long, value_name = "STUDY")]
    out: PathBuf,
}

const FRAMES: &str = "frames.parquet";
const RUNS: &str = "runs.parquet";

pub(crate) fn run(args: &Args, quiet: bool) -> Result<(), Failure> {
    let asked = interrupt::watch()?;
    let go_on = || if asked.load(Ordering::Relaxed) { Err(StudyError::Interrupted) } else { Ok(()) };
    // 1. everything is checked before anything is written
    let inputs = args.folders.iter().map(PathBuf::as_path).collect();
    let files = [FRAMES, RUNS, REPORT].map(str::to_owned).to_vec();
    let results = Results { folder: &args.out, command: "collect", recordings: &args.folders, inputs, files };
    results.check()?;
    if let Some(missing) = args.folders.iter().find(|folder| !folder.is_dir()) {
        let what =
            if missing.exists() { "is not a folder: give that of a run, or one above" } else { "no such folder" };
        return Err(Failure::usage(format!("{}: {what}", missing.display())));
    }
    let study = Study::find(&args.folders, go_on).map_err(failure)?;
    let folders = || args.folders.iter().map(|folder| folder.display().to_string()).collect::<Vec<_>>().join(", ");
    if study.runs.is_empty() && study.left_out.is_empty() {
        let text = "no summary.json in it or below: give folders that `catoptra track` or `live` wrote";
        return Err(Failure::usage(format!("{}: {text}", folders())));
    }
    study.unfinished.iter().for_each(|folder| {
        let text = "has no summary.json, which a run writes last: it was not finished, and is left out";
        tracing::warn!("{}: {text}", folder.display());
    });
    study.too_deep.iter().for_each(|folder| {
        tracing::warn!("{}: lies too deep and is not searched: name it, or a folder nearer to it", folder.display());
    });
    study.vetoes.iter().for_each(|said| tracing::warn!("{said}"));
    study.left_out.iter().for_each(|error| tracing::warn!("{error}; it is left out"));
    if study.runs.is_empty() {
        return Err(Failure::usage(format!("{}: no run can be read: nothing is written", folders())));
    }
    study.cautions().iter().for_each(|text| tracing::warn!("{text}"));
    go_on().map_err(failure)?;
    // 2. the files: earlier ones stay until all is known
    let held = results.hold()?;
    let mut progress = Progress::of(Some(study.runs.len() as u64), "runs", quiet);
    let after_run = || {
        progress.one_more();
        go_on()
    };
    let (frames, frames_table) = study.write_frames(&args.out.join(FRAMES), after_run).map_err(failure)?;
    drop(progress);
    let runs_table = study.write_runs(&args.out.join(RUNS)).map_err(failure)?;
    let unusual = unusual_runs(&study);
    let title = args.out.file_name().map_or_else(|| "study".into(), |name| name.to_string_lossy().into_owned());
    let page = study::page(&study, &unusual, &args.out, &title, &provenance::of_this_run());
    go_on().map_err(failure)?;
    results.claim(&held)?;
    for table in [frames_table, runs_table] {
        table.put_in_place().map_err(|e| Failure::new(Exit::Failed, format!("{}: {e}", args.out.display())))?;
    }
    output::save(&args.out.join(REPORT), &page)?;
    // 3. text
    if !quiet {
        output::print(&summary(&study, frames, unusual.len(), &args.out))?;
    }
    match study.left_out.len() {
        0 => Ok(()),
        1 => Err(Failure::new(Exit::Failed, "1 run cannot be read, and is left out")),
        n => Err(Failure::new(Exit::Failed, format!("{n} runs cannot be read, and are left out"))),
    }
}

fn failure(error: StudyError) -> Failure {
    let exit = match error {
        StudyError::Track { .. } => Exit::Usage,
        StudyError::Interrupted => Exit::Interrupted,
        _ => Exit::Failed,
    };
    Failure::new(exit, error)
}

fn summary(study: &Study, frames: u64, unusual: usize, out: &Path) -> String {
    let mut text = format!("{}, {}\n", plural(study.runs.len(), "run"), plural(frames, "frame"));
    let failed: Vec<_> = study.runs.iter().filter(|run| run.summary.outcome != Outcome::Tracked).collect();
    // Writing to memory cannot fail.
    for run in &failed {
        let message = run.summary.failure.as_ref().map_or("", |failure| failure.message.as_str());
        let again = run.summary.failure.as_ref().is_some_and(|failure| failure.retryable);
        let again = if again { "may pass" } else { "will not pass" };
        let _ = writeln!(
            text,
            "  {} {} ({again}): {}",
            run.name,
            run.summary.outcome.word(),
            message.replace('\n', "\n    ")
        );
    }
    let _ = writeln!(text, "{} without results, {unusual} stand out", failed.len());
    let _ = writeln!(text, "results in {}", out.display());
    for (file, what) in [(FRAMES, "one row per frame"), (RUNS, "one row per run"), (REPORT, "to look at, in a browser")]
    {
        let _ = writeln!(text, "  {file:<14}  {what}");
    }
    text
}
