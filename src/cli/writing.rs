//! Results that are written whole: an interrupt waits until they are.

use parking_lot::{Mutex, MutexGuard};

/// Held while results are written.
static WRITING: Mutex<()> = Mutex::new(());

/// Delays termination until the guard is dropped.
pub(super) fn wait() -> MutexGuard<'static, ()> {
    WRITING.lock()
}

/// Whether an interrupt has to wait.
#[cfg(test)]
pub(super) fn waits() -> bool {
    WRITING.is_locked()
}
