//! The highest rate at which a live run loses nothing, and its latency: pictures of the sample, decoded in advance,
//! delivered like a camera's, θ received as datagrams.
//!
//! `cargo bench --bench live`, or with rates and seconds: `cargo bench --bench live -- 60:60 500:5`.

#![allow(clippy::unwrap_used, clippy::print_stdout, reason = "a measurement fails by panicking, and prints")]

use catoptra::estimate::Estimate;
use catoptra::live::{self, Outputs, Until};
use catoptra::rig::Rig;
use catoptra::sink::{McapSink, Sink, SinkError, UdpSink};
use catoptra::source::host::HostClock;
use catoptra::source::{Clock, Frame, FrameSource, HostTime, Picture, SourceError, Timestamp, VideoFile, VideoOptions};
use catoptra::tally::Tally;
use catoptra::track::{TrackOptions, Tracker};
use std::collections::BTreeMap;
use std::net::UdpSocket;
use std::path::Path;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

/// What is tried: rates, Hz, each for so many seconds. The first is looked at closely.
const TRIED: [(f64, f64); 15] = [
    (60.0, 60.0),
    (60.0, 60.0),
    (60.0, 60.0),
    (120.0, 4.0),
    (240.0, 4.0),
    (300.0, 4.0),
    (360.0, 4.0),
    (420.0, 4.0),
    (480.0, 4.0),
    (600.0, 60.0),
    (600.0, 60.0),
    (600.0, 60.0),
    (720.0, 4.0),
    (900.0, 4.0),
    (1200.0, 4.0),
];

/// Where the catheter turns by itself in the sample: from its beginning, at rest, to here and back it moves as it can.
const TURNS_AT: usize = 287;

/// About what a frame takes.
const WORK: Duration = Duration::from_millis(2);

/// Frames of the first run that are looked at.
const SLOWEST: usize = 20;

/// Delivers pictures of a ring, each when due.
struct Memory {
    ring: Arc<[Picture]>,
    numbers: std::ops::Range<u64>,
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
        let Some(seq) = self.numbers.next() else { return Ok(None) };
        let picture = self.ring[seq as usize % self.ring.len()].clone();
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
}

/// The sample's pictures, as far as they are used.
fn decoded() -> Vec<Picture> {
    let mut recording = VideoFile::open("sample_frames/planar.mkv", VideoOptions::default()).unwrap();
    let frames = std::iter::from_fn(|| recording.next_frame().unwrap());
    // A camera states no quantiser.
    frames.take(TURNS_AT + 1).map(|frame| frame.picture.quantised(None)).collect()
}

/// The pictures forwards and backwards, so that the catheter neither jumps nor turns at once. There are so many that no
/// cache holds one until it comes again.
fn ring(pictures: &[Picture]) -> Arc<[Picture]> {
    let last = pictures.len() - 1;
    (0..2 * last).map(|i| pictures[last - i.abs_diff(last)].clone()).collect()
}

struct Outcome {
    skipped: u64,
    lost: usize,
    latencies: BTreeMap<u64, Latency>,
    cpu: f64,
}

/// Where the time of a frame went, milliseconds.
#[derive(Clone, Copy)]
struct Latency {
    /// From arrival until θ was received.
    all: f64,
    /// Until θ was sent.
    until_sent: f64,
    /// What the tracker's thread computed since θ of the frame before was sent: what was to be learned from that frame,
    /// then this one.
    computed: f64,
}

impl Latency {
    /// All of it, and what it was spent on: computing, waiting, delivery.
    fn parts(&self) -> [f64; 4] {
        let Self { all, until_sent, computed } = *self;
        [all, computed, (until_sent - computed).max(0.0), all - until_sent]
    }
}

/// A controller's line that notes for each frame when θ was sent, and the processor time of the tracker's thread.
struct Noted {
    line: UdpSink,
    clock: HostClock,
    notes: Arc<Mutex<BTreeMap<u64, (f64, f64)>>>,
    computed_ms: f64,
}

impl Sink for Noted {
    fn write(&mut self, estimate: &Estimate, picture: Option<&Picture>) -> Result<(), SinkError> {
        self.line.write(estimate, picture)?;
        let before_ms = std::mem::replace(&mut self.computed_ms, thread_ms());
        let arrival_ns = estimate.host.map_or(i64::MIN, |host| host.arrival_ns);
        let sent_ms = (self.clock.now_ns() - arrival_ns) as f64 * 1e-6;
        self.notes.lock().unwrap().insert(estimate.seq, (sent_ms, self.computed_ms - before_ms));
        Ok(())
    }

    fn finish(&mut self, tally: &Tally) -> Result<(), SinkError> {
        self.line.finish(tally)
    }
}

fn tried(rig: &Rig, (hz, seconds): (f64, f64), ring: &Arc<[Picture]>, folder: &Path) -> Outcome {
    let count = (hz * seconds) as usize;
    let receiver = UdpSocket::bind("127.0.0.1:0").unwrap();
    receiver.set_read_timeout(Some(Duration::from_millis(700))).unwrap();
    let clock = HostClock::start();
    let notes = Arc::new(Mutex::new(BTreeMap::new()));
    let line = UdpSink::to(receiver.local_addr().unwrap(), rig).unwrap();
    let controllers: Vec<Box<dyn Sink + Send>> =
        vec![Box::new(Noted { line, clock, notes: Arc::clone(&notes), computed_ms: 0.0 })];
    let received = std::thread::spawn(move || {
        // A controller is on another machine, or as urgent.
        as_the_tracker();
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
    let source = Memory { ring: Arc::clone(ring), numbers: 0..count as u64, began: None, period, clock };
    let (cpu, began) = (cpu_time::ProcessTime::now(), Instant::now());
    let summary = live::run(Box::new(source), tracker, pool, outputs, clock, &Until::default(), |_| {}).unwrap();
    let cpu = cpu.elapsed().as_secs_f64() / began.elapsed().as_secs_f64();
    let received = received.join().unwrap();
    let reasons = summary.run.tally.reasons("tangent");
    let skipped = reasons.iter().find(|(word, _)| *word == "skipped_overload").map_or(0, |(_, n)| *n);
    let lost = count - received.len();
    let notes = notes.lock().unwrap();
    let latency = |(seq, (all, ok)): (u64, (f64, bool))| {
        let (until_sent, computed) = *notes.get(&seq).filter(|_| ok)?;
        Some((seq, Latency { all, until_sent, computed }))
    };
    Outcome { skipped, lost, latencies: received.into_iter().filter_map(latency).collect(), cpu }
}

/// Processor time of this thread, milliseconds.
fn thread_ms() -> f64 {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ThreadCPUTime);
    time.tv_sec as f64 * 1e3 + time.tv_nsec as f64 * 1e-6
}

/// Schedules this thread as the tracker is, where it may.
fn as_the_tracker() {
    #[cfg(target_os = "linux")]
    {
        use thread_priority::{
            RealtimeThreadSchedulePolicy, ThreadPriority, ThreadSchedulePolicy, set_thread_priority_and_policy,
        };
        let policy = ThreadSchedulePolicy::Realtime(RealtimeThreadSchedulePolicy::RoundRobin);
        let priority = ThreadPriority::Crossplatform(10_u8.try_into().unwrap());
        let _ = set_thread_priority_and_policy(thread_priority::thread_native_id(), priority, policy);
    }
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
        as_the_tracker();
        let (mut due, mut late) = ([0; 8], Vec::new());
        while receiver.recv(&mut due).is_ok() {
            late.push((began.elapsed().as_nanos() as f64 - u64::from_le_bytes(due) as f64) * 1e-6);
        }
        late
    });
    let sent = std::thread::spawn(move || {
        as_the_tracker();
        for i in 1..=(hz * seconds) as u32 {
            let due = Duration::from_secs_f64(f64::from(i) / hz);
            wait_until(began + due);
            sender.send(&(due.as_nanos() as u64).to_le_bytes()).unwrap();
        }
    });
    sent.join().unwrap();
    received.join().unwrap()
}

/// How long a thread that pauses between frames waits for the help of a second one, milliseconds; `WORK` where the
/// second does not come before the first has finished.
fn second_thread(hz: f64, seconds: f64) -> Vec<f64> {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(2).build().unwrap();
    pool.broadcast(|_| as_the_tracker());
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

/// The slowest frames of a run, and what each waited for: for its own computation; for a processor or another thread,
/// before or in between; and on the way to the receiver.
fn print_slowest(hz: f64, latencies: &BTreeMap<u64, Latency>) {
    let mut frames: Vec<(u64, Latency)> = latencies.iter().map(|(seq, latency)| (*seq, *latency)).collect();
    frames.sort_by(|a, b| b.1.all.total_cmp(&a.1.all));
    println!("\nthe {SLOWEST} slowest at {hz} Hz, milliseconds");
    println!("{:>8} {:>9} {:>10} {:>9} {:>10}", "frame", "latency", "computing", "waiting", "delivery");
    let print = |name: &str, [all, computed, waited, delivered]: [f64; 4]| {
        println!("{name:>8} {all:>9.2} {computed:>10.2} {waited:>9.2} {delivered:>10.2}");
    };
    for (seq, latency) in frames.iter().take(SLOWEST) {
        print(&seq.to_string(), latency.parts());
    }
    println!("all frames, each column by itself");
    let columns = [0, 1, 2, 3].map(|i| p50_p99_max(frames.iter().map(|(_, latency)| latency.parts()[i])));
    for (name, at) in [("p50", 0), ("p99", 1)] {
        print(name, columns.map(|column| column[at]));
    }
}

fn main() {
    let asked = std::env::args().filter_map(|arg| {
        let (hz, seconds) = arg.split_once(':')?;
        Some((hz.parse().ok()?, seconds.parse().ok()?))
    });
    let asked: Vec<(f64, f64)> = asked.collect();
    let all = if asked.is_empty() { &TRIED[..] } else { &asked };
    let ring = ring(&decoded());
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
        let Outcome { skipped, lost, latencies, cpu } = tried(&rig, (hz, seconds), &ring, place.path());
        let [p50, p99, max] = p50_p99_max(latencies.values().map(|latency| latency.all));
        println!("{hz:>6} {seconds:>6} {skipped:>8} {lost:>6} {p50:>7.2} {p99:>7.2} {max:>7.2} {cpu:>6.2}");
        slowest.get_or_insert((hz, latencies));
    }
    if let Some((hz, latencies)) = slowest {
        print_slowest(hz, &latencies);
    }
}
