//! Tracking of many recordings: the list, and the outcomes.

use super::super::output;
use super::super::progress::{Progress, stderr};
use super::super::run::folder;
use super::jobs::{Batch, Done, Job};
use super::options::Options;
use super::{Args, Exit, Failure, interrupt};
use crate::archive::{Entry, Manifest, ManifestError, Outcome, default_name, is_name};
use crate::plural::plural;
use std::collections::{BTreeMap, HashMap};
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

pub(super) fn run(args: &Args, quiet: bool) -> Result<(), Failure> {
    let interrupt = interrupt::watch()?;
    let began = Instant::now();
    let entries = entries(args)?;
    let folder = results_folder(args)?;
    let jobs = entries
        .into_iter()
        .map(|(entry, options)| match args.has_folder_for_each() {
            true => Job { folder: folder.join(&entry.name), entry, options },
            false => Job { folder: folder.clone(), entry: Entry { name: folder::name(&folder), ..entry }, options },
        })
        .collect::<Vec<_>>();
    let jobs_at_once = args.jobs.or((!args.has_folder_for_each()).then_some(1));
    let (at_once, threads) = shares(jobs_at_once, args.threads);
    let batch = Batch { jobs: &jobs, threads, resume: args.resume, dry_run: args.dry_run, interrupt: &interrupt };
    let mut progress = Progress::of(Some(jobs.len() as u64), "recordings", quiet);
    let mut came = Outcomes::default();
    batch.run(at_once.min(jobs.len()), |at, done| {
        progress.one_more();
        if let Some(job) = jobs.get(at) {
            came.add(at, &job.entry.name, &done);
        }
    })?;
    drop(progress);
    if args.dry_run {
        return output::print(&came.plan(&jobs));
    }
    if !quiet {
        let each = if args.has_folder_for_each() { ", a folder for each" } else { "" };
        let place = format!("{}{each}", folder.display());
        output::print(&came.summary(&place, began.elapsed()))?;
    }
    came.verdict(interrupt.load(Ordering::Relaxed), jobs.len())
}

/// The recordings, each with its options.
fn entries(args: &Args) -> Result<Vec<(Entry, Options)>, Failure> {
    if args.csv.is_some() {
        let text = match args.has_folder_for_each() {
            true => {
                "--csv is for one recording: of many, each has its track.csv in its folder (if the second is the name \
                 of the table, write --csv=FILE)"
            }
            false => "--csv does not go with --resume and --dry-run, which look for track.csv in the folder of results",
        };
        return Err(Failure::usage(text));
    }
    let entries = match &args.manifest {
        Some(file) => Manifest::read(file)
            .map_err(|e| {
                let away =
                    matches!(&e, ManifestError::Read { source, .. } if source.kind() != std::io::ErrorKind::NotFound);
                Failure::new(if away { Exit::Failed } else { Exit::Usage }, e)
            })?
            .entries,
        None => named(&args.sources).map_err(Failure::usage)?,
    };
    let options = |entry: Entry| {
        let entry = Entry { rig: entry.rig.or_else(|| args.rig.clone()), ..entry };
        match args.options.with(&entry.options) {
            Ok(options) => {
                let options = options.of_recording(&entry.recording);
                Ok((entry, options))
            }
            // Only a manifest has options per line.
            Err(why) => {
                let manifest = args.manifest.as_deref().unwrap_or(Path::new(""));
                Err(Failure::usage(format!("{}:{}: {why}", manifest.display(), entry.line)))
            }
        }
    };
    entries.into_iter().map(options).collect()
}

/// Recordings of the command line.
fn named(sources: &[PathBuf]) -> Result<Vec<Entry>, String> {
    let mut seen: HashMap<String, &PathBuf> = HashMap::new();
    let entry = |(k, source): (usize, &PathBuf)| (k as u64 + 1, default_name(source));
    let mut entries = Vec::new();
    for (source, (line, name)) in sources.iter().zip(sources.iter().enumerate().map(entry)) {
        is_name(&name).map_err(|why| format!("{}: {why}", source.display()))?;
        if let Some(other) = seen.insert(name.clone(), source) {
            let both = format!("{} and {} have the same name, {name}", other.display(), source.display());
            return Err(format!(
                "{both}, and the folder of results is named after it: use --manifest with a column `name`"
            ));
        }
        let (recording, options, columns) = (source.clone(), String::new(), BTreeMap::new());
        entries.push(Entry { line, name, recording, rig: None, options, columns });
    }
    Ok(entries)
}

/// The parent of all recordings' folders, or the folder of the only one.
fn results_folder(args: &Args) -> Result<PathBuf, Failure> {
    let refused = |text: String| Err(Failure::usage(text));
    match (&args.out, args.sources.as_slice()) {
        (None, [source]) if !args.has_folder_for_each() => Ok(folder::default_folder(source)),
        (None, _) => refused("name the folder for the results of all recordings with -o".to_owned()),
        (Some(folder), _) if folder.exists() && !folder.is_dir() => {
            refused(format!("{}: is a file; choose a folder with -o", folder.display()))
        }
        (Some(folder), _) => Ok(folder.clone()),
    }
}

/// Simultaneous recordings, and threads for each: together one per core, unless both are given.
fn shares(jobs: Option<usize>, threads: Option<usize>) -> (usize, usize) {
    let cores = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
    match (jobs, threads) {
        (Some(jobs), Some(threads)) => (jobs, threads),
        (Some(jobs), None) => (jobs, (cores / jobs).max(1)),
        (None, threads) => ((cores / threads.unwrap_or(1)).max(1), threads.unwrap_or(1)),
    }
}

/// Outcomes of all recordings.
#[derive(Default)]
struct Outcomes {
    tracked: u64,
    /// Left out: their results are there.
    left_out: u64,
    failed: u64,
    retryable: u64,
    interrupted: u64,
    frames: u64,
    /// Of a dry run: number of the job, and what would be done.
    planned: BTreeMap<usize, (bool, String)>,
}

impl Outcomes {
    fn add(&mut self, at: usize, name: &str, done: &Done) {
        match done {
            Done::Planned { run, why } => {
                self.planned.insert(at, (*run, why.clone()));
            }
            Done::LeftOut(summary) if summary.outcome == Outcome::Tracked => self.left_out += 1,
            Done::LeftOut(summary) => {
                let message = summary.failure.as_ref().map_or("", |failure| failure.message.as_str());
                self.fail(name, &format!("as before: {message}"), false);
            }
            Done::Tracked { frames } => {
                self.tracked += 1;
                self.frames += frames;
            }
            Done::Failed { message, retryable } => self.fail(name, message, *retryable),
            Done::Interrupted => self.interrupted += 1,
        }
    }

    fn fail(&mut self, name: &str, message: &str, retryable: bool) {
        self.failed += 1;
        self.retryable += u64::from(retryable);
        // Without stderr, the summary remains.
        let _ = writeln!(stderr(), "error: {name}: {message}");
    }

    /// What would be done, one line each.
    fn plan(&self, jobs: &[Job]) -> String {
        let lines = self.planned.iter().filter_map(|(at, (run, why))| {
            let name = &jobs.get(*at)?.entry.name;
            Some(format!("{}\t{name}\t{why}\n", if *run { "track" } else { "leave" }))
        });
        let text: String = lines.collect();
        let run = self.planned.values().filter(|(run, _)| *run).count();
        format!("{text}{run} of {} would be tracked\n", plural(jobs.len(), "recording"))
    }

    fn summary(&self, place: &str, took: Duration) -> String {
        let Self { tracked, left_out, failed, retryable, frames, .. } = self;
        let took_s = took.as_secs_f64();
        let (recordings, frames) = (plural(*tracked, "recording"), plural(*frames, "frame"));
        let mut text = format!("{recordings} tracked, {frames}, in {took_s:.1} s");
        if *tracked > 0 {
            text += &format!(": {:.2} recordings per second", *tracked as f64 / took_s.max(1e-9));
        }
        text += "\n";
        if *left_out > 0 {
            text += &format!("{left_out} skipped: their results exist\n");
        }
        if *failed > 0 {
            text += &format!("{failed} failed, of which {retryable} may succeed when retried\n");
        }
        text + &format!("results in {place}, with summary.json written last\n")
    }

    fn verdict(&self, interrupted: bool, all: usize) -> Result<(), Failure> {
        if interrupted {
            let done = all as u64 - self.interrupted.min(all as u64);
            let text = format!("{done} of {all} recordings are done; --resume goes on with the others");
            return Err(Failure::new(Exit::Interrupted, text));
        }
        match self.failed {
            0 => Ok(()),
            failed => {
                let text =
                    format!("{failed} of {} failed; the summary.json of each says why", plural(all, "recording"));
                Err(Failure::new(Exit::Failed, text))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn jobs_and_threads_share_the_cores() {
        let cores = std::thread::available_parallelism().unwrap().get();
        assert_eq!(shares(None, None), (cores, 1));
        assert_eq!(shares(Some(1), None), (1, cores));
        assert_eq!(shares(Some(cores * 2), None), (cores * 2, 1));
        assert_eq!(shares(None, Some(cores)), (1, cores));
        assert_eq!(shares(Some(3), Some(5)), (3, 5));
    }

    #[test]
    fn two_recordings_of_one_name_are_refused() {
        let refused = named(&["day1/a.mkv".into(), "day2/a.mp4".into()]).unwrap_err();
        assert!(refused.contains("day1/a.mkv and day2/a.mp4") && refused.contains("--manifest"), "{refused}");
        assert_eq!(named(&["a.mkv".into(), "b.mkv".into()]).unwrap().len(), 2);
    }
}
