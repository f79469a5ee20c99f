//! How a live run goes: counted by the tracker's thread, read by the status line.

use crate::estimate::Estimate;
use crate::source::host::HostClock;
use crate::tally::{AlarmInWords, Tally, Totals};
use hdrhistogram::Histogram;
use parking_lot::Mutex;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Latencies up to ten seconds are told apart.
const LONGEST_US: u64 = 10_000_000;
/// Silence longer than this, and than this many usual steps between frames, is reported.
const SILENCE: Duration = Duration::from_secs(2);
const SILENCE_STEPS: u32 = 3;
/// The same before the first frame.
const SILENT_START: Duration = Duration::from_secs(5);

/// Time from a frame's arrival until its θ was sent, microseconds.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Latency {
    /// Half of the frames took less.
    pub p50_us: u64,
    /// 99 of 100 took less.
    pub p99_us: u64,
    /// The longest.
    pub max_us: u64,
}

/// How a run goes, at one moment.
#[derive(Debug, Clone, Default)]
pub struct Status {
    /// Frames received, tracked or not.
    pub frames: u64,
    /// Frames received per second since the last status.
    pub rate_hz: f64,
    /// Camera frames lost.
    pub lost: u64,
    /// Frames passed over because the tracker was busy.
    pub skipped: u64,
    /// Latency of the frames since the last status.
    pub latency: Latency,
    /// How long no frame has come, if that is longer than usual.
    pub silent: Option<Duration>,
    /// θ of the last frame and its σ, radians, if it was measured and is not [long ago](Status::silent).
    pub theta_rad: Option<(f64, f64)>,
    /// Markers located in the last frame, if that is not long ago, and how many there are.
    pub markers: (usize, usize),
    /// Rows that wait to be written.
    pub backlog: usize,
    /// Rows that could not be written because too many waited.
    pub unlogged: u64,
    /// Pictures recorded, and pictures lost to the recording; `None` when none are to be.
    pub pictures: Option<(u64, u64)>,
    /// All drift alarms so far.
    pub alarms: Vec<AlarmInWords>,
    /// What the tracker has warned of so far.
    pub warnings: Vec<String>,
}

/// The counters of a run.
#[derive(Debug)]
pub(super) struct Counters {
    clock: HostClock,
    counts: Mutex<Counts>,
}

#[derive(Debug)]
struct Counts {
    tally: Tally,
    latest: Option<Arc<Estimate>>,
    pace: Pace,
    /// Frames at the last status, and when that was.
    reported: (u64, Instant),
    recent: Histogram<u64>,
    whole: Histogram<u64>,
    warnings: Vec<String>,
}

impl Counters {
    /// # Errors
    /// When the histograms cannot be made.
    pub(super) fn new(tally: Tally, clock: HostClock) -> Result<Self, hdrhistogram::CreationError> {
        let histogram = || Histogram::new_with_bounds(1, LONGEST_US, 3);
        let (recent, whole) = (histogram()?, histogram()?);
        let now = Instant::now();
        let (pace, reported) = (Pace::new(now), (0, now));
        let counts = Counts { tally, latest: None, pace, reported, recent, whole, warnings: Vec::new() };
        Ok(Self { clock, counts: Mutex::new(counts) })
    }

    /// Counts a frame, when it has been sent to whoever waits for it; the totals, when they are to be reported.
    pub(super) fn add(&self, estimate: &Arc<Estimate>, tracked: bool) -> Option<Totals> {
        let now_ns = self.clock.now_ns();
        let mut counts = self.counts.lock();
        let due = counts.tally.add(estimate);
        if let (Some(host), true) = (estimate.host, tracked) {
            let took_us = u64::try_from(now_ns.saturating_sub(host.arrival_ns) / 1000).unwrap_or(0);
            counts.recent.saturating_record(took_us);
            counts.whole.saturating_record(took_us);
        }
        counts.latest = Some(Arc::clone(estimate));
        counts.pace.frame(Instant::now());
        due.then(|| counts.tally.totals())
    }

    /// Keeps a warning, for who looks later.
    pub(super) fn warn(&self, warning: String) {
        self.counts.lock().warnings.push(warning);
    }

    /// How it goes; the counts of new frames begin again.
    pub(super) fn status(&self) -> Status {
        let mut counts = self.counts.lock();
        let now = Instant::now();
        let silent = counts.pace.silence(now);
        let (before, since) = counts.reported;
        let latest = counts.latest.as_ref().filter(|_| silent.is_none());
        let located = latest.map_or(0, |e| e.markers.iter().filter(|m| m.position.is_ok()).count());
        let angle = latest.and_then(|e| e.deflection.as_ref().ok());
        let status = Status {
            frames: counts.tally.frames,
            rate_hz: (counts.tally.frames - before) as f64 / now.duration_since(since).as_secs_f64().max(1e-3),
            lost: counts.tally.lost,
            skipped: counts.tally.skipped(),
            latency: latency(&counts.recent),
            silent,
            theta_rad: angle.map(|d| (d.theta_rad, d.theta_sd_rad)),
            markers: (located, counts.tally.markers.len()),
            alarms: counts.tally.alarms().collect(),
            warnings: counts.warnings.clone(),
            ..Status::default()
        };
        counts.reported = (counts.tally.frames, now);
        counts.recent.reset();
        status
    }

    /// Totals, and the latency of all frames.
    pub(super) fn totals(&self) -> (Tally, Latency) {
        let counts = self.counts.lock();
        (counts.tally.clone(), latency(&counts.whole))
    }
}

/// When the last frame came, and how far apart the last ones were.
#[derive(Debug)]
struct Pace {
    /// When frames could come first.
    begun: Instant,
    last: Option<Instant>,
    steps: [Option<Duration>; 2],
}

impl Pace {
    fn new(begun: Instant) -> Self {
        Self { begun, last: None, steps: [None; 2] }
    }

    fn frame(&mut self, now: Instant) {
        let [_, before] = self.steps;
        self.steps = [before, self.last.map(|last| now - last)];
        self.last = Some(now);
    }

    /// How long no frame has come, if that is longer than the steps between frames explain.
    fn silence(&self, now: Instant) -> Option<Duration> {
        // The longer of two may be an outage.
        let step = self.steps.into_iter().flatten().min().unwrap_or_default();
        // A camera may take a while to begin.
        let first = if self.last.is_none() { SILENT_START } else { SILENCE };
        Some(now - self.last.unwrap_or(self.begun)).filter(|elapsed| *elapsed > first.max(step * SILENCE_STEPS))
    }
}

fn latency(of: &Histogram<u64>) -> Latency {
    let at = |quantile: f64| if of.is_empty() { 0 } else { of.value_at_quantile(quantile) };
    Latency { p50_us: at(0.5), p99_us: at(0.99), max_us: at(1.0) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn silence_is_longer_than_the_camera_s_own_steps() {
        let s = Duration::from_secs_f64;
        let begin = Instant::now();
        let told = |times: &[f64], now: f64| {
            let mut pace = Pace::new(begin);
            times.iter().for_each(|time| pace.frame(begin + s(*time)));
            pace.silence(begin + s(now)).map(|silent| silent.as_secs())
        };
        assert_eq!((told(&[], 4.9), told(&[], 5.1)), (None, Some(5)));
        assert_eq!((told(&[0.0], 1.9), told(&[0.0], 2.1)), (None, Some(2)));
        assert_eq!((told(&[0.0, 0.016], 1.9), told(&[0.0, 0.016], 2.1)), (None, Some(2)));
        assert_eq!((told(&[0.0, 5.0], 19.0), told(&[0.0, 5.0], 21.0)), (None, Some(16)));
        // An outage of a minute is no step of the camera's, neither before nor after the next frame.
        assert_eq!(told(&[0.0, 0.016, 60.016], 63.1), Some(3));
        assert_eq!(told(&[0.0, 0.016, 60.016, 60.032], 63.1), Some(3));
    }
}
