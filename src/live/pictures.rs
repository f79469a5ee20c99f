//! The thread that records pictures: the first to give way when anything is short.
//!
//! Few pictures wait for it; what does not fit is dropped and counted, and no estimate ever waits. Windows go into the
//! log, but only while the log's own line is short. When the disk has less free space than is to be kept for the log,
//! or the video cannot be written, no more pictures are recorded, which is told once; the estimates go on.

use super::priority::{Urgency, run_as};
use super::writer::{Backlog, Entry, Log};
use crate::estimate::Estimate;
use crate::sink::{PictureCount, Sink, SinkError, WindowRecorder};
use crate::source::Picture;
use crate::tally::Tally;
use std::io;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::thread::{Builder, JoinHandle};
use std::time::{Duration, Instant};

/// Pictures that may wait for the recorder.
pub const MOST_PICTURES: usize = 16;
/// Rows that may wait for the disk while windows are added to them.
const MOST_ROWS_BEFORE: usize = 64;
/// How often the disk is looked at.
const LOOK: Duration = Duration::from_millis(200);

/// What is recorded of the pictures.
pub struct Recording {
    /// Where they go.
    pub to: RecordTo,
    /// Counts them.
    pub count: Arc<PictureCount>,
    /// The folder whose disk is watched.
    pub folder: PathBuf,
    /// Free space below which no more pictures are recorded, bytes: it is the log's.
    pub keep_free_bytes: u64,
}

/// Where pictures go.
pub enum RecordTo {
    /// The parts the tracker looked at, into the log.
    Log,
    /// Whole, to this sink.
    Video(Box<dyn Sink + Send>),
}

/// A picture on its way.
struct Taken {
    estimate: Arc<Estimate>,
    picture: Arc<Picture>,
    /// Pictures before it were dropped.
    after_loss: bool,
}

/// The near end of the line.
pub(super) struct Pictures {
    line: SyncSender<Taken>,
    count: Arc<PictureCount>,
    lost: bool,
}

impl Pictures {
    /// Starts the thread; it ends, with what went wrong, when the near end is gone.
    pub(super) fn start(recording: Recording, log: Log) -> io::Result<(Self, JoinHandle<Option<SinkError>>)> {
        let (line, taken) = sync_channel(MOST_PICTURES);
        let count = Arc::clone(&recording.count);
        let thread = Builder::new().name("pictures".to_owned()).spawn(move || {
            let backlog = log.backlog();
            let windows = WindowRecorder::default();
            Recorder { recording, log, backlog, windows, looked: None, stopped: false }.run(&taken)
        })?;
        Ok((Self { line, count, lost: false }, thread))
    }

    /// Hands a picture that was tracked to the recorder; never waits.
    pub(super) fn put(&mut self, estimate: Arc<Estimate>, picture: Arc<Picture>) {
        let taken = Taken { estimate, picture, after_loss: self.lost };
        self.lost = match self.line.try_send(taken) {
            Ok(()) => false,
            Err(TrySendError::Full(_) | TrySendError::Disconnected(_)) => {
                self.count.add_dropped();
                true
            }
        };
    }
}

struct Recorder {
    recording: Recording,
    log: Log,
    backlog: Arc<Backlog>,
    windows: WindowRecorder,
    /// When the disk was looked at.
    looked: Option<Instant>,
    stopped: bool,
}

impl Recorder {
    fn run(mut self, line: &Receiver<Taken>) -> Option<SinkError> {
        let mut failure = None;
        // The first picture and what its file begins with are soon on the disk, whatever else wants the processor.
        run_as(Urgency::Tracker);
        let mut first = true;
        for taken in line {
            if !self.stopped && self.is_short() {
                self.stopped = true;
                tracing::warn!(
                    "{}: less than {:.1} GB are free: no more pictures are recorded, the log goes on",
                    self.recording.folder.display(),
                    self.recording.keep_free_bytes as f64 * 1e-9
                );
            }
            let recorded = if self.stopped { Ok(false) } else { self.record(&taken) };
            match recorded {
                Ok(true) if first => {
                    first = false;
                    run_as(Urgency::Pictures);
                }
                Ok(true) => {}
                Ok(false) => self.recording.count.add_dropped(),
                Err(error) => {
                    self.recording.count.add_dropped();
                    self.stopped = true;
                    tracing::error!("{error}; no more pictures are recorded, the rest of the run goes on");
                    failure = Some(error);
                }
            }
        }
        let ended = match &mut self.recording.to {
            // A video has no place for counts.
            RecordTo::Video(video) => video.finish(&Tally::default()),
            RecordTo::Log => Ok(()),
        };
        // What a failed video says at its end follows from why it failed.
        failure.or(ended.err())
    }

    /// Whether it could be handed on; if not, nothing is wrong, but the disk is too slow.
    fn record(&mut self, taken: &Taken) -> Result<bool, SinkError> {
        match &mut self.recording.to {
            RecordTo::Video(video) => {
                video.write(&taken.estimate, Some(taken.picture.as_ref()))?;
                self.recording.count.add_recorded();
                Ok(true)
            }
            RecordTo::Log => {
                if taken.after_loss {
                    self.windows.lost_one();
                }
                if self.backlog.waiting() > MOST_ROWS_BEFORE {
                    self.windows.lost_one();
                    return Ok(false);
                }
                let kept = self.windows.keep(&taken.estimate, &taken.picture)?;
                // Counted when it is written.
                self.log.put(Entry::Windows(Box::new(kept), Arc::clone(&self.recording.count)));
                Ok(true)
            }
        }
    }

    fn is_short(&mut self) -> bool {
        if self.looked.is_some_and(|at| at.elapsed() < LOOK) {
            return false;
        }
        self.looked = Some(Instant::now());
        free_bytes(&self.recording.folder).is_some_and(|free| free < self.recording.keep_free_bytes)
    }
}

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
