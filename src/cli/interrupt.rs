//! Ctrl-C and other termination signals. A run with partial results finishes in order, and ends at once on a second
//! signal ([`watch`]); one without results until its end terminates at once, but not in the middle of a file
//! ([`end_at_once`]).

use super::{Exit, Failure, writing};
use std::io::Write as _;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

#[allow(
    unsafe_code,
    reason = "a declaration of C's function, which is safe to call: it ends the process and nothing else"
)]
mod c {
    unsafe extern "C" {
        /// Ends the process without destructors, which crash when run by `exit` while OpenCV's threads still work.
        pub(super) safe fn _exit(code: std::ffi::c_int) -> !;
    }
}

/// The flag that is set when the user, or the system, asks to end. Call once.
///
/// # Errors
/// When the system does not allow handling the signals.
pub(super) fn watch() -> Result<Arc<AtomicBool>, Failure> {
    let asked = Arc::new(AtomicBool::new(false));
    let flag = Arc::clone(&asked);
    let mut already = false;
    ctrlc::set_handler(move || {
        if std::mem::replace(&mut already, true) {
            c::_exit(130);
        }
        flag.store(true, Ordering::Relaxed);
        // Without stderr nothing can be printed; the run ends anyway.
        let _ = writeln!(super::progress::stderr(), "finishing; interrupt again to stop at once");
    })
    .map_err(cannot_watch)?;
    Ok(asked)
}

/// Ends the program when the user, or the system, asks: at once, or when what [`writing::wait`] asked for is over. Call once.
///
/// # Errors
/// When the system does not allow handling the signals.
pub(super) fn end_at_once() -> Result<(), Failure> {
    ctrlc::set_handler(|| {
        let _whole = writing::wait();
        // Without stderr nothing can be printed; the run ends anyway.
        let _ = writeln!(super::progress::stderr(), "interrupted");
        super::outcome::interrupted();
        c::_exit(130);
    })
    .map_err(cannot_watch)
}

fn cannot_watch(error: ctrlc::Error) -> Failure {
    Failure::new(Exit::Failed, format!("cannot watch for interrupts: {error}"))
}
