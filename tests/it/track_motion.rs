//! Impossible motion: pictures of another time inserted among others.

use crate::support::command::*;
use catoptra::estimate::Miss;
use catoptra::source::{Frame, FrameSource as _, VideoFile, VideoOptions};
use catoptra::track::{TrackOptions, Tracker};

/// Damage can make a picture whose bands are elsewhere, all of it in order: what tells is where they were just before.
#[test]
fn a_jump_that_the_motion_before_does_not_allow_is_no_measurement() {
    let mut source = VideoFile::open(sample("planar.mkv"), VideoOptions::default()).unwrap();
    let mut frames: Vec<Frame> = (0..91).map(|_| source.next_frame().unwrap().unwrap()).collect();
    // The tip is 25 mm away there.
    let elsewhere = frames.pop().unwrap();
    frames.truncate(16);
    frames[13].picture = elsewhere.picture;
    let tracked = |full_frame: bool| {
        let mut tracker = Tracker::new(&rig(), TrackOptions { full_frame, ..TrackOptions::default() }).unwrap();
        frames.iter().map(|frame| tracker.step(frame).unwrap()).collect::<Vec<_>>()
    };
    let estimates = tracked(false);
    for estimate in &estimates {
        let is_jump = estimate.seq == 13;
        let refused = |miss: &Miss| matches!(miss, Miss::ImplausibleMotion { times } if *times > 1.5);
        assert!(estimate.markers[0].position.is_ok(), "the base stands still, frame {}", estimate.seq);
        for marker in &estimate.markers[1..] {
            assert_eq!(marker.position.as_ref().is_err_and(refused), is_jump, "frame {}", estimate.seq);
            assert_eq!(marker.position.is_ok(), !is_jump, "frame {}", estimate.seq);
        }
        assert_eq!(estimate.tangent.as_ref().is_err_and(refused), is_jump);
        assert_eq!(estimate.deflection.as_ref().is_err_and(refused), is_jump);
    }
    let places = |estimates: &[catoptra::estimate::Estimate]| {
        let all = estimates.iter().flat_map(|e| e.markers.iter().map(|m| m.position.as_ref().ok().map(|p| p.point)));
        all.collect::<Vec<_>>()
    };
    assert_eq!(places(&tracked(true)), places(&estimates), "windows change the result");
}
