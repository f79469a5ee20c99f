//! `catoptra studio`: the page in the browser.

use super::camera::{self, SourceArgs};
use super::units::seconds;
use super::warned::{Warnings, Work};
use super::{Exit, Failure, calibrate, fitting, interrupt, output, progress};
use crate::plural::plural;
use crate::rig::Draft;
use crate::source::host::HostClock;
use crate::studio::{Camera, Desk, Places, Server, Start, VerbResult, Verbs, Watch};
use parking_lot::Mutex;
use std::io::Write as _;
use std::net::{SocketAddr, ToSocketAddrs as _};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::str::FromStr;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// How often it is looked whether to end.
const POLL_INTERVAL: Duration = Duration::from_millis(50);

/// Arguments of `catoptra studio`.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// A recording or a folder of pictures to teach from, the folder of a run to look through, or a camera or stream to
    /// take pictures of a board with, as /dev/video0 (those of `catoptra live`)
    #[arg(value_name = "RECORDING|RUN|SOURCE")]
    source: Option<PathBuf>,
    /// The rig file, with its views; with its camera alone, to calibrate them
    #[arg(long, value_name = "RIG.toml")]
    rig: Option<PathBuf>,
    /// Where the page is served; other computers can see it only if a host is named
    #[arg(long, value_name = "HOST:PORT", default_value = "127.0.0.1:0")]
    listen: Listen,
    /// Do not open the page in the browser
    #[arg(long)]
    no_open: bool,
    #[command(flatten)]
    from: SourceArgs,
    /// Stop after this time, as 90s or 10min; without a unit it is seconds
    #[arg(long, value_name = "T", value_parser = seconds, allow_negative_numbers = true)]
    duration: Option<Duration>,
}

impl Args {
    /// The name of the camera or stream, if it is one that was named.
    fn live_source(&self) -> Option<&str> {
        let name = self.source.as_deref().and_then(Path::to_str)?;
        (self.from.realtime || self.from.raw.is_some() || camera::is_live(name)).then_some(name)
    }

    /// Opens the camera. Its pictures must be of the size that the rig's camera was calibrated for.
    fn camera(&self, name: &str, stop: &Arc<AtomicBool>) -> Result<Camera, Failure> {
        let rig = self.rig.as_deref();
        let rig = rig.ok_or_else(|| {
            Failure::usage(format!("{name}: name the rig file with --rig: it says how large pictures are"))
        })?;
        let size_px = Draft::load(rig)?.camera.size_px;
        let source = self.from.open(name, size_px, HostClock::start(), stop)?;
        fitting::check_size(name, source.size_px(), (rig, size_px))?;
        Camera::start(name, source, stop).map_err(|e| Failure::new(Exit::Failed, format!("cannot start a thread: {e}")))
    }
}

/// Where to listen, and the name that was given for it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Listen {
    address: SocketAddr,
    name: Option<String>,
}

impl FromStr for Listen {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if let Ok(port) = text.trim_start_matches(':').parse::<u16>() {
            return Ok(Self { address: SocketAddr::from(([127, 0, 0, 1], port)), name: None });
        }
        if let Ok(address) = text.parse() {
            return Ok(Self { address, name: None });
        }
        let found = text.to_socket_addrs().map_err(|e| format!("{e}; write HOST:PORT, such as 127.0.0.1:8080"))?;
        let address = found.into_iter().next().ok_or_else(|| "no such host".to_owned())?;
        let name = text.rsplit_once(':').map(|(name, _)| name.to_owned());
        Ok(Self { address, name })
    }
}

pub(crate) fn run(args: &Args) -> Result<(), Failure> {
    let stop = interrupt::watch()?;
    let live = args.live_source();
    for path in args.source.iter().filter(|_| live.is_none()).chain(&args.rig) {
        std::fs::metadata(path).map_err(|e| Failure::usage(format!("{}: cannot be read: {e}", path.display())))?;
    }
    let whole = |path: &Option<PathBuf>| path.as_ref().and_then(|path| path.canonicalize().ok());
    let (source, rig) = (whole(&args.source).filter(|_| live.is_none()), whole(&args.rig));
    let is_run = source.as_deref().is_some_and(|path| path.join("run.toml").is_file());
    let given: Vec<PathBuf> = source.iter().chain(&rig).cloned().collect();
    let places = Places::below(Path::new("."), &given)
        .map_err(|e| Failure::new(Exit::Failed, format!("the folder that this was started in cannot be read: {e}")))?;
    let (recording, run) = if is_run { (None, source) } else { (source, None) };
    let start = Start { recording, rig, run, fps: args.from.fps };
    let verbs = Verbs {
        teach: Box::new(|arguments| run_verb(|print| calibrate::teach(arguments, print))),
        rig_to_teach: Box::new(|arguments| calibrate::rig_to_teach(arguments).map_err(|e| e.message())),
        calibrate_rig: Box::new(|arguments| run_verb(|print| calibrate::rig(arguments, print))),
        rig_to_calibrate: Box::new(|arguments| calibrate::rig_to_calibrate(arguments).map_err(|e| e.message())),
    };
    let mut desk = Desk::new(places, start, verbs);
    if let Some(name) = live {
        desk = desk.with_camera(args.camera(name, &stop)?);
    }
    let server = serve(&args.listen, desk)?;
    output::print(&format!("{}\n", server.url()))?;
    if !args.no_open {
        open(server.url());
    }
    let began = Instant::now();
    while !stop.load(Ordering::Relaxed) && args.duration.is_none_or(|duration| began.elapsed() < duration) {
        std::thread::sleep(POLL_INTERVAL);
    }
    Ok(())
}

/// Serves a live run, and says where.
pub(super) fn show_live(listen: &Listen, watch: Watch) -> Result<Server, Failure> {
    let places = Places::below(Path::new("."), &[])
        .map_err(|e| Failure::new(Exit::Failed, format!("the folder that this was started in cannot be read: {e}")))?;
    let server = serve(listen, Desk::live(places, watch))?;
    // Without stderr the run goes on all the same.
    let _ = writeln!(progress::stderr(), "watch it at {}", server.url());
    Ok(server)
}

fn serve(listen: &Listen, desk: Desk) -> Result<Server, Failure> {
    Server::start(listen.address, listen.name.as_deref(), desk).map_err(|e| {
        Failure::new(Exit::Failed, format!("{}: cannot be listened at: {e}; choose another port", listen.address))
    })
}

/// Runs a verb as if it had been typed; what it prints is told.
fn run_verb(verb: impl FnOnce(&dyn Fn(&str) -> Result<(), Failure>) -> Result<(), Failure>) -> VerbResult {
    // The command writes its files as one process: two pages wait for each other.
    static ALONE: Mutex<()> = Mutex::new(());
    let _alone = ALONE.lock();
    let text = Mutex::new(String::new());
    let print = |part: &str| {
        text.lock().push_str(part);
        Ok(())
    };
    let work = Work::new();
    let ended = work.within(|| verb(&print));
    let Warnings { mut warnings, more } = work.warned();
    if more > 0 {
        warnings.push(format!("and {}", plural(more, "more warning")));
    }
    VerbResult {
        code: ended.as_ref().map_or_else(|failure| failure.exit().code(), |()| 0),
        text: text.into_inner(),
        error: ended.err().map(|failure| failure.message()),
        warnings,
    }
}

/// Opens the page as the desktop does. Where there is no desktop, the address that was printed is all.
fn open(url: &str) {
    let opener = if cfg!(target_os = "macos") { "open" } else { "xdg-open" };
    let opened = Command::new(opener).arg(url).stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null()).spawn();
    match opened {
        // Waited for, so that it does not stay behind as a zombie; it ends at once.
        Ok(mut child) => drop(std::thread::spawn(move || child.wait())),
        Err(error) => tracing::warn!("the browser could not be opened ({opener}: {error}): open the address above"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn this_computer_alone_is_served_unless_a_host_is_named() {
        let at = |text: &str| text.parse::<Listen>().map(|listen| (listen.address.to_string(), listen.name));
        assert_eq!(at("8080").unwrap(), ("127.0.0.1:8080".to_owned(), None));
        assert_eq!(at(":0").unwrap(), ("127.0.0.1:0".to_owned(), None));
        assert_eq!(at("0.0.0.0:90").unwrap().0, "0.0.0.0:90");
        assert_eq!(at("localhost:90").unwrap().1.as_deref(), Some("localhost"));
        assert!(at("nonsense").unwrap_err().contains("127.0.0.1:8080"));
    }
}
