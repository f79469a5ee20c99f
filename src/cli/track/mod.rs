//! `catoptra track`: a recording, or a folder of pictures, to log, table, report and overlay.

mod folder;
mod told;

use super::progress::Progress;
use super::{Exit, Failure, fitting, interrupt, output};
use catoptra::pipeline::{self, End, Summary};
use catoptra::report::{ReportSink, RunInfo};
use catoptra::rig::check::{Warning, check};
use catoptra::rig::{Rig, RigError};
use catoptra::sink::{CsvSink, McapSink, OutputFrame, OverlaySink, Sink, SinkError};
use catoptra::source::times::{parse_seconds_ns, seconds};
use catoptra::source::{FrameRate, FrameSource as _, SourceOptions, Span};
use catoptra::tally::Tally;
use catoptra::track::{TrackOptions, Tracker};
use clap::builder::RangedU64ValueParser;
use folder::{Files, Run, frame_word, unlike_others, whole_path};
use std::path::{Path, PathBuf};

/// Arguments of `catoptra track`.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// A recorded video, or a folder of pictures with their times in times.csv
    #[arg(value_name = "VIDEO|DIR")]
    source: PathBuf,
    /// The rig, with colours and base frame
    #[arg(long, value_name = "RIG.toml")]
    rig: PathBuf,
    /// Folder for the results [default: NAME-track, here]
    #[arg(short, long, value_name = "OUT")]
    out: Option<PathBuf>,
    /// Write the table to FILE instead of OUT/track.csv
    #[arg(long, value_name = "FILE", num_args = 0..=1, require_equals = true)]
    csv: Option<Option<PathBuf>>,
    /// Also write a video with what was found drawn into it
    #[arg(long)]
    overlay: bool,
    /// Frame of reference of table and report
    #[arg(long, value_enum, default_value_t = Reference::Base)]
    frame: Reference,
    /// Leave out what is before T, seconds of the recording's clock
    #[arg(long, value_name = "T", value_parser = seconds_ns, allow_hyphen_values = true)]
    from: Option<i64>,
    /// Leave out what is after T
    #[arg(long, value_name = "T", value_parser = seconds_ns, allow_hyphen_values = true)]
    to: Option<i64>,
    /// Frames a second of a folder of pictures without times.csv
    #[arg(long, value_name = "F", allow_hyphen_values = true)]
    fps: Option<FrameRate>,
    /// Threads of decoder and tracker; results are the same with any [default: one a core]
    #[arg(long, value_name = "N", allow_hyphen_values = true, value_parser = RangedU64ValueParser::<usize>::new().range(1..=256))]
    threads: Option<usize>,
    /// Search every picture whole: slower, same results
    #[arg(long)]
    full_frame: bool,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Reference {
    Base,
    Camera,
}

fn seconds_ns(text: &str) -> Result<i64, String> {
    parse_seconds_ns(text).ok_or_else(|| "expected seconds, such as 12 or 3.25".to_owned())
}

pub(crate) fn run(args: &Args, quiet: bool) -> Result<(), Failure> {
    let interrupt = interrupt::watch()?;
    // 1. everything is judged before anything is written
    let (rig, rig_toml) = load_rig(args)?;
    let mut tracker = Tracker::new(&rig, TrackOptions { full_frame: args.full_frame })
        .map_err(|e| Failure::new(Exit::Usage, format!("{}: {e}", args.rig.display())))?;
    let span = Span { from_ns: args.from, to_ns: args.to };
    let options = SourceOptions { span, stated_rate: args.fps, decoder_threads: args.threads() };
    let source = fitting::open((&args.source, options), (&args.rig, &rig))?;
    tell_warnings(args, &rig)?;
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(args.threads())
        .build()
        .map_err(|e| Failure::new(Exit::Failed, format!("cannot start the tracker's threads: {e}")))?;
    // 2. the files
    let run = args.described();
    let run_toml = run.to_toml()?;
    let folder = args.out.clone().unwrap_or_else(|| folder::default_folder(&args.source));
    let files = Files::new(&folder, args.csv.as_ref().and_then(Option::as_deref), args.overlay);
    files.prepare(&run, &[&args.source, &args.rig])?;
    let sinks = open_sinks(args, &rig, [&rig_toml, &run_toml], &files).map_err(|e| Failure::new(Exit::Failed, e))?;
    // 3. the run
    let mut progress = Progress::of_frames(source.frame_count_hint(), quiet);
    let recording = args.source.display().to_string();
    let mut told = 0;
    let watch = |tally: &Tally| {
        progress.at(tally.frames);
        // At once: a run may be long, and be live.
        told = told::new_alarms(tally, &recording, told);
    };
    let summary = pool
        .install(|| pipeline::run(Box::new(source), &mut tracker, sinks, interrupt, watch))
        .map_err(|e| Failure::new(Exit::Failed, format!("cannot start a thread: {e}")))?;
    drop(progress);
    // 4. what came of it
    if !quiet {
        let mut text = String::new();
        told::summary(&mut text, &recording, &summary, &files, &rig)
            .map_err(|e| Failure::new(Exit::Failed, format!("cannot describe the run: {e}")))?;
        output::print(&text)?;
    }
    verdict(&args.source, &rig, summary)
}

impl Args {
    /// 0: one a core.
    fn threads(&self) -> usize {
        self.threads.unwrap_or(0)
    }

    fn frame(&self) -> OutputFrame {
        match self.frame {
            Reference::Base => OutputFrame::Base,
            Reference::Camera => OutputFrame::Camera,
        }
    }

    fn described(&self) -> Run {
        let whole = |path: &Path| unlike_others(&whole_path(path));
        Run {
            command: "track".to_owned(),
            version: env!("CARGO_PKG_VERSION").to_owned(),
            recording: whole(&self.source),
            rig: whole(&self.rig),
            frame: frame_word(self.frame()).to_owned(),
            from_s: self.from.map(seconds),
            to_s: self.to.map(seconds),
            fps: self.fps.map(|rate| rate.to_string()),
            full_frame: self.full_frame,
        }
    }
}

/// The rig, and the text it was read from.
fn load_rig(args: &Args) -> Result<(Rig, String), Failure> {
    let text =
        std::fs::read_to_string(&args.rig).map_err(|source| RigError::Read { file: args.rig.clone(), source })?;
    let rig = Rig::from_toml_str(&text, &args.rig)?;
    if args.frame().output_from_camera(&rig).is_none() {
        let missing = "has no [base]: measure it with `catoptra calibrate base`, or track in the camera's frame with \
                       --frame camera";
        return Err(Failure::new(Exit::Usage, format!("{}: {missing}", args.rig.display())));
    }
    Ok((rig, text))
}

/// What `catoptra rig check` would warn of: who never asked must not learn it from the results.
fn tell_warnings(args: &Args, rig: &Rig) -> Result<(), Failure> {
    let rig_file = args.rig.display();
    let checked = check(rig).map_err(|e| Failure::new(Exit::Usage, format!("{rig_file}: {e}")))?;
    // Without a base the user has asked for the camera's frame.
    for warning in checked.warnings.iter().filter(|warning| **warning != Warning::NoBase) {
        tracing::warn!("{rig_file}: {warning}");
    }
    Ok(())
}

fn open_sinks(
    args: &Args,
    rig: &Rig,
    [rig_toml, run_toml]: [&str; 2],
    files: &Files,
) -> Result<Vec<Box<dyn Sink + Send>>, SinkError> {
    let settings = [
        args.from.map(|ns| ("From".to_owned(), format!("{} s", seconds(ns)))),
        args.to.map(|ns| ("To".to_owned(), format!("{} s", seconds(ns)))),
        args.fps.map(|rate| ("Stated frame rate".to_owned(), format!("{rate} a second"))),
        args.full_frame.then(|| ("Search".to_owned(), "every picture whole".to_owned())),
    ];
    let info = RunInfo {
        source: args.source.display().to_string(),
        rig: args.rig.display().to_string(),
        settings: settings.into_iter().flatten().collect(),
        camera_frame: args.frame == Reference::Camera,
    };
    let mut sinks: Vec<Box<dyn Sink + Send>> = vec![
        Box::new(McapSink::create(&files.log, rig, rig_toml, run_toml)?),
        Box::new(CsvSink::create(&files.table, rig, args.frame())?),
        Box::new(ReportSink::create(&files.report, rig, info)?),
    ];
    if let Some(overlay) = &files.overlay {
        sinks.push(Box::new(OverlaySink::create(overlay, rig)?));
    }
    Ok(sinks)
}

/// How the run ended: exit code and last words.
fn verdict(source: &Path, rig: &Rig, summary: Summary) -> Result<(), Failure> {
    let tally = &summary.tally;
    let source = source.display();
    let so_far = match tally.frames {
        0 => "nothing is tracked".to_owned(),
        n => format!("{n} frames are tracked and written, the last one at {} s", seconds(tally.last_ns)),
    };
    // Disks come first: an interrupted run that could not be written is a failed one.
    if !summary.sink_failures.is_empty() {
        let errors: Vec<_> = summary.sink_failures.iter().map(SinkError::to_string).collect();
        let text = format!("{}; the other files are complete: {so_far}", errors.join("; "));
        return Err(Failure::new(Exit::Failed, text));
    }
    match summary.end {
        End::Complete | End::Sink => {}
        End::Early(error) => tracing::warn!("{error}"),
        End::Interrupted => return Err(Failure::new(Exit::Interrupted, format!("{source}: {so_far}"))),
        End::Source(error) => return Err(Failure::new(Exit::Failed, format!("{error}; {so_far}"))),
        End::Track { stamp, error, .. } => {
            let text = format!("{source}: at {} s: {error}; {so_far}", stamp.seconds());
            return Err(Failure::new(Exit::Failed, text));
        }
    }
    match told::unusable(rig, tally) {
        Some(why) => Err(Failure::new(Exit::Unusable, why)),
        None => Ok(()),
    }
}
