//! `--record ffv1` and `h264`: pictures in a video that can be tracked like any other.

use crate::support::command::*;
use catoptra::pipeline;
use catoptra::sink::{CsvSink, OutputFrame, PictureCodec, PictureVideo, Sink};
use catoptra::source::host::HostClock;
use catoptra::source::live::RawPictures;
use catoptra::source::{
    Colour, Frame, FrameSource, Picture, PixelFormat, SourceError, Span, Timestamp, VideoFile, VideoOptions,
};
use catoptra::tally::Tally;
use catoptra::track::{TrackOptions, Tracker};
use std::path::Path;
use std::sync::atomic::AtomicBool;

/// Stamps no clock in milliseconds or microseconds has.
const ODD_NS: i64 = 1_234_567_890_123;

/// A recording whose stamps are odd to the last nanosecond.
struct OddlyTimed(VideoFile);

impl FrameSource for OddlyTimed {
    fn next_frame(&mut self) -> Result<Option<Frame>, SourceError> {
        let odd = |frame: Frame| {
            let ns = ODD_NS + frame.stamp.ns + (frame.seq as i64 * 7919) % 1013;
            Frame { stamp: Timestamp { ns, ..frame.stamp }, ..frame }
        };
        Ok(self.0.next_frame()?.map(odd))
    }

    fn size_px(&self) -> [u32; 2] {
        self.0.size_px()
    }
}

fn recording() -> OddlyTimed {
    let span = Span { from_ns: None, to_ns: Some(400_000_000) };
    OddlyTimed(VideoFile::open(sample("planar.mkv"), VideoOptions { span, ..VideoOptions::default() }).unwrap())
}

fn track(source: Box<dyn FrameSource + Send>, table: &Path, video: Option<PictureVideo>) -> String {
    let rig = rig();
    let mut sinks: Vec<Box<dyn Sink + Send>> = vec![Box::new(CsvSink::create(table, &rig, OutputFrame::Base).unwrap())];
    sinks.extend(video.map(|video| Box::new(video) as Box<dyn Sink + Send>));
    let mut tracker = Tracker::new(&rig, TrackOptions::default()).unwrap();
    let summary = pipeline::run(source, &mut tracker, sinks, &AtomicBool::new(false), |_| {}).unwrap();
    assert!(summary.sink_failures.is_empty(), "{:?}", summary.sink_failures);
    assert_eq!(summary.tally.frames, 25);
    std::fs::read_to_string(table).unwrap()
}

fn open(path: &Path) -> Box<dyn FrameSource + Send> {
    catoptra::source::open(path, Default::default()).unwrap()
}

#[test]
fn ffv1_is_tracked_to_the_same_table_with_the_same_stamps() {
    let place = tempfile::tempdir().unwrap();
    let [first, again, video] = ["first.csv", "again.csv", "pictures.mkv"].map(|name| place.path().join(name));
    let recorder = PictureVideo::create(&video, PictureCodec::Ffv1).unwrap();
    let first_file = first;
    let first = track(Box::new(recording()), &first_file, Some(recorder));
    assert!(first.contains(&ODD_NS.to_string()), "{first}");
    track(open(&video), &again, None);
    // Only σ differs: that the pictures had been H.264 before is not in the copy.
    let [first, again] = [first_file, again].map(|path| Table::read(&path));
    assert_eq!(first.rows.len(), again.rows.len());
    for (a, b) in first.rows.iter().zip(&again.rows) {
        for (column, value) in a.iter().filter(|(column, _)| !column.contains("_sd_")) {
            assert_eq!(Some(value), b.get(column), "{column} at {}", a["t_s"]);
        }
    }
}

#[test]
fn h264_keeps_the_stamps_and_nearly_the_numbers() {
    let place = tempfile::tempdir().unwrap();
    let [first, again, video] = ["first.csv", "again.csv", "pictures.mkv"].map(|name| place.path().join(name));
    let recorder = PictureVideo::create(&video, PictureCodec::H264).unwrap();
    track(Box::new(recording()), &first, Some(recorder));
    track(open(&video), &again, None);
    let [first, again] = [first, again].map(|path| Table::read(&path));
    for (a, b) in first.rows.iter().zip(&again.rows) {
        assert_eq!(a["stamp_ns"], b["stamp_ns"]);
        let apart = |column: &str| a[column].parse::<f64>().unwrap() - b[column].parse::<f64>().unwrap();
        assert!(apart("theta_deg").abs() < 0.3 && apart("coil_x_mm").abs() < 0.1, "{a:?} {b:?}");
    }
}

/// Pictures of every storage, some samples of each.
#[test]
fn what_ffv1_gives_back_is_what_it_was_given_whatever_the_storage() {
    let colours = [
        Colour::SRGB,
        Colour {
            matrix: catoptra::source::Matrix::Bt601,
            range: catoptra::source::Range::Limited,
            transfer: catoptra::source::Transfer::Linear,
            siting: catoptra::source::ChromaSiting::TopLeft,
        },
    ];
    let yuv = |x, y| PixelFormat::Yuv { chroma_log2: [x, y] };
    let formats = [
        yuv(1, 1),
        yuv(1, 0),
        yuv(0, 0),
        yuv(0, 1),
        yuv(2, 0),
        PixelFormat::Nv12,
        PixelFormat::RgbPlanar,
        PixelFormat::RgbPacked { step: 3, order: [0, 1, 2] },
        PixelFormat::RgbPacked { step: 4, order: [2, 1, 0] },
    ];
    let place = tempfile::tempdir().unwrap();
    for (k, (format, colour)) in formats.into_iter().flat_map(|f| colours.map(|c| (f, c))).enumerate() {
        let size = [64_u32, 48];
        let picture = patterned(size, format, colour);
        let video = place.path().join(format!("{k}.mkv"));
        let mut recorder = PictureVideo::create(&video, PictureCodec::Ffv1).unwrap();
        let mut estimate = catoptra::estimate::Estimate::missed(
            &Frame {
                seq: 0,
                stamp: Timestamp { ns: 5, clock: catoptra::source::Clock::Device },
                gap: 0,
                host: None,
                picture: patterned(size, format, colour),
            },
            &rig(),
            &catoptra::estimate::Miss::NotConverged,
        );
        recorder.write(&estimate, Some(&picture)).unwrap();
        estimate.stamp.ns = 17;
        recorder.write(&estimate, Some(&picture)).unwrap();
        recorder.finish(&Tally::default()).unwrap();
        let mut back = open(&video);
        let frames = [back.next_frame().unwrap().unwrap(), back.next_frame().unwrap().unwrap()];
        assert!(back.next_frame().unwrap().is_none());
        assert_eq!(frames.each_ref().map(|f| f.stamp.ns), [5, 17], "{format:?}");
        let found = frames[1].picture.colour();
        assert_eq!((found.range, found.transfer), (colour.range, colour.transfer), "{format:?}");
        if format.is_yuv() {
            assert_eq!(found, colour, "{format:?}");
        }
        for channel in 0..3 {
            let (a, b) = (picture.plane(channel).unwrap(), frames[1].picture.plane(channel).unwrap());
            assert_eq!((a.width, a.height, a.scale), (b.width, b.height, b.scale), "{format:?}");
            for row in 0..a.height {
                let samples = |p: &catoptra::source::Plane<'_>| -> Vec<u8> {
                    p.row(row).unwrap().iter().step_by(p.step).copied().collect()
                };
                assert_eq!(samples(&a), samples(&b), "{format:?}, channel {channel}, row {row}");
            }
        }
    }
}

fn patterned([width, height]: [u32; 2], format: PixelFormat, colour: Colour) -> Picture {
    let (w, h) = (width as usize, height as usize);
    let sizes = match format {
        PixelFormat::Yuv { chroma_log2: [x, y] } => vec![w * h, (w >> x) * (h >> y), (w >> x) * (h >> y)],
        PixelFormat::Nv12 => vec![w * h, w * h / 2],
        PixelFormat::RgbPacked { step, .. } => vec![w * h * usize::from(step)],
        _ => vec![w * h; 3],
    };
    let plane = |(i, size): (usize, usize)| (0..size).map(|k| (k * 7 + k / 31 + i * 50) as u8).collect();
    let planes = sizes.into_iter().enumerate().map(plane).collect();
    Picture::from_planes(width, height, format, colour, planes).unwrap()
}

/// What a Bayer camera gives, through H.264.
#[test]
fn rgb_pictures_are_recorded_with_h264_too() {
    let mosaic: Vec<u8> = (0..64 * 48 * 3).map(|i| (i / 200) as u8).collect();
    let format = "64x48:bayer_rg8@60".parse().unwrap();
    let mut source = RawPictures::new("test", Box::new(std::io::Cursor::new(mosaic)), format, HostClock::start());
    let place = tempfile::tempdir().unwrap();
    let video = place.path().join("pictures.mkv");
    let mut recorder = PictureVideo::create(&video, PictureCodec::H264).unwrap();
    let mut stamps = Vec::new();
    while let Some(frame) = source.next_frame().unwrap() {
        stamps.push(frame.stamp.ns);
        let row = catoptra::estimate::Estimate::missed(&frame, &rig(), &catoptra::estimate::Miss::NotConverged);
        recorder.write(&row, Some(&frame.picture)).unwrap();
    }
    recorder.finish(&Tally::default()).unwrap();
    let mut back = open(&video);
    let found: Vec<i64> = std::iter::from_fn(|| back.next_frame().unwrap()).map(|f| f.stamp.ns).collect();
    assert_eq!(found, stamps);
}
