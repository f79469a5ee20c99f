//! The command `catoptra`: arguments in, exit code out.

fn main() -> std::process::ExitCode {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    {
        give_back_pictures();
        fail_at_limits_of_files();
    }
    catoptra::cli::run()
}

/// Freed pictures go back to the system at once. Left alone, glibc raises its limit for that with the first one that is
/// freed, later ones lie between small blocks, and memory grows with the length of a recording.
#[cfg(all(target_os = "linux", target_env = "gnu"))]
#[allow(unsafe_code, reason = "no safe binding to the setting")]
fn give_back_pictures() {
    const BYTES: libc::c_int = 1 << 20;
    // SAFETY: a setting of the allocator, with a valid value, before there is a second thread.
    unsafe { libc::mallopt(libc::M_MMAP_THRESHOLD, BYTES) };
}

/// A file that may not grow (`ulimit -f`, a quota of the scheduler) gives an error as a full disk does, and the run is
/// concluded; the signal that comes with it would kill the process.
#[cfg(all(target_os = "linux", target_env = "gnu"))]
#[allow(unsafe_code, reason = "no safe binding to ignoring a signal")]
fn fail_at_limits_of_files() {
    // SAFETY: no handler is installed, the signal is ignored; before there is a second thread.
    unsafe { libc::signal(libc::SIGXFSZ, libc::SIG_IGN) };
}
