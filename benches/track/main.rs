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
mod recoded;
mod spread;
mod stages;
#[path = "../support/stopwatch.rs"]
mod stopwatch;
mod whole_runs;

use catoptra::rig::Rig;
use std::error::Error;
use std::path::Path;

fn main() -> Result<(), Box<dyn Error + Send + Sync>> {
    let repository = Path::new(env!("CARGO_MANIFEST_DIR"));
    let recording = repository.join("sample_frames/planar.mkv");
    let rig_file = repository.join("calibration/dev_tank/rig.toml");
    let rig = Rig::load(&rig_file)?;
    stages::print(&recording, &rig)?;
    println!("\n{}: H.264", recording.file_name().unwrap_or_default().display());
    whole_runs::print(&recording, &rig)?;
    let folder = tempfile::tempdir()?;
    for coder in ["ffv1", "mjpeg"] {
        let to = folder.path().join(coder).with_extension("mkv");
        recoded::recoded(&recording, coder, &to)?;
        println!("\nthe same pictures, by the coder {coder}");
        whole_runs::print(&to, &rig)?;
    }
    program::print(&recording, &rig_file)
}
