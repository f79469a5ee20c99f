//! The frames of one recording by number: a list of their times that grows while the recording is read through once,
//! and the frames themselves, decoded where they are asked for and kept while they are near.

use super::Refusal;
use super::places::{changed, opened};
use crate::archive::hash;
use crate::calibrate::markers::locate::pixels::Pixels;
use crate::sink::ToBgr;
use crate::source::{Frame, FrameRate, FrameSource, SourceOptions, Span};
use parking_lot::Mutex;
use std::collections::VecDeque;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::Builder;
use std::time::SystemTime;

/// Memory of the frames that are kept, bytes, and how many at least.
const KEPT_BYTES: usize = 120_000_000;
const MIN_KEPT: usize = 4;
/// Frames further ahead than this are jumped to.
const SEEK_BEYOND: usize = 40;
/// Frames before the one asked for that are decoded with it: who steps, steps back too.
const DECODED_BEFORE: usize = 5;

/// A recording that is open.
pub(super) struct Reel {
    path: PathBuf,
    /// When it was changed last, and its length.
    changed: Option<(SystemTime, u64)>,
    options: SourceOptions,
    /// The rate that it was asked for with.
    asked_rate: Option<FrameRate>,
    size_px: [u32; 2],
    hint: Option<u64>,
    index: Arc<Index>,
    content: Arc<Mutex<Content>>,
    hand: Mutex<ReelState>,
}

/// What is known of all its bytes.
#[derive(Debug, Default)]
enum Content {
    #[default]
    NotAsked,
    BeingRead,
    /// SHA-256; `None` when it cannot be read.
    Read(Option<String>),
}

/// The times of its frames.
#[derive(Default)]
struct Index {
    state: Mutex<Indexed>,
    stop: AtomicBool,
}

/// How far the recording was read through.
#[derive(Debug, Clone, Default)]
pub(super) struct Indexed {
    /// Times of the frames, nanoseconds.
    pub(super) stamps_ns: Vec<i64>,
    /// Whether these are all.
    pub(super) done: bool,
    /// Why there are no more, if that is not the end.
    pub(super) error: Option<String>,
}

#[derive(Default)]
struct ReelState {
    /// Gives the frames from this number on.
    reader: Option<(usize, Box<dyn FrameSource + Send>)>,
    kept: VecDeque<(usize, Arc<Frame>)>,
    pixels: Option<(usize, Arc<Pixels>)>,
    to_bgr: ToBgr,
}

impl Reel {
    /// Opens a recording, and reads its first frame.
    pub(super) fn open(
        path: &Path,
        options: SourceOptions,
        asked_rate: Option<FrameRate>,
    ) -> Result<Arc<Self>, Refusal> {
        let changed = changed(path);
        let mut source = opened(path, options)?;
        let (size_px, hint) = (source.size_px(), source.frame_count_hint());
        let first = source.next_frame().map_err(Refusal::wrong)?;
        let first = first.ok_or_else(|| Refusal::wrong(format!("{}: has no frame", path.display())))?;
        let index = Arc::new(Index::default());
        index.state.lock().stamps_ns.push(first.stamp.ns);
        let mut hand = ReelState { reader: Some((1, source)), ..ReelState::default() };
        hand.kept.push_back((0, Arc::new(first)));
        let (path, content, hand) = (path.to_owned(), Arc::default(), Mutex::new(hand));
        let reel = Self { path, changed, options, asked_rate, size_px, hint, index, content, hand };
        let (index, path) = (Arc::clone(&reel.index), reel.path.clone());
        let read = move || index.fill(&path, SourceOptions { decoder_threads: 1, ..options });
        Builder::new().name("studio index".to_owned()).spawn(read).map_err(Refusal::wrong)?;
        Ok(Arc::new(reel))
    }

    /// Whether it is still the recording that was opened.
    pub(super) fn is_current(&self) -> bool {
        changed(&self.path) == self.changed
    }

    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// The rate that it was asked for with; with none it may have been opened with that of the command line.
    pub(super) fn asked_rate(&self) -> Option<FrameRate> {
        self.asked_rate
    }

    /// The rate that was stated for it.
    pub(super) fn stated_rate(&self) -> Option<FrameRate> {
        self.options.stated_rate
    }

    /// SHA-256 of its content, inner `None` when it cannot be read. `None` as long as it is being read: it can be long.
    pub(super) fn sha256(&self) -> Option<Option<String>> {
        let mut content = self.content.lock();
        match &*content {
            Content::Read(hash) => return Some(hash.clone()),
            Content::BeingRead => return None,
            Content::NotAsked => {}
        }
        let (known, path) = (Arc::clone(&self.content), self.path.clone());
        let read = move || *known.lock() = Content::Read(hash::of_recording(&path).ok());
        *content = match Builder::new().name("studio content".to_owned()).spawn(read) {
            Ok(_) => Content::BeingRead,
            Err(_) => Content::Read(None),
        };
        None
    }

    pub(super) fn size_px(&self) -> [u32; 2] {
        self.size_px
    }

    /// How many frames there may be.
    pub(super) fn hint(&self) -> Option<u64> {
        self.hint
    }

    pub(super) fn indexed(&self) -> Indexed {
        self.index.state.lock().clone()
    }

    /// The number of the frame with this time.
    pub(super) fn at(&self, stamp_ns: i64) -> Option<usize> {
        self.index.state.lock().stamps_ns.iter().position(|ns| *ns == stamp_ns)
    }

    /// Frame number `i`, and its colours pixel by pixel.
    pub(super) fn with_pixels(&self, i: usize) -> Result<(Arc<Frame>, Arc<Pixels>), Refusal> {
        let mut hand = self.hand.lock();
        let frame = hand.frame(self, i)?;
        if let Some((_, pixels)) = hand.pixels.as_ref().filter(|(of, _)| *of == i) {
            return Ok((frame, Arc::clone(pixels)));
        }
        let grey = || Refusal::wrong("grey pictures have no colour");
        let pixels = Arc::new(Pixels::of(&frame.picture).ok_or_else(grey)?);
        hand.pixels = Some((i, Arc::clone(&pixels)));
        Ok((frame, pixels))
    }

    /// Frame number `i` as JPEG, no wider than `width`.
    pub(super) fn jpeg(&self, i: usize, width: Option<u32>) -> Result<(Arc<Frame>, Vec<u8>), Refusal> {
        let mut hand = self.hand.lock();
        let frame = hand.frame(self, i)?;
        let jpeg = super::shown::jpeg(&mut hand.to_bgr, &frame.picture, width)?;
        Ok((frame, jpeg))
    }
}

impl Drop for Reel {
    fn drop(&mut self) {
        self.index.stop.store(true, Ordering::Relaxed);
    }
}

impl Index {
    /// Reads the recording through.
    fn fill(&self, path: &Path, options: SourceOptions) {
        let mut source = match opened(path, options) {
            Ok(source) => source,
            Err(refusal) => return self.end(Some(refusal.words)),
        };
        let mut first = true;
        while !self.stop.load(Ordering::Relaxed) {
            match source.next_frame() {
                // The first is there already.
                Ok(Some(_)) if std::mem::take(&mut first) => {}
                Ok(Some(frame)) => self.state.lock().stamps_ns.push(frame.stamp.ns),
                Ok(None) => return self.end(None),
                Err(error) => return self.end(Some(error.to_string())),
            }
        }
    }

    fn end(&self, error: Option<String>) {
        let mut state = self.state.lock();
        (state.done, state.error) = (true, error);
    }
}

/// The last frame up to number `from` whose time tells where it is: all before it are earlier, all after it later.
fn seekable(stamps_ns: &[i64], from: usize) -> Option<usize> {
    let mut after: Vec<i64> = stamps_ns.to_vec();
    for k in (1..after.len()).rev() {
        after[k - 1] = after[k - 1].min(after[k]);
    }
    let mut latest = i64::MIN;
    let mut found = None;
    for (k, ns) in stamps_ns.iter().enumerate().take(from.saturating_add(1)) {
        if *ns > latest && after.get(k + 1).is_none_or(|least| least > ns) {
            found = Some(k);
        }
        latest = latest.max(*ns);
    }
    found
}

impl ReelState {
    fn frame(&mut self, reel: &Reel, i: usize) -> Result<Arc<Frame>, Refusal> {
        if let Some((_, frame)) = self.kept.iter().find(|(of, _)| *of == i) {
            return Ok(Arc::clone(frame));
        }
        let count = reel.index.state.lock().stamps_ns.len();
        let beyond = || Refusal::wrong(format!("frame {i}: expected one of the {count} that are known so far"));
        if i >= count {
            return Err(beyond());
        }
        if !self.reader.as_ref().is_some_and(|(next, _)| (*next..*next + SEEK_BEYOND).contains(&i)) {
            let (from, from_ns) = {
                let stamps_ns = &reel.index.state.lock().stamps_ns;
                let from = seekable(stamps_ns, i.saturating_sub(DECODED_BEFORE));
                (from.unwrap_or(0), from.and_then(|from| stamps_ns.get(from).copied()))
            };
            let span = Span { from_ns, to_ns: None };
            // A stated rate counts from the first picture that is read.
            let (from, span) = if reel.options.stated_rate.is_some() { (0, Span::default()) } else { (from, span) };
            self.reader = Some((from, opened(&reel.path, SourceOptions { span, ..reel.options })?));
        }
        while let Some((next, source)) = &mut self.reader {
            match source.next_frame() {
                Ok(Some(frame)) => {
                    let (number, frame) = (*next, Arc::new(frame));
                    *next += 1;
                    self.keep(reel, number, &frame);
                    if number == i {
                        return Ok(frame);
                    }
                }
                Ok(None) => {
                    self.reader = None;
                    return Err(beyond());
                }
                Err(error) => {
                    self.reader = None;
                    return Err(Refusal::wrong(error));
                }
            }
        }
        Err(beyond())
    }

    fn keep(&mut self, reel: &Reel, number: usize, frame: &Arc<Frame>) {
        let [width, height] = reel.size_px.map(|size| size as usize);
        let most = (KEPT_BYTES / (width * height * 2).max(1)).max(MIN_KEPT);
        self.kept.retain(|(of, _)| *of != number);
        self.kept.push_back((number, Arc::clone(frame)));
        while self.kept.len() > most {
            self.kept.pop_front();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_frame_is_sought_by_a_time_that_no_other_has() {
        assert_eq!(seekable(&[0, 10, 20, 30, 40], 3), Some(3));
        // Number 3 has the time of 2; 6 is earlier than 4 and 5.
        let stamps_ns = [0, 10, 20, 20, 50, 60, 40, 70];
        assert_eq!(
            (0..8).map(|from| seekable(&stamps_ns, from)).collect::<Vec<_>>(),
            [0, 1, 1, 1, 1, 1, 1, 7].map(Some)
        );
        assert_eq!(seekable(&[5, 5], 1), None);
    }
}
