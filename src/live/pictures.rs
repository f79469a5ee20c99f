//! The thread that records pictures: the first to give way when anything is short.
//!
//! Few pictures wait for it; what does not fit is dropped and counted, and no estimate ever waits. Windows go into the
//! log, but only while the log's own line is short. When the disk has less free space than is to be kept for the log,
//! or the video cannot be written, no more pictures are recorded, which is told once; the estimates go on.
//!
//! With a [switch](RecordSwitch) there are stretches that are recorded, each whole to a place of its own or into the
//! log, and stretches between that are not.

use super::priority::{Urgency, run_as};
use super::switch::{FROM_THE_BEGINNING, RecordSwitch, is_on};
use super::writer::{Backlog, Entry, Log};
use crate::estimate::Estimate;
use crate::sink::{PictureCount, Sink, SinkError, WindowRecorder, can_hold};
use crate::source::Picture;
use crate::tally::Tally;
use std::io;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, TrySendError, sync_channel};
use std::thread::{Builder, JoinHandle};
use std::time::{Duration, Instant};

/// Pictures that may wait for the recorder.
pub const MAX_PICTURES: usize = 16;
/// Rows that may wait for the disk while windows are added to them.
const MAX_ROWS_BEFORE: usize = 64;
/// How often the disk is looked at.
const POLL_INTERVAL: Duration = Duration::from_millis(200);

/// What is recorded of the pictures.
pub struct Recording {
    /// Where they go from the beginning of the run.
    pub to: RecordTo,
    /// Counts them.
    pub count: Arc<PictureCount>,
    /// The folder whose disk is watched.
    pub folder: PathBuf,
    /// Free space below which no more pictures are recorded, bytes: it is the log's.
    pub keep_free_bytes: u64,
    /// Begins and ends it while the run goes on; it is recorded from beginning to end without.
    pub switch: Option<SwitchedRecording>,
}

/// Recording that is begun and ended while a run goes on.
pub struct SwitchedRecording {
    /// Who turns it.
    pub switch: Arc<RecordSwitch>,
    /// Finds a place for each stretch.
    pub place: NewPlace,
}

/// Opens where a stretch is recorded, by how it was asked for; with its name, for people.
pub type NewPlace = Box<dyn FnMut(&str) -> Result<(RecordTo, String), SinkError> + Send>;

/// Where pictures go.
pub enum RecordTo {
    /// Nowhere, until recording is begun.
    Nowhere,
    /// The parts the tracker looked at, into the log.
    Log,
    /// Whole, to this sink.
    Video(Box<dyn Sink + Send>),
}

/// A picture on its way.
struct QueuedPicture {
    estimate: Arc<Estimate>,
    picture: Arc<Picture>,
    /// Pictures before it were dropped.
    after_loss: bool,
    /// The stretch that it is in.
    stretch: u64,
}

/// The near end of the line.
pub(super) struct Pictures {
    line: SyncSender<QueuedPicture>,
    count: Arc<PictureCount>,
    switch: Option<Arc<RecordSwitch>>,
    lost: bool,
}

impl Pictures {
    /// Starts the thread; it ends, with what went wrong, when the near end is gone.
    pub(super) fn start(recording: Recording, log: Log) -> io::Result<(Self, JoinHandle<Option<SinkError>>)> {
        let (line, taken) = sync_channel(MAX_PICTURES);
        let count = Arc::clone(&recording.count);
        let switch = recording.switch.as_ref().map(|switched| Arc::clone(&switched.switch));
        // The switch may have been turned already: that stretch has no place yet.
        let stretch = if matches!(recording.to, RecordTo::Nowhere) { 0 } else { FROM_THE_BEGINNING };
        let thread = Builder::new().name("pictures".to_owned()).spawn(move || {
            let backlog = log.backlog();
            let windows = WindowRecorder::default();
            let looked = None;
            Recorder { recording, log, backlog, windows, looked, stopped: false, stretch, failure: None }.run(&taken)
        })?;
        Ok((Self { line, count, switch, lost: false }, thread))
    }

    /// Hands a picture that was tracked to the recorder; never waits.
    pub(super) fn put(&mut self, estimate: Arc<Estimate>, picture: Arc<Picture>) {
        let stretch = stretch(self.switch.as_deref());
        if !is_on(stretch) {
            self.lost = false;
            return;
        }
        let taken = QueuedPicture { estimate, picture, after_loss: self.lost, stretch };
        self.lost = match self.line.try_send(taken) {
            Ok(()) => false,
            Err(TrySendError::Full(_) | TrySendError::Disconnected(_)) => {
                self.count.add_dropped();
                true
            }
        };
    }
}

/// The stretch of now.
fn stretch(switch: Option<&RecordSwitch>) -> u64 {
    switch.map_or(FROM_THE_BEGINNING, RecordSwitch::stretch)
}

struct Recorder {
    recording: Recording,
    log: Log,
    backlog: Arc<Backlog>,
    windows: WindowRecorder,
    /// When the disk was looked at.
    looked: Option<Instant>,
    stopped: bool,
    /// The one that is being recorded, or was.
    stretch: u64,
    /// The first.
    failure: Option<SinkError>,
}

impl Recorder {
    fn run(mut self, line: &Receiver<QueuedPicture>) -> Option<SinkError> {
        // The first picture and what its file begins with are soon on the disk, whatever else wants the processor.
        run_as(Urgency::Soon);
        let mut first = true;
        loop {
            let taken = match line.recv_timeout(POLL_INTERVAL) {
                Ok(taken) => taken,
                Err(RecvTimeoutError::Timeout) => {
                    // A stretch ends without a picture, too.
                    let now = stretch(self.recording.switch.as_ref().map(|switched| switched.switch.as_ref()));
                    if !is_on(now) {
                        self.switch_to(now);
                    }
                    continue;
                }
                Err(RecvTimeoutError::Disconnected) => break,
            };
            if taken.stretch > self.stretch {
                self.switch_to(taken.stretch);
            }
            if !self.stopped && self.is_short() {
                let (folder, least) = (self.recording.folder.display(), self.recording.keep_free_bytes as f64 * 1e-9);
                let text = format!("{folder}: less than {least:.1} GB are free: no more pictures are recorded");
                tracing::warn!("{text}, the log continues");
                self.stop(text);
            }
            let recorded = if self.stopped || taken.stretch < self.stretch { Ok(false) } else { self.record(&taken) };
            match recorded {
                Ok(true) if first => {
                    first = false;
                    run_as(Urgency::Pictures);
                }
                Ok(true) => {}
                Ok(false) => self.recording.count.add_dropped(),
                Err(error) => {
                    self.recording.count.add_dropped();
                    tracing::error!("{error}; no more pictures are recorded, the rest of the run continues");
                    self.fail(error);
                }
            }
        }
        self.finish();
        self.failure
    }

    /// No more of this stretch is recorded.
    fn stop(&mut self, problem: String) {
        self.stopped = true;
        if let Some(switched) = &self.recording.switch {
            switched.switch.failed(problem);
        }
    }

    fn fail(&mut self, error: SinkError) {
        self.stop(error.to_string());
        self.failure.get_or_insert(error);
    }

    /// Completes what is being recorded.
    fn finish(&mut self) {
        let ended = match std::mem::replace(&mut self.recording.to, RecordTo::Nowhere) {
            // A video has no place for counts.
            RecordTo::Video(mut video) => video.finish(&Tally::default()),
            RecordTo::Log | RecordTo::Nowhere => Ok(()),
        };
        // What a failed video says at its end follows from why it failed.
        if let Err(error) = ended {
            if !self.stopped {
                tracing::error!("{error}");
                self.stop(error.to_string());
            }
            self.failure.get_or_insert(error);
        }
    }

    /// Ends a stretch, and begins the next one if that is to be recorded.
    fn switch_to(&mut self, stretch: u64) {
        if stretch == self.stretch {
            return;
        }
        self.finish();
        (self.stretch, self.stopped) = (stretch, false);
        // The frames between are not in the log.
        self.windows.lost_one();
        let Some(switched) = self.recording.switch.as_mut().filter(|_| is_on(stretch)) else { return };
        match (switched.place)(&switched.switch.how()) {
            Ok((to, name)) => {
                tracing::info!("pictures are recorded: {name}");
                switched.switch.began(name);
                self.recording.to = to;
            }
            Err(error) => {
                tracing::error!("{error}; no pictures are recorded, the rest of the run continues");
                self.fail(error);
            }
        }
    }

    /// Whether it could be handed on; if not, nothing is wrong, but the disk is too slow.
    fn record(&mut self, taken: &QueuedPicture) -> Result<bool, SinkError> {
        match &mut self.recording.to {
            RecordTo::Nowhere => Ok(false),
            RecordTo::Video(video) => {
                video.write(&taken.estimate, Some(taken.picture.as_ref()))?;
                if can_hold(&taken.picture) {
                    self.recording.count.add_recorded();
                }
                Ok(true)
            }
            RecordTo::Log => {
                if taken.after_loss {
                    self.windows.lost_one();
                }
                if self.backlog.waiting() > MAX_ROWS_BEFORE {
                    self.windows.lost_one();
                    return Ok(false);
                }
                let kept = self.windows.keep(&taken.estimate, &taken.picture)?;
                // Counted when it is written.
                let has_room = self.log.put(Entry::Windows(Box::new(kept), Arc::clone(&self.recording.count)));
                if !has_room {
                    self.windows.lost_one();
                }
                Ok(has_room)
            }
        }
    }

    fn is_short(&mut self) -> bool {
        if self.looked.is_some_and(|at| at.elapsed() < POLL_INTERVAL) {
            return false;
        }
        self.looked = Some(Instant::now());
        free_bytes(&self.recording.folder).is_some_and(|free| free < self.recording.keep_free_bytes)
    }
}

/// Bytes: hardly enough for the operating system itself.
pub const NEARLY_FULL_BYTES: u64 = 500_000_000;

/// Bytes that may still be written to the disk of `folder`; `None` where the system cannot say.
pub fn free_bytes(folder: &std::path::Path) -> Option<u64> {
    #[cfg(unix)]
    {
        let stat = rustix::fs::statvfs(folder).ok()?;
        Some(stat.f_bavail.saturating_mul(stat.f_frsize))
    }
    #[cfg(not(unix))]
    {
        let _ = folder;
        None
    }
}
