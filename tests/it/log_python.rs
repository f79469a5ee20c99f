//! The log read by someone else's code: Python's `mcap` with `mcap-protobuf-support` decodes every message and finds
//! the numbers of the table. What was logged is made up, with everything in it that a log can hold; track_python.rs has
//! a real one.

use crate::support::fixture;
use crate::support::python;
use catoptra::rig::Rig;
use catoptra::sink::{CsvSink, McapSink, OutputFrame, Sink};
use catoptra::tally::Tally;
use std::path::Path;
use std::process::Output;

use crate::support::python::{agreed, interpreter};

const FRAMES: u64 = 200;

fn write(folder: &Path, rig: &Rig, frame: OutputFrame) {
    let mut log = McapSink::create(&folder.join("run.mcap"), rig, "# the rig\n", "frame = \"base\"\n").unwrap();
    let mut table = CsvSink::create(&folder.join("run.csv"), rig, frame).unwrap();
    let mut tally = Tally::new(rig);
    for seq in 0..FRAMES {
        // From a negative stamp through 0, as containers have them.
        let estimate = fixture::eventful(seq, -3 * 16_666_667);
        log.write(&estimate, None).unwrap();
        if tally.add(&estimate) {
            log.write_totals(&tally.totals()).unwrap();
        }
        table.write(&estimate, None).unwrap();
    }
    log.finish(&tally).unwrap();
    table.finish(&tally).unwrap();
}

fn compare(python: &str, folder: &Path, frame: &str) -> Output {
    python::compare(python, &folder.join("run.mcap"), &folder.join("run.csv"), frame)
}

#[test]
fn python_decodes_every_message_and_finds_the_numbers_of_the_table() {
    let Some(python) = interpreter() else { return };
    let folder = tempfile::tempdir().unwrap();
    write(folder.path(), &fixture::rig(), OutputFrame::Base);
    let told = agreed(&compare(&python, folder.path(), "base"));
    for part in [
        "\"frames\": 200",
        "\"/camera/annotations\": 200, \"/camera/calibration\": 1",
        "\"/catheter/deflection\": 200, \"/catheter/estimate\": 200",
        "\"/health\": 4, \"/scene\": 200, \"/tf\": 1",
        "\"attachments\": [\"options.toml\", \"rig.toml\"]",
        "\"clock\": \"container\"",
    ] {
        assert!(told.contains(part), "{part} is not in {told}");
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
    let told = agreed(&compare(&python, folder.path(), "camera"));
    assert!(!told.contains("/tf"), "{told}");
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
    let told = String::from_utf8_lossy(&output.stderr);
    assert!(!output.status.success() && told.contains("frame 100, tip_y_mm"), "{told}");
}
