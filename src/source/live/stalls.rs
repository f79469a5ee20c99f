//! Time in which this program itself stood still: it was stopped, or the computer slept or was too busy.
//!
//! A thread looks at the clock every [`TICK`]; what passes beyond is time in which nothing here ran. Frames that wait on a
//! pipe meanwhile arrive late, and are not lost.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Weak};
use std::thread::Builder;
use std::time::{Duration, Instant};

const TICK: Duration = Duration::from_millis(20);
/// Less is ordinary delay.
const WORTH_COUNTING: Duration = Duration::from_millis(100);

/// Watches as long as it lives.
#[derive(Debug, Default)]
pub(super) struct Stalls(Arc<AtomicU64>);

impl Stalls {
    /// Begins to watch; without a thread for it nothing is ever counted.
    pub(super) fn watch() -> Self {
        let total = Arc::new(AtomicU64::new(0));
        let watched: Weak<AtomicU64> = Arc::downgrade(&total);
        let watch = move || {
            let mut last = Instant::now();
            while let Some(total) = watched.upgrade() {
                let late = last.elapsed().saturating_sub(TICK);
                last = Instant::now();
                if late >= WORTH_COUNTING {
                    total.fetch_add(late.as_nanos() as u64, Ordering::Relaxed);
                }
                drop(total);
                std::thread::sleep(TICK);
            }
        };
        if Builder::new().name("stalls".to_owned()).spawn(watch).is_err() {
            tracing::debug!("no thread to watch for stalls");
        }
        Self(total)
    }

    /// How long it has stood still so far, nanoseconds.
    pub(super) fn total_ns(&self) -> u64 {
        self.0.load(Ordering::Relaxed)
    }
}
