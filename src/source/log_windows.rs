//! The pictures in a log that was recorded with `--record windows`, to be tracked again.
//!
//! In: a log of this program. Out: a frame for every row of the log, in order, with the log's stamp, gap and host time,
//! and the log's coil currents.
//! The recorded parts of each picture are exact to the last bit; the rest is black, and [`Picture::declare_read`]
//! refuses it. A frame whose picture was not recorded (it was not tracked, or the recorder fell behind) has no
//! recorded part.
//!
//! The windows of a picture follow its row in the log, some frames later. Rows wait for them until those of a later
//! frame arrive.

use super::times::seconds;
use super::{
    ChromaSiting, Clock, Colour, CurrentSample, Frame, FrameSource, HostTime, LARGEST_SIDE_PX, Matrix, Picture,
    PixelFormat, Quantisation, Range, SourceError, Span, StreamFaults, Timestamp, Transfer, Window,
};
use crate::log::decoder::MessageDecoder;
use crate::log::fields::{floats, list, number, text, word};
use crate::log::records::Records;
use crate::log::schema::{Topic, WINDOW_FORMAT};
use crate::log::{restarted, typed};
use crate::plural::are;
use image::codecs::png::PngDecoder;
use image::{ColorType, ImageDecoder as _, Limits};
use mcap::records::Record;
use prost_reflect::{DynamicMessage, Value};
use std::collections::VecDeque;
use std::io::Cursor;
use std::path::{Path, PathBuf};

/// Pictures with more pixels are damage.
const MAX_PX: u64 = 1 << 27;

/// The status of a frame whose picture was damaged.
const DAMAGED: &str = "damaged";
/// That of an interlaced picture.
const INTERLACED: &str = "interlaced";

/// The pictures in a log.
pub struct LogWindows {
    path: PathBuf,
    records: Records,
    decoder: MessageDecoder,
    /// Rows whose picture has not been read yet, oldest first.
    rows: VecDeque<Row>,
    /// Read and not handed out yet.
    currents: Vec<CurrentSample>,
    /// Layout of all pictures.
    layout: Layout,
    /// Number of the last row read, in the log's own count.
    last: Option<u64>,
    /// Rows that are missing between those read.
    lacking: u64,
    /// Whether a row had no higher number than the one before.
    restarts: bool,
    /// Number of the last frame whose windows were read.
    windows_to: Option<u64>,
    /// Number of the last row read.
    read_to: Option<u64>,
    span: Span,
    given: u64,
    faults: StreamFaults,
    last_good_ns: Option<i64>,
    /// Stamps of the rows nearest to the span, outside of it: the last before, the first after.
    outside_ns: [Option<i64>; 2],
}

struct Row {
    seq: u64,
    stamp: Timestamp,
    gap: u32,
    host: Option<HostTime>,
    windows: Option<DynamicMessage>,
    /// Whether its picture was damaged: none was recorded, and tracked again it is not one that is missing in the log.
    damaged: bool,
    /// Whether its rows were of two moments: where the picture was recorded it is so again.
    interlaced: bool,
}

/// Size and storage of a picture.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Layout {
    size_px: [u32; 2],
    format: PixelFormat,
    colour: Colour,
}

impl LogWindows {
    /// Opens the log at `path`.
    ///
    /// # Errors
    /// When it cannot be read, is not a log, holds no pictures, or the span ends before it starts.
    pub fn open(path: &Path, span: Span) -> Result<Self, SourceError> {
        span.check()?;
        let layout = Layout { size_px: [0; 2], format: PixelFormat::Grey, colour: Colour::SRGB };
        let mut source = Self {
            path: path.to_owned(),
            records: Records::open(path)?,
            decoder: MessageDecoder::default(),
            rows: VecDeque::new(),
            currents: Vec::new(),
            layout,
            last: None,
            lacking: 0,
            restarts: false,
            windows_to: None,
            read_to: None,
            span,
            given: 0,
            faults: StreamFaults::default(),
            last_good_ns: None,
            outside_ns: [None; 2],
        };
        // The first one that can be parsed sets the layout.
        while source.layout.size_px == [0; 2] {
            if !source.read()? {
                let damage = source.records.condition().summary();
                return Err(SourceError::LogWithoutPictures { path: path.to_owned(), damage });
            }
            let newest = source.rows.iter().rev().find_map(|row| row.windows.as_ref());
            if let Some(layout) = newest.and_then(|message| layout_of(message).ok()) {
                source.layout = layout;
            }
        }
        Ok(source)
    }

    /// Reads a record; false at the end.
    fn read(&mut self) -> Result<bool, SourceError> {
        let Some(record) = self.records.next()? else { return Ok(false) };
        self.decoder.learn(&record);
        let Record::Message { header, data } = &record else { return Ok(true) };
        if let Some(estimate) = self.decoder.decoded(header.channel_id, Topic::Estimate, data) {
            match row(&estimate) {
                Ok(row) => {
                    // Of another run in the same file, whose numbers begin anew.
                    if self.read_to.replace(row.seq).is_some_and(|before| row.seq <= before) {
                        self.windows_to = None;
                    }
                    self.rows.push_back(row);
                }
                // It has no time, and so no row; the next frame counts it as missing.
                Err(reason) => tracing::warn!("{}: frame {}: {reason}", self.path.display(), header.sequence),
            }
        } else if let Some(windows) = self.decoder.decoded(header.channel_id, Topic::Windows, data) {
            let seq = number(&windows, "seq").and_then(|n| u64::try_from(n).ok()).unwrap_or(0);
            self.windows_to = Some(seq);
            // Without a row it has no time, and is not a frame of this log.
            if let Some(row) = self.rows.iter_mut().rev().find(|row| row.seq == seq) {
                row.windows = Some(windows);
            }
        } else if let Some(current) = self.decoder.decoded(header.channel_id, Topic::Current, data) {
            self.currents.extend(typed::current(&current).map(|current| CurrentSample {
                host_ns: current.host_ns,
                arrival_ns: current.arrival_ns,
                seq: current.seq,
                current_a: current.current_a,
            }));
        }
        Ok(true)
    }

    /// The next row with its recorded windows; `None` at the end.
    fn next_row(&mut self) -> Result<Option<Row>, SourceError> {
        loop {
            let complete = |row: &Row| row.windows.is_some() || self.windows_to.is_some_and(|to| to > row.seq);
            if self.rows.front().is_some_and(complete) || !self.read()? {
                let mut row = self.rows.pop_front();
                if let Some(row) = &mut row {
                    // Rows missing in the log are lost frames.
                    let lacking = self.last.map_or(0, |last| row.seq.saturating_sub(last.saturating_add(1)));
                    if let Some(last) = self.last.filter(|last| row.seq <= *last)
                        && !std::mem::replace(&mut self.restarts, true)
                    {
                        tracing::warn!("{}: {}", self.path.display(), restarted(row.seq, last));
                    }
                    self.lacking = self.lacking.saturating_add(lacking);
                    row.gap = row.gap.saturating_add(u32::try_from(lacking).unwrap_or(u32::MAX));
                    self.last = Some(row.seq);
                }
                return Ok(row);
            }
        }
    }

    fn picture(&self, row: &Row) -> Result<Picture, SourceError> {
        let failed = |reason: String| self.damaged(row.seq, reason);
        if row.damaged {
            let Layout { size_px, format, colour } = self.layout;
            return Picture::missing(size_px, format, colour).map_err(|e| failed(e.to_string()));
        }
        let Some(message) = &row.windows else {
            let black = black(&self.layout);
            return Ok(picture_of(self.layout, black).map_err(failed)?.of_parts(Vec::new()));
        };
        let layout = layout_of(message).map_err(failed)?;
        let mut planes = black(&layout);
        let mut there = Vec::new();
        for window in list(message, "windows") {
            let (plane, area) = paste(&mut planes, &layout, &window).map_err(failed)?;
            if plane == 0 {
                there.push(area);
            }
        }
        Ok(picture_of(layout, planes).map_err(failed)?.of_parts(there).quantised(quantisation_of(message)))
    }

    fn damaged(&self, seq: u64, reason: String) -> SourceError {
        SourceError::LogPicture { path: self.path.clone(), seq, reason }
    }
}

impl FrameSource for LogWindows {
    fn next_frame(&mut self) -> Result<Option<Frame>, SourceError> {
        while let Some(row) = self.next_row()? {
            if !self.span.contains(row.stamp.ns) {
                let [before, after] = &mut self.outside_ns;
                if self.span.from_ns.is_some_and(|from_ns| row.stamp.ns < from_ns) {
                    *before = Some(row.stamp.ns);
                } else {
                    after.get_or_insert(row.stamp.ns);
                }
                continue;
            }
            let picture = match self.picture(&row) {
                Ok(picture) => picture.interlaced(row.interlaced),
                Err(error) => {
                    self.faults.pictures_left_out += 1;
                    if self.faults.pictures_left_out == 1 {
                        tracing::warn!("{error}; it is not measured, more are counted");
                    }
                    Picture::missing(self.layout.size_px, self.layout.format, self.layout.colour)
                        .map_err(|e| self.damaged(row.seq, e.to_string()))?
                }
            };
            let Row { stamp, gap, host, .. } = row;
            let seq = self.given;
            self.given += 1;
            self.last_good_ns = Some(stamp.ns);
            return Ok(Some(Frame { seq, stamp, gap, host, picture }));
        }
        if self.lacking > 0 {
            let (log, rows) = (self.path.display(), are(self.lacking, "row"));
            tracing::warn!("{log}: {rows} missing in the log: the camera need not have lost them");
            self.lacking = 0;
        }
        let condition = self.records.condition();
        if let (None, Some(why)) = (&condition.cut, condition.summary()) {
            tracing::warn!("{}: the log is damaged: {why}; what is left of it is tracked", self.path.display());
        }
        match &condition.cut {
            Some(_) => Err(SourceError::Truncated {
                path: self.path.clone(),
                frames: self.given,
                last_good_s: self.last_good_ns.map(seconds),
                why: condition.summary().unwrap_or_default(),
            }),
            None if self.given == 0 && self.span != Span::default() => {
                let [from_s, to_s, before_s, after_s] =
                    [self.span.from_ns, self.span.to_ns, self.outside_ns[0], self.outside_ns[1]]
                        .map(|ns| ns.map(seconds));
                Err(SourceError::EmptySpan { path: self.path.clone(), from_s, to_s, before_s, after_s })
            }
            None => Ok(None),
        }
    }

    fn size_px(&self) -> [u32; 2] {
        self.layout.size_px
    }

    fn faults(&self) -> StreamFaults {
        self.faults
    }

    fn currents(&mut self) -> Vec<CurrentSample> {
        std::mem::take(&mut self.currents)
    }
}

/// The row of an estimate message.
fn row(estimate: &DynamicMessage) -> Result<Row, String> {
    let whole = |field: &str| number(estimate, field).ok_or_else(|| format!("its row has no `{field}`"));
    let name = text(estimate, "clock").ok_or("its row names no clock")?;
    let clock = Clock::by_name(&name).ok_or_else(|| format!("its clock `{name}` is not known"))?;
    let unsigned = |field: &str| whole(field).and_then(|n| u64::try_from(n).map_err(|e| format!("`{field}`: {e}")));
    let host = estimate.has_field_by_name("arrival_ns") && estimate.has_field_by_name("host_stamp_ns");
    let host = || {
        Ok(HostTime { arrival_ns: whole("arrival_ns")?, stamp_ns: whole("host_stamp_ns")? }).map(|t| host.then_some(t))
    };
    let status = word(estimate, "tangent_status");
    Ok(Row {
        seq: unsigned("seq")?,
        stamp: Timestamp { ns: whole("stamp_ns")?, clock },
        gap: unsigned("gap")?.try_into().unwrap_or(u32::MAX),
        host: host().map_err(|e: String| e)?,
        windows: None,
        damaged: status.as_deref() == Some(DAMAGED),
        interlaced: status.as_deref() == Some(INTERLACED),
    })
}

fn layout_of(message: &DynamicMessage) -> Result<Layout, String> {
    let side = |field: &str| {
        let n = number(message, field).and_then(|n| u32::try_from(n).ok());
        n.filter(|n| (1..=LARGEST_SIDE_PX).contains(n))
            .ok_or_else(|| format!("`{field}` is not 1 to {LARGEST_SIDE_PX}"))
    };
    let size_px = [side("width")?, side("height")?];
    if size_px.iter().map(|n| u64::from(*n)).product::<u64>() > MAX_PX {
        return Err(format!("its size is {}x{} pixels", size_px[0], size_px[1]));
    }
    let log2 = |field: &str| {
        let n = number(message, field).and_then(|n| u8::try_from(n).ok());
        n.filter(|n| *n <= 2).ok_or_else(|| format!("`{field}` is not 0, 1 or 2"))
    };
    let word = |field: &str| text(message, field).ok_or_else(|| format!("`{field}` is missing"));
    fn known<T>(field: &str, name: String, by_name: fn(&str) -> Option<T>) -> Result<T, String> {
        by_name(&name).ok_or_else(|| format!("`{field}` is `{name}`, which is not known"))
    }
    let format = match word("planes")?.as_str() {
        "yuv" => PixelFormat::Yuv { chroma_log2: [log2("chroma_log2_x")?, log2("chroma_log2_y")?] },
        "rgb" => PixelFormat::RgbPlanar,
        "grey" => PixelFormat::Grey,
        other => return Err(format!("`planes` is `{other}`, expected yuv, rgb or grey")),
    };
    Ok(Layout {
        size_px,
        format,
        colour: Colour {
            matrix: known("matrix", word("matrix")?, Matrix::by_name)?,
            range: known("range", word("range")?, Range::by_name)?,
            transfer: known("transfer", word("transfer")?, Transfer::by_name)?,
            siting: known("siting", word("siting")?, ChromaSiting::by_name)?,
        },
    })
}

/// No coder quantises one channel so much more coarsely than another.
const LARGEST_RATIO: f64 = 1000.0;

/// `None` when the message has none.
fn quantisation_of(message: &DynamicMessage) -> Option<Quantisation> {
    if !message.has_field_by_name("quantisation") {
        return None;
    }
    let said = message.get_field_by_name("quantisation")?;
    let said = said.as_message()?;
    let unsigned = |field: &str| number(said, field).and_then(|n| u32::try_from(n).ok()).filter(|n| *n > 0);
    // Older logs have none.
    let channels = <[f64; 3]>::try_from(floats(said, "channels")).ok();
    let channels = channels.filter(|all| all.iter().all(|by| (0.0..=LARGEST_RATIO).contains(by)));
    Some(Quantisation {
        block_px: unsigned("block_px")?,
        columns: unsigned("columns")?,
        predicted: said.get_field_by_name("predicted")?.as_bool()?,
        levels: said.get_field_by_name("levels")?.as_bytes()?.to_vec(),
        channels: channels.unwrap_or([1.0; 3]),
    })
}

/// Width and height of a plane in samples, and pixels per sample.
fn plane_size(layout: &Layout, plane: usize) -> ([usize; 2], [u32; 2]) {
    let log2 = match layout.format {
        PixelFormat::Yuv { chroma_log2 } if plane > 0 => chroma_log2,
        _ => [0, 0],
    };
    let scale = log2.map(|log2| 1 << log2);
    ([0, 1].map(|i| layout.size_px[i].div_ceil(scale[i]) as usize), scale)
}

fn black(layout: &Layout) -> Vec<Vec<u8>> {
    let yuv = layout.format.is_yuv();
    let plane = |i: usize| {
        let ([width, height], _) = plane_size(layout, i);
        let value = match (yuv, i, layout.colour.range) {
            (true, 0, Range::Limited) => 16,
            (true, 1.., _) => 128,
            _ => 0,
        };
        vec![value; width * height]
    };
    (0..layout.format.channels()).map(plane).collect()
}

fn picture_of(layout: Layout, planes: Vec<Vec<u8>>) -> Result<Picture, String> {
    let [width, height] = layout.size_px;
    let picture = Picture::from_planes(width, height, layout.format, layout.colour, planes);
    picture.map(Picture::marked_as_given).map_err(|e| e.to_string())
}

/// Copies a window into its plane; returns the plane and the pixels that it covers.
fn paste(planes: &mut [Vec<u8>], layout: &Layout, window: &DynamicMessage) -> Result<(usize, Window), String> {
    let whole = |field: &str| {
        number(window, field).and_then(|n| u32::try_from(n).ok()).ok_or_else(|| format!("a window has no `{field}`"))
    };
    let (index, x, y) = (whole("plane")? as usize, whole("x")?, whole("y")?);
    let (width, height) = (whole("width")?, whole("height")?);
    let ([plane_width, plane_height], [sx, sy]) = plane_size(layout, index);
    let plane = planes.get_mut(index).ok_or_else(|| format!("a window is of plane {index}"))?;
    let inside = |from: u32, size: u32, all: usize| size > 0 && u64::from(from) + u64::from(size) <= all as u64;
    if !(inside(x, width, plane_width) && inside(y, height, plane_height)) {
        return Err(format!(
            "a window of {width}x{height} samples at {x}, {y} does not lie in plane {index} of \
             {plane_width}x{plane_height}"
        ));
    }
    let format = text(window, "format").unwrap_or_default();
    if format != WINDOW_FORMAT {
        return Err(format!("a window is compressed as `{format}`, expected `{WINDOW_FORMAT}`"));
    }
    let data = window.get_field_by_name("data");
    let data = data.as_deref().and_then(Value::as_bytes).ok_or("a window has no `data`")?;
    let grey = samples(data, (width, height))?;
    let rows = plane.chunks_exact_mut(plane_width).skip(y as usize);
    for (to, from) in rows.zip(grey.chunks_exact(width as usize)) {
        if let Some(to) = to.get_mut(x as usize..(x + width) as usize) {
            to.copy_from_slice(from);
        }
    }
    Ok((index, Window { x0: x * sx, y0: y * sy, x1: (x + width) * sx, y1: (y + height) * sy }))
}

/// The samples of a window, of the size that the log says: a damaged or hostile PNG may be of any, and is not decoded.
fn samples(png: &[u8], (width, height): (u32, u32)) -> Result<Vec<u8>, String> {
    let decoder = PngDecoder::with_limits(Cursor::new(png), Limits::default()).map_err(|e| e.to_string())?;
    if decoder.dimensions() != (width, height) {
        return Err(format!("a window's PNG has {:?} samples, expected {width}x{height}", decoder.dimensions()));
    }
    if decoder.color_type() != ColorType::L8 {
        return Err("a window's PNG is not grey of 8 bits".to_owned());
    }
    let mut samples = vec![0; width as usize * height as usize];
    decoder.read_image(&mut samples).map_err(|e| e.to_string())?;
    Ok(samples)
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::{DynamicImage, ImageFormat};

    fn png(image: impl Into<DynamicImage>) -> Vec<u8> {
        let mut png = Cursor::new(Vec::new());
        image.into().write_to(&mut png, ImageFormat::Png).unwrap();
        png.into_inner()
    }

    #[test]
    fn a_window_of_another_size_is_refused_by_its_header() {
        let mut other = png(image::GrayImage::new(3000, 2000));
        // Nothing is left to decode.
        other.truncate(60);
        assert_eq!(samples(&other, (8, 4)).unwrap_err(), "a window's PNG has (3000, 2000) samples, expected 8x4");
        assert!(samples(&other, (3000, 2000)).is_err());
    }

    #[test]
    fn samples_are_those_of_a_grey_png() {
        let grey = image::GrayImage::from_fn(8, 4, |x, y| image::Luma([(31 * x + 7 * y) as u8]));
        assert_eq!(samples(&png(grey.clone()), (8, 4)).unwrap(), grey.into_raw());
        let colour = png(image::RgbImage::new(8, 4));
        assert_eq!(samples(&colour, (8, 4)).unwrap_err(), "a window's PNG is not grey of 8 bits");
    }
}
