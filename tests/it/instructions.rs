//! How many instructions a frame takes, counted by Valgrind: unlike times, they depend neither on the machine nor on
//! its load. Without Valgrind, or built incrementally, which makes other code, nothing is counted; CI counts.

use crate::support::command::{rig, sample};
use crate::support::skipped;
use catoptra::segment::Segmenter;
use catoptra::source::{Frame, FrameSource, VideoFile, VideoOptions};
use catoptra::track::{TrackOptions, Tracker};
use std::hint::black_box;
use std::process::Command;

/// Frames before those that are counted: the first has no predecessor, and some are fitted with other blurs too.
const SKIPPED: usize = 48;
/// Frames counted.
const FRAMES: usize = 8;
/// What was counted last, as the tests are built, with Rust 1.95 and AVX2: to be lowered after every improvement, and
/// raised only for what makes a measurement better (checks of recordings since 14.94e6, soft bands that bend).
const STEP: f64 = 16.28e6;
const SEGMENTATION: f64 = 4.343e6;
/// More than this is a step back; other compilers differ by less.
const MOST: f64 = 1.10;

#[inline(never)]
fn counted_step(tracker: &mut Tracker, frame: &Frame) {
    black_box(tracker.step(black_box(frame)).unwrap());
}

#[inline(never)]
fn counted_segmentation(segmenter: &mut Segmenter, frame: &Frame) {
    black_box(segmenter.all_blobs(black_box(&frame.picture)).unwrap());
}

/// What is counted. Everything runs in this thread: Valgrind begins to count in the thread that calls a function.
#[test]
#[ignore = "runs under Valgrind, started by the other test"]
fn frames_to_count() {
    let mut source = VideoFile::open(sample("planar.mkv"), VideoOptions::default()).unwrap();
    let mut tracker = Tracker::new(&rig(), TrackOptions::default()).unwrap();
    let mut segmenter = Segmenter::for_rig(&rig()).unwrap();
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).use_current_thread().build().unwrap();
    pool.install(|| {
        for k in 0..SKIPPED + FRAMES {
            let frame = source.next_frame().unwrap().unwrap();
            if k < SKIPPED {
                tracker.step(&frame).unwrap();
                continue;
            }
            counted_step(&mut tracker, &frame);
            counted_segmentation(&mut segmenter, &frame);
        }
    });
}

/// Instructions per frame of a function of this file.
fn counted(function: &str) -> f64 {
    let out = Command::new("valgrind")
        .args(["--tool=callgrind", "--callgrind-out-file=/dev/null"])
        .arg(format!("--toggle-collect=*{function}*"))
        .arg(std::env::current_exe().unwrap())
        .args(["--ignored", "--exact", "instructions::frames_to_count"])
        .output()
        .unwrap();
    let text = String::from_utf8_lossy(&out.stderr);
    assert!(out.status.success(), "{text}");
    let count = text.lines().find_map(|line| line.split_once("Collected : ")?.1.trim().parse::<f64>().ok());
    count.unwrap_or_else(|| panic!("no count in {text}")) / FRAMES as f64
}

#[test]
#[cfg(target_arch = "x86_64")]
fn a_frame_takes_no_more_instructions_than_it_did() {
    if option_env!("CARGO_INCREMENTAL") != Some("0") {
        return skipped("instructions are not counted: built without CARGO_INCREMENTAL=0");
    }
    if !is_x86_feature_detected!("avx2") {
        return skipped("instructions are not counted: no AVX2");
    }
    if Command::new("valgrind").arg("--version").output().is_err() {
        return skipped("instructions are not counted: no valgrind");
    }
    for (function, expected) in [("counted_step", STEP), ("counted_segmentation", SEGMENTATION)] {
        let count = counted(function);
        println!("{function}: {:.3} million instructions", count / 1e6);
        assert!(count < MOST * expected, "{function}: {count} instructions, {expected} before");
        assert!(count > expected / 2.0, "{function}: {count} instructions is far below {expected}: lower it");
    }
}
