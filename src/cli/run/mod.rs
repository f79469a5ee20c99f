//! Common parts of offline and live tracking: the rig, the files, the end of a run.

pub(super) mod finished;
pub(super) mod folder;
mod options;
pub(super) mod summary;

pub(super) use options::{LogFor, Record, Reference};

use super::{Exit, Failure};
use crate::archive::transient::is_transient;
use crate::log;
use crate::log::schema::PICTURES_FILE;
use crate::log::schema::RIG_ATTACHMENT;
use crate::pipeline::{End, Summary};
use crate::plural::plural;
use crate::report::{ReportSink, RunInfo};
use crate::rig::check::{Warning, check};
use crate::rig::{Rig, RigError, View};
use crate::sink::{CsvSink, McapSink, OutputFrame, OverlaySink, PictureCount, PictureVideo, Sink, SinkError};
use crate::source::times::seconds;
use crate::text_file;
use folder::Files;
use std::path::Path;
use std::sync::Arc;

/// A pool of `threads` threads for the fits; 0 for one per core.
pub(super) fn pool(threads: usize) -> Result<rayon::ThreadPool, Failure> {
    rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .build()
        .map_err(|e| Failure::new(Exit::Failed, format!("cannot start the tracker's threads: {e}")))
}

/// The rig in `file`, and its text.
pub(super) fn load_rig(file: &Path, reference: Reference) -> Result<(Rig, String), Failure> {
    let text = text_file::read(file).map_err(|source| RigError::Read { file: file.to_owned(), source })?;
    parse_rig(file, text, reference)
}

/// The rig that is attached to the log `file`, and its text.
pub(super) fn rig_of_log(file: &Path, reference: Reference) -> Result<(Rig, String), Failure> {
    let text = log::attached(file, RIG_ATTACHMENT).map_err(Failure::usage)?.unwrap_or_default();
    if text.trim().is_empty() {
        let text = format!("{}: has no rig.toml attached: name the rig with --rig", file.display());
        return Err(Failure::usage(text));
    }
    parse_rig(file, text, reference)
}

fn parse_rig(file: &Path, text: String, reference: Reference) -> Result<(Rig, String), Failure> {
    let rig = Rig::from_toml_str(&text, file)?;
    two_views(file, &rig.views)?;
    if OutputFrame::from(reference).output_from_camera(&rig).is_none() {
        let missing = "has no [base]: measure it with `catoptra calibrate base`, or track in the camera's frame with \
                       --frame camera";
        return Err(Failure::usage(format!("{}: {missing}", file.display())));
    }
    Ok((rig, text))
}

/// Refuses a rig that can measure nothing: a single view shows a direction, not a position.
pub(super) fn two_views(file: &Path, views: &[View]) -> Result<(), Failure> {
    let [view] = views else { return Ok(()) };
    let text = format!(
        "{}: has one view, `{}`; a place in space needs two. Add the view in the mirror, with `catoptra calibrate rig` \
         or as another [[view]]",
        file.display(),
        view.name
    );
    Err(Failure::usage(text))
}

/// Prints the warnings of `catoptra rig check`, so that a user who never ran it does not learn them from the results.
pub(super) fn print_warnings(file: &Path, rig: &Rig) -> Result<(), Failure> {
    rig_warnings(file, rig)?.iter().for_each(|warning| tracing::warn!("{warning}"));
    Ok(())
}

/// As [`print_warnings`], without printing.
pub(super) fn rig_warnings(file: &Path, rig: &Rig) -> Result<Vec<String>, Failure> {
    let rig_file = file.display();
    let checked = check(&rig.clone().into()).map_err(|e| Failure::usage(format!("{rig_file}: {e}")))?;
    // Without a base, the user has requested the camera frame.
    let warnings = checked.warnings.iter().filter(|warning| **warning != Warning::NoBase);
    Ok(warnings.map(|warning| format!("{rig_file}: {warning}")).collect())
}

/// The files of a run, open.
pub(super) struct Opened {
    pub(super) sinks: Vec<Box<dyn Sink + Send>>,
    /// The video of the pictures, if there is to be one.
    pub(super) video: Option<Box<dyn Sink + Send>>,
}

/// How to write a log.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Logged {
    pub(super) record: Option<Record>,
    pub(super) profile: LogFor,
    /// Whether pictures are counted all the same when none are recorded from the beginning.
    pub(super) counts: bool,
    /// Whether it is given pictures, to cut them itself.
    pub(super) cuts: bool,
    /// Whether the same frames give the same bytes; a run that is killed may then lose more than its last second.
    pub(super) repeatable: bool,
    /// Whether a lamp is watched that shows commands.
    pub(super) ticks: bool,
}

/// Opens the files of a run.
pub(super) fn open_sinks(
    files: &Files,
    rig: &Rig,
    [rig_toml, run_toml]: [&str; 2],
    reference: Reference,
    info: RunInfo,
    logged: Logged,
    count: &Arc<PictureCount>,
) -> Result<Opened, Failure> {
    let Logged { record, profile, counts, cuts, repeatable, ticks } = logged;
    let open = || -> Result<Opened, SinkError> {
        let mut log = McapSink::of_profile(profile.into(), &files.log, rig, rig_toml, run_toml)?;
        if let Some(record) = record {
            let what = record.codec().map_or(record.word(), |_| PICTURES_FILE);
            log = log.with_pictures(what, Arc::clone(count));
        } else if counts {
            log = log.with_picture_count(Arc::clone(count));
        }
        if repeatable {
            log = log.by_camera_time();
        }
        if cuts && record == Some(Record::Windows) {
            log = log.with_windows();
        }
        let mut sinks: Vec<Box<dyn Sink + Send>> = vec![
            Box::new(log),
            Box::new(match files.table_on_stdout() {
                true => CsvSink::on_stdout(rig, reference.into(), ticks)?,
                false if ticks => CsvSink::with_ticks(&files.table, rig, reference.into())?,
                false => CsvSink::create(&files.table, rig, reference.into())?,
            }),
            Box::new(ReportSink::create(&files.report, rig, info.clone())?),
        ];
        if let Some(overlay) = &files.overlay {
            sinks.push(Box::new(OverlaySink::create(overlay, rig)?));
        }
        let video = files.pictures.as_ref().zip(record.and_then(Record::codec));
        let video = video.map(|(path, codec)| PictureVideo::create(path, codec)).transpose()?;
        let video = video.map(|video| Box::new(video) as Box<dyn Sink + Send>);
        Ok(Opened { sinks, video })
    };
    open().map_err(|e| Failure::new(Exit::Failed, e))
}

/// The exit code of a run, by how it ended, with the message to go with it.
pub(super) fn verdict(source: &str, rig: &Rig, summary: Summary) -> Result<(), Failure> {
    let tally = &summary.tally;
    let frames = |done: &str| match tally.frames {
        0 => "nothing is tracked".to_owned(),
        n => format!("{} {done}, the last one at {} s", plural(n, "frame"), seconds(tally.last_ns)),
    };
    let so_far = frames("tracked and written");
    // Disks come first: an interrupted run that could not be written is a failed one.
    if !summary.sink_failures.is_empty() {
        let errors: Vec<_> = summary.sink_failures.iter().map(SinkError::to_string).collect();
        let text =
            format!("{}; what was written before is kept; of the whole run {}", errors.join("; "), frames("tracked"));
        // A transient one tells that the run may be repeated.
        let mut failures = summary.sink_failures;
        let which = failures.iter().position(|failure| is_transient(failure)).unwrap_or(0);
        return Err(Failure::because(Exit::Failed, text, failures.swap_remove(which)));
    }
    match summary.end {
        End::Complete | End::Sink => {}
        End::Early(error) => tracing::warn!("{error}"),
        End::Interrupted => return Err(Failure::new(Exit::Interrupted, format!("{source}: {so_far}"))),
        End::Source(error) => {
            let text = format!("{error}; {so_far}");
            return Err(Failure::because(Exit::Failed, text, error));
        }
        End::Track { stamp, error, .. } => {
            let text = format!("{source}: at {} s: {error}; {so_far}", stamp.seconds());
            return Err(Failure::new(Exit::Failed, text));
        }
    }
    match summary::unusable(rig, tally) {
        Some(why) => Err(Failure::new(Exit::Unusable, why)),
        None => Ok(()),
    }
}
