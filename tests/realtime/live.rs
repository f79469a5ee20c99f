//! The live runner: rows of frames that were tracked, skipped or of another size; failing sinks; ends of a run.

use crate::support::command::*;
use catoptra::estimate::Estimate;
use catoptra::live::{self, Currents, LiveSummary, Outputs, Until};
use catoptra::pipeline::{self, End};
use catoptra::sink::{CsvSink, CurrentSample, OutputFrame, Sink, SinkError, UdpSink};
use catoptra::source::host::HostClock;
use catoptra::source::{
    Clock, Colour, Frame, FrameSource, HostTime, Picture, PixelFormat, SourceError, Span, Timestamp, VideoFile,
    VideoOptions,
};
use catoptra::track::{TrackOptions, Tracker};
use std::net::UdpSocket;
use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

/// Rows as they were written.
#[derive(Clone, Default)]
struct Rows {
    rows: Arc<Mutex<Vec<Estimate>>>,
    currents: Arc<Mutex<Vec<CurrentSample>>>,
    fails_at: Option<u64>,
}

impl Rows {
    fn words(&self) -> Vec<(u64, String)> {
        let views = ["direct", "mirror"];
        let word = |e: &Estimate| e.deflection.as_ref().err().map_or("ok".to_owned(), |miss| miss.word(&views));
        self.rows.lock().unwrap().iter().map(|e| (e.seq, word(e))).collect()
    }

    fn count(&self) -> u64 {
        self.rows.lock().unwrap().len() as u64
    }
}

impl Sink for Rows {
    fn write(&mut self, estimate: &Estimate, picture: Option<&Picture>) -> Result<(), SinkError> {
        assert!(picture.is_none(), "a live run keeps no picture");
        if self.fails_at == Some(estimate.seq) {
            return Err(SinkError::Io { path: "rows".into(), source: std::io::ErrorKind::StorageFull.into() });
        }
        self.rows.lock().unwrap().push(estimate.clone());
        Ok(())
    }

    fn write_current(&mut self, sample: &CurrentSample) -> Result<(), SinkError> {
        self.currents.lock().unwrap().push(sample.clone());
        Ok(())
    }

    fn finish(&mut self, _: &catoptra::tally::Tally) -> Result<(), SinkError> {
        Ok(())
    }
}

/// Frames by a function of their number; before each it waits until `ready` says so.
struct Given<F> {
    frame: F,
    next: u64,
    ready: Box<dyn Fn(u64) -> bool + Send>,
    stop: Arc<AtomicBool>,
}

impl<F: FnMut(u64) -> Option<Frame>> FrameSource for Given<F> {
    fn next_frame(&mut self) -> Result<Option<Frame>, SourceError> {
        let waited = Instant::now();
        while !(self.ready)(self.next) && !self.stop.load(Ordering::Relaxed) {
            assert!(waited.elapsed() < Duration::from_secs(60), "frame {} was never wanted", self.next);
            std::thread::sleep(Duration::from_micros(200));
        }
        self.next += 1;
        Ok((self.frame)(self.next - 1))
    }

    fn size_px(&self) -> [u32; 2] {
        rig().camera.size_px
    }
}

fn black(seq: u64, [width, height]: [u32; 2]) -> Frame {
    let samples = (width * height) as usize;
    let planes = vec![vec![16; samples], vec![128; samples / 4], vec![128; samples / 4]];
    let format = PixelFormat::Yuv { chroma_log2: [1, 1] };
    let picture = Picture::from_planes(width, height, format, Colour::SRGB, planes).unwrap();
    let stamp = Timestamp { ns: seq as i64 * 16_666_667, clock: Clock::Device };
    Frame { seq, stamp, gap: 0, host: None, picture }
}

fn run(source: impl FrameSource + Send + 'static, outputs: Outputs, until: &Until) -> LiveSummary {
    let rig = rig();
    let tracker = Tracker::new(&rig, TrackOptions::default()).unwrap();
    let pool = rayon::ThreadPoolBuilder::new().num_threads(2).build().unwrap();
    live::run(Box::new(source), tracker, pool, outputs, HostClock::start(), until, |_| {}).unwrap()
}

fn files(sinks: &[&Rows]) -> Outputs {
    let boxed = |rows: &&Rows| Box::new((*rows).clone()) as Box<dyn Sink + Send>;
    Outputs { files: sinks.iter().map(boxed).collect(), ..Outputs::default() }
}

fn recording() -> VideoFile {
    let span = Span { from_ns: None, to_ns: Some(400_000_000) };
    VideoFile::open(sample("planar.mkv"), VideoOptions { span, ..VideoOptions::default() }).unwrap()
}

#[test]
fn the_same_pictures_give_the_same_rows_live_and_offline_to_the_last_bit() {
    let place = tempfile::tempdir().unwrap();
    let [live, offline] = ["live.csv", "offline.csv"].map(|name| place.path().join(name));
    let table = |path: &Path| Box::new(CsvSink::create(path, &rig(), OutputFrame::Base).unwrap());

    let rows = Rows::default();
    let written = rows.clone();
    let mut recording_live = recording();
    let source = Given {
        frame: move |_| recording_live.next_frame().unwrap(),
        next: 0,
        ready: Box::new(move |seq| written.count() == seq),
        stop: Arc::default(),
    };
    let mut outputs = files(&[&rows]);
    outputs.files.insert(0, table(&live));
    let summary = run(source, outputs, &Until::default());
    assert!(matches!(summary.run.end, End::Complete), "{:?}", summary.run.end);
    assert_eq!((summary.run.tally.frames, summary.run.tally.complete), (25, 25));

    let mut tracker = Tracker::new(&rig(), TrackOptions::default()).unwrap();
    pipeline::run(Box::new(recording()), &mut tracker, vec![table(&offline)], &AtomicBool::new(false), |_| {}).unwrap();
    assert_eq!(std::fs::read_to_string(live).unwrap(), std::fs::read_to_string(offline).unwrap());
}

#[test]
fn frames_that_come_faster_than_they_are_tracked_keep_their_rows() {
    let rows = Rows::default();
    let mut frames: Vec<Frame> = Vec::new();
    // More than may wait.
    for second in 0..3 {
        let mut source = recording();
        while let Some(mut frame) = source.next_frame().unwrap() {
            frame.seq = frames.len() as u64;
            frame.stamp.ns += second * 1_000_000_000;
            frames.push(frame);
        }
    }
    let count = frames.len() as u64;
    let mut frames = frames.into_iter();
    let source = Given { frame: move |_| frames.next(), next: 0, ready: Box::new(|_| true), stop: Arc::default() };
    let summary = run(source, files(&[&rows]), &Until::default());
    let words = rows.words();
    assert_eq!(words.iter().map(|(seq, _)| *seq).collect::<Vec<_>>(), (0..count).collect::<Vec<_>>());
    let of = |word: &str| words.iter().filter(|(_, w)| w == word).count();
    assert!(of("skipped_overload") > 0 && of("ok") > 0, "{words:?}");
    assert_eq!(of("skipped_overload") + of("ok"), words.len(), "{words:?}");
    // The last one is the newest, and the newest is tracked.
    assert_eq!(words.last().unwrap().1, "ok");
    assert_eq!(summary.run.tally.frames, count);
}

#[test]
fn a_picture_of_another_size_has_its_row_and_the_run_goes_on() {
    let rows = Rows::default();
    let written = rows.clone();
    let size_px = |seq: u64| if (3..5).contains(&seq) { [640, 480] } else { rig().camera.size_px };
    let source = Given {
        frame: move |seq| (seq < 8).then(|| black(seq, size_px(seq))),
        next: 0,
        ready: Box::new(move |seq| written.count() == seq),
        stop: Arc::default(),
    };
    run(source, files(&[&rows]), &Until::default());
    let words: Vec<String> = rows.words().into_iter().map(|(_, word)| word).collect();
    let missing = "marker_missing";
    assert_eq!(words, [missing, missing, missing, "wrong_size", "wrong_size", missing, missing, missing]);
}

#[test]
fn a_file_that_cannot_be_written_is_told_and_the_others_go_on() {
    let (bad, good) = (Rows { fails_at: Some(2), ..Rows::default() }, Rows::default());
    let written = good.clone();
    let source = Given {
        frame: |seq| (seq < 20).then(|| black(seq, rig().camera.size_px)),
        next: 0,
        ready: Box::new(move |seq| written.count() == seq),
        stop: Arc::default(),
    };
    let summary = run(source, files(&[&bad, &good]), &Until::default());
    assert!(matches!(summary.run.end, End::Complete), "{:?}", summary.run.end);
    assert_eq!((bad.count(), good.count(), summary.run.sink_failures.len()), (2, 20, 1));
}

/// Frames for ever, one a millisecond.
fn endless(stop: &Arc<AtomicBool>) -> impl FrameSource + Send + use<> {
    let began = Instant::now();
    let ready = move |seq| began.elapsed() >= Duration::from_millis(seq);
    Given {
        frame: |seq| Some(black(seq, rig().camera.size_px)),
        next: 0,
        ready: Box::new(ready),
        stop: Arc::clone(stop),
    }
}

#[test]
fn when_no_file_can_be_written_and_nobody_listens_the_run_ends() {
    let (until, bad) = (Until::default(), Rows { fails_at: Some(3), ..Rows::default() });
    let summary = run(endless(&until.stop), files(&[&bad]), &until);
    assert!(matches!(summary.run.end, End::Sink), "{:?}", summary.run.end);
}

#[test]
fn controllers_are_served_when_every_file_is_lost() {
    let listener = UdpSocket::bind("127.0.0.1:0").unwrap();
    listener.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
    let until = Until { duration: Some(Duration::from_millis(700)), ..Until::default() };
    let bad = Rows { fails_at: Some(0), ..Rows::default() };
    let controllers: Vec<Box<dyn Sink + Send>> =
        vec![Box::new(UdpSink::to(listener.local_addr().unwrap(), &rig()).unwrap())];
    let summary = run(endless(&until.stop), Outputs { controllers, ..files(&[&bad]) }, &until);
    assert!(matches!(summary.run.end, End::Complete), "{:?}", summary.run.end);
    assert_eq!(summary.run.sink_failures.len(), 1);
    let mut bytes = [0; 2048];
    for seq in 0..10 {
        let length = listener.recv(&mut bytes).unwrap();
        let datagram: serde_json::Value = serde_json::from_slice(&bytes[..length]).unwrap();
        assert_eq!(datagram["seq"], seq);
    }
}

#[test]
fn a_camera_that_hangs_does_not_hold_up_the_end_and_nothing_before_is_lost() {
    let rows = Rows::default();
    let until = Until { duration: Some(Duration::from_millis(300)), ..Until::default() };
    let source = Given {
        frame: |seq| {
            if seq == 5 {
                std::thread::sleep(Duration::from_secs(3600));
            }
            Some(black(seq, rig().camera.size_px))
        },
        next: 0,
        ready: Box::new(|_| true),
        stop: Arc::default(),
    };
    let began = Instant::now();
    let summary = run(source, files(&[&rows]), &until);
    assert!(began.elapsed() < Duration::from_secs(30));
    assert!(matches!(summary.run.end, End::Complete), "{:?}", summary.run.end);
    assert_eq!(rows.count(), 5);
}

#[test]
fn coil_currents_go_into_the_same_log() {
    let (until, rows) = (Until { duration: Some(Duration::from_millis(300)), ..Until::default() }, Rows::default());
    let (line, samples) = std::sync::mpsc::sync_channel(16);
    let currents = Currents { samples, wait: false };
    let sample = CurrentSample { host_ns: 5, arrival_ns: 6, seq: Some(7), current_a: vec![0.1, -0.1, 0.0] };
    line.send(sample.clone()).unwrap();
    run(endless(&until.stop), Outputs { currents: Some(currents), ..files(&[&rows]) }, &until);
    assert_eq!(*rows.currents.lock().unwrap(), [sample]);
    assert!(rows.count() > 0);
}

#[test]
fn the_time_from_arrival_to_angle_is_that_of_the_frames_that_were_tracked() {
    let clock = HostClock::start();
    let (rows, given) = (Rows::default(), AtomicU64::new(0));
    let written = rows.clone();
    let source = Given {
        frame: move |seq| {
            given.fetch_add(1, Ordering::Relaxed);
            // Handed on 50 ms after it was here.
            let arrival_ns = clock.now_ns() - 50_000_000;
            let host = Some(HostTime { arrival_ns, stamp_ns: arrival_ns });
            (seq < 10).then(|| Frame { host, ..black(seq, rig().camera.size_px) })
        },
        next: 0,
        ready: Box::new(move |seq| written.count() == seq),
        stop: Arc::default(),
    };
    let tracker = Tracker::new(&rig(), TrackOptions::default()).unwrap();
    let pool = rayon::ThreadPoolBuilder::new().num_threads(2).build().unwrap();
    let summary =
        live::run(Box::new(source), tracker, pool, files(&[&rows]), clock, &Until::default(), |_| {}).unwrap();
    let latency = summary.latency;
    assert!(latency.p50_us >= 50_000 && latency.p50_us <= latency.p99_us && latency.p99_us <= latency.max_us);
    assert!(rows.rows.lock().unwrap().iter().all(|row| row.host.is_some()));
}
