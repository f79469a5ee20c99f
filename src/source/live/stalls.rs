//! Time in which this program was stalled: stopped, or the computer slept or was too busy.
//!
//! A thread reads the clock every [`POLL_INTERVAL`]; any excess is time in which nothing here ran. Frames that queued
//! on a pipe meanwhile arrive late but are not lost. The caller may have been woken before that thread, so time that it
//! has not counted yet is added.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Weak};
use std::thread::Builder;
use std::time::{Duration, Instant};

const POLL_INTERVAL: Duration = Duration::from_millis(20);
/// Shorter stalls are ordinary delay.
const MIN_STALL: Duration = Duration::from_millis(100);

/// Watches for stalls until it is dropped.
#[derive(Debug)]
pub(super) struct Stalls {
    count: Arc<Count>,
    watched: bool,
}

#[derive(Debug)]
struct Count {
    began: Instant,
    total_ns: AtomicU64,
    /// When the thread last read the clock, since its start.
    looked_ns: AtomicU64,
}

impl Count {
    fn now_ns(&self) -> u64 {
        self.began.elapsed().as_nanos() as u64
    }

    /// Time since the thread last read the clock, beyond its sleep.
    fn late_ns(&self) -> u64 {
        let late = self.now_ns().saturating_sub(self.looked_ns.load(Ordering::Acquire));
        let late = late.saturating_sub(POLL_INTERVAL.as_nanos() as u64);
        if u128::from(late) >= MIN_STALL.as_nanos() { late } else { 0 }
    }
}

impl Stalls {
    /// Begins to watch; if no thread can be started, nothing is counted.
    pub(super) fn watch() -> Self {
        let count =
            Arc::new(Count { began: Instant::now(), total_ns: AtomicU64::new(0), looked_ns: AtomicU64::new(0) });
        let theirs: Weak<Count> = Arc::downgrade(&count);
        let watch = move || {
            while let Some(count) = theirs.upgrade() {
                let late_ns = count.late_ns();
                count.total_ns.fetch_add(late_ns, Ordering::Relaxed);
                count.looked_ns.store(count.now_ns(), Ordering::Release);
                drop(count);
                std::thread::sleep(POLL_INTERVAL);
            }
        };
        let watched = Builder::new().name("stalls".to_owned()).spawn(watch).is_ok();
        if !watched {
            tracing::debug!("no thread to watch for stalls");
        }
        Self { count, watched }
    }

    /// Total time stalled so far, nanoseconds.
    pub(super) fn total_ns(&self) -> u64 {
        if !self.watched {
            return 0;
        }
        self.count.total_ns.load(Ordering::Relaxed).saturating_add(self.count.late_ns())
    }
}
