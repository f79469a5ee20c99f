//! `catoptra live`: a camera, tracked while it runs; θ to controllers and subscribers, everything to the log.

mod ros;
mod status;

use super::results::{unlike_others, whole_path};
use super::run::folder::{Files, Run};
use super::run::{LogFor, Logged, Record, Reference, load_rig, open_sinks, pool, print_warnings, summary, verdict};
use super::studio::{self, Listen};
use super::{Exit, Failure, fitting, interrupt, output, provenance};
use crate::live::{self, CurrentSource, LiveSummary, Outputs, Priority, RecordTo, Recording, Until};
use crate::pipeline::End;
use crate::report::RunInfo;
use crate::rig::Rig;
use crate::sink::{PublishSink, Sink, UdpSink};
use crate::source::host::HostClock;
use crate::source::live::{Camera, CameraSettings, Paced, RawFormat, RawPictures, Stream};
use crate::source::times::parse_seconds_ns;
use crate::source::{self, FrameRate, FrameSource, SourceOptions};
use crate::studio::Watch;
use crate::track::{TrackOptions, Tracker};
use clap::builder::RangedU64ValueParser;
use status::StatusLine;
use std::fmt::Write as _;
use std::io::ErrorKind;
use std::net::{SocketAddr, ToSocketAddrs as _};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

/// Free space that is left to the log, gigabytes: more than an hour of it at 60 Hz.
const KEEP_FREE_GB: f64 = 2.0;

/// Arguments of `catoptra live`.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// /dev/video0, genicam:NAME, gst:PIPELINE, rtsp://…, http://…, udp://… or another stream, - for standard input, a
    /// recording with --realtime
    #[arg(value_name = "SOURCE")]
    source: String,
    /// The rig file, with colours and base frame
    #[arg(long, value_name = "RIG.toml")]
    rig: PathBuf,
    /// Folder for the results [default: live-1, live-2, …]
    #[arg(short, long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Play a recording at its own pace
    #[arg(long, conflicts_with = "raw")]
    realtime: bool,
    /// Raw pictures on standard input, as 1280x1024:bayer_rg8@60
    #[arg(long, value_name = "FORMAT")]
    raw: Option<RawFormat>,
    /// Camera: frames per second
    #[arg(long, value_name = "RATE")]
    fps: Option<FrameRate>,
    /// Camera: exposure time in milliseconds
    #[arg(long, value_name = "MS", value_parser = positive)]
    exposure: Option<f64>,
    /// Camera: gain, in its own unit
    #[arg(long, value_name = "G", value_parser = finite, allow_negative_numbers = true)]
    gain: Option<f64>,
    /// Camera: pixel format, such as bayer_rg8 or MJPG
    #[arg(long, value_name = "FORMAT")]
    format: Option<String>,
    /// Send θ to a controller, one JSON datagram per frame
    #[arg(long, value_name = "HOST:PORT", value_parser = receiver)]
    udp: Option<SocketAddr>,
    /// Serve the log's topics to Foxglove [default: ws://127.0.0.1:8765]
    #[arg(long, value_name = "ADDRESS", num_args = 0..=1, default_missing_value = "127.0.0.1:8765", value_parser = listening)]
    publish: Option<SocketAddr>,
    /// Show the run in the browser [default: 127.0.0.1, a free port]
    #[arg(long, value_name = "ADDRESS", num_args = 0..=1, default_missing_value = "127.0.0.1:0")]
    studio: Option<Listen>,
    /// Web page that may subscribe too, as https://lab.example.org
    #[arg(long, value_name = "ORIGIN", requires = "publish")]
    allow_origin: Vec<String>,
    #[command(flatten)]
    ros: ros::RosArgs,
    /// Coil currents: udp:PORT, serial:DEVICE@BAUD, file:CSV or ros2:/TOPIC
    #[arg(long, value_name = "FROM")]
    currents: Option<CurrentSource>,
    /// Largest plausible current, amperes
    #[arg(long, value_name = "A", value_parser = positive, default_value_t = 10.0, requires = "currents")]
    current_limit: f64,
    /// Also record pictures
    #[arg(long, value_enum, value_name = "HOW")]
    record: Option<Record>,
    /// Write the log for foxglove or ros2 (docs/ros2.md)
    #[arg(long, value_enum, value_name = "FOR", default_value_t = LogFor::Foxglove, hide_possible_values = true)]
    profile: LogFor,
    /// Record no pictures when less is free on the disk, GB [default: 2]
    #[arg(long, value_name = "GB", value_parser = positive, requires = "record")]
    keep_free: Option<f64>,
    /// Stop after T seconds
    #[arg(long, value_name = "T", value_parser = duration)]
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
    let found = address(text)?;
    if found.port() == 0 { Err("the port is 0; give the one where the receiver listens".to_owned()) } else { Ok(found) }
}

fn address(text: &str) -> Result<SocketAddr, String> {
    let mut found = text.to_socket_addrs().map_err(|e| format!("{e}; write HOST:PORT, such as 192.168.1.20:5005"))?;
    found.next().ok_or_else(|| "no such host".to_owned())
}

/// `ws://HOST:PORT`, `HOST:PORT`, `:PORT` or `PORT`; this computer alone when no host is named.
fn listening(text: &str) -> Result<SocketAddr, String> {
    let place = text.strip_prefix("ws://").unwrap_or(text).trim_end_matches('/');
    let port = place.strip_prefix(':').unwrap_or(place);
    if let Ok(port) = port.parse::<u16>() {
        return Ok(SocketAddr::from(([127, 0, 0, 1], port)));
    }
    address(place)
}

fn finite(text: &str) -> Result<f64, String> {
    text.parse().ok().filter(|x: &f64| x.is_finite()).ok_or_else(|| "expected a number".to_owned())
}

fn positive(text: &str) -> Result<f64, String> {
    finite(text).ok().filter(|x| *x > 0.0).ok_or_else(|| "expected a number above 0, such as 8.5".to_owned())
}

fn duration(text: &str) -> Result<Duration, String> {
    let ns = parse_seconds_ns(text).and_then(|ns| u64::try_from(ns).ok()).filter(|ns| *ns > 0);
    ns.map(Duration::from_nanos).ok_or_else(|| "expected seconds above 0, such as 600".to_owned())
}

pub(crate) fn run(args: &Args, quiet: bool) -> Result<(), Failure> {
    let until = Until { stop: interrupt::watch()?, duration: args.duration };
    // 1. everything is judged before anything is written
    let (rig, rig_toml) = load_rig(&args.rig, args.frame)?;
    let tracker = Tracker::new(&rig, TrackOptions::default())
        .map_err(|e| Failure::new(Exit::Usage, format!("{}: {e}", args.rig.display())))?;
    print_warnings(&args.rig, &rig)?;
    let controllers = args.controllers(&rig)?;
    let subscribers = args.ros.open(&rig)?;
    let publisher = args.publish.map(|at| PublishSink::listen(at, &args.allow_origin, &rig)).transpose();
    let publisher = publisher.map_err(|e| Failure::new(Exit::Failed, e))?;
    if let Some(publisher) = &publisher {
        tracing::info!("subscribers find the topics at ws://{}", publisher.address());
    }
    let clock = HostClock::start();
    let currents = args.currents.as_ref().map(|from| {
        let refused = |e: std::io::Error| {
            // The file that was named is the wrong one, or there is none.
            let invalid = [ErrorKind::InvalidData, ErrorKind::NotFound, ErrorKind::IsADirectory].contains(&e.kind());
            let exit = if invalid { Exit::Usage } else { Exit::Failed };
            Failure::new(exit, format!("{from}: no currents can be had: {e}"))
        };
        let from = args.ros.of_currents(from)?;
        from.open(args.current_limit, clock, &until.stop).map_err(refused)
    });
    let currents = currents.transpose()?;
    let source = args.open(rig.camera.size_px, clock, &until.stop)?;
    fitting::check_size(&args.source, source.size_px(), (&args.rig, &rig))?;
    let files = Files::new(&args.folder(), None, false).recording(args.record);
    let latest = args.studio.is_some().then(|| Arc::new(live::Latest::default()));
    let watch = |latest: &Arc<live::Latest>| {
        Watch::new(Arc::clone(latest), &rig, &args.source, &files.folder.display().to_string())
    };
    let watched = args.studio.as_ref().zip(latest.as_ref());
    let _studio = watched.map(|(listen, latest)| studio::show_live(listen, watch(latest))).transpose()?;
    // 2. the files
    let run = args.described();
    let run_toml = run.to_toml()?;
    let _held = files.prepare_new(&run, &[&args.rig])?;
    let logged = Logged { record: args.record, profile: args.profile, ..Logged::default() };
    let opened = open_sinks(&files, &rig, [&rig_toml, &run_toml], args.frame, args.info(), logged)?;
    let pictures = args.record.map(|_| Recording {
        to: opened.video.map_or(RecordTo::Log, RecordTo::Video),
        count: opened.count,
        folder: files.folder.clone(),
        keep_free_bytes: (args.keep_free.unwrap_or(KEEP_FREE_GB) * 1e9) as u64,
    });
    // 3. the run
    let publisher = publisher.map(|sink| Box::new(sink) as Box<dyn Sink + Send>);
    let subscribers = subscribers.into_iter().chain(publisher).collect();
    let outputs = Outputs { files: opened.sinks, controllers, subscribers, currents, pictures, latest };
    let mut line = StatusLine::new(&args.source, &files.folder, quiet);
    let pool = pool(args.threads.unwrap_or(0))?;
    let show = |status: &live::Status| line.show(status);
    let live = live::run(source, tracker, pool, outputs, clock, &until, show)
        .map_err(|e| Failure::new(Exit::Failed, format!("cannot start a thread: {e}")))?;
    drop(line);
    // 4. what came of it
    if let Some(sources) = live.run.tally.budget() {
        files.add_budget(&run, &sources)?;
    }
    if !quiet {
        let mut text = String::new();
        summary::summary(&mut text, &args.source, &live.run, &files, &rig)
            .and_then(|()| text.write_str(&lines(&live)))
            .map_err(|e| Failure::new(Exit::Failed, format!("cannot describe the run: {e}")))?;
        output::print(&text)?;
    }
    if live.unlogged > 0 {
        let text = format!("{} frames are missing in the files: the disk was too slow", live.unlogged);
        return Err(Failure::new(Exit::Failed, text));
    }
    if live.run.tally.frames == 0 && matches!(live.run.end, End::Complete) {
        let text = format!("{}: not a single frame came", args.source);
        return Err(Failure::new(Exit::Unusable, text));
    }
    verdict(&args.source, &rig, live.run)
}

/// The part of the summary that only a live run has.
fn lines(summary: &LiveSummary) -> String {
    let latency = summary.latency;
    let ms = |us: u64| us as f64 * 1e-3;
    let mut text = format!(
        "from a frame's arrival to its θ: median {:.2} ms, 99 of 100 within {:.2} ms, longest {:.2} ms\n",
        ms(latency.p50_us),
        ms(latency.p99_us),
        ms(latency.max_us)
    );
    if summary.run.tally.reasons("tangent").iter().any(|(word, _)| *word == "skipped_overload")
        && summary.priority != Priority::Raised
    {
        text += &format!("{}\n", summary.priority);
    }
    let interruptions = summary.run.source.interruptions;
    if interruptions > 0 {
        let times = if interruptions == 1 { "once".to_owned() } else { format!("{interruptions} times") };
        text += &format!("the stream broke off {times}\n");
    }
    if let Some((recorded, dropped)) = summary.pictures {
        let lost = if dropped == 0 { "none lost".to_owned() } else { format!("{dropped} lost to the recording") };
        text += &format!("{recorded} pictures recorded, {lost}\n");
    }
    if summary.unpublished > 0 {
        text += &format!("subscribers missed {} frames; the log has them\n", summary.unpublished);
    }
    text
}

/// Standard input without the small buffer of the standard library, and as a pipe that holds half a picture.
#[cfg(unix)]
fn standard_input() -> Result<Box<dyn std::io::Read + Send>, Failure> {
    use std::os::fd::AsFd as _;
    let refused = |e: std::io::Error| Failure::new(Exit::Usage, format!("standard input: {e}"));
    let input = std::io::stdin().as_fd().try_clone_to_owned().map_err(refused)?;
    // Refused where it is no pipe.
    let _ = rustix::pipe::fcntl_setpipe_size(&input, 1 << 20);
    Ok(Box::new(std::fs::File::from(input)))
}

#[cfg(not(unix))]
fn standard_input() -> Result<Box<dyn std::io::Read + Send>, Failure> {
    Ok(Box::new(std::io::stdin()))
}

impl Args {
    /// Who is told θ the moment it is known.
    fn controllers(&self, rig: &Rig) -> Result<Vec<Box<dyn Sink + Send>>, Failure> {
        let mut controllers: Vec<Box<dyn Sink + Send>> = Vec::new();
        if let Some(to) = self.udp {
            let sink = UdpSink::to(to, rig);
            controllers
                .push(Box::new(sink.map_err(|e| Failure::new(Exit::Failed, format!("cannot send datagrams: {e}")))?));
        }
        Ok(controllers)
    }

    fn open(
        &self,
        size_px: [u32; 2],
        clock: HostClock,
        stop: &Arc<AtomicBool>,
    ) -> Result<Box<dyn FrameSource + Send>, Failure> {
        let usage = |text: String| Failure::new(Exit::Usage, text);
        let invalid = |e: source::SourceError| Failure::new(Exit::Usage, e);
        if !self.realtime && self.raw.is_none() {
            let settings = || CameraSettings {
                size_px,
                rate: self.fps,
                exposure_s: self.exposure.map(|ms| ms * 1e-3),
                gain: self.gain,
                format: self.format.clone(),
            };
            if let Some(id) = self.source.strip_prefix("genicam:") {
                return Ok(Box::new(Camera::genicam(id, settings(), clock, Arc::clone(stop)).map_err(invalid)?));
            }
            if self.source.starts_with("/dev/") {
                let path = Path::new(&self.source);
                return Ok(Box::new(Camera::v4l2(path, settings(), clock, Arc::clone(stop)).map_err(invalid)?));
            }
        }
        if let (Some(text), false, None) = (self.source.strip_prefix("gst:"), self.realtime, self.raw)
            && self.camera_options().is_empty()
        {
            return Ok(Box::new(Camera::gstreamer(text, clock, Arc::clone(stop)).map_err(invalid)?));
        }
        if let Some((option, _)) = self.camera_options().first() {
            return Err(usage(format!(
                "{}: --{option} is for cameras, /dev/video0 or genicam:; this source is as it comes",
                self.source
            )));
        }
        if let Some(format) = self.raw {
            if self.source != "-" {
                return Err(usage(format!(
                    "{}: --raw describes what is on standard input: give - as the source",
                    self.source
                )));
            }
            return Ok(Box::new(RawPictures::new("standard input", standard_input()?, format, clock)));
        }
        if self.realtime {
            let recording = source::open_to_track(&self.source, SourceOptions::default()).map_err(invalid)?;
            return Ok(Box::new(Paced::new(recording, clock, Arc::clone(stop))));
        }
        if Path::new(&self.source).exists() {
            let advice = "is a file or folder: play it at its own pace with --realtime, or use `catoptra track`";
            return Err(usage(format!("{}: {advice}", self.source)));
        }
        Ok(Box::new(Stream::open(&self.source, clock, Arc::clone(stop)).map_err(invalid)?))
    }

    /// What was asked of a camera.
    fn camera_options(&self) -> Vec<(&'static str, String)> {
        let options = [
            ("fps", self.fps.map(|rate| rate.to_string())),
            ("exposure", self.exposure.map(|ms| format!("{ms} ms"))),
            ("gain", self.gain.map(|gain| gain.to_string())),
            ("format", self.format.clone()),
        ];
        options.into_iter().filter_map(|(name, value)| Some((name, value?))).collect()
    }

    /// The folder asked for, or the first free one.
    fn folder(&self) -> PathBuf {
        let free = || (1..).map(|n| PathBuf::from(format!("live-{n}"))).find(|folder| !folder.exists());
        self.out.clone().or_else(free).unwrap_or_else(|| "live".into())
    }

    fn described(&self) -> Run {
        Run {
            command: "live".to_owned(),
            version: env!("CARGO_PKG_VERSION").to_owned(),
            recording: self.source.clone(),
            rig: unlike_others(&whole_path(&self.rig)),
            frame: self.frame.word().to_owned(),
            from_s: None,
            to_s: None,
            fps: self.raw.map(|format| format.rate).or(self.fps).map(|rate| rate.to_string()),
            full_frame: false,
            record: self.record.map(|record| record.word().to_owned()),
            profile: self.profile.unusual(),
        }
    }

    fn info(&self) -> RunInfo {
        let camera = self.camera_options().into_iter().map(|(name, value)| (name.to_owned(), value));
        RunInfo {
            source: self.source.clone(),
            rig: self.rig.display().to_string(),
            settings: camera.chain(provenance::of_this_run()).collect(),
            camera_frame: self.frame == Reference::Camera,
        }
    }
}
