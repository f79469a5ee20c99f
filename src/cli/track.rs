//! `catoptra track`: a recording, or a folder of pictures, to log, table, report and overlay.

use super::progress::Progress;
use super::results::{unlike_others, whole_path};
use super::run::folder::{self, Files, Run};
use super::run::{Record, Reference, load_rig, open_sinks, pool, print_warnings, rig_of_log, summary, verdict};
use super::{Exit, Failure, fitting, interrupt, output, provenance};
use crate::log::is_log;
use crate::pipeline;
use crate::report::RunInfo;
use crate::source::times::{parse_seconds_ns, seconds};
use crate::source::{FrameRate, FrameSource as _, SourceOptions, Span};
use crate::tally::Tally;
use crate::track::{TrackOptions, Tracker};
use clap::builder::RangedU64ValueParser;
use std::io::Write as _;
use std::path::{Path, PathBuf};

/// Arguments of `catoptra track`.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// A video, a folder of pictures with their times in times.csv, or a log with windows
    #[arg(value_name = "VIDEO|DIR|LOG.mcap")]
    source: PathBuf,
    /// The rig file, with colours and base frame; a log brings its own
    #[arg(long, value_name = "RIG.toml")]
    rig: Option<PathBuf>,
    /// Folder for the results [default: NAME-track, here]
    #[arg(short, long, value_name = "OUT")]
    out: Option<PathBuf>,
    /// Write the table to FILE instead of OUT/track.csv; `-` stands for stdout
    #[arg(long, value_name = "FILE", num_args = 0..=1, require_equals = true)]
    csv: Option<Option<PathBuf>>,
    /// Also write a video with the results drawn into it
    #[arg(long)]
    overlay: bool,
    /// Also record the pictures: windows (the parts the tracker looked at, in the log), or whole ones
    #[arg(long, value_enum, value_name = "HOW")]
    record: Option<Record>,
    /// Frame of reference of table and report
    #[arg(long, value_enum, default_value_t = Reference::Base)]
    frame: Reference,
    /// Start at time T, in seconds of the recording's clock
    #[arg(long, value_name = "T", value_parser = seconds_ns, allow_hyphen_values = true)]
    from: Option<i64>,
    /// Stop at time T
    #[arg(long, value_name = "T", value_parser = seconds_ns, allow_hyphen_values = true)]
    to: Option<i64>,
    /// Frames per second of a folder of pictures without times.csv, or of a raw stream (.h264)
    #[arg(long, value_name = "F", allow_hyphen_values = true)]
    fps: Option<FrameRate>,
    /// Threads for decoder and tracker; results do not depend on it [default: one per core]
    #[arg(long, value_name = "N", allow_hyphen_values = true, value_parser = RangedU64ValueParser::<usize>::new().range(1..=256))]
    threads: Option<usize>,
    /// Search the whole of every picture: slower, same results
    #[arg(long)]
    full_frame: bool,
}

fn seconds_ns(text: &str) -> Result<i64, String> {
    parse_seconds_ns(text).ok_or_else(|| "expected seconds, such as 12 or 3.25".to_owned())
}

pub(crate) fn run(args: &Args, quiet: bool) -> Result<(), Failure> {
    let interrupt = interrupt::watch()?;
    // 1. everything is judged before anything is written
    let rig_file = args.rig_file()?;
    let (rig, rig_toml) = match &args.rig {
        Some(file) => load_rig(file, args.frame)?,
        None => rig_of_log(&args.source, args.frame)?,
    };
    if args.full_frame && is_log(&args.source) {
        let text = "holds parts of its pictures: they cannot be searched whole, leave out --full-frame";
        return Err(Failure::new(Exit::Usage, format!("{}: {text}", args.source.display())));
    }
    let mut tracker = Tracker::new(&rig, TrackOptions { full_frame: args.full_frame })
        .map_err(|e| Failure::new(Exit::Usage, format!("{}: {e}", rig_file.display())))?;
    let span = Span { from_ns: args.from, to_ns: args.to };
    let options =
        SourceOptions { span, stated_rate: args.fps, decoder_threads: args.threads(), ..SourceOptions::default() };
    let source = fitting::open_to_track((&args.source, options), (rig_file, &rig))?;
    print_warnings(rig_file, &rig)?;
    let pool = pool(args.threads())?;
    tracing::info!(
        "{}: {}, {} threads; -vv describes every frame",
        args.source.display(),
        source.described(),
        pool.current_num_threads()
    );
    // 2. the files
    let run = args.described();
    let run_toml = run.to_toml()?;
    let folder = args.out.clone().unwrap_or_else(|| folder::default_folder(&args.source));
    let files = Files::new(&folder, args.csv.as_ref().and_then(Option::as_deref), args.overlay);
    let files = files.recording(args.record);
    files.prepare(&run, &[&args.source, rig_file])?;
    let recorded = (args.record, true);
    let opened = open_sinks(&files, &rig, [&rig_toml, &run_toml], args.frame, args.info(), recorded)?;
    let sinks = opened.sinks.into_iter().chain(opened.video).collect();
    // 3. the run
    let mut progress = Progress::of_frames(source.frame_count_hint(), quiet);
    let recording = args.source.display().to_string();
    let mut alarms = 0;
    let watch = |tally: &Tally| {
        progress.at(tally.frames);
        // At once: a run may be long, and be live.
        alarms = summary::new_alarms(tally, &recording, alarms);
    };
    let run_summary = pool
        .install(|| pipeline::run(Box::new(source), &mut tracker, sinks, &interrupt, watch))
        .map_err(|e| Failure::new(Exit::Failed, format!("cannot start a thread: {e}")))?;
    drop(progress);
    // 4. what came of it
    if let Some(sources) = run_summary.tally.budget() {
        files.add_budget(&run, &sources)?;
    }
    if !quiet {
        let mut text = String::new();
        summary::summary(&mut text, &recording, &run_summary, &files, &rig)
            .map_err(|e| Failure::new(Exit::Failed, format!("cannot describe the run: {e}")))?;
        // The table may be on stdout.
        if files.table_on_stdout() {
            let _ = write!(super::progress::stderr(), "{text}");
        } else {
            output::print(&text)?;
        }
    }
    verdict(&recording, &rig, run_summary)
}

impl Args {
    /// 0: one a core.
    fn threads(&self) -> usize {
        self.threads.unwrap_or(0)
    }

    /// Where the rig comes from: its own file, or a log that is tracked again.
    fn rig_file(&self) -> Result<&Path, Failure> {
        match &self.rig {
            Some(file) => Ok(file),
            None if is_log(&self.source) => Ok(&self.source),
            None => {
                let text = "needs a rig: name it with --rig RIG.toml (only a log brings its own)";
                Err(Failure::new(Exit::Usage, format!("{}: {text}", self.source.display())))
            }
        }
    }

    /// What the report says of the run.
    fn info(&self) -> RunInfo {
        let settings = [
            self.from.map(|ns| ("From".to_owned(), format!("{} s", seconds(ns)))),
            self.to.map(|ns| ("To".to_owned(), format!("{} s", seconds(ns)))),
            self.fps.map(|rate| ("Stated frame rate".to_owned(), format!("{rate} a second"))),
            self.full_frame.then(|| ("Search".to_owned(), "every picture whole".to_owned())),
        ];
        RunInfo {
            source: self.source.display().to_string(),
            rig: self.rig.as_ref().unwrap_or(&self.source).display().to_string(),
            settings: settings.into_iter().flatten().chain(provenance::of_this_run()).collect(),
            camera_frame: self.frame == Reference::Camera,
        }
    }

    fn described(&self) -> Run {
        let whole = |path: &Path| unlike_others(&whole_path(path));
        Run {
            command: "track".to_owned(),
            version: env!("CARGO_PKG_VERSION").to_owned(),
            recording: whole(&self.source),
            rig: whole(self.rig.as_ref().unwrap_or(&self.source)),
            frame: self.frame.word().to_owned(),
            from_s: self.from.map(seconds),
            to_s: self.to.map(seconds),
            fps: self.fps.map(|rate| rate.to_string()),
            full_frame: self.full_frame,
            record: self.record.map(|record| record.word().to_owned()),
        }
    }
}
