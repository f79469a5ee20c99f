//! The thread that writes the log, the table and the report, behind a line of its own that publishers have no part in.
//!
//! The line holds rows without pictures, minutes of them. That it grows is told long before it is full; when it is,
//! rows are lost to the files (never to publishers) and counted. A sink that fails is told at once; the others go on.

use crate::estimate::Estimate;
use crate::log::schema::messages::PictureWindows;
use crate::pipeline::OpenSink;
use crate::sink::{CurrentSample, PictureCount, Sink, SinkError};
use crate::tally::Totals;
use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::thread::{Builder, JoinHandle};

/// Rows that may wait: more than two minutes at 60 Hz, some 50 MB.
pub const MAX_ROWS: usize = 8192;
/// So many that wait are warned of.
const WARN_BACKLOG: usize = MAX_ROWS / 16;

/// What is logged.
#[derive(Debug)]
pub(super) enum Entry {
    /// A frame, and the count with it when that is to be reported.
    Frame(Arc<Estimate>, Option<Totals>),
    Current(CurrentSample),
    /// What was kept of a picture, and where it is counted.
    Windows(Box<PictureWindows>, Arc<PictureCount>),
}

/// Counts that both ends of the line know.
#[derive(Debug, Default)]
pub(super) struct Backlog {
    waiting: AtomicUsize,
    unlogged_frames: AtomicU64,
    unlogged_currents: AtomicU64,
    sinks_alive: AtomicUsize,
}

impl Backlog {
    /// Rows that wait for the disk.
    pub(super) fn waiting(&self) -> usize {
        self.waiting.load(Ordering::Relaxed)
    }

    /// Frames that were not logged because the line was full.
    pub(super) fn unlogged_frames(&self) -> u64 {
        self.unlogged_frames.load(Ordering::Relaxed)
    }

    /// The same of samples of currents.
    pub(super) fn unlogged_currents(&self) -> u64 {
        self.unlogged_currents.load(Ordering::Relaxed)
    }

    fn count_unlogged(&self, entry: &Entry) {
        let count = match entry {
            Entry::Frame(..) => &self.unlogged_frames,
            Entry::Current(_) => &self.unlogged_currents,
            // The recorder counts its own.
            Entry::Windows(..) => return,
        };
        count.fetch_add(1, Ordering::Relaxed);
        if self.unlogged_frames() + self.unlogged_currents() == 1 {
            tracing::error!("the disk has been too slow for minutes: rows are being lost from now on, and counted");
        }
    }

    /// Sinks that still write.
    pub(super) fn sinks_alive(&self) -> usize {
        self.sinks_alive.load(Ordering::Relaxed)
    }
}

/// The sending end of the line.
#[derive(Debug, Clone)]
pub(super) struct Log {
    entries: SyncSender<Entry>,
    backlog: Arc<Backlog>,
}

impl Log {
    /// Starts the thread; it ends when the last sender is gone, and gives the sinks back, with what went wrong.
    pub(super) fn start(sinks: Vec<Box<dyn Sink + Send>>) -> io::Result<(Self, JoinHandle<Written>)> {
        let (entries, line) = sync_channel(MAX_ROWS);
        let backlog = Arc::new(Backlog { sinks_alive: AtomicUsize::new(sinks.len()), ..Backlog::default() });
        let shared = Arc::clone(&backlog);
        let thread = Builder::new().name("log".to_owned()).spawn(move || write_all(sinks, &line, &shared))?;
        Ok((Self { entries, backlog }, thread))
    }

    /// Puts an entry into the line; never waits. Whether there was room for it.
    pub(super) fn put(&self, entry: Entry) -> bool {
        let waiting = self.backlog.waiting.fetch_add(1, Ordering::Relaxed) + 1;
        if let Err(TrySendError::Full(entry) | TrySendError::Disconnected(entry)) = self.entries.try_send(entry) {
            self.backlog.waiting.fetch_sub(1, Ordering::Relaxed);
            self.backlog.count_unlogged(&entry);
            return false;
        }
        if waiting == WARN_BACKLOG {
            tracing::warn!(
                "the disk falls behind: {waiting} rows wait to be written, {MAX_ROWS} can; nothing is lost yet"
            );
        }
        true
    }

    pub(super) fn backlog(&self) -> Arc<Backlog> {
        Arc::clone(&self.backlog)
    }
}

/// All sinks, not yet finished, and why some have failed.
pub(super) type Written = (Vec<OpenSink>, Vec<SinkError>);

fn write_all(sinks: Vec<Box<dyn Sink + Send>>, line: &Receiver<Entry>, backlog: &Backlog) -> Written {
    let mut failures = Vec::new();
    let mut sinks: Vec<_> = sinks.into_iter().map(|sink| (sink, true)).collect();
    for entry in line {
        let mut kept = false;
        for (sink, works) in sinks.iter_mut().filter(|(_, works)| *works) {
            let written = match &entry {
                Entry::Frame(estimate, totals) => sink
                    .write(estimate, None)
                    .and_then(|()| totals.iter().try_for_each(|totals| sink.write_totals(totals))),
                Entry::Current(sample) => sink.write_current(sample),
                Entry::Windows(windows, _) => sink.write_windows(windows).map(|takes| kept |= takes),
            };
            if let Err(error) = written {
                *works = false;
                backlog.sinks_alive.fetch_sub(1, Ordering::Relaxed);
                tracing::error!("{error}; what was written before is kept, the rest of the run continues");
                failures.push(error);
            }
        }
        if let Entry::Windows(_, count) = &entry {
            if kept { count.add_recorded() } else { count.add_dropped() }
        }
        backlog.waiting.fetch_sub(1, Ordering::Relaxed);
    }
    (sinks, failures)
}
