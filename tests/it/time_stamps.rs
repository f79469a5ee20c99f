//! Every frame of a recording has the container's own time, including the last ones, and lost frames are counted.

use crate::support::encode;
use std::path::Path;

use crate::support::encode::{Recording, Written, write};
use catoptra::source::{self, Clock, Frame, FrameSource, SourceOptions, Span, StreamFaults, VideoFile, VideoOptions};

fn read(path: &Path, options: VideoOptions) -> Vec<Frame> {
    let (frames, guessed) = read_and_guesses(path, options);
    assert_eq!(guessed, if path.extension().unwrap() == "avi" { frames.len() as u64 } else { 0 });
    frames
}

/// All frames, and how many times were guessed, of those before the span too.
fn read_and_guesses(path: &Path, options: VideoOptions) -> (Vec<Frame>, u64) {
    let mut source = VideoFile::open(path, options).unwrap();
    let mut frames = Vec::new();
    while let Some(frame) = source.next_frame().unwrap() {
        assert_eq!(frame.seq, frames.len() as u64);
        assert_eq!(frame.stamp.clock, Clock::Container);
        frames.push(frame);
    }
    assert!(source.next_frame().unwrap().is_none());
    let guessed_stamps = source.faults().guessed_stamps;
    assert_eq!(source.faults(), StreamFaults { guessed_stamps, ..StreamFaults::default() });
    (frames, guessed_stamps)
}

fn stamps(frames: &[Frame]) -> Vec<i64> {
    frames.iter().map(|f| f.stamp.ns).collect()
}

/// Luma tells which frame it is: the pattern moves by 3 per frame.
fn assert_is_frame(frame: &Frame, i: usize) {
    let plane = frame.picture.plane(0).unwrap();
    for (x, y) in [(5, 5), (20, 11), (33, 30)] {
        let (found, drawn) = (plane.row(y).unwrap()[x], encode::luma(i, x, y));
        assert!(found.abs_diff(drawn) <= 1, "frame {i}: {found}, drawn {drawn}");
    }
}

/// 150 frames of a camera with three losses: one frame, two, and eleven.
fn kept() -> Vec<i64> {
    (0..165).filter(|f| !(*f == 30 || (61..63).contains(f) || (100..111).contains(f))).collect()
}

/// AVI has no presentation times, and NUT would be written with all times shifted: no B frames there.
fn b_frames(ending: &str) -> usize {
    if matches!(ending, "avi" | "nut") { 0 } else { 3 }
}

fn assert_gaps(frames: &[Frame], kept: &[i64]) {
    let gaps: Vec<u32> = frames.iter().map(|f| f.gap).collect();
    let lost: Vec<u32> =
        std::iter::once(0).chain(kept.windows(2).map(|p| u32::try_from(p[1] - p[0] - 1).unwrap())).collect();
    assert_eq!(gaps, lost);
    assert_eq!(gaps.iter().sum::<u32>(), 14);
}

#[test]
fn every_frame_has_the_containers_time_in_any_container_and_time_base() {
    let folder = tempfile::tempdir().unwrap();
    // Container, time base asked for, units per frame, time base the container makes of it.
    let cases = [
        ("mkv", (1, 1000), None, (1, 1000)),
        ("mkv", (1, 15360), Some(256), (1, 1000)),
        ("mp4", (1, 15360), Some(256), (1, 15360)),
        ("mp4", (1, 1000), None, (1, 16000)),
        ("mp4", (1, 90_000), Some(1501), (1, 90_000)),
        ("mov", (1, 60_000), Some(1001), (1, 60_000)),
        ("nut", (1, 60_000), Some(1001), (1, 60_000)),
        ("avi", (1001, 60_000), Some(1), (1001, 60_000)),
    ];
    for (i, (ending, time_base, units, expected_base)) in cases.into_iter().enumerate() {
        let path = folder.path().join(format!("{i}.{ending}"));
        let kept = kept();
        // A 60 Hz camera in whole milliseconds, or in whole units; the recording starts at its own time.
        let time = |f: i64| units.map_or((1000 * f + 30) / 60, |u| u * f);
        let pts: Vec<i64> = kept.iter().map(|&f| time(f)).collect();
        let b_frames = b_frames(ending);
        let written = write(&path, &Recording { time_base, pts: &pts, b_frames, ..Recording::default() });
        assert_eq!(written.reordered, b_frames > 0, "{ending}: B frames");
        assert_eq!(written.time_base, expected_base, "{ending}");
        let frames = read(&path, VideoOptions::default());
        assert_eq!(stamps(&frames), written.stamps_ns(), "{ending} {time_base:?}");
        for (i, frame) in frames.iter().enumerate() {
            assert_is_frame(frame, i);
        }
        assert_gaps(&frames, &kept);
        if ending == "avi" || ending == "nut" {
            assert_eq!(frames[1].stamp.ns, 16_683_333);
        }
    }
}

/// Steps from 10 to 40 ms without a pattern.
fn varying(count: i64) -> Vec<i64> {
    let mut time = 0;
    (0..count)
        .map(|i| {
            time += 10 + (i * i * 7 + i * 13) % 31;
            time
        })
        .collect()
}

#[test]
fn a_variable_rate_keeps_its_times_and_invents_no_gaps() {
    let folder = tempfile::tempdir().unwrap();
    for ending in ["mkv", "mp4"] {
        let path = folder.path().join(format!("varying.{ending}"));
        let written = write(&path, &Recording { pts: &varying(200), b_frames: 3, ..Recording::default() });
        let frames = read(&path, VideoOptions::default());
        assert_eq!(stamps(&frames), written.stamps_ns());
        assert_eq!(frames.iter().map(|f| f.gap).sum::<u32>(), 0, "{ending}");
    }
}

#[test]
fn times_are_the_same_with_any_number_of_decoder_threads() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("threads.mkv");
    let written = write(&path, &Recording { pts: &varying(60), ..Recording::default() });
    for decoder_threads in [0, 1, 4] {
        let frames = read(&path, VideoOptions { decoder_threads, ..VideoOptions::default() });
        assert_eq!(stamps(&frames), written.stamps_ns());
        frames.iter().enumerate().for_each(|(i, f)| assert_is_frame(f, i));
    }
}

#[test]
fn a_span_is_exact_wherever_it_starts() {
    let folder = tempfile::tempdir().unwrap();
    for ending in ["mkv", "mp4", "nut"] {
        let path = folder.path().join(format!("span.{ending}"));
        let written: Written = write(
            &path,
            &Recording { pts: &varying(120), group: 15, b_frames: b_frames(ending), ..Recording::default() },
        );
        let all = written.stamps_ns();
        let open = |from_ns, to_ns| VideoOptions { span: Span { from_ns, to_ns }, ..VideoOptions::default() };
        for start in 0..all.len() {
            let end = (start + 7).min(all.len() - 1);
            let frames = read(&path, open(Some(all[start]), Some(all[end])));
            assert_eq!(stamps(&frames), all[start..=end], "{ending}, frame {start}");
            assert_is_frame(&frames[0], start);
            assert_eq!(frames[0].gap, 0);
        }
        // Between two frames, before the first, past the last.
        assert_eq!(stamps(&read(&path, open(Some(all[50] + 1), Some(all[53] - 1)))), all[51..53]);
        assert_eq!(stamps(&read(&path, open(Some(-1_000_000_000), Some(all[1])))), all[..2]);
        assert_eq!(stamps(&read(&path, open(Some(all[117]), Some(i64::MAX)))), all[117..]);
        let error = VideoFile::open(&path, open(Some(100_000_000_000), None)).unwrap().next_frame().unwrap_err();
        let last_s = *all.last().unwrap() as f64 * 1e-9;
        assert!(error.to_string().ends_with(&format!("the nearest is the last, at {last_s} s")), "{error}");
        let error = VideoFile::open(&path, open(Some(2), Some(1))).unwrap_err();
        assert!(error.to_string().contains("ends before it starts"), "{error}");
    }
}

/// Pictures of an AVI take their packets' times in turn, wherever reading begins.
#[test]
fn a_span_of_an_avi_whose_pictures_are_reordered_is_exact() {
    let folder = tempfile::tempdir().unwrap();
    let pts: Vec<i64> = (0..60).collect();
    for encoder in ["libx264", "mpeg4"] {
        let path = folder.path().join(format!("{encoder}.avi"));
        let recording = Recording { time_base: (1, 50), pts: &pts, group: 15, encoder, ..Recording::default() };
        assert!(write(&path, &recording).reordered);
        let all = read(&path, VideoOptions::default());
        assert_eq!(all.len(), 60);
        for start in 0..60 {
            let span = Span { from_ns: Some(all[start].stamp.ns), to_ns: None };
            let (frames, guessed) = read_and_guesses(&path, VideoOptions { span, ..VideoOptions::default() });
            assert_eq!(guessed, 60);
            assert_eq!(stamps(&frames), stamps(&all)[start..], "{encoder}, from frame {start}");
            for (frame, whole) in frames.iter().zip(&all[start..]) {
                assert_eq!(frame.picture.plane(0).unwrap().row(7), whole.picture.plane(0).unwrap().row(7));
            }
        }
    }
}

#[test]
fn the_sample_recordings_have_the_times_of_their_truth() {
    for (name, count) in [("planar", 300), ("circle", 120), ("rest", 20)] {
        let sample = Path::new(env!("CARGO_MANIFEST_DIR")).join("sample_frames");
        let truth = std::fs::read_to_string(sample.join(format!("truth/{name}.csv"))).unwrap();
        let expected: Vec<i64> = truth
            .lines()
            .skip(1)
            .map(|row| source::times::parse_seconds_ns(row.split(',').nth(1).unwrap()).unwrap())
            .collect();
        assert_eq!(expected.len(), count);
        let mut source = source::open(sample.join(format!("{name}.mkv")), SourceOptions::default()).unwrap();
        assert_eq!(source.size_px(), [1280, 1024]);
        assert_eq!(source.frame_count_hint(), Some(count as u64));
        let mut found = Vec::new();
        while let Some(frame) = source.next_frame().unwrap() {
            assert_eq!(frame.gap, 0);
            found.push(frame.stamp.ns);
        }
        assert_eq!(found, expected, "{name}");
    }
}
