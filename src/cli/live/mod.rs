//! `catoptra live`: a camera, tracked while it runs; θ to controllers and subscribers, everything to the log.

mod recording;
mod ros;
mod simulated;
mod status;

use super::camera::{SourceArgs, positive};
use super::results::{unique_text, whole_path};
use super::run::finished::{self, FinishedRun};
use super::run::folder::{self, Files, Run};
use super::run::{LogFor, Logged, Record, Reference, load_rig, open_sinks, pool, print_warnings, summary, verdict};
use super::studio::{self, Listen};
use super::units::seconds;
use super::warned::Work;
use super::{Exit, Failure, fitting, interrupt, output, provenance};
use crate::archive::{Hashes, Measured, early_end, hash};
use crate::estimate::Spot;
use crate::live::{self, CurrentSource, Currents, LiveSummary, Outputs, Priority, RecordSwitch, Until};
use crate::pipeline::End;
use crate::plural::plural;
use crate::report::RunInfo;
use crate::rig::Rig;
use crate::sink::{PictureCount, PublishSink, Sink, UdpSink};
use crate::source::host::HostClock;
use crate::source::names::without_credentials;
use crate::studio::Watch;
use crate::track::{TrackOptions, Tracker};
use clap::builder::RangedU64ValueParser;
use simulated::Simulated;
use status::StatusLine;
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::io::ErrorKind;
use std::net::{SocketAddr, ToSocketAddrs as _};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// Free space reserved for the log, gigabytes: more than an hour at 60 Hz.
const KEEP_FREE_GB: f64 = 2.0;

/// Arguments of `catoptra live`.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// /dev/video0, genicam:NAME, gst:PIPELINE, rtsp://…, http://…, udp://… or another stream, - for standard input, a
    /// recording with --realtime, sim:MOTION to simulate
    #[arg(value_name = "SOURCE")]
    source: String,
    /// The rig file, with colours and base frame
    #[arg(long, value_name = "RIG.toml")]
    rig: PathBuf,
    /// Folder for the results [default: live-1, live-2, …]
    #[arg(short, long, value_name = "DIR")]
    out: Option<PathBuf>,
    #[command(flatten)]
    from: SourceArgs,
    /// Send θ to a controller, one JSON datagram per frame
    #[arg(long, value_name = "HOST:PORT", value_parser = receiver)]
    udp: Option<SocketAddr>,
    /// Serve the log's topics to Foxglove [default: ws://127.0.0.1:8765]
    #[arg(long, value_name = "ADDRESS", num_args = 0..=1, default_missing_value = "127.0.0.1:8765")]
    #[arg(value_parser = listening)]
    publish: Option<SocketAddr>,
    /// Show the run in the browser [default: 127.0.0.1, a free port]
    #[arg(long, value_name = "ADDRESS", num_args = 0..=1, default_missing_value = "127.0.0.1:0")]
    studio: Option<Listen>,
    /// Web page that may subscribe too, as https://lab.example.org
    #[arg(long, value_name = "ORIGIN", requires = "publish")]
    allow_origin: Vec<String>,
    #[command(flatten)]
    ros: ros::RosArgs,
    /// Currents: udp:PORT, serial:DEV@BAUD, file:CSV, LIST.play, ros2:/TOPIC
    #[arg(long, value_name = "FROM")]
    currents: Option<CurrentSource>,
    /// Watch a lamp that each command switches: x,y,radius
    #[arg(long, value_name = "X,Y,R")]
    tick_led: Option<Spot>,
    /// Largest plausible current, amperes
    #[arg(
        long,
        value_name = "A", value_parser = positive, default_value_t = 10.0,
        requires = "currents", allow_negative_numbers = true,
    )]
    current_limit: f64,
    /// Also record pictures
    #[arg(long, value_enum, value_name = "HOW")]
    record: Option<Record>,
    /// Write the log for foxglove or ros2 (docs/ros2.md)
    #[arg(long, value_enum, value_name = "FOR", default_value_t = LogFor::Foxglove, hide_possible_values = true)]
    profile: LogFor,
    /// Record no pictures when less is free on the disk, GB [default: 2]
    #[arg(
        long,
        value_name = "GB", value_parser = positive,
        requires = "record", hide = true, allow_negative_numbers = true,
    )]
    keep_free: Option<f64>,
    /// Stop after this time, as 90s or 10min; without a unit it is seconds
    #[arg(long, value_name = "T", value_parser = seconds, allow_negative_numbers = true)]
    duration: Option<Duration>,
    /// Frame of table and report: base or camera
    #[arg(long, value_enum, default_value_t = Reference::Base, hide_possible_values = true)]
    frame: Reference,
    /// Threads for the tracker [default: one per core]
    #[arg(long, value_name = "N", value_parser = RangedU64ValueParser::<usize>::new().range(1..=256))]
    threads: Option<usize>,
}

/// Where a receiver listens.
fn receiver(text: &str) -> Result<SocketAddr, String> {
    let found = address(text, "192.168.1.20:5005")?;
    if found.port() == 0 { Err("the port is 0; give the one where the receiver listens".to_owned()) } else { Ok(found) }
}

fn address(text: &str, example: &str) -> Result<SocketAddr, String> {
    let mut found = text.to_socket_addrs().map_err(|e| format!("{e}; write HOST:PORT, such as {example}"))?;
    found.next().ok_or_else(|| "no such host".to_owned())
}

/// `ws://HOST:PORT`, `HOST:PORT`, `:PORT` or `PORT`; only this computer if no host is given.
fn listening(text: &str) -> Result<SocketAddr, String> {
    let place = text.strip_prefix("ws://").unwrap_or(text).trim_end_matches('/');
    let port = place.strip_prefix(':').unwrap_or(place);
    if let Ok(port) = port.parse::<u16>() {
        return Ok(SocketAddr::from(([127, 0, 0, 1], port)));
    }
    address(place, "127.0.0.1:8765")
}

pub(crate) fn run(args: &Args, quiet: bool) -> Result<(), Failure> {
    let until = Until { stop: interrupt::watch()?, duration: args.duration };
    let work = Work::new();
    // 1. everything is checked before anything is written
    let (mut rig, mut rig_toml) = load_rig(&args.rig, args.frame)?;
    let simulated = args.simulated(&rig)?;
    if let Some(simulated) = &simulated {
        rig.clone_from(&simulated.rig);
        rig_toml = rig.to_toml_string();
    }
    let rig = rig;
    fitting::check_spot(args.tick_led, (&args.rig, &rig))?;
    args.record.map_or(Ok(()), |record| record.check(args.source.as_ref()))?;
    let tracker = Tracker::new(&rig, TrackOptions { tick_led: args.tick_led, ..TrackOptions::default() })
        .map_err(|e| Failure::usage(format!("{}: {e}", args.rig.display())))?;
    print_warnings(&args.rig, &rig)?;
    let controllers = args.controllers(&rig)?;
    let (count, counts) = (Arc::new(PictureCount::default()), args.studio.is_some());
    let counted = (args.record.is_some() || counts).then(|| Arc::clone(&count));
    let subscribers = args.ros.open(&rig, counted.clone())?;
    let publisher = args.publish.map(|at| PublishSink::listen(at, &args.allow_origin, &rig)).transpose();
    let mut publisher = publisher.map_err(|e| Failure::new(Exit::Failed, e))?;
    if let Some(count) = counted {
        publisher = publisher.map(|publisher| publisher.with_picture_count(count));
    }
    if let Some(publisher) = &publisher {
        tracing::info!("subscribers find the topics at ws://{}", publisher.address());
    }
    let clock = HostClock::start();
    let receive = |from| work.within(|| args.receive_currents(from, clock, &until.stop));
    let currents = args.currents.as_ref().map(receive).transpose()?;
    if args.source == "-" && !until.await_standard_input() {
        let exit = if until.stop.load(Ordering::Relaxed) { Exit::Interrupted } else { Exit::Unusable };
        return Err(Failure::new(exit, format!("{}: no frame was received", args.name())));
    }
    let source = match simulated {
        Some(simulated) => {
            let rate_hz = args.from.fps.map(|rate| rate.hz());
            simulated.start(&args.source, rate_hz, args.from.exposure.map(|ms| ms * 1e-3), clock, &until.stop)?
        }
        None => args.from.open(&args.source, rig.camera.size_px, clock, &until.stop)?,
    };
    fitting::check_size(&args.name(), source.size_px(), (&args.rig, rig.camera.size_px))?;
    let files = Files::new(&args.folder(), None, false).recording(args.record);
    let latest = args.studio.is_some().then(|| Arc::new(live::Latest::default()));
    let switch = args.studio.is_some().then(|| Arc::new(recording::switch(args.record)));
    let watch = |(latest, switch): (&Arc<live::Latest>, &Arc<RecordSwitch>)| {
        let folder = files.folder.display().to_string();
        Watch::new(Arc::clone(latest), &rig, &args.name(), &folder)
            .recording(Arc::clone(switch), recording::record_words())
    };
    let watched = args.studio.as_ref().zip(latest.as_ref().zip(switch.as_ref()));
    let _studio = watched.map(|(listen, run)| studio::show_live(listen, watch(run))).transpose()?;
    // 2. the files
    let run = args.described();
    let run_toml = run.to_toml()?;
    let _held = files.prepare_new(&run, &[&args.rig])?;
    let ticks = args.tick_led.is_some();
    let logged = Logged { record: args.record, profile: args.profile, counts, ticks, ..Logged::default() };
    let opened = open_sinks(&files, &rig, [&rig_toml, &run_toml], args.frame, args.info(), logged, &count)?;
    let keep_free_bytes = (args.keep_free.unwrap_or(KEEP_FREE_GB) * 1e9) as u64;
    let pictures = recording::of(args.record, opened.video, count, &files.folder, keep_free_bytes, switch);
    // 3. the run
    let publisher = publisher.map(|sink| Box::new(sink) as Box<dyn Sink + Send>);
    let subscribers = subscribers.into_iter().chain(publisher).collect();
    let outputs = Outputs { files: opened.sinks, controllers, subscribers, currents, pictures, latest };
    let mut line = StatusLine::new(&args.name(), &files.folder, quiet);
    let pool = pool(args.threads.unwrap_or(0))?;
    let show = |status: &live::Status| line.show(status);
    let began = Instant::now();
    let live = work
        .within(|| live::run(source, tracker, pool, outputs, clock, &until, show))
        .map_err(|e| Failure::new(Exit::Failed, format!("cannot start a thread: {e}")))?;
    drop(line);
    // 4. the result
    if let Some(sources) = live.run.tally.budget() {
        files.add_budget_or_warn(&run, &sources);
    }
    let mut text = String::new();
    summary::summary(&mut text, &args.name(), &live.run, &files, &rig)
        .and_then(|()| text.write_str(&lines(&live, args.record.is_some())))
        .map_err(|e| Failure::new(Exit::Failed, format!("cannot describe the run: {e}")))?;
    let views: Vec<String> = rig.views.iter().map(|view| view.name.clone()).collect();
    let measured = Some((Measured::of(&live.run, &views), early_end(&live.run.end)));
    let unusable = no_frame(args, &live).or_else(|| summary::unusable(&rig, &live.run.tally));
    let unusable = unusable.map(|why| Failure::new(Exit::Unusable, why));
    let verdict = work.within(|| verdict_of(args, &rig, live));
    let failure = match &verdict {
        // Being stopped is how a live run ends.
        Err(failure) if failure.exit() == Exit::Interrupted => unusable.as_ref(),
        verdict => verdict.as_ref().err(),
    };
    let options = args.named();
    let hashes = Hashes {
        recording: None,
        rig: Some(hash::of_bytes(rig_toml.as_bytes())),
        options: finished::hash_of(&options),
        program: hash::of_program().ok(),
    };
    let (name, columns, warned) = (folder::name(&files.folder), BTreeMap::new(), (Vec::new(), work.warned()));
    let over = FinishedRun { name, run, options, columns, hashes, measured, warned, began, repeatable: false };
    let saved = over.summary(&files, failure).and_then(|summary| match summary {
        Some(summary) => finished::save(&summary, &files.folder),
        None => Ok(()),
    });
    if !quiet {
        output::print(&text)?;
    }
    verdict.and(saved)
}

/// What to say when there was nothing to track to the end.
fn no_frame(args: &Args, live: &LiveSummary) -> Option<String> {
    (live.run.tally.frames == 0).then(|| format!("{}: no frame was received", args.name()))
}

/// An error when rows are missing, no frame came, or the run ended badly.
fn verdict_of(args: &Args, rig: &Rig, live: LiveSummary) -> Result<(), Failure> {
    let missing = [("frames", live.unlogged_frames), ("samples of currents", live.unlogged_currents)];
    let missing: Vec<_> = missing.iter().filter(|(_, n)| *n > 0).map(|(what, n)| format!("{what}: {n}")).collect();
    if !missing.is_empty() {
        let text = format!("missing in the files, because the log could not keep up: {}", missing.join(", "));
        return Err(Failure::new(Exit::Failed, text));
    }
    let lost = live.run.tally.lost;
    if args.motion().is_some() && lost > 0 {
        tracing::warn!(
            "{}: rendering does not keep up, {} lost by it: with a lower --fps none is",
            args.source,
            plural(lost, "frame")
        );
    }
    if live.lost_currents {
        let from = args.currents.as_ref().map_or_else(String::new, ToString::to_string);
        let text = format!("{from}: the currents were lost during the run; the log has those before");
        return Err(Failure::new(Exit::Failed, text));
    }
    if let Some(text) = no_frame(args, &live).filter(|_| matches!(live.run.end, End::Complete)) {
        return Err(Failure::new(Exit::Unusable, text));
    }
    verdict(&args.name(), rig, live.run)
}

/// The part of the summary specific to a live run.
fn lines(summary: &LiveSummary, recorded_from_the_beginning: bool) -> String {
    let latency = summary.latency;
    let ms = |us: u64| us as f64 * 1e-3;
    let mut text = String::new();
    if summary.run.tally.frames > 0 {
        text += &format!(
            "from a frame's arrival to its θ: median {:.2} ms, 99 of 100 within {:.2} ms, longest {:.2} ms\n",
            ms(latency.p50_us),
            ms(latency.p99_us),
            ms(latency.max_us)
        );
    }
    if summary.run.tally.skipped() > 0 && matches!(summary.priority, Priority::Ordinary | Priority::WithinSession) {
        text += &format!("{}\n", summary.priority);
    }
    let interruptions = summary.run.source.interruptions;
    if interruptions > 0 {
        let times = if interruptions == 1 { "once".to_owned() } else { format!("{interruptions} times") };
        text += &format!(
            "the stream was interrupted {times}; where its clock began anew, what was lost meanwhile is not known\n"
        );
    }
    let pictures = summary.pictures.filter(|(recorded, dropped)| recorded_from_the_beginning || recorded + dropped > 0);
    if let Some((recorded, dropped)) = pictures {
        let lost = if dropped == 0 { "none lost".to_owned() } else { format!("{dropped} lost to the recording") };
        text += &format!("{} recorded, {lost}\n", plural(recorded, "picture"));
    }
    if summary.unpublished > 0 {
        let them = if summary.unpublished == 1 { "it" } else { "them" };
        text += &format!("subscribers missed {}; the log has {them}\n", plural(summary.unpublished, "frame"));
    }
    text
}

impl Args {
    /// The currents that come from there.
    fn receive_currents(
        &self,
        from: &CurrentSource,
        clock: HostClock,
        stop: &Arc<AtomicBool>,
    ) -> Result<Currents, Failure> {
        let refused = |e: std::io::Error| {
            // The named file is wrong or does not exist.
            let invalid = [ErrorKind::InvalidData, ErrorKind::NotFound, ErrorKind::IsADirectory].contains(&e.kind());
            let exit = if invalid { Exit::Usage } else { Exit::Failed };
            Failure::new(exit, format!("{from}: cannot receive currents: {e}"))
        };
        self.ros.of_currents(from)?.open(self.current_limit, clock, stop).map_err(refused)
    }

    /// The controllers that get θ immediately.
    fn controllers(&self, rig: &Rig) -> Result<Vec<Box<dyn Sink + Send>>, Failure> {
        let mut controllers: Vec<Box<dyn Sink + Send>> = Vec::new();
        if let Some(to) = self.udp {
            let sink = UdpSink::to(to, rig);
            controllers
                .push(Box::new(sink.map_err(|e| Failure::new(Exit::Failed, format!("cannot send datagrams: {e}")))?));
        }
        Ok(controllers)
    }

    /// The motion that is simulated, if no camera is to be read.
    fn motion(&self) -> Option<&str> {
        self.source.strip_prefix("sim:").filter(|_| !self.from.realtime && self.from.raw.is_none())
    }

    /// What is to be simulated instead of a camera.
    fn simulated(&self, rig: &Rig) -> Result<Option<Simulated>, Failure> {
        let Some(motion) = self.motion() else { return Ok(None) };
        let known = ["fps", "exposure"];
        if let Some((option, _)) = self.from.settings().iter().find(|(name, _)| !known.contains(name)) {
            let text =
                format!("{}: --{option} is for real cameras; --fps and --exposure are for this one", self.source);
            return Err(Failure::usage(text));
        }
        Simulated::of((&self.rig, rig), motion, self.duration).map(Some)
    }

    /// The source as it is told and written.
    fn name(&self) -> String {
        without_credentials(&self.source)
    }

    /// The requested folder, or the first free one.
    fn folder(&self) -> PathBuf {
        let free = || (1..).map(|n| PathBuf::from(format!("live-{n}"))).find(|folder| !folder.exists());
        self.out.clone().or_else(free).unwrap_or_else(|| "live".into())
    }

    fn described(&self) -> Run {
        Run {
            command: "live".to_owned(),
            version: env!("CARGO_PKG_VERSION").to_owned(),
            recording: if self.from.realtime { unique_text(&whole_path(self.source.as_ref())) } else { self.name() },
            rig: unique_text(&whole_path(&self.rig)),
            frame: self.frame.word().to_owned(),
            from_s: None,
            to_s: None,
            fps: self.from.raw.map(|format| format.rate).or(self.from.fps).map(|rate| rate.to_string()),
            full_frame: false,
            record: self.record.map(|record| record.word().to_owned()),
            profile: self.profile.unusual(),
            tick_led: self.tick_led.map(|spot| spot.to_string()),
        }
    }

    /// Names and values of the options that results depend on, for `summary.json`.
    fn named(&self) -> BTreeMap<String, String> {
        let own = [
            ("frame", Some(self.frame.word().to_owned())),
            ("record", self.record.map(|record| record.word().to_owned())),
            ("profile", self.profile.unusual()),
            ("tick_led", self.tick_led.map(|spot| spot.to_string())),
        ];
        let own = own.into_iter().filter_map(|(name, value)| Some((name, value?)));
        own.chain(self.from.settings()).map(|(name, value)| (name.to_owned(), value)).collect()
    }

    fn info(&self) -> RunInfo {
        let camera = self.from.settings().into_iter().map(|(name, value)| (name.to_owned(), value));
        RunInfo {
            source: self.name(),
            rig: self.rig.display().to_string(),
            settings: camera.chain(provenance::of_this_run()).collect(),
            camera_frame: self.frame == Reference::Camera,
            of_log: false,
        }
    }
}
