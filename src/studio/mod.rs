//! The page in the browser: bands are taught by clicking on them, runs looked through, live runs watched.
//!
//! In: a starting folder, what was named on the command line, the verbs of the command line that the page may call. Out:
//! a server that gives one page, which needs no network, and answers what that page asks.
//!
//! - `server`: HTTP on this computer. `guard`: who is let in. `assets`: the page. `places`: which files.
//! - `api`: what the page may ask; all of it is `POST` with JSON and the key of this start.
//! - `reel`: frames of a recording by number. `teach`, `review`, `watch`: the views of the page.
//!
//! What it does not protect from: a program of the same user, who can read the key, and who can do all this without it.

mod api;
mod assets;
mod guard;
mod places;
mod reel;
mod review;
mod run;
mod scene;
mod server;
mod shown;
mod teach;
mod veto;
mod watch;

pub(crate) use api::Desk;
pub(crate) use places::Places;
pub(crate) use server::Server;
pub(crate) use watch::Watch;

use crate::rig::Rig;
use std::path::PathBuf;

/// What a verb of the command line came to.
#[derive(Debug, Clone, Default, serde::Serialize)]
pub(crate) struct Told {
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
pub(crate) type Verb = Box<dyn Fn(&[String]) -> Told + Send + Sync>;
/// The rig that a verb would begin with, or what is wrong with its arguments.
pub(crate) type RigOf = Box<dyn Fn(&[String]) -> Result<Rig, String> + Send + Sync>;

/// The verbs of the command line that the page calls: the same code, in this process.
pub(crate) struct Verbs {
    /// `catoptra calibrate markers`.
    pub teach: Verb,
    /// The rig with the bands of the same arguments, before anything is learned.
    pub rig_to_teach: RigOf,
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

    /// It is not for the page.
    fn forbidden(words: impl ToString) -> Self {
        Self { status: 403, words: words.to_string() }
    }
}
