//! Reads a log: `cargo run --example read_log -- LOG.mcap`; without one, makes one of half a second of the sample.

use catoptra::log::Info;
use catoptra::pipeline;
use catoptra::rig::Rig;
use catoptra::series::Recording;
use catoptra::sink::McapSink;
use catoptra::source::{self, SourceOptions, Span};
use catoptra::track::{TrackOptions, Tracker};
use std::error::Error;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

fn main() -> Result<(), Box<dyn Error>> {
    let log = match std::env::args_os().nth(1) {
        Some(log) => PathBuf::from(log),
        None => sample()?,
    };
    let mut out = std::io::stdout().lock();

    // Its content, whatever program wrote it.
    let info = Info::read(&log)?;
    writeln!(out, "{}: {} frames, {} lost", log.display(), info.frames, info.gaps.1)?;
    for topic in &info.topics {
        writeln!(out, "  {:5} messages on {} ({})", topic.messages, topic.name, topic.schema)?;
    }
    if let Some(why) = info.condition.summary() {
        writeln!(out, "  it ends early: {why}")?;
    }

    // What was measured, frame by frame.
    let run = Recording::read(&log)?;
    let tip = run.marker("tip")?;
    for frame in &run.frames {
        let time_s = frame.stamp_ns as f64 * 1e-9;
        match (frame.theta_rad, frame.places.get(tip).and_then(|place| place.point)) {
            (Some(theta_rad), Some(tip)) => {
                let [x, y, z] = [tip.x, tip.y, tip.z].map(|metres| metres * 1e3);
                writeln!(out, "{time_s:.3} s  θ {:+.2}°  tip ({x:.2}, {y:.2}, {z:.2}) mm", theta_rad.to_degrees())?;
            }
            _ => writeln!(out, "{time_s:.3} s  θ: {}", frame.theta_status.as_deref().unwrap_or("not known"))?,
        }
    }
    Ok(())
}

/// Tracks half a second of the sample into a log.
fn sample() -> Result<PathBuf, Box<dyn Error>> {
    let rig_toml = std::fs::read_to_string("calibration/dev_tank/rig.toml")?;
    let rig = Rig::from_toml_str(&rig_toml, Path::new("rig.toml"))?;
    let span = Span { from_ns: None, to_ns: Some(500_000_000) };
    let recording = source::open("sample_frames/planar.mkv", SourceOptions { span, ..SourceOptions::default() })?;
    let log = std::env::temp_dir().join(format!("catoptra_example_{}.mcap", std::process::id()));
    let sink = McapSink::create(&log, &rig, &rig_toml, "")?;
    let mut tracker = Tracker::new(&rig, TrackOptions::default())?;
    let summary = pipeline::run(recording, &mut tracker, vec![Box::new(sink)], &AtomicBool::new(false), |_| {})?;
    match summary.sink_failures.into_iter().next() {
        Some(error) => Err(error.into()),
        None => Ok(log),
    }
}
