//! `catoptra validate` from end to end: logs and tables of the same run, all outputs, and refusals.

use crate::support::fixture;
use crate::support::python;
use catoptra::estimate::{Estimate, Position};
use catoptra::sink::{CsvSink, CurrentSample, McapSink, OutputFrame, Sink as _};
use catoptra::source::HostTime;
use catoptra::tally::Tally;
use nalgebra::{Matrix3, Point3};
use std::f64::consts::TAU;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// Camera time of the first command.
const START_NS: i64 = 2_000_000_000;
const PAUSE_NS: i64 = 25_000_000;
/// The host's clock at camera time 0.
const HOST_0: i64 = 1_700_000_000_000_000_000;

fn data(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/validate").join(name)
}

fn validate(folder: &Path, args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_catoptra")).current_dir(folder).arg("validate").args(args).output().unwrap()
}

fn stdout(output: &Output) -> String {
    String::from_utf8_lossy(&output.stdout).into_owned()
}

fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// The point that was commanded 8 points, 0.2 s, ago: where a catheter is that follows so late.
fn place(t_s: f64) -> Point3<f64> {
    let k = (t_s / (PAUSE_NS as f64 * 1e-9)).floor() - 8.0;
    let t = TAU * k.max(0.0) / 200.0;
    Point3::new(0.012 * t.cos(), 0.012 * t.sin(), 0.09)
}

/// A live run of such a catheter: log with currents, and table.
fn record(folder: &Path) {
    let rig = fixture::rig();
    let mut log = McapSink::create(&folder.join("log.mcap"), &rig, "# rig", "frame = \"base\"").unwrap();
    let mut table = CsvSink::create(&folder.join("track.csv"), &rig, OutputFrame::Base).unwrap();
    let camera_from_base = rig.base.as_ref().unwrap().base_from_camera.inverse();
    let mut command = -40_i64;
    for seq in 0..1400_u64 {
        let mut estimate: Estimate = fixture::complete(seq, 4_000_000 + seq as i64 * 16_666_667);
        let stamp_ns = estimate.stamp.ns;
        let in_base = place((stamp_ns - START_NS) as f64 * 1e-9);
        estimate.markers[2].position = Ok(Position {
            point: camera_from_base * in_base,
            covariance: Matrix3::identity() * 1e-9,
            bound: Matrix3::zeros(),
        });
        estimate.host = Some(HostTime { stamp_ns: HOST_0 + stamp_ns, arrival_ns: HOST_0 + stamp_ns + 2_000_000 });
        while START_NS + command * PAUSE_NS < stamp_ns {
            // At rest before, one current a point from the first command on.
            let amperes = if command < 0 { 0.0 } else { 0.05 + 0.01 * (command as f64 * 0.0314).sin() };
            let host_ns = HOST_0 + START_NS + command * PAUSE_NS;
            let sample = CurrentSample { host_ns, arrival_ns: host_ns + 1, seq: None, current_a: vec![amperes] };
            log.write_current(&sample).unwrap();
            command += 1;
        }
        log.write(&estimate, None).unwrap();
        table.write(&estimate, None).unwrap();
    }
    log.finish(&Tally::default()).unwrap();
    table.finish(&Tally::default()).unwrap();
    let mut text = "x_mm,y_mm,z_mm\n".to_owned();
    for k in 0..200 {
        let p = place((k as f64 + 8.5) * PAUSE_NS as f64 * 1e-9) * 1e3;
        text += &format!("{},{},{}\n", p.x, p.y, p.z);
    }
    fs::write(folder.join("path.csv"), text).unwrap();
}

fn first_run(folder: &Path) -> serde_json::Value {
    let text = fs::read_to_string(folder.join("validation.json")).unwrap();
    serde_json::from_str::<serde_json::Value>(&text).unwrap()["runs"][0].clone()
}

#[test]
fn a_log_knows_its_start_and_its_table_gives_the_same_when_told() {
    let folder = tempfile::tempdir().unwrap();
    record(folder.path());
    let common = ["--desired", "path.csv", "--pause", "25ms", "-o"];
    let log = validate(folder.path(), &[&["log.mcap"], common.as_slice(), &["by_log"]].concat());
    assert!(log.status.success(), "{}", stderr(&log));
    let table = validate(folder.path(), &[&["track.csv", "--start", "2"], common.as_slice(), &["by_table"]].concat());
    assert!(table.status.success(), "{}", stderr(&table));
    let [log, table] = ["by_log", "by_table"].map(|name| first_run(&folder.path().join(name)));
    assert_eq!((&log["start_from"], &table["start_from"]), (&"currents".into(), &"given".into()));
    let both = |name: &str| [&log, &table].map(|run| run[name].as_f64().unwrap());
    for (name, expected, within) in [
        ("start_s", 2.0, 1e-6),
        ("magnitude_db", 0.0, 0.01),
        // 0.2 s of a period of 5 s.
        ("phase_deg", -14.4, 0.05),
        ("rotation_deg", 14.4, 0.05),
        ("rms_unaligned_mm", 24.0 * (7.2_f64).to_radians().sin(), 0.05),
        ("rms_aligned_mm", 0.0, 0.1),
        ("sd_mm", 0.0316, 1e-3),
    ] {
        let [a, b] = both(name);
        assert!((a - expected).abs() < within && (a - b).abs() < 1e-4, "{name}: {a} and {b}, expected {expected}");
    }
}

#[test]
fn without_a_start_it_is_searched_for_and_there_is_no_phase() {
    let folder = tempfile::tempdir().unwrap();
    record(folder.path());
    let args = ["track.csv", "--desired", "path.csv", "--pause", "25ms", "-o", "out"];
    let output = validate(folder.path(), &args);
    assert!(output.status.success(), "{}", stderr(&output));
    assert!(stderr(&output).contains("the start was found by correlation, which absorbs the lag: there is no phase"));
    let run = first_run(&folder.path().join("out"));
    assert_eq!((&run["start_from"], &run["phase_deg"]), (&"search".into(), &serde_json::Value::Null));
    assert!((run["start_s"].as_f64().unwrap() - 2.2).abs() < 0.03);
}

/// The bundled runs.
fn bundled(folder: &Path, more: &[&str]) -> Output {
    let [slow, fast, path] = ["20ms.csv", "5ms.csv", "circle.csv"].map(|name| data(name).display().to_string());
    let args = [slow.as_str(), &fast, "--desired", &path, "--pause", "20ms,5ms", "--start", "1.5"];
    validate(folder, &[args.as_slice(), more].concat())
}

#[test]
fn everything_is_written_and_an_earlier_result_is_replaced() {
    let folder = tempfile::tempdir().unwrap();
    for _ in 0..2 {
        let output = bundled(folder.path(), &["-o", "out"]);
        assert!(output.status.success(), "{}", stderr(&output));
        assert!(stdout(&output).starts_with("| Pause time (ms) | 5 | 20 |\n"), "{}", stdout(&output));
    }
    let mut names: Vec<String> = fs::read_dir(folder.path().join("out"))
        .unwrap()
        .map(|f| f.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort();
    let expected = [
        "points_20ms.csv",
        "points_5ms.csv",
        "report.html",
        "run.toml",
        "table.md",
        "validation.csv",
        "validation.json",
    ];
    assert_eq!(names, expected);
    let page = fs::read_to_string(folder.path().join("out/report.html")).unwrap();
    for part in
        ["plot-rms", "plot-errors", "plot-magnitude", "plot-phase", "plot-observed", "plot-aligned", "plot-circles"]
    {
        assert!(page.contains(&format!("id=\"{part}\"")), "{part}");
    }
    let quiet = bundled(folder.path(), &["-o", "out", "--quiet"]);
    assert!(quiet.status.success() && quiet.stdout.is_empty());
}

#[test]
fn a_model_is_drawn_beside_the_runs() {
    let folder = tempfile::tempdir().unwrap();
    for (model, name) in [("eq7", "Eq. 7"), ("lag.toml", "lag.toml")] {
        fs::write(folder.path().join("lag.toml"), "num = [1.0]\nden = [0.05, 1.0]\n").unwrap();
        let output = bundled(folder.path(), &["-o", "out", "--model", model]);
        assert!(output.status.success(), "{}", stderr(&output));
        let page = fs::read_to_string(folder.path().join("out/report.html")).unwrap();
        let plot = page.split("id=\"plot-magnitude\"").nth(1).unwrap();
        assert!(plot.contains(name), "{model}");
    }
    let output = bundled(folder.path(), &["-o", "out", "--model", "none.json"]);
    assert_eq!(output.status.code(), Some(2));
    assert!(stderr(&output).contains("none.json"), "{}", stderr(&output));
}

#[test]
fn a_report_of_another_command_is_not_written_over() {
    let folder = tempfile::tempdir().unwrap();
    fs::create_dir(folder.path().join("out")).unwrap();
    fs::write(folder.path().join("out/report.html"), "<!doctype html>").unwrap();
    let output = bundled(folder.path(), &["-o", "out"]);
    assert_eq!(output.status.code(), Some(2));
    assert!(stderr(&output).contains("out: has a report.html that this command did not write"), "{}", stderr(&output));
}

#[test]
fn wrong_usage_and_wrong_files_are_refused_before_anything_is_written() {
    let folder = tempfile::tempdir().unwrap();
    let [slow, path] = ["20ms.csv", "circle.csv"].map(|name| data(name).display().to_string());
    fs::write(folder.path().join("two.csv"), "x_mm,y_mm,z_mm\n0,0,0\n1,0,0\n").unwrap();
    fs::write(folder.path().join("line.csv"), "x_mm,y_mm,z_mm\n0,0,0\n1,0,0\n2,0,0\n3,0,0\n").unwrap();
    fs::write(folder.path().join("empty.csv"), "t_s,tip_x_mm,tip_y_mm,tip_z_mm\n").unwrap();
    fs::write(folder.path().join("missed.csv"), "t_s,tip_x_mm,tip_y_mm,tip_z_mm\n0,,,\n0.02,,,\n").unwrap();
    let refused = |args: &[&str], code: i32, words: &str| {
        let output = validate(folder.path(), &[args, &["-o", "out"]].concat());
        let said = stderr(&output);
        assert_eq!(output.status.code(), Some(code), "{said}");
        assert!(said.contains(words), "`{words}` is not in {said}");
        assert!(!folder.path().join("out").exists() && output.stdout.is_empty());
    };
    let desired = |path: &'static str| ["--desired", path, "--pause", "20ms", "--start", "1.5"];
    refused(
        &[&[slow.as_str()], desired("two.csv").as_slice()].concat(),
        2,
        "two.csv: has 2 points per period; a path needs 3",
    );
    refused(&[&[slow.as_str()], desired("line.csv").as_slice()].concat(), 2, "line.csv: its points lie on a line");
    refused(&[&[slow.as_str()], desired("none.csv").as_slice()].concat(), 2, "none.csv: ");
    let with = ["--desired", path.as_str(), "--start", "1.5", "--pause"];
    refused(&[&["none.csv"], with.as_slice(), &["20ms"]].concat(), 2, "none.csv: ");
    refused(&[&["empty.csv"], with.as_slice(), &["20ms"]].concat(), 2, "empty.csv: has no frame");
    refused(
        &[&["missed.csv"], with.as_slice(), &["20ms"]].concat(),
        3,
        "missed.csv: none of its 2 frames has a place of tip",
    );
    refused(&[&[slow.as_str()], with.as_slice(), &["0ms"]].concat(), 2, "`0ms` is not a time above 0");
    refused(&[&[slow.as_str()], with.as_slice(), &["20ms,5ms"]].concat(), 2, "1 run and 2 pause times");
    let starts = [slow.as_str(), &slow, &slow, "--desired", &path, "--pause", "20ms,20ms,20ms", "--start", "1,2"];
    refused(&starts, 2, "3 runs and 2 starts");
    let late = [slow.as_str(), "--desired", &path, "--pause", "20ms", "--start", "100"];
    refused(&late, 2, "the frames from 0.003 s to ");
    let other = [slow.as_str(), "--desired", &path, "--pause", "20ms", "--start", "1.5", "--marker", "coil"];
    refused(&other, 2, "has no marker `coil`; it has tip");
    let skip = [slow.as_str(), "--desired", &path, "--pause", "20ms", "--start", "1.5", "--skip", "4"];
    refused(&skip, 2, "nothing would be left");
}

/// numpy and scipy compute all of it anew, for all pause times of the paper.
#[test]
fn numpy_and_scipy_find_the_same_numbers() {
    let Some(python) = python::interpreter_with(&["numpy", "scipy"]) else { return };
    let folder = tempfile::tempdir().unwrap();
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/python/validate.py");
    let pauses = ["1", "3", "5", "8", "10", "12", "15", "18", "20", "25", "50", "100"];
    let run = |args: &[&str]| {
        let output = Command::new(&python).current_dir(folder.path()).arg(&script).args(args).output().unwrap();
        assert!(output.status.success(), "{}", stderr(&output));
        stdout(&output)
    };
    run(&[&["make", "runs"], pauses.as_slice()].concat());
    let files: Vec<String> = pauses.iter().map(|ms| format!("runs/{ms}ms.csv")).collect();
    let pauses_ms: Vec<String> = pauses.iter().map(|ms| format!("{ms}ms")).collect();
    let pauses_ms = pauses_ms.join(",");
    let files: Vec<&str> = files.iter().map(String::as_str).collect();
    let common = ["--desired", "runs/circle.csv", "--pause", &pauses_ms, "--start", "1.5", "-o", "out"];
    let output = validate(folder.path(), &[files.as_slice(), common.as_slice()].concat());
    assert!(output.status.success(), "{}", stderr(&output));
    assert_eq!(run(&["check", "runs", "out"]).lines().count(), pauses.len());
}
