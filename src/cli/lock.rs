//! A lock on a file or folder against other processes of this program.

use super::{Exit, Failure};
use std::fs::File;
use std::io;
use std::path::Path;

/// A lock.
#[derive(Debug)]
#[must_use = "it is held as long as this lives"]
pub(in crate::cli) struct Lock(
    #[cfg(unix)]
    #[allow(dead_code, reason = "dropping it releases the lock")]
    Option<File>,
);

impl Lock {
    /// On what is at `path`; `busy` says what another process is doing with it. Two would write into each other's
    /// files, or the second lose what the first has found: one that a scheduler has abandoned may still be running.
    ///
    /// # Errors
    /// [`Exit::Failed`] when another process holds it.
    #[cfg(unix)]
    pub(in crate::cli) fn take(path: &Path, busy: &str) -> Result<Self, Failure> {
        use rustix::fs::{FlockOperation, flock};
        let Ok(open) = File::open(path) else { return Ok(Self(None)) };
        match flock(&open, FlockOperation::NonBlockingLockExclusive) {
            Ok(()) => Ok(Self(Some(open))),
            Err(error) if error == rustix::io::Errno::WOULDBLOCK => {
                let text = format!("{}: another process {busy}", path.display());
                Err(Failure::because(Exit::Failed, text, io::Error::from(error)))
            }
            // Not supported by all file systems.
            Err(_) => Ok(Self(None)),
        }
    }

    #[cfg(not(unix))]
    pub(in crate::cli) fn take(_: &Path, _: &str) -> Result<Self, Failure> {
        Ok(Self())
    }
}

/// What a process does with a folder of results.
pub(in crate::cli) const WRITES_RESULTS: &str = "is writing results there";

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    #[cfg(unix)]
    fn a_lock_is_free_again_when_it_is_gone() {
        let file = tempfile::NamedTempFile::new().unwrap();
        let held = Lock::take(file.path(), "works on it").unwrap();
        let refused = Lock::take(file.path(), "works on it").unwrap_err();
        assert!(refused.to_string().contains(": another process works on it"), "{refused}");
        drop(held);
        // Programs that other tests start hold it too, until they run.
        let again = || std::thread::sleep(std::time::Duration::from_millis(20));
        assert!((0..250).any(|_| Lock::take(file.path(), "works on it").map_err(|_| again()).is_ok()));
        Lock::take(Path::new("/no such file"), "works on it").map(drop).unwrap();
    }
}
