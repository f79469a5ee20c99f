//! Pictures recorded live: tracking them again gives the same numbers, and they are dropped first when disk or recorder
//! are slow.

use crate::support::command::*;
use catoptra::estimate::Estimate;
use catoptra::live::{self, LiveSummary, Outputs, RecordSwitch, RecordTo, Recording, SwitchedRecording, Until};
use catoptra::log::Info;
use catoptra::pipeline;
use catoptra::sink::{CsvSink, McapSink, OutputFrame, PictureCodec, PictureCount, PictureVideo, Sink, SinkError};
use catoptra::source::host::HostClock;
use catoptra::source::{
    Frame, FrameSource, HostTime, LogWindows, Picture, SourceError, Span, VideoFile, VideoOptions, open_to_track,
};
use catoptra::track::{TrackOptions, Tracker};
use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

/// Counts the rows that were written; the first ones take their time.
#[derive(Clone, Default)]
struct Rows {
    written: Arc<AtomicU64>,
    takes: Duration,
    slow: u64,
}

impl Sink for Rows {
    fn write(&mut self, _: &Estimate, _: Option<&Picture>) -> Result<(), SinkError> {
        if self.written.fetch_add(1, Ordering::SeqCst) < self.slow {
            std::thread::sleep(self.takes);
        }
        Ok(())
    }

    fn finish(&mut self, _: &catoptra::tally::Tally) -> Result<(), SinkError> {
        Ok(())
    }
}

/// Frames of the sample as if a camera sent them, each when it is due.
struct Camera {
    recording: Box<dyn Iterator<Item = Frame> + Send>,
    due: Box<dyn Fn(u64) -> bool + Send>,
    clock: HostClock,
}

impl FrameSource for Camera {
    fn next_frame(&mut self) -> Result<Option<Frame>, SourceError> {
        let Some(frame) = self.recording.next() else { return Ok(None) };
        let waited = Instant::now();
        while !(self.due)(frame.seq) {
            assert!(waited.elapsed() < Duration::from_secs(60), "frame {} was never wanted", frame.seq);
            std::thread::sleep(Duration::from_micros(200));
        }
        let arrival_ns = self.clock.now_ns();
        Ok(Some(Frame { host: Some(HostTime { arrival_ns, stamp_ns: arrival_ns - 5 }), ..frame }))
    }

    fn size_px(&self) -> [u32; 2] {
        rig().camera.size_px
    }
}

fn camera(to_ns: i64, due: impl Fn(u64) -> bool + Send + 'static) -> Camera {
    let span = Span { from_ns: None, to_ns: Some(to_ns) };
    let mut file = VideoFile::open(sample("planar.mkv"), VideoOptions { span, ..VideoOptions::default() }).unwrap();
    let recording = Box::new(std::iter::from_fn(move || file.next_frame().unwrap()));
    Camera { recording, due: Box::new(due), clock: HostClock::start() }
}

/// Each frame when row and picture of the one before are written.
fn one_by_one(rows: &Rows, count: &Arc<PictureCount>) -> impl Fn(u64) -> bool + Send + use<> {
    let (written, count) = (Arc::clone(&rows.written), Arc::clone(count));
    move |seq| written.load(Ordering::SeqCst) == seq && count.recorded() == seq
}

/// Each frame as long after the one before.
fn every(period: Duration) -> impl Fn(u64) -> bool + Send {
    let began = Instant::now();
    move |seq| began.elapsed() >= period * seq as u32
}

struct Files {
    place: tempfile::TempDir,
    count: Arc<PictureCount>,
}

impl Files {
    fn new() -> Self {
        Self { place: tempfile::tempdir().unwrap(), count: Arc::default() }
    }

    fn path(&self, name: &str) -> std::path::PathBuf {
        self.place.path().join(name)
    }

    /// Log and table, and `more`.
    fn outputs(&self, to: RecordTo, keep_free_bytes: u64, more: &Rows) -> Outputs {
        let log = McapSink::create(&self.path("log.mcap"), &rig(), "", "").unwrap();
        let files: Vec<Box<dyn Sink + Send>> = vec![
            Box::new(log.with_pictures("windows", Arc::clone(&self.count))),
            Box::new(CsvSink::create(&self.path("live.csv"), &rig(), OutputFrame::Base).unwrap()),
            Box::new(more.clone()),
        ];
        let folder = self.place.path().to_owned();
        let recording = Recording { to, count: Arc::clone(&self.count), folder, keep_free_bytes, switch: None };
        Outputs { files, pictures: Some(recording), ..Outputs::default() }
    }

    /// Tracks `source` again and gives rows as they are in both tables.
    fn both(&self, source: &Path) -> (Vec<String>, Vec<String>) {
        let again = self.path("again.csv");
        let sinks: Vec<Box<dyn Sink + Send>> =
            vec![Box::new(CsvSink::create(&again, &rig(), OutputFrame::Base).unwrap())];
        let source = open_to_track(source, Default::default()).unwrap();
        let mut tracker = Tracker::new(&rig(), TrackOptions::default()).unwrap();
        pipeline::run(source, &mut tracker, sinks, &AtomicBool::new(false), |_| {}).unwrap();
        let rows = |path: &Path| std::fs::read_to_string(path).unwrap().lines().map(str::to_owned).collect();
        (rows(&self.path("live.csv")), rows(&again))
    }
}

fn run(source: Camera, outputs: Outputs) -> LiveSummary {
    let tracker = Tracker::new(&rig(), TrackOptions::default()).unwrap();
    let pool = rayon::ThreadPoolBuilder::new().num_threads(2).build().unwrap();
    let clock = source.clock;
    live::run(Box::new(source), tracker, pool, outputs, clock, &Until::default(), |_| {}).unwrap()
}

#[test]
fn windows_recorded_live_are_tracked_again_to_the_same_table() {
    let (files, rows) = (Files::new(), Rows::default());
    let source = camera(900_000_000, one_by_one(&rows, &files.count));
    let summary = run(source, files.outputs(RecordTo::Log, 0, &rows));
    assert_eq!(summary.pictures, Some((55, 0)));
    let (live, again) = files.both(&files.path("log.mcap"));
    assert_eq!(live.len(), 56);
    assert_eq!(live, again);
    // The host's times are those of the run.
    let mut source = LogWindows::open(&files.path("log.mcap"), Span::default()).unwrap();
    let host = source.next_frame().unwrap().unwrap().host.unwrap();
    assert_eq!(host.arrival_ns - host.stamp_ns, 5);
    assert!(
        Info::read(&files.path("log.mcap"))
            .unwrap()
            .topics
            .iter()
            .any(|t| t.messages == 55 && t.name == "/camera/windows" && t.schema == "catoptra.PictureWindows")
    );
}

#[test]
fn a_video_recorded_live_is_tracked_again_to_the_same_table() {
    let (files, rows) = (Files::new(), Rows::default());
    let source = camera(400_000_000, one_by_one(&rows, &files.count));
    let video = PictureVideo::create(&files.path("pictures.mkv"), PictureCodec::Ffv1).unwrap();
    let summary = run(source, files.outputs(RecordTo::Video(Box::new(video)), 0, &rows));
    assert_eq!(summary.pictures, Some((25, 0)));
    let (live, again) = files.both(&files.path("pictures.mkv"));
    assert_eq!(live.len(), 26);
    assert_eq!(same_where_recorded(&live, &again), 0);
}

/// Rows of both tables that have a picture are the same but for what the frames before tell: σ, and where chroma sits;
/// those that were not recorded are unknown the second time; how many have none.
fn same_where_recorded(live: &[String], again: &[String]) -> usize {
    assert_eq!(live.len(), again.len());
    let mut without = 0;
    for (live, again) in live.iter().zip(again) {
        if again.contains("not_recorded") {
            without += 1;
        } else {
            // σ of θ, of three bands, of the tangent; the azimuth, which has no meaning at rest.
            let but_sd = |row: &str| -> Vec<String> {
                let cells = row.split(',').map(str::to_owned).enumerate();
                cells.filter(|(column, _)| ![4, 6, 10, 15, 20, 25].contains(column)).map(|(_, cell)| cell).collect()
            };
            for (live, again) in but_sd(live).iter().zip(&but_sd(again)) {
                match (live.parse::<f64>(), again.parse::<f64>()) {
                    (Ok(live), Ok(again)) => assert!((live - again).abs() < 0.2, "{live} and {again}"),
                    _ => assert_eq!(live, again),
                }
            }
        }
    }
    without
}

#[test]
fn frames_that_were_passed_over_have_no_picture_and_the_others_their_numbers() {
    let (files, rows) = (Files::new(), Rows::default());
    // Decoded before, and all of them at once.
    let slow = camera(1_200_000_000, |_| true);
    let source = Camera { recording: Box::new(slow.recording.collect::<Vec<_>>().into_iter()), ..slow };
    let summary = run(source, files.outputs(RecordTo::Log, 0, &rows));
    let (live, again) = files.both(&files.path("log.mcap"));
    let skipped = live.iter().filter(|row| row.contains("skipped_overload")).count();
    assert!(skipped > 0, "the tracker was never too slow");
    let (recorded, dropped) = summary.pictures.unwrap();
    assert_eq!(recorded + dropped, 73 - skipped as u64);
    assert_eq!(same_where_recorded(&live, &again), skipped + dropped as usize);
}

#[test]
fn a_disk_that_is_too_slow_costs_pictures_and_no_row_and_the_rest_is_tracked_again() {
    let files = Files::new();
    // After 2.4 s 90 rows wait; then the disk is fast again.
    let rows = Rows { takes: Duration::from_millis(40), slow: 60, ..Rows::default() };
    let summary = run(camera(4_000_000_000, every(Duration::from_millis(16))), files.outputs(RecordTo::Log, 0, &rows));
    let (recorded, dropped) = summary.pictures.unwrap();
    assert!(recorded > 20 && dropped > 10, "{recorded} recorded, {dropped} dropped");
    assert_eq!((rows.written.load(Ordering::SeqCst), summary.unlogged_frames), (241, 0));
    let (live, again) = files.both(&files.path("log.mcap"));
    let skipped = live.iter().filter(|row| row.contains("skipped_overload")).count();
    assert_eq!(same_where_recorded(&live, &again), skipped + dropped as usize);
    // `/health` says it too.
    let counted = last_health(&files.path("log.mcap"));
    assert_eq!(counted, (recorded, dropped));
}

/// Pictures recorded and dropped as the log's last message of `/health` has them.
fn last_health(log: &Path) -> (u64, u64) {
    let bytes = std::fs::read(log).unwrap();
    let mut last = None;
    for message in mcap::MessageStream::new(&bytes).unwrap().map(Result::unwrap) {
        if message.channel.topic == "/health" {
            let schema = message.channel.schema.clone().unwrap();
            let pool = prost_reflect::DescriptorPool::decode(schema.data.as_ref()).unwrap();
            let descriptor = pool.get_message_by_name(&schema.name).unwrap();
            let health = prost_reflect::DynamicMessage::decode(descriptor, message.data.as_ref()).unwrap();
            let number = |field: &str| health.get_field_by_name(field).unwrap().as_u64().unwrap();
            last = Some((number("pictures_recorded"), number("pictures_dropped")));
        }
    }
    last.unwrap()
}

/// Takes its time for each picture, and fails from one on.
struct Video {
    takes: Duration,
    fails_at: Option<u64>,
    seen: Arc<Mutex<(Vec<u64>, bool)>>,
}

impl Sink for Video {
    fn write(&mut self, estimate: &Estimate, picture: Option<&Picture>) -> Result<(), SinkError> {
        assert_eq!(picture.unwrap().size_px(), [1280, 1024]);
        std::thread::sleep(self.takes);
        if self.fails_at.is_some_and(|at| estimate.seq >= at) {
            return Err(SinkError::Io { path: "video".into(), source: std::io::ErrorKind::StorageFull.into() });
        }
        self.seen.lock().unwrap().0.push(estimate.seq);
        Ok(())
    }

    fn finish(&mut self, _: &catoptra::tally::Tally) -> Result<(), SinkError> {
        self.seen.lock().unwrap().1 = true;
        Ok(())
    }
}

#[test]
fn an_encoder_that_is_too_slow_costs_pictures_and_no_row() {
    let (files, rows, seen) = (Files::new(), Rows::default(), Arc::default());
    let video = Video { takes: Duration::from_millis(80), fails_at: None, seen: Arc::clone(&seen) };
    let source = camera(1_000_000_000, every(Duration::from_millis(16)));
    let summary = run(source, files.outputs(RecordTo::Video(Box::new(video)), 0, &rows));
    let (recorded, dropped) = summary.pictures.unwrap();
    assert!(dropped > 0 && recorded > 10, "{recorded} recorded, {dropped} dropped");
    assert_eq!(rows.written.load(Ordering::SeqCst), 61);
    let (seen, finished) = seen.lock().unwrap().clone();
    assert!(finished && seen.len() as u64 == recorded && seen.is_sorted());
    assert!(summary.run.sink_failures.is_empty());
}

#[test]
fn a_video_that_cannot_be_written_is_told_and_every_row_is_there() {
    let (files, rows, seen) = (Files::new(), Rows::default(), Arc::default());
    let video = Video { takes: Duration::ZERO, fails_at: Some(10), seen: Arc::clone(&seen) };
    let source = camera(500_000_000, every(Duration::from_millis(16)));
    let summary = run(source, files.outputs(RecordTo::Video(Box::new(video)), 0, &rows));
    assert_eq!(rows.written.load(Ordering::SeqCst), 31);
    assert_eq!(summary.run.sink_failures.len(), 1);
    let (seen, finished) = seen.lock().unwrap().clone();
    assert!(finished && seen.len() <= 10, "{seen:?}");
    let (recorded, dropped) = summary.pictures.unwrap();
    assert_eq!(recorded, seen.len() as u64);
    assert!(dropped > 0);
}

#[test]
fn when_the_disk_is_short_no_picture_is_recorded_and_every_row_is() {
    let (files, rows) = (Files::new(), Rows::default());
    let source = camera(300_000_000, every(Duration::from_millis(16)));
    let summary = run(source, files.outputs(RecordTo::Log, u64::MAX, &rows));
    let (recorded, dropped) = summary.pictures.unwrap();
    assert!(recorded == 0 && dropped > 0);
    assert_eq!(rows.written.load(Ordering::SeqCst), 19);
    let error = LogWindows::open(&files.path("log.mcap"), Span::default()).err().unwrap();
    assert!(matches!(error, SourceError::LogWithoutPictures { .. }), "{error}");
}

/// Frames of each stretch that is recorded, and how.
const STRETCHES: [(std::ops::Range<u64>, &str); 3] = [(10..25, "ffv1"), (30..38, "windows"), (40..52, "ffv1")];

#[test]
fn of_stretches_that_are_begun_and_ended_every_picture_is_recorded_and_no_other() {
    let (files, rows) = (Files::new(), Rows::default());
    let switch = Arc::new(RecordSwitch::new(None));
    let due = {
        let (written, count, switch) = (Arc::clone(&rows.written), Arc::clone(&files.count), Arc::clone(&switch));
        move |seq: u64| {
            let before: u64 =
                STRETCHES.iter().map(|(frames, _)| frames.clone().filter(|n| *n < seq).count() as u64).sum();
            if written.load(Ordering::SeqCst) != seq || count.recorded() != before {
                return false;
            }
            for (frames, how) in &STRETCHES {
                if seq == frames.start {
                    // The row of the frame before is written; its picture is passed by a moment later.
                    std::thread::sleep(Duration::from_millis(30));
                    switch.start(how);
                } else if seq == frames.end {
                    switch.stop();
                }
            }
            true
        }
    };
    let folder = files.place.path().to_owned();
    let place = move |how: &str| {
        if how == "windows" {
            return Ok((RecordTo::Log, "the log".to_owned()));
        }
        let name = ["a.mkv", "b.mkv"].into_iter().find(|name| !folder.join(name).exists()).unwrap().to_owned();
        let video = PictureVideo::create(&folder.join(&name), PictureCodec::Ffv1)?;
        Ok((RecordTo::Video(Box::new(video)), name))
    };
    let mut outputs = files.outputs(RecordTo::Nowhere, 0, &rows);
    outputs.pictures.as_mut().unwrap().switch =
        Some(SwitchedRecording { switch: Arc::clone(&switch), place: Box::new(place) });
    let summary = run(camera(900_000_000, due), outputs);
    assert_eq!((summary.run.tally.frames, summary.pictures), (55, Some((15 + 8 + 12, 0))));
    assert_eq!(switch.state().places, ["a.mkv", "the log", "b.mkv"]);
    // Videos: these frames, without loss, with their stamps.
    let all: Vec<Frame> = camera(900_000_000, |_| true).recording.collect();
    for (name, recorded) in [("a.mkv", 10..25), ("b.mkv", 40..52)] {
        let kept = frames(&files.path(name));
        let expected: Vec<&Frame> = all.iter().filter(|frame| recorded.contains(&frame.seq)).collect();
        assert_eq!(kept.len(), expected.len(), "{name}");
        for (kept, expected) in kept.iter().zip(expected) {
            assert_eq!(kept.stamp.ns, expected.stamp.ns, "{name}");
            for (a, b) in (0..3).map(|i| (kept.picture.plane(i).unwrap(), expected.picture.plane(i).unwrap())) {
                assert!((0..a.height).all(|y| a.row(y).unwrap() == b.row(y).unwrap()), "{name} at {}", kept.stamp.ns);
            }
        }
    }
    // The log: its part is tracked again as if the run had begun there, the rest says that it is not there.
    let (live, again) = files.both(&files.path("log.mcap"));
    let missing: Vec<usize> = (0..55).filter(|seq| again[seq + 1].contains("not_recorded")).collect();
    assert_eq!(missing, (0..30).chain(38..55).collect::<Vec<_>>());
    assert_eq!(same_where_recorded(&live, &again), 47);
}

#[test]
fn a_stretch_that_cannot_be_recorded_is_told_and_the_next_one_is() {
    let (files, rows) = (Files::new(), Rows::default());
    let switch = Arc::new(RecordSwitch::new(None));
    // Turned before there is a run.
    switch.start("windows");
    let due = {
        let (written, count, switch) = (Arc::clone(&rows.written), Arc::clone(&files.count), Arc::clone(&switch));
        move |seq: u64| {
            if written.load(Ordering::SeqCst) != seq {
                return false;
            }
            // Those of before are recorded, all of them.
            if seq == 5 && count.recorded() != 5 {
                return false;
            }
            if [10, 20, 30].contains(&seq) {
                std::thread::sleep(Duration::from_millis(30));
            }
            match seq {
                10 => switch.start("nowhere"),
                5 | 20 => switch.stop(),
                30 => switch.start("windows"),
                _ => {}
            }
            true
        }
    };
    let place = |how: &str| match how {
        "windows" => Ok((RecordTo::Log, "the log".to_owned())),
        _ => Err(SinkError::NoEncoder { path: "x.mkv".into(), tried: how.to_owned() }),
    };
    let mut outputs = files.outputs(RecordTo::Nowhere, 0, &rows);
    outputs.pictures.as_mut().unwrap().switch =
        Some(SwitchedRecording { switch: Arc::clone(&switch), place: Box::new(place) });
    let summary = run(camera(900_000_000, due), outputs);
    let (recorded, dropped) = summary.pictures.unwrap();
    assert!(recorded > 5 && dropped >= 10 && recorded + dropped == 40, "{recorded} recorded, {dropped} not");
    assert!(
        matches!(summary.run.sink_failures.as_slice(), [SinkError::NoEncoder { .. }]),
        "{:?}",
        summary.run.sink_failures
    );
    assert_eq!((switch.state().places, switch.state().problem), (vec!["the log".to_owned()], None));
}
