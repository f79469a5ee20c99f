//! Ctrl-C, and the signals that ask a program to end. A run that has results on the way finishes in order, and ends at
//! once when asked again ([`watch`]); one that has none until its end ends at once, but not in the middle of a file
//! ([`end_at_once`]).

use super::{Exit, Failure};
use std::io::Write as _;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

#[allow(
    unsafe_code,
    reason = "a declaration of C's function, which is safe to call: it ends the process and nothing else"
)]
mod c {
    unsafe extern "C" {
        /// Ends the process with what it holds: destructors, run by `exit` while OpenCV's threads still work, crash.
        pub(super) safe fn _exit(code: std::ffi::c_int) -> !;
    }
}

/// Held while results are written.
static WRITING: Mutex<()> = Mutex::new(());

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
            c::_exit(130);
        }
        flag.store(true, Ordering::Relaxed);
        // Nothing can be told when stderr is gone; the run ends all the same.
        let _ = writeln!(super::progress::stderr(), "finishing what is begun; once more to end at once");
    })
    .map_err(cannot_watch)?;
    Ok(asked)
}

/// Ends the program when the user, or the system, asks: at once, or when what [`wait`] asked for is over. Call once.
///
/// # Errors
/// When the system does not let the signals be handled.
pub(super) fn end_at_once() -> Result<(), Failure> {
    ctrlc::set_handler(|| {
        let _whole = wait();
        // Nothing can be told when stderr is gone; the run ends all the same.
        let _ = writeln!(super::progress::stderr(), "interrupted");
        c::_exit(130);
    })
    .map_err(cannot_watch)
}

/// Puts the end off until what it gives is dropped.
pub(super) fn wait() -> MutexGuard<'static, ()> {
    WRITING.lock().unwrap_or_else(PoisonError::into_inner)
}

fn cannot_watch(error: ctrlc::Error) -> Failure {
    Failure::new(Exit::Failed, format!("cannot watch for interrupts: {error}"))
}
