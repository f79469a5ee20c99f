//! Live streams through libav: `rtsp://`, `http://`, `udp://`, `tcp://`, `srt://`, or a container on standard input
//! (`-`).
//!
//! A network stream that ends or falls silent is reopened, trying once a second, until it is back or the run is
//! stopped. Its stamps may restart: the gap before its first frame is unknown and counts as 0, the interruption is
//! counted ([`StreamFaults::interruptions`]). Standard input ends for good.

use super::super::host::{ClockFit, HostClock};
use super::super::{Frame, FrameSource, SourceError, StreamFaults, VideoFile};
use super::retry::until_back;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

/// A live stream.
pub struct Stream {
    url: String,
    /// `None` while the stream is lost.
    input: Option<VideoFile>,
    size_px: [u32; 2],
    clock: HostClock,
    fit: ClockFit,
    stop: Arc<AtomicBool>,
    seq: u64,
    /// Faults of inputs that have ended.
    past: StreamFaults,
}

impl Stream {
    /// Opens the stream at `url`, `-` for standard input.
    ///
    /// # Errors
    /// When nobody answers, or the stream has no video.
    pub fn open(url: &str, clock: HostClock, stop: Arc<AtomicBool>) -> Result<Self, SourceError> {
        let input = VideoFile::stream(url)?;
        let size_px = input.size_px();
        let (fit, past) = (ClockFit::default(), StreamFaults::default());
        Ok(Self { url: url.to_owned(), input: Some(input), size_px, clock, fit, stop, seq: 0, past })
    }
}

impl FrameSource for Stream {
    fn next_frame(&mut self) -> Result<Option<Frame>, SourceError> {
        let comes_back = self.url != "-";
        while !self.stop.load(Ordering::Relaxed) {
            let Some(input) = &mut self.input else {
                self.input = until_back(&self.url, "stream", &self.stop, || VideoFile::stream(&self.url));
                continue;
            };
            let reason = match input.next_frame() {
                Ok(Some(mut frame)) => {
                    let arrival_ns = self.clock.at_ns(input.arrival().unwrap_or_else(Instant::now));
                    frame.host = Some(self.fit.map(frame.stamp.ns, arrival_ns));
                    frame.seq = self.seq;
                    self.seq += 1;
                    return Ok(Some(frame));
                }
                Ok(None) if !comes_back => return Ok(None),
                Err(error) if !comes_back => return Err(error),
                Ok(None) => "it has ended".to_owned(),
                Err(error) => error.to_string(),
            };
            tracing::warn!("{}: the stream is interrupted ({reason}); waiting for it to come back", self.url);
            self.past.add(input.faults());
            self.past.interruptions += 1;
            self.input = None;
        }
        Ok(None)
    }

    fn size_px(&self) -> [u32; 2] {
        self.size_px
    }

    fn frame_count_hint(&self) -> Option<u64> {
        None
    }

    fn faults(&self) -> StreamFaults {
        let mut all = self.past;
        if let Some(input) = &self.input {
            all.add(input.faults());
        }
        all
    }
}
