//! `catoptra simulate`: recordings and calibration pictures of a rig, with their truth.

mod motion;
mod writer;

use super::catheter::Columns;
use super::progress::Progress;
use super::results::Results;
use super::units::{duration_or_none_s, duration_s, frequency_hz, part_of_frames};
use super::{Exit, Failure, interrupt, output};
use crate::calibrate::board::{Board, Pattern};
use crate::catheter::Catheter;
use crate::plural::plural;
use crate::rig::Rig;
use crate::simulate::{
    BoardPoses, BoardSet, Mount, Renderer, Scene, Sensor, Stamp, StandardMotion, Timing, noise_seed, taught,
};
use crate::source::times::seconds;
pub(in crate::cli) use motion::Source;
use rayon::prelude::*;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use writer::{Codec, Taken, Writer};

/// Frames that are drawn side by side, and wait for the encoder.
const BATCH: usize = 8;
/// Frames per second where no option says it.
const RATE_HZ: f64 = 60.0;
/// Exposure where neither rig nor options say it, seconds.
pub(in crate::cli) const EXPOSURE_S: f64 = 2e-3;

/// The catheter that was simulated, for `catheter fit`.
const CATHETER: &str = "catheter.toml";

/// Options that boards do not have.
const OF_RECORDINGS: [&str; 9] =
    ["motion", "duration", "fps", "codec", "exposure", "highlight", "distractors", "jitter", "lost"];

/// Arguments of `catoptra simulate`.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The rig, with base frame and places of the bands
    #[arg(long, value_name = "RIG.toml")]
    rig: PathBuf,
    /// rest, planar, circle, lemniscate, a table of currents, or a tracked run's table
    #[arg(long, value_name = "MOTION", default_value = "planar")]
    motion: String,
    /// The catheter [default: the paper's, with the bands' lengths]
    #[arg(long, value_name = "CATHETER.toml")]
    catheter: Option<PathBuf>,
    #[command(flatten)]
    columns: Columns,
    /// Frames per second [default: 60Hz]
    #[arg(long, value_name = "F", value_parser = frequency_hz)]
    fps: Option<f64>,
    /// Length [default: 9 s; 1 s at rest, or beyond the last current]
    #[arg(long, value_name = "T", value_parser = duration_s)]
    duration: Option<f64>,
    /// Seed of noise, jitter and lost frames
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
    /// How pictures are stored
    #[arg(long, value_enum, default_value_t = Codec::H264)]
    codec: Codec,
    /// Exposure; 0 freezes every frame [default: the rig's, or 2 ms]
    #[arg(long, value_name = "T", value_parser = duration_or_none_s)]
    exposure: Option<f64>,
    /// Electrons of full white and of read noise; 0,0: no noise
    #[arg(long, value_name = "FULL,READ", value_delimiter = ',', num_args = 1, default_value = "10000,5")]
    noise: Vec<f64>,
    /// Each pixel sees one colour only
    #[arg(long)]
    bayer: bool,
    /// Strength of the highlight on the tube, 0 to 1
    #[arg(long, value_name = "PART", default_value_t = 0.03)]
    highlight: f64,
    /// Objects in the bands' colours in the background
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = clap::value_parser!(u8).range(..=100))]
    distractors: u8,
    /// σ of the frames' times about even spacing
    #[arg(long, value_name = "T", default_value = "0", value_parser = duration_or_none_s)]
    jitter: f64,
    /// Percentage of frames that are lost
    #[arg(long, value_name = "%", default_value = "0", value_parser = part_of_frames)]
    lost: f64,
    /// N pictures of a board in air and N in the rig instead of a recording
    #[arg(long, value_name = "N", conflicts_with_all = OF_RECORDINGS)]
    #[arg(value_parser = clap::value_parser!(u16).range(1..=1000))]
    boards: Option<u16>,
    /// That board: inner corners and squares
    #[arg(long, value_name = "CxR:SIZE", default_value = "9x6:12mm", requires = "boards")]
    board: String,
    /// Folder for recording, truth.csv, rig.toml and catheter.toml
    #[arg(short, long, value_name = "DIR")]
    out: PathBuf,
}

pub(crate) fn run(args: &Args, quiet: bool) -> Result<(), Failure> {
    let asked = interrupt::watch()?;
    let rig = Rig::load(&args.rig)?;
    let catheter = args.catheter.as_deref().map(Catheter::load).transpose().map_err(Failure::usage)?;
    let of_rig = |e: &dyn std::fmt::Display| Failure::usage(format!("{}: {e}", args.rig.display()));
    let mount = Mount::of(&rig, catheter.as_ref()).map_err(|e| of_rig(&e))?;
    let source = args.source(&rig, &mount)?;
    let mut scene = Scene::of(&rig, &mount, source.rest()).map_err(|e| of_rig(&e))?;
    scene.sensor = args.sensor()?;
    scene.distractors = usize::from(args.distractors);
    scene.seed = args.seed;
    if !(0.0..=1.0).contains(&args.highlight) {
        return Err(Failure::usage(format!("--highlight {}: expected a part from 0 to 1", args.highlight)));
    }
    scene.highlight = args.highlight;
    match args.boards {
        Some(count) => args.boards(&rig, &scene, usize::from(count), (&asked, quiet)),
        None => args.recording(&taught(&rig, &scene).map_err(|e| of_rig(&e))?, &scene, &mount, source, (&asked, quiet)),
    }
}

impl Args {
    fn sensor(&self) -> Result<Sensor, Failure> {
        match *self.noise.as_slice() {
            [full, read] if full >= 0.0 && read >= 0.0 && full.is_finite() && read.is_finite() => {
                Ok(Sensor { full_well_e: (full > 0.0).then_some(full), read_e: read, mosaic: self.bayer })
            }
            _ => {
                Err(Failure::usage("--noise: expected two numbers of electrons not below 0, FULL,READ such as 10000,5"))
            }
        }
    }

    fn exposure_s(&self, rig: &Rig) -> Result<f64, Failure> {
        let exposure_s = self.exposure.or(rig.camera.exposure_s).unwrap_or(EXPOSURE_S);
        let rate_hz = self.rate_hz();
        if exposure_s * rate_hz > 1.0 {
            let text = format!("an exposure of {} ms is longer than a frame at {rate_hz} Hz", exposure_s * 1e3);
            return Err(Failure::usage(text));
        }
        Ok(exposure_s)
    }

    fn rate_hz(&self) -> f64 {
        self.fps.unwrap_or(RATE_HZ)
    }

    /// The frames of a motion, each exposed for so long.
    fn stamps(&self, source: &Source, exposure_s: f64) -> Result<Vec<Stamp>, Failure> {
        if matches!(source, Source::Poses(_)) {
            let given = [
                ("--fps", self.fps.is_some()),
                ("--exposure", self.exposure.is_some()),
                ("--jitter", self.jitter > 0.0),
                ("--lost", self.lost > 0.0),
            ];
            if let Some((option, _)) = given.into_iter().find(|(_, given)| *given) {
                let text =
                    format!("{option}: a tracked run is simulated at its own times, frame by frame: leave it out");
                return Err(Failure::usage(text));
            }
        }
        let timing = Timing { rate_hz: self.rate_hz(), jitter_s: self.jitter, lost: self.lost, seed: self.seed };
        if self.jitter > timing.most_jitter_s() {
            return Err(Failure::usage(format!(
                "--jitter: {} ms, expected at most {:.2} ms at {} Hz: the frames would change places",
                self.jitter * 1e3,
                (timing.most_jitter_s() * 1e5).floor() / 1e2,
                timing.rate_hz
            )));
        }
        let stamps = source.stamps(timing)?;
        let shortest_s = stamps.windows(2).map(|pair| seconds(pair[1].ns - pair[0].ns)).fold(f64::INFINITY, f64::min);
        // Stamps are whole nanoseconds.
        if self.jitter > 0.0 && exposure_s > shortest_s + 1e-9 {
            return Err(Failure::usage(format!(
                "exposures of {} ms overlap: by --jitter two frames are only {:.3} ms apart; shorten one of them",
                exposure_s * 1e3,
                shortest_s * 1e3
            )));
        }
        Ok(stamps)
    }

    fn source(&self, rig: &Rig, mount: &Mount) -> Result<Source, Failure> {
        let usual_s = |usual| if usual == StandardMotion::Rest { 1.0 } else { 9.0 };
        Source::of((rig, mount), &self.motion, &self.columns, self.duration, usual_s)
    }

    fn recording(
        &self,
        rig: &Rig,
        scene: &Scene,
        mount: &Mount,
        mut source: Source,
        (asked, quiet): (&AtomicBool, bool),
    ) -> Result<(), Failure> {
        let exposure_s = self.exposure_s(rig)?;
        let stamps = self.stamps(&source, exposure_s)?;
        let renderer = Renderer::new(rig, scene).map_err(|e| Failure::usage(format!("{}: {e}", self.rig.display())))?;
        let mut files = self.codec.files(stamps.len());
        files.extend(["truth.csv", "rig.toml", CATHETER].map(str::to_owned));
        let results = self.results(files);
        let _writing = results.take()?;
        rig.save(&self.out.join("rig.toml"))?;
        output::save(&self.out.join(CATHETER), &mount.catheter.to_toml(&self.heading()))?;
        let mut progress = Progress::of_frames(Some(stamps.len() as u64), quiet);
        let mut writer = Writer::start(&self.out, self.codec, rig, &mount.centres_m)?;
        let began = std::time::Instant::now();
        let mut done = 0_u64;
        for batch in stamps.chunks(BATCH) {
            if asked.load(Ordering::Relaxed) {
                break;
            }
            let first = done;
            let lines = batch.iter().enumerate().map(|(k, stamp)| {
                let line = source.exposed(first as usize + k, *stamp, exposure_s);
                line.map_err(|e| Failure::new(Exit::Failed, e.to_string()))
            });
            let lines = lines.collect::<Result<Vec<_>, Failure>>()?;
            let drawn: Vec<_> = lines
                .par_iter()
                .enumerate()
                .map(|(k, line)| renderer.picture(line, noise_seed(self.seed, first + k as u64), self.codec.stored()))
                .collect();
            for ((stamp, line), picture) in batch.iter().zip(lines).zip(drawn) {
                let picture = picture.map_err(|e| Failure::new(Exit::Failed, e.to_string()))?;
                writer.add(Taken { seq: done, stamp: *stamp, line: line.middle, picture })?;
                done += 1;
                progress.at(done);
            }
        }
        drop(progress);
        writer.finish()?;
        let took_s = began.elapsed().as_secs_f64();
        if !quiet {
            output::print(&format!(
                "{} in {took_s:.1} s, {:.1} per second\n\nwritten: {}, truth.csv, rig.toml, {CATHETER} in {}\n",
                plural(done, "frame"),
                done as f64 / took_s,
                self.codec.name(),
                self.out.display()
            ))?;
        }
        if done < stamps.len() as u64 {
            return Err(Failure::new(Exit::Interrupted, format!("after {done} of {}", plural(stamps.len(), "frame"))));
        }
        Ok(())
    }

    /// The first line of the catheter's file.
    fn heading(&self) -> String {
        let rig = self.rig.display();
        match &self.catheter {
            Some(file) => format!("{}, with the bands of {rig}.", file.display()),
            None => format!("The paper's prototype, with the lengths and bands of {rig}."),
        }
    }

    fn results(&self, files: Vec<String>) -> Results<'_> {
        let mut inputs = vec![self.rig.as_path()];
        inputs.extend(self.catheter.as_deref());
        inputs.extend(Some(Path::new(&self.motion)).filter(|file| file.is_file()));
        Results { folder: &self.out, command: "simulate", recordings: std::slice::from_ref(&self.rig), inputs, files }
    }

    fn boards(
        &self,
        rig: &Rig,
        scene: &Scene,
        count: usize,
        (asked, quiet): (&AtomicBool, bool),
    ) -> Result<(), Failure> {
        let board: Board = self.board.parse().map_err(|e| Failure::usage(format!("--board {}: {e}", self.board)))?;
        if !matches!(board.kind, Pattern::Chessboard) {
            return Err(Failure::usage(format!(
                "--board {}: only chessboards can be drawn, such as 9x6:12mm",
                self.board
            )));
        }
        let blur_px = scene.blur_px(rig);
        let middle = scene.rest.at(scene.length_m / 2.0).0;
        let name = |set: &str, k: usize| format!("{set}{k:03}.png");
        let sets = [("air", BoardSet::Air), ("rig", BoardSet::Rig)];
        let mut files: Vec<String> = sets.iter().flat_map(|(set, _)| (0..count).map(move |k| name(set, k))).collect();
        files.push("rig.toml".to_owned());
        let mut planned = Vec::new();
        for (set, where_) in sets {
            let standing = BoardPoses::new(rig, where_, middle);
            let boards = standing.boards(board.clone(), blur_px, scene.sensor);
            let poses = standing
                .poses(&boards, count, self.seed)
                .map_err(|e| Failure::usage(format!("{}: {e}", self.rig.display())))?;
            planned.push((set, boards, poses));
        }
        let _writing = self.results(files).take()?;
        rig.save(&self.out.join("rig.toml"))?;
        let mut progress = Progress::of(Some(2 * count as u64), "pictures", quiet);
        let [width, height] = rig.camera.size_px;
        for (set, boards, poses) in &planned {
            for (first, batch) in poses.chunks(BATCH).enumerate() {
                if asked.load(Ordering::Relaxed) {
                    return Err(Failure::new(Exit::Interrupted, "interrupted".to_owned()));
                }
                let saved = batch.par_iter().enumerate().map(|(k, pose)| {
                    let k = first * BATCH + k;
                    let path = self.out.join(name(set, k));
                    let bytes = boards.picture(pose, self.seed ^ ((k as u64 + 1) << 20));
                    let saved = image::save_buffer(&path, &bytes, width, height, image::ColorType::L8);
                    saved.map_err(|e| Failure::new(Exit::Failed, format!("{}: {e}", path.display())))
                });
                saved.collect::<Result<Vec<()>, Failure>>()?;
                batch.iter().for_each(|_| progress.one_more());
            }
        }
        drop(progress);
        if quiet {
            return Ok(());
        }
        output::print(&format!("written: air*.png, rig*.png ({count} each) and rig.toml in {}\n", self.out.display()))
    }
}
