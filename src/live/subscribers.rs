//! Subscribers: each sink of them is served by a thread of its own, and misses rows rather than hold up the tracker.

use crate::estimate::Estimate;
use crate::sink::{CurrentSample, Sink, SinkError};
use crate::tally::Totals;
use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{SyncSender, TrySendError, sync_channel};
use std::thread::{Builder, JoinHandle};

/// Rows that may wait for subscribers.
const MAX_PUBLISHED: usize = 64;

/// The thread that serves a sink; it gives it back at the end, unless that has failed.
pub(super) type Publisher = JoinHandle<Option<Box<dyn Sink + Send>>>;

/// The line to a sink for subscribers.
#[derive(Clone)]
pub(super) struct Subscribers {
    line: SyncSender<Published>,
    missed: Arc<AtomicU64>,
}

/// What subscribers are told.
enum Published {
    Frame(Arc<Estimate>, Option<Totals>),
    Current(CurrentSample),
}

impl Subscribers {
    /// Starts the thread; it gives the sink back at the end, unless that has failed.
    pub(super) fn start(mut sink: Box<dyn Sink + Send>) -> io::Result<(Self, Publisher)> {
        let (line, rows) = sync_channel::<Published>(MAX_PUBLISHED);
        let thread = Builder::new().name("publisher".to_owned()).spawn(move || {
            let failed = rows.iter().find_map(|published| {
                let written = match published {
                    Published::Frame(row, totals) => sink
                        .write(&row, None)
                        .and_then(|()| totals.iter().try_for_each(|totals| sink.write_totals(totals))),
                    Published::Current(sample) => sink.write_current(&sample),
                };
                written.err()
            });
            match failed {
                Some(error) => {
                    Self::report(&error);
                    None
                }
                None => Some(sink),
            }
        })?;
        Ok((Self { line, missed: Arc::default() }, thread))
    }

    pub(super) fn report(error: &SinkError) {
        tracing::error!("{error}; subscribers receive nothing from now on; logging continues");
    }

    pub(super) fn put(&self, estimate: &Arc<Estimate>, totals: Option<Totals>) {
        if let Err(TrySendError::Full(_)) = self.line.try_send(Published::Frame(Arc::clone(estimate), totals)) {
            self.missed.fetch_add(1, Ordering::Relaxed);
        }
    }

    /// Currents give way to frames; the log has them.
    pub(super) fn put_current(&self, sample: &CurrentSample) {
        let _ = self.line.try_send(Published::Current(sample.clone()));
    }

    /// Counts the rows that they were not given. A counter must not hold the line: its thread would never end.
    pub(super) fn missed(&self) -> Arc<AtomicU64> {
        Arc::clone(&self.missed)
    }
}
