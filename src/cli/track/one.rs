//! One recording: from the first look at it to its summary.

use super::super::lock::Lock;
use super::super::results::{unique_text, whole_path};
use super::super::run::folder::{Files, Run};
use super::super::run::{Logged, load_rig, open_sinks, rig_of_log, rig_warnings, summary, verdict};
use super::super::warned::Work;
use super::super::{Exit, Failure, fitting};
use super::options::Options;
use crate::archive::{Measured, early_end};
use crate::log::is_log;
use crate::pipeline::{self, Summary};
use crate::plural::plural;
use crate::report::RunInfo;
use crate::rig::Rig;
use crate::source::times::seconds;
use crate::source::{FrameSource as _, SourceOptions};
use crate::tally::Tally;
use crate::track::{TrackOptions, Tracker};
use rayon::ThreadPool;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// A rig, as it was read.
pub(super) struct LoadedRig {
    /// Where it is from: a rig file, or a log.
    pub(super) file: PathBuf,
    pub(super) rig: Rig,
    pub(super) toml: String,
    /// What is to be said of it before it is used.
    pub(super) warnings: Vec<String>,
}

impl LoadedRig {
    /// The rig in `file`; that of the log `source` when there is none.
    ///
    /// # Errors
    /// [`Exit::Usage`] when it cannot be used.
    pub(super) fn read(file: Option<&Path>, source: &Path, options: &Options) -> Result<Self, Failure> {
        let (file, (rig, toml)) = match file {
            Some(file) => (file, load_rig(file, options.frame())?),
            None if is_log(source) => (source, rig_of_log(source, options.frame())?),
            None => {
                let text = "needs a rig: name it with --rig RIG.toml (only a log brings its own)";
                return Err(Failure::usage(format!("{}: {text}", source.display())));
            }
        };
        let warnings = rig_warnings(file, &rig)?;
        Ok(Self { file: file.to_owned(), rig, toml, warnings })
    }
}

/// A recording that is to be tracked.
pub(super) struct Request<'a> {
    pub(super) source: &'a Path,
    pub(super) rig: &'a LoadedRig,
    pub(super) options: &'a Options,
    pub(super) files: &'a Files,
    /// Threads of the decoder, 0 for as many as keep all cores busy.
    pub(super) threads: usize,
    /// Those of the tracker.
    pub(super) pool: &'a ThreadPool,
    /// Whether the run is done again when it is killed, rather than what is left of it read.
    pub(super) repeatable: bool,
    /// What the report says of the command.
    pub(super) command: [(String, String); 2],
}

/// A recording at its first frame, and the tracker for it. Nothing is written yet.
pub(super) struct PreparedRun {
    tracker: Tracker,
    source: fitting::Peeked,
}

impl PreparedRun {
    /// How many frames there are, as far as the recording says.
    pub(super) fn frame_count_hint(&self) -> Option<u64> {
        self.source.frame_count_hint()
    }
}

impl Request<'_> {
    /// Judges everything that can be judged before anything is written.
    ///
    /// # Errors
    /// [`Exit::Usage`] when recording and rig cannot be used, or do not fit.
    pub(super) fn open(&self) -> Result<PreparedRun, Failure> {
        if self.options.full_frame && is_log(self.source) {
            let text = "holds parts of its pictures: they cannot be searched whole, leave out --full-frame";
            return Err(Failure::usage(format!("{}: {text}", self.source.display())));
        }
        self.options.record.map_or(Ok(()), |record| record.check(self.source))?;
        let LoadedRig { file, rig, .. } = self.rig;
        let (full_frame, tick_led) = (self.options.full_frame, self.options.tick_led);
        fitting::check_spot(tick_led, (file, rig))?;
        let tracker = Tracker::new(rig, TrackOptions { full_frame, tick_led })
            .map_err(|e| Failure::usage(format!("{}: {e}", file.display())))?;
        let (span, stated_rate) = (self.options.span(), self.options.fps);
        let options = SourceOptions { span, stated_rate, decoder_threads: self.threads, ..SourceOptions::default() };
        let source = fitting::open_to_track((self.source, options), (file, rig))?;
        tracing::info!(
            "{}: {}, {}; -vv describes every frame",
            self.source.display(),
            source.described(),
            plural(self.pool.current_num_threads(), "thread")
        );
        Ok(PreparedRun { tracker, source })
    }

    /// Makes the folder ready.
    ///
    /// # Errors
    /// As [`Files::prepare`].
    pub(super) fn prepare(&self) -> Result<Lock, Failure> {
        self.files.prepare(&self.described(), &[self.source, &self.rig.file])
    }

    /// Tracks the recording; `watch` is called after every frame. The folder is [prepared](Request::prepare).
    ///
    /// # Errors
    /// When nothing could be tracked: the files cannot be opened, or the system gives no thread.
    pub(super) fn track(
        &self,
        ready: PreparedRun,
        work: &Work,
        interrupt: &AtomicBool,
        watch: impl FnMut(&Tally) + Send,
    ) -> Result<Summary, Failure> {
        let PreparedRun { mut tracker, source } = ready;
        let run = self.described();
        let run_toml = run.to_toml()?;
        let (record, profile) = (self.options.record, self.options.profile());
        let ticks = self.options.tick_led.is_some();
        let logged = Logged { record, profile, cuts: true, repeatable: self.repeatable, ticks, ..Logged::default() };
        let texts = [self.rig.toml.as_str(), run_toml.as_str()];
        let opened =
            open_sinks(self.files, &self.rig.rig, texts, self.options.frame(), self.info(), logged, &Arc::default())?;
        let sinks = opened.sinks.into_iter().chain(opened.video).collect();
        let tracked = self
            .pool
            .install(|| work.within(|| pipeline::run(Box::new(source), &mut tracker, sinks, interrupt, watch)));
        let tracked = tracked.map_err(|e| Failure::because(Exit::Failed, format!("cannot start a thread: {e}"), e))?;
        if let Some(sources) = tracked.tally.budget() {
            self.files.add_budget_or_warn(&run, &sources);
        }
        Ok(tracked)
    }

    /// What the report says of the run.
    fn info(&self) -> RunInfo {
        let options = self.options;
        let settings = [
            options.from.map(|ns| ("From".to_owned(), format!("{} s", seconds(ns)))),
            options.to.map(|ns| ("To".to_owned(), format!("{} s", seconds(ns)))),
            options.fps.map(|rate| ("Stated frame rate".to_owned(), format!("{rate} per second"))),
            options.full_frame.then(|| ("Search".to_owned(), "every picture whole".to_owned())),
        ];
        RunInfo {
            source: self.source.display().to_string(),
            rig: self.rig.file.display().to_string(),
            settings: settings.into_iter().flatten().chain(self.command.clone()).collect(),
            camera_frame: options.frame().word() == "camera",
            of_log: is_log(self.source),
        }
    }

    fn described(&self) -> Run {
        described(self.source, &self.rig.file, self.options)
    }
}

/// What is run, as `run.toml` has it.
pub(super) fn described(source: &Path, rig: &Path, options: &Options) -> Run {
    let whole = |path: &Path| unique_text(&whole_path(path));
    Run {
        command: "track".to_owned(),
        version: env!("CARGO_PKG_VERSION").to_owned(),
        recording: whole(source),
        rig: whole(rig),
        frame: options.frame().word().to_owned(),
        from_s: options.from.map(seconds),
        to_s: options.to.map(seconds),
        fps: options.fps.map(|rate| rate.to_string()),
        full_frame: options.full_frame,
        record: options.record.map(|record| record.word().to_owned()),
        profile: options.profile().unusual(),
        tick_led: options.tick_led.map(|spot| spot.to_string()),
    }
}

/// What was measured, and why the recording ended early; and how the run is to be judged.
pub(super) fn judged(
    request: &Request<'_>,
    tracked: Summary,
    work: &Work,
) -> ((Measured, Option<String>), Result<(), Failure>) {
    let views: Vec<String> = request.rig.rig.views.iter().map(|view| view.name.clone()).collect();
    let measured = Measured::of(&tracked, &views);
    let early = early_end(&tracked.end);
    let recording = request.source.display().to_string();
    let verdict = work.within(|| verdict(&recording, &request.rig.rig, tracked));
    ((measured, early), verdict)
}

/// Warns of drift at once: a run may be long. For [`Request::track`].
pub(super) fn alarms(recording: String) -> impl FnMut(&Tally) + Send {
    let mut known = 0;
    move |tally| known = summary::new_alarms(tally, &recording, known)
}
