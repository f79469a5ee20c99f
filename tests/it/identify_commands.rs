//! What `catoptra identify` says about commands: their clock, their unit, and how often they were logged.

use crate::support::random::Random;
use std::f64::consts::TAU;
use std::fmt::Write as _;
use std::fs;
use std::path::Path;
use std::process::Command;

const COMMANDS: usize = 2460;
const FRAMES: usize = 2390;

fn current_a(command: usize) -> f64 {
    let t = command as f64 / 60.0;
    0.1 * (TAU * (0.2 * t + 1.9 * t * t / 41.0)).sin()
}

/// A pendulum of 6 rad/s, driven by commands at 60 Hz and seen at 59.97 Hz: a record, its table of currents, of which
/// only every so many rows are told, and the input and output of every command. The camera's clock is fast by `ppm`.
fn record(folder: &Path, ppm: f64, rows: usize, unit: f64) {
    record_with(folder, ppm, (rows, unit), 0.0);
}

/// The same with frames that are early or late by up to `uneven` periods.
fn record_with(folder: &Path, ppm: f64, (rows, unit): (usize, f64), uneven: f64) {
    const STEPS: usize = 60;
    let step_s = 1.0 / (60.0 * STEPS as f64);
    let mut random = Random::new(1);
    let (mut angle, mut speed) = (0.0_f64, 0.0_f64);
    let mut seen = "seq,t_s,stamp_ns,theta_deg,theta_sd_deg,gap\n".to_owned();
    let (mut currents, mut single) = ("t_s,axial_a\n".to_owned(), "t,u,y\n".to_owned());
    let mut frame = 0;
    for command in 0..COMMANDS {
        let t = command as f64 / 60.0;
        if command % rows == 0 {
            writeln!(currents, "{t:.6},{:.6}", unit * current_a(command)).unwrap();
        }
        let noisy = angle.to_degrees() + 0.11 * random.normal();
        writeln!(single, "{t:.6},{:.6},{noisy:.6}", current_a(command / rows * rows)).unwrap();
        for step in 0..STEPS {
            let at_s = 0.0123 + (frame as f64 + uneven * (2.0 * frame as f64).sin()) / 59.97;
            if t + step as f64 * step_s >= at_s && frame < FRAMES {
                let (theta, clock_s) = (angle.to_degrees() + 0.11 * random.normal(), at_s * (1.0 + 1e-6 * ppm));
                writeln!(seen, "{frame},{clock_s:.9},{:.0},{theta:.6},0.11,0", 1e9 * clock_s).unwrap();
                frame += 1;
            }
            speed += step_s * (108.0 * current_a(command) - 3.6 * speed - 36.0 * angle);
            angle += step_s * speed;
        }
    }
    fs::write(folder.join("run.csv"), seen).unwrap();
    fs::write(folder.join("currents.csv"), currents).unwrap();
    fs::write(folder.join("single.csv"), single).unwrap();
}

/// What is said about a record.
fn told(folder: &Path, args: &[&str]) -> String {
    let mut program = Command::new(env!("CARGO_BIN_EXE_catoptra"));
    program.current_dir(folder).arg("identify").args(args);
    let output = program.args(["--order", "2", "--nk", "1", "--bootstrap", "0", "-o", "out"]).output().unwrap();
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{text}");
    fs::remove_dir_all(folder.join("out")).unwrap();
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

const CURRENT: [&str; 5] = ["run.csv", "--input", "current", "--currents", "currents.csv"];
const SINGLE: [&str; 7] = ["single.csv", "--input", "u", "--output", "y", "--time", "t"];

#[test]
fn a_clock_that_drifts_is_told() {
    let folder = tempfile::tempdir().unwrap();
    record(folder.path(), -300.0, 1, 1.0);
    let drifts = told(folder.path(), &CURRENT);
    assert!(drifts.contains("the clock of the currents seems to run"), "{drifts}");
    record(folder.path(), 0.0, 1, 1.0);
    let same = told(folder.path(), &CURRENT);
    assert!(!same.contains("the clock of the currents") && !same.contains("mA?"), "{same}");
}

/// What is estimated for even frames alone is not skipped in silence.
#[test]
fn uneven_frames_are_said_not_to_tell_the_delay() {
    let folder = tempfile::tempdir().unwrap();
    let resampled = [&CURRENT[..], &["--resample"]].concat();
    record_with(folder.path(), 0.0, (1, 1.0), 0.3);
    let uneven = told(folder.path(), &resampled);
    assert!(uneven.contains("frames are not evenly spaced, from which neither the delay"), "{uneven}");
    record(folder.path(), 0.0, 1, 1.0);
    let even = told(folder.path(), &resampled);
    assert!(!even.contains("not evenly spaced"), "{even}");
}

#[test]
fn milliamperes_are_asked_about_without_a_plant() {
    let folder = tempfile::tempdir().unwrap();
    record(folder.path(), 0.0, 1, 1e3);
    let milli = told(folder.path(), &CURRENT);
    assert!(milli.contains("holds currents of up to 100 A") && milli.contains("are these mA?"), "{milli}");
}

#[test]
fn a_log_that_is_slower_than_the_frames_is_told() {
    let folder = tempfile::tempdir().unwrap();
    record(folder.path(), 0.0, 6, 1.0);
    let slow = told(folder.path(), &CURRENT);
    assert!(slow.contains("currents come every 0.100 s and frames every 0.017 s"), "{slow}");
    let stairs = told(folder.path(), &SINGLE);
    assert!(stairs.contains("the input keeps each value for 6 rows, again and again"), "{stairs}");
    record(folder.path(), 0.0, 1, 1.0);
    let quick = told(folder.path(), &CURRENT);
    assert!(!quick.contains("currents come every"), "{quick}");
    let quick = told(folder.path(), &SINGLE);
    assert!(!quick.contains("again and again"), "{quick}");
    // A camera that gives every fourth output, which the log repeats.
    let table = fs::read_to_string(folder.path().join("single.csv")).unwrap();
    let mut kept = String::new();
    let held = table.lines().enumerate().map(|(k, line)| {
        let (rest, y) = line.rsplit_once(',').unwrap();
        if k < 2 || k % 4 == 1 {
            y.clone_into(&mut kept);
        }
        format!("{rest},{kept}\n")
    });
    let held: String = held.collect();
    fs::write(folder.path().join("single.csv"), held).unwrap();
    let slow = told(folder.path(), &SINGLE);
    assert!(
        slow.contains("the output keeps each value for 4 rows, again and again: it seems to be measured"),
        "{slow}"
    );
}

/// What the amplifier was told meanwhile is not known: σ of noise would be too small.
#[test]
fn commands_that_are_lacking_leave_no_sigma() {
    let folder = tempfile::tempdir().unwrap();
    record(folder.path(), 0.0, 1, 1.0);
    let whole = told(folder.path(), &CURRENT);
    assert!(!whole.contains("is the table complete?") && !whole.contains("since the problems reported"), "{whole}");
    let table = fs::read_to_string(folder.path().join("currents.csv")).unwrap();
    let rows: Vec<&str> = table.split_inclusive('\n').collect();
    fs::write(folder.path().join("currents.csv"), rows[..1000].concat() + &rows[1150..].concat()).unwrap();
    let cut = told(folder.path(), &CURRENT);
    assert!(cut.contains("is the table complete?") && cut.contains("has no σ, since the problems reported"), "{cut}");
    // A few holes of a tenth of a second.
    let rest = (0..rows.len()).filter(|row| *row < 500 || row % 500 >= 6).map(|row| rows[row]);
    fs::write(folder.path().join("currents.csv"), rest.collect::<String>()).unwrap();
    let few = told(folder.path(), &CURRENT);
    assert!(
        few.contains("24 rows seem to be lacking") && few.contains("has no σ, since the problems reported"),
        "{few}"
    );
}

/// Of a run that was begun before the camera, the system is not taken to be at rest where frames begin.
#[test]
fn frames_that_begin_while_it_moves_are_not_taken_to_begin_at_rest() {
    let folder = tempfile::tempdir().unwrap();
    record(folder.path(), 0.0, 1, 1.0);
    let file = folder.path().join("run.csv");
    let whole = fs::read_to_string(&file).unwrap();
    let later: Vec<&str> = whole.lines().enumerate().filter(|(k, _)| !(1..600).contains(k)).map(|(_, l)| l).collect();
    fs::write(&file, later.join("\n")).unwrap();
    let mut program = Command::new(env!("CARGO_BIN_EXE_catoptra"));
    let args = ["--order", "2", "--nk", "1", "--bootstrap", "0", "-o", "out"];
    let status = program.current_dir(folder.path()).arg("identify").args(CURRENT).args(args).status().unwrap();
    assert!(status.success());
    let model: serde_json::Value =
        serde_json::from_slice(&fs::read(folder.path().join("out/model.json")).unwrap()).unwrap();
    let values = |name: &str| -> Vec<f64> {
        let all = model["refined"]["continuous"][name].as_array().unwrap_or_else(|| panic!("no {name}"));
        all.iter().map(|v| v.as_f64().unwrap()).collect()
    };
    let (found, sd) = (values("den"), values("den_standard_errors"));
    for ((found, sd), truth) in found.iter().zip(&sd).zip([1.0, 3.6, 36.0]).skip(1) {
        assert!((found - truth).abs() < 5.0 * sd && *sd < 0.01 * truth, "{found} ± {sd}, {truth}");
    }
}
