//! Where frames come from: recorded video, folders of pictures.
//!
//! A [`Frame`] is a [`Picture`] with the camera's time and the count of camera frames lost before it. Pictures are handed
//! on as they were decoded: planar YUV stays planar YUV, no colour is converted ([`Picture::plane`] tells how samples
//! map to places in the picture, [`Picture::colour`] how they map to colours).

mod picture;

pub use picture::{ChromaSiting, Colour, Matrix, Picture, PictureError, PixelFormat, Plane, Range, RgbFromStored, Transfer};

/// Which clock a time stamp was read from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Clock {
    /// Presentation time in the container of a recording, or the table beside a folder of pictures.
    Container,
    /// No clock at all: the user stated a frame rate (`--fps`) for a folder of pictures.
    StatedRate,
}

impl Clock {
    /// The name used in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Container => "container",
            Self::StatedRate => "stated_rate",
        }
    }
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
        self.ns as f64 * 1e-9
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
    /// What the camera saw.
    pub picture: Picture,
}

/// A stream of frames in the order of their time stamps.
pub trait FrameSource {
    /// The next frame; `None` at the end of the stream.
    ///
    /// # Errors
    /// [`SourceError`] when the stream breaks; frames already handed out stay valid.
    fn next_frame(&mut self) -> Result<Option<Frame>, SourceError>;

    /// Width and height of every frame, pixels.
    fn size_px(&self) -> [u32; 2];

    /// How many frames there will be, if the source knows (for a progress bar).
    fn frame_count_hint(&self) -> Option<u64>;
}

/// Why frames cannot be had.
#[derive(Debug, thiserror::Error)]
pub enum SourceError {}
