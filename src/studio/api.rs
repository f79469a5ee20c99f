//! What the page may ask: a name and JSON in, JSON or a picture out.

use super::desk::Desk;
use super::{Refusal, Reply, board_camera, boards, review, teach, veto};
use crate::source::times::seconds;
use serde::Deserialize;
use serde::de::DeserializeOwned;
use serde_json::{Value, json};

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
        "board/pictures" => boards::pictures(desk, &read(body)?),
        "board/keep" => boards::keep(desk, &read(body)?),
        "board/show" => boards::show(desk, &read(body)?),
        "board/find" => boards::find(desk, &read(body)?),
        "board/judge" => boards::judge(desk, &read(body)?),
        "board/save" => boards::save(desk, &read(body)?),
        "camera/look" => desk.camera()?.look(&read(body)?),
        "camera/judge" => board_camera::judge(desk, &read(body)?),
        "camera/take" => board_camera::take(desk, &read(body)?),
        "watch" => Ok(desk.watch()?.rows(&read(body)?)),
        "watch/record" => desk.watch()?.record(&read(body)?),
        "watch/picture" => desk.watch()?.picture(&read(body)?),
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
        "live": desk.watch.as_ref().map(super::Watch::about),
        "camera": desk.camera.as_ref().map(super::Camera::about),
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
    let us: Vec<i64> =
        indexed.stamps_ns.iter().skip(asked.known).map(|ns| ns.saturating_sub(first_ns) / 1000).collect();
    Ok(Reply::Json(json!({
        "size": reel.size_px(),
        "first_s": seconds(first_ns),
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
