//! Times of repeated runs.

use cpu_time::ThreadTime;
use std::time::Duration;

/// Durations of repeated runs, in CPU time of the calling thread.
#[derive(Default)]
pub(crate) struct Stopwatch(Vec<Duration>);

impl Stopwatch {
    pub(crate) fn time<T>(&mut self, run: impl FnOnce() -> T) -> T {
        let start = ThreadTime::now();
        let result = std::hint::black_box(run());
        self.0.push(start.elapsed());
        result
    }

    pub(crate) fn median_ms(&self) -> f64 {
        median(self.0.iter().map(|time| time.as_secs_f64() * 1e3))
    }
}

pub(crate) fn median(values: impl Iterator<Item = f64>) -> f64 {
    let mut sorted: Vec<f64> = values.collect();
    sorted.sort_by(f64::total_cmp);
    sorted.get(sorted.len() / 2).copied().unwrap_or(f64::NAN)
}
