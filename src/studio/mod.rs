//! The page in the browser: bands are taught by clicking on them, runs looked through, live runs watched.
//!
//! In: a starting folder, what was named on the command line, the verbs of the command line that the page may call.
//! Out: a server that gives one page, which needs no network, and answers what that page asks.
//!
//! - `server`: HTTP on this computer. `guard`: who is let in. `assets`: the page. `places`: which files.
//! - `api`: what the page may ask; all of it is `POST` with JSON and the key of this start.
//! - `desk`: what is open. `reel`: frames of a recording by number. `run`: a run, read back. `searched`: boards in
//!   pictures.
//! - `teach`, `boards`, `review` and `veto`, `watch`: the views of the page. `command`: the same as a command line.
//!
//! What it does not protect from: a program of the same user, who can read the key, and who can do all this without it.

mod api;
mod assets;
mod board_camera;
mod boards;
mod camera;
mod command;
mod desk;
mod guard;
mod places;
mod reel;
mod review;
mod run;
mod scene;
mod searched;
mod server;
mod shown;
mod teach;
mod veto;
mod watch;

pub(crate) use camera::Camera;
pub(crate) use desk::Desk;
pub(crate) use places::Places;
pub(crate) use server::Server;
pub(crate) use watch::Watch;

use crate::calibrate::rig::RigOptions;
use crate::rig::{Draft, Rig};
use std::path::PathBuf;

/// What a verb of the command line came to.
#[derive(Debug, Clone, Default, serde::Serialize)]
pub(crate) struct VerbResult {
    /// Its exit code.
    pub code: u8,
    /// What it printed.
    pub text: String,
    /// What went wrong, if something did.
    pub error: Option<String>,
    /// What it warned of.
    pub warnings: Vec<String>,
}

/// A verb, with the arguments that stand after its name.
pub(crate) type Verb = Box<dyn Fn(&[String]) -> VerbResult + Send + Sync>;
/// The rig that a verb would begin with, or what is wrong with its arguments.
pub(crate) type RigOf = Box<dyn Fn(&[String]) -> Result<Rig, String> + Send + Sync>;

/// The rig file that a verb would begin with and its options, or what is wrong with its arguments.
pub(crate) type DraftOf = Box<dyn Fn(&[String]) -> Result<(Draft, RigOptions), String> + Send + Sync>;

/// The verbs of the command line that the page calls: the same code, in this process.
pub(crate) struct Verbs {
    /// `catoptra calibrate markers`.
    pub teach: Verb,
    /// The rig with the bands of the same arguments, before anything is learned.
    pub rig_to_teach: RigOf,
    /// `catoptra calibrate rig`.
    pub calibrate_rig: Verb,
    /// What it would begin with: the rig file, and its options.
    pub rig_to_calibrate: DraftOf,
}

/// What was named on the command line.
#[derive(Debug, Clone, Default)]
pub(crate) struct Start {
    /// A recording to teach from.
    pub recording: Option<PathBuf>,
    /// A rig file.
    pub rig: Option<PathBuf>,
    /// The folder of a run to look through.
    pub run: Option<PathBuf>,
    /// Frames per second of a folder of pictures without times.
    pub fps: Option<crate::source::FrameRate>,
}

/// An answer.
enum Reply {
    Json(serde_json::Value),
    /// A picture, and what it is of.
    Jpeg {
        bytes: Vec<u8>,
        about: String,
    },
    Nothing,
}

/// Why the page does not get what it asked for.
#[derive(Debug)]
struct Refusal {
    status: u16,
    words: String,
}

impl Refusal {
    /// What was asked for is wrong, or cannot be had.
    fn wrong(words: impl ToString) -> Self {
        Self { status: 400, words: words.to_string() }
    }

    /// The page works with what is there no more.
    fn tracked_again() -> Self {
        Self { status: 409, words: "the run was tracked again since the page read it: open it once more".to_owned() }
    }

    /// It is not for the page.
    fn forbidden(words: impl ToString) -> Self {
        Self { status: 403, words: words.to_string() }
    }
}
