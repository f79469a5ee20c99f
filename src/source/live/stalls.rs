//! Time in which this program itself stood still: it was stopped, or the computer slept or was too busy.
//!
//! A thread looks at the clock every [`TICK`]; what passes beyond is time in which nothing here ran. Frames that wait
//! on a pipe meanwhile arrive late, and are not lost. Who asks may have been woken before that thread: what it has not
//! counted yet counts too.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Weak};
use std::thread::Builder;
use std::time::{Duration, Instant};

const TICK: Duration = Duration::from_millis(20);
/// Less is ordinary delay.
const WORTH_COUNTING: Duration = Duration::from_millis(100);

/// Watches as long as it lives.
#[derive(Debug)]
pub(super) struct Stalls {
    count: Arc<Count>,
    watched: bool,
}

#[derive(Debug)]
struct Count {
    began: Instant,
    total_ns: AtomicU64,
    /// When the thread last looked, since it began.
    looked_ns: AtomicU64,
}

impl Count {
    fn now_ns(&self) -> u64 {
        self.began.elapsed().as_nanos() as u64
    }

    /// What has passed since the thread last looked, beyond what it sleeps.
    fn late_ns(&self) -> u64 {
        let late = self.now_ns().saturating_sub(self.looked_ns.load(Ordering::Acquire));
        let late = late.saturating_sub(TICK.as_nanos() as u64);
        if u128::from(late) >= WORTH_COUNTING.as_nanos() { late } else { 0 }
    }
}

impl Stalls {
    /// Begins to watch; without a thread for it nothing is ever counted.
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
                std::thread::sleep(TICK);
            }
        };
        let watched = Builder::new().name("stalls".to_owned()).spawn(watch).is_ok();
        if !watched {
            tracing::debug!("no thread to watch for stalls");
        }
        Self { count, watched }
    }

    /// How long it has stood still so far, nanoseconds.
    pub(super) fn total_ns(&self) -> u64 {
        if !self.watched {
            return 0;
        }
        self.count.total_ns.load(Ordering::Relaxed).saturating_add(self.count.late_ns())
    }
}
