//! All that the page works with, and keeps open.

use super::camera::Camera;
use super::places::Places;
use super::reel::Reel;
use super::run::{Run, Runs};
use super::searched::Boards;
use super::watch::Watch;
use super::{Refusal, Start, Verbs};
use crate::source::{FrameRate, SourceOptions};
use parking_lot::Mutex;
use std::path::Path;
use std::sync::Arc;

/// Recordings that stay open.
const MAX_REELS: usize = 3;

/// All that the page works with.
pub(crate) struct Desk {
    pub(super) places: Places,
    pub(super) start: Start,
    pub(super) verbs: Option<Verbs>,
    pub(super) watch: Option<Watch>,
    /// A camera that pictures of a board are taken with.
    pub(super) camera: Option<Camera>,
    pub(super) boards: Boards,
    runs: Runs,
    reels: Mutex<Vec<Arc<Reel>>>,
}

impl Desk {
    /// For teaching and looking through runs.
    pub(crate) fn new(places: Places, start: Start, verbs: Verbs) -> Self {
        Self { start, verbs: Some(verbs), ..Self::empty(places) }
    }

    /// For a live run, and nothing else.
    pub(crate) fn live(places: Places, watch: Watch) -> Self {
        Self { watch: Some(watch), ..Self::empty(places) }
    }

    fn empty(places: Places) -> Self {
        Self {
            places,
            start: Start::default(),
            verbs: None,
            watch: None,
            camera: None,
            boards: Boards::default(),
            runs: Runs::default(),
            reels: Mutex::default(),
        }
    }

    /// With a camera that pictures of a board are taken with.
    pub(crate) fn with_camera(mut self, camera: Camera) -> Self {
        self.camera = Some(camera);
        self
    }

    pub(super) fn camera(&self) -> Result<&Camera, Refusal> {
        let none = || Refusal::wrong("there is no camera: start `catoptra studio /dev/video0 --rig RIG.toml`");
        self.camera.as_ref().ok_or_else(none)
    }

    pub(super) fn verbs(&self) -> Result<&Verbs, Refusal> {
        self.verbs.as_ref().ok_or_else(|| Refusal::forbidden("this is not part of a live run: start `catoptra studio`"))
    }

    pub(super) fn watch(&self) -> Result<&Watch, Refusal> {
        let none = || Refusal::wrong("no live run is watched: start `catoptra live … --studio`");
        self.watch.as_ref().ok_or_else(none)
    }

    /// The run in a folder.
    pub(super) fn run(&self, text: &str) -> Result<Arc<Run>, Refusal> {
        self.verbs()?;
        self.runs.get(&self.places.existing(text)?)
    }

    /// The same, if it is still as the page has read it.
    pub(super) fn run_as_read(&self, text: &str, version: Option<&str>) -> Result<Arc<Run>, Refusal> {
        let run = self.run(text)?;
        if version.is_some_and(|version| version != run.version()) {
            return Err(Refusal::tracked_again());
        }
        Ok(run)
    }

    /// The recording at a path, opened when it is not.
    pub(super) fn reel(&self, text: &str) -> Result<Arc<Reel>, Refusal> {
        self.verbs()?;
        let path = self.places.existing(text)?;
        // By number, a picture is the same at any rate.
        let open = reused(&mut self.reels.lock(), |reel| reel.path() == path);
        open.map_or_else(|| self.reel_at(&path, None), Ok)
    }

    /// The recording at a whole path, with this rate; with none, that of the command line if it has no times.
    pub(super) fn reel_at(&self, path: &Path, rate: Option<FrameRate>) -> Result<Arc<Reel>, Refusal> {
        // Held while it is opened: two requests open it once.
        let mut reels = self.reels.lock();
        if let Some(reel) = reused(&mut reels, |reel| reel.path() == path && reel.asked_rate() == rate) {
            return Ok(reel);
        }
        let options = |stated_rate| SourceOptions { stated_rate, ..SourceOptions::default() };
        let open = |stated_rate| Reel::open(path, options(stated_rate), rate);
        let reel = open(rate).or_else(|refusal| match self.start.fps {
            Some(stated) if rate.is_none() => open(Some(stated)).map_err(|_| refusal),
            _ => Err(refusal),
        })?;
        if reels.len() >= MAX_REELS {
            reels.remove(0);
        }
        reels.push(Arc::clone(&reel));
        Ok(reel)
    }
}

/// One of the reels, the last used, if it is still as its recording is: it is the last used then.
fn reused(reels: &mut Vec<Arc<Reel>>, is_asked: impl Fn(&Reel) -> bool) -> Option<Arc<Reel>> {
    let reel = reels.remove(reels.iter().rposition(|reel| is_asked(reel))?);
    reel.is_current().then(|| {
        reels.push(Arc::clone(&reel));
        reel
    })
}
