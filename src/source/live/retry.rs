//! Trying again until a source is back.

use super::super::SourceError;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// Time between two attempts.
const RETRY: Duration = Duration::from_secs(1);

/// Tries to open the `what` called `name` once a second until that succeeds; `None` when asked to stop.
pub(super) fn until_back<T>(
    name: &str,
    what: &str,
    stop: &AtomicBool,
    mut open: impl FnMut() -> Result<T, SourceError>,
) -> Option<T> {
    let lost = Instant::now();
    loop {
        let next_try = Instant::now() + RETRY;
        while Instant::now() < next_try {
            if stop.load(Ordering::Relaxed) {
                return None;
            }
            std::thread::sleep(Duration::from_millis(20));
        }
        match open() {
            Ok(opened) => {
                tracing::warn!("{name}: the {what} is back after {:.0} s", lost.elapsed().as_secs_f64());
                return Some(opened);
            }
            Err(error) => tracing::debug!("{error}"),
        }
    }
}
