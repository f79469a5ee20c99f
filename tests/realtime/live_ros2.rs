//! `catoptra live --ros2`: another implementation of DDS, Eclipse Cyclone DDS, gets every frame in order, with the
//! log's numbers.
//!
//! 10 seconds at 60 Hz; with `CATOPTRA_MINUTE=1` a minute.

use crate::support::command::*;
use crate::support::python::interpreter_with;
use serde_json::Value;
use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

const PERIOD: Duration = Duration::from_nanos(16_666_667);
/// Pictures that are shown to and fro.
const PICTURES: usize = 40;

/// The first pictures of a sample as NV12.
fn pictures() -> Vec<Vec<u8>> {
    let mut source = catoptra::source::open(sample("planar.mkv"), Default::default()).unwrap();
    let picture = |_| {
        let frame = source.next_frame().unwrap().unwrap();
        let plane = |k: usize| {
            let plane = frame.picture.plane(k).unwrap();
            let row = |y: usize| plane.row(y).unwrap().iter().step_by(plane.step).take(plane.width).copied();
            (0..plane.height).flat_map(|y| row(y).collect::<Vec<u8>>()).collect::<Vec<u8>>()
        };
        let mut bytes = plane(0);
        bytes.extend(plane(1).into_iter().zip(plane(2)).flat_map(|(u, v)| [u, v]));
        bytes
    };
    (0..PICTURES).map(picture).collect()
}

fn ns(stamp: &Value) -> i64 {
    stamp["sec"].as_i64().unwrap() * 1_000_000_000 + stamp["nanosec"].as_i64().unwrap()
}

#[test]
fn another_implementation_of_dds_gets_every_frame_in_its_order() {
    let Some(python) = interpreter_with(&["cyclonedds.domain", "mcap.reader"]) else { return };
    let place = Place::new();
    // Definitions for the listener.
    ended_with(&place.track(&sample("planar.mkv"), &["--to", "0", "--profile", "ros2"]), 0);
    let domain = (std::process::id() % 90 + 5).to_string();
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/python/ros2_listen.py");
    let mut listener = Command::new(python)
        .arg(script)
        .arg(place.path("out/log.mcap"))
        .args([&domain, "--send-currents"])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut heard = BufReader::new(listener.stdout.take().unwrap());

    let [width, height] = rig().camera.size_px;
    let mut live = Command::new(env!("CARGO_BIN_EXE_catoptra"))
        .current_dir(place.folder.path())
        .args(["live", "-", "--raw", &format!("{width}x{height}:nv12@60"), "-o", "live", "--rig"])
        .arg(&place.rig)
        .args(["--ros2", "--domain", &domain, "--currents", "ros2:/amplifier/joint_states"])
        .stdin(Stdio::piped())
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut line = String::new();
    heard.read_line(&mut line).unwrap();
    assert_eq!(line, "matched\n");
    let pictures = pictures();
    let seconds = if std::env::var_os("CATOPTRA_MINUTE").is_some() { 60 } else { 10 };
    let mut pipe = live.stdin.take().unwrap();
    let began = Instant::now();
    for k in 0..seconds * 60 {
        std::thread::sleep((PERIOD * k as u32).saturating_sub(began.elapsed()));
        let phase = k % (2 * PICTURES - 2);
        pipe.write_all(&pictures[phase.min(2 * PICTURES - 2 - phase)]).unwrap();
    }
    drop(pipe);
    let output = live.wait_with_output().unwrap();
    let printed = stderr(&output);
    assert!(matches!(output.status.code(), Some(0 | 3)), "{printed}");
    drop(listener.stdin.take());
    let mut text = String::new();
    heard.read_to_string(&mut text).unwrap();
    assert!(listener.wait().unwrap().success());
    let heard: Value = serde_json::from_str(&text).unwrap();
    let messages = |topic: &str| heard["received"][topic].as_array().unwrap();

    // Every frame, in its order, by both clocks.
    let log = catoptra::series::Recording::read(&place.path("live/log.mcap")).unwrap();
    assert_eq!(log.frames.len(), seconds * 60);
    let by_host: Vec<i64> = log.frames.iter().map(|frame| frame.host_ns.unwrap()).collect();
    let by_camera: Vec<i64> = log.frames.iter().map(|frame| frame.stamp_ns).collect();
    let stamps = |topic: &str| messages(topic).iter().map(|m| ns(&m["header"]["stamp"])).collect::<Vec<_>>();
    assert_eq!(stamps("/catheter/deflection").len(), by_host.len());
    assert!(stamps("/catheter/deflection") == by_host, "stamps differ");
    assert!(stamps("/camera/time_reference") == by_host, "stamps differ");
    let camera: Vec<i64> = messages("/camera/time_reference").iter().map(|m| ns(&m["time_ref"])).collect();
    assert!(camera == by_camera, "the camera's stamps differ");

    // With the numbers of the log.
    for (frame, message) in log.frames.iter().zip(messages("/catheter/deflection")) {
        assert_eq!(message["position"][0].as_f64(), frame.theta_rad, "frame {}", frame.seq);
    }
    for (index, name) in log.markers.iter().enumerate() {
        let topic = format!("/catheter/{name}/pose");
        let known: Vec<_> = log.frames.iter().filter_map(|f| Some((f.host_ns?, f.places[index].point?))).collect();
        assert_eq!(messages(&topic).len(), known.len(), "{topic}");
        for (message, (host_ns, point)) in messages(&topic).iter().zip(&known) {
            assert_eq!(ns(&message["header"]["stamp"]), *host_ns);
            let position = &message["pose"]["pose"]["position"];
            assert_eq!(["x", "y", "z"].map(|axis| position[axis].as_f64().unwrap()), [point.x, point.y, point.z]);
        }
        println!("{topic}: {} of {} frames", known.len(), log.frames.len());
    }
    assert_eq!(messages("/tf_static").len(), 1);
    assert!(messages("/diagnostics").len() >= seconds - 1, "{} diagnostics", messages("/diagnostics").len());
    assert!(messages("/catheter/markers").len() == by_host.len());

    // Currents came in, and went out again.
    let sent = heard["sent"].as_u64().unwrap() as usize;
    assert!(log.currents.len() > seconds * 10 && log.currents.len() <= sent, "{} of {sent}", log.currents.len());
    let first = log.currents[0].values_a[0] * 8.0;
    for (k, current) in log.currents.iter().enumerate() {
        assert_eq!(current.values_a, [(first + k as f64) % 64.0 / 8.0, -0.5]);
    }
    let efforts = messages("/coil/joint_states").iter().map(|message| message["effort"].clone());
    let efforts: Vec<Vec<f64>> = efforts.map(|effort| serde_json::from_value(effort).unwrap()).collect();
    let logged: Vec<_> = log.currents.iter().map(|current| current.values_a.clone()).collect();
    assert!(logged.starts_with(&efforts) && efforts.len() >= logged.len() - 1, "{efforts:?}\n{logged:?}");
    println!("{} frames, {} currents of {sent}", log.frames.len(), log.currents.len());
}
