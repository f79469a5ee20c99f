//! The highest rate at which a live run loses nothing, and its latency: pictures of the sample, decoded in advance,
//! delivered like a camera's, θ received as datagrams.
//!
//! `cargo bench --bench live`, or with rates and seconds: `cargo bench --bench live -- 60:60 500:5`. 1000 pictures need
//! 2 GB of memory.

#![allow(clippy::unwrap_used, clippy::print_stdout, reason = "a measurement fails by panicking, and prints")]

use catoptra::live::{self, Outputs, Until};
use catoptra::rig::Rig;
use catoptra::sink::{McapSink, Sink, UdpSink};
use catoptra::source::host::HostClock;
use catoptra::source::{Clock, Frame, FrameSource, HostTime, Picture, SourceError, Timestamp, VideoFile, VideoOptions};
use catoptra::track::{TrackOptions, Tracker};
use std::collections::BTreeMap;
use std::net::UdpSocket;
use std::path::Path;
use std::time::{Duration, Instant};

/// What is tried: rates, Hz, each for so many seconds. (Memory is for ten seconds at 600 Hz.)
const TRIED: [(f64, f64); 15] = [
    (60.0, 60.0),
    (120.0, 4.0),
    (240.0, 4.0),
    (300.0, 4.0),
    (360.0, 4.0),
    (420.0, 4.0),
    (480.0, 4.0),
    (600.0, 10.0),
    (600.0, 10.0),
    (600.0, 10.0),
    (600.0, 10.0),
    (600.0, 10.0),
    (600.0, 10.0),
    (720.0, 4.0),
    (900.0, 4.0),
];

/// Where the catheter turns by itself in the sample: from its beginning, at rest, to here and back it moves as it can.
const TURNS_AT: usize = 287;

/// About what a frame takes.
const WORK: Duration = Duration::from_millis(2);

/// Frames of the first run that are looked at.
const SLOWEST: usize = 20;

/// Delivers pictures, each when due.
struct Memory {
    pictures: std::iter::Enumerate<std::vec::IntoIter<Picture>>,
    began: Option<Instant>,
    period: Duration,
    clock: HostClock,
}

/// Sleeps like a thread waiting for a camera, except for the last bit.
fn wait_until(due: Instant) {
    while let Some(rest) = due.checked_duration_since(Instant::now()) {
        if rest > Duration::from_micros(150) {
            std::thread::sleep(rest - Duration::from_micros(100));
        } else {
            std::hint::spin_loop();
        }
    }
}

impl FrameSource for Memory {
    fn next_frame(&mut self) -> Result<Option<Frame>, SourceError> {
        let Some((seq, picture)) = self.pictures.next() else { return Ok(None) };
        let seq = seq as u64;
        let began = *self.began.get_or_insert_with(Instant::now);
        wait_until(began + self.period * seq as u32);
        let arrival_ns = self.clock.now_ns();
        let stamp = Timestamp { ns: (self.period * seq as u32).as_nanos() as i64, clock: Clock::Device };
        let host = Some(HostTime { arrival_ns, stamp_ns: arrival_ns });
        Ok(Some(Frame { seq, stamp, gap: 0, host, picture }))
    }

    fn size_px(&self) -> [u32; 2] {
        [1280, 1024]
    }

    fn frame_count_hint(&self) -> Option<u64> {
        None
    }
}

/// A picture of its own, as a camera's would be.
fn copy(picture: &Picture) -> Picture {
    let [width, height] = picture.size_px();
    let plane = |i: usize| {
        let plane = picture.plane(i).unwrap();
        let mut bytes = Vec::with_capacity(plane.width * plane.height);
        (0..plane.height).for_each(|j| bytes.extend_from_slice(plane.row(j).unwrap()));
        bytes
    };
    let planes = (0..picture.format().channels()).map(plane).collect();
    Picture::from_planes(width, height, picture.format(), picture.colour(), planes).unwrap()
}

/// The sample's pictures, as far as they are used.
fn decoded() -> Vec<Picture> {
    let mut recording = VideoFile::open("sample_frames/planar.mkv", VideoOptions::default()).unwrap();
    let frames = std::iter::from_fn(|| recording.next_frame().unwrap());
    frames.take(TURNS_AT + 1).map(|frame| frame.picture).collect()
}

/// Number `i` of them, taken forwards and backwards, so that the catheter neither jumps nor turns at once.
fn repeated(pictures: &[Picture], i: usize) -> Picture {
    let last = pictures.len() - 1;
    copy(&pictures[last - (i % (2 * last)).abs_diff(last)])
}

struct Outcome {
    skipped: u64,
    lost: usize,
    /// By frame, milliseconds.
    latency_ms: BTreeMap<u64, f64>,
    cpu: f64,
}

fn tried(rig: &Rig, (hz, seconds): (f64, f64), pictures: &[Picture], folder: &Path) -> Outcome {
    let count = (hz * seconds) as usize;
    let pictures: Vec<Picture> = (0..count).map(|i| repeated(pictures, i)).collect();
    let receiver = UdpSocket::bind("127.0.0.1:0").unwrap();
    receiver.set_read_timeout(Some(Duration::from_millis(700))).unwrap();
    let controllers: Vec<Box<dyn Sink + Send>> =
        vec![Box::new(UdpSink::to(receiver.local_addr().unwrap(), rig).unwrap())];
    let clock = HostClock::start();
    let received = std::thread::spawn(move || {
        // A controller is on another machine, or has the same priority.
        set_priority(-15);
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
    let period = Duration::from_secs_f64(1.0 / hz);
    let source = Memory { pictures: pictures.into_iter().enumerate(), began: None, period, clock };
    let (cpu, began) = (cpu_time::ProcessTime::now(), Instant::now());
    let summary = live::run(Box::new(source), tracker, pool, outputs, clock, &Until::default(), |_| {}).unwrap();
    let cpu = cpu.elapsed().as_secs_f64() / began.elapsed().as_secs_f64();
    let received = received.join().unwrap();
    let reasons = summary.run.tally.reasons("tangent");
    let skipped = reasons.iter().find(|(word, _)| *word == "skipped_overload").map_or(0, |(_, n)| *n);
    let lost = count - received.len();
    let latency_ms = received.into_iter().filter(|(_, (_, ok))| *ok).map(|(seq, (ms, _))| (seq, ms)).collect();
    Outcome { skipped, lost, latency_ms, cpu }
}

/// How far this thread goes before others, where it may ("nice").
fn set_priority(nice: i32) {
    #[cfg(target_os = "linux")]
    let _ = rustix::process::setpriority_process(Some(rustix::thread::gettid()), nice);
    #[cfg(not(target_os = "linux"))]
    let _ = nice;
}

/// Latencies of datagrams that are sent when a frame would arrive, milliseconds: what the machine takes for waking two
/// threads, and how long it stands still.
fn of_machine(hz: f64, seconds: f64) -> Vec<f64> {
    let receiver = UdpSocket::bind("127.0.0.1:0").unwrap();
    receiver.set_read_timeout(Some(Duration::from_millis(700))).unwrap();
    let sender = UdpSocket::bind("127.0.0.1:0").unwrap();
    sender.connect(receiver.local_addr().unwrap()).unwrap();
    let began = Instant::now();
    let received = std::thread::spawn(move || {
        set_priority(-15);
        let (mut due, mut late) = ([0; 8], Vec::new());
        while receiver.recv(&mut due).is_ok() {
            late.push((began.elapsed().as_nanos() as f64 - u64::from_le_bytes(due) as f64) * 1e-6);
        }
        late
    });
    set_priority(-15);
    for i in 1..=(hz * seconds) as u32 {
        let due = Duration::from_secs_f64(f64::from(i) / hz);
        wait_until(began + due);
        sender.send(&(due.as_nanos() as u64).to_le_bytes()).unwrap();
    }
    set_priority(0);
    received.join().unwrap()
}

/// How long a thread that pauses between frames waits for the help of a second one, milliseconds; `WORK` where the
/// second does not come before the first has finished.
fn second_thread(hz: f64, seconds: f64) -> Vec<f64> {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(2).build().unwrap();
    let began = Instant::now();
    pool.install(|| {
        let late = |i: u32| {
            wait_until(began + Duration::from_secs_f64(f64::from(i) / hz));
            let woken = Instant::now();
            let work = || while woken.elapsed() < WORK {};
            rayon::join(work, || woken.elapsed().min(WORK)).1.as_secs_f64() * 1e3
        };
        (1..=(hz * seconds) as u32).map(late).collect()
    })
}

fn p50_p99_max(values: impl Iterator<Item = f64>) -> [f64; 3] {
    let mut sorted: Vec<f64> = values.collect();
    sorted.sort_by(f64::total_cmp);
    let at = |share: f64| sorted.get((share * sorted.len() as f64) as usize).or(sorted.last());
    [0.5, 0.99, 1.0].map(|share| at(share).copied().unwrap_or(f64::NAN))
}

/// The slowest frames of a run: what of their latency is computation, when the same frames are tracked one right after
/// another, and what is waiting: for a processor, for other threads, for a cache that the pause left cold.
fn print_slowest(rig: &Rig, hz: f64, pictures: &[Picture], latency_ms: &BTreeMap<u64, f64>) {
    let pool = rayon::ThreadPoolBuilder::new().build().unwrap();
    let mut tracker = Tracker::new(rig, TrackOptions::default()).unwrap();
    let mut frames: Vec<(u64, f64, f64)> = Vec::new();
    for seq in 0..latency_ms.last_key_value().map_or(0, |(last, _)| last + 1) {
        let stamp = Timestamp { ns: (seq as f64 * 1e9 / hz) as i64, clock: Clock::Device };
        let frame = Frame { seq, stamp, gap: 0, host: None, picture: repeated(pictures, seq as usize) };
        let began = Instant::now();
        pool.install(|| tracker.step(&frame)).unwrap();
        let step_ms = began.elapsed().as_secs_f64() * 1e3;
        frames.extend(latency_ms.get(&seq).map(|ms| (seq, *ms, step_ms)));
    }
    frames.sort_by(|a, b| b.1.total_cmp(&a.1));
    println!("\nthe {SLOWEST} slowest at {hz} Hz, milliseconds");
    println!("{:>8} {:>9} {:>18} {:>9}", "frame", "latency", "Tracker::step", "the rest");
    for (seq, ms, step_ms) in frames.iter().take(SLOWEST) {
        println!("{seq:>8} {ms:>9.2} {step_ms:>18.2} {:>9.2}", ms - step_ms);
    }
    let [p50, p99, _] = p50_p99_max(frames.iter().map(|frame| frame.2));
    println!("Tracker::step of all frames: p50 {p50:.2}, p99 {p99:.2}");
}

fn main() {
    let asked = std::env::args().filter_map(|arg| {
        let (hz, seconds) = arg.split_once(':')?;
        Some((hz.parse().ok()?, seconds.parse().ok()?))
    });
    let asked: Vec<(f64, f64)> = asked.collect();
    let all = if asked.is_empty() { &TRIED[..] } else { &asked };
    let pictures = decoded();
    let rig = Rig::load(Path::new("sample_frames/truth/rig.toml")).unwrap();
    let place = tempfile::tempdir().unwrap();
    println!(
        "1280 x 1024 from memory, {} cores; milliseconds from arrival to θ at the receiver",
        rayon::current_num_threads()
    );
    println!(
        "{:>6} {:>6} {:>8} {:>6} {:>7} {:>7} {:>7} {:>6}",
        "Hz", "s", "skipped", "lost", "p50", "p99", "max", "cores"
    );
    // Where rates are asked for, they alone are measured.
    if asked.is_empty() {
        let print = |what: &str, hz: f64, late: Vec<f64>| {
            let [p50, p99, max] = p50_p99_max(late.into_iter());
            println!("{hz:>6} {:>6} {what:<15} {p50:>8.2} {p99:>7.2} {max:>7.2}", 20);
        };
        [60.0, 600.0].into_iter().for_each(|hz| print("nothing tracked", hz, of_machine(hz, 20.0)));
        print("a second thread", 60.0, second_thread(60.0, 20.0));
    }
    let mut slowest = None;
    for &(hz, seconds) in all {
        let Outcome { skipped, lost, latency_ms, cpu } = tried(&rig, (hz, seconds), &pictures, place.path());
        let [p50, p99, max] = p50_p99_max(latency_ms.values().copied());
        println!("{hz:>6} {seconds:>6} {skipped:>8} {lost:>6} {p50:>7.2} {p99:>7.2} {max:>7.2} {cpu:>6.2}");
        slowest.get_or_insert((hz, latency_ms));
    }
    if let Some((hz, latency_ms)) = slowest {
        print_slowest(&rig, hz, &pictures, &latency_ms);
    }
}
