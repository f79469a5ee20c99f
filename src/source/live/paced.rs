//! A recording played at its own pace: each frame is passed on when as much time has passed here as in the recording.
//!
//! Frames are decoded before they are due. A slow consumer gets them late until it has caught up: this source drops
//! nothing.

use super::super::host::{ClockFit, HostClock};
use super::super::{Frame, FrameSource, SourceError, StreamFaults};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// A recording at its own pace.
pub struct Paced {
    recording: Box<dyn FrameSource + Send>,
    clock: HostClock,
    fit: ClockFit,
    stop: Arc<AtomicBool>,
    /// When the first frame was passed on, and its stamp.
    began: Option<(Instant, i64)>,
}

/// How long it sleeps before it checks the stop flag.
const POLL_INTERVAL: Duration = Duration::from_millis(50);

impl Paced {
    /// Plays `recording`.
    pub fn new(recording: Box<dyn FrameSource + Send>, clock: HostClock, stop: Arc<AtomicBool>) -> Self {
        Self { recording, clock, fit: ClockFit::default(), stop, began: None }
    }

    /// Waits until the frame stamped `ns` is due; false when asked to stop.
    fn wait(&mut self, ns: i64) -> bool {
        let (began, first_ns) = *self.began.get_or_insert_with(|| (Instant::now(), ns));
        // A stamp that goes back is due at once.
        let due = began + Duration::from_nanos(u64::try_from(ns.saturating_sub(first_ns)).unwrap_or(0));
        loop {
            if self.stop.load(Ordering::Relaxed) {
                return false;
            }
            let rest = due.saturating_duration_since(Instant::now());
            if rest.is_zero() {
                return true;
            }
            std::thread::sleep(rest.min(POLL_INTERVAL));
        }
    }
}

impl FrameSource for Paced {
    fn next_frame(&mut self) -> Result<Option<Frame>, SourceError> {
        let Some(mut frame) = self.recording.next_frame()? else { return Ok(None) };
        if !self.wait(frame.stamp.ns) {
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
