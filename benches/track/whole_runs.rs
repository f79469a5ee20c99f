//! Runs of a whole recording compared with plain decoding, alternately: frames per second of libav decoding to nothing,
//! of the source alone, and of the pipeline with and without the files of `catoptra track`.

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
    for (threads, title) in [(0, format!("one thread per core ({cores})")), (1, "--threads 1".to_owned())] {
        let job = Job { recording: recording.to_path_buf(), rig: rig.clone(), threads };
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build()?;
        let rounds = (0..ROUNDS).map(|_| pool.install(|| round(&job))).collect::<Result<Vec<_>, _>>()?;
        println!("\n{title:42}{:>16}{:>27}{:>15}", "frames per second", "of bare decoding", "CPU per frame");
        for (i, (name, _)) in WAYS.iter().enumerate() {
            let rate = median(rounds.iter().map(|round| round[i].rate));
            let ratios = || rounds.iter().map(|round| round[i].rate / round[0].rate);
            let (low, high) = ratios().fold((f64::INFINITY, 0.0_f64), |(low, high), r| (low.min(r), high.max(r)));
            let ratio = format!("{:.2} ({low:.2} to {high:.2})", median(ratios()));
            let cpu_ms = median(rounds.iter().map(|round| round[i].cpu_ms));
            println!("{name:42}{rate:>16.0}{ratio:>27}{cpu_ms:>12.2} ms");
        }
    }
    Ok(())
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
