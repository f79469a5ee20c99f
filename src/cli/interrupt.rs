//! Ctrl-C, and the signals that ask a program to end: the first finishes in order, the second ends at once.

use super::{Exit, Failure};
use std::io::Write as _;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// The flag that is set when the user, or the system, asks to end. Call once.
///
/// # Errors
/// When the system does not let the signals be handled.
pub(super) fn watch() -> Result<Arc<AtomicBool>, Failure> {
    let asked = Arc::new(AtomicBool::new(false));
    let flag = Arc::clone(&asked);
    let mut already = false;
    ctrlc::set_handler(move || {
        if std::mem::replace(&mut already, true) {
            std::process::exit(130);
        }
        flag.store(true, Ordering::Relaxed);
        // Nothing can be told when stderr is gone; the run ends all the same.
        let _ = writeln!(super::progress::stderr(), "finishing what is begun; once more to end at once");
    })
    .map_err(|e| Failure::new(Exit::Failed, format!("cannot watch for interrupts: {e}")))?;
    Ok(asked)
}
