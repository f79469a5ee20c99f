//! The status line of a live run, and warnings that cannot wait for its end.

use super::super::progress::Line;
use super::super::run::summary::warn_of_alarm;
use crate::live::{NEARLY_FULL_BYTES, Status, free_bytes};
use crate::log::schema::LOG_FILE;
use crate::plural::plural;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Remaining time until the disk is full at the present rate, seconds, at each of which one warning is given.
const WARN_AT_S: [f64; 3] = [1800.0, 300.0, 60.0];

/// One status line, on a terminal only.
pub(super) struct StatusLine {
    source: String,
    folder: PathBuf,
    line: Line,
    began: (Instant, u64),
    warned_alarms: usize,
    told_over: usize,
    warned_short: usize,
    warned_skipped: bool,
    warned_silent: bool,
    warned_pictures: bool,
    warned_gone: bool,
}

impl StatusLine {
    pub(super) fn new(source: &str, folder: &Path, quiet: bool) -> Self {
        let began = (Instant::now(), free_bytes(folder).unwrap_or(0));
        Self {
            source: source.to_owned(),
            folder: folder.to_owned(),
            line: Line::new(quiet),
            began,
            warned_alarms: 0,
            told_over: 0,
            warned_short: 0,
            warned_skipped: false,
            warned_silent: false,
            warned_pictures: false,
            warned_gone: false,
        }
    }

    pub(super) fn show(&mut self, status: &Status) {
        let source = &self.source;
        status.alarms.iter().skip(self.warned_alarms).for_each(|alarm| warn_of_alarm(alarm, source));
        self.warned_alarms = status.alarms.len();
        let over = status.alarms.iter().filter(|alarm| alarm.over_ns.is_some()).count();
        if over > self.told_over {
            tracing::info!("{source}: the rig is as calibrated again: a drift alarm is over");
        }
        self.told_over = over;
        if status.skipped > 0 && !self.warned_skipped {
            self.warned_skipped = true;
            tracing::warn!("{source}: the tracker does not keep up: frames are skipped, each still has its row");
        }
        let angle = status.theta_rad.map_or("θ –".to_owned(), |(theta, sd)| {
            format!("θ {:+.2}° ± {:.2}°", theta.to_degrees(), sd.to_degrees())
        });
        let (seen, markers) = status.markers;
        if let Some(silent) = status.silent.filter(|_| !self.warned_silent) {
            let waited = silent.as_secs_f64();
            tracing::warn!("{source}: no frame has come for {waited:.0} s; the run waits");
        }
        self.warned_silent = status.silent.is_some();
        let ms = |us: u64| us as f64 * 1e-3;
        let (p50, p99) = (ms(status.latency.p50_us), ms(status.latency.p99_us));
        let mut text = format!(
            "{:5.1} Hz · {} lost · {} skipped · latency {p50:.1} ms, 99 % within {p99:.1} ms · {angle} · \
             {seen} of {markers} markers",
            status.rate_hz, status.lost, status.skipped
        );
        if let Some(silent) = status.silent {
            let (lost, skipped) = (status.lost, status.skipped);
            text = format!("no frame for {:.0} s · {lost} lost · {skipped} skipped", silent.as_secs_f64());
        }
        if let Some(free) = free_bytes(&self.folder) {
            text += &format!(" · disk {:.1} GB", free as f64 * 1e-9);
            self.warn_of_short_disk(free);
        }
        if !self.warned_gone && !self.folder.join(LOG_FILE).exists() {
            self.warned_gone = true;
            tracing::error!(
                "{}: the log is no longer there: the folder was moved or removed, and what is recorded from now on may \
                 be lost; stop the run and start another",
                self.folder.display()
            );
        }
        if status.backlog > 60 {
            text += &format!(" · {} rows wait for it", status.backlog);
        }
        if let Some((recorded, dropped)) = status.pictures.filter(|(recorded, dropped)| recorded + dropped > 0) {
            text += &format!(" · {}", plural(recorded, "picture"));
            if dropped > 0 {
                text += &format!(", {dropped} lost");
            }
        }
        if dropped_now(status) && !self.warned_pictures {
            self.warned_pictures = true;
            tracing::warn!("{}: not all pictures can be recorded; every row is logged", self.source);
        }
        if status.alarms.iter().any(|alarm| alarm.over_ns.is_none()) {
            text += " · DRIFT";
        }
        self.line.set(text);
    }

    fn warn_of_short_disk(&mut self, free: u64) {
        let (began, free_then) = self.began;
        // The first seconds do not give a rate.
        if began.elapsed().as_secs() < 30 && free > NEARLY_FULL_BYTES {
            return;
        }
        let per_second = free_then.saturating_sub(free) as f64 / began.elapsed().as_secs_f64().max(1.0);
        let left_s = free as f64 / per_second.max(1.0);
        let short = WARN_AT_S.iter().filter(|limit| left_s < **limit).count();
        if short > self.warned_short {
            self.warned_short = short;
            let minutes = plural((left_s / 60.0).round().max(1.0) as u64, "minute");
            tracing::warn!("{}: the disk will be full in about {minutes} at this rate", self.folder.display());
        }
    }
}

fn dropped_now(status: &Status) -> bool {
    status.pictures.is_some_and(|(_, dropped)| dropped > 0)
}
