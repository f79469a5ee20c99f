//! Ctrl-C in the middle of `catoptra track`: all results so far are safely written.

#![cfg(unix)]

use crate::support::command;
use crate::support::command::*;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

fn interrupted_by(signal: &str) {
    let place = Place::new();
    let mut command = place.command(&sample("planar.mkv"));
    let child = command.arg("--overlay").stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let table = place.path("out/track.csv");
    let began = Instant::now();
    while std::fs::read_to_string(&table).map_or(0, |text| text.lines().count()) < 10 {
        assert!(began.elapsed() < Duration::from_secs(60), "no rows after a minute");
        std::thread::sleep(Duration::from_millis(5));
    }
    assert!(command::signal(&child, signal));
    let output = child.wait_with_output().unwrap();
    let said = ended_with(&output, 130);

    let frames = place.frames_in_all_files();
    assert!((9..300).contains(&frames), "{frames} frames");
    assert_eq!(command::frames(&place.path("out/overlay.mp4")).len(), frames);
    let last_s = *place.table().numbers("t_s").last().unwrap();
    let printed = format!("{frames} frames tracked and written, the last one at {last_s} s");
    assert!(said.contains("interrupted: ") && said.contains(&printed), "{printed} is not in {said}");
    assert!(stdout(&output).contains(&format!("{frames} frames, 0.000 s to ")), "{}", stdout(&output));
}

#[test]
fn ctrl_c_keeps_what_is_done() {
    interrupted_by("INT");
}

#[test]
fn so_does_the_signal_that_services_are_stopped_with() {
    interrupted_by("TERM");
}

#[test]
fn of_many_recordings_those_that_are_finished_stay_and_resume_goes_on() {
    let place = Place::new();
    let [rest, planar] = ["rest.mkv", "planar.mkv"].map(sample);
    let lines = format!("recording\toptions\n{}\t--to 0\n{}\t--to 2\n", rest.display(), planar.display());
    std::fs::write(place.path("runs.tsv"), lines).unwrap();
    let command = || {
        let mut command = Command::new(env!("CARGO_BIN_EXE_catoptra"));
        command.current_dir(place.folder.path()).args(["track", "--manifest", "runs.tsv", "--rig", "rig.toml"]);
        command.args(["-o", "runs", "--jobs", "1", "--resume"]);
        command
    };
    let child = command().stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let table = place.path("runs/planar/track.csv");
    let began = Instant::now();
    while std::fs::read_to_string(&table).map_or(0, |text| text.lines().count()) < 5 {
        assert!(began.elapsed() < Duration::from_secs(60), "no rows after a minute");
        std::thread::sleep(Duration::from_millis(5));
    }
    assert!(signal(&child, "INT"));
    let said = ended_with(&child.wait_with_output().unwrap(), 130);
    assert!(said.contains("interrupted: 1 of 2 recordings are done; --resume goes on"), "{said}");
    assert!(place.path("runs/rest/summary.json").exists() && !place.path("runs/planar/summary.json").exists());
    let plan = command().arg("--dry-run").output().unwrap();
    assert!(
        stdout(&plan).starts_with("leave\trest\tdone\ntrack\tplanar\tbegun and not finished\n"),
        "{}",
        stdout(&plan)
    );
}
