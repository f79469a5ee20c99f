//! A GigE Vision camera with frames of the sample: Aravis' own fake camera, on the loopback interface.
#![cfg(feature = "genicam")]
#![allow(unsafe_code, reason = "the binding does not offer the fake camera's own pictures")]

use crate::support::command::{Place, Table, sample};
use aravis::glib::object::ObjectType as _;
use catoptra::source::host::HostClock;
use catoptra::source::live::{Camera, CameraSettings, RawPictures};
use catoptra::source::{Clock, Frame, FrameSource, Picture, VideoFile, VideoOptions};
use std::ffi::c_void;
use std::process::Command;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, LazyLock, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

const SIZE: [usize; 2] = [1280, 1024];
const NAME: &str = "Aravis-Fake-CATOPTRA";

/// A GigE camera answers at one port of the only loopback interface: one at a time.
static PORT: Mutex<()> = Mutex::new(());

/// The sample's first frames, as a colour sensor with an RG mosaic would send them.
static MOSAICS: LazyLock<Vec<Vec<u8>>> = LazyLock::new(|| {
    let mut recording = VideoFile::open(sample("planar.mkv"), VideoOptions::default()).unwrap();
    (0..8).map(|_| mosaic(&recording.next_frame().unwrap().unwrap().picture)).collect()
});

fn mosaic(picture: &Picture) -> Vec<u8> {
    let planes = [0, 1, 2].map(|i| picture.plane(i).unwrap());
    let map = picture.rgb_from_stored().unwrap();
    let at = |x: usize, y: usize| {
        let stored = [0, 1, 2].map(|i| {
            let plane = planes[i];
            let [x, y] = [x / plane.scale[0] as usize, y / plane.scale[1] as usize];
            f64::from(plane.row(y).unwrap()[x * plane.step])
        });
        map.apply(&stored.into())[[0, 1, 1, 2][2 * (y % 2) + x % 2]].round().clamp(0.0, 255.0) as u8
    };
    (0..SIZE[1]).flat_map(|y| (0..SIZE[0]).map(move |x| (x, y))).map(|(x, y)| at(x, y)).collect()
}

/// How many pictures were filled in.
static FILLED: AtomicUsize = AtomicUsize::new(0);

unsafe extern "C" {
    fn arv_fake_camera_set_fill_pattern(
        camera: *mut c_void,
        fill: Option<unsafe extern "C" fn(*mut c_void, *mut c_void, u32, u32, u32)>,
        data: *mut c_void,
    );
    fn arv_fake_camera_get_payload(camera: *mut c_void) -> usize;
    fn arv_buffer_get_data(buffer: *mut c_void, size: *mut usize) -> *mut u8;
}

/// Called by the fake camera for each picture; its buffer is as long as its payload, though it does not say so yet.
unsafe extern "C" fn fill(buffer: *mut c_void, camera: *mut c_void, _exposure_us: u32, _gain: u32, _format: u32) {
    let picture = &MOSAICS[FILLED.fetch_add(1, Ordering::Relaxed) % MOSAICS.len()];
    // SAFETY: buffer and camera are Aravis' own and live while this function runs; no more is written than the buffer
    // holds.
    unsafe {
        let size = arv_fake_camera_get_payload(camera).min(picture.len());
        let data = arv_buffer_get_data(buffer, std::ptr::null_mut());
        std::ptr::copy_nonoverlapping(picture.as_ptr(), data, size);
    }
}

fn fake() -> aravis::GvFakeCamera {
    LazyLock::force(&MOSAICS);
    let camera = aravis::GvFakeCamera::new(Some("127.0.0.1"), Some("CATOPTRA"));
    assert!(camera.is_running());
    let inner = camera.fake_camera().unwrap();
    let pointer: *mut c_void = inner.as_ptr().cast::<c_void>();
    // SAFETY: the camera lives as long as it may call the function.
    unsafe { arv_fake_camera_set_fill_pattern(pointer, Some(fill), pointer) };
    camera
}

fn alone() -> MutexGuard<'static, ()> {
    PORT.lock().unwrap_or_else(PoisonError::into_inner)
}

fn settings() -> CameraSettings {
    CameraSettings {
        size_px: SIZE.map(|n| n as u32),
        rate: Some("60".parse().unwrap()),
        exposure_s: Some(0.008),
        gain: Some(2.0),
        format: Some("bayer_rg8".to_owned()),
    }
}

fn open(stop: &Arc<AtomicBool>) -> Camera {
    Camera::genicam(NAME, settings(), HostClock::start(), Arc::clone(stop)).unwrap()
}

fn next(camera: &mut Camera) -> Frame {
    camera.next_frame().unwrap().unwrap()
}

fn bytes(picture: &Picture) -> Vec<u8> {
    let plane = picture.plane(0).unwrap();
    (0..plane.height).flat_map(|j| plane.row(j).unwrap().to_vec()).collect()
}

/// Each of the mosaics as it is read from a pipe.
fn expected() -> Vec<Vec<u8>> {
    let pipe = Box::new(std::io::Cursor::new(MOSAICS.concat()));
    let format = "1280x1024:bayer_rg8@60".parse().unwrap();
    let mut source = RawPictures::new("mosaics", pipe, format, HostClock::start());
    MOSAICS.iter().map(|_| bytes(&source.next_frame().unwrap().unwrap().picture)).collect()
}

#[test]
fn pictures_of_a_gige_camera_arrive_to_the_last_bit_with_its_own_stamps_and_none_unaccounted_for() {
    let _alone = alone();
    let _fake = fake();
    let stop = Arc::default();
    let mut camera = open(&stop);
    assert_eq!(camera.size_px(), [1280, 1024]);
    let expected = expected();
    let frames: Vec<Frame> = (0..60).map(|_| next(&mut camera)).collect();
    let first = expected.iter().position(|p| *p == bytes(&frames[0].picture)).unwrap();
    let mut number = first;
    for (k, frame) in frames.iter().enumerate() {
        number += if k == 0 { 0 } else { 1 + frame.gap as usize };
        assert!(expected[number % expected.len()] == bytes(&frame.picture), "frame {k} is not picture {number}");
        assert_eq!((frame.seq, frame.stamp.clock), (k as u64, Clock::Device));
        let host = frame.host.unwrap();
        assert!(host.stamp_ns <= host.arrival_ns);
    }
    let steps_ns = frames.windows(2).map(|two| (two[1].stamp.ns - two[0].stamp.ns) / i64::from(1 + two[1].gap));
    let mut steps_ns: Vec<i64> = steps_ns.collect();
    steps_ns.sort_unstable();
    assert!((steps_ns[30] - 16_666_667).abs() < 500_000, "{} ns from frame to frame", steps_ns[30]);
    assert_eq!(camera.faults().interruptions, 0);
}

#[test]
fn a_picture_with_packets_missing_is_left_out_and_counted_as_lost() {
    let _alone = alone();
    let fake = fake();
    let stop = Arc::default();
    let mut camera = open(&stop);
    next(&mut camera);
    let before = camera.faults().pictures_left_out;
    fake.set_gvsp_lost_ratio(0.0003);
    let mut lost = 0;
    for _ in 0..40 {
        lost += u64::from(next(&mut camera).gap);
    }
    let left_out = camera.faults().pictures_left_out - before;
    assert!(left_out > 0 && lost >= left_out, "{left_out} left out, {lost} lost");
}

#[test]
fn a_camera_that_goes_and_comes_back_is_taken_up_again_and_a_silent_one_can_be_stopped() {
    let _alone = alone();
    let first = fake();
    let stop = Arc::new(AtomicBool::new(false));
    let mut camera = open(&stop);
    let last = (0..5).map(|_| next(&mut camera).seq).last().unwrap();
    drop(first);
    let back = std::thread::spawn(move || {
        std::thread::sleep(Duration::from_secs(3));
        fake()
    });
    let mut frame = next(&mut camera);
    while camera.faults().interruptions == 0 {
        frame = next(&mut camera);
    }
    assert!(frame.seq > last && frame.gap == 0);
    drop(back.join().unwrap());
    let setter = std::thread::spawn(move || {
        std::thread::sleep(Duration::from_millis(700));
        stop.store(true, Ordering::Relaxed);
    });
    while camera.next_frame().unwrap().is_some() {}
    setter.join().unwrap();
}

#[test]
fn what_is_wrong_with_a_camera_is_said_before_the_run() {
    let _alone = alone();
    let _fake = fake();
    let refused = |id: &str, settings: CameraSettings| {
        Camera::genicam(id, settings, HostClock::start(), Arc::default()).unwrap_err().to_string()
    };
    let error = refused("Nobody-1", settings());
    assert!(error.contains("genicam:Nobody-1") && error.contains(NAME), "{error}");
    let error = refused(NAME, CameraSettings { format: Some("Mono8".to_owned()), ..settings() });
    assert!(error.contains("no colours") && error.contains("BayerRG8"), "{error}");
}

#[test]
fn the_command_tracks_a_gige_camera_and_warns_of_what_it_does_otherwise() {
    let _alone = alone();
    let _fake = fake();
    let place = Place::new();
    let mut command = Command::new(env!("CARGO_BIN_EXE_catoptra"));
    command.current_dir(place.folder.path()).args(["live", "genicam:", "-o", "out", "--duration", "3", "--rig"]);
    command.arg(&place.rig).args(["--fps", "30", "--format", "BayerRG8", "--exposure", "8", "--gain", "1e12"]);
    let output = command.output().unwrap();
    let printed = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{printed}");
    assert!(printed.contains("gain: ") && !printed.contains("exposure: "), "{printed}");
    let table = Table::read(&place.path("out/track.csv"));
    assert!(table.rows.len() > 40, "{} rows\n{printed}", table.rows.len());
}

/// CPU seconds and resident megabytes of a process, now.
fn usage(pid: u32) -> Option<(f64, f64)> {
    let stat = std::fs::read_to_string(format!("/proc/{pid}/stat")).ok()?;
    let fields: Vec<&str> = stat.rsplit_once(')')?.1.split_whitespace().collect();
    let ticks: f64 = fields.get(11)?.parse::<f64>().ok()? + fields.get(12)?.parse::<f64>().ok()?;
    let pages: f64 =
        std::fs::read_to_string(format!("/proc/{pid}/statm")).ok()?.split_whitespace().nth(1)?.parse().ok()?;
    Some((ticks / 100.0, pages * 4096.0 * 1e-6))
}

/// Frames sent and rows, latency, CPU and memory at 60 Hz for `CATOPTRA_SECONDS` (120):
/// `CATOPTRA_BIN=target/release/catoptra cargo test --features genicam --test realtime genicam:: -- --ignored
/// --nocapture`.
#[test]
#[ignore = "a measurement of minutes"]
fn sixty_hertz_for_minutes() {
    let _alone = alone();
    let _fake = fake();
    let seconds: u64 = std::env::var("CATOPTRA_SECONDS").ok().and_then(|n| n.parse().ok()).unwrap_or(120);
    let receiver = std::net::UdpSocket::bind("127.0.0.1:0").unwrap();
    receiver.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
    let address = receiver.local_addr().unwrap().to_string();
    let received = std::thread::spawn(move || {
        let (mut bytes, mut at) = ([0; 4096], std::collections::BTreeMap::new());
        while let Ok(length) = receiver.recv(&mut bytes) {
            let now = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap();
            let datagram: serde_json::Value = serde_json::from_slice(&bytes[..length]).unwrap();
            at.insert(datagram["seq"].as_u64().unwrap(), now.as_nanos() as i64);
        }
        at
    });
    let place = Place::new();
    let before = FILLED.load(Ordering::Relaxed);
    let program = std::env::var("CATOPTRA_BIN").unwrap_or_else(|_| env!("CARGO_BIN_EXE_catoptra").to_owned());
    let mut live = Command::new(std::path::Path::new(&program).canonicalize().unwrap())
        .current_dir(place.folder.path())
        .args(["live", &format!("genicam:{NAME}"), "-o", "out", "--duration", &seconds.to_string(), "--rig"])
        .arg(&place.rig)
        .args(["--fps", "60", "--format", "BayerRG8", "--udp", &address])
        .spawn()
        .unwrap();
    let (mut memory, mut cpu) = (Vec::new(), 0.0);
    while live.try_wait().unwrap().is_none() {
        if let Some((seconds, megabytes)) = usage(live.id()) {
            cpu = seconds;
            memory.push(megabytes);
        }
        std::thread::sleep(Duration::from_secs(1));
    }
    let sent = FILLED.load(Ordering::Relaxed) - before;
    let received = received.join().unwrap();
    let bytes = std::fs::read(place.path("out/log.mcap")).unwrap();
    let (mut rows, mut lost, mut skipped, mut latency_ms) = (0, 0, 0, Vec::new());
    for message in mcap::MessageStream::new(&bytes).unwrap().map(Result::unwrap) {
        if message.channel.topic == "/catheter/estimate" {
            let schema = message.channel.schema.clone().unwrap();
            let pool = prost_reflect::DescriptorPool::decode(schema.data.as_ref()).unwrap();
            let descriptor = pool.get_message_by_name(&schema.name).unwrap();
            let estimate = prost_reflect::DynamicMessage::decode(descriptor, message.data.as_ref()).unwrap();
            rows += 1;
            lost += estimate.get_field_by_name("gap").unwrap().as_u32().unwrap();
            let status = estimate.get_field_by_name("deflection_status").unwrap();
            let word = status.as_message().unwrap().get_field_by_name("word").unwrap().as_str().unwrap().to_owned();
            skipped += u32::from(word == "skipped_overload");
            let arrival_ns = estimate.get_field_by_name("arrival_ns").unwrap().as_i64().unwrap();
            if let Some(at) = received.get(&u64::from(message.sequence)).filter(|_| word == "ok") {
                latency_ms.push((at - arrival_ns) as f64 * 1e-6);
            }
        }
    }
    latency_ms.sort_by(f64::total_cmp);
    let at = |share: f64| latency_ms[((share * latency_ms.len() as f64) as usize).min(latency_ms.len() - 1)];
    println!("frames sent {sent}, rows {rows} (skipped {skipped}), lost {lost}, datagrams {}", received.len());
    println!("arrival to θ at the receiver: p50 {:.2} ms, p99 {:.2} ms, max {:.2} ms", at(0.5), at(0.99), at(1.0));
    println!("CPU {:.0} % of one core", 100.0 * cpu / seconds as f64);
    let tenth = (memory.len() / 10).max(1);
    println!("memory {:.0} MB after a tenth, {:.0} MB in the end", memory[tenth], memory[memory.len() - 2]);
    assert!(sent.abs_diff(rows + lost as usize) <= 3, "{sent} sent, {rows} rows, {lost} lost");
}
