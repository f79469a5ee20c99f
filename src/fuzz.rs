//! Everything that reads untrusted bytes: one function for each kind of input, which must end soon and never panic,
//! whatever the bytes. `fuzz/` gives them to a fuzzer; `tests/it/mutations.rs` gives them seeded mutations of sound
//! files.

use crate::calibrate::board::grey::{Grey, Rows};
use crate::calibrate::board::{Board, find_boards};
use crate::identify::data::plant::Plant;
use crate::identify::results::saved::Saved;
use crate::log::{Info, repair};
use crate::rig::Rig;
use crate::rig::check::check;
use crate::rig::formats::Format;
use crate::series::{CurrentTable, Recording, columns};
use crate::source::host::HostClock;
use crate::source::live::{RawFormat, RawPictures};
use crate::source::{FrameSource, ImageFolder, ImageTiming, LogWindows, Span, VideoFile, VideoOptions};
use crate::track::{TrackOptions, Tracker};
use std::io;
use std::path::{Path, PathBuf};

/// A kind of input.
#[derive(Clone, Copy)]
pub struct Target {
    /// Its name, which is also its fuzz target's.
    pub name: &'static str,
    /// Reads it; files that it needs go into the folder.
    pub read: fn(&[u8], &Path),
}

/// All kinds.
pub const TARGETS: [Target; 14] = [
    Target { name: "rig", read: rig },
    Target { name: "rig_import", read: rig_import },
    Target { name: "series", read: series },
    Target { name: "plant", read: plant },
    Target { name: "model", read: model },
    Target { name: "currents", read: currents },
    Target { name: "log", read: log },
    Target { name: "log_windows", read: log_windows },
    Target { name: "board_text", read: board_text },
    Target { name: "board_picture", read: board_picture },
    Target { name: "container", read: container },
    Target { name: "raw_pipe", read: raw_pipe },
    Target { name: "picture", read: picture },
    Target { name: "codec", read: codec },
];

/// Most frames read from a recording.
const FRAMES: usize = 8;

/// Puts the bytes into a file.
fn file(bytes: &[u8], folder: &Path, name: &str) -> Option<PathBuf> {
    let path = folder.join(name);
    std::fs::write(&path, bytes).ok()?;
    Some(path)
}

fn take(source: &mut dyn FrameSource) {
    for _ in 0..FRAMES {
        if !matches!(source.next_frame(), Ok(Some(_))) {
            return;
        }
    }
}

fn rig(bytes: &[u8], _: &Path) {
    let Ok(rig) = Rig::from_toml_str(&String::from_utf8_lossy(bytes), Path::new("rig.toml")) else { return };
    let _ = check(&rig.clone().into());
    let _ = Tracker::new(&rig, TrackOptions::default());
    let _ = rig.to_toml_string();
}

fn rig_import(bytes: &[u8], _: &Path) {
    let (text, name) = (String::from_utf8_lossy(bytes), Path::new("camera.yaml"));
    let _ = Format::guess(&text, name);
    for format in [Format::OpenCv, Format::Ros, Format::Kalibr] {
        let _ = format.read(&text, name);
    }
}

fn series(bytes: &[u8], folder: &Path) {
    let Some(path) = file(bytes, folder, "table.csv") else { return };
    if let Ok(recording) = Recording::read(&path) {
        let _ = recording.clocks();
    }
    let _ = CurrentTable::read(&path);
    let _ = columns(&path, &["1", "theta_deg"]);
}

fn plant(bytes: &[u8], folder: &Path) {
    if let Some(path) = file(bytes, folder, "plant.toml") {
        let _ = Plant::load(&path);
    }
}

fn model(bytes: &[u8], _: &Path) {
    let Ok(saved) = Saved::parse(&String::from_utf8_lossy(bytes), "model") else { return };
    for model in &saved.models {
        let _ = model.at(0.01);
        let _ = model.response(1.0);
    }
}

fn currents(bytes: &[u8], _: &Path) {
    crate::live::currents_of(bytes);
}

fn log(bytes: &[u8], folder: &Path) {
    let Some(path) = file(bytes, folder, "log.mcap") else { return };
    let _ = Info::read(&path);
    let _ = Recording::read(&path);
    let _ = crate::log::attached(&path, crate::log::schema::RIG_ATTACHMENT);
    let _ = repair(&path);
    let _ = std::fs::remove_file(folder.join("log.mcap.bak"));
}

fn log_windows(bytes: &[u8], folder: &Path) {
    let Some(path) = file(bytes, folder, "windows.mcap") else { return };
    if let Ok(mut source) = LogWindows::open(&path, Span::default()) {
        take(&mut source);
    }
}

fn board_text(bytes: &[u8], _: &Path) {
    let text = String::from_utf8_lossy(bytes);
    let _ = text.parse::<Board>();
    let _ = text.parse::<RawFormat>();
    let _ = text.parse::<crate::live::CurrentSource>();
    let _ = text.parse::<crate::source::FrameRate>();
}

fn board_picture(bytes: &[u8], folder: &Path) {
    let Some(path) = file(bytes, folder, "board.png") else { return };
    let Ok(grey) = Grey::load(&path, Rows::AsShown) else { return };
    for board in ["9x6:12mm", "charuco:5x7:12mm:9mm:4X4_50"] {
        if let Ok(board) = board.parse::<Board>() {
            let _ = find_boards(&grey, &board, 1);
        }
    }
}

fn container(bytes: &[u8], folder: &Path) {
    let Some(path) = file(bytes, folder, "video.mkv") else { return };
    crate::source::extent_of(bytes);
    if let Ok(mut source) = VideoFile::open(&path, VideoOptions { keep_damaged: true, ..VideoOptions::default() }) {
        take(&mut source);
    }
}

fn raw_pipe(bytes: &[u8], _: &Path) {
    for format in ["16x12:yuv420p@60", "17x5:bayer_rg8@30", "8x8:uyvy422@1000000"] {
        let Ok(format) = format.parse::<RawFormat>() else { continue };
        let pipe = Box::new(io::Cursor::new(bytes.to_vec()));
        take(&mut RawPictures::new("pipe", pipe, format, HostClock::start()));
    }
}

fn picture(bytes: &[u8], folder: &Path) {
    let Some(path) = file(bytes, folder, "frame0.png") else { return };
    let _ = Grey::load(&path, Rows::AsStored);
    let Ok(rate) = "60".parse() else { return };
    if let Ok(mut source) = ImageFolder::open(folder, ImageTiming::StatedRate(rate), Span::default()) {
        take(&mut source);
    }
}

fn codec(bytes: &[u8], _: &Path) {
    crate::source::checked_packet(bytes);
}
