//! [`run`]: the tracker while the camera runs.
//!
//! | thread | does | waits for |
//! |---|---|---|
//! | `camera` | takes frames out of the source | the camera |
//! | `tracker` | tracks them, sends θ to controllers at once, then learns for later frames | frames |
//! | `log` | writes log, table, report | rows |
//! | `pictures` | records pictures, while wanted | tracked frames |
//! | `publisher` | serves subscribers | rows |
//! | `currents`, `currents in` | take coil currents to the log | samples |
//! | the caller's | watches, tells once a second how it goes | the clock |
//!
//! Frames are tracked by the same [`Tracker`] as recordings: the same pictures give the same rows. Between camera and
//! tracker few pictures wait; a tracker that falls behind goes to the newest frame, and those passed over keep their
//! rows (`skipped_overload`). A frame of another size than the rig's has its row too (`wrong_size`). Nothing that
//! writes or publishes can hold up the tracker: its lines are bounded, what does not fit is counted, and a sink that
//! fails is reported at once while everything else goes on. Where the system allows, camera and tracker are scheduled
//! in real time, and pictures behind everything else.

mod currents;
mod latest;
mod listener;
mod pictures;
mod priority;
mod queue;
mod status;
mod subscribers;
mod switch;
mod tracking;
mod writer;

pub(crate) use currents::currents_of;
pub use currents::{CurrentSource, Currents};
pub use latest::{Latest, lower_priority};
pub use pictures::{MAX_PICTURES, NEARLY_FULL_BYTES, NewPlace, RecordTo, Recording, SwitchedRecording, free_bytes};
pub use priority::Priority;
pub use queue::MAX_WAITING;
pub use status::{Latency, Status};
pub use switch::{RecordState, RecordSwitch};
pub use writer::MAX_ROWS;

use crate::pipeline::{End, Summary, finish_all, returned};
use crate::sink::Sink;
use crate::source::host::HostClock;
use crate::source::{FrameSource, SourceError, StreamFaults};
use crate::tally::Tally;
use crate::track::Tracker;
use pictures::Pictures;
use priority::{SessionPriority, Urgency, run_as};
use queue::Queue;
use status::Counters;
use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::RecvTimeoutError;
use std::thread::{Builder, JoinHandle};
use std::time::{Duration, Instant};
use subscribers::Subscribers;
use tracing::Span;
use tracking::{RowOutputs, start_tracker};
use writer::{Entry, Log};

/// How long a camera that was asked to stop may take.
const STOP_TIMEOUT: Duration = Duration::from_secs(4);
/// How long whoever receives currents may take to stop.
const CURRENTS_TIMEOUT: Duration = Duration::from_secs(1);
/// How often the caller's thread looks around.
const POLL_INTERVAL: Duration = Duration::from_millis(50);
/// How often the status is reported.
const REPORT_INTERVAL: Duration = Duration::from_secs(1);

/// Where the rows of a live run go.
#[derive(Default)]
pub struct Outputs {
    /// Files. When all of them have failed but pages ([`Sink::writes_at_once`]), and nobody else listens, the run ends.
    pub files: Vec<Box<dyn Sink + Send>>,
    /// Controllers: sinks that never wait, served by the tracker's own thread.
    pub controllers: Vec<Box<dyn Sink + Send>>,
    /// Subscribers, each served by a thread of its own that may miss rows.
    pub subscribers: Vec<Box<dyn Sink + Send>>,
    /// Coil currents, as they come.
    pub currents: Option<Currents>,
    /// Pictures of the frames that are tracked.
    pub pictures: Option<Recording>,
    /// Where the last rows, and a picture now and then, are left for onlookers.
    pub latest: Option<Arc<Latest>>,
}

/// When a run ends, if the source does not end before.
#[derive(Debug, Clone, Default)]
pub struct Until {
    /// When somebody sets this. It must be the flag that the source watches.
    pub stop: Arc<AtomicBool>,
    /// When this is over.
    pub duration: Option<Duration>,
}

impl Until {
    /// Waits for the first bytes of standard input, or its end; `false` when the run would be over before. (What reads
    /// it cannot be stopped. The run's own duration begins after it.)
    pub(crate) fn await_standard_input(&self) -> bool {
        let began = Instant::now();
        while !self.stop.load(Ordering::Relaxed) && self.duration.is_none_or(|duration| began.elapsed() < duration) {
            #[cfg(unix)]
            if !is_silent(&std::io::stdin()) {
                return true;
            }
            #[cfg(not(unix))]
            return true;
        }
        false
    }
}

/// Whether nothing comes from a file for [`POLL_INTERVAL`].
#[cfg(unix)]
fn is_silent(file: &impl std::os::fd::AsFd) -> bool {
    use rustix::event::{PollFd, PollFlags, Timespec, poll};
    let wait = Timespec::try_from(POLL_INTERVAL).ok();
    let mut watched = [PollFd::new(file, PollFlags::IN)];
    match poll(&mut watched, wait.as_ref()) {
        Ok(ready) => ready == 0,
        // A signal came.
        Err(error) => error == rustix::io::Errno::INTR,
    }
}

/// What a live run came to.
#[derive(Debug)]
pub struct LiveSummary {
    /// The same summary as of a recording.
    pub run: Summary,
    /// Time from the arrival of a frame to its θ being sent, over all tracked frames.
    pub latency: Latency,
    /// Frames that were not logged because the log could not keep up.
    pub unlogged_frames: u64,
    /// Samples of currents that were not logged for the same reason.
    pub unlogged_currents: u64,
    /// Whether the source of currents failed before the end.
    pub lost_currents: bool,
    /// Rows that subscribers were not given because they would have waited.
    pub unpublished: u64,
    /// Pictures recorded, and pictures lost to the recording; `None` when none were to be.
    pub pictures: Option<(u64, u64)>,
    /// Whether it went before other programs.
    pub priority: Priority,
}

/// Tracks what `source` gives; `watch` is called once a second.
///
/// Fits run in `pool`. The tracker is returned to nobody: a run begins with a new one.
///
/// # Errors
/// When the system gives no thread, or no memory for counters; nothing is tracked then.
pub fn run(
    source: Box<dyn FrameSource + Send>,
    tracker: Tracker,
    pool: rayon::ThreadPool,
    outputs: Outputs,
    clock: HostClock,
    until: &Until,
    mut watch: impl FnMut(&Status),
) -> io::Result<LiveSummary> {
    let began = Instant::now();
    let session = SessionPriority::raise();
    tracing::info!("{}", session.obtained);
    let stop = &until.stop;
    let tally = Tally::new(tracker.rig());
    let queue = Arc::new(Queue::new(tracker.rig()));
    let counters = Arc::new(Counters::new(tally, clock).map_err(io::Error::other)?);
    let listened_to = !outputs.controllers.is_empty() || !outputs.subscribers.is_empty();
    let (log, writer) = Log::start(outputs.files)?;
    let backlog = log.backlog();
    let started = outputs.subscribers.into_iter().map(Subscribers::start).collect::<io::Result<Vec<_>>>()?;
    let (subscribers, publishers): (Vec<_>, Vec<_>) = started.into_iter().unzip();
    let unpublished: Vec<_> = subscribers.iter().map(Subscribers::missed).collect();
    let count = outputs.pictures.as_ref().map(|recording| Arc::clone(&recording.count));
    let counted = || count.as_ref().map(|count| (count.recorded(), count.dropped()));
    let recording = outputs.pictures.map(|recording| Pictures::start(recording, log.clone())).transpose()?;
    let (pictures, recorder) = recording.unzip();

    let camera = start_camera(source, Arc::clone(&queue), Arc::clone(stop))?;
    let currents = outputs.currents.map(|currents| {
        start_currents(currents, log.clone(), subscribers.clone(), outputs.latest.clone(), Arc::clone(stop))
    });
    let currents = currents.transpose()?;
    let out = RowOutputs {
        controllers: outputs.controllers.into_iter().map(|sink| (sink, true)).collect(),
        subscribers,
        log,
        counters: Arc::clone(&counters),
        pictures,
        latest: outputs.latest.clone(),
    };
    let tracking = start_tracker(tracker, pool, Arc::clone(&queue), out)?;

    let reason_to_stop = || {
        if backlog.sinks_alive() == 0 && !listened_to {
            Some(End::Sink)
        } else if until.duration.is_some_and(|duration| began.elapsed() >= duration) {
            Some(End::Complete)
        } else {
            stop.load(Ordering::Relaxed).then_some(End::Interrupted)
        }
    };
    let mut interrupted = None;
    let mut reported = Instant::now();
    while !tracking.is_finished() {
        std::thread::sleep(POLL_INTERVAL);
        if reported.elapsed() >= REPORT_INTERVAL {
            reported = Instant::now();
            let (waiting, unlogged) = (backlog.waiting(), backlog.unlogged_frames() + backlog.unlogged_currents());
            let status = Status { backlog: waiting, unlogged, pictures: counted(), ..counters.status() };
            outputs.latest.iter().for_each(|latest| latest.put_status(&status));
            watch(&status);
        }
        if interrupted.is_none()
            && let Some(end) = reason_to_stop()
        {
            interrupted = Some((Instant::now(), end));
            stop.store(true, Ordering::Relaxed);
        }
        if camera.is_finished() || interrupted.as_ref().is_some_and(|(since, _)| since.elapsed() > STOP_TIMEOUT) {
            queue.close();
        }
    }
    stop.store(true, Ordering::Relaxed);
    let asked = interrupted.as_ref().map_or_else(Instant::now, |(since, _)| *since);
    let (source_faults, source_end) = ended_by(camera, asked + STOP_TIMEOUT).unwrap_or_else(|| {
        let timeout_s = STOP_TIMEOUT.as_secs();
        tracing::warn!("the camera did not stop in {timeout_s} s: counts of its faults are not known, and stay 0");
        CameraEnd::default()
    });
    let (tracked, controllers) = returned(tracking.join());
    let lost_currents = currents.is_some_and(|thread| returned(thread.join()));
    let unrecorded = recorder.and_then(|thread| returned(thread.join()));
    let (sinks, mut sink_failures) = returned(writer.join());
    let (mut tally, latency) = counters.totals();
    tally.end();
    sink_failures.extend(finish_all(sinks, &tally));
    sink_failures.extend(unrecorded);
    finish_all(controllers, &tally).iter().for_each(RowOutputs::report);
    for sink in publishers.into_iter().filter_map(|thread| returned(thread.join())) {
        finish_all(vec![(sink, true)], &tally).iter().for_each(Subscribers::report);
    }
    Ok(LiveSummary {
        run: Summary {
            tally,
            source: source_faults,
            elapsed: began.elapsed(),
            end: end_of(tracked, interrupted.map(|(_, end)| end), source_end),
            sink_failures,
        },
        latency,
        unlogged_frames: backlog.unlogged_frames(),
        unlogged_currents: backlog.unlogged_currents(),
        lost_currents,
        unpublished: unpublished.iter().map(|missed| missed.load(Ordering::Relaxed)).sum(),
        pictures: counted(),
        priority: session.obtained,
    })
}

/// Faults of the stream, and the error that ended it.
type CameraEnd = (StreamFaults, Option<SourceError>);

/// Its warnings belong to the caller's span.
fn start_camera(
    source: Box<dyn FrameSource + Send>,
    queue: Arc<Queue>,
    stop: Arc<AtomicBool>,
) -> io::Result<JoinHandle<CameraEnd>> {
    let span = Span::current();
    Builder::new().name("camera".to_owned()).spawn(move || span.in_scope(|| take_all(source, &queue, &stop)))
}

/// What a thread returned, if it ends by then. What is asleep in a driver is not waited for: the process ends soon.
fn ended_by<T>(thread: JoinHandle<T>, deadline: Instant) -> Option<T> {
    while !thread.is_finished() && Instant::now() < deadline {
        std::thread::sleep(POLL_INTERVAL);
    }
    thread.is_finished().then(|| returned(thread.join()))
}

/// Why the run ended: by the tracker, by request, or by the source.
fn end_of(tracked: Option<End>, requested: Option<End>, source: Option<SourceError>) -> End {
    match (tracked.or(requested), source) {
        (Some(end), _) => end,
        (None, Some(error)) if error.is_early_end() => End::Early(error),
        (None, Some(error)) => End::Source(error),
        (None, None) => End::Complete,
    }
}

/// Takes frames until there are no more.
fn take_all(mut source: Box<dyn FrameSource + Send>, queue: &Queue, stop: &AtomicBool) -> CameraEnd {
    run_as(Urgency::Camera);
    let end = loop {
        if stop.load(Ordering::Relaxed) {
            break None;
        }
        match source.next_frame() {
            Ok(Some(frame)) => queue.push(frame),
            Ok(None) => break None,
            Err(error) => break Some(error),
        }
    };
    queue.close();
    (source.faults(), end)
}

fn start_currents(
    currents: Currents,
    log: Log,
    subscribers: Vec<Subscribers>,
    latest: Option<Arc<Latest>>,
    stop: Arc<AtomicBool>,
) -> io::Result<JoinHandle<bool>> {
    Builder::new()
        .name("currents".to_owned())
        .spawn(move || log_currents(&currents, &log, &subscribers, latest.as_deref(), &stop))
}

/// Hands on currents until the run ends; whether they ended before.
fn log_currents(
    currents: &Currents,
    log: &Log,
    subscribers: &[Subscribers],
    latest: Option<&Latest>,
    stop: &AtomicBool,
) -> bool {
    let mut ends: Option<Instant> = None;
    loop {
        match currents.samples.recv_timeout(POLL_INTERVAL) {
            Ok(sample) => {
                subscribers.iter().for_each(|line| line.put_current(&sample));
                latest.iter().for_each(|latest| latest.put_current(&sample));
                while currents.wait && !log.has_room_for_current() {
                    std::thread::sleep(POLL_INTERVAL);
                }
                log.put(Entry::Current(sample));
            }
            Err(RecvTimeoutError::Timeout) if !stop.load(Ordering::Relaxed) => {}
            // Who receives them reports what was lost before it is done.
            Err(RecvTimeoutError::Timeout) if ends.get_or_insert_with(Instant::now).elapsed() < CURRENTS_TIMEOUT => {}
            Err(RecvTimeoutError::Timeout) => return false,
            // A source goes on until it is stopped, or fails.
            Err(RecvTimeoutError::Disconnected) => return !stop.load(Ordering::Relaxed),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_thread_that_is_asleep_is_not_waited_for_and_one_that_is_about_to_end_is() {
        let asleep = std::thread::spawn(|| std::thread::sleep(Duration::from_secs(3600)));
        let began = Instant::now();
        assert_eq!(ended_by(asleep, began + Duration::from_millis(120)), None);
        assert!(began.elapsed() < Duration::from_secs(60));
        let slow = std::thread::spawn(|| {
            std::thread::sleep(Duration::from_millis(120));
            7
        });
        assert_eq!(ended_by(slow, Instant::now() + Duration::from_secs(60)), Some(7));
    }

    #[test]
    fn the_tracker_ends_a_run_before_anybody_and_a_source_last() {
        let failed = || Some(SourceError::Stream { url: String::new(), reason: String::new() });
        assert!(matches!(end_of(Some(End::Sink), Some(End::Interrupted), failed()), End::Sink));
        assert!(matches!(end_of(None, Some(End::Interrupted), failed()), End::Interrupted));
        assert!(matches!(end_of(None, None, failed()), End::Source(_)));
        assert!(matches!(end_of(None, None, None), End::Complete));
    }
}
