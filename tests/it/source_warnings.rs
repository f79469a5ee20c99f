//! Every change to a recording's content is reported, once.

use std::io::Write;
use std::path::Path;
use std::sync::{Arc, Mutex};

use crate::support::encode::{Recording, write};
use catoptra::source::{self, SourceOptions};
use ffmpeg_the_third::color;
use ffmpeg_the_third::format::Pixel;

#[derive(Clone, Default)]
struct Lines(Arc<Mutex<Vec<u8>>>);

impl Write for Lines {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.0.lock().unwrap().extend_from_slice(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

/// Reads all frames; the warnings that came with them.
fn warnings(path: &Path, options: SourceOptions) -> Vec<String> {
    let lines = Lines::default();
    let writer = lines.clone();
    let subscriber = tracing_subscriber::fmt()
        .with_writer(move || writer.clone())
        .without_time()
        .with_ansi(false)
        .with_target(false)
        .finish();
    tracing::subscriber::with_default(subscriber, || {
        let mut source = source::open(path, options).unwrap();
        while source.next_frame().unwrap().is_some() {}
    });
    let text = String::from_utf8(lines.0.lock().unwrap().clone()).unwrap();
    text.lines().map(|l| l.replace(&format!("{}: ", path.display()), "").trim().to_owned()).collect()
}

/// FFV1 as these tests write it has no checksums.
const UNCHECKED: &str = "WARN its pictures (FFV1) have no checksums: damage in them cannot be noticed";

#[test]
fn a_recording_that_needs_nothing_done_is_read_without_a_word() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("plain.mkv");
    write(&path, &Recording { pts: &[0, 20, 40], ..Recording::default() });
    assert_eq!(warnings(&path, SourceOptions::default()), [""; 0]);
}

#[test]
fn ten_bits_and_a_missing_matrix_are_named_once() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("deep.mkv");
    let recording = Recording {
        pts: &[0, 20, 40, 60],
        b_frames: 0,
        encoder: "ffv1",
        pixel: Pixel::YUV420P10LE,
        colour: (color::Space::Unspecified, color::Range::MPEG),
        ..Recording::default()
    };
    write(&path, &recording);
    let expected = [
        UNCHECKED,
        "WARN the recording does not say its YUV matrix; BT.601 is taken, as is usual for 48 rows",
        "WARN pixel format yuv420p10le is reduced to 8 bits (yuv420p) by swscale",
    ];
    assert_eq!(warnings(&path, SourceOptions::default()), expected);
}

#[test]
fn repeated_stamps_and_a_varying_rate_are_named_and_counted() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("times.mkv");
    let mut time = 0;
    let mut pts = vec![0, 3, 6];
    pts.extend((0..100).map(|i| {
        time += 100 + 10 * ((i * i * 7 + i * 13) % 31);
        time
    }));
    write(
        &path,
        &Recording { pts: &pts, time_base: (1, 10_000), b_frames: 0, encoder: "ffv1", ..Recording::default() },
    );
    let found = warnings(&path, SourceOptions::default());
    assert_eq!(found[0], UNCHECKED);
    assert_eq!(found[1], "WARN frame 1 repeats the time stamp 0 s; it is kept, more are counted");
    let varying = "WARN the time from frame to frame varies (median ";
    assert!(found[2].starts_with(varying) && found[2].ends_with("are not counted"), "{}", found[2]);
    assert_eq!(found.len(), 3);
}

#[test]
fn damage_is_named_and_summed_up() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("damaged.mkv");
    let pts: Vec<i64> = (0..100).map(|i| 20 * i).collect();
    write(&path, &Recording { pts: &pts, size_px: [320, 240], b_frames: 0, ..Recording::default() });
    let mut bytes = std::fs::read(&path).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle..middle + 60].iter_mut().for_each(|b| *b ^= 0x5A);
    std::fs::write(&path, bytes).unwrap();
    let found = warnings(&path, SourceOptions::default());
    assert!(found[0].contains("is damaged and left out, as are those predicted from it"), "{found:?}");
    assert!(found.last().unwrap().ends_with("damaged pictures in all"), "{found:?}");
}

#[test]
fn a_missing_number_at_a_stated_rate_and_sixteen_bits_are_named() {
    let folder = tempfile::tempdir().unwrap();
    for i in [1, 2, 4] {
        let picture = image::ImageBuffer::<image::Luma<u16>, _>::new(8, 6);
        picture.save(folder.path().join(format!("img{i:02}.png"))).unwrap();
    }
    let options = SourceOptions { stated_rate: Some("25".parse().unwrap()), ..SourceOptions::default() };
    let found = warnings(folder.path(), options);
    assert_eq!(found.len(), 2, "{found:?}");
    let lost = "img02.png is followed by img04.png; missing numbers count as lost pictures: 1";
    assert!(found[0].contains(lost) && found[1].contains("samples of 16 bits are reduced to 8"), "{found:?}");
    let mut source = catoptra::source::open(folder.path(), options).unwrap();
    let frames = std::iter::from_fn(|| source.next_frame().unwrap()).map(|frame| (frame.stamp.ns, frame.gap));
    assert_eq!(frames.collect::<Vec<_>>(), [(0, 0), (40_000_000, 0), (120_000_000, 1)]);
    // Numbers of another kind.
    std::fs::rename(folder.path().join("img04.png"), folder.path().join("img900.png")).unwrap();
    let found = warnings(folder.path(), options);
    assert!(found[0].contains("img900.png, and the numbers are not evenly spaced"), "{found:?}");
}

#[test]
fn pictures_of_two_cameras_in_one_folder_are_doubted() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["cam1_0000", "cam1_0001", "cam1_0002", "cam2_0000", "cam2_0001"] {
        image::GrayImage::new(8, 6).save(folder.path().join(format!("{name}.png"))).unwrap();
    }
    let options = SourceOptions { stated_rate: Some("25".parse().unwrap()), ..SourceOptions::default() };
    let found = warnings(folder.path(), options);
    let place = "cam1_0002.png is followed by cam2_0000.png, whose number is not higher: are there pictures of two";
    assert!(found.len() == 1 && found[0].contains(place), "{found:?}");
}

#[test]
fn pictures_none_of_which_can_be_read_are_refused_with_a_reason() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["f_0001.tif", "f_0002.tif"] {
        std::fs::write(folder.path().join(name), b"II*\0 and no more").unwrap();
    }
    let options = SourceOptions { stated_rate: Some("25".parse().unwrap()), ..SourceOptions::default() };
    let error = source::open(folder.path(), options).err().unwrap().to_string();
    assert!(
        error.contains("f_0001.tif: is not a picture that can be read: ") && error.contains("png *.tif"),
        "{error}"
    );
    assert!(error.contains("No other picture of this folder, or of the span") && !error.contains("read: ."), "{error}");
    std::fs::remove_file(folder.path().join("f_0001.tif")).unwrap();
    std::fs::rename(folder.path().join("f_0002.tif"), folder.path().join("f_0002.dpx")).unwrap();
    let error = source::open(folder.path(), options).err().unwrap().to_string();
    assert!(error.contains("1 picture ending in dpx cannot be read"), "{error}");
}

/// A changed bit may spoil the rest of the picture, and nothing shows it.
#[test]
fn pictures_without_any_check_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let pts: Vec<i64> = (0..3).map(|i| 20 * i).collect();
    for (encoder, told) in [("huffyuv", true), ("ffvhuff", true), ("rawvideo", false)] {
        let path = folder.path().join(format!("{encoder}.mkv"));
        let pixel = Pixel::YUV422P;
        write(&path, &Recording { pts: &pts, encoder, b_frames: 0, pixel, ..Recording::default() });
        let words = format!("({}) have no checksums", encoder.to_ascii_uppercase());
        let found = warnings(&path, SourceOptions::default());
        assert_eq!(found.iter().any(|warning| warning.contains(&words)), told, "{found:?}");
    }
}

/// As `cat` joins them: the second one has an index of its own, which libav skips.
#[test]
fn an_mp4_behind_another_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("joined.mp4");
    let pts: Vec<i64> = (0..10).map(|i| 20 * i).collect();
    write(&path, &Recording { pts: &pts, ..Recording::default() });
    assert_eq!(warnings(&path, SourceOptions::default()), Vec::<String>::new());
    std::fs::write(&path, std::fs::read(&path).unwrap().repeat(2)).unwrap();
    let found = warnings(&path, SourceOptions::default());
    assert!(found.iter().any(|warning| warning.contains("only the first is read")), "{found:?}");
}

/// One that is not of the sequence would shift all after it.
#[test]
fn pictures_of_which_some_have_no_number_have_no_times_by_rate() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["f_0001", "f_0002", "f_0004", "background"] {
        image::GrayImage::new(8, 6).save(folder.path().join(format!("{name}.png"))).unwrap();
    }
    let options = SourceOptions { stated_rate: Some("25".parse().unwrap()), ..SourceOptions::default() };
    let error = source::open(folder.path(), options).err().unwrap().to_string();
    assert!(
        error.contains("background.png: its name does not end with a number, as that of f_0001.png does"),
        "{error}"
    );
    std::fs::remove_file(folder.path().join("background.png")).unwrap();
    assert!(warnings(folder.path(), options)[0].contains("lost pictures: 1"));
}

#[test]
fn milliseconds_in_a_column_of_seconds_are_doubted() {
    let folder = tempfile::tempdir().unwrap();
    let mut table = "file,t_s\n".to_owned();
    for i in 0..5 {
        image::GrayImage::new(8, 6).save(folder.path().join(format!("{i}.png"))).unwrap();
        table += &format!("{i}.png,{}\n", 16.667 * f64::from(i));
    }
    std::fs::write(folder.path().join("times.csv"), table).unwrap();
    let found = warnings(folder.path(), SourceOptions::default());
    assert!(found[0].contains("the pictures are 16.667 s apart: t_s is in seconds; are these times?"), "{found:?}");
}

#[test]
fn a_recording_that_asks_to_be_turned_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("turned.mp4");
    write(&path, &Recording { pts: &[0, 20, 40], ..Recording::default() });
    assert_eq!(warnings(&path, SourceOptions::default()), [""; 0]);
    // Half a turn, in the header of the track: its matrix begins 40 bytes behind its name.
    let mut bytes = std::fs::read(&path).unwrap();
    let matrix = bytes.windows(4).position(|name| name == b"tkhd").unwrap() + 44;
    for (place, value) in [(0, -1_i32 << 16), (4, -1 << 16)] {
        bytes[matrix + 4 * place..][..4].copy_from_slice(&value.to_be_bytes());
    }
    std::fs::write(&path, bytes).unwrap();
    let printed = warnings(&path, SourceOptions::default());
    assert!(matches!(printed.as_slice(), [only] if only.contains("turn or mirror its pictures")), "{printed:?}");
}
