//! Opens what a path names: a recorded video, a folder of pictures, a log.

use super::{FrameRate, FrameSource, ImageFolder, ImageTiming, LogWindows, SourceError, Span, VideoFile, VideoOptions};
use std::path::Path;

/// How frames are read, from any kind of source.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SourceOptions {
    /// Part to read.
    pub span: Span,
    /// Frame rate the user states for a folder of pictures without times, or a raw stream.
    pub stated_rate: Option<FrameRate>,
    /// Threads of the video decoder; 0 for as many as keep all cores busy.
    pub decoder_threads: usize,
    /// Whether damaged pictures are passed on, marked, instead of left out.
    pub keep_damaged: bool,
}

impl Default for SourceOptions {
    fn default() -> Self {
        let VideoOptions { decoder_threads, span, stated_rate, keep_damaged } = VideoOptions::default();
        Self { span, stated_rate, decoder_threads, keep_damaged }
    }
}

/// Opens a recorded video (a file) or a folder of pictures.
///
/// # Errors
/// [`SourceError`] when it cannot be opened, or is not one.
pub fn open(path: impl AsRef<Path>, options: SourceOptions) -> Result<Box<dyn FrameSource + Send>, SourceError> {
    let path = path.as_ref();
    if crate::log::is_log(path) {
        return Err(SourceError::IsLog { path: path.to_path_buf() });
    }
    if path.is_dir() {
        let timing = options.stated_rate.map_or(ImageTiming::Table, ImageTiming::StatedRate);
        return Ok(Box::new(ImageFolder::open(path, timing, options.span)?.keeping_damaged(options.keep_damaged)));
    }
    if path.exists() && !path.is_file() {
        return Err(SourceError::NoFile { path: path.to_path_buf() });
    }
    let SourceOptions { decoder_threads, span, stated_rate, keep_damaged } = options;
    Ok(Box::new(VideoFile::open(path, VideoOptions { decoder_threads, span, stated_rate, keep_damaged })?))
}

/// As [`open`], and logs that hold the windows of their pictures ([`LogWindows`]): only for a
/// [`Tracker`](crate::track::Tracker), which checks that what it looks at was recorded.
///
/// # Errors
/// [`SourceError`] when it cannot be opened, or is not one.
pub fn open_to_track(
    path: impl AsRef<Path>,
    options: SourceOptions,
) -> Result<Box<dyn FrameSource + Send>, SourceError> {
    let path = path.as_ref();
    if !crate::log::is_log(path) {
        return open(path, SourceOptions { keep_damaged: true, ..options });
    }
    match options.stated_rate {
        Some(_) => Err(SourceError::RateOfVideo { path: path.to_path_buf() }),
        None => Ok(Box::new(LogWindows::open(path, options.span)?)),
    }
}
