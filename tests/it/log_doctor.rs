//! Logs examined by the rules of `mcap doctor` (tests/python/doctor.py): logs of a live run with windows and of a
//! recording, and repaired ones.

use crate::support::command::*;
use crate::support::python;
use std::path::Path;
use std::process::{Command, Output};

fn examined(python: &str, log: &Path) -> Output {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/python/doctor.py");
    Command::new(python).arg(script).arg(log).output().unwrap()
}

/// Fails unless nothing is wrong with the log; messages by topic, and how many are out of order.
fn healthy(python: &str, log: &Path) -> serde_json::Value {
    let output = examined(python, log);
    assert!(output.status.success(), "{}", stderr(&output));
    serde_json::from_slice(&output.stdout).unwrap()
}

#[test]
fn logs_of_recordings_and_of_live_runs_are_healthy_and_so_are_repaired_ones() {
    let Some(python) = python::interpreter() else { return };
    let place = Place::new();
    ended_with(&place.track(&sample("planar.mkv"), &["--to", "1.2", "--record", "windows"]), 0);
    let printed = healthy(&python, &place.path("out/log.mcap"));
    assert_eq!(
        (&printed["topics"]["/catheter/estimate"], &printed["topics"]["/camera/windows"]),
        (&73.into(), &73.into())
    );
    assert_eq!((&printed["warnings"], &printed["out_of_order"]), (&serde_json::json!([]), &0.into()));

    let live = Command::new(env!("CARGO_BIN_EXE_catoptra"))
        .current_dir(place.folder.path())
        .arg("live")
        .arg(sample("planar.mkv"))
        .args(["--realtime", "--duration", "3", "--record", "windows", "-o", "live", "--rig"])
        .arg(&place.rig)
        .output()
        .unwrap();
    ended_with(&live, 0);
    let log = place.path("live/log.mcap");
    let printed = healthy(&python, &log);
    assert!(printed["topics"]["/camera/windows"].as_u64().unwrap() > 50, "{printed}");

    // Cut in the middle it is sick, repaired it is not.
    let bytes = std::fs::read(&log).unwrap();
    std::fs::write(&log, &bytes[..bytes.len() / 2]).unwrap();
    assert!(!examined(&python, &log).status.success());
    let mended = Command::new(env!("CARGO_BIN_EXE_catoptra")).args(["log", "repair"]).arg(&log).output().unwrap();
    ended_with(&mended, 0);
    healthy(&python, &log);
}

/// The examination can fail: wherever a bit is turned over, it is found.
#[test]
fn a_single_bit_anywhere_is_found() {
    let Some(python) = python::interpreter() else { return };
    let place = Place::new();
    ended_with(&place.track(&sample("planar.mkv"), &["--to", "0.2"]), 0);
    let log = place.path("out/log.mcap");
    let bytes = std::fs::read(&log).unwrap();
    for k in 0..24 {
        let mut changed = bytes.clone();
        let at = (bytes.len() as f64 * (0.003 + 0.041_3 * f64::from(k))) as usize;
        changed[at] ^= 1 << (k % 8);
        std::fs::write(&log, &changed).unwrap();
        assert!(!examined(&python, &log).status.success(), "bit {} of byte {at} of {}", k % 8, bytes.len());
    }
}
