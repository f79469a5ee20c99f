//! [`LiveScene`]: a simulated camera. What a rig shows is handed on at the pace of a real camera.
//!
//! Time begins when the first frame is asked for; each frame is handed on when it is due. Frames are rendered ahead, as
//! many as [`MAX_AHEAD`] allows. Where that does not keep the pace, frames that are overdue before they are begun are
//! lost, as a camera loses them, and the next one's `gap` counts them; one that was begun in time and is done too late
//! comes late.

use super::centre_line::Exposed;
use super::motion::MotionError;
use super::picture::{Renderer, Stored};
use super::timing::Stamp;
use crate::source::host::{ClockFit, HostClock};
use crate::source::pace::{POLL_INTERVAL, Pace};
use crate::source::{Clock, Frame, FrameSource, SourceError, Timestamp};
use rayon::prelude::*;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::sync::{Arc, OnceLock};
use std::thread::{Builder, JoinHandle};

/// Frames that are rendered ahead of time.
pub const MAX_AHEAD: usize = 16;

/// Where the catheter is in a frame of the list.
pub type Motion = Box<dyn FnMut(usize, Stamp) -> Result<Exposed, MotionError> + Send>;

/// A scene before a camera, live.
pub struct LiveScene {
    name: String,
    size_px: [u32; 2],
    /// Rendered before anything else begins: its time is not that of the run.
    first: Option<Result<Frame, MotionError>>,
    frames: Receiver<Result<Frame, MotionError>>,
    /// From the first frame that was asked for.
    pace: Arc<OnceLock<Pace>>,
    first_ns: i64,
    clock: HostClock,
    fit: ClockFit,
    stop: Arc<AtomicBool>,
    renderer: Option<JoinHandle<()>>,
}

impl LiveScene {
    /// Begins to render the frames of `stamps` ahead; `seed` is that of their noise. `name` is what errors call it.
    ///
    /// # Errors
    /// [`SourceError::Camera`] when the system gives no thread.
    pub fn start(
        name: &str,
        renderer: Renderer,
        motion: Motion,
        (stamps, seed): (Vec<Stamp>, u64),
        clock: HostClock,
        stop: Arc<AtomicBool>,
    ) -> Result<Self, SourceError> {
        let (out, frames) = sync_channel(MAX_AHEAD);
        let pace = Arc::new(OnceLock::new());
        let (size_px, first_ns) = (renderer.size_px(), stamps.first().map_or(0, |stamp| stamp.ns));
        let work = Work { renderer, motion, stamps, seed, pace: Arc::clone(&pace), stop: Arc::clone(&stop), out };
        let spawned = Builder::new().name("renderer".to_owned()).spawn(move || work.run());
        let failed = |e: std::io::Error| SourceError::Camera {
            name: name.to_owned(),
            reason: format!("the system gives no thread to render in: {e}"),
        };
        let renderer = Some(spawned.map_err(failed)?);
        let (name, fit) = (name.to_owned(), ClockFit::default());
        let first = frames.recv().ok();
        Ok(Self { name, size_px, first, frames, pace, first_ns, clock, fit, stop, renderer })
    }

    /// Waits until something comes; `None` when nothing will, or when asked to stop.
    fn rendered(&mut self) -> Option<Result<Frame, MotionError>> {
        if let Some(first) = self.first.take() {
            return Some(first);
        }
        loop {
            match self.frames.recv_timeout(POLL_INTERVAL) {
                Ok(frame) => return Some(frame),
                Err(RecvTimeoutError::Timeout) if !self.stop.load(Ordering::Relaxed) => {}
                Err(_) => return None,
            }
        }
    }
}

impl FrameSource for LiveScene {
    fn next_frame(&mut self) -> Result<Option<Frame>, SourceError> {
        let Some(rendered) = self.rendered() else { return Ok(None) };
        let lost = |e: MotionError| SourceError::Camera { name: self.name.clone(), reason: e.to_string() };
        let mut frame = rendered.map_err(lost)?;
        let pace = self.pace.get_or_init(|| Pace::from_now(self.first_ns));
        if !pace.wait(frame.stamp.ns, &self.stop) {
            return Ok(None);
        }
        frame.host = Some(self.fit.map(frame.stamp.ns, self.clock.now_ns()));
        Ok(Some(frame))
    }

    fn size_px(&self) -> [u32; 2] {
        self.size_px
    }
}

impl Drop for LiveScene {
    fn drop(&mut self) {
        // Who waits to hand a frame on finds nobody, and ends.
        let (_, nothing) = sync_channel(0);
        self.frames = nothing;
        let ended = self.renderer.take().map(JoinHandle::join);
        if ended.is_some_and(|ended| ended.is_err()) {
            tracing::error!("{}: the thread that renders has panicked", self.name);
        }
    }
}

/// What the thread that renders has.
struct Work {
    renderer: Renderer,
    motion: Motion,
    stamps: Vec<Stamp>,
    seed: u64,
    pace: Arc<OnceLock<Pace>>,
    stop: Arc<AtomicBool>,
    out: SyncSender<Result<Frame, MotionError>>,
}

impl Work {
    /// As long as there are frames and somebody takes them.
    fn run(mut self) {
        let side_by_side = rayon::current_num_threads().clamp(1, MAX_AHEAD / 2);
        let (mut next, mut seq, mut gap) = (0, 0, 0_u32);
        while next < self.stamps.len() && !self.stop.load(Ordering::Relaxed) {
            let mut batch = Vec::with_capacity(side_by_side);
            while let Some(stamp) = self.stamps.get(next).copied().filter(|_| batch.len() < side_by_side) {
                next += 1;
                gap = gap.saturating_add(stamp.gap);
                if self.is_overdue(stamp) {
                    gap = gap.saturating_add(1);
                    continue;
                }
                match (self.motion)(next - 1, stamp) {
                    Ok(exposed) => batch.push((next - 1, stamp, std::mem::take(&mut gap), exposed)),
                    Err(error) => {
                        let _ = self.out.send(Err(error));
                        return;
                    }
                }
            }
            let draw = |(index, stamp, gap, exposed): &(usize, Stamp, u32, Exposed)| {
                let seed = noise_seed(self.seed, *index as u64);
                let picture = self.renderer.picture(exposed, seed, Stored::Whole).ok()?.marked_as_given();
                Some((*stamp, *gap, picture))
            };
            let drawn: Vec<_> = batch.par_iter().filter_map(draw).collect();
            for (stamp, gap, picture) in drawn {
                let stamp = Timestamp { ns: stamp.ns, clock: Clock::Device };
                if self.out.send(Ok(Frame { seq, stamp, gap, host: None, picture })).is_err() {
                    return;
                }
                seq += 1;
            }
        }
    }

    fn is_overdue(&self, stamp: Stamp) -> bool {
        self.pace.get().is_some_and(|pace| pace.is_overdue(stamp.ns))
    }
}

/// Seed of a frame's noise: the same in a recording and live.
pub fn noise_seed(seed: u64, frame: u64) -> u64 {
    seed.wrapping_mul(0x2545_f491_4f6c_dd1d) ^ frame
}
