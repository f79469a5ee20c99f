//! `catoptra live --studio`: pages that watch, and requests that must be refused, while a run goes on and loses nothing.

use crate::support::command::*;
use crate::support::studio::Studio;
use serde_json::{Value, json};
use std::collections::BTreeSet;
use std::process::Command;
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
