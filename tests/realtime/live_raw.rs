//! Raw pictures on a pipe, from a sender that keeps its own pace.

use crate::support::command::*;
use rustix::process::{Pid, Signal, kill_process};
use std::io::Write as _;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

const PERIOD: Duration = Duration::from_millis(100);
const AWAY: Duration = Duration::from_secs(3);

/// Whether a sender that is late sends what it has missed at once, or never.
#[derive(PartialEq)]
enum Missed {
    Sent,
    Lost,
}

/// Camera frames that a run counts as lost. `between` comes after the 20th of 50 pictures, which nobody waits for.
fn lost(missed: Missed, between: impl FnOnce(&Child) + Send + 'static) -> u64 {
    let place = Place::new();
    let [width, height] = rig().camera.size_px;
    let mut live = Command::new(env!("CARGO_BIN_EXE_catoptra"))
        .current_dir(place.folder.path())
        .args(["live", "-", "--raw", &format!("{width}x{height}:nv12@10"), "-o", "live", "--rig"])
        .arg(&place.rig)
        .stdin(Stdio::piped())
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut pipe = live.stdin.take().unwrap();
    let picture = vec![128; (width * height * 3 / 2) as usize];
    // Up to the first row it may take its time.
    pipe.write_all(&picture).unwrap();
    let began = Instant::now();
    while !place.path("live/track.csv").exists() {
        assert!(began.elapsed() < Duration::from_secs(60), "the run does not begin");
        std::thread::sleep(Duration::from_millis(20));
    }
    let mut between = Some(between);
    let mut began = Instant::now();
    for k in 1..50 {
        std::thread::sleep((PERIOD * k).saturating_sub(began.elapsed()));
        if k == 20
            && let Some(between) = between.take()
        {
            let stopped = Instant::now();
            between(&live);
            if missed == Missed::Lost {
                began += stopped.elapsed();
            }
        }
        pipe.write_all(&picture).unwrap();
    }
    drop(pipe);
    let output = live.wait_with_output().unwrap();
    // Grey pictures, in which nothing is to be found.
    ended_with(&output, 3);
    let table = Table::read(&place.path("live/track.csv"));
    assert_eq!(table.rows.len(), 50);
    table.rows.iter().map(|row| row["gap"].parse::<u64>().unwrap()).sum()
}

/// The pictures wait on the pipe: the sender lost none.
#[test]
fn a_process_that_was_stopped_and_continued_claims_no_lost_frames() {
    let stopped = lost(Missed::Sent, |live| {
        let pid = Pid::from_child(live);
        kill_process(pid, Signal::STOP).unwrap();
        std::thread::spawn(move || {
            std::thread::sleep(AWAY);
            kill_process(pid, Signal::CONT).unwrap();
        });
    });
    assert_eq!(stopped, 0, "the program itself stood still");
}

/// The same from outside, and yet another thing.
#[test]
fn a_sender_that_was_away_has_lost_frames() {
    let away = lost(Missed::Lost, |_| std::thread::sleep(AWAY));
    assert!((20..=35).contains(&away), "{away} frames of 30");
}

#[test]
fn a_sender_that_catches_up_has_lost_none() {
    let held_up = lost(Missed::Sent, |_| std::thread::sleep(AWAY / 3));
    assert_eq!(held_up, 0);
}

#[test]
fn a_run_without_a_single_frame_is_no_result() {
    let place = Place::new();
    let [width, height] = rig().camera.size_px;
    let mut live = Command::new(env!("CARGO_BIN_EXE_catoptra"))
        .current_dir(place.folder.path())
        .args(["live", "-", "--raw", &format!("{width}x{height}:nv12@10"), "--duration", "1", "-o", "live", "--rig"])
        .arg(&place.rig)
        .stdin(Stdio::piped())
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    // Open, and silent, as long as it runs.
    let pipe = live.stdin.take();
    let output = live.wait_with_output().unwrap();
    drop(pipe);
    let printed = ended_with(&output, 3);
    assert!(printed.contains("no frame was received"), "{printed}");
}
