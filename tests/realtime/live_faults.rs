//! Cameras whose counters and times go wrong during a live run: every frame keeps its row, is tracked, and is in the
//! log.

use crate::support::command::*;
use catoptra::live::{self, LiveSummary, Outputs, Until};
use catoptra::log::Info;
use catoptra::pipeline::End;
use catoptra::sink::{CsvSink, McapSink, OutputFrame, Sink};
use catoptra::source::host::{ClockFit, HostClock};
use catoptra::source::{Clock, Frame, FrameSource, SourceError, Timestamp, VideoFile, VideoOptions};
use catoptra::track::{TrackOptions, Tracker};
use std::time::Duration;

/// The sample with other numbers: the camera's own of each frame, and its time, seconds.
struct Camera<F> {
    /// Decoded before the run.
    frames: std::vec::IntoIter<Frame>,
    wrong: F,
    clock: HostClock,
    fit: ClockFit,
    period: Duration,
}

impl<F: Fn(u64, i64) -> (u32, i64)> FrameSource for Camera<F> {
    fn next_frame(&mut self) -> Result<Option<Frame>, SourceError> {
        let Some(frame) = self.frames.next() else { return Ok(None) };
        std::thread::sleep(self.period);
        let (gap, ns) = (self.wrong)(frame.seq, frame.stamp.ns);
        let host = Some(self.fit.map(ns, self.clock.now_ns()));
        Ok(Some(Frame { gap, stamp: Timestamp { ns, clock: Clock::Device }, host, ..frame }))
    }

    fn size_px(&self) -> [u32; 2] {
        rig().camera.size_px
    }
}

struct Run {
    summary: LiveSummary,
    table: Table,
    info: Info,
}

/// 40 frames of a camera, `wrong` by number and stamp.
fn run(threads: usize, period: Duration, wrong: impl Fn(u64, i64) -> (u32, i64) + Send + 'static) -> Run {
    let place = tempfile::tempdir().unwrap();
    let [table, log] = ["live.csv", "log.mcap"].map(|name| place.path().join(name));
    let rig = rig();
    let files: Vec<Box<dyn Sink + Send>> = vec![
        Box::new(McapSink::create(&log, &rig, "", "").unwrap()),
        Box::new(CsvSink::create(&table, &rig, OutputFrame::Base).unwrap()),
    ];
    let mut recording = VideoFile::open(sample("planar.mkv"), VideoOptions::default()).unwrap();
    let frames: Vec<Frame> = (0..40).map(|_| recording.next_frame().unwrap().unwrap()).collect();
    let clock = HostClock::start();
    let source = Camera { frames: frames.into_iter(), wrong, clock, fit: ClockFit::default(), period };
    let tracker = Tracker::new(&rig, TrackOptions::default()).unwrap();
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
    let outputs = Outputs { files, ..Outputs::default() };
    let summary = live::run(Box::new(source), tracker, pool, outputs, clock, &Until::default(), |_| {}).unwrap();
    assert!(matches!(summary.run.end, End::Complete), "{:?}", summary.run.end);
    let run = Run { summary, table: Table::read(&table), info: Info::read(&log).unwrap() };
    let seqs: Vec<String> = run.table.rows.iter().map(|row| row["seq"].clone()).collect();
    assert_eq!(seqs, (0..40).map(|seq: u32| seq.to_string()).collect::<Vec<_>>());
    assert_eq!((run.info.frames, run.info.condition.cut.clone(), run.info.rows_missing), (40, None, 0));
    run
}

const CALM: Duration = Duration::from_millis(30);

fn word(run: &Run, row: usize) -> &str {
    &run.table.rows[row]["coil_status"]
}

fn all_measured(run: &Run) {
    // A machine that is busy with other things passes frames over; what else may be is what is tested.
    let words: Vec<&str> = (0..40).map(|row| word(run, row)).filter(|word| *word != "skipped_overload").collect();
    assert!(words.len() > 20 && words.iter().all(|word| *word == "ok"), "{words:?}");
}

#[test]
fn a_frame_counter_that_jumps_is_a_gap_of_so_many_frames() {
    // Three are missing before frame 10, and as many as can be told before frame 30.
    let run = run(2, CALM, |seq, ns| match seq {
        10 => (3, ns + 50_000_000),
        11..30 => (0, ns + 50_000_000),
        30 => (u32::MAX, ns + 100_000_000_000),
        31.. => (0, ns + 100_000_000_000),
        _ => (0, ns),
    });
    all_measured(&run);
    assert_eq!((run.table.rows[10]["gap"].as_str(), run.table.rows[30]["gap"].as_str()), ("3", "4294967295"));
    assert_eq!(run.info.gaps, (2, u64::from(u32::MAX) + 3));
    assert_eq!(run.summary.run.tally.lost, u64::from(u32::MAX) + 3);
}

#[test]
fn a_camera_whose_time_goes_backwards_or_stands_still_is_tracked_on() {
    let run = run(2, CALM, |seq, ns| match seq {
        0..10 => (0, ns + 3_600_000_000_000),
        10..20 => (0, ns - 5_000_000_000),
        20..25 => (0, 7),
        _ => (0, ns),
    });
    all_measured(&run);
    assert_eq!(run.info.not_later, 1 + 4);
    let stamp = |row: usize| run.table.rows[row]["stamp_ns"].parse::<i64>().unwrap();
    assert!(stamp(9) > stamp(10) && stamp(10) < 0 && stamp(24) == 7);
    // The host's time of the frames goes on all the same.
    let (from_ns, to_ns) = run.info.host_span_ns.unwrap();
    assert!((500_000_000..10_000_000_000).contains(&(to_ns - from_ns)), "{} ns", to_ns - from_ns);
}

/// A tracker of one thread, and all frames at once.
#[test]
fn a_tracker_that_is_too_slow_leaves_rows_and_measures_the_newest() {
    let run = run(1, Duration::ZERO, |_, ns| (0, ns));
    let skipped = (0..40).filter(|row| word(&run, *row) == "skipped_overload").count();
    let ok = (0..40).filter(|row| word(&run, *row) == "ok").count();
    assert!(skipped > 0 && ok > 0 && skipped + ok == 40, "{skipped} skipped, {ok} ok");
    assert_eq!(word(&run, 39), "ok");
    let missed: u64 = run.info.misses.iter().filter(|((what, _), _)| what == "coil").map(|(_, n)| n).sum();
    assert_eq!(missed, skipped as u64);
}
