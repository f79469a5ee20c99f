//! A progress bar on stderr, and a stderr whose lines do not run into it.

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::io::{self, IsTerminal as _, Write};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Work that is done sooner shows no bar.
const PATIENCE: Duration = Duration::from_secs(1);

/// Work that is done sooner says nothing where there is no terminal.
const UNSEEN_PATIENCE: Duration = Duration::from_secs(10);

/// The bar that is on the screen.
static SHOWN: Mutex<Option<ProgressBar>> = Mutex::new(None);

/// A count of frames or pictures on its way. The bar is gone when it is dropped.
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
    /// Of `total` frames, if that is known. Shown on a terminal only, and not when `quiet`.
    pub(super) fn of_frames(total: Option<u64>, quiet: bool) -> Self {
        Self::of(total, "frames", quiet)
    }

    /// As [`Progress::of_frames`], of other things.
    pub(super) fn of(total: Option<u64>, things: &str, quiet: bool) -> Self {
        let bar = ProgressBar::with_draw_target(total, ProgressDrawTarget::hidden());
        let template = match total {
            Some(_) => format!("{{bar:30}} {{pos}} of {{len}} {things}, {{per_sec}} a second, {{eta}} to go"),
            None => format!("{{spinner}} {{pos}} {things}, {{per_sec}} a second"),
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

    /// One more is done.
    pub(super) fn one_more(&mut self) {
        self.at(self.bar.position() + 1);
    }

    /// So many are done.
    pub(super) fn at(&mut self, frames: u64) {
        // Containers' lengths are guesses at times.
        if self.bar.length().is_some_and(|total| frames > total) {
            self.bar.set_length(frames);
        }
        self.bar.set_position(frames);
        if self.shown == Shown::NotYet && self.began.elapsed() > PATIENCE {
            self.shown = Shown::Now;
            self.bar.set_draw_target(ProgressDrawTarget::stderr());
            *lock() = Some(self.bar.clone());
        }
    }
}

/// A line of text that changes in place, on a terminal only. It is gone when it is dropped.
pub(super) struct Line(Option<ProgressBar>);

impl Line {
    /// None when `quiet`.
    pub(super) fn new(quiet: bool) -> Self {
        if quiet || !io::stderr().is_terminal() {
            return Self(None);
        }
        let bar = ProgressBar::with_draw_target(None, ProgressDrawTarget::stderr());
        if let Ok(style) = ProgressStyle::with_template("{msg}") {
            bar.set_style(style);
        }
        *lock() = Some(bar.clone());
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

/// Says `what` is being done, on a terminal, while it is.
pub(super) fn during<T>(what: &str, quiet: bool, work: impl FnOnce() -> T) -> T {
    let line = Line::new(quiet);
    line.set(format!("{what} …"));
    work()
}

/// Stages of a work of which it is not known how long they take: what is being done, in a line of its own on a
/// terminal; elsewhere a line when a stage begins and it has taken a while already.
pub(super) struct Stages {
    line: Line,
    began: Instant,
    quiet: bool,
}

impl Stages {
    /// None when `quiet`.
    pub(super) fn new(quiet: bool) -> Self {
        Self { line: Line::new(quiet), began: Instant::now(), quiet }
    }

    /// A stage begins.
    pub(super) fn tell(&self, what: &str) {
        self.line.set(format!("{what} …"));
        let elapsed = self.began.elapsed();
        if !self.quiet && !self.line.is_shown() && elapsed > UNSEEN_PATIENCE {
            // What cannot be told is not worth an error.
            let _ = writeln!(stderr(), "{:.0} s: {what}", elapsed.as_secs_f64());
        }
    }
}

impl Drop for Line {
    fn drop(&mut self) {
        if let Some(bar) = &self.0 {
            bar.finish_and_clear();
            *lock() = None;
        }
    }
}

impl Drop for Progress {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
        if self.shown == Shown::Now {
            *lock() = None;
        }
    }
}

fn lock() -> std::sync::MutexGuard<'static, Option<ProgressBar>> {
    SHOWN.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Stderr that takes a bar away while it writes, and puts it back.
pub(super) fn stderr() -> impl Write {
    Stderr
}

struct Stderr;

impl Write for Stderr {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let write = || io::stderr().lock().write_all(bytes).map(|()| bytes.len());
        match &*lock() {
            Some(bar) => bar.suspend(write),
            None => write(),
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        io::stderr().flush()
    }
}
