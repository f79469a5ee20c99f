//! A recording played at its own pace: each frame is passed on when as much time has passed here as in the recording.
//!
//! Frames are decoded before they are due. A slow consumer gets them late until it has caught up: this source drops
//! nothing.

use super::super::host::{ClockFit, HostClock};
use super::super::pace::Pace;
use super::super::{Frame, FrameSource, SourceError, StreamFaults};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// A recording at its own pace.
pub struct Paced {
    recording: Box<dyn FrameSource + Send>,
    clock: HostClock,
    fit: ClockFit,
    stop: Arc<AtomicBool>,
    /// From the first frame on.
    pace: Option<Pace>,
}

impl Paced {
    /// Plays `recording`.
    pub fn new(recording: Box<dyn FrameSource + Send>, clock: HostClock, stop: Arc<AtomicBool>) -> Self {
        Self { recording, clock, fit: ClockFit::default(), stop, pace: None }
    }
}

impl FrameSource for Paced {
    fn next_frame(&mut self) -> Result<Option<Frame>, SourceError> {
        let Some(mut frame) = self.recording.next_frame()? else { return Ok(None) };
        let pace = self.pace.get_or_insert_with(|| Pace::from_now(frame.stamp.ns));
        if !pace.wait(frame.stamp.ns, &self.stop) {
            return Ok(None);
        }
        frame.host = Some(self.fit.map(frame.stamp.ns, self.clock.now_ns()));
        Ok(Some(frame))
    }

    fn size_px(&self) -> [u32; 2] {
        self.recording.size_px()
    }

    fn frame_count_hint(&self) -> Option<u64> {
        self.recording.frame_count_hint()
    }

    fn faults(&self) -> StreamFaults {
        self.recording.faults()
    }
}
