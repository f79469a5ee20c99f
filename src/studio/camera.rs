//! A camera that runs while pictures of a board are taken: its newest frame, and nothing else of it.

use super::{Refusal, Reply, shown};
use crate::calibrate::board::BoardImage;
use crate::sink::ToBgr;
use crate::source::{Frame, FrameSource};
use base64::prelude::{BASE64_STANDARD, Engine as _};
use parking_lot::{Mutex, MutexGuard};
use serde::Deserialize;
use serde_json::{Value, json};
use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::{Builder, JoinHandle};
use std::time::{Duration, Instant};

/// Pictures that are looked at are no wider, pixels.
const WIDTH_PX: u32 = 960;
/// A picture that is older than this, and than so many steps from frame to frame, is not what the camera sees now.
const STALE: Duration = Duration::from_secs(2);
const STALE_STEPS: u32 = 4;

/// A camera that runs until this is dropped.
pub(crate) struct Camera {
    name: String,
    size_px: [u32; 2],
    newest: Arc<Mutex<Newest>>,
    to_bgr: Mutex<ToBgr>,
    looked: Mutex<Option<SearchedFrame>>,
    /// The flag that the source watches, too.
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

/// A frame in which a board was looked for, and what was in it.
pub(super) struct SearchedFrame {
    pub(super) frame: Arc<Frame>,
    pub(super) images: Vec<BoardImage>,
    /// When the board was seen for the first time where it is now.
    pub(super) since: Instant,
}

#[derive(Default)]
struct Newest {
    frame: Option<Arc<Frame>>,
    /// When it came, and how long after the one before.
    came: Option<(Instant, Duration)>,
    /// Why there are no more, when that is so.
    ended: Option<String>,
}

impl Newest {
    fn put(&mut self, frame: Frame) {
        let now = Instant::now();
        let step = self.came.map_or(Duration::ZERO, |(before, _)| now - before);
        (self.frame, self.came) = (Some(Arc::new(frame)), Some((now, step)));
    }

    /// How long no frame has come, if that is longer than the camera's pace explains.
    fn silence(&self) -> Option<Duration> {
        let (came, step) = self.came?;
        Some(came.elapsed()).filter(|age| *age > STALE.max(step * STALE_STEPS))
    }
}

impl Camera {
    /// Takes frames out of `source`, which watches `stop`.
    ///
    /// # Errors
    /// When the system gives no thread.
    pub(crate) fn start(
        name: &str,
        mut source: Box<dyn FrameSource + Send>,
        stop: &Arc<AtomicBool>,
    ) -> io::Result<Self> {
        let newest = Arc::new(Mutex::new(Newest::default()));
        let size_px = source.size_px();
        let (shared, flag) = (Arc::clone(&newest), Arc::clone(stop));
        let thread = Builder::new().name("camera".to_owned()).spawn(move || {
            let ended = loop {
                if flag.load(Ordering::Relaxed) {
                    break "the studio has ended".to_owned();
                }
                match source.next_frame() {
                    Ok(Some(frame)) => shared.lock().put(frame),
                    Ok(None) => break "it has ended; its last picture is shown".to_owned(),
                    Err(error) => break error.to_string(),
                }
            };
            shared.lock().ended = Some(ended);
        })?;
        let (name, stop) = (name.to_owned(), Arc::clone(stop));
        let (to_bgr, looked) = (Mutex::default(), Mutex::default());
        Ok(Self { name, size_px, newest, to_bgr, looked, stop, thread: Some(thread) })
    }

    /// What does not change.
    pub(super) fn about(&self) -> Value {
        json!({ "name": self.name, "size": self.size_px })
    }

    /// The newest frame.
    pub(super) fn newest(&self) -> Result<Arc<Frame>, Refusal> {
        let newest = self.newest.lock();
        let none = || {
            let why = newest.ended.as_deref().unwrap_or("no picture has come yet");
            Refusal { status: 503, words: format!("{}: {why}", self.name) }
        };
        newest.frame.clone().ok_or_else(none)
    }

    /// The newest frame, unless the camera has fallen silent: to be kept as what it sees now.
    pub(super) fn current(&self) -> Result<Arc<Frame>, Refusal> {
        let silence = self.newest.lock().silence();
        match silence {
            None => self.newest(),
            Some(silence) => {
                let words = format!("{}: no picture for {:.0} s", self.name, silence.as_secs_f64());
                Err(Refusal { status: 503, words })
            }
        }
    }

    /// The frame that was looked at last.
    pub(super) fn looked(&self) -> MutexGuard<'_, Option<SearchedFrame>> {
        self.looked.lock()
    }

    /// Its picture, whole.
    pub(super) fn rgb(&self, frame: &Frame) -> Result<image::RgbImage, Refusal> {
        shown::rgb(&mut self.to_bgr.lock(), &frame.picture)
    }

    /// The newest picture, scaled; nothing when the page has it.
    pub(super) fn look(&self, asked: &LookAsked) -> Result<Reply, Refusal> {
        let frame = self.newest()?;
        let (ended, silence) = {
            let newest = self.newest.lock();
            (newest.ended.clone(), newest.silence().map(|silence| silence.as_secs()))
        };
        if asked.after == Some(frame.seq) && ended.is_none() && silence.is_none() {
            return Ok(Reply::Nothing);
        }
        let jpeg = shown::jpeg(&mut self.to_bgr.lock(), &frame.picture, Some(WIDTH_PX))?;
        let jpeg = BASE64_STANDARD.encode(jpeg);
        Ok(Reply::Json(json!({ "seq": frame.seq, "jpeg": jpeg, "ended": ended, "silent_s": silence })))
    }
}

impl Drop for Camera {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        // What is asleep in a driver is not waited for: the process ends soon.
        if let Some(thread) = self.thread.take().filter(JoinHandle::is_finished) {
            // A panic there is told by the thread itself.
            let _ = thread.join();
        }
    }
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct LookAsked {
    /// Number of the picture that the page has.
    after: Option<u64>,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_camera_is_silent_when_its_own_pace_does_not_explain_it() {
        let after = |age_s: u64, step_s: u64| {
            let came = Instant::now().checked_sub(Duration::from_secs(age_s)).unwrap();
            Newest { came: Some((came, Duration::from_secs(step_s))), ..Newest::default() }.silence().is_some()
        };
        assert!(!after(1, 0) && after(3, 0) && !after(3, 1) && after(5, 1));
        assert!(Newest::default().silence().is_none());
    }
}
