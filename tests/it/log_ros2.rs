//! Logs of profile `ros2`, read with independent code (`rosbags`, `mcap-ros2-support`) by `tests/python/read_ros2.py`,
//! and with our own.

use crate::support::command::*;
use crate::support::made_up::write_run;
use crate::support::python::{agreed, interpreter_with};
use catoptra::log::{Repaired, repair};
use catoptra::rig::Rig;
use catoptra::series::Recording;
use catoptra::sink::{CsvSink, McapSink, OutputFrame, Profile};
use std::path::Path;
use std::process::{Command, Output};

fn python() -> Option<String> {
    interpreter_with(&["rosbags.rosbag2", "mcap_ros2", "numpy"])
}

fn compare(python: &str, log: &Path, table: &Path, live: bool) -> Output {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/python/read_ros2.py");
    Command::new(python).arg(script).args([log, table]).args(live.then_some("--live")).output().unwrap()
}

/// A made-up run.
fn write(profile: Profile, folder: &Path, rig: &Rig, live: bool) {
    rig.save(&folder.join("rig.toml")).unwrap();
    let text = std::fs::read_to_string(folder.join("rig.toml")).unwrap();
    let log = McapSink::of_profile(profile, &folder.join("run.mcap"), rig, &text, "frame = \"base\"\n").unwrap();
    let table = CsvSink::create(&folder.join("run.csv"), rig, OutputFrame::Base).unwrap();
    write_run(log, table, rig, live);
}

#[test]
fn two_libraries_decode_every_message_and_find_the_numbers_of_the_table() {
    let Some(python) = python() else { return };
    for live in [false, true] {
        let folder = tempfile::tempdir().unwrap();
        write(Profile::Ros2, folder.path(), &rig(), live);
        let printed = agreed(&compare(&python, &folder.path().join("run.mcap"), &folder.path().join("run.csv"), live));
        for part in [
            "\"/catheter/base/pose\": 180, \"/catheter/coil/pose\": 180, \"/catheter/deflection\": 200",
            "\"/catheter/markers\": 200, \"/catheter/tip/pose\": 180, ",
            "\"/diagnostics\": 5, \"/health\": 5",
            "\"chain\": [[\"catheter_base_link\", \"camera_link\"], [\"camera_link\", \"camera_optical_frame\"]]",
        ] {
            assert!(printed.contains(part), "{part} is not in {printed}");
        }
        let of_live = "\"/camera/time_reference\": 200";
        assert_eq!(printed.contains(of_live), live, "{printed}");
        assert_eq!(printed.contains("\"/coil/current\": 200, \"/coil/joint_states\": 200"), live, "{printed}");
    }
}

/// The comparison can fail: one digit of one number, and one nanosecond.
#[test]
fn a_changed_digit_is_found() {
    let Some(python) = python() else { return };
    let folder = tempfile::tempdir().unwrap();
    write(Profile::Ros2, folder.path(), &rig(), false);
    let path = folder.path().join("run.csv");
    let whole = std::fs::read_to_string(&path).unwrap();
    for (column, message) in [(2, "stamps of all frames"), (18, "frame 100, tip_y_mm")] {
        let mut lines: Vec<String> = whole.lines().map(str::to_owned).collect();
        let mut cells: Vec<String> = lines[101].split(',').map(str::to_owned).collect();
        let digit = cells[column].pop().unwrap().to_digit(10).unwrap();
        cells[column].push(char::from_digit((digit + 2) % 10, 10).unwrap());
        lines[101] = cells.join(",");
        std::fs::write(&path, lines.join("\r\n")).unwrap();
        let output = compare(&python, &folder.path().join("run.mcap"), &path, false);
        let said = stderr(&output);
        assert!(!output.status.success() && said.contains(message), "{said}");
    }
}

fn recorded(path: &Path) -> Recording {
    Recording { path: "log.mcap".into(), ..Recording::read(path).unwrap() }
}

/// What is read back is the same to the last bit.
#[test]
fn our_own_messages_are_read_back_as_from_any_log() {
    let [own, ros2] = [Profile::Foxglove, Profile::Ros2].map(|profile| {
        let folder = tempfile::tempdir().unwrap();
        write(profile, folder.path(), &rig(), true);
        let recording = recorded(&folder.path().join("run.mcap"));
        assert_eq!((recording.frames.len(), recording.currents.len()), (200, 200));
        recording
    });
    assert_eq!(own, ros2);
}

#[test]
fn a_log_that_was_cut_off_is_repaired_for_ros_too() {
    let folder = tempfile::tempdir().unwrap();
    write(Profile::Ros2, folder.path(), &rig(), true);
    let path = folder.path().join("run.mcap");
    let bytes = std::fs::read(&path).unwrap();
    std::fs::write(&path, &bytes[..bytes.len() * 7 / 10]).unwrap();
    assert!(matches!(repair(&path).unwrap(), Repaired::Mended { unknown: 0, .. }));
    let frames = recorded(&path).frames.len();
    assert!((100..200).contains(&frames), "{frames}");
    // The table ends where the log does.
    let table = folder.path().join("run.csv");
    let text = std::fs::read_to_string(&table).unwrap();
    std::fs::write(&table, text.lines().take(frames + 1).collect::<Vec<_>>().join("\r\n")).unwrap();
    let Some(python) = python() else { return };
    let output = compare(&python, &path, &table, true);
    // Only the totals of the end are missing.
    let said = stderr(&output);
    assert!(output.status.success() || said.starts_with("frames counted"), "{said}");
}

#[test]
fn a_recording_tracked_for_ros_is_read_by_all_and_tracked_again() {
    let place = Place::new();
    let args = ["--to", "0.3", "--profile", "ros2", "--record", "windows"];
    ended_with(&place.track(&sample("planar.mkv"), &args), 0);
    let log = place.path("out/log.mcap");
    let run = |words: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_catoptra"));
        command.current_dir(place.folder.path()).args(words).output().unwrap()
    };
    let info = run(&["log", "info", "out/log.mcap"]);
    ended_with(&info, 0);
    let said = stdout(&info);
    for part in ["19 frames", "complete, with index", "catoptra.Estimate in std_msgs/msg/UInt8MultiArray", "/tf_static"]
    {
        assert!(said.contains(part), "{said}");
    }
    ended_with(&run(&["track", "out/log.mcap", "-o", "again"]), 0);
    let table = |folder: &str| std::fs::read_to_string(place.path(folder).join("track.csv")).unwrap();
    assert_eq!(table("again"), table("out"));
    let options = std::fs::read_to_string(place.path("out/run.toml")).unwrap();
    assert!(options.contains("profile = \"ros2\""), "{options}");
    let summary = std::fs::read_to_string(place.path("out/summary.json")).unwrap();
    assert!(summary.contains("\"profile\": \"ros2\""), "{summary}");
    let Some(python) = python() else { return };
    let printed = agreed(&compare(&python, &log, &place.path("out/track.csv"), false));
    assert!(printed.contains("\"/camera/image/compressed\": 1, \"/camera/windows\": 19"), "{printed}");
}

/// Topic, times, number and bytes of every message, topic by topic.
fn messages(path: &Path) -> Vec<(String, u64, u64, u32, Vec<u8>)> {
    let bytes = std::fs::read(path).unwrap();
    let all = mcap::MessageStream::new(&bytes).unwrap().map(Result::unwrap);
    let mut all: Vec<_> =
        all.map(|m| (m.channel.topic.clone(), m.log_time, m.publish_time, m.sequence, m.data.into_owned())).collect();
    all.sort();
    all
}

#[test]
fn a_converted_log_has_the_messages_that_the_run_would_have_written() {
    let [own, ros2] = [Profile::Foxglove, Profile::Ros2].map(|profile| {
        let folder = tempfile::tempdir().unwrap();
        write(profile, folder.path(), &rig(), true);
        folder
    });
    let out = own.path().join("ros2.mcap");
    let convert = |from: &Path, to: &Path| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_catoptra"));
        command.args(["log", "convert"]).arg(from).args(["--profile", "ros2", "-o"]).arg(to).output().unwrap()
    };
    let output = convert(&own.path().join("run.mcap"), &out);
    ended_with(&output, 0);
    let said = stdout(&output);
    assert!(said.contains("200 frames, currents at 200 times"), "{said}");
    assert!(said.contains("/camera/annotations, 200 messages: ROS has no message for outlines"), "{said}");
    let (found, expected) = (messages(&out), messages(&ros2.path().join("run.mcap")));
    assert_eq!(found.len(), expected.len());
    for (found, expected) in found.iter().zip(&expected) {
        assert!(found == expected, "{} at {}", found.0, found.1);
    }
    assert_eq!(attached(&out, "rig.toml"), attached(&own.path().join("run.mcap"), "rig.toml"));
    assert_eq!(recorded(&out), recorded(&own.path().join("run.mcap")));

    // Nothing is written over, and it is not done twice.
    let before = std::fs::read(&out).unwrap();
    let said = ended_with(&convert(&own.path().join("run.mcap"), &out), 2);
    assert!(said.contains("ros2.mcap: already exists"), "{said}");
    let said = ended_with(&convert(&out, &own.path().join("twice.mcap")), 2);
    assert!(said.contains("ros2.mcap: is of profile ros2 already"), "{said}");
    assert!(std::fs::read(&out).unwrap() == before && !own.path().join("twice.mcap").exists());
    let said = ended_with(&convert(&own.path().join("run.csv"), &own.path().join("new.mcap")), 2);
    assert!(said.contains("run.csv: is not a log"), "{said}");
}
