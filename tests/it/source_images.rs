//! Folders of pictures: their order, times, and faults.

use std::path::Path;

use catoptra::source::{self, Clock, Frame, PixelFormat, SourceError, SourceOptions, Span};
use image::{DynamicImage, GrayImage, ImageBuffer, Luma, Rgb, RgbImage};

const TABLE: SourceOptions = SourceOptions {
    span: Span { from_ns: None, to_ns: None },
    stated_rate: None,
    decoder_threads: 1,
    keep_damaged: false,
};

fn stated(rate: &str) -> SourceOptions {
    SourceOptions { stated_rate: Some(rate.parse().unwrap()), ..TABLE }
}

fn grey(folder: &Path, name: &str, value: u8) {
    GrayImage::from_pixel(8, 6, Luma([value])).save(folder.join(name)).unwrap();
}

fn read(folder: &Path, options: SourceOptions) -> Result<Vec<Frame>, SourceError> {
    let mut source = source::open(folder, options)?;
    let mut frames = Vec::new();
    while let Some(frame) = source.next_frame()? {
        assert_eq!(source.size_px(), frame.picture.size_px());
        frames.push(frame);
    }
    Ok(frames)
}

fn value(frame: &Frame) -> u8 {
    frame.picture.plane(0).unwrap().data[0]
}

#[test]
fn pictures_at_a_stated_rate_come_in_the_order_people_count() {
    let folder = tempfile::tempdir().unwrap();
    for i in [1, 2, 9, 10, 11, 100] {
        grey(folder.path(), &format!("img{i}.png"), i);
    }
    std::fs::write(folder.path().join("notes.txt"), "").unwrap();
    std::fs::write(folder.path().join("._img1.png"), "").unwrap();
    let frames = read(folder.path(), stated("60000/1001")).unwrap();
    assert_eq!(frames.iter().map(value).collect::<Vec<_>>(), [1, 2, 9, 10, 11, 100]);
    assert_eq!(frames.iter().map(|f| f.stamp.ns).collect::<Vec<_>>()[..3], [0, 16_683_333, 33_366_667]);
    assert!(frames.iter().all(|f| f.stamp.clock == Clock::StatedRate && f.gap == 0));
}

#[test]
fn the_table_gives_order_exact_times_and_gaps() {
    let folder = tempfile::tempdir().unwrap();
    let mut table = "exposure,file,t_s\n".to_owned();
    let mut expected = Vec::new();
    for i in 0..30_i64 {
        grey(folder.path(), &format!("{}.png", 99 - i), i as u8);
        let ms = 17 * i + if i >= 20 { 34 } else { 0 };
        table += &format!("5,{}.png,1700000000.{ms:03}\n", 99 - i);
        expected.push(1_700_000_000_000_000_000 + ms * 1_000_000);
    }
    std::fs::write(folder.path().join("times.csv"), &table).unwrap();
    let frames = read(folder.path(), TABLE).unwrap();
    assert_eq!(frames.iter().map(|f| f.stamp.ns).collect::<Vec<_>>(), expected);
    assert_eq!(frames.iter().map(value).collect::<Vec<_>>(), (0..30).collect::<Vec<u8>>());
    assert!(frames.iter().all(|f| f.stamp.clock == Clock::Container));
    assert_eq!(frames.iter().map(|f| f.gap).collect::<Vec<_>>()[19..22], [0, 2, 0]);

    let span = Span { from_ns: Some(expected[3]), to_ns: Some(expected[5]) };
    let part = read(folder.path(), SourceOptions { span, ..TABLE }).unwrap();
    assert_eq!(part.iter().map(value).collect::<Vec<_>>(), [3, 4, 5]);
    let span = Span { from_ns: Some(0), to_ns: Some(1) };
    let error = read(folder.path(), SourceOptions { span, ..TABLE }).unwrap_err().to_string();
    assert!(error.contains("the nearest is the first, at 1700000000 s"), "{error}");
}

#[test]
fn the_table_may_be_in_nanoseconds() {
    let folder = tempfile::tempdir().unwrap();
    grey(folder.path(), "a.png", 1);
    grey(folder.path(), "b.png", 2);
    std::fs::write(
        folder.path().join("times.csv"),
        "\u{feff}file,stamp_ns\r\na.png, 1234567890123456789\r\nb.png,1234567890123456790\r\n",
    )
    .unwrap();
    let frames = read(folder.path(), TABLE).unwrap();
    assert_eq!(
        frames.iter().map(|f| f.stamp.ns).collect::<Vec<_>>(),
        [1_234_567_890_123_456_789, 1_234_567_890_123_456_790]
    );
}

#[test]
fn kinds_of_pictures() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let rgb = RgbImage::from_pixel(8, 6, Rgb([10, 20, 30]));
    for name in ["1.png", "2.bmp", "3.ppm", "4.tiff"] {
        rgb.save(at(name)).unwrap();
    }
    DynamicImage::ImageRgb8(rgb).to_rgba8().save(at("5.png")).unwrap();
    ImageBuffer::<Rgb<u16>, _>::from_pixel(8, 6, Rgb([2570, 5140, 7710])).save(at("6.png")).unwrap();
    ImageBuffer::<Luma<u16>, _>::from_pixel(8, 6, Luma([2570])).save(at("7.tif")).unwrap();
    let frames = read(folder.path(), stated("25")).unwrap();
    assert_eq!(frames.len(), 7);
    for frame in &frames[..6] {
        let found = [0, 1, 2].map(|i| frame.picture.plane(i).unwrap().row(5).unwrap()[0]);
        assert_eq!(found, [10, 20, 30], "{frame:?}");
    }
    assert_eq!(frames[4].picture.format(), PixelFormat::RgbPacked { step: 4, order: [0, 1, 2] });
    assert_eq!((frames[6].picture.format(), value(&frames[6])), (PixelFormat::Grey, 10));
}

#[test]
fn what_is_wrong_is_named_with_file_and_line() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let error = |options| read(folder.path(), options).unwrap_err().to_string();
    assert!(error(TABLE).contains("no picture in this folder (files ending in png, jpg"));
    for name in ["a.webp", "b.WEBP", "c.jp2"] {
        std::fs::write(at(name), "another kind of picture").unwrap();
    }
    let printed = error(TABLE);
    assert!(
        printed.contains("3 pictures ending in WEBP, jp2, webp cannot be read")
            && printed.contains("mogrify -format png")
    );
    for i in 1..=3 {
        grey(folder.path(), &format!("{i}.png"), i);
    }
    let says_how = error(TABLE);
    assert!(
        says_how.contains("times.csv") && says_how.contains("\"file,t_s\"") && says_how.contains("--fps"),
        "{says_how}"
    );
    let tables = [
        ("name,t_s\n1.png,0\n", "times.csv:1: the header is \"name,t_s\", expected the columns file and t_s"),
        ("file,t_s\n1.png,0\n2.png,0.1\n4.png,0.2\n", "times.csv:4: there is no picture \"4.png\" in this folder"),
        ("file,t_s\n1.png,0\n2.png,0.1\n", "times.csv: picture 3.png has no row in this table"),
        (
            "file,t_s\n1.png,0\n2.png,0.2\n3.png,0.1\n",
            "times.csv:4: picture 3.png at 100000000 ns is not later than 2.png",
        ),
        ("file,t_s\n1.png,0\n1.png,0.2\n", "times.csv:3: picture 1.png has a row above already"),
        ("file,t_s\n1.png,0\n2.png,soon\n", "times.csv:3: \"soon\" is not a number of seconds (picture 2.png)"),
        ("file,stamp_ns\n1.png,0.5\n", "times.csv:2: \"0.5\" is not a whole number of nanoseconds (picture 1.png)"),
        ("file,t_s\n1.png,0,7\n", "times.csv:2: is not a row of a table"),
    ];
    for (table, expected) in tables {
        std::fs::write(at("times.csv"), table).unwrap();
        let found = error(TABLE);
        assert!(found.contains(expected), "{found}");
    }
    assert!(error(stated("60")).contains("has times.csv, and 60 frames per second are stated"));
    std::fs::remove_file(at("times.csv")).unwrap();

    GrayImage::from_pixel(8, 7, Luma([0])).save(at("4.png")).unwrap();
    assert!(error(stated("60")).contains("the picture size changes from 8x6 to 8x7 pixels at frame 3 (4.png)"));
    std::fs::write(at("4.png"), "no picture").unwrap();
    // A picture that cannot be read costs its frame and no other.
    let frames = read(folder.path(), stated("60")).unwrap();
    assert_eq!(frames.iter().filter(|frame| !frame.picture.is_damaged()).count(), 3);
    // Nor does the first, which is tracked as damaged.
    std::fs::write(at("0.png"), "no picture").unwrap();
    let kept = read(folder.path(), SourceOptions { keep_damaged: true, ..stated("60") }).unwrap();
    let damaged: Vec<bool> = kept.iter().map(|frame| frame.picture.is_damaged()).collect();
    assert_eq!(damaged, [true, false, false, false, true]);
    let missing = source::open(at("none"), stated("60")).err().unwrap().to_string();
    assert!(missing.contains("none: no such file or folder"), "{missing}");
}
