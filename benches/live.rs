//! The highest rate at which a live run loses nothing, and its latency: pictures of the sample, decoded in advance,
//! delivered like a camera's, θ received as datagrams.
//!
//! `cargo bench --bench live`, or with rates: `cargo bench --bench live -- 60 500`. Needs some gigabytes of memory.

#![allow(clippy::unwrap_used, clippy::print_stdout, reason = "a measurement fails by panicking, and prints")]

use catoptra::live::{self, Outputs, Until};
use catoptra::rig::Rig;
use catoptra::sink::{McapSink, Sink, UdpSink};
use catoptra::source::host::HostClock;
use catoptra::source::{Clock, Frame, FrameSource, HostTime, SourceError, Timestamp, VideoFile, VideoOptions};
use catoptra::track::{TrackOptions, Tracker};
use std::collections::BTreeMap;
use std::net::UdpSocket;
use std::path::Path;
use std::time::{Duration, Instant};

/// How long each rate is tried.
const SECONDS: f64 = 2.0;

/// Delivers frames from memory, each when due.
struct Memory {
    frames: std::vec::IntoIter<Frame>,
    began: Option<Instant>,
    period: Duration,
    clock: HostClock,
}

impl FrameSource for Memory {
    fn next_frame(&mut self) -> Result<Option<Frame>, SourceError> {
        let Some(frame) = self.frames.next() else { return Ok(None) };
        let began = *self.began.get_or_insert_with(Instant::now);
        let due = began + self.period * frame.seq as u32;
        // Sleeps like a thread waiting for a camera, except for the last bit.
        while let Some(rest) = due.checked_duration_since(Instant::now()) {
            if rest > Duration::from_micros(150) {
                std::thread::sleep(rest - Duration::from_micros(100));
            } else {
                std::hint::spin_loop();
            }
        }
        let arrival_ns = self.clock.now_ns();
        let stamp = Timestamp { ns: (self.period * frame.seq as u32).as_nanos() as i64, clock: Clock::Device };
        Ok(Some(Frame { stamp, host: Some(HostTime { arrival_ns, stamp_ns: arrival_ns }), ..frame }))
    }

    fn size_px(&self) -> [u32; 2] {
        [1280, 1024]
    }

    fn frame_count_hint(&self) -> Option<u64> {
        None
    }
}

/// `count` frames of the sample, repeated: it ends as it begins.
fn decoded(count: usize) -> Vec<Frame> {
    let mut all = Vec::with_capacity(count);
    while all.len() < count {
        let mut recording = VideoFile::open("sample_frames/planar.mkv", VideoOptions::default()).unwrap();
        while let Some(frame) = recording.next_frame().unwrap().filter(|_| all.len() < count) {
            all.push(Frame { seq: all.len() as u64, ..frame });
        }
    }
    all
}

struct Outcome {
    skipped: u64,
    lost: usize,
    /// Sorted, milliseconds.
    latency_ms: Vec<f64>,
    cpu: f64,
}

fn tried(rig: &Rig, hz: f64, folder: &Path) -> Outcome {
    let count = (hz * SECONDS) as usize;
    let frames = decoded(count).into_iter();
    let receiver = UdpSocket::bind("127.0.0.1:0").unwrap();
    receiver.set_read_timeout(Some(Duration::from_millis(700))).unwrap();
    let controllers: Vec<Box<dyn Sink + Send>> =
        vec![Box::new(UdpSink::to(receiver.local_addr().unwrap(), rig).unwrap())];
    let clock = HostClock::start();
    let received = std::thread::spawn(move || {
        // A controller is on another machine, or has the same priority.
        #[cfg(target_os = "linux")]
        let _ = rustix::process::setpriority_process(Some(rustix::thread::gettid()), -15);
        let (mut bytes, mut at) = ([0; 4096], BTreeMap::new());
        while let Ok(length) = receiver.recv(&mut bytes) {
            let now_ns = clock.now_ns();
            let datagram: serde_json::Value = serde_json::from_slice(&bytes[..length]).unwrap();
            let host_ns = datagram["host_ns"].as_i64().unwrap();
            at.insert(
                datagram["seq"].as_u64().unwrap(),
                ((now_ns - host_ns) as f64 * 1e-6, datagram["status"] == "ok"),
            );
        }
        at
    });
    let log: Box<dyn Sink + Send> = Box::new(McapSink::create(&folder.join("log.mcap"), rig, "", "").unwrap());
    let outputs = Outputs { files: vec![log], controllers, ..Outputs::default() };
    let pool = rayon::ThreadPoolBuilder::new().build().unwrap();
    let tracker = Tracker::new(rig, TrackOptions::default()).unwrap();
    let source = Memory { frames, began: None, period: Duration::from_secs_f64(1.0 / hz), clock };
    let (cpu, began) = (cpu_time::ProcessTime::now(), Instant::now());
    let summary = live::run(Box::new(source), tracker, pool, outputs, clock, &Until::default(), |_| {}).unwrap();
    let cpu = cpu.elapsed().as_secs_f64() / began.elapsed().as_secs_f64();
    let received = received.join().unwrap();
    let reasons = summary.run.tally.reasons("tangent");
    let skipped = reasons.iter().find(|(word, _)| *word == "skipped_overload").map_or(0, |(_, n)| *n);
    let mut latency_ms: Vec<f64> = received.values().filter(|(_, ok)| *ok).map(|(ms, _)| *ms).collect();
    latency_ms.sort_by(f64::total_cmp);
    Outcome { skipped, lost: count - received.len(), latency_ms, cpu }
}

fn main() {
    let rates: Vec<f64> = std::env::args().filter_map(|arg| arg.parse().ok()).collect();
    let rates = if rates.is_empty() { vec![60.0, 120.0, 200.0, 300.0, 400.0, 500.0, 600.0, 700.0] } else { rates };
    let rig = Rig::load(Path::new("sample_frames/truth/rig.toml")).unwrap();
    let place = tempfile::tempdir().unwrap();
    println!(
        "1280 x 1024 from memory, {} cores; milliseconds from arrival to θ at the receiver",
        rayon::current_num_threads()
    );
    println!("{:>6} {:>8} {:>6} {:>7} {:>7} {:>7} {:>6}", "Hz", "skipped", "lost", "p50", "p99", "max", "cores");
    for hz in rates {
        let Outcome { skipped, lost, latency_ms, cpu } = tried(&rig, hz, place.path());
        let at = |share: f64| latency_ms.get((share * latency_ms.len() as f64) as usize).or(latency_ms.last());
        let [p50, p99, max] = [0.5, 0.99, 1.0].map(|share| at(share).copied().unwrap_or(f64::NAN));
        println!("{hz:>6} {skipped:>8} {lost:>6} {p50:>7.2} {p99:>7.2} {max:>7.2} {cpu:>6.2}");
    }
}
