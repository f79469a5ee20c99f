//! `catoptra studio`: the page in the browser.

use super::warned::Work;
use super::{Exit, Failure, calibrate, interrupt, output, progress};
use crate::source::FrameRate;
use crate::source::times::parse_seconds_ns;
use crate::studio::{Desk, Places, Server, Start, Told, Verbs, Watch};
use std::io::Write as _;
use std::net::{SocketAddr, ToSocketAddrs as _};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::str::FromStr;
use std::sync::Mutex;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

/// How often it is looked whether to end.
const LOOK: Duration = Duration::from_millis(50);

/// Arguments of `catoptra studio`.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// A recording or a folder of pictures to teach from, or the folder of a run to look through
    #[arg(value_name = "RECORDING|RUN")]
    source: Option<PathBuf>,
    /// The rig file, with its views
    #[arg(long, value_name = "RIG.toml")]
    rig: Option<PathBuf>,
    /// Where the page is served; other computers can see it only where a host is named
    #[arg(long, value_name = "HOST:PORT", default_value = "127.0.0.1:0")]
    listen: Listen,
    /// Do not open the page in the browser
    #[arg(long)]
    no_open: bool,
    /// Frames per second of a folder of pictures without times.csv
    #[arg(long, value_name = "F", allow_hyphen_values = true)]
    fps: Option<FrameRate>,
    /// Stop after T seconds
    #[arg(long, value_name = "T", value_parser = duration)]
    duration: Option<Duration>,
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

fn duration(text: &str) -> Result<Duration, String> {
    let ns = parse_seconds_ns(text).and_then(|ns| u64::try_from(ns).ok()).filter(|ns| *ns > 0);
    ns.map(Duration::from_nanos).ok_or_else(|| "expected seconds above 0, such as 600".to_owned())
}

pub(crate) fn run(args: &Args) -> Result<(), Failure> {
    let stop = interrupt::watch()?;
    let usage = |text: String| Failure::new(Exit::Usage, text);
    for path in args.source.iter().chain(&args.rig) {
        std::fs::metadata(path).map_err(|e| usage(format!("{}: cannot be read: {e}", path.display())))?;
    }
    let whole = |path: &Option<PathBuf>| path.as_ref().and_then(|path| path.canonicalize().ok());
    let (source, rig) = (whole(&args.source), whole(&args.rig));
    let is_run = source.as_deref().is_some_and(|path| path.join("run.toml").is_file());
    let given: Vec<PathBuf> = source.iter().chain(&rig).cloned().collect();
    let places = Places::below(Path::new("."), &given)
        .map_err(|e| Failure::new(Exit::Failed, format!("the folder that this was started in cannot be read: {e}")))?;
    let (recording, run) = if is_run { (None, source) } else { (source, None) };
    let start = Start { recording, rig, run, fps: args.fps };
    let verbs = Verbs {
        teach: Box::new(|arguments| told(|print| calibrate::teach(arguments, print))),
        rig_to_teach: Box::new(|arguments| calibrate::rig_to_teach(arguments).map_err(|e| e.message())),
        calibrate_rig: Box::new(|arguments| told(|print| calibrate::rig(arguments, print))),
        rig_to_calibrate: Box::new(|arguments| calibrate::rig_to_calibrate(arguments).map_err(|e| e.message())),
    };
    let server = serve(&args.listen, Desk::new(places, start, verbs))?;
    output::print(&format!("{}\n", server.url()))?;
    if !args.no_open {
        open(server.url());
    }
    let began = Instant::now();
    while !stop.load(Ordering::Relaxed) && args.duration.is_none_or(|duration| began.elapsed() < duration) {
        std::thread::sleep(LOOK);
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
fn told(verb: impl FnOnce(&dyn Fn(&str) -> Result<(), Failure>) -> Result<(), Failure>) -> Told {
    // The command writes its files as one process: two pages wait for each other.
    static ALONE: Mutex<()> = Mutex::new(());
    let _alone = ALONE.lock();
    let text = Mutex::new(String::new());
    let print = |part: &str| {
        if let Ok(mut text) = text.lock() {
            text.push_str(part);
        }
        Ok(())
    };
    let work = Work::new();
    let ended = work.within(|| verb(&print));
    let code = match ended.as_ref().map_err(Failure::exit) {
        Ok(()) => 0,
        Err(Exit::Failed) => 1,
        Err(Exit::Usage) => 2,
        Err(Exit::Unusable) => 3,
        Err(Exit::Interrupted) => 130,
    };
    Told {
        code,
        text: text.into_inner().unwrap_or_default(),
        error: ended.err().map(|failure| failure.message()),
        warnings: work.warned().warnings,
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
