//! `catoptra log convert` to tables: CSV byte for byte as written by the run; Parquet and MAT 5 with the same numbers,
//! read with independent code (`pyarrow`, `polars`, `scipy`) by `tests/python/read_tables.py`.

use crate::support::command::*;
use crate::support::fixture;
use crate::support::python::{agreed, interpreter_with};
use catoptra::estimate::{Spot, Tick};
use catoptra::series::CurrentTable;
use catoptra::sink::{CsvSink, CurrentSample, McapSink, OutputFrame, Profile, Sink};
use catoptra::tally::Tally;
use std::path::Path;
use std::process::{Command, Output};

/// A made-up run: `NAME.mcap`, and its table in both frames of reference.
fn write(profile: Profile, folder: &Path, name: &str, based: bool) {
    let mut rig = rig();
    if !based {
        rig.base = None;
    }
    let file = |ending: &str| folder.join(format!("{name}{ending}"));
    let mut log = McapSink::of_profile(profile, &file(".mcap"), &rig, "", "").unwrap();
    let frames = [OutputFrame::Camera, OutputFrame::Base];
    let frames = frames.iter().filter(|frame| based || **frame == OutputFrame::Camera);
    let mut tables: Vec<_> =
        frames.map(|frame| CsvSink::create(&file(&format!("-{frame:?}.csv")), &rig, *frame).unwrap()).collect();
    let mut tally = Tally::new(&rig);
    for seq in 0..150 {
        // Nanoseconds that a double cannot hold.
        let estimate = fixture::eventful(seq, 1_795_188_826_788_000_001);
        tally.add(&estimate);
        log.write(&estimate, None).unwrap();
        let sample = CurrentSample {
            host_ns: estimate.stamp.ns + 3,
            arrival_ns: estimate.stamp.ns + 7,
            seq: None,
            current_a: vec![seq as f64 / 3.0, -1e-7],
        };
        log.write_current(&sample).unwrap();
        tables.iter_mut().for_each(|table| table.write(&estimate, None).unwrap());
    }
    log.finish(&tally).unwrap();
    tables.iter_mut().for_each(|table| table.finish(&tally).unwrap());
}

fn convert(folder: &Path, words: &str) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_catoptra"));
    command.current_dir(folder).args(["log", "convert"]).args(words.split_whitespace()).output().unwrap()
}

fn read(python: &str, table: &Path, others: &[&Path]) -> Output {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/python/read_tables.py");
    Command::new(python).arg(script).arg(table).args(others).output().unwrap()
}

#[test]
fn the_table_of_a_log_is_that_of_its_run_to_the_last_byte() {
    let place = tempfile::tempdir().unwrap();
    for profile in [Profile::Foxglove, Profile::Ros2] {
        let name = format!("{profile:?}");
        write(profile, place.path(), &name, true);
        for (frame, word) in [("Base", "base"), ("Camera", "camera")] {
            let out = format!("{name}-{word}-out.csv");
            let output = convert(place.path(), &format!("{name}.mcap --profile csv --frame {word} -o {out}"));
            ended_with(&output, 0);
            let said = stdout(&output);
            assert!(said.contains("150 frames, currents at 150 times\n  left out:\n    of each frame: cov"), "{said}");
            let text = |name: &str| std::fs::read_to_string(place.path().join(name)).unwrap();
            assert!(text(&out) == text(&format!("{name}-{frame}.csv")), "{name} {frame}");
            let currents = CurrentTable::read(&place.path().join(format!("{name}-{word}-out-currents.csv"))).unwrap();
            assert_eq!(currents.coils, ["coil_1", "coil_2"]);
            let row = &currents.rows[100];
            // Three frames were lost before this one.
            let stamp_ns = 1_795_188_826_788_000_001 + 103 * 16_666_667;
            assert_eq!((row.time_ns, row.values_a.as_slice()), (stamp_ns + 3, &[100.0 / 3.0, -1e-7][..]));
        }
    }
}

/// A run whose first frame was skipped or damaged: the lamp was watched all the same.
#[test]
fn a_tick_that_the_first_frame_lacks_has_its_column() {
    let place = tempfile::tempdir().unwrap();
    let rig = rig();
    for (name, options) in [("with", "tick_led = \"1,2,3\""), ("without", "")] {
        let file = |ending: &str| place.path().join(format!("{name}{ending}"));
        let mut log = McapSink::of_profile(Profile::Foxglove, &file(".mcap"), &rig, "", options).unwrap();
        let mut table = CsvSink::with_ticks(&file("-run.csv"), &rig, OutputFrame::Base).unwrap();
        let mut tally = Tally::new(&rig);
        for seq in 0..9 {
            let mut estimate = fixture::eventful(seq, 0);
            let spot = Spot { x_px: 1, y_px: 2, radius_px: 3 };
            estimate.tick = (seq > 3).then_some(Tick { count: (seq % 2) as u8, level: 100.0, spot });
            tally.add(&estimate);
            log.write(&estimate, None).unwrap();
            table.write(&estimate, None).unwrap();
        }
        log.finish(&tally).unwrap();
        table.finish(&tally).unwrap();
        ended_with(&convert(place.path(), &format!("{name}.mcap --profile csv -o {name}.csv")), 0);
        let text = |ending: &str| std::fs::read_to_string(file(ending)).unwrap();
        assert!(text(".csv") == text("-run.csv"), "{name}");
        assert!(text(".csv").lines().next().unwrap().ends_with(",tick"), "{name}");
    }
}

/// A datagram of another program among those of the amplifier: the rest is converted.
#[test]
fn samples_of_another_number_of_coils_are_left_out_and_named() {
    let place = tempfile::tempdir().unwrap();
    let rig = rig();
    for (name, odd) in [("first", 0), ("later", 5)] {
        let mut log = McapSink::of_profile(Profile::Foxglove, &place.path().join(name), &rig, "", "").unwrap();
        let mut tally = Tally::new(&rig);
        for seq in 0..9 {
            let estimate = fixture::eventful(seq, 0);
            tally.add(&estimate);
            log.write(&estimate, None).unwrap();
            let current_a = if seq == odd { vec![0.5] } else { vec![0.1, seq as f64] };
            let ns = 1000 + seq as i64;
            log.write_current(&CurrentSample { host_ns: ns, arrival_ns: ns, seq: None, current_a }).unwrap();
        }
        log.finish(&tally).unwrap();
        let output = convert(place.path(), &format!("{name} --profile csv -o {name}.csv"));
        ended_with(&output, 0);
        let said = stdout(&output);
        assert!(said.contains("9 frames, currents at 8 times"), "{said}");
        assert!(said.contains("/coil/current, 1 message: not of 2 coils, as most are"), "{said}");
        let currents = CurrentTable::read(&place.path().join(format!("{name}-currents.csv"))).unwrap();
        let times: Vec<u64> = currents.rows.iter().map(|row| (row.time_ns - 1000) as u64).collect();
        assert_eq!(times, (0..9).filter(|seq| *seq != odd).collect::<Vec<u64>>());
    }
}

#[test]
fn other_libraries_find_the_numbers_of_the_table() {
    let Some(python) = interpreter_with(&["pyarrow.parquet", "polars", "scipy.io", "numpy"]) else { return };
    let place = tempfile::tempdir().unwrap();
    write(Profile::Foxglove, place.path(), "run", true);
    let table = place.path().join("run-Base.csv");
    for ending in ["parquet", "mat"] {
        ended_with(&convert(place.path(), &format!("run.mcap --profile {ending} -o out.{ending}")), 0);
    }
    let printed = agreed(&read(
        &python,
        &table,
        &[&place.path().join("out.parquet"), &place.path().join("out.mat"), &place.path().join("out-currents.parquet")],
    ));
    assert!(printed.contains("\"out.parquet\": 150") && printed.contains("\"out.mat\": 150"), "{printed}");
    assert!(printed.contains("\"out-currents.parquet\": 150"), "{printed}");
    // The comparison can fail.
    let text = std::fs::read_to_string(&table).unwrap();
    let mut lines: Vec<String> = text.lines().map(str::to_owned).collect();
    lines[70] = lines[70].replacen("17951888", "17951889", 1);
    std::fs::write(&table, lines.join("\r\n")).unwrap();
    let output = read(&python, &table, &[&place.path().join("out.mat")]);
    assert!(!output.status.success() && stderr(&output).contains("row 69"), "{}", stderr(&output));
}

/// What `catoptra collect` writes, to the last bit: its numbers are the table's.
#[test]
fn other_libraries_find_the_numbers_of_the_tables_in_a_study() {
    let Some(python) = interpreter_with(&["pyarrow.parquet", "polars", "scipy.io", "numpy"]) else { return };
    let place = Place::new();
    let output = place.command(&sample("circle.mkv")).args(["--to", "0.1"]).output().unwrap();
    ended_with(&output, 0);
    let mut collect = Command::new(env!("CARGO_BIN_EXE_catoptra"));
    ended_with(&collect.current_dir(place.folder.path()).args(["collect", "out", "-o", "study"]).output().unwrap(), 0);
    let printed = agreed(&read(&python, &place.path("out/track.csv"), &[&place.path("study/frames.parquet")]));
    let rows = place.table().rows.len();
    assert!(rows > 4 && printed.contains(&format!("\"frames.parquet\": {rows}")), "{printed}");
}

#[test]
fn what_cannot_be_converted_is_refused_and_nothing_is_written() {
    let place = tempfile::tempdir().unwrap();
    write(Profile::Foxglove, place.path(), "bare", false);
    write(Profile::Foxglove, place.path(), "run", true);
    std::fs::write(place.path().join("mine.csv"), "mine").unwrap();
    std::fs::write(place.path().join("new-currents.csv"), "mine").unwrap();
    let there = names(place.path());
    for (words, message) in [
        (
            "bare.mcap --profile csv -o out.csv",
            "has no places in the base frame: its rig has none; convert with --frame",
        ),
        ("run.mcap --profile csv -o mine.csv", "mine.csv: already exists; choose another name"),
        ("run.mcap --profile csv -o new.csv", "new-currents.csv: already exists"),
        ("run.mcap --profile mat -o none/out.mat", "none/out.mat: cannot be written: No such file"),
        ("bare.mcap --profile ros2 -o out.mcap", "bare.mcap: has no rig.toml attached"),
        ("mine.csv --profile csv -o out.csv", "mine.csv: is not a log"),
        ("none.mcap --profile csv -o out.csv", "none.mcap: No such file"),
        ("run.mcap --profile csv -o run.mcap", "run.mcap: already exists"),
    ] {
        let said = ended_with(&convert(place.path(), words), 2);
        assert!(said.contains(message), "{words}: {said}");
        assert_eq!(names(place.path()), there, "{words}");
    }
    ended_with(&convert(place.path(), "bare.mcap --profile csv --frame camera -o out.csv"), 0);
    let text = |name: &str| std::fs::read_to_string(place.path().join(name)).unwrap();
    assert_eq!(text("out.csv"), text("bare-Camera.csv"));
}

#[test]
fn a_damaged_log_is_converted_as_far_as_it_goes() {
    let place = tempfile::tempdir().unwrap();
    write(Profile::Foxglove, place.path(), "run", true);
    let path = place.path().join("run.mcap");
    let bytes = std::fs::read(&path).unwrap();
    std::fs::write(&path, &bytes[..bytes.len() / 2]).unwrap();
    let said = ended_with(&convert(place.path(), "run.mcap --profile csv -o out.csv"), 0);
    assert!(said.contains("ends without an index") && said.contains("the rest is converted"), "{said}");
    let text = |name: &str| std::fs::read_to_string(place.path().join(name)).unwrap();
    let (part, whole) = (text("out.csv"), text("run-Base.csv"));
    assert!(whole.starts_with(&part) && part.lines().count() > 30, "{} lines", part.lines().count());
}
