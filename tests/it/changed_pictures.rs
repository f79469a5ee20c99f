//! Pictures that do not show the scene at their time: repeated ones, views out of step, a camera that shakes.

use crate::support::command::{rig, sample};
use catoptra::estimate::Estimate;
use catoptra::source::{Frame, FrameSource, Picture, VideoFile, VideoOptions};
use catoptra::track::{TrackOptions, Tracker};

/// Frames of the sample in which the catheter swings.
const FIRST: usize = 60;
const COUNT: usize = 40;
/// A column between the direct view and the mirror's, right of it.
const BETWEEN: u32 = 690;

/// Those frames, as if recorded without loss.
fn swing() -> Vec<Frame> {
    let mut source = VideoFile::open(sample("planar.mkv"), VideoOptions::default()).unwrap();
    let frames = std::iter::from_fn(|| source.next_frame().unwrap());
    let lossless = |frame: Frame| Frame { picture: composed(&frame.picture, &frame.picture, 0), ..frame };
    frames.skip(FIRST).take(COUNT).map(lossless).collect()
}

/// A picture like another, with rows of its own: by channel and number.
fn with_rows(picture: &Picture, row: impl Fn(usize, usize) -> Vec<u8>) -> Picture {
    let plane = |i: usize| (0..picture.plane(i).unwrap().height).flat_map(|j| row(i, j)).collect();
    let planes = (0..picture.format().channels()).map(plane).collect();
    let [width, height] = picture.size_px();
    Picture::from_planes(width, height, picture.format(), picture.colour(), planes).unwrap()
}

/// The columns of one picture before `column`, those of another behind it.
fn composed(left: &Picture, right: &Picture, column: u32) -> Picture {
    with_rows(left, |i, j| {
        let (left, right) = (left.plane(i).unwrap(), right.plane(i).unwrap());
        let at = (column / left.scale[0]) as usize;
        [&left.row(j).unwrap()[..at], &right.row(j).unwrap()[at..left.width]].concat()
    })
}

/// The picture moved to the right by a number of pixels, which is a multiple of a chroma sample's.
fn moved(picture: &Picture, by_px: i64) -> Picture {
    with_rows(picture, |i, j| {
        let plane = picture.plane(i).unwrap();
        let by = by_px / i64::from(plane.scale[0]);
        let from = |x: usize| (x as i64 - by).clamp(0, plane.width as i64 - 1) as usize;
        (0..plane.width).map(|x| plane.row(j).unwrap()[from(x)]).collect()
    })
}

/// The estimates, and whether there was a warning.
fn tracked(frames: &[Frame]) -> (Vec<Estimate>, bool) {
    let mut tracker = Tracker::new(&rig(), TrackOptions::default()).unwrap();
    let estimates = frames.iter().map(|frame| tracker.step(frame).unwrap()).collect();
    (estimates, tracker.warning().is_some())
}

fn word(estimate: &Estimate) -> String {
    estimate.markers[1].position.as_ref().map_or_else(|miss| miss.word(&["direct", "mirror"]), |_| "ok".to_owned())
}

#[test]
fn a_picture_shown_again_is_not_answered_and_what_follows_it_is() {
    let mut frames = swing();
    for k in 21..28 {
        frames[k].picture = composed(&frames[20].picture, &frames[20].picture, 0);
    }
    let (estimates, _) = tracked(&frames);
    for (k, estimate) in estimates.iter().enumerate() {
        let expected = if (21..28).contains(&k) { "repeated" } else { "ok" };
        assert_eq!(word(estimate), expected, "frame {k}");
    }
}

#[test]
fn views_out_of_step_widen_sigma_and_are_warned_of() {
    let frames = swing();
    let late: Vec<Frame> = frames
        .windows(2)
        .map(|pair| Frame { picture: composed(&pair[1].picture, &pair[0].picture, BETWEEN), ..pair[1] })
        .collect();
    let sd_m = |estimates: &[Estimate]| {
        let located = estimates.iter().filter_map(|estimate| estimate.markers[1].position.as_ref().ok());
        let mut all: Vec<f64> = located.map(|position| position.sd_m()).collect();
        all.sort_by(f64::total_cmp);
        all[all.len() / 2]
    };
    let ((sound, silent), (stale, warned)) = (tracked(&frames), tracked(&late));
    assert!(!silent && warned);
    assert!(sd_m(&stale) > 3.0 * sd_m(&sound), "{} and {}", sd_m(&stale), sd_m(&sound));
}

/// By two pixels either way, four times a second.
#[test]
fn a_shaking_camera_widens_sigma_by_as_much_and_is_warned_of() {
    let still = swing();
    let shaken: Vec<Frame> = still
        .iter()
        .enumerate()
        .map(|(k, frame)| Frame { picture: moved(&frame.picture, if k / 8 % 2 == 0 { 2 } else { -2 }), ..*frame })
        .collect();
    let ((still, silent), (shaken, warned)) = (tracked(&still), tracked(&shaken));
    assert!(!silent && warned);
    let squares = |skipped: usize| {
        let both = still.iter().zip(&shaken).skip(skipped).flat_map(|(a, b)| a.markers.iter().zip(&b.markers));
        let errors = both.filter_map(|(a, b)| {
            let (truth, found) = (a.position.as_ref().ok()?, b.position.as_ref().ok()?);
            Some(((found.point - truth.point).norm() / found.sd_m()).powi(2) / 3.0)
        });
        let errors: Vec<f64> = errors.collect();
        (errors.iter().sum::<f64>() / errors.len() as f64, errors.len())
    };
    // The first move is at the ninth frame.
    let (mean, count) = squares(12);
    assert!(count > 60 && (0.2..3.0).contains(&mean), "{mean} of {count} positions");
}
