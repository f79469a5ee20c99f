//! How much memory a frame allocates once the first frames are tracked: what selects and compares pixels uses the
//! memory of earlier frames again.

use crate::support::command::{rig, sample};
use allocation_counter::{AllocationInfo, measure};
use catoptra::source::{FrameSource, VideoFile, VideoOptions};
use catoptra::track::{TrackOptions, Tracker};

/// Frames before those that are counted, and frames counted.
const SKIPPED: usize = 30;
const FRAMES: usize = 30;
/// What was counted last, per frame: to be lowered after every improvement.
const BYTES: f64 = 630e3;
const COUNT: f64 = 515.0;
/// More than this is a step back.
const MOST: f64 = 1.15;

#[test]
fn a_frame_allocates_no_more_than_it_did() {
    let mut source = VideoFile::open(sample("planar.mkv"), VideoOptions::default()).unwrap();
    let mut tracker = Tracker::new(&rig(), TrackOptions::default()).unwrap();
    // Counted is what this thread allocates.
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).use_current_thread().build().unwrap();
    let mut all = AllocationInfo::default();
    for k in 0..SKIPPED + FRAMES {
        let frame = source.next_frame().unwrap().unwrap();
        let of_frame = pool.install(|| measure(|| drop(tracker.step(&frame).unwrap())));
        if k >= SKIPPED {
            all += of_frame;
        }
    }
    let [bytes, count] = [all.bytes_total, all.count_total].map(|total| total as f64 / FRAMES as f64);
    let kept = all.bytes_current as f64 / FRAMES as f64;
    println!("a frame allocates {bytes:.0} bytes in {count:.0} pieces, and keeps {kept:.0} bytes");
    assert!(
        bytes < MOST * BYTES && count < MOST * COUNT,
        "{bytes} bytes, {BYTES} before; {count} pieces, {COUNT} before"
    );
    assert!(kept < 2e3, "keeps {kept} bytes");
}
