//! A new user's experience: results in the requested place, nothing lost, and clear messages where something cannot
//! work.

use crate::support::command::*;
use catoptra::rig::Rig;
use std::collections::BTreeMap;
use std::path::Path;
use std::process::{Command, Output};

fn catoptra(place: &Place, args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_catoptra")).current_dir(place.folder.path()).args(args).output().unwrap()
}

fn in_repository(name: &str) -> String {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(name).to_str().unwrap().to_owned()
}

#[test]
fn a_dash_puts_the_table_on_stdout_and_the_summary_aside() {
    let place = Place::new();
    let output = place.track(&sample("rest.mkv"), &["--csv=-", "--to", "0.1"]);
    let said = ended_with(&output, 0);
    let table = stdout(&output);
    let rows: Vec<&str> = table.lines().collect();
    assert!(rows[0].starts_with("seq,t_s,stamp_ns,") && rows[1].starts_with("0,") && rows.len() == 8, "{table}");
    assert!(said.contains("results in out") && said.contains("stdout"), "{said}");
    assert!(!place.path("-").exists() && !place.path("out/track.csv").exists());
}

#[test]
fn a_rig_with_one_view_is_refused_with_what_it_lacks() {
    let mut rig = rig();
    rig.views.truncate(1);
    let place = Place::with(&rig);
    let words = ["one view, `direct`", "needs two"];
    let runs: [(&[&str], i32); 3] = [
        (&["track", "none.mkv", "--rig", "rig.toml"], 2),
        (&["live", "-", "--rig", "rig.toml"], 2),
        (&["rig", "check", "rig.toml"], 3),
    ];
    for (args, code) in runs {
        let said = ended_with(&catoptra(&place, args), code);
        assert!(words.iter().all(|word| said.contains(word)), "{args:?}: {said}");
    }
}

#[test]
fn every_frame_is_told_when_that_is_asked_for() {
    let place = Place::new();
    let said = |args: &[&str]| stderr(&place.track(&sample("rest.mkv"), &[&["--to", "0.05"], args].concat()));
    let (plain, once, twice) = (said(&[]), said(&["-v"]), said(&["-vv"]));
    assert!(!plain.contains("1280x1024") && once.contains("frames of 1280x1024 pixels"), "{once}");
    assert!(!once.contains("frame 2 at") && twice.contains("frame 2 at 0.033 s: θ "), "{twice}");
}

#[test]
fn no_rig_is_ever_lost() {
    let place = Place::new();
    let finished = std::fs::read_to_string(&place.rig).unwrap();
    let mut before = finished.clone();
    for (camera, backup) in
        [("ros.yaml", "rig.toml.bak"), ("opencv4.yml", "rig.toml.bak2"), ("ros.yaml", "rig.toml.bak3")]
    {
        let camera = in_repository(&format!("tests/data/cameras/{camera}"));
        let output = catoptra(&place, &["rig", "import", &camera, "--out", "rig.toml"]);
        ended_with(&output, 0);
        let said = stdout(&output);
        assert!(
            said.contains("written: rig.toml") && said.contains(&format!("{backup} (the rig as it was)")),
            "{said}"
        );
        assert_eq!(std::fs::read_to_string(place.path(backup)).unwrap(), before, "{backup}");
        before = std::fs::read_to_string(&place.rig).unwrap();
    }
    assert_eq!(std::fs::read_to_string(place.path("rig.toml.bak")).unwrap(), finished);
    // The same once more changes nothing: there is nothing to keep.
    let camera = in_repository("tests/data/cameras/ros.yaml");
    let said = ended_with(&catoptra(&place, &["rig", "import", &camera, "--out", "rig.toml"]), 0);
    assert!(!said.contains("as it was") && !place.path("rig.toml.bak4").exists(), "{said}");
}

#[test]
fn export_says_what_it_wrote() {
    let place = Place::new();
    for (format, what) in [("opencv", "the camera as OpenCV YAML"), ("ros", "the camera as ROS camera_info")] {
        let output = catoptra(&place, &["rig", "export", "rig.toml", "--format", format, "-o", "made"]);
        ended_with(&output, 0);
        let said = stdout(&output);
        assert!(said.contains(&format!("written: made, {what}")), "{said}");
    }
}

#[test]
fn shells_and_manuals_know_every_command() {
    let place = Place::new();
    for shell in ["bash", "zsh", "fish"] {
        let output = catoptra(&place, &["completions", shell]);
        ended_with(&output, 0);
        let script = stdout(&output);
        assert!(script.contains("from-markers") && script.contains("realtime"), "{shell}: {script}");
    }
    ended_with(&catoptra(&place, &["man", "man1"]), 0);
    let page = std::fs::read_to_string(place.path("man1/catoptra-track.1")).unwrap();
    assert!(page.contains("tick\\-led") && page.contains("Example:"), "{page}");
    assert!(place.path("man1/catoptra.1").exists() && place.path("man1/catoptra-calibrate-rig.1").exists());
}

#[test]
fn a_page_says_when_and_how_it_was_made() {
    let place = Place::new();
    ended_with(&place.track(&sample("rest.mkv"), &["--to", "0.02"]), 0);
    let page = std::fs::read_to_string(place.path("out/report.html")).unwrap();
    assert!(page.contains("<td>Command</td><td>catoptra track "), "no command line");
    assert!(page.contains("<td>Made</td><td>20") && page.contains(" UTC</td>"), "no date");
}

/// A live run replaces nothing: who follows the README, the documentation and the help in one folder must get through.
#[test]
fn examples_of_live_runs_have_folders_of_their_own() {
    let help = Command::new(env!("CARGO_BIN_EXE_catoptra")).args(["live", "--help"]).output().unwrap();
    let mut texts = BTreeMap::from([("live --help".to_owned(), stdout(&help))]);
    for name in ["README.md", "docs/live.md", "docs/log.md", "docs/identify.md"] {
        texts.insert(name.to_owned(), std::fs::read_to_string(in_repository(name)).unwrap());
    }
    let mut folders: BTreeMap<String, String> = BTreeMap::new();
    for (name, text) in texts {
        let text = text.replace("\\\n", " ");
        for example in text.lines().filter(|line| line.trim_start().starts_with("catoptra live")) {
            let mut words = example.split_whitespace();
            let Some(folder) = words.find(|word| *word == "-o").and_then(|_| words.next()) else { continue };
            let taken = folders.insert(folder.to_owned(), name.clone());
            assert!(taken.is_none(), "{folder} is written by {} and by {name}", taken.unwrap());
        }
    }
    assert!(folders.len() >= 3, "{folders:?}");
}

#[test]
fn the_rig_of_a_refused_run_is_still_a_rig() {
    let place = Place::new();
    let before = std::fs::read_to_string(&place.rig).unwrap();
    let said = ended_with(&catoptra(&place, &["rig", "import", "none.yaml", "--out", "rig.toml"]), 2);
    assert!(said.contains("none.yaml"), "{said}");
    assert_eq!(std::fs::read_to_string(&place.rig).unwrap(), before);
    assert!(Rig::load(&place.rig).is_ok() && !place.path("rig.toml.bak").exists());
}

/// Every topic that the layout for Foxglove names is in a log.
#[test]
fn the_layout_for_foxglove_fits_a_log() {
    let place = Place::new();
    ended_with(&place.track(&sample("rest.mkv"), &["--to", "0.02"]), 0);
    let bytes = std::fs::read(place.path("out/log.mcap")).unwrap();
    let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
    let topics: Vec<&str> = summary.channels.values().map(|channel| channel.topic.as_str()).collect();
    let layout: serde_json::Value =
        serde_json::from_str(&std::fs::read_to_string(in_repository("docs/foxglove.json")).unwrap()).unwrap();
    let mut named = Vec::new();
    collect_topics(&layout["configById"], &mut named);
    assert!(named.len() >= 5, "{named:?}");
    for name in named {
        assert!(topics.contains(&name.as_str()), "{name} is not among {topics:?}");
    }
    // The annotations have a picture to lie on: of their own time, as large as they count.
    assert!(summary.chunk_indexes.iter().all(|chunk| chunk.compression == "zstd"));
    let messages: Vec<_> = mcap::MessageStream::new(&bytes).unwrap().map(Result::unwrap).collect();
    let of = |topic: &'static str| messages.iter().filter(move |message| message.channel.topic == topic);
    let image = of("/camera/image").next().unwrap();
    assert!(of("/camera/annotations").any(|annotations| annotations.publish_time == image.publish_time));
    let jpeg = image.data.windows(3).position(|start| start == [0xff, 0xd8, 0xff]).unwrap();
    let read = image::load_from_memory(&image.data[jpeg..]).unwrap();
    assert_eq!([read.width(), read.height()], rig().camera.size_px);
    // Panels that the layout arranges are there.
    let arranged = serde_json::to_string(&layout["layout"]).unwrap();
    for panel in layout["configById"].as_object().unwrap().keys() {
        assert!(arranged.contains(panel), "{panel} is not shown");
    }
}

/// Names of topics in keys and values: `/topic` or `/topic.field`.
fn collect_topics(value: &serde_json::Value, topics: &mut Vec<String>) {
    let mut take = |text: &str| {
        if text.starts_with('/') {
            topics.push(text.split('.').next().unwrap().to_owned());
        }
    };
    match value {
        serde_json::Value::String(text) => take(text),
        serde_json::Value::Array(list) => list.iter().for_each(|item| collect_topics(item, topics)),
        serde_json::Value::Object(map) => {
            map.keys().for_each(|key| take(key));
            map.values().for_each(|item| collect_topics(item, topics));
        }
        _ => {}
    }
}
