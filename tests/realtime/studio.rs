//! `catoptra live --studio`: watching pages, and requests that must be refused, during a run that loses nothing.

use crate::support::command::*;
use crate::support::looped::looped;
use crate::support::studio::Studio;
use serde_json::{Value, json};
use std::collections::{BTreeMap, BTreeSet};
use std::hash::{Hash as _, Hasher as _};
use std::io::{Read as _, Write as _};
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// What one page that watches is shown until `until`.
fn watch(studio: &Studio, until: Instant) -> (BTreeSet<u64>, usize, Value) {
    let (mut rows, mut pictures, mut status) = (BTreeSet::new(), 0, Value::Null);
    let (mut after, mut seq) = (Value::Null, Value::Null);
    while Instant::now() < until {
        let shown = studio.json("watch", &json!({ "after": after, "currents_after": null }));
        for row in shown["rows"].as_array().unwrap() {
            assert!(rows.insert(row["seq"].as_u64().unwrap()), "row {} was shown twice", row["seq"]);
            after = row["seq"].clone();
        }
        status = shown["status"].clone();
        let picture = studio.ask("watch/picture", &json!({ "after": seq }));
        if picture.status == 200 {
            let picture = picture.json();
            assert!(picture["jpeg"].as_str().unwrap().len() > 1000);
            assert_eq!(picture["bands"].as_array().unwrap().len(), 3);
            pictures += 1;
            seq = picture["seq"].clone();
        }
        std::thread::sleep(Duration::from_millis(50));
    }
    (rows, pictures, status)
}

#[test]
fn a_live_run_is_watched_by_two_pages_and_attacked_and_loses_nothing() {
    let _alone = alone();
    let place = Place::new();
    let mut command = Command::new(env!("CARGO_BIN_EXE_catoptra"));
    command.current_dir(place.folder.path()).arg("live").arg(sample("planar.mkv")).args(["--realtime", "--rig"]);
    command.arg(&place.rig).args(["-o", "out", "--studio", "--record", "windows"]);
    let studio = Studio::of_live(command);
    let until = Instant::now() + Duration::from_secs(3);
    let shown = std::thread::scope(|scope| {
        let pages = [(); 2].map(|()| scope.spawn(|| watch(&studio, until)));
        studio.refuses_all();
        // What is not of a live run is not there.
        for name in ["list", "reel", "run", "teach/rig", "teach/save"] {
            let answer = studio
                .ask(name, &json!({ "folder": ".", "recording": "x", "known": 0, "run": "out", "rig": "rig.toml" }));
            assert!((400..500).contains(&answer.status), "{name}: {}", answer.status);
        }
        pages.map(|page| page.join().unwrap())
    });
    assert_eq!(studio.ended(), Some(0));
    let rows = place.table().rows.len();
    assert_eq!(rows, frames(&sample("planar.mkv")).len(), "a row for every frame");
    for (seen, pictures, status) in shown {
        println!("a page was shown {} of {rows} rows, {pictures} pictures; {status}", seen.len());
        assert!(seen.len() > 100 && pictures > 5, "{} rows, {pictures} pictures", seen.len());
        assert_eq!((&status["lost"], &status["unlogged"]), (&json!(0), &json!(0)));
    }
}

/// One of these tests at a time: each needs a processor of its own to lose nothing.
fn alone() -> MutexGuard<'static, ()> {
    static ALONE: Mutex<()> = Mutex::new(());
    ALONE.lock().unwrap_or_else(PoisonError::into_inner)
}

/// What tells the pictures of a recording apart, by their stamps.
fn pictures(path: &Path) -> BTreeMap<i64, u64> {
    let mut source = catoptra::source::open(path, Default::default()).unwrap();
    std::iter::from_fn(|| source.next_frame().unwrap())
        .map(|frame| {
            let mut hasher = std::hash::DefaultHasher::new();
            for plane in (0..3).map(|i| frame.picture.plane(i).unwrap()) {
                (0..plane.height).for_each(|y| plane.row(y).unwrap().hash(&mut hasher));
            }
            (frame.stamp.ns, hasher.finish())
        })
        .collect()
}

#[cfg(unix)]
#[test]
fn recording_is_begun_and_ended_by_the_page_each_stretch_whole_and_none_over_another() {
    let _alone = alone();
    let place = Place::new();
    let long = place.path("long.mkv");
    // Longer than it takes on a machine that is busy.
    looped(&sample("planar.mkv"), 6, &long);
    let mut command = Command::new(env!("CARGO_BIN_EXE_catoptra"));
    command.current_dir(place.folder.path()).arg("live").arg(&long).args(["--realtime", "--rig"]);
    command.arg(&place.rig).args(["-o", "out", "--studio"]);
    let studio = Studio::of_live(command);
    let turn = |on: bool, how: &str| studio.json("watch/record", &json!({ "on": on, "how": how }));
    let state = || studio.json("watch", &json!({ "after": null, "currents_after": null }))["status"].clone();
    let recorded = |least: u64| {
        let began = Instant::now();
        loop {
            let state = state();
            if state["pictures"][0].as_u64().unwrap_or(0) >= least {
                return state;
            }
            assert!(began.elapsed() < Duration::from_secs(8), "{state}");
            std::thread::sleep(Duration::from_millis(20));
        }
    };
    // Not without the key, and not in a way that there is none of.
    let body = json!({ "on": true, "how": "gif" });
    let refused = studio.ask("watch/record", &body);
    assert!(refused.status == 400 && String::from_utf8_lossy(&refused.body).contains("windows, ffv1, h264"));
    assert_eq!(state()["recording"]["on"], false);
    // The state is renewed every second; pictures that wait for the encoder are counted later.
    let settled = || {
        let mut before = state();
        loop {
            std::thread::sleep(Duration::from_millis(1200));
            let now = state();
            if now["pictures"] == before["pictures"] {
                return now;
            }
            before = now;
        }
    };
    let mut end = state();
    for how in ["ffv1", "windows", "ffv1"] {
        assert_eq!(turn(true, how)["on"], true);
        recorded(end["pictures"][0].as_u64().unwrap_or(0) + 20);
        assert_eq!(turn(false, how)["on"], false);
        end = settled();
    }
    let so_far = end["pictures"][0].as_u64().unwrap();
    println!("{end}");
    assert_eq!(end["recording"]["places"], json!(["pictures.mkv", "log.mcap", "pictures-2.mkv"]));
    assert_eq!(end["recording"]["problem"], Value::Null);
    assert_eq!(studio.interrupted(), Some(130));

    // As good as those of `--record`: without loss, with their stamps. (That none is left out: live_record.rs.)
    let played = pictures(&long);
    let mut whole = 0;
    let mut spans = Vec::new();
    for name in ["pictures.mkv", "pictures-2.mkv"] {
        let kept = pictures(&place.path("out").join(name));
        assert!(kept.len() >= 20, "{name} has {} pictures", kept.len());
        for (stamp_ns, picture) in &kept {
            assert_eq!(*picture, played[stamp_ns], "{name} at {stamp_ns}");
        }
        whole += kept.len() as u64;
        spans.push((*kept.keys().next().unwrap(), *kept.keys().last().unwrap()));
    }
    assert!(spans[0].1 < spans[1].0, "{spans:?}");
    // The windows are tracked again to the same rows; frames of other stretches say that they are not there.
    let mut again = Command::new(env!("CARGO_BIN_EXE_catoptra"));
    let output =
        again.current_dir(place.folder.path()).args(["track", "out/log.mcap", "-o", "again"]).output().unwrap();
    ended_with(&output, 0);
    let (live, again) = (place.table().rows, Table::read(&place.path("again/track.csv")).rows);
    assert_eq!(live.len(), again.len());
    let mut windows = 0;
    for (live, again) in live.iter().zip(&again) {
        assert_eq!(live["stamp_ns"], again["stamp_ns"]);
        if again["coil_status"] == "not_recorded" {
            continue;
        }
        windows += 1;
        // Where the recording begins again, every 5 s, the catheter jumps.
        let jumped = live["t_s"].parse::<f64>().unwrap() % 5.0 < 0.2;
        if jumped && [live, again].iter().any(|row| row["coil_status"] == "implausible_motion") {
            continue;
        }
        let [(a, b), (sd, _)] = ["coil_z_mm", "coil_sd_mm"].map(|name| {
            let number = |row: &std::collections::HashMap<String, String>| row[name].parse::<f64>().unwrap();
            (number(live), number(again))
        });
        // The tracker begins anew there: its memory of colours and blur is another.
        assert!((a - b).abs() < 3.0 * sd, "{a} and {b} ± {sd} mm at {}", live["stamp_ns"]);
    }
    println!("{whole} pictures whole, {windows} in windows");
    assert!(windows >= 20 && whole + windows >= so_far, "{whole} whole, {windows} in windows, {so_far} counted");
}

/// A sender that stops sending without an end: the last θ is not passed off as that of now.
#[cfg(unix)]
#[test]
fn a_source_that_falls_silent_is_told_of() {
    let _alone = alone();
    let place = Place::new();
    let mut command = Command::new("sh");
    let live = "(cat \"$1\"; sleep 8) | \"$2\" live - --rig \"$3\" -o out --studio";
    command.current_dir(place.folder.path()).args(["-c", live, "sh"]);
    command.arg(sample("rest.mkv")).arg(env!("CARGO_BIN_EXE_catoptra")).arg(&place.rig);
    let studio = Studio::of_live(command);
    let status = || studio.json("watch", &json!({ "after": null, "currents_after": null }))["status"].clone();
    let (began, mut silent_s) = (Instant::now(), Vec::new());
    while began.elapsed() < Duration::from_secs(6) {
        silent_s.push(status()["silent_s"].clone());
        std::thread::sleep(Duration::from_millis(100));
    }
    assert!(silent_s[0].is_null(), "{silent_s:?}");
    let last = silent_s.last().unwrap();
    assert!(last.as_f64().is_some_and(|s| (2.0..9.0).contains(&s)), "{last}");
    assert_eq!(studio.ended(), Some(0));
}

#[cfg(unix)]
#[test]
fn two_pages_in_a_browser_watch_and_record_and_no_row_is_lost() {
    let _alone = alone();
    let Some((browser, python)) = crate::support::browser::browser_and_python() else { return };
    let place = Place::new();
    let long = place.path("long.mkv");
    // Longer than pages take to open on a machine that is busy.
    looped(&sample("planar.mkv"), 24, &long);
    // The browser is there before the run begins: it takes its time on a busy machine.
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/python/studio_watch.py");
    let mut watcher = Command::new(python)
        .arg(script)
        .args([browser.as_str(), "-", "--record", "--seconds", "3"])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut ready = [0; 6];
    watcher.stdout.as_mut().unwrap().read_exact(&mut ready).unwrap();
    assert_eq!(&ready, b"ready\n");
    let mut command = Command::new(env!("CARGO_BIN_EXE_catoptra"));
    command.current_dir(place.folder.path()).arg("live").arg(&long).args(["--realtime", "--rig"]);
    command.arg(&place.rig).args(["-o", "out", "--studio"]);
    let studio = Studio::of_live(command);
    writeln!(watcher.stdin.take().unwrap(), "{}", studio.url()).unwrap();
    let output = watcher.wait_with_output().unwrap();
    println!("{}", stdout(&output));
    ended_with(&output, 0);
    assert_eq!(studio.interrupted(), Some(130));
    let rows = place.table().rows;
    assert!(rows.len() > 180, "{} rows", rows.len());
    for (seq, row) in rows.iter().enumerate() {
        assert_eq!((row["seq"].as_str(), row["gap"].as_str()), (&*seq.to_string(), "0"), "a row for every frame");
    }
    assert!(!logged(&place.path("out/log.mcap")).is_empty());
}
