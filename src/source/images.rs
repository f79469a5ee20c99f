//! Folders of pictures.
//!
//! In: a folder of PNG, JPEG, TIFF, BMP or PNM pictures, and their times: a table `times.csv` beside them, or a stated
//! frame rate. Out: the pictures as frames, in the order of the table, or in natural order of their names (`img2`
//! before `img10`), whose missing numbers are lost pictures.
//!
//! 8-bit grey and RGB are taken as they are, 16 bits are reduced to 8 with a warning, transparency is ignored. All are
//! taken for sRGB. A JPEG is the RGB that its decoder gives. A rotation in EXIF data is not applied: calibration refers
//! to the sensor's own rows and columns.
//!
//! `times.csv`: a header line with `file` (the picture's name in this folder) and `t_s` (seconds, decimal, read
//! exactly) or `stamp_ns` (whole nanoseconds; it wins if both are there); other columns are ignored. One row per
//! picture, in rising order of time.

use std::cmp::Ordering;
use std::collections::BTreeSet;
use std::io::Cursor;
use std::path::{Path, PathBuf};

use image::DynamicImage;

use crate::csv_lines::Lines;

use super::gaps::GapCounter;
use super::jpeg;
use super::names::{conversion_advice, is_picture_name, to_png};
use super::times::{FrameRate, parse_seconds_ns, seconds};
use super::{
    Clock, Colour, Frame, FrameSource, Picture, PictureError, PixelFormat, SourceError, Span, StreamFaults, Timestamp,
};

/// Name of the table of times.
const TABLE: &str = "times.csv";

/// Where the times of pictures come from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ImageTiming {
    /// The table `times.csv` in the folder.
    Table,
    /// No clock: frame i was taken at i / rate, lost ones included.
    StatedRate(FrameRate),
}

/// A folder of pictures.
#[derive(Debug)]
pub struct ImageFolder {
    folder: PathBuf,
    /// Names and times, nanoseconds.
    rows: Vec<(String, i64)>,
    next: usize,
    given: u64,
    clock: Clock,
    gaps: GapCounter,
    size_px: [u32; 2],
    depth_named: bool,
    keep_damaged: bool,
    layout: Option<(PixelFormat, Colour)>,
    /// Pictures left out since the last frame.
    missing: u32,
    faults: StreamFaults,
}

/// Pictures further apart hardly show a catheter move: their times are probably in another unit. Milliseconds read as
/// seconds give 1.67 s even at 600 frames per second.
const SLOW_S: f64 = 1.5;
/// Less from picture to picture is no camera's time in the stated unit.
const FAST_S: f64 = 1e-4;

impl ImageFolder {
    /// Lists the pictures of the folder and their times; those outside `span` are left out.
    ///
    /// # Errors
    /// When the folder, its pictures or their times cannot be read or are inconsistent.
    pub fn open(folder: impl AsRef<Path>, timing: ImageTiming, span: Span) -> Result<Self, SourceError> {
        let folder = folder.as_ref().to_path_buf();
        span.check()?;
        let names = picture_names(&folder)?;
        let table = folder.join(TABLE);
        let (mut rows, clock) = match (timing, table.is_file()) {
            (ImageTiming::Table, true) => (read_table(&table, &names)?, Clock::Container),
            (ImageTiming::Table, false) => return Err(SourceError::NoTimes { path: folder }),
            (ImageTiming::StatedRate(rate), true) => {
                return Err(SourceError::TwoTimes { path: folder, rate: rate.to_string() });
            }
            (ImageTiming::StatedRate(rate), false) => {
                let row = |(i, name): (u64, String)| {
                    let late = || SourceError::TimeRange { path: folder.clone(), seq: i };
                    Ok((name, rate.stamp_ns(i).ok_or_else(late)?))
                };
                let rows = positions(&folder, &names)?.into_iter().zip(names).map(row);
                (rows.collect::<Result<Vec<_>, SourceError>>()?, Clock::StatedRate)
            }
        };
        let stated_ns = match timing {
            ImageTiming::Table => None,
            ImageTiming::StatedRate(rate) => Some(1e9 / rate.hz()),
        };
        let gaps = GapCounter::new(stated_ns, resolution_ns(&rows));
        let before_s =
            rows.iter().rev().find(|(_, ns)| span.from_ns.is_some_and(|from| *ns < from)).map(|r| seconds(r.1));
        let after_s = rows.iter().find(|(_, ns)| span.to_ns.is_some_and(|to| *ns > to)).map(|r| seconds(r.1));
        rows.retain(|(_, ns)| span.contains(*ns));
        let Some((name, _)) = rows.first() else {
            let (from_s, to_s) = (span.from_ns.map(seconds), span.to_ns.map(seconds));
            return Err(SourceError::EmptySpan { path: folder, from_s, to_s, before_s, after_s });
        };
        // The first readable one sets the size.
        let size = |(name, _): &(String, i64)| size_px(&folder.join(name)).ok();
        let Some((width, height)) = rows.iter().find_map(size) else {
            let path = folder.join(name);
            let why = size_px(&path).err().map(|error| error.to_string()).unwrap_or_default();
            let ending = path.extension().unwrap_or_default().display().to_string();
            let cure =
                if ending.eq_ignore_ascii_case("png") { String::new() } else { format!(": {}", to_png(&ending)) };
            let why = why.trim_end_matches('.');
            let reason = format!("{why}. No other picture of this folder, or of the span asked for, can be read{cure}");
            return Err(SourceError::Picture { path, reason });
        };
        Ok(Self {
            folder,
            rows,
            next: 0,
            given: 0,
            clock,
            gaps,
            size_px: [width, height],
            depth_named: false,
            keep_damaged: false,
            layout: None,
            missing: 0,
            faults: StreamFaults::default(),
        })
    }

    /// Whether unreadable pictures are passed on marked ([`Picture::is_damaged`]) instead of left out.
    #[must_use]
    pub fn keeping_damaged(mut self, keep: bool) -> Self {
        self.keep_damaged = keep;
        self
    }

    /// How the next readable picture is stored.
    fn next_layout(&mut self) -> Option<(PixelFormat, Colour)> {
        let paths: Vec<PathBuf> = self.rows.iter().skip(self.next).map(|(name, _)| self.folder.join(name)).collect();
        let picture = paths.iter().find_map(|path| self.read(path).ok())?;
        Some((picture.format(), picture.colour()))
    }

    fn read(&mut self, path: &Path) -> Result<Picture, SourceError> {
        let unreadable = |reason: String| SourceError::Picture { path: path.to_path_buf(), reason };
        let unread = |error| SourceError::Io { path: path.to_path_buf(), error };
        let bytes = std::fs::read(path).map_err(unread)?;
        if jpeg::is_cut_off(&bytes) {
            return Err(unreadable("the file ends before the picture does".to_owned()));
        }
        let jpeg::Examined { damage, steps } = jpeg::examine(&bytes);
        if let Some(what) = damage {
            return Err(unreadable(what.to_owned()));
        }
        if tiff_pages(&bytes) > 1 {
            return Err(SourceError::Pages { path: path.to_path_buf() });
        }
        let decoded = image::ImageReader::new(Cursor::new(bytes))
            .with_guessed_format()
            .map_err(unread)?
            .decode()
            .map_err(|error| unreadable(error.to_string()))?;
        if decoded.color().bytes_per_pixel() > decoded.color().channel_count() && !self.depth_named {
            self.depth_named = true;
            tracing::warn!(
                "{}: samples of 16 bits are reduced to 8 (65535 becomes 255), here and in the pictures after it{}",
                path.display(),
                depth_advice(&decoded).unwrap_or_default()
            );
        }
        match picture(decoded) {
            Some(Ok(picture)) => Ok(picture.of_jpeg(steps.as_ref()).marked_as_given()),
            Some(Err(error)) => Err(unreadable(error.to_string())),
            None => Err(unreadable("its samples are not whole numbers of 8 or 16 bits".to_owned())),
        }
    }
}

impl FrameSource for ImageFolder {
    fn next_frame(&mut self) -> Result<Option<Frame>, SourceError> {
        while let Some((name, ns)) = self.rows.get(self.next).cloned() {
            self.next += 1;
            self.missing = self.missing.saturating_add(self.gaps.step(ns).gap);
            let path = self.folder.join(&name);
            let picture = match self.read(&path) {
                Ok(picture) => picture,
                Err(error @ (SourceError::Picture { .. } | SourceError::Io { .. })) => {
                    self.faults.pictures_left_out += 1;
                    tracing::warn!("{error}");
                    if self.layout.is_none() && self.keep_damaged {
                        self.layout = self.next_layout();
                    }
                    let dark = self.layout.filter(|_| self.keep_damaged);
                    match dark.and_then(|(format, colour)| Picture::missing(self.size_px, format, colour).ok()) {
                        Some(picture) => picture,
                        None => {
                            self.missing = self.missing.saturating_add(1);
                            continue;
                        }
                    }
                }
                Err(error) => return Err(error),
            };
            if picture.size_px() != self.size_px {
                let (before, after, seq) = (self.size_px, picture.size_px(), self.given);
                return Err(SourceError::SizeChange { path: self.folder.clone(), at: name, seq, before, after });
            }
            self.layout = Some((picture.format(), picture.colour()));
            let (seq, gap) = (self.given, std::mem::take(&mut self.missing));
            self.given += 1;
            return Ok(Some(Frame { seq, stamp: Timestamp { ns, clock: self.clock }, gap, host: None, picture }));
        }
        if self.given == 0 {
            return Err(SourceError::NoFrames { path: self.folder.clone() });
        }
        Ok(None)
    }

    fn size_px(&self) -> [u32; 2] {
        self.size_px
    }

    fn frame_count_hint(&self) -> Option<u64> {
        Some(self.rows.len() as u64)
    }

    fn faults(&self) -> StreamFaults {
        self.faults
    }
}

/// Width and height that a picture's head states, pixels.
fn size_px(path: &Path) -> image::ImageResult<(u32, u32)> {
    image::ImageReader::open(path)?.with_guessed_format()?.into_dimensions()
}

/// How many pictures a TIFF file has; 0 for other files and for those that do not say. Counts no further than two.
fn tiff_pages(bytes: &[u8]) -> usize {
    let little = match bytes.first_chunk() {
        Some(b"II*\0") => true,
        Some(b"MM\0*") => false,
        _ => return 0,
    };
    let part = |at: usize, size: usize| bytes.get(at..at.checked_add(size)?);
    let number = |at: usize, size: usize| {
        let bytes = part(at, size)?.iter();
        let add = |sum: usize, byte: &u8| (sum << 8) | usize::from(*byte);
        Some(if little { bytes.rev().fold(0, add) } else { bytes.fold(0, add) })
    };
    let next = |at: usize| number(at.checked_add(2 + 12 * number(at, 2)?)?, 4).filter(|next| *next != 0);
    let Some(first) = number(4, 4).filter(|at| *at != 0) else { return 0 };
    if next(first).is_some_and(|second| second != first && number(second, 2).is_some()) { 2 } else { 1 }
}

/// `None` for samples that are not integers.
fn picture(decoded: DynamicImage) -> Option<Result<Picture, PictureError>> {
    let (width, height) = (decoded.width(), decoded.height());
    let rgb = |step| PixelFormat::RgbPacked { step, order: [0, 1, 2] };
    let grey_of_pairs = |samples: Vec<u8>| samples.chunks_exact(2).filter_map(|p| p.first().copied()).collect();
    let (format, samples) = match decoded {
        DynamicImage::ImageLuma8(p) => (PixelFormat::Grey, p.into_raw()),
        DynamicImage::ImageLumaA8(p) => (PixelFormat::Grey, grey_of_pairs(p.into_raw())),
        DynamicImage::ImageRgb8(p) => (rgb(3), p.into_raw()),
        DynamicImage::ImageRgba8(p) => (rgb(4), p.into_raw()),
        DynamicImage::ImageLuma16(p) => (PixelFormat::Grey, eight_bits(&p.into_raw())),
        DynamicImage::ImageLumaA16(p) => (PixelFormat::Grey, grey_of_pairs(eight_bits(&p.into_raw()))),
        DynamicImage::ImageRgb16(p) => (rgb(3), eight_bits(&p.into_raw())),
        DynamicImage::ImageRgba16(p) => (rgb(4), eight_bits(&p.into_raw())),
        _ => return None,
    };
    Some(Picture::from_planes(width, height, format, Colour::SRGB, vec![samples]))
}

/// What to do with samples of a camera of fewer bits that were stored as they are: they would be nearly black.
fn depth_advice(decoded: &DynamicImage) -> Option<String> {
    let most = decoded.as_flat_samples_u16()?.samples.iter().copied().max().filter(|most| *most > 0)?;
    let bits = [8, 10, 12, 14].into_iter().find(|bits| most >> bits == 0)?;
    let factor = 1 << (16 - bits);
    Some(format!(
        ". They reach only {most}: if they are those of a camera of {bits} bits, multiply them by {factor} when \
         storing them, or the pictures are too dark"
    ))
}

/// To the nearest of v / 257.
fn eight_bits(samples: &[u16]) -> Vec<u8> {
    samples.iter().map(|&v| ((u32::from(v) + 128) / 257) as u8).collect()
}

/// Names of the pictures, in natural order.
fn picture_names(folder: &Path) -> Result<Vec<String>, SourceError> {
    let io = |error: std::io::Error| match error.kind() {
        std::io::ErrorKind::NotFound => SourceError::NotFound { path: folder.to_path_buf() },
        std::io::ErrorKind::NotADirectory => SourceError::IsFile { path: folder.to_path_buf() },
        _ => SourceError::Io { path: folder.to_path_buf(), error },
    };
    let mut names = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(io)? {
        let path = entry.map_err(io)?.path();
        let Some(name) = path.file_name().and_then(|n| n.to_str()) else { continue };
        if is_picture_name(&path) && path.is_file() {
            names.push(name.to_owned());
        }
    }
    if names.is_empty() {
        return Err(SourceError::NoPictures { path: folder.to_path_buf(), cure: conversion_advice(folder) });
    }
    if let Some(cure) = conversion_advice(folder) {
        tracing::warn!("{}: {cure}", folder.display());
    }
    names.sort_by(|a, b| natural_order(a, b));
    Ok(names)
}

/// Natural order: runs of digits compare as numbers.
fn natural_order(a: &str, b: &str) -> Ordering {
    let (mut x, mut y) = (a, b);
    loop {
        let (Some(cx), Some(cy)) = (x.chars().next(), y.chars().next()) else {
            return x.len().cmp(&y.len()).then_with(|| a.cmp(b));
        };
        if cx.is_ascii_digit() && cy.is_ascii_digit() {
            let (nx, rest_x) = leading_number(x);
            let (ny, rest_y) = leading_number(y);
            match nx.len().cmp(&ny.len()).then_with(|| nx.cmp(ny)) {
                Ordering::Equal => (x, y) = (rest_x, rest_y),
                unequal => return unequal,
            }
        } else if cx == cy {
            (x, y) = (x.strip_prefix(cx).unwrap_or(""), y.strip_prefix(cy).unwrap_or(""));
        } else {
            return cx.cmp(&cy);
        }
    }
}

/// The leading digits of `text`, without leading zeros, and the rest.
fn leading_number(text: &str) -> (&str, &str) {
    let end = text.find(|c: char| !c.is_ascii_digit()).unwrap_or(text.len());
    let (digits, rest) = text.split_at(end);
    (digits.trim_start_matches('0'), rest)
}

/// Where each picture is in its sequence, from 0, lost ones included, by the number that its name ends with. Where such
/// numbers tell nothing, one picture follows the other.
///
/// # Errors
/// When some names end with a number and others do not: these are hardly pictures of the sequence.
fn positions(folder: &Path, names: &[String]) -> Result<Vec<u64>, SourceError> {
    let digits = |name: &String| {
        let stem = Path::new(name).file_stem()?.to_str()?;
        let start = stem.trim_end_matches(|c: char| c.is_ascii_digit()).len();
        stem.get(start..).filter(|digits| !digits.is_empty()).map(str::to_owned)
    };
    let (numbered, odd): (Vec<&String>, Vec<&String>) = names.iter().partition(|name| digits(name).is_some());
    if let (Some(numbered), Some(odd)) = (numbered.first(), odd.first()) {
        let path = folder.join(odd);
        return Err(SourceError::NoNumber { path, numbered: numbered.to_string() });
    }
    let number = |name: &String| digits(name)?.parse::<u64>().ok();
    let count = names.len() as u64;
    let in_a_row = || Ok((0..count).collect());
    let Some(numbers) = names.iter().map(number).collect::<Option<Vec<_>>>() else { return in_a_row() };
    let neighbours = || names.iter().zip(&numbers).zip(names.iter().zip(&numbers).skip(1));
    if let Some(((before, _), (after, _))) = neighbours().find(|((_, before), (_, after))| after <= before) {
        tracing::warn!(
            "{}: {before} is followed by {after}, whose number is not higher: are there pictures of two cameras or \
             recordings in this folder? At the stated frame rate one picture is taken to follow the other; keep one \
             sequence in a folder, or give the times in times.csv",
            folder.display()
        );
        return in_a_row();
    }
    let steps = || numbers.iter().zip(numbers.iter().skip(1)).map(|(a, b)| b.saturating_sub(*a));
    let usual = lower_median(steps().collect()).unwrap_or(1);
    let jump = names.iter().zip(names.iter().skip(1)).zip(steps()).find(|(_, step)| *step != usual);
    let Some(((before, after), _)) = jump else { return in_a_row() };
    let place = folder.display();
    let [first, .., last] = numbers[..] else { return in_a_row() };
    let lost = last.saturating_sub(first).checked_div(usual).map(|last| (last + 1).saturating_sub(count));
    match lost.filter(|lost| *lost < count && steps().all(|step| step.is_multiple_of(usual))) {
        Some(lost) => {
            tracing::warn!("{place}: {before} is followed by {after}; missing numbers count as lost pictures: {lost}");
            Ok(numbers.iter().map(|number| (number - first) / usual).collect())
        }
        None => {
            tracing::warn!(
                "{place}: {before} is followed by {after}, and the numbers are not evenly spaced: at the stated frame \
                 rate one picture is taken to follow the other; if any is missing, all later times are wrong"
            );
            in_a_row()
        }
    }
}

/// Of an even count, the lower of the two in the middle.
fn lower_median(mut of: Vec<u64>) -> Option<u64> {
    of.sort_unstable();
    of.get(of.len().saturating_sub(1) / 2).copied()
}

/// The table's rows, checked against the pictures in the folder.
fn read_table(table: &Path, names: &[String]) -> Result<Vec<(String, i64)>, SourceError> {
    let wrong = |line: u64, reason: String| SourceError::Times { path: table.to_path_buf(), line, reason };
    let csv_error = |error: csv::Error| wrong(1, format!("is not a row of a table: {error}"));
    let text = std::fs::read(table).map_err(|e| csv_error(e.into()))?;
    let mut lines = Lines::of(&text, None);
    let mut reader = csv::ReaderBuilder::new().trim(csv::Trim::All).from_reader(text.as_slice());
    let header = reader.headers().map_err(csv_error)?.clone();
    let column = |name: &str| header.iter().position(|h| h == name);
    let time_column = column("stamp_ns").map(|c| (c, true)).or_else(|| column("t_s").map(|c| (c, false)));
    let (Some(file_column), Some((time_column, in_ns))) = (column("file"), time_column) else {
        let found = header.iter().collect::<Vec<_>>().join(",");
        return Err(wrong(
            1,
            format!("the header is \"{found}\", expected the columns file and t_s, or file and stamp_ns"),
        ));
    };
    let mut missing: BTreeSet<&str> = names.iter().map(String::as_str).collect();
    let mut rows: Vec<(String, i64)> = Vec::with_capacity(names.len());
    for record in reader.records() {
        let record =
            record.map_err(|error| wrong(lines.line(error.position()), format!("is not a row of a table: {error}")))?;
        let line = lines.line(record.position());
        let (file, time) = (record.get(file_column).unwrap_or(""), record.get(time_column).unwrap_or(""));
        if !missing.remove(file) {
            let reason = if names.iter().any(|n| n == file) {
                format!("picture {file} has a row above already")
            } else {
                format!("there is no picture \"{file}\" in this folder")
            };
            return Err(wrong(line, reason));
        }
        let ns = if in_ns { time.parse().ok() } else { parse_seconds_ns(time) }.ok_or_else(|| {
            let what = if in_ns { "whole number of nanoseconds" } else { "number of seconds" };
            wrong(line, format!("\"{time}\" is not a {what} (picture {file})"))
        })?;
        if let Some((before, before_ns)) = rows.last()
            && *before_ns >= ns
        {
            let reason = format!("picture {file} at {ns} ns is not later than {before} at {before_ns} ns");
            return Err(wrong(line, reason));
        }
        rows.push((file.to_owned(), ns));
    }
    if let Some(picture) = names.iter().find(|n| missing.contains(n.as_str())) {
        return Err(SourceError::NotInTimes { path: table.to_path_buf(), picture: picture.clone() });
    }
    let mut steps: Vec<f64> =
        rows.iter().zip(rows.iter().skip(1)).map(|((_, a), (_, b))| seconds(b.saturating_sub(*a))).collect();
    steps.sort_unstable_by(f64::total_cmp);
    if let Some(step_s) = steps.get(steps.len() / 2).filter(|step_s| !(FAST_S..=SLOW_S).contains(*step_s)) {
        let (table, column) = (table.display(), if in_ns { "stamp_ns is in nanoseconds" } else { "t_s is in seconds" });
        tracing::warn!("{table}: the pictures are {step_s} s apart: {column}; are these times?");
    }
    Ok(rows)
}

/// The largest power of ten that divides all times: the resolution they were written with.
fn resolution_ns(rows: &[(String, i64)]) -> f64 {
    let mut tick = 1_000_000_000;
    while tick > 1 && rows.iter().any(|(_, ns)| ns % tick != 0) {
        tick /= 10;
    }
    tick as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_ordered_as_people_count() {
        let mut names = ["img10.png", "img2.png", "img1.png", "img010.png", "a.png", "img2b.png", "img2.1.png", "img"];
        names.sort_by(|a, b| natural_order(a, b));
        assert_eq!(
            names,
            ["a.png", "img", "img1.png", "img2.1.png", "img2.png", "img2b.png", "img010.png", "img10.png"]
        );
        let long = ["f99999999999999999999999.png", "f100000000000000000000000.png"];
        assert_eq!(natural_order(long[0], long[1]), Ordering::Less);
    }

    #[test]
    fn sixteen_bits_are_rounded_to_eight() {
        assert_eq!(
            eight_bits(&[0, 128, 129, 257, 32_767, 32_768, 65_406, 65_407, 65_535]),
            [0, 0, 1, 1, 127, 128, 254, 255, 255]
        );
    }

    #[test]
    fn a_camera_of_fewer_bits_than_its_pictures_is_told_by_the_largest_value() {
        let advice = |most: u16| {
            let picture = image::ImageBuffer::<image::Luma<u16>, _>::from_raw(2, 1, vec![most, most / 2]).unwrap();
            depth_advice(&DynamicImage::ImageLuma16(picture))
        };
        for (most, words) in [
            (1023, "reach only 1023: if they are those of a camera of 10 bits, multiply them by 64"),
            (3900, "12 bits, multiply them by 16 "),
            (16_383, "14 bits, multiply them by 4 "),
        ] {
            let advice = advice(most).unwrap();
            assert!(advice.contains(words), "{advice}");
        }
        assert_eq!([0, 16_384, 65_535].map(advice), [None, None, None]);
        assert_eq!(depth_advice(&DynamicImage::new_luma8(2, 2)), None);
    }

    #[test]
    fn the_resolution_of_times_is_that_of_their_decimals() {
        let rows = |ns: &[i64]| ns.iter().map(|&ns| (String::new(), ns)).collect::<Vec<_>>();
        assert_eq!(resolution_ns(&rows(&[0, 17_000_000, 33_000_000])), 1e6);
        assert_eq!(resolution_ns(&rows(&[0, 16_666_667])), 1.0);
        assert_eq!(resolution_ns(&rows(&[0, 2_000_000_000])), 1e9);
    }
}
