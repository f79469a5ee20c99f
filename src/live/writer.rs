//! The thread that writes the log, the table and the report, behind a line of its own that publishers have no part in.
//!
//! The line holds rows without pictures, minutes of them. That it grows is told long before it is full; when it is,
//! rows are lost to the files (never to publishers) and counted. Currents may fill half of it, so that they never take
//! the place of frames. A sink that fails is told at once; the others go on.

use crate::estimate::Estimate;
use crate::log::schema::messages::PictureWindows;
use crate::pipeline::OpenSink;
use crate::sink::{CurrentSample, PictureCount, Sink, SinkError};
use crate::tally::Totals;
use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::thread::{Builder, JoinHandle};

/// Rows that may wait: more than two minutes at 60 Hz, some 50 MB.
pub const MAX_ROWS: usize = 8192;
/// Rows that wait when a sample of currents is put into the line.
const MAX_ROWS_BEFORE_CURRENT: usize = MAX_ROWS / 2;
/// A warning is given when this many wait.
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
    /// Whether it was said that many rows wait, and that some are lost.
    said_waiting: AtomicBool,
    said_lost: AtomicBool,
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
        if !self.said_lost.swap(true, Ordering::Relaxed) {
            tracing::error!(
                "the log cannot keep up: {} rows wait to be written; rows are being lost from now on, and counted",
                self.waiting()
            );
        }
    }

    /// Sinks that still write each row as it comes.
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
        let at_once = sinks.iter().filter(|sink| sink.writes_at_once()).count();
        // Of pages alone none can fail before the end.
        let at_once = if at_once == 0 { sinks.len() } else { at_once };
        let backlog = Arc::new(Backlog { sinks_alive: AtomicUsize::new(at_once), ..Backlog::default() });
        let shared = Arc::clone(&backlog);
        let thread = Builder::new().name("log".to_owned()).spawn(move || write_all(sinks, &line, &shared))?;
        Ok((Self { entries, backlog }, thread))
    }

    /// Puts an entry into the line; never waits. Whether there was room for it.
    pub(super) fn put(&self, entry: Entry) -> bool {
        if matches!(entry, Entry::Current(_)) && !self.has_room_for_current() {
            self.backlog.count_unlogged(&entry);
            return false;
        }
        let waiting = self.backlog.waiting.fetch_add(1, Ordering::Relaxed) + 1;
        if let Err(TrySendError::Full(entry) | TrySendError::Disconnected(entry)) = self.entries.try_send(entry) {
            self.backlog.waiting.fetch_sub(1, Ordering::Relaxed);
            self.backlog.count_unlogged(&entry);
            return false;
        }
        if waiting >= WARN_BACKLOG && !self.backlog.said_waiting.swap(true, Ordering::Relaxed) {
            tracing::warn!(
                "the log falls behind: {waiting} rows wait to be written, {MAX_ROWS} can; nothing is lost yet"
            );
        }
        true
    }

    /// Whether a sample of currents would be taken.
    pub(super) fn has_room_for_current(&self) -> bool {
        self.backlog.waiting() < MAX_ROWS_BEFORE_CURRENT
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
                backlog.sinks_alive.fetch_sub(usize::from(sink.writes_at_once()), Ordering::Relaxed);
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tally::Tally;
    use crate::testing::fixture;
    use parking_lot::Mutex;

    /// Writes once it may, and counts frames and currents.
    struct Slow(Arc<Mutex<[usize; 2]>>);

    impl Sink for Slow {
        fn write(&mut self, _: &Estimate, _: Option<&crate::source::Picture>) -> Result<(), SinkError> {
            self.0.lock()[0] += 1;
            Ok(())
        }

        fn write_current(&mut self, _: &CurrentSample) -> Result<(), SinkError> {
            self.0.lock()[1] += 1;
            Ok(())
        }

        fn finish(&mut self, _: &Tally) -> Result<(), SinkError> {
            Ok(())
        }
    }

    #[test]
    fn currents_do_not_take_the_place_of_frames() {
        let written = Arc::new(Mutex::new([0; 2]));
        let disk = written.lock();
        let (log, thread) = Log::start(vec![Box::new(Slow(Arc::clone(&written)))]).unwrap();
        let current = || Entry::Current(CurrentSample { host_ns: 0, arrival_ns: 0, seq: None, current_a: vec![0.0] });
        let taken = (0..2 * MAX_ROWS).filter(|_| log.put(current())).count();
        let frames = MAX_ROWS / 3;
        assert!((0..frames as u64).all(|k| log.put(Entry::Frame(Arc::new(fixture::complete(k, k as i64)), None))));
        let backlog = log.backlog();
        assert_eq!((backlog.unlogged_frames(), backlog.unlogged_currents()), (0, (2 * MAX_ROWS - taken) as u64));
        drop((disk, log));
        thread.join().unwrap();
        assert_eq!(*written.lock(), [frames, taken]);
        assert!((MAX_ROWS_BEFORE_CURRENT..=MAX_ROWS_BEFORE_CURRENT + 1).contains(&taken), "{taken}");
    }
}
