//! What the page may ask: a name and JSON in, JSON or a picture out.

use super::places::Places;
use super::reel::Reel;
use super::review::{self, Runs};
use super::watch::Watch;
use super::{Refusal, Start, Verbs, teach, veto, watch};
use axum::http::HeaderName;
use serde::Deserialize;
use serde::de::DeserializeOwned;
use serde_json::{Value, json};
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};

/// Recordings that stay open.
const MOST_REELS: usize = 3;

/// A header that says what a picture is of.
pub(super) const ABOUT: HeaderName = HeaderName::from_static("x-about");

/// An answer.
pub(super) enum Reply {
    Json(Value),
    Jpeg { bytes: Vec<u8>, about: String },
    Nothing,
}

/// All that the page works with.
pub(crate) struct Desk {
    pub(super) places: Places,
    pub(super) start: Start,
    pub(super) verbs: Option<Verbs>,
    pub(super) watch: Option<Watch>,
    pub(super) runs: Runs,
    reels: Mutex<Vec<Arc<Reel>>>,
}

impl Desk {
    /// For teaching and looking through runs.
    pub(crate) fn new(places: Places, start: Start, verbs: Verbs) -> Self {
        Self { places, start, verbs: Some(verbs), watch: None, runs: Runs::default(), reels: Mutex::default() }
    }

    /// For a live run, and nothing else.
    pub(crate) fn live(places: Places, watch: Watch) -> Self {
        let start = Start::default();
        Self { places, start, verbs: None, watch: Some(watch), runs: Runs::default(), reels: Mutex::default() }
    }

    pub(super) fn verbs(&self) -> Result<&Verbs, Refusal> {
        self.verbs.as_ref().ok_or_else(|| Refusal::forbidden("this is not part of a live run: start `catoptra studio`"))
    }

    /// The recording at a path, opened when it is not.
    pub(super) fn reel(&self, text: &str) -> Result<Arc<Reel>, Refusal> {
        self.verbs()?;
        self.reel_at(&self.places.existing(text)?)
    }

    pub(super) fn reel_at(&self, path: &Path) -> Result<Arc<Reel>, Refusal> {
        // Held while it is opened: two requests open it once.
        let mut reels = self.reels.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(at) = reels.iter().position(|reel| reel.path() == path) {
            let reel = reels.remove(at);
            reels.push(Arc::clone(&reel));
            return Ok(reel);
        }
        let options = crate::source::SourceOptions { stated_rate: self.start.fps, ..Default::default() };
        let options = crate::source::SourceOptions {
            stated_rate: options.stated_rate.filter(|_| path.is_dir() && !path.join("times.csv").is_file()),
            ..options
        };
        let reel = Reel::open(path, options)?;
        if reels.len() >= MOST_REELS {
            reels.remove(0);
        }
        reels.push(Arc::clone(&reel));
        Ok(reel)
    }
}

/// Answers.
pub(super) fn answer(desk: &Desk, name: &str, body: &[u8]) -> Result<Reply, Refusal> {
    match name {
        "state" => Ok(Reply::Json(state(desk))),
        "list" => list(desk, &read(body)?),
        "reel" => reel(desk, &read(body)?),
        "frame" => frame(desk, &read(body)?),
        "teach/rig" => teach::rig(desk, &read(body)?),
        "teach/prepare" => teach::prepare(desk, &read(body)?),
        "teach/click" => teach::click(desk, &read(body)?),
        "teach/preview" => teach::preview(desk, &read(body)?),
        "teach/save" => teach::save(desk, &read(body)?),
        "run" => review::run(desk, &read(body)?),
        "run/frame" => review::frame(desk, &read(body)?),
        "run/veto" => veto::veto(desk, &read(body)?),
        "watch" => watch::rows(desk, &read(body)?),
        "watch/picture" => watch::picture(desk, &read(body)?),
        _ => Err(Refusal { status: 404, words: "there is nothing here".to_owned() }),
    }
}

fn read<T: DeserializeOwned>(body: &[u8]) -> Result<T, Refusal> {
    serde_json::from_slice(body)
        .map_err(|error| Refusal::wrong(format!("what the page sent is not understood: {error}")))
}

fn state(desk: &Desk) -> Value {
    let shown = |path: &Option<std::path::PathBuf>| path.as_ref().map(|path| desk.places.shown(path));
    json!({
        "version": env!("CARGO_PKG_VERSION"),
        "root": desk.places.root(),
        "live": desk.watch.as_ref().map(Watch::about),
        "recording": shown(&desk.start.recording),
        "rig": shown(&desk.start.rig),
        "run": shown(&desk.start.run),
    })
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct List {
    folder: String,
}

fn list(desk: &Desk, asked: &List) -> Result<Reply, Refusal> {
    desk.verbs()?;
    let folder = desk.places.existing(&asked.folder)?;
    Ok(Reply::Json(json!({ "folder": desk.places.shown(&folder), "entries": desk.places.list(&asked.folder)? })))
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ReelAsked {
    recording: String,
    /// How many times the page has already.
    known: usize,
}

fn reel(desk: &Desk, asked: &ReelAsked) -> Result<Reply, Refusal> {
    let reel = desk.reel(&asked.recording)?;
    let indexed = reel.indexed();
    let first_ns = indexed.stamps_ns.first().copied().unwrap_or_default();
    let us: Vec<i64> = indexed.stamps_ns.iter().skip(asked.known).map(|ns| (ns - first_ns) / 1000).collect();
    Ok(Reply::Json(json!({
        "size": reel.size_px(),
        "first_s": first_ns as f64 * 1e-9,
        "times_us": us,
        "done": indexed.done,
        "hint": reel.hint(),
        "error": indexed.error,
    })))
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct FrameAsked {
    recording: String,
    frame: usize,
    width: Option<u32>,
}

fn frame(desk: &Desk, asked: &FrameAsked) -> Result<Reply, Refusal> {
    let (frame, bytes) = desk.reel(&asked.recording)?.jpeg(asked.frame, asked.width)?;
    Ok(Reply::Jpeg { bytes, about: frame.stamp.ns.to_string() })
}
