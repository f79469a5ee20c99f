//! Tracks a recording and prints θ: `cargo run --example track_video -- VIDEO RIG.toml`.
//!
//! Offline there is no hurry: this processes one frame after another. `catoptra::pipeline::run` does the same with
//! source, tracker and sinks in separate threads.

use catoptra::rig::Rig;
use catoptra::source::{self, SourceOptions};
use catoptra::track::{TrackOptions, Tracker};
use std::error::Error;
use std::io::Write as _;
use std::path::Path;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [video, rig] = arguments.as_slice() else { return Err("expected two arguments: VIDEO RIG.toml".into()) };
    let rig = Rig::load(Path::new(rig))?;
    let views: Vec<&str> = rig.views.iter().map(|view| view.name.as_str()).collect();
    let mut frames = source::open(video, SourceOptions::default())?;
    let mut tracker = Tracker::new(&rig, TrackOptions::default())?;
    let mut out = std::io::stdout().lock();
    while let Some(frame) = frames.next_frame()? {
        let estimate = tracker.step(&frame)?;
        let time_s = estimate.stamp.seconds();
        match &estimate.deflection {
            Ok(angles) => {
                let [theta_deg, sd_deg] = [angles.theta_rad, angles.theta_sd_rad].map(f64::to_degrees);
                writeln!(out, "{time_s:.3} s  θ {theta_deg:+7.2}° ± {sd_deg:.2}°")?;
            }
            // Every frame has a line, with the reason if there is no angle.
            Err(miss) => writeln!(out, "{time_s:.3} s  {}", miss.word(&views))?,
        }
    }
    Ok(())
}
