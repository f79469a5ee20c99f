//! A progress bar on stderr, and a stderr writer that does not collide with it.

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use parking_lot::Mutex;
use std::io::{self, IsTerminal as _, Write};
use std::time::{Duration, Instant};

/// Shorter work shows no bar.
const SHOW_AFTER: Duration = Duration::from_secs(1);

/// Shorter work prints nothing without a terminal.
const PRINT_AFTER: Duration = Duration::from_secs(10);

/// The bar that is on the screen.
static SHOWN: Mutex<Option<ProgressBar>> = Mutex::new(None);

/// Progress in frames or pictures. Dropping it removes the bar.
pub(super) struct Progress {
    bar: ProgressBar,
    began: Instant,
    shown: Shown,
}

#[derive(PartialEq, Eq)]
enum Shown {
    Never,
    NotYet,
    Now,
}

impl Progress {
    /// Progress over `total` frames, if known. Shown only on a terminal, and not when `quiet`.
    pub(super) fn of_frames(total: Option<u64>, quiet: bool) -> Self {
        Self::of(total, "frames", quiet)
    }

    /// As [`Progress::of_frames`], for other items.
    pub(super) fn of(total: Option<u64>, things: &str, quiet: bool) -> Self {
        let bar = ProgressBar::with_draw_target(total, ProgressDrawTarget::hidden());
        let template = match total {
            Some(_) => format!("{{bar:30}} {{pos}} of {{len}} {things}, {{per_sec}} per second, {{eta}} to go"),
            None => format!("{{spinner}} {{pos}} {things}, {{per_sec}} per second"),
        };
        if let Ok(style) = ProgressStyle::with_template(&template) {
            let per_second = |state: &indicatif::ProgressState, out: &mut dyn std::fmt::Write| {
                // A bar that cannot be drawn is not worth an error.
                let _ = write!(out, "{:.0}", state.per_sec());
            };
            bar.set_style(style.with_key("per_sec", per_second));
        }
        let shown = if quiet || !io::stderr().is_terminal() { Shown::Never } else { Shown::NotYet };
        Self { bar, began: Instant::now(), shown }
    }

    /// One more item is done.
    pub(super) fn one_more(&mut self) {
        self.at(self.bar.position() + 1);
    }

    /// This many are done.
    pub(super) fn at(&mut self, frames: u64) {
        // Lengths from containers are sometimes guesses.
        if self.bar.length().is_some_and(|total| frames > total) {
            self.bar.set_length(frames);
        }
        self.bar.set_position(frames);
        if self.shown == Shown::NotYet && self.began.elapsed() > SHOW_AFTER {
            self.shown = Shown::Now;
            self.bar.set_draw_target(ProgressDrawTarget::stderr());
            *SHOWN.lock() = Some(self.bar.clone());
        }
    }
}

/// A line of text that changes in place, only on a terminal. Dropping it removes the line.
pub(super) struct Line(Option<ProgressBar>);

impl Line {
    /// Shows nothing when `quiet`.
    pub(super) fn new(quiet: bool) -> Self {
        if quiet || !io::stderr().is_terminal() {
            return Self(None);
        }
        let bar = ProgressBar::with_draw_target(None, ProgressDrawTarget::stderr());
        if let Ok(style) = ProgressStyle::with_template("{msg}") {
            bar.set_style(style);
        }
        *SHOWN.lock() = Some(bar.clone());
        Self(Some(bar))
    }

    fn is_shown(&self) -> bool {
        self.0.is_some()
    }

    /// Shows `text`.
    pub(super) fn set(&self, text: String) {
        if let Some(bar) = &self.0 {
            bar.set_message(text);
        }
    }
}

/// Shows `what` on a terminal while the work is running.
pub(super) fn during<T>(what: &str, quiet: bool, work: impl FnOnce() -> T) -> T {
    let line = Line::new(quiet);
    line.set(format!("{what} …"));
    work()
}

/// Stages of unknown duration: on a terminal, a line shows the current one; elsewhere a line is printed when a stage
/// begins after a while.
pub(super) struct Stages {
    line: Line,
    began: Instant,
    quiet: bool,
}

impl Stages {
    /// Shows nothing when `quiet`.
    pub(super) fn new(quiet: bool) -> Self {
        Self { line: Line::new(quiet), began: Instant::now(), quiet }
    }

    /// A stage begins.
    pub(super) fn begin(&self, what: &str) {
        self.line.set(format!("{what} …"));
        let elapsed = self.began.elapsed();
        if !self.quiet && !self.line.is_shown() && elapsed > PRINT_AFTER {
            // A failure to print is not worth an error.
            let _ = writeln!(stderr(), "{:.0} s: {what}", elapsed.as_secs_f64());
        }
    }
}

impl Drop for Line {
    fn drop(&mut self) {
        if let Some(bar) = &self.0 {
            bar.finish_and_clear();
            *SHOWN.lock() = None;
        }
    }
}

impl Drop for Progress {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
        if self.shown == Shown::Now {
            *SHOWN.lock() = None;
        }
    }
}

/// Stderr that hides the bar while writing.
pub(super) fn stderr() -> impl Write {
    Stderr
}

struct Stderr;

impl Write for Stderr {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let write = || io::stderr().lock().write_all(bytes).map(|()| bytes.len());
        match &*SHOWN.lock() {
            Some(bar) => bar.suspend(write),
            None => write(),
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        io::stderr().flush()
    }
}
