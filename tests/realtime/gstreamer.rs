//! GStreamer pipelines: the sample decoded by GStreamer's own elements, made-up pictures of all formats, ends and
//! errors.
#![cfg(feature = "gstreamer")]

use crate::support::command::*;
use catoptra::source::host::HostClock;
use catoptra::source::live::Camera;
use catoptra::source::{
    ChromaSiting, Clock, Frame, FrameSource, Matrix, PixelFormat, Plane, Range, VideoFile, VideoOptions,
};
use std::process::Command;
use std::sync::Arc;

fn open(pipeline: &str) -> Result<Camera, String> {
    Camera::gstreamer(pipeline, HostClock::start(), Arc::default()).map_err(|e| e.to_string())
}

fn samples(plane: &Plane<'_>) -> Vec<u8> {
    (0..plane.height).flat_map(|j| plane.row(j).unwrap().iter().step_by(plane.step).copied()).collect()
}

fn decoded() -> String {
    format!("filesrc location=\"{}\" ! matroskademux ! avdec_h264", sample("planar.mkv").display())
}

#[test]
fn the_sample_is_the_same_through_gstreamer() {
    let mut pipeline = open(&decoded()).unwrap();
    let mut file = VideoFile::open(sample("planar.mkv"), VideoOptions::default()).unwrap();
    assert_eq!(pipeline.size_px(), file.size_px());
    for k in 0..300 {
        let (live, recorded): (Frame, Frame) =
            (pipeline.next_frame().unwrap().unwrap(), file.next_frame().unwrap().unwrap());
        assert_eq!((live.seq, live.stamp.ns, live.stamp.clock, live.gap), (k, recorded.stamp.ns, Clock::Stream, 0));
        let (a, b) = (live.picture.colour(), recorded.picture.colour());
        assert_eq!((a.matrix, a.range, a.siting), (b.matrix, b.range, b.siting));
        for channel in 0..3 {
            let planes = (live.picture.plane(channel).unwrap(), recorded.picture.plane(channel).unwrap());
            assert!(samples(&planes.0) == samples(&planes.1), "frame {k}, channel {channel}");
        }
    }
    // The file has ended, and so has the pipeline.
    assert!(pipeline.next_frame().unwrap().is_none());
    assert_eq!(pipeline.faults().interruptions, 0);
}

#[test]
fn pictures_of_all_formats_are_read_and_numbered() {
    // Odd widths: rows are longer than their samples.
    for format in ["I420", "NV12", "Y42B", "Y444", "YUY2", "UYVY", "RGB", "BGR", "RGBA", "BGRx", "xRGB"] {
        let caps = format!("video/x-raw,format={format},width=50,height=38,framerate=60/1");
        let mut source = open(&format!("videotestsrc num-buffers=5 pattern=red ! {caps}")).unwrap();
        assert_eq!(source.size_px(), [50, 38]);
        let frames: Vec<Frame> = std::iter::from_fn(|| source.next_frame().unwrap()).collect();
        assert_eq!(
            frames.iter().map(|f| (f.seq, f.gap)).collect::<Vec<_>>(),
            (0..5).map(|k| (k, 0)).collect::<Vec<_>>()
        );
        assert_eq!(frames[4].stamp.ns, 66_666_667 - 1, "{format}");
        let picture = &frames[2].picture;
        let map = picture.rgb_from_stored().unwrap();
        let middle = [0, 1, 2].map(|i| {
            let plane = picture.plane(i).unwrap();
            let samples = samples(&plane);
            f64::from(samples[plane.height / 2 * plane.width + plane.width / 2])
        });
        let rgb = map.apply(&middle.into());
        assert!(rgb.x > 250.0 && rgb.y < 5.0 && rgb.z < 5.0, "{format}: {rgb:?}");
    }
}

#[test]
fn what_is_said_of_colours_is_kept() {
    let caps = "video/x-raw,format=I420,width=64,height=48,colorimetry=1:4:0:1,chroma-site=jpeg";
    let mut source = open(&format!("videotestsrc num-buffers=1 ! {caps}")).unwrap();
    let colour = source.next_frame().unwrap().unwrap().picture.colour();
    assert_eq!((colour.matrix, colour.range, colour.siting), (Matrix::Bt601, Range::Full, ChromaSiting::Center));
    let mosaic = "videotestsrc num-buffers=2 ! video/x-bayer,format=rggb,width=46,height=32";
    let picture = open(mosaic).unwrap().next_frame().unwrap().unwrap().picture;
    assert_eq!((picture.size_px(), picture.format()), ([46, 32], PixelFormat::RgbPacked { step: 3, order: [0, 1, 2] }));
}

#[test]
fn frames_that_a_pipeline_drops_are_gaps_by_their_numbers() {
    let caps = "video/x-raw,format=I420,width=32,height=32,framerate=60/1";
    let mut source = open(&format!("videotestsrc num-buffers=200 ! {caps} ! identity drop-probability=0.3")).unwrap();
    let frames: Vec<Frame> = std::iter::from_fn(|| source.next_frame().unwrap()).collect();
    assert!((80..200).contains(&frames.len()), "{} frames", frames.len());
    for two in frames.windows(2) {
        let steps = (two[1].stamp.ns - two[0].stamp.ns + 8_000_000) / 16_666_667;
        assert_eq!(i64::from(two[1].gap), steps - 1);
    }
}

#[test]
fn what_is_wrong_with_a_pipeline_is_said() {
    let error = open("nosuchelement ! fakesink").unwrap_err();
    assert!(error.contains("gst:nosuchelement") && error.contains("nosuchelement\""), "{error}");
    let error = open("filesrc location=/nowhere.mkv ! matroskademux ! avdec_h264").unwrap_err();
    assert!(error.contains("/nowhere.mkv") || error.contains("not found"), "{error}");
    let error = open("videotestsrc ! video/x-raw,format=GRAY8,width=32,height=32").unwrap_err();
    assert!(error.contains("videoconvert") || error.contains("could not link"), "{error}");
    let error = open("videotestsrc num-buffers=0 ! video/x-raw,format=I420").unwrap_err();
    assert!(error.contains("no picture") && error.contains("has ended"), "{error}");
}

#[test]
fn the_command_tracks_a_pipeline_to_the_table_of_the_recording() {
    let place = Place::new();
    ended_with(&place.track(&sample("planar.mkv"), &[]), 0);
    let mut live = Command::new(env!("CARGO_BIN_EXE_catoptra"));
    live.current_dir(place.folder.path()).args(["live", &format!("gst:{} ! identity sync=true", decoded())]);
    let output = live.args(["-o", "live", "--rig"]).arg(&place.rig).output().unwrap();
    ended_with(&output, 0);
    let (offline, live) = (place.table().rows, Table::read(&place.path("live/track.csv")).rows);
    assert_eq!(offline.len(), live.len());
    let mut same = 0;
    for (a, b) in offline.iter().zip(&live).filter(|(_, b)| b["coil_status"] != "skipped_overload") {
        assert_eq!(
            (&a["stamp_ns"], &a["theta_deg"], &a["tip_x_mm"]),
            (&b["stamp_ns"], &b["theta_deg"], &b["tip_x_mm"])
        );
        same += 1;
    }
    assert!(same > 150, "{same} rows");
}
