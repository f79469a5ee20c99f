//! Why frames cannot be had.

use crate::plural::plural;
use std::io;
use std::path::PathBuf;

use super::names::PICTURE_ENDINGS;
use super::times::FrameRateError;
use crate::log::LogError;

/// Why frames cannot be had.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SourceError {
    /// No such file or folder.
    #[error("{}: no such file or folder", path.display())]
    NotFound {
        /// The requested path.
        path: PathBuf,
    },
    /// A folder where a video file is wanted.
    #[error("{}: is a folder; expected a video file", path.display())]
    IsFolder {
        /// The requested path.
        path: PathBuf,
    },
    /// A file where a folder of pictures is wanted.
    #[error("{}: is a file; expected a folder of pictures", path.display())]
    IsFile {
        /// The requested path.
        path: PathBuf,
    },
    /// The operating system refuses.
    #[error("{}: cannot be read: {error}", path.display())]
    Io {
        /// The requested path.
        path: PathBuf,
        /// Its reason.
        #[source]
        error: io::Error,
    },
    /// A stream that cannot be had.
    #[error("{url}: cannot read the stream ({reason})")]
    Stream {
        /// Its address.
        url: String,
        /// libav's reason.
        reason: String,
    },
    /// A recorded or piped stream of raw pictures that is not as stated.
    #[error("{name}: {reason}")]
    Raw {
        /// Where it comes from.
        name: String,
        /// What is wrong and what would be right.
        reason: String,
    },
    /// A camera that cannot be had, or is lost.
    #[error("{name}: {reason}")]
    Camera {
        /// Its name, as given by the user.
        name: String,
        /// What is wrong and what would be right.
        reason: String,
    },
    /// No container that libav knows.
    #[error("{}: is not a video that can be read ({reason}); recordings may be Matroska (.mkv), MP4, AVI and others \
        that FFmpeg reads", path.display())]
    NotAVideo {
        /// The file.
        path: PathBuf,
        /// libav's reason.
        reason: String,
    },
    /// An MP4 whose index was never written or is cut off.
    #[error("{}: the recording's index (\"moov\") is missing: it was not finished, or the file is cut off. Copy the \
        file again; if the recorder was interrupted, a repair tool needs a whole recording of the same \
        camera", path.display())]
    NoIndex {
        /// The file.
        path: PathBuf,
    },
    /// A recording without pictures.
    #[error("{}: has no video stream: {found}", path.display())]
    NoVideoStream {
        /// The file.
        path: PathBuf,
        /// The streams that exist.
        found: String,
    },
    /// The stream cannot be decoded here.
    #[error("{}: video of codec {codec} cannot be decoded: {reason}", path.display())]
    Decoder {
        /// The file.
        path: PathBuf,
        /// Name of the codec.
        codec: String,
        /// libav's reason.
        reason: String,
    },
    /// A pixel format that is not read.
    #[error("{}: pixel format {format} is not supported; planar YUV, NV12, packed or planar RGB and grey are: convert \
        it, for example with ffmpeg -pix_fmt yuv444p", path.display())]
    PixelFormat {
        /// The file.
        path: PathBuf,
        /// libav's name of it.
        format: String,
    },
    /// A YUV matrix that is not read.
    #[error("{}: colours in {matrix} are not supported; BT.601, BT.709 and BT.2020 (non-constant luminance) \
        are", path.display())]
    Matrix {
        /// The file.
        path: PathBuf,
        /// Its name.
        matrix: String,
    },
    /// Pictures of two sizes.
    #[error("{}: the picture size changes from {}x{} to {}x{} pixels at frame {seq} ({at}); all must have one size",
        path.display(), before[0], before[1], after[0], after[1])]
    SizeChange {
        /// The recording or folder.
        path: PathBuf,
        /// Where: its time or file.
        at: String,
        /// Number of the frame.
        seq: u64,
        /// Width and height of those before, pixels.
        before: [u32; 2],
        /// Width and height of this one, pixels.
        after: [u32; 2],
    },
    /// A frame without a time.
    #[error("{}: frame {seq} has no time stamp; catoptra never makes one up from the frame number. Raw streams have \
        none: state their rate with --fps, or put the stream into a container that has times", path.display())]
    NoTime {
        /// The file.
        path: PathBuf,
        /// Number of the frame.
        seq: u64,
    },
    /// The recording ends early; all that could be read was handed out before.
    #[error("{}: the recording ends early ({why}); {}", path.display(), last_good(*frames, *last_good_s))]
    Truncated {
        /// The file.
        path: PathBuf,
        /// Frames that were handed out.
        frames: u64,
        /// Time of the last frame handed out, seconds.
        last_good_s: Option<f64>,
        /// How that is known.
        why: String,
    },
    /// A log, where pictures are wanted.
    #[error("{}: is a log, which holds parts of its pictures at most; it can only be tracked", path.display())]
    IsLog {
        /// The file.
        path: PathBuf,
    },
    /// A log that cannot be read.
    #[error(transparent)]
    Log(#[from] LogError),
    /// A log without pictures.
    #[error(
        "{}: {}this log holds no pictures, so it cannot be tracked again: record them with `catoptra live … --record \
        windows`, or track the video beside it, if it was recorded with `--record ffv1` or `h264`", path.display(),
        damage.as_ref().map(|damage| format!("{damage}; what is left of ")).unwrap_or_default()
    )]
    LogWithoutPictures {
        /// The log.
        path: PathBuf,
        /// What is wrong with it: its pictures may have been there.
        damage: Option<String>,
    },
    /// A picture in a log that cannot be understood.
    #[error("{}: the picture of frame {seq} cannot be read: {reason}", path.display())]
    LogPicture {
        /// The log.
        path: PathBuf,
        /// Number of the frame.
        seq: u64,
        /// What is wrong.
        reason: String,
    },
    /// A pipe or a device in place of a recording.
    #[error("{}: is neither a file nor a folder; expected a recorded video, a folder of pictures or a log",
        path.display())]
    NoFile {
        /// What was named.
        path: PathBuf,
    },
    /// The stream has ended without a frame.
    #[error("{}: has no frame that can be decoded", path.display())]
    NoFrames {
        /// The recording or folder.
        path: PathBuf,
    },
    /// A span of time without a frame.
    #[error("{}: no frame between {} and {}; the nearest {}", path.display(), bound(*from_s, "the start"),
        bound(*to_s, "the end"), nearest(*before_s, *after_s))]
    EmptySpan {
        /// The recording or folder.
        path: PathBuf,
        /// Requested start, seconds.
        from_s: Option<f64>,
        /// Requested end, seconds.
        to_s: Option<f64>,
        /// Time of the last frame before it, seconds.
        before_s: Option<f64>,
        /// Time of the first frame after it, seconds.
        after_s: Option<f64>,
    },
    /// A span that ends before it starts.
    #[error("the span of time from {from_s} s to {to_s} s ends before it starts")]
    Span {
        /// Requested start, seconds.
        from_s: f64,
        /// Requested end, seconds.
        to_s: f64,
    },
    /// A frame rate stated for a recording.
    #[error("{}: a recording has its own time stamps; a frame rate may be stated for a folder of pictures or a raw \
        stream (.h264) only", path.display())]
    RateOfVideo {
        /// The file.
        path: PathBuf,
    },
    /// Not a frame rate.
    #[error(transparent)]
    Rate(#[from] FrameRateError),
    /// A folder without pictures.
    #[error("{}: no picture in this folder (files ending in {}){}", path.display(), PICTURE_ENDINGS.join(", "),
        cure.as_ref().map(|cure| format!("; {cure}")).unwrap_or_default())]
    NoPictures {
        /// The folder.
        path: PathBuf,
        /// How to make other pictures in the folder readable.
        cure: Option<String>,
    },
    /// A folder of pictures without times.
    #[error("{}: the pictures have no times. Put a table times.csv beside them (header \"file,t_s\", \
        or \"file,stamp_ns\"; a row for each picture), or state their rate with --fps", path.display())]
    NoTimes {
        /// The folder.
        path: PathBuf,
    },
    /// A table of times and a stated rate.
    #[error("{}: has times.csv, and {rate} frames per second are stated: leave out --fps, or move the table \
        away", path.display())]
    TwoTimes {
        /// The folder.
        path: PathBuf,
        /// Rate stated.
        rate: String,
    },
    /// A table of times that cannot be understood.
    #[error("{}:{line}: {reason}", path.display())]
    Times {
        /// The table.
        path: PathBuf,
        /// Line in it, from 1.
        line: u64,
        /// What is wrong and what would be right.
        reason: String,
    },
    /// A picture missing from the table of times.
    #[error("{}: picture {picture} has no row in this table", path.display())]
    NotInTimes {
        /// The table.
        path: PathBuf,
        /// Name of the picture.
        picture: String,
    },
    /// A picture without a number among numbered ones.
    #[error("{}: its name does not end with a number, as that of {numbered} does: with --fps pictures are taken for \
        one sequence in the order of their names; move it elsewhere, or give the times in times.csv", path.display())]
    NoNumber {
        /// The picture.
        path: PathBuf,
        /// Name of one that has a number.
        numbered: String,
    },
    /// A picture that cannot be decoded.
    #[error("{}: is not a picture that can be read: {reason}", path.display())]
    Picture {
        /// The picture.
        path: PathBuf,
        /// Why.
        reason: String,
    },
    /// A file with several pictures.
    #[error(
        "{}: holds more than one picture, and a frame is one; take it apart, for example with ImageMagick: \
        convert FILE.tif frame%05d.png",
        path.display()
    )]
    Pages {
        /// The file.
        path: PathBuf,
    },
    /// A time outside the range of 64-bit nanoseconds.
    #[error("{}: the time of frame {seq} is beyond 292 years", path.display())]
    TimeRange {
        /// The recording or folder.
        path: PathBuf,
        /// Number of the frame.
        seq: u64,
    },
}

impl SourceError {
    /// Whether the frames handed out before this error are the readable part of a recording that ends early, so that
    /// their results are worth keeping.
    pub fn is_early_end(&self) -> bool {
        matches!(self, Self::Truncated { .. })
    }
}

fn last_good(frames: u64, last_good_s: Option<f64>) -> String {
    match last_good_s {
        Some(s) => format!("{} could be read, the last one at {s} s", plural(frames, "frame")),
        None => "no frame could be read".to_owned(),
    }
}

fn bound(s: Option<f64>, open: &str) -> String {
    s.map_or_else(|| open.to_owned(), |s| format!("{s} s"))
}

fn nearest(before_s: Option<f64>, after_s: Option<f64>) -> String {
    match (before_s, after_s) {
        (Some(before), Some(after)) => format!("are at {before} s and {after} s"),
        (Some(last), None) => format!("is the last, at {last} s"),
        (None, Some(first)) => format!("is the first, at {first} s"),
        (None, None) => "is none: there are no frames".to_owned(),
    }
}
