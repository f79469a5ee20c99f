//! Raw pictures on a pipe, one after another without headers: `1280x1024:bayer_rg8@60`.
//!
//! Such a pipe has no clock: frames are stamped on arrival ([`Clock::HostArrival`]), with all delays of the way, and
//! lost frames show only as long steps that no later frames make up for. A camera program that knows the times should
//! write a container instead (`-`).

use super::super::decoded::PictureMaker;
use super::super::host::HostClock;
use super::super::stamps::StampWatch;
use super::super::{
    Clock, Frame, FrameRate, FrameSource, HostTime, LARGEST_SIDE_PX, SourceError, StreamFaults, Timestamp,
};
use super::catching_up::CatchingUp;
use super::samples;
use super::stalls::Stalls;
use ffmpeg_the_third::codec::Id;
use ffmpeg_the_third::format::Pixel;
use ffmpeg_the_third::frame::Video;
use std::io::{ErrorKind, Read};
use std::str::FromStr;

/// Format of the data on the pipe, written `WIDTHxHEIGHT:FORMAT@RATE`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RawFormat {
    /// Width and height, pixels.
    pub size_px: [u32; 2],
    pixel: Pixel,
    /// Frames per second.
    pub rate: FrameRate,
}

impl FromStr for RawFormat {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = |what: String| format!("`{text}`: {what}; write for example 1280x1024:bayer_rg8@60");
        let (size, rest) = text.split_once(':').ok_or_else(|| wrong("the pixel format is missing".to_owned()))?;
        let (format, rate) = rest.split_once('@').ok_or_else(|| wrong("the frame rate is missing".to_owned()))?;
        let side = |text: &str| text.parse::<u32>().ok().filter(|n| (1..=LARGEST_SIDE_PX).contains(n));
        let (width, height) = size.split_once('x').and_then(|(w, h)| Some((side(w)?, side(h)?))).ok_or_else(|| {
            wrong(format!("{size} is not a size in pixels, 1x1 to {LARGEST_SIDE_PX}x{LARGEST_SIDE_PX}"))
        })?;
        let pixel = samples::by_name(format).map_err(wrong)?;
        let rate = rate.parse::<FrameRate>().map_err(|e| wrong(e.to_string()))?;
        Ok(Self { size_px: [width, height], pixel, rate })
    }
}

/// Frames after a stall whose arrival means nothing: as many as may have queued.
const SETTLING: u32 = 16;

/// Frames after which the stated rate is compared with theirs.
const RATED_FRAMES: u64 = 600;
/// They come faster than stated if in less than this part of the time.
const FASTER: f64 = 0.95;

/// Raw pictures from a pipe.
pub struct RawPictures {
    name: String,
    pipe: Box<dyn Read + Send>,
    format: RawFormat,
    pictures: PictureMaker,
    clock: HostClock,
    stamps: StampWatch,
    catching_up: CatchingUp,
    /// Arrival of the first frame.
    first_ns: Option<i64>,
    stalls: Stalls,
    /// Stalls up to the last frame, nanoseconds.
    stalled_ns: u64,
    /// Frames since the last stall.
    since_stall: u32,
    faults: StreamFaults,
    seq: u64,
}

impl RawPictures {
    /// Reads from `pipe`; `name` is for messages.
    pub fn new(name: &str, pipe: Box<dyn Read + Send>, format: RawFormat, clock: HostClock) -> Self {
        let period_ns = format.rate.stamp_ns(1).map(|ns| ns as f64);
        let stamps = StampWatch::new(name.to_owned(), period_ns, 0.0);
        let pictures = PictureMaker::new(name.into(), Id::RAWVIDEO);
        Self {
            name: name.to_owned(),
            pipe,
            format,
            pictures,
            clock,
            stamps,
            catching_up: CatchingUp::new(period_ns.unwrap_or(0.0)),
            first_ns: None,
            stalls: Stalls::watch(),
            stalled_ns: 0,
            since_stall: u32::MAX,
            faults: StreamFaults::default(),
            seq: 0,
        }
    }

    /// Warns, once, if frames come faster than stated. (Slower ones may have been lost.)
    fn compare_rate(&self, arrival_ns: i64) {
        let (Some(first_ns), Some(stated_ns)) = (self.first_ns, self.format.rate.stamp_ns(RATED_FRAMES)) else {
            return;
        };
        let took_ns = arrival_ns.saturating_sub(first_ns) as f64;
        if self.seq == RATED_FRAMES && took_ns < FASTER * stated_ns as f64 {
            tracing::warn!(
                "{}: frames come at {:.1} per second, {} was stated: lost ones cannot be told; state the rate of the \
                 camera",
                self.name,
                RATED_FRAMES as f64 * 1e9 / took_ns.max(1.0),
                self.format.rate
            );
        }
    }

    /// Fills the planes of `frame`, each in one read where its rows have no padding; false at the end of the pipe.
    fn fill(&mut self, frame: &mut Video) -> Result<bool, SourceError> {
        let mut begun = false;
        for plane in 0..frame.planes() {
            let (stride, rows) = (frame.stride(plane), frame.plane_height(plane) as usize);
            let bytes = samples::row_bytes(self.format.pixel, plane, self.format.size_px[0] as usize);
            let (bytes, reads) = if stride == bytes { (rows * bytes, 1) } else { (bytes, rows) };
            for row in 0..reads {
                let Some(row) = frame.data_mut(plane).get_mut(row * stride..row * stride + bytes) else { continue };
                let wrong = |reason: String| SourceError::Raw { name: self.name.clone(), reason };
                match read_all(&mut self.pipe, row).map_err(|error| wrong(error.to_string()))? {
                    got if got == row.len() => begun = true,
                    0 if !begun => return Ok(false),
                    _ => {
                        let [width, height] = self.format.size_px;
                        return Err(wrong(format!(
                            "ends within picture {}: is it really {width}x{height} pixels of the format stated?",
                            self.seq
                        )));
                    }
                }
            }
        }
        Ok(true)
    }
}

/// Reads until `bytes` is full or the pipe ends; returns how many were read.
fn read_all(pipe: &mut impl Read, bytes: &mut [u8]) -> std::io::Result<usize> {
    let mut got = 0;
    while let Some(rest) = bytes.get_mut(got..).filter(|rest| !rest.is_empty()) {
        match pipe.read(rest) {
            Ok(0) => break,
            Ok(more) => got += more,
            Err(error) if error.kind() == ErrorKind::Interrupted => {}
            Err(error) => return Err(error),
        }
    }
    Ok(got)
}

impl FrameSource for RawPictures {
    fn next_frame(&mut self) -> Result<Option<Frame>, SourceError> {
        let [width, height] = self.format.size_px;
        let mut frame = Video::new(self.format.pixel, width, height);
        if !self.fill(&mut frame)? {
            return Ok(None);
        }
        let ns = self.clock.now_ns();
        self.first_ns.get_or_insert(ns);
        self.compare_rate(ns);
        let missing = self.stamps.gap(ns, self.seq, &mut self.faults);
        // While this program was stalled, frames queued on the pipe.
        let stalled_ns = self.stalls.total_ns();
        self.since_stall = if stalled_ns > self.stalled_ns { 0 } else { self.since_stall.saturating_add(1) };
        self.stalled_ns = stalled_ns;
        let gap = self.catching_up.lost(ns, if self.since_stall < SETTLING { 0 } else { missing });
        let picture = self.pictures.picture(frame)?;
        let stamp = Timestamp { ns, clock: Clock::HostArrival };
        let host = Some(HostTime { arrival_ns: ns, stamp_ns: ns });
        let seq = self.seq;
        self.seq += 1;
        Ok(Some(Frame { seq, stamp, gap, host, picture }))
    }

    fn size_px(&self) -> [u32; 2] {
        self.format.size_px
    }

    fn faults(&self) -> StreamFaults {
        self.faults
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(bytes: Vec<u8>, format: &str) -> Vec<Result<Option<Frame>, SourceError>> {
        let format = format.parse().unwrap();
        let mut source = RawPictures::new("stdin", Box::new(std::io::Cursor::new(bytes)), format, HostClock::start());
        let mut all = Vec::new();
        while all.last().is_none_or(|last| matches!(last, Ok(Some(_)))) {
            all.push(source.next_frame());
        }
        all
    }

    #[test]
    fn pictures_follow_each_other_without_padding() {
        // 6 x 4 pixels of 4:2:0: rows of 6 and 3 bytes, which libav pads.
        let picture: Vec<u8> = (0..36).collect();
        let frames = read([picture.clone(), picture].concat(), "6x4:yuv420p@60");
        assert_eq!(frames.len(), 3);
        let Ok(Some(second)) = &frames[1] else { panic!("{:?}", frames[1]) };
        assert_eq!((second.seq, second.stamp.clock), (1, Clock::HostArrival));
        assert_eq!(second.picture.plane(0).unwrap().row(1).unwrap(), [6, 7, 8, 9, 10, 11]);
        assert_eq!(second.picture.plane(1).unwrap().row(1).unwrap(), [27, 28, 29]);
        assert_eq!(second.picture.plane(2).unwrap().row(1).unwrap(), [33, 34, 35]);
        assert!(matches!(frames[2], Ok(None)));
    }

    #[test]
    fn a_bayer_mosaic_becomes_colours() {
        // Red light alone: red samples bright, the others dark.
        let mosaic = (0..16 * 16).map(|i| if i % 2 == 0 && (i / 16) % 2 == 0 { 200 } else { 10 }).collect();
        let frames = read(mosaic, "16x16:bayer_rg8@60");
        let Ok(Some(frame)) = &frames[0] else { panic!("{:?}", frames[0]) };
        let at = |channel: usize| {
            let plane = frame.picture.plane(channel).unwrap();
            plane.row(8).unwrap()[8 * plane.step]
        };
        assert_eq!((at(0), at(1), at(2)), (200, 10, 10));
    }

    #[test]
    fn a_picture_that_is_cut_is_named() {
        let frames = read(vec![0; 100], "6x4:rgb24@60");
        let error = frames[1].as_ref().unwrap_err().to_string();
        assert!(error.contains("picture 1") && error.contains("6x4"), "{error}");
    }

    #[test]
    fn a_picture_whose_rows_have_no_padding_is_cut_too() {
        // Rows of 64 bytes are stored as libav does: a plane is read at once.
        let frames = read(vec![7; 64 * 16 * 3 / 2 + 64 * 5], "64x16:nv12@60");
        let Ok(Some(first)) = &frames[0] else { panic!("{:?}", frames[0]) };
        assert_eq!(first.picture.plane(0).unwrap().row(15).unwrap(), [7; 64]);
        let error = frames[1].as_ref().unwrap_err().to_string();
        assert!(error.contains("picture 1") && error.contains("64x16"), "{error}");
    }

    #[test]
    fn what_is_wrong_with_a_format_is_said() {
        let error = |text: &str| text.parse::<RawFormat>().unwrap_err();
        assert!(error("1280x1024").contains("pixel format is missing"));
        assert!(error("1280x1024:rgb24").contains("frame rate is missing"));
        assert!(error("1280:rgb24@60").contains("1280 is not a size"));
        assert!(error("0x4:rgb24@60").contains("0x4 is not a size"));
        assert!(error("1280x1024:mono8@60").contains("bayer_rg8"));
        assert!(error("1280x1024:rgb24@-3").contains("1280x1024:rgb24@-3"));
    }
}
