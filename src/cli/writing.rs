//! Results that are written whole: an interrupt waits until they are.

use parking_lot::{ReentrantMutex, ReentrantMutexGuard};

/// Held while results are written: for each file, and around files that belong together.
static WRITING: ReentrantMutex<()> = ReentrantMutex::new(());

/// Delays termination until the guard is dropped.
pub(super) fn wait() -> ReentrantMutexGuard<'static, ()> {
    WRITING.lock()
}

/// Whether an interrupt has to wait.
#[cfg(test)]
pub(super) fn waits() -> bool {
    WRITING.is_locked()
}
