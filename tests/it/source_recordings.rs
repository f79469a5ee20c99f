//! Recordings from cameras and disks: pixel formats, cut off, damaged, or not recordings at all.

use std::path::{Path, PathBuf};

use crate::support::command::sample;
use crate::support::encode::{Recording, luma, write};
use catoptra::source::{
    self, Frame, FrameSource, Matrix, PixelFormat, Range, SourceError, SourceOptions, Span, StreamFaults, VideoFile,
    VideoOptions,
};
use ffmpeg_the_third::color;
use ffmpeg_the_third::format::Pixel;

/// All frames, and how it ended.
fn read(path: &Path) -> (Vec<Frame>, Option<SourceError>, StreamFaults) {
    let mut source = VideoFile::open(path, VideoOptions::default()).unwrap();
    let mut frames = Vec::new();
    loop {
        match source.next_frame() {
            Ok(Some(frame)) => frames.push(frame),
            Ok(None) => return (frames, None, source.faults()),
            Err(error) => {
                assert!(source.next_frame().unwrap().is_none(), "nothing after an error");
                return (frames, Some(error), source.faults());
            }
        }
    }
}

fn open_error(path: impl AsRef<Path>) -> String {
    source::open(path, SourceOptions::default()).err().expect("an error").to_string()
}

/// 100 frames, 20 ms apart.
fn regular() -> Vec<i64> {
    (0..100).map(|i| 20 * i).collect()
}

fn written(folder: &Path, name: &str, recording: &Recording<'_>) -> (PathBuf, Vec<u8>) {
    let path = folder.join(name);
    write(&path, &Recording { pts: &regular(), size_px: [320, 240], ..*recording });
    let bytes = std::fs::read(&path).unwrap();
    (path, bytes)
}

#[test]
fn a_matroska_file_cut_in_the_middle_gives_its_readable_frames_and_then_says_so() {
    let folder = tempfile::tempdir().unwrap();
    let (path, bytes) = written(folder.path(), "cut.mkv", &Recording::default());
    for part in [0.3, 0.5, 0.9, 0.999] {
        let kept = (bytes.len() as f64 * part) as usize;
        std::fs::write(&path, &bytes[..kept]).unwrap();
        let (frames, error, _) = read(&path);
        assert!(frames.len() > (60.0 * part) as usize && frames.len() <= 100, "{part}: {}", frames.len());
        for (i, frame) in frames.iter().enumerate() {
            assert!(frame.picture.plane(0).unwrap().row(99).unwrap()[77].abs_diff(luma(i, 77, 99)) <= 2);
        }
        let last_s = frames.last().unwrap().stamp.seconds();
        let error = error.expect("an early end");
        assert!(error.is_early_end());
        let expected = format!(
            "{}: the recording ends early (the file has {kept} of at least {} bytes); {} frames could be read, the last one at {last_s} s",
            path.display(),
            bytes.len(),
            frames.len()
        );
        assert_eq!(error.to_string(), expected);
    }
}

#[test]
fn an_mp4_cut_off_is_read_with_its_index_in_front_and_refused_without() {
    let folder = tempfile::tempdir().unwrap();
    let (path, bytes) = written(folder.path(), "front.mp4", &Recording { index_first: true, ..Recording::default() });
    let (whole, error, _) = read(&path);
    assert!(whole.len() == 100 && error.is_none());
    std::fs::write(&path, &bytes[..bytes.len() * 6 / 10]).unwrap();
    let (frames, error, _) = read(&path);
    assert!((40..80).contains(&frames.len()), "{}", frames.len());
    assert_same_pictures(&frames, &whole);
    let Some(SourceError::Truncated { last_good_s, .. }) = error else { panic!("{error:?}") };
    assert_eq!(last_good_s, Some(frames.last().unwrap().stamp.seconds()));

    let (path, bytes) = written(folder.path(), "end.mp4", &Recording::default());
    std::fs::write(&path, &bytes[..bytes.len() * 6 / 10]).unwrap();
    let error = open_error(&path);
    assert!(error.contains("end.mp4: the recording's index (\"moov\") is missing"), "{error}");
}

/// Each picture is the undamaged recording's of the same time.
fn assert_same_pictures(frames: &[Frame], whole: &[Frame]) {
    for frame in frames {
        let same = whole.iter().find(|f| f.stamp == frame.stamp).unwrap();
        for row in 0..240 {
            let row_of = |f: &Frame| f.picture.plane(0).unwrap().row(row).unwrap().to_vec();
            assert!(row_of(frame) == row_of(same), "picture at {} s differs in row {row}", frame.stamp.seconds());
        }
    }
}

#[test]
fn damage_in_the_middle_is_counted_left_out_and_shown_as_a_gap() {
    let folder = tempfile::tempdir().unwrap();
    for (name, b_frames) in [("a.mkv", 0), ("b.mp4", 0), ("c.mkv", 2), ("d.mp4", 2)] {
        let (path, mut bytes) = written(folder.path(), name, &Recording { b_frames, ..Recording::default() });
        let (whole, error, faults) = read(&path);
        assert!(whole.len() == 100 && error.is_none() && faults == StreamFaults::default());
        let middle = bytes.len() / 2;
        for byte in &mut bytes[middle..middle + 60] {
            *byte ^= 0x5A;
        }
        std::fs::write(&path, &bytes).unwrap();
        let (frames, error, faults) = read(&path);
        assert!(error.is_none(), "{error:?}");
        assert!(faults.damaged_packets + faults.pictures_left_out > 0, "{faults:?}");
        assert!((84..100).contains(&frames.len()), "{}", frames.len());
        assert_same_pictures(&frames, &whole);
        assert_eq!(
            frames.len() as u32 + frames.iter().map(|f| f.gap).sum::<u32>(),
            100,
            "every camera frame is accounted for"
        );
    }
}

#[test]
fn pixel_formats_come_as_they_are_stored() {
    let folder = tempfile::tempdir().unwrap();
    let yuv = |x, y| PixelFormat::Yuv { chroma_log2: [x, y] };
    let packed = |step, order| PixelFormat::RgbPacked { step, order };
    let cases = [
        ("a.mkv", "libx264", Pixel::YUV444P, yuv(0, 0)),
        ("b.mkv", "ffv1", Pixel::YUV422P, yuv(1, 0)),
        ("c.mkv", "ffv1", Pixel::GRAY8, PixelFormat::Grey),
        ("d.mkv", "ffv1", Pixel::BGRZ, packed(4, [2, 1, 0])),
        ("e.avi", "mjpeg", Pixel::YUVJ420P, yuv(1, 1)),
        ("f.avi", "rawvideo", Pixel::BGR24, packed(3, [2, 1, 0])),
        ("g.nut", "rawvideo", Pixel::RGB24, packed(3, [0, 1, 2])),
        ("h.mkv", "ffv1", Pixel::YUV420P10LE, yuv(1, 1)),
    ];
    for (name, encoder, pixel, format) in cases {
        let path = folder.path().join(name);
        let full = pixel == Pixel::YUVJ420P;
        let colour = (color::Space::BT470BG, if full { color::Range::JPEG } else { color::Range::MPEG });
        let recording = Recording {
            pts: &[0, 1, 2, 3, 4],
            time_base: (1, 25),
            b_frames: 0,
            encoder,
            pixel,
            colour,
            ..Recording::default()
        };
        write(&path, &recording);
        let (frames, error, faults) = read(&path);
        assert!(
            error.is_none() && frames.len() == 5 && faults == StreamFaults::default(),
            "{name}: {error:?} {faults:?}"
        );
        let tolerance = match encoder {
            "libx264" | "mjpeg" => 4,
            _ => u8::from(pixel == Pixel::YUV420P10LE),
        };
        for (i, frame) in frames.iter().enumerate() {
            assert_eq!(frame.picture.format(), format, "{name}");
            assert_eq!(frame.stamp.ns, 40_000_000 * i as i64);
            let plane = frame.picture.plane(0).unwrap();
            let first = match format {
                PixelFormat::RgbPacked { order, .. } => usize::from(order[0]),
                _ => 0,
            };
            for (x, y) in [(3, 0), (15, 20), (20, 47)] {
                let place = first + x * plane.step;
                if place < 64 {
                    let found = plane.row(y).unwrap()[x * plane.step];
                    assert!(found.abs_diff(luma(i, place, y)) <= tolerance, "{name}: {found} at {x}, {y}");
                }
            }
        }
        let colour = frames[0].picture.colour();
        if format.is_yuv() {
            assert_eq!(colour.matrix, Matrix::Bt601, "{name}");
            assert_eq!(colour.range, if full { Range::Full } else { Range::Limited }, "{name}");
        }
    }
}

#[test]
fn a_pixel_format_that_is_not_read_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("high.nut");
    let pixel = Pixel::RGB565LE;
    write(&path, &Recording { pts: &[0, 40], b_frames: 0, encoder: "rawvideo", pixel, ..Recording::default() });
    let (frames, error, _) = read(&path);
    assert!(frames.is_empty());
    assert!(error.unwrap().to_string().contains("high.nut: pixel format rgb565le is not supported"));
}

#[test]
fn a_change_of_the_picture_size_names_both_sizes() {
    let folder = tempfile::tempdir().unwrap();
    let mut bytes = Vec::new();
    for size_px in [[64, 48], [96, 64]] {
        let path = folder.path().join("part.ts");
        write(&path, &Recording { size_px, pts: &regular(), ..Recording::default() });
        bytes.extend(std::fs::read(&path).unwrap());
    }
    let path = folder.path().join("two.ts");
    std::fs::write(&path, bytes).unwrap();
    let (frames, error, _) = read(&path);
    let error = error.unwrap().to_string();
    let expected = format!("the picture size changes from 64x48 to 96x64 pixels at frame {} (", frames.len());
    assert!(error.contains(&expected), "{error}");
}

#[test]
fn repeated_stamps_and_a_clock_that_goes_back_are_kept_and_counted() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("repeated.mkv");
    // In whole milliseconds of Matroska, the third stamp is the second.
    let pts = [0, 100, 101, 200, 300, 400];
    write(
        &path,
        &Recording { pts: &pts, time_base: (1, 10_000), b_frames: 0, encoder: "ffv1", ..Recording::default() },
    );
    let (frames, error, faults) = read(&path);
    assert!(error.is_none());
    let ms: Vec<i64> = frames.iter().map(|f| f.stamp.ns / 1_000_000).collect();
    assert_eq!(ms, [0, 10, 10, 20, 30, 40]);
    assert_eq!(faults, StreamFaults { repeated_stamps: 1, ..StreamFaults::default() });

    let part = folder.path().join("part.ts");
    write(&part, &Recording { pts: &regular(), ..Recording::default() });
    let bytes = std::fs::read(&part).unwrap();
    let path = folder.path().join("twice.ts");
    std::fs::write(&path, [bytes.clone(), bytes].concat()).unwrap();
    let (frames, error, faults) = read(&path);
    assert!(error.is_none(), "{error:?}");
    // Where transport packets do not continue, the one before counts as damaged, with what is built on it.
    assert!((190..=200).contains(&frames.len()), "{}", frames.len());
    assert_eq!(faults.backward_stamps, 1, "{faults:?}");
    assert_eq!(frames.len() as u64 + faults.damaged_packets + faults.pictures_left_out, 200);
    let second = frames.iter().rposition(|f| f.stamp == frames[0].stamp).unwrap();
    assert_eq!(frames[second].gap, 0);
    assert_eq!(frames[second..].iter().map(|f| f.gap).sum::<u32>(), 0);
}

#[test]
fn what_is_no_recording_is_refused_with_the_reason() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    assert_eq!(open_error(at("none.mkv")), format!("{}: no such file or folder", at("none.mkv").display()));
    assert!(open_error(at("with\0zero.mkv")).contains("cannot be read"));

    std::fs::write(at("notes.txt"), "plain text\n".repeat(100)).unwrap();
    std::fs::write(at("table.csv"), "a,b\n1,2\n".repeat(100)).unwrap();
    std::fs::write(at("empty.mkv"), "").unwrap();
    for name in ["notes.txt", "table.csv", "empty.mkv"] {
        let error = open_error(at(name));
        assert!(error.contains(&format!("{name}: is not a video that can be read")), "{error}");
    }

    // A second of silence.
    let mut sound =
        b"RIFF\x24\x3e\0\0WAVEfmt \x10\0\0\0\x01\0\x01\0\x40\x1f\0\0\x40\x1f\0\0\x01\0\x08\0data\0\x3e\0\0".to_vec();
    sound.resize(sound.len() + 0x3e00, 0x80);
    std::fs::write(at("sound.wav"), sound).unwrap();
    assert!(open_error(at("sound.wav")).contains("sound.wav: has no video stream"));

    let error = VideoFile::open(folder.path(), VideoOptions::default()).unwrap_err().to_string();
    assert!(error.contains("is a folder; expected a video file"), "{error}");

    let path = at("own:time.mkv");
    write(&path, &Recording { pts: &[0, 20, 40], ..Recording::default() });
    let stated_rate = Some("60".parse().unwrap());
    let error =
        source::open(&path, SourceOptions { stated_rate, ..SourceOptions::default() }).err().unwrap().to_string();
    assert!(error.contains("a recording has its own time stamps"), "{error}");
}

/// A stream without a container has no times; what libav would make up is not taken.
#[test]
fn a_raw_stream_needs_its_rate_and_takes_it() {
    let folder = tempfile::tempdir().unwrap();
    for (name, encoder, pixel, b_frames) in
        [("raw.h264", "libx264", Pixel::YUV420P, 2), ("raw.mjpeg", "mjpeg", Pixel::YUVJ420P, 0)]
    {
        let (path, _) = written(folder.path(), name, &Recording { encoder, pixel, b_frames, ..Recording::default() });
        let printed = open_error(&path);
        assert!(
            printed.contains(name) && printed.contains("has no time stamp") && printed.contains("--fps"),
            "{printed}"
        );
        let stated_rate = Some("50".parse().unwrap());
        let mut source = source::open(&path, SourceOptions { stated_rate, ..SourceOptions::default() }).unwrap();
        let frames: Vec<Frame> = std::iter::from_fn(|| source.next_frame().unwrap()).collect();
        let stamps: Vec<i64> = frames.iter().map(|frame| frame.stamp.ns).collect();
        assert_eq!(stamps, (0..100).map(|k| 20_000_000 * k).collect::<Vec<_>>(), "{name}");
        assert!(frames.iter().all(|frame| frame.gap == 0 && frame.stamp.clock == source::Clock::StatedRate));
        // Motion JPEG is coarse as it is written here.
        for (i, frame) in frames.iter().enumerate().filter(|_| encoder == "libx264") {
            let luma_there = frame.picture.plane(0).unwrap().row(99).unwrap()[77];
            assert!(luma_there.abs_diff(luma(i, 77, 99)) <= 6, "{name}: frame {i} is another");
        }
    }
    let (path, _) = written(folder.path(), "with_times.mkv", &Recording::default());
    let stated_rate = Some("50".parse().unwrap());
    let printed =
        source::open(&path, SourceOptions { stated_rate, ..SourceOptions::default() }).err().unwrap().to_string();
    assert!(printed.contains("has its own time stamps"), "{printed}");
}

/// Of the quantisers that the packets of both recordings state (tests/data/coded/README.md), in the order of display.
#[test]
fn pictures_of_h265_and_av1_have_the_quantiser_that_their_headers_state() {
    let levels = |name: &str| -> Vec<Vec<u8>> {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/coded").join(name);
        let (frames, error, _) = read(&path);
        assert!(error.is_none(), "{name}: {error:?}");
        frames.iter().map(|frame| frame.picture.quantisation().unwrap().levels.clone()).collect()
    };
    let everywhere = |levels: [u8; 10]| levels.map(|level| vec![level; 20]).to_vec();
    // I, P and two kinds of B pictures.
    assert_eq!(levels("h265.mkv"), everywhere([27, 32, 31, 32, 30, 32, 31, 30, 32, 30]));
    // Indices 67, 105 (shown when its turn comes), 140, 151 and 160.
    assert_eq!(levels("av1.mkv"), everywhere([23, 36, 35, 36, 33, 36, 35, 36, 28, 36]));
}

/// The sample's pictures are reordered, and each says how coarsely it was quantised.
#[test]
fn the_number_of_threads_does_not_change_a_picture_or_its_quantisation() {
    let read = |decoder_threads| {
        let span = Span { from_ns: None, to_ns: Some(1_500_000_000) };
        let options = VideoOptions { decoder_threads, span, ..VideoOptions::default() };
        let mut source = VideoFile::open(sample("planar.mkv"), options).unwrap();
        let mut frames = Vec::new();
        while let Some(frame) = source.next_frame().unwrap() {
            let luma = frame.picture.plane(0).unwrap();
            let rows = (0..luma.height).step_by(16).flat_map(|y| luma.row(y).unwrap().to_vec());
            frames.push((frame.stamp, frame.picture.quantisation().unwrap().clone(), rows.collect::<Vec<_>>()));
        }
        frames
    };
    let one = read(1);
    assert_eq!(one.len(), 91);
    for threads in [2, 3, 8] {
        assert!(read(threads) == one, "{threads} threads");
    }
}
