//! Pictures of a board, as they arrive: corners found in each, and how far off in space a rig would be that is
//! calibrated with those so far.

use super::command::{Setting, arguments, typed};
use super::desk::Desk;
use super::{Refusal, Reply, shown};
use crate::atomic_file;
use crate::calibrate::board::Board;
use crate::calibrate::rig::expected_error::{Expected, Suggestion, Verdict, verdict};
use crate::calibrate::rig::initial::BoardsPicture;
use crate::calibrate::rig::{RigOptions, calibrate_rig};
use crate::rig::Draft;
use crate::source::{PICTURE_ENDINGS, is_picture_name};
use base64::prelude::{BASE64_STANDARD, Engine as _};
use serde::Deserialize;
use serde_json::{Value, json};
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

/// Pictures that are taken at most.
const MAX_PICTURES: usize = 200;
/// Suggestions that are shown for each frame.
const SUGGESTIONS: usize = 2;

fn board_of(text: &str) -> Result<Board, Refusal> {
    text.parse().map_err(Refusal::wrong)
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct FindAsked {
    picture: String,
    board: String,
    mirrors: usize,
}

/// The board in one picture.
pub(super) fn find(desk: &Desk, asked: &FindAsked) -> Result<Reply, Refusal> {
    desk.verbs()?;
    let path = desk.places.existing(&asked.picture)?;
    let found = desk.boards.search(&path, &board_of(&asked.board)?, asked.mirrors.min(8) + 1)?;
    let images = found.images.as_ref().map(|images| {
        images
            .iter()
            .map(|image| {
                json!({
                    "corners": image.corners.iter().map(|(_, at)| [at.x, at.y]).collect::<Vec<_>>(),
                    "square_px": image.square_px,
                    "blurred": image.is_blurred(),
                })
            })
            .collect::<Vec<_>>()
    });
    Ok(Reply::Json(json!({ "size": found.size_px, "images": images.as_ref().ok(), "error": images.as_ref().err() })))
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ShowAsked {
    picture: String,
}

/// One picture.
pub(super) fn show(desk: &Desk, asked: &ShowAsked) -> Result<Reply, Refusal> {
    desk.verbs()?;
    let path = desk.places.existing(&asked.picture)?;
    let unread = |error: &dyn std::fmt::Display| Refusal::wrong(format!("{}: cannot be read: {error}", asked.picture));
    let reader =
        image::ImageReader::open(&path).and_then(image::ImageReader::with_guessed_format).map_err(|e| unread(&e))?;
    let bytes = shown::jpeg_of(&reader.decode().map_err(|e| unread(&e))?.into_rgb8())?;
    Ok(Reply::Jpeg { bytes, about: String::new() })
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct FolderAsked {
    folder: String,
}

/// The pictures in a folder, by name.
pub(super) fn pictures(desk: &Desk, asked: &FolderAsked) -> Result<Reply, Refusal> {
    desk.verbs()?;
    let folder = desk.places.existing(&asked.folder)?;
    let unread = |error: std::io::Error| Refusal::wrong(format!("{}: cannot be read: {error}", asked.folder));
    let mut found = Vec::new();
    for entry in std::fs::read_dir(&folder).map_err(unread)? {
        let path = entry.map_err(unread)?.path();
        if path.is_file() && is_picture_name(&path) {
            found.push(desk.places.shown(&path));
        }
    }
    found.sort();
    let all = found.len();
    found.truncate(MAX_PICTURES);
    Ok(Reply::Json(json!({ "folder": desk.places.shown(&folder), "pictures": found, "all": all })))
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Dropped {
    folder: String,
    name: String,
    /// The file, in base64.
    base64: String,
}

/// Keeps a picture that was dropped into the page.
pub(super) fn keep(desk: &Desk, asked: &Dropped) -> Result<Reply, Refusal> {
    desk.verbs()?;
    let name = Path::new(&asked.name);
    if name.file_name() != Some(name.as_os_str()) || !is_picture_name(name) {
        let endings = PICTURE_ENDINGS.join(", ");
        return Err(Refusal::wrong(format!("{}: expected the name of a picture ({endings})", asked.name)));
    }
    let bytes =
        BASE64_STANDARD.decode(&asked.base64).map_err(|error| Refusal::wrong(format!("{}: {error}", asked.name)))?;
    if image::guess_format(&bytes).is_err() {
        return Err(Refusal::wrong(format!("{}: is not a picture", asked.name)));
    }
    let folder = folder(desk, &asked.folder)?;
    let path = desk.places.to_write(&folder.join(name).to_string_lossy())?;
    match std::fs::read(&path) {
        Ok(there) if there == bytes => {}
        Ok(_) => {
            return Err(Refusal::wrong(format!(
                "{}: is there, and another picture; rename one",
                desk.places.shown(&path)
            )));
        }
        Err(error) if error.kind() == ErrorKind::NotFound => {
            atomic_file::write(&path, &bytes).map_err(|error| unwritten(&path, &error))?;
        }
        Err(error) => return Err(unwritten(&path, &error)),
    }
    Ok(Reply::Json(json!({ "picture": desk.places.shown(&path) })))
}

/// A folder for pictures, made where it is not there.
pub(super) fn folder(desk: &Desk, text: &str) -> Result<PathBuf, Refusal> {
    let folder = desk.places.to_write(text)?;
    if !folder.exists() {
        std::fs::create_dir(&folder).map_err(|error| unwritten(&folder, &error))?;
    }
    Ok(folder)
}

pub(super) fn unwritten(path: &Path, error: &std::io::Error) -> Refusal {
    Refusal { status: 500, words: format!("{}: cannot be written: {error}", path.display()) }
}

/// What the page's form says.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Form {
    pictures: Vec<String>,
    board: String,
    rig: String,
    mirrors: usize,
    glass_mm: Option<f64>,
    /// `WxDxHmm`.
    tank: Option<String>,
    mirrors_inside: bool,
    temperature: Option<f64>,
    /// Measured distances, `NAME=DISTANCE:σ`, with spaces or commas between them.
    #[serde(default)]
    distances: String,
}

impl Form {
    /// The options of the command, and the pictures with their whole paths.
    fn settings(&self, desk: &Desk) -> Result<(Vec<Setting>, Vec<PathBuf>), Refusal> {
        if self.pictures.len() > MAX_PICTURES {
            return Err(Refusal::wrong(format!("{} pictures: expected at most {MAX_PICTURES}", self.pictures.len())));
        }
        let paths = self.pictures.iter().map(|picture| desk.places.existing(picture)).collect::<Result<_, _>>()?;
        let mut settings =
            vec![("--rig", desk.places.shown(&desk.places.existing(&self.rig)?)), ("--board", self.board.clone())];
        if self.mirrors != 1 {
            settings.push(("--mirrors", self.mirrors.to_string()));
        }
        settings.extend(self.glass_mm.map(|mm| ("--glass", format!("{mm}mm"))));
        settings.extend(self.tank.clone().map(|tank| ("--tank", tank)));
        settings.extend(self.temperature.map(|t| ("--temperature", t.to_string())));
        let distances = self.distances.split([' ', ',']).filter(|distance| !distance.is_empty());
        settings.extend(distances.map(|distance| ("--distance", distance.to_owned())));
        if self.mirrors_inside {
            settings.push(("--mirrors-inside", String::new()));
        }
        Ok((settings, paths))
    }
}

/// How good a rig would be that is calibrated from these pictures.
pub(super) fn judge(desk: &Desk, form: &Form) -> Result<Reply, Refusal> {
    let bench = CalibrationInput::of(desk, form)?;
    Ok(Reply::Json(match bench.verdict(&bench.found) {
        Ok(judged) => json!({ "pictures": bench.found.len(), "verdict": judged.as_ref().map(in_numbers) }),
        Err(error) => json!({ "pictures": bench.found.len(), "error": error }),
    }))
}

/// What a rig is calibrated from: the page's form, read, and the boards in its pictures.
pub(super) struct CalibrationInput {
    pub(super) board: Board,
    /// Images of the board that a picture has at most.
    pub(super) most: usize,
    pub(super) found: Vec<BoardsPicture>,
    draft: Draft,
    options: RigOptions,
}

impl CalibrationInput {
    pub(super) fn of(desk: &Desk, form: &Form) -> Result<Self, Refusal> {
        let (settings, paths) = form.settings(desk)?;
        let mut named: Vec<&str> = form.pictures.iter().map(String::as_str).collect();
        if named.is_empty() {
            // The command wants one; it is not read here.
            named.push(".");
        }
        let arguments = arguments(&desk.places, &named, &settings);
        let (draft, options) = (desk.verbs()?.rig_to_calibrate)(&arguments).map_err(Refusal::wrong)?;
        let (board, most) = (board_of(&form.board)?, form.mirrors.min(8) + 1);
        let mut found = Vec::new();
        for path in &paths {
            let searched = desk.boards.search(path, &board, most)?;
            if searched.size_px != draft.camera.size_px {
                let [[w, h], [we, he]] = [searched.size_px, draft.camera.size_px];
                let name = desk.places.shown(path);
                return Err(Refusal::wrong(format!(
                    "{name} has {w}x{h} pixels, but {} was calibrated for {we}x{he}",
                    form.rig
                )));
            }
            if let Ok(images) = &searched.images {
                let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
                found.push(BoardsPicture { name, size_px: searched.size_px, images: images.clone() });
            }
        }
        Ok(Self { board, most, found, draft, options })
    }

    /// How good a rig would be that is calibrated from these pictures, or why it cannot be.
    pub(super) fn verdict(&self, pictures: &[BoardsPicture]) -> Result<Option<Verdict>, String> {
        let done = calibrate_rig(&self.board, &self.draft.camera.lens, pictures, &self.options);
        let done = done.map_err(|error| error.to_string())?;
        Ok(verdict(&done.solution, &done.corners, &self.board.centred_points()))
    }
}

fn in_numbers(judged: &Verdict) -> Value {
    let mm = |of: fn(&Expected) -> f64| {
        let (median, worst) = judged.median_and_worst(of);
        [median * 1e3, worst * 1e3]
    };
    let best = |all: Vec<&Suggestion>, median_m: fn(&Suggestion) -> f64| -> Vec<Value> {
        let best = all.into_iter().take(SUGGESTIONS);
        best.map(|s| json!({ "what": s.what, "median_mm": median_m(s) * 1e3 })).collect()
    };
    json!({
        "absolute_mm": mm(|e| e.absolute_m),
        "relative_mm": mm(|e| e.relative_m),
        "random_mm": mm(|e| e.random_m),
        "angle_deg": judged.angle_rad.1.to_degrees(),
        "helpful": {
            "base": best(judged.helpful_relative(), |s| s.relative_m),
            "camera": best(judged.helpful_absolute(), |s| s.absolute_m),
        },
    })
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Save {
    form: Form,
    out: String,
    dry: bool,
}

/// Runs `catoptra calibrate rig`.
pub(super) fn save(desk: &Desk, asked: &Save) -> Result<Reply, Refusal> {
    let (mut settings, paths) = asked.form.settings(desk)?;
    let out = desk.places.to_write(&asked.out)?;
    settings.push(("--out", desk.places.shown(&out)));
    let named: Vec<String> = paths.iter().map(|path| desk.places.shown(path)).collect();
    let named: Vec<&str> = named.iter().map(String::as_str).collect();
    let command = typed("calibrate rig", &named, &settings);
    if asked.dry {
        return Ok(Reply::Json(json!({ "command": command })));
    }
    let result = (desk.verbs()?.calibrate_rig)(&arguments(&desk.places, &named, &settings));
    Ok(Reply::Json(json!({ "command": command, "told": result, "out": desk.places.shown(&out) })))
}
