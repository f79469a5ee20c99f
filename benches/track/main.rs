//! Speed of tracking: each stage compared with a typical OpenCV script, then whole runs compared with plain decoding of
//! the same file, then the program itself.
//!
//! Everything compared runs in this process on the same frames, alternately; only the ratios matter. Stages are
//! measured in thread CPU time, which stops while another program has the core. Whole runs are measured in wall-clock
//! time, because threads wait for each other: use an idle machine, or compare their CPU time, which is also printed.

#![allow(clippy::print_stdout, clippy::unwrap_used, reason = "a bench prints its result, and fails by panicking")]

#[path = "../../tests/support/looped.rs"]
mod looped;
mod opencv_script;
mod program;
mod stages;
mod whole_runs;

use catoptra::rig::Rig;
use cpu_time::ThreadTime;
use std::error::Error;
use std::path::Path;
use std::time::Duration;

fn main() -> Result<(), Box<dyn Error + Send + Sync>> {
    let repository = Path::new(env!("CARGO_MANIFEST_DIR"));
    let recording = repository.join("sample_frames/planar.mkv");
    let rig_file = repository.join("calibration/dev_tank/rig.toml");
    let rig = Rig::load(&rig_file)?;
    stages::print(&recording, &rig)?;
    whole_runs::print(&recording, &rig)?;
    program::print(&recording, &rig_file)
}

/// Durations of repeated runs, in CPU time of the calling thread.
#[derive(Default)]
struct Stopwatch(Vec<Duration>);

impl Stopwatch {
    fn time<T>(&mut self, run: impl FnOnce() -> T) -> T {
        let start = ThreadTime::now();
        let result = std::hint::black_box(run());
        self.0.push(start.elapsed());
        result
    }

    fn median_ms(&self) -> f64 {
        median(self.0.iter().map(|time| time.as_secs_f64() * 1e3))
    }
}

fn median(values: impl Iterator<Item = f64>) -> f64 {
    let mut sorted: Vec<f64> = values.collect();
    sorted.sort_by(f64::total_cmp);
    sorted.get(sorted.len() / 2).copied().unwrap_or(f64::NAN)
}
