//! The log read by independent code: Python's `mcap` with `mcap-protobuf-support` decodes every message and finds the
//! numbers of the table. The logged run is made up and contains everything that a log can hold; track_python.rs has a
//! real one.

use crate::support::fixture;
use crate::support::made_up::write_run;
use crate::support::python;
use catoptra::rig::Rig;
use catoptra::sink::{CsvSink, McapSink, OutputFrame};
use std::path::Path;
use std::process::Output;

use crate::support::python::{agreed, interpreter};

fn write(folder: &Path, rig: &Rig, frame: OutputFrame) {
    let log = McapSink::create(&folder.join("run.mcap"), rig, "# the rig\n", "frame = \"base\"\n").unwrap();
    let table = CsvSink::create(&folder.join("run.csv"), rig, frame).unwrap();
    write_run(log, table, rig, false);
}

fn compare(python: &str, folder: &Path, frame: &str) -> Output {
    python::compare(python, &folder.join("run.mcap"), &folder.join("run.csv"), frame)
}

#[test]
fn python_decodes_every_message_and_finds_the_numbers_of_the_table() {
    let Some(python) = interpreter() else { return };
    let folder = tempfile::tempdir().unwrap();
    write(folder.path(), &fixture::rig(), OutputFrame::Base);
    let printed = agreed(&compare(&python, folder.path(), "base"));
    for part in [
        "\"frames\": 200",
        "\"/camera/annotations\": 200, \"/camera/calibration\": 1",
        "\"/catheter/deflection\": 200, \"/catheter/estimate\": 200",
        "\"/health\": 4, \"/scene\": 200, \"/tf\": 1",
        "\"attachments\": [\"options.toml\", \"rig.toml\", \"topics\"]",
        "\"clock\": \"container\"",
    ] {
        assert!(printed.contains(part), "{part} is not in {printed}");
    }
}

#[test]
fn in_the_camera_frame_and_without_a_base() {
    let Some(python) = interpreter() else { return };
    let folder = tempfile::tempdir().unwrap();
    write(folder.path(), &fixture::rig(), OutputFrame::Camera);
    agreed(&compare(&python, folder.path(), "camera"));
    let mut rig = fixture::rig();
    rig.base = None;
    write(folder.path(), &rig, OutputFrame::Camera);
    let printed = agreed(&compare(&python, folder.path(), "camera"));
    assert!(!printed.contains("/tf"), "{printed}");
}

/// The comparison can fail: one digit of one number of the table is changed.
#[test]
fn a_changed_digit_is_found() {
    let Some(python) = interpreter() else { return };
    let folder = tempfile::tempdir().unwrap();
    write(folder.path(), &fixture::rig(), OutputFrame::Base);
    let path = folder.path().join("run.csv");
    let mut lines: Vec<String> = std::fs::read_to_string(&path).unwrap().lines().map(str::to_owned).collect();
    let mut cells: Vec<String> = lines[101].split(',').map(str::to_owned).collect();
    let digit = cells[18].pop().unwrap().to_digit(10).unwrap();
    cells[18].push(char::from_digit((digit + 2) % 10, 10).unwrap());
    lines[101] = cells.join(",");
    std::fs::write(&path, lines.join("\r\n")).unwrap();
    let output = compare(&python, folder.path(), "base");
    let printed = String::from_utf8_lossy(&output.stderr);
    assert!(!output.status.success() && printed.contains("frame 100, tip_y_mm"), "{printed}");
}
