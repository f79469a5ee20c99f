//! `--record windows`: the windows are all that the tracker needs, and tracking a log with them again gives the same
//! numbers.

use crate::support::command::*;
use catoptra::estimate::{Estimate, Miss};
use catoptra::pipeline::{self, End};
use catoptra::rig::Rig;
use catoptra::sink::{CsvSink, McapSink, OutputFrame, Sink};
use catoptra::source::{
    CurrentSample, Frame, FrameSource, LogWindows, Picture, SourceError, Span, VideoFile, VideoOptions, Window,
    open_to_track,
};
use catoptra::tally::Tally;
use catoptra::track::{TrackOptions, Tracker};
use std::path::Path;
use std::sync::atomic::AtomicBool;

fn recording(name: &str, to_ns: i64) -> VideoFile {
    let span = Span { from_ns: None, to_ns: Some(to_ns) };
    VideoFile::open(sample(name), VideoOptions { span, ..VideoOptions::default() }).unwrap()
}

fn tracker() -> Tracker {
    Tracker::new(&rig(), TrackOptions::default()).unwrap()
}

/// The same picture where it is recorded, and something else everywhere else.
fn with_rubbish_outside(picture: &Picture, there: &[Window], seed: u8) -> Picture {
    let [width, height] = picture.size_px();
    let planes = (0..3).map(|i| {
        let plane = picture.plane(i).unwrap();
        let mut samples = Vec::with_capacity(plane.width * plane.height);
        for (y, x) in (0..plane.height).flat_map(|y| (0..plane.width).map(move |x| (y, x))) {
            let (px, py) = (x as u32 * plane.scale[0], y as u32 * plane.scale[1]);
            let known = there.iter().any(|w| (w.x0..w.x1).contains(&px) && (w.y0..w.y1).contains(&py));
            let rubbish = (x as u8).wrapping_mul(37) ^ (y as u8).wrapping_mul(91) ^ seed;
            samples.push(if known { plane.row(y).unwrap()[x * plane.step] } else { rubbish });
        }
        samples
    });
    let copy = Picture::from_planes(width, height, picture.format(), picture.colour(), planes.collect());
    copy.unwrap().of_parts(there.to_vec()).quantised(picture.quantisation().cloned())
}

/// To the last bit: numbers are written so that they read back the same.
fn written(estimate: &Estimate) -> String {
    format!("{estimate:?}")
}

#[test]
fn a_log_brings_the_lamp_that_was_watched() {
    let place = Place::new();
    let options = ["--to", "0.3", "--record", "windows", "--tick-led", "110,110,6"];
    ended_with(&place.track(&sample("planar.mkv"), &options), 0);
    let again = std::process::Command::new(env!("CARGO_BIN_EXE_catoptra"))
        .current_dir(place.folder.path())
        .args(["track", "out/log.mcap", "-o", "again"])
        .output()
        .unwrap();
    ended_with(&again, 0);
    let (first, again) = (place.table().rows, Table::read(&place.path("again/track.csv")).rows);
    assert!(first[0].contains_key("tick") && first == again, "{first:?}\n{again:?}");
}

#[test]
fn what_lies_outside_of_what_was_looked_at_changes_nothing() {
    for name in ["planar.mkv", "circle.mkv"] {
        let mut source = recording(name, 250_000_000);
        let (mut with_all, mut with_parts) = (tracker(), tracker());
        let mut smallest = u64::MAX;
        while let Some(frame) = source.next_frame().unwrap() {
            let expected = written(&with_all.step(&frame).unwrap());
            let there = frame.picture.windows_read(0);
            smallest = smallest.min(there.iter().map(Window::pixels).sum());
            let picture = with_rubbish_outside(&frame.picture, &there, frame.seq as u8);
            let found = with_parts.step(&Frame { picture, ..frame }).unwrap();
            assert_eq!(written(&found), expected, "{name}");
        }
        // Else it would prove nothing.
        assert!(smallest < 1280 * 1024 / 10, "{smallest} pixels");
    }
}

#[test]
fn a_picture_that_lacks_what_the_tracker_wants_is_a_miss_and_never_made_up() {
    let mut frames = recording("planar.mkv", 100_000_000);
    let (mut tracker, mut seen) = (tracker(), Vec::new());
    for take_away in [None, Some(0), Some(usize::MAX), None] {
        let frame = frames.next_frame().unwrap().unwrap();
        let mut parts = tracker_windows(&frame);
        if let Some(which) = take_away {
            parts.remove(which.min(parts.len() - 1));
        }
        let picture = with_rubbish_outside(&frame.picture, &parts, 5);
        seen.push(tracker.step(&Frame { picture, ..frame }).unwrap());
    }
    let complete = |e: &Estimate| e.markers.iter().all(|m| m.position.is_ok()) && e.tangent.is_ok();
    let not_recorded = |e: &Estimate| e.markers.iter().any(|m| matches!(m.position, Err(Miss::NotRecorded)));
    assert!(complete(&seen[0]) && complete(&seen[3]));
    assert!(not_recorded(&seen[1]), "{:?}", seen[1].markers);
    assert!(not_recorded(&seen[2]), "{:?}", seen[2].markers);
}

/// The tracker then looks further around than what was recorded.
#[test]
fn right_after_pictures_that_were_not_recorded_bands_are_found_in_what_was() {
    let mut source = recording("planar.mkv", 400_000_000);
    let (mut with_all, mut with_parts) = (tracker(), tracker());
    while let Some(frame) = source.next_frame().unwrap() {
        with_all.step(&frame).unwrap();
        let lacks = (5..13).contains(&frame.seq);
        let there = if lacks { Vec::new() } else { frame.picture.windows_read(0) };
        let picture = with_rubbish_outside(&frame.picture, &there, 3);
        let seq = frame.seq;
        let found = with_parts.step(&Frame { picture, ..frame }).unwrap();
        assert!(found.markers.iter().all(|marker| marker.position.is_err() == lacks), "{seq}: {:?}", found.markers);
    }
}

/// Four parts that make up the picture.
fn tracker_windows(frame: &Frame) -> Vec<Window> {
    let [w, h] = frame.picture.size_px();
    let window = |x0, y0, x1, y1| Window { x0, y0, x1, y1 };
    vec![window(0, h / 2, w / 2, h), window(0, 0, w / 2, h / 2), window(w / 2, 0, w, h / 2), window(w / 2, h / 2, w, h)]
}

/// Tracks `source` into a table, and into a log that keeps windows if wanted.
fn run(source: Box<dyn FrameSource + Send>, rig: &Rig, table: &Path, log: Option<&Path>) -> End {
    let mut sinks: Vec<Box<dyn Sink + Send>> = vec![Box::new(CsvSink::create(table, rig, OutputFrame::Base).unwrap())];
    if let Some(log) = log {
        let sink = McapSink::create(log, rig, "", "").unwrap();
        sinks.push(Box::new(sink.with_windows()));
    }
    let mut tracker = Tracker::new(rig, TrackOptions::default()).unwrap();
    let summary = pipeline::run(source, &mut tracker, sinks, &AtomicBool::new(false), |_| {}).unwrap();
    assert!(summary.sink_failures.is_empty(), "{:?}", summary.sink_failures);
    summary.end
}

#[test]
fn a_log_with_windows_is_tracked_again_to_the_same_table() {
    let place = tempfile::tempdir().unwrap();
    let [first, again, log] = ["first.csv", "again.csv", "log.mcap"].map(|name| place.path().join(name));
    let rig = rig();
    run(Box::new(recording("circle.mkv", i64::MAX)), &rig, &first, Some(&log));
    let source = open_to_track(&log, Default::default()).unwrap();
    assert_eq!(source.size_px(), [1280, 1024]);
    assert!(matches!(run(source, &rig, &again, None), End::Complete));
    let [first, again] = [first, again].map(|path| std::fs::read_to_string(path).unwrap());
    assert_eq!(first.lines().count(), 121);
    assert_eq!(first, again);
    let bytes = std::fs::metadata(&log).unwrap().len();
    assert!(bytes < 120 * 50_000, "{bytes} bytes");
}

/// A live run's recording: coil currents come between the frames, and after the last.
struct WithCurrents {
    frames: VideoFile,
    given: u64,
}

impl FrameSource for WithCurrents {
    fn next_frame(&mut self) -> Result<Option<Frame>, SourceError> {
        self.frames.next_frame()
    }

    fn size_px(&self) -> [u32; 2] {
        self.frames.size_px()
    }

    fn currents(&mut self) -> Vec<CurrentSample> {
        self.given += 1;
        let sample = |seq: u64| {
            let host_ns = seq as i64 * 5_000_000;
            CurrentSample { host_ns, arrival_ns: host_ns + 1, seq: Some(seq), current_a: vec![0.1, seq as f64] }
        };
        (2 * self.given - 2..2 * self.given).map(sample).collect()
    }
}

#[test]
fn the_currents_of_a_log_are_in_the_log_of_its_second_tracking() {
    let place = tempfile::tempdir().unwrap();
    let [first, again, table] = ["first.mcap", "again.mcap", "table.csv"].map(|name| place.path().join(name));
    let source = WithCurrents { frames: recording("planar.mkv", 200_000_000), given: 0 };
    run(Box::new(source), &rig(), &table, Some(&first));
    run(open_to_track(&first, Default::default()).unwrap(), &rig(), &table, Some(&again));
    let currents = |log: &Path| -> Vec<(u64, u64, Vec<u8>)> {
        let bytes = std::fs::read(log).unwrap();
        let messages = mcap::MessageStream::new(&bytes).unwrap().map(Result::unwrap);
        let of_coils = messages.filter(|message| message.channel.topic == "/coil/current");
        of_coils.map(|message| (message.log_time, message.publish_time, message.data.into_owned())).collect()
    };
    let [first, again] = [first, again].map(|log| currents(&log));
    assert_eq!((first.len(), first == again), (28, true), "{} again", again.len());
}

/// A calibration that was refined: the windows have a margin for it.
#[test]
fn a_log_with_windows_is_tracked_again_with_a_slightly_other_rig() {
    let place = tempfile::tempdir().unwrap();
    let [first, again, log] = ["first.csv", "again.csv", "log.mcap"].map(|name| place.path().join(name));
    run(Box::new(recording("planar.mkv", 300_000_000)), &rig(), &first, Some(&log));
    let mut other = rig();
    other.catheter.diameter_m *= 1.02;
    other.camera.blur_px = Some(0.7);
    run(Box::new(LogWindows::open(&log, Span::default()).unwrap()), &other, &again, None);
    let [first, again] = [first, again].map(|path| Table::read(&path));
    assert!(again.rows.iter().all(|row| row["coil_status"] == "ok" && row["tip_status"] == "ok"));
    assert_ne!(first.rows[5]["theta_deg"], again.rows[5]["theta_deg"]);
}

#[test]
fn a_log_without_pictures_says_how_to_record_them() {
    let place = tempfile::tempdir().unwrap();
    let log = place.path().join("log.mcap");
    let mut sink = McapSink::create(&log, &rig(), "", "").unwrap();
    let frame = recording("planar.mkv", 0).next_frame().unwrap().unwrap();
    sink.write(&tracker().step(&frame).unwrap(), Some(&frame.picture)).unwrap();
    sink.finish(&Tally::default()).unwrap();
    let error = LogWindows::open(&log, Span::default()).err().unwrap();
    assert!(matches!(error, SourceError::LogWithoutPictures { .. }), "{error}");
    assert!(error.to_string().contains("--record windows"), "{error}");
    // It may have had some where it is damaged.
    let bytes = std::fs::read(&log).unwrap();
    std::fs::write(&log, &bytes[..bytes.len() / 2]).unwrap();
    let damaged = LogWindows::open(&log, Span::default()).err().unwrap().to_string();
    assert!(damaged.contains("it ends without an index; what is left of this log"), "{damaged}");
    std::fs::write(&log, bytes).unwrap();
    let error = catoptra::source::open(&log, Default::default()).err().unwrap();
    assert!(matches!(error, SourceError::IsLog { .. }), "{error}");
}

/// Cut anywhere, all that is whole is tracked, and the end is named.
#[test]
fn a_log_that_was_cut_off_gives_what_is_whole() {
    let place = tempfile::tempdir().unwrap();
    let [first, again, log, cut] = ["a.csv", "b.csv", "log.mcap", "cut.mcap"].map(|name| place.path().join(name));
    run(Box::new(recording("planar.mkv", 900_000_000)), &rig(), &first, Some(&log));
    let bytes = std::fs::read(&log).unwrap();
    std::fs::write(&cut, &bytes[..bytes.len() * 3 / 5]).unwrap();
    let end = run(Box::new(LogWindows::open(&cut, Span::default()).unwrap()), &rig(), &again, None);
    assert!(matches!(end, End::Early(SourceError::Truncated { .. })), "{end:?}");
    let [first, again] = [first, again].map(|path| std::fs::read_to_string(path).unwrap());
    // The last row may have come without its picture.
    let whole: Vec<&str> = again.lines().filter(|row| !row.contains("not_recorded")).collect();
    assert!(whole.len() > 10 && again.lines().count() <= whole.len() + 1, "{} rows", whole.len());
    assert!(first.starts_with(&whole.join("\r\n")), "{again}");
}

#[test]
fn the_command_tracks_a_log_again_with_the_rig_that_is_in_it() {
    let place = Place::new();
    ended_with(&place.track(&sample("planar.mkv"), &["--to", "0.5", "--record", "windows"]), 0);
    let log = place.path("out/log.mcap");
    let command = |args: &[&str]| {
        let mut command = std::process::Command::new(env!("CARGO_BIN_EXE_catoptra"));
        command.current_dir(place.folder.path()).arg("track").args(args).output().unwrap()
    };
    ended_with(&command(&["out/log.mcap", "-o", "again"]), 0);
    let table = |folder: &str| std::fs::read_to_string(place.path(folder).join("track.csv")).unwrap();
    assert_eq!(table("out"), table("again"));
    assert_eq!(attached(&log, "rig.toml"), attached(&place.path("again/log.mcap"), "rig.toml"));

    // As of a video, a span without a frame is a mistake.
    let beyond = ended_with(&command(&["out/log.mcap", "-o", "beyond", "--from", "100"]), 2);
    let last = "no frame between 100 s and the end; the nearest";
    assert!(beyond.contains(last) && !place.path("beyond").exists(), "{beyond}");

    // Later nothing is known of before, and the next whole picture comes within ten seconds: until then the bands are
    // found in what was recorded.
    ended_with(&command(&["out/log.mcap", "-o", "later", "--from", "0.25"]), 0);
    let angles = |folder: &str| Table::read(&place.path(folder).join("track.csv")).numbers("theta_deg");
    let (all, later) = (angles("out"), angles("later"));
    assert!(!later.is_empty() && later.len() < all.len());
    for (first, again) in all[all.len() - later.len()..].iter().zip(&later) {
        assert!((first - again).abs() < 0.05, "{first}° and {again}°");
    }

    // A video would be black beside the parts.
    let printed = ended_with(&command(&["out/log.mcap", "-o", "video", "--record", "ffv1"]), 2);
    assert!(printed.contains("parts of its pictures") && !place.path("video").exists(), "{printed}");
    let printed = ended_with(&command(&["out/log.mcap", "-o", "whole", "--full-frame"]), 2);
    assert!(printed.contains("--full-frame"), "{printed}");
    let printed = ended_with(&command(&["again/log.mcap"]), 2);
    assert!(printed.contains("holds no pictures") && printed.contains("--record windows"), "{printed}");
    let printed = ended_with(&command(&[sample("planar.mkv").to_str().unwrap()]), 2);
    assert!(printed.contains("--rig RIG.toml"), "{printed}");
}
