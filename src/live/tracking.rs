//! The thread that tracks: θ goes to controllers first, rows to all others, and then the tracker learns.
//!
//! When it falls behind it goes to the newest frame; those passed over keep their rows.

use super::REPORT_INTERVAL;
use super::latest::Latest;
use super::pictures::Pictures;
use super::priority::{Urgency, run_as};
use super::queue::{Next, Queue};
use super::status::Counters;
use super::subscribers::Subscribers;
use super::writer::{Entry, Log};
use crate::estimate::{Estimate, Miss};
use crate::pipeline::{End, OpenSink};
use crate::sink::SinkError;
use crate::source::{Picture, Timestamp};
use crate::track::{TrackError, Tracker};
use std::io;
use std::sync::Arc;
use std::thread::{Builder, JoinHandle};
use std::time::{Duration, Instant};
use tracing::Span;

/// A tracker that fell behind is urgent again when it has passed over no frame for so long.
const RECOVERY: Duration = Duration::from_secs(5);

/// Where the tracker's rows go.
pub(super) struct RowOutputs {
    pub(super) controllers: Vec<OpenSink>,
    pub(super) subscribers: Vec<Subscribers>,
    pub(super) log: Log,
    pub(super) counters: Arc<Counters>,
    pub(super) pictures: Option<Pictures>,
    pub(super) latest: Option<Arc<Latest>>,
}

impl RowOutputs {
    pub(super) fn report(error: &SinkError) {
        tracing::error!("{error}; this controller receives nothing from now on; logging continues");
    }

    /// Controllers first: they wait for it.
    fn put(&mut self, estimate: Estimate, tracked: bool) -> Arc<Estimate> {
        for (controller, works) in self.controllers.iter_mut().filter(|(_, works)| *works) {
            if let Err(error) = controller.write(&estimate, None) {
                *works = false;
                Self::report(&error);
            }
        }
        let estimate = Arc::new(estimate);
        let totals = self.counters.add(&estimate, tracked);
        self.subscribers.iter().for_each(|line| line.put(&estimate, totals.clone()));
        self.log.put(Entry::Frame(Arc::clone(&estimate), totals));
        estimate
    }

    /// A frame that was tracked, once nothing more is read from its picture; of one that was not, only its row.
    fn show(&mut self, estimate: Arc<Estimate>, picture: Option<Picture>) {
        let picture = picture.map(Arc::new);
        if let Some(latest) = &self.latest {
            latest.put(&estimate, picture.as_ref());
        }
        if let (Some(pictures), Some(picture)) = (&mut self.pictures, picture) {
            pictures.put(estimate, picture);
        }
    }

    fn put_untracked(&mut self, row: Estimate) {
        let row = self.put(row, false);
        self.show(row, None);
    }
}

/// Tracks until the queue is closed; the thread returns why it ended early, if it did, and the controllers. Its
/// warnings belong to the caller's span.
pub(super) fn start_tracker(
    mut tracker: Tracker,
    pool: rayon::ThreadPool,
    queue: Arc<Queue>,
    mut out: RowOutputs,
) -> io::Result<JoinHandle<(Option<End>, Vec<OpenSink>)>> {
    let span = Span::current();
    Builder::new().name("tracker".to_owned()).spawn(move || {
        let end = pool.install(|| span.in_scope(|| track_all(&mut tracker, &queue, &mut out)));
        (end, out.controllers)
    })
}

/// Tracks all frames; why it ended early, if it did.
fn track_all(tracker: &mut Tracker, queue: &Queue, out: &mut RowOutputs) -> Option<End> {
    let all_run_as = |urgency: Urgency| {
        rayon::broadcast(|_| run_as(urgency));
    };
    all_run_as(Urgency::Tracker);
    let mut fell_behind: Option<Instant> = None;
    loop {
        let (skipped, frame) = match queue.next(REPORT_INTERVAL) {
            Next::Frames(skipped, frame) => (skipped, frame),
            Next::Silence => continue,
            Next::Closed => return None,
        };
        if !skipped.is_empty() {
            // Whatever else runs must not starve meanwhile: the log, and the system.
            if fell_behind.replace(Instant::now()).is_none() {
                all_run_as(Urgency::Soon);
            }
        } else if fell_behind.is_some_and(|since| since.elapsed() > RECOVERY) {
            fell_behind = None;
            all_run_as(Urgency::Tracker);
        }
        skipped.into_iter().for_each(|row| out.put_untracked(row));
        let Some(frame) = frame else { continue };
        match tracker.measure(&frame) {
            Ok((estimate, measured)) => {
                let estimate = out.put(estimate, true);
                tracker.learn(&frame, measured);
                out.show(estimate, Some(frame.picture));
            }
            Err(TrackError::Size { found, .. }) => {
                out.put_untracked(Estimate::missed(&frame, tracker.rig(), &Miss::WrongSize { found }));
            }
            Err(error) => {
                let (seq, stamp): (u64, Timestamp) = (frame.seq, frame.stamp);
                return Some(End::Track { seq, stamp, error });
            }
        }
        while let Some(warning) = tracker.warning() {
            tracing::warn!("{warning}");
            out.counters.warn(warning);
        }
    }
}
