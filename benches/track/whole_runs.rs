//! Runs of a whole recording compared with plain decoding, alternately: frames per second of libav decoding to nothing,
//! of the source alone, and of the pipeline with and without the files of `catoptra track`; by all cores, and by one.

use super::spread::with_spread;
use super::stopwatch::median;
use catoptra::pipeline::{self, End};
use catoptra::report::{ReportSink, RunInfo};
use catoptra::rig::Rig;
use catoptra::sink::{CsvSink, McapSink, OutputFrame, Sink};
use catoptra::source::{self, FrameSource, SourceError, SourceOptions};
use catoptra::track::{TrackOptions, Tracker};
use cpu_time::ProcessTime;
use ffmpeg_the_third as av;
use std::error::Error;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;
use std::time::Instant;

/// Repetitions of each variant.
const ROUNDS: usize = 3;

/// Number of frames.
type Frames = Result<u64, Box<dyn Error + Send + Sync>>;
type Way = fn(&Job) -> Frames;

/// Inputs of a run.
struct Job {
    recording: PathBuf,
    rig: Rig,
    /// Threads of the decoder; 0 for one per core.
    threads: usize,
}

/// The first is the reference for the others.
const WAYS: [(&str, Way); 4] = [
    ("libav, decoding to nothing", Job::libav),
    ("source::open", Job::source),
    ("pipeline::run, no sinks", |job| job.pipeline(Vec::new())),
    ("pipeline::run, log, table and report", Job::files),
];

/// Measures and prints.
pub(crate) fn print(recording: &Path, rig: &Rig) -> Result<(), Box<dyn Error + Send + Sync>> {
    let cores = std::thread::available_parallelism()?;
    let job = |threads| Job { recording: recording.to_path_buf(), rig: rig.clone(), threads };
    let all = rounds(&job(0))?;
    print_rounds(&format!("all cores ({cores})"), &all);
    print_rounds("--threads 1: the decoder and the tracker", &rounds(&job(1))?);
    let Some(alone) = on_one_core(|| rounds(&job(1))) else {
        println!("\nthis system keeps no program to one core");
        return Ok(());
    };
    let alone = alone?;
    print_rounds("--threads 1, kept to one core", &alone);
    println!("\n{cores} cores against one");
    for (i, (name, _)) in WAYS.iter().enumerate() {
        let ratios = || all.iter().zip(&alone).map(|(all, alone)| all[i].rate / alone[i].rate);
        println!("{name:42}{:>43}", with_spread(ratios, 2));
    }
    Ok(())
}

/// What repeated rounds gave.
type Rounds = Vec<[Speed; WAYS.len()]>;

fn rounds(job: &Job) -> Result<Rounds, Box<dyn Error + Send + Sync>> {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(job.threads).build()?;
    (0..ROUNDS).map(|_| pool.install(|| round(job))).collect()
}

fn print_rounds(title: &str, rounds: &Rounds) {
    println!("\n{title:42}{:>16}{:>27}{:>15}", "frames per second", "of bare decoding", "CPU per frame");
    for (i, (name, _)) in WAYS.iter().enumerate() {
        let rate = median(rounds.iter().map(|round| round[i].rate));
        let ratio = with_spread(|| rounds.iter().map(|round| round[i].rate / round[0].rate), 2);
        let cpu_ms = median(rounds.iter().map(|round| round[i].cpu_ms));
        println!("{name:42}{rate:>16.0}{ratio:>27}{cpu_ms:>12.2} ms");
    }
}

/// Runs something on one core, with all threads that it starts; `None` where that cannot be had.
fn on_one_core<T>(run: impl FnOnce() -> T) -> Option<T> {
    #[cfg(target_os = "linux")]
    {
        use rustix::thread::{CpuSet, sched_getaffinity, sched_setaffinity};
        let before = sched_getaffinity(None).ok()?;
        let core = (0..CpuSet::MAX_CPU).find(|core| before.is_set(*core))?;
        let mut one = CpuSet::new();
        one.set(core);
        sched_setaffinity(None, &one).ok()?;
        let result = run();
        sched_setaffinity(None, &before).ok()?;
        Some(result)
    }
    #[cfg(not(target_os = "linux"))]
    {
        let _ = run;
        None
    }
}

#[derive(Default, Clone, Copy)]
struct Speed {
    /// Frames per second.
    rate: f64,
    /// CPU time of all threads per frame.
    cpu_ms: f64,
}

/// Runs each variant once.
fn round(job: &Job) -> Result<[Speed; WAYS.len()], Box<dyn Error + Send + Sync>> {
    let mut speeds = [Speed::default(); WAYS.len()];
    let mut expected = None;
    for (speed, (name, way)) in speeds.iter_mut().zip(WAYS) {
        let (wall, cpu) = (Instant::now(), ProcessTime::now());
        let frames = way(job)?;
        let (wall_s, cpu_s) = (wall.elapsed().as_secs_f64(), cpu.elapsed().as_secs_f64());
        *speed = Speed { rate: frames as f64 / wall_s, cpu_ms: cpu_s * 1e3 / frames as f64 };
        let expected = *expected.get_or_insert(frames);
        if frames != expected {
            return Err(format!("{name}: {frames} frames, but bare decoding gives {expected}").into());
        }
    }
    Ok(speeds)
}

impl Job {
    fn open(&self) -> Result<Box<dyn FrameSource + Send>, SourceError> {
        source::open(&self.recording, SourceOptions { decoder_threads: self.threads, ..SourceOptions::default() })
    }

    fn libav(&self) -> Frames {
        let mut input = av::format::input(&self.recording)?;
        let stream = input.streams().best(av::media::Type::Video).ok_or("no video")?;
        let index = stream.index();
        let mut context = av::codec::Context::from_parameters(stream.parameters())?;
        // As fast as libav can: FFV1's threads share each picture.
        let is_ffv1 = context.id() == av::codec::Id::FFV1;
        let mut threading = av::threading::Config::kind(match is_ffv1 {
            true => av::threading::Type::Slice,
            false => av::threading::Type::Frame,
        });
        threading.count = self.threads;
        context.set_threading(threading);
        let mut decoder = context.decoder().video()?;
        let mut picture = av::frame::Video::empty();
        let mut frames = 0;
        for packet in input.packets() {
            let (stream, packet) = packet?;
            if stream.index() == index {
                decoder.send_packet(&packet)?;
                while decoder.receive_frame(&mut picture).is_ok() {
                    frames += 1;
                }
            }
        }
        decoder.send_eof()?;
        while decoder.receive_frame(&mut picture).is_ok() {
            frames += 1;
        }
        Ok(frames)
    }

    fn source(&self) -> Frames {
        let mut source = self.open()?;
        let mut frames = 0;
        while source.next_frame()?.is_some() {
            frames += 1;
        }
        Ok(frames)
    }

    fn pipeline(&self, sinks: Vec<Box<dyn Sink + Send>>) -> Frames {
        let mut tracker = Tracker::new(&self.rig, TrackOptions::default())?;
        let run = pipeline::run(self.open()?, &mut tracker, sinks, &AtomicBool::new(false), |_| ())?;
        match run.end {
            End::Complete if run.sink_failures.is_empty() => Ok(run.tally.frames),
            end => Err(format!("the run ended as {end:?}, {:?}", run.sink_failures).into()),
        }
    }

    fn files(&self) -> Frames {
        let folder = tempfile::tempdir()?;
        let file = |name: &str| folder.path().join(name);
        let sinks: Vec<Box<dyn Sink + Send>> = vec![
            Box::new(McapSink::create(&file("log.mcap"), &self.rig, "", "")?),
            Box::new(CsvSink::create(&file("track.csv"), &self.rig, OutputFrame::Base)?),
            Box::new(ReportSink::create(&file("report.html"), &self.rig, RunInfo::default())?),
        ];
        self.pipeline(sinks)
    }
}
