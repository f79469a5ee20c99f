//! Frames that a person has vetoed: left out and counted by every command that reads a run.

use crate::support::command::*;
use catoptra::series::Recording;
use parquet::file::reader::SerializedFileReader;
use parquet::record::Field;
use serde_json::Value;
use std::fs;
use std::path::Path;
use std::process::{Command, Output};

fn run(folder: &Path, words: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_catoptra")).current_dir(folder).args(words).output().unwrap()
}

/// Vetoes these rows of a table, as the studio writes them; one more is taken back, and one is of another recording.
fn veto(table: &Path, rows: &[usize]) {
    let text = fs::read_to_string(table).unwrap();
    let header: Vec<&str> = text.lines().next().unwrap().split(',').collect();
    let cell = |row: usize, name: &str| {
        let at = header.iter().position(|other| *other == name).unwrap();
        text.lines().nth(row + 1).unwrap().split(',').nth(at).unwrap().to_owned()
    };
    let mut vetoes = "seq,stamp_ns,status,comment,written\r\n".to_owned();
    let mut add = |row: usize, status: &str, shift_ns: i64| {
        let stamp_ns: i64 = cell(row, "stamp_ns").parse().unwrap();
        let (seq, stamp_ns) = (cell(row, "seq"), stamp_ns + shift_ns);
        vetoes += &format!("{seq},{stamp_ns},{status},\"a hand, in front\",2026-01-01T00:00:00Z\r\n");
    };
    rows.iter().for_each(|row| add(*row, "vetoed", 0));
    add(rows[0] - 1, "vetoed", 0);
    add(rows[0] - 1, "restored", 0);
    add(rows[0] - 1, "vetoed", 7);
    fs::write(table.with_file_name("vetoes.csv"), vetoes).unwrap();
}

#[test]
fn of_a_vetoed_frame_only_its_time_is_read_from_table_and_log() {
    let place = Place::new();
    ended_with(&place.track(&sample("planar.mkv"), &["--to", "0.2"]), 0);
    veto(&place.path("out/track.csv"), &[3, 8]);
    for name in ["out/track.csv", "out/log.mcap"] {
        let path = place.path(name);
        let (all, read) = (Recording::as_measured(&path).unwrap(), Recording::read(&path).unwrap());
        assert_eq!((all.vetoed, read.vetoed, read.frames.len()), (0, 2, all.frames.len()), "{name}");
        for (frame, measured) in read.frames.iter().zip(&all.frames) {
            if [3, 8].contains(&frame.seq) {
                assert!(frame.theta_rad.is_none() && frame.tangent.is_none() && measured.theta_rad.is_some());
                assert!(frame.places.iter().all(|place| place.point.is_none() && place.status == "vetoed"));
                assert_eq!((frame.stamp_ns, frame.gap), (measured.stamp_ns, measured.gap));
            } else {
                assert_eq!(frame, measured);
            }
        }
    }
    // The studio shows what was measured, and `collect` has it beside the reason.
    ended_with(&run(place.folder.path(), &["collect", "out", "-o", "study"]), 0);
    let rows = SerializedFileReader::new(fs::File::open(place.path("study/frames.parquet")).unwrap()).unwrap();
    let vetoes: Vec<(i64, bool)> = rows
        .into_iter()
        .filter_map(|row| {
            let cells: std::collections::HashMap<String, Field> = row.unwrap().into_columns().into_iter().collect();
            let Field::Long(seq) = cells["seq"] else { panic!("{cells:?}") };
            match &cells["veto"] {
                Field::Null => None,
                why => Some((seq, *why == Field::Str("a hand, in front".into()) && cells["theta_deg"] != Field::Null)),
            }
        })
        .collect();
    assert_eq!(vetoes, [(3, true), (8, true)]);
    // A file that is something else is not taken for vetoes, nor passed over.
    fs::write(place.path("out/vetoes.csv"), "who,why\nme,so\n").unwrap();
    let error = Recording::read(&place.path("out/track.csv")).unwrap_err().to_string();
    assert!(error.contains("vetoes.csv") && error.contains("seq,stamp_ns,status,comment,written"), "{error}");
}

#[test]
fn vetoes_of_another_content_of_the_recording_are_set_aside() {
    let place = Place::new();
    let recording = place.path("day.mkv");
    let put = |name: &str| fs::write(&recording, fs::read(sample(name)).unwrap()).unwrap();
    let track = || ended_with(&place.track(&recording, &["--to", "0.05"]), 0);
    put("rest.mkv");
    track();
    veto(&place.path("out/track.csv"), &[1]);
    let said = track();
    assert!(!said.contains("vetoes"), "{said}");
    put("circle.mkv");
    let said = track();
    assert!(
        said.contains("of an earlier content of this recording, now in") && said.contains("vetoes.csv.bak"),
        "{said}"
    );
    assert!(!place.path("out/vetoes.csv").exists() && place.path("out/vetoes.csv.bak").exists());
    assert_eq!(Recording::read(&place.path("out/track.csv")).unwrap().vetoed, 0);
}

#[test]
fn validate_and_identify_leave_vetoed_frames_out_and_say_how_many() {
    let folder = tempfile::tempdir().unwrap();
    let tree = Path::new(env!("CARGO_MANIFEST_DIR"));
    fs::copy(tree.join("tests/data/validate/20ms.csv"), folder.path().join("20ms.csv")).unwrap();
    let desired = tree.join("tests/data/validate/circle.csv").display().to_string();
    let validated = |out: &str| {
        let words = ["validate", "20ms.csv", "--pause", "20ms", "--desired", &desired, "--start", "1.5", "-o", out];
        let output = run(folder.path(), &words);
        ended_with(&output, 0);
        let read = fs::read_to_string(folder.path().join(out).join("validation.json")).unwrap();
        (serde_json::from_str::<Value>(&read).unwrap()["runs"][0].clone(), stderr(&output))
    };
    let (before, said) = validated("before");
    assert!(before["frames_vetoed"] == 0 && !said.contains("vetoed"), "{before} {said}");
    let rows: Vec<usize> = (300..340).collect();
    let table = fs::read_to_string(folder.path().join("20ms.csv")).unwrap();
    let seen = table.lines().skip(301).take(40).filter(|line| line.contains(",ok,")).count() as u64;
    veto(&folder.path().join("20ms.csv"), &rows);
    let (after, said) = validated("after");
    assert_eq!(after["frames_vetoed"], 40, "{after}");
    let count = |run: &Value, name: &str| run[name].as_u64().unwrap();
    assert_eq!(count(&after, "frames"), count(&before, "frames"));
    assert_eq!(count(&after, "frames_missed"), count(&before, "frames_missed") + seen);
    assert!(said.contains("20ms.csv: 40 frames are left out: vetoed in vetoes.csv"), "{said}");
    assert_ne!(after["rms_aligned_mm"], before["rms_aligned_mm"]);

    for name in ["training.csv", "training_currents.csv", "plant.toml"] {
        fs::copy(tree.join("sample_dynamics").join(name), folder.path().join(name)).unwrap();
    }
    veto(&folder.path().join("training.csv"), &rows);
    let words = ["identify", "training.csv", "--currents", "training_currents.csv", "--plant", "plant.toml"];
    let output = run(folder.path(), &[&words[..], &["-o", "dynamics", "--bootstrap", "0", "--json"]].concat());
    ended_with(&output, 0);
    let outcome: Value = serde_json::from_slice(&output.stdout).unwrap();
    let text = outcome["text"].as_str().unwrap();
    assert!(text.contains("40 of these vetoed"), "{text}");
    assert!(outcome["warnings"].to_string().contains("40 frames are left out"), "{}", outcome["warnings"]);
    let model: Value =
        serde_json::from_str(&fs::read_to_string(folder.path().join("dynamics/model.json")).unwrap()).unwrap();
    assert_eq!(model["records"][0]["vetoed"], 40, "{}", model["records"]);
}
