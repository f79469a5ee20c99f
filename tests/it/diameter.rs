//! A rig with the diameter of another tube.

use crate::support::command::{rig, sample};
use catoptra::source::{FrameSource as _, Span, VideoFile, VideoOptions};
use catoptra::track::{TrackOptions, Tracker};

/// What is said of the diameter in the first three seconds of a recording, where the rig's is so many times the true
/// one.
fn said(name: &str, times: f64) -> Option<String> {
    let mut rig = rig();
    rig.catheter.diameter_m *= times;
    let span = Span { from_ns: None, to_ns: Some(3_000_000_000) };
    let mut source = VideoFile::open(sample(name), VideoOptions { span, ..VideoOptions::default() }).unwrap();
    let mut tracker = Tracker::new(&rig, TrackOptions::default()).unwrap();
    let mut said = Vec::new();
    while let Some(frame) = source.next_frame().unwrap() {
        tracker.step(&frame).unwrap();
        said.extend(tracker.warning().filter(|warning| warning.contains("tube diameter")));
    }
    assert!(said.len() < 2, "{said:?}");
    said.pop()
}

#[test]
fn another_diameter_is_told_with_that_which_would_fit() {
    let right_mm = rig().catheter.diameter_m * 1e3;
    for times in [0.8, 1.2] {
        let said = said("planar.mkv", times).unwrap();
        let fits_mm: f64 = said.split(" mm would fit").next().unwrap().rsplit(' ').next().unwrap().parse().unwrap();
        assert!((fits_mm / right_mm - 1.0).abs() < 0.08, "{times}: {said}");
        assert!(said.contains(if times < 1.0 { "wider" } else { "narrower" }), "{said}");
    }
    assert_eq!((said("planar.mkv", 1.0), said("circle.mkv", 1.0)), (None, None));
}
