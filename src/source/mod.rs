//! Where frames come from: recorded video, folders of pictures, logs that hold parts of their pictures, and live
//! cameras and streams ([`live`]).
//!
//! A [`Frame`] is a [`Picture`] with the camera's time and the count of camera frames lost before it. Pictures are
//! passed on as decoded: planar YUV stays planar YUV, colours are not converted ([`Picture::plane`] tells how samples
//! map to places in the picture, [`Picture::colour`] how they map to colours).

mod check;
mod container;
pub(crate) mod counter;
pub(crate) mod current_columns;
mod damage;
mod decoded;
mod decoding;
mod error;
mod extent;
mod ffv1;
pub(crate) mod file;
mod frame_numbers;
pub(crate) mod gaps;
mod headers;
pub mod host;
pub(crate) mod images;
pub(crate) mod jpeg;
mod last_coded;
pub mod live;
mod log_windows;
mod messages;
pub(crate) mod names;
mod open;
pub(crate) mod pace;
mod packets;
mod picture;
mod quantisation;
mod reads;
mod stamps;
pub mod times;
mod turns;
mod window;

use std::path::Path;

pub(crate) use container::{quiet_libav, url_of};
pub use error::SourceError;
pub(crate) use file::ORIGIN_TAG;
pub use file::{VideoFile, VideoOptions};
pub use host::HostTime;
pub use images::{ImageFolder, ImageTiming};
pub use log_windows::LogWindows;
pub(crate) use names::{PICTURE_ENDINGS, conversion_advice, is_picture_name};
pub use open::{SourceOptions, open, open_to_track};
pub(crate) use picture::LARGEST_SIDE_PX;
pub use picture::{
    ChromaSiting, Colour, Matrix, Picture, PictureError, PixelFormat, Plane, Range, RgbFromStored, Transfer,
};
pub use quantisation::Quantisation;
pub use reads::NotRecorded;
pub use times::{FrameRate, FrameRateError};
pub use window::Window;

/// Reads the lengths that a container declares.
pub(crate) fn extent_of(bytes: &[u8]) {
    let _ = extent::extent(std::io::Cursor::new(bytes));
}

/// Checks a coded picture, as done for those of a stream.
pub(crate) fn checked_packet(bytes: &[u8]) {
    let _ = (jpeg::examine(bytes).damage, jpeg::is_cut_off(bytes), ffv1::is_sound(bytes), ffv1::has_checksums(bytes));
}

/// Which clock a time stamp was read from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Clock {
    /// Presentation time in the container of a recording, or the table beside a folder of pictures.
    Container,
    /// No clock at all: the user stated a frame rate (`--fps`) for a folder of pictures.
    StatedRate,
    /// Presentation time in a live stream, from the stream's own zero.
    Stream,
    /// The kernel's monotonic clock as the driver of a V4L2 camera stamped the buffer: start of the exposure or end of
    /// the transfer, as the driver declares.
    V4l2Monotonic,
    /// The camera's own clock.
    Device,
    /// The host's clock at arrival: the last resort, with all delays of the way.
    HostArrival,
}

/// When a frame was exposed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Timestamp {
    /// Nanoseconds since the clock's own zero; exact to the clock's time base.
    pub ns: i64,
    /// Which clock.
    pub clock: Clock,
}

impl Timestamp {
    /// Seconds since the clock's zero.
    pub fn seconds(self) -> f64 {
        times::seconds(self.ns)
    }

    /// Seconds since an earlier time of the same clock; negative before it.
    pub(crate) fn seconds_since(self, earlier: Self) -> f64 {
        times::seconds(self.ns.saturating_sub(earlier.ns))
    }
}

/// One camera frame.
#[derive(Debug)]
pub struct Frame {
    /// Number of this frame among those received, from 0.
    pub seq: u64,
    /// Its camera time.
    pub stamp: Timestamp,
    /// Camera frames lost between the frame before and this one.
    pub gap: u32,
    /// When it was taken by the clock of this computer; `None` for recordings.
    pub host: Option<HostTime>,
    /// What the camera saw.
    pub picture: Picture,
}

/// A stream of frames in the order they were taken. Stamps increase, except where the recording itself has them wrong;
/// the source then warns and passes them on.
pub trait FrameSource {
    /// The next frame; `None` at the end of the stream.
    ///
    /// # Errors
    /// [`SourceError`] when the stream breaks; frames already handed out stay valid.
    fn next_frame(&mut self) -> Result<Option<Frame>, SourceError>;

    /// The same, for whom a recording that ends early is valid as far as it goes: that is its end, with a warning, if
    /// `some_read`.
    ///
    /// # Errors
    /// As [`FrameSource::next_frame`], but for that.
    fn next_of_readable(&mut self, some_read: bool) -> Result<Option<Frame>, SourceError> {
        match self.next_frame() {
            Err(error) if error.is_early_end() && some_read => {
                tracing::warn!("{error}");
                Ok(None)
            }
            next => next,
        }
    }

    /// Width and height of every frame, pixels.
    fn size_px(&self) -> [u32; 2];

    /// How many frames there will be, if the source knows (for a progress bar).
    fn frame_count_hint(&self) -> Option<u64> {
        None
    }

    /// What has been wrong with the stream so far.
    fn faults(&self) -> StreamFaults {
        StreamFaults::default()
    }

    /// Coil currents that the source has and has not handed out yet, up to the last frame or a little beyond; at the
    /// end, all that are left.
    fn currents(&mut self) -> Vec<CurrentSample> {
        Vec::new()
    }
}

/// Currents of the coils at one moment.
#[derive(Debug, Clone, PartialEq)]
pub struct CurrentSample {
    /// When they flowed, as precisely as known, by the host's clock: nanoseconds since 1970.
    pub host_ns: i64,
    /// When they arrived here, by the same clock.
    pub arrival_ns: i64,
    /// The sender's own count, if it has one.
    pub seq: Option<u64>,
    /// One entry per coil, amperes.
    pub current_a: Vec<f64>,
}

/// Counts of what is wrong with a stream but does not end it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct StreamFaults {
    /// Packets that could not be read or decoded.
    pub damaged_packets: u64,
    /// Pictures that are damaged or predicted from damaged ones: left out, or passed on as such.
    pub pictures_left_out: u64,
    /// Frames with the same stamp as the one before.
    pub repeated_stamps: u64,
    /// Frames with a stamp earlier than a previous one.
    pub backward_stamps: u64,
    /// Frames without a presentation time, where the decoder's best estimate is taken.
    pub guessed_stamps: u64,
    /// Frames without any time, which are left out: those before the first time stamp of a live stream, or whose packet
    /// with the stamp was lost.
    pub unstamped: u64,
    /// Interruptions of a live stream.
    pub interruptions: u64,
}

impl StreamFaults {
    /// Adds the counts of another part of the stream.
    fn add(&mut self, other: Self) {
        self.damaged_packets += other.damaged_packets;
        self.pictures_left_out += other.pictures_left_out;
        self.repeated_stamps += other.repeated_stamps;
        self.backward_stamps += other.backward_stamps;
        self.guessed_stamps += other.guessed_stamps;
        self.unstamped += other.unstamped;
        self.interruptions += other.interruptions;
    }

    /// Warns of faults that occurred more than once: the first of each was reported at once.
    fn report(&self, path: &Path) {
        let counts = [
            (self.damaged_packets, "damaged packets"),
            (self.pictures_left_out, "damaged pictures"),
            (self.repeated_stamps, "repeated time stamps"),
            (self.backward_stamps, "time stamps that go back"),
            (self.guessed_stamps, "estimated time stamps"),
            (self.unstamped, "frames without a time stamp"),
        ];
        let found: Vec<String> = counts.iter().filter(|(n, _)| *n > 1).map(|(n, what)| format!("{n} {what}")).collect();
        if !found.is_empty() {
            tracing::warn!("{}: {} in all", path.display(), found.join(", "));
        }
    }
}

/// Part of a recording: frames with `from_ns ≤ stamp ≤ to_ns`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Span {
    /// First time, nanoseconds of the frames' clock; the start if `None`.
    pub from_ns: Option<i64>,
    /// Last time, nanoseconds of the frames' clock; the end if `None`.
    pub to_ns: Option<i64>,
}

impl Span {
    /// Whether `ns` lies in it.
    pub fn contains(self, ns: i64) -> bool {
        self.from_ns.is_none_or(|from| ns >= from) && self.to_ns.is_none_or(|to| ns <= to)
    }

    /// # Errors
    /// When it ends before it starts.
    fn check(self) -> Result<(), SourceError> {
        match (self.from_ns, self.to_ns) {
            (Some(from), Some(to)) if to < from => {
                Err(SourceError::Span { from_s: times::seconds(from), to_s: times::seconds(to) })
            }
            _ => Ok(()),
        }
    }
}
