//! A live run as other programs see it: its topics by a Python WebSocket client, its datagrams, its log by Python's
//! `mcap`, and the table of the same recording tracked offline.

use crate::support::command::*;
use crate::support::python;
use std::net::{TcpListener, UdpSocket};
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Duration;

#[test]
fn subscribers_controllers_log_and_table_say_the_same() {
    let Some(interpreter) = python::interpreter() else { return };
    let place = Place::new();
    let port = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let controller = UdpSocket::bind("127.0.0.1:0").unwrap();
    let address = controller.local_addr().unwrap().to_string();
    // Read as they come: the system keeps some hundred for who is late.
    controller.set_read_timeout(Some(Duration::from_secs(8))).unwrap();
    let received = std::thread::spawn(move || {
        let mut bytes = [0; 4096];
        let next = || controller.recv(&mut bytes).ok().map(|length| serde_json::from_slice(&bytes[..length]).unwrap());
        std::iter::from_fn(next).collect::<Vec<serde_json::Value>>()
    });

    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/python/subscribe.py");
    let subscriber = Command::new(interpreter.as_str())
        .arg(script)
        .arg(format!("ws://127.0.0.1:{port}"))
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let live = Command::new(env!("CARGO_BIN_EXE_catoptra"))
        .current_dir(place.folder.path())
        .arg("live")
        .arg(sample("planar.mkv"))
        .args(["--realtime", "--duration", "4", "-o", "out", "--rig"])
        .arg(&place.rig)
        .args(["--publish", &format!("127.0.0.1:{port}"), "--udp", &address])
        .output()
        .unwrap();
    assert!(live.status.success(), "{}", String::from_utf8_lossy(&live.stderr));

    // The log, whole and equal to the table, by someone else's code.
    let (log, table) = (place.path("out/log.mcap"), place.path("out/track.csv"));
    let printed = python::agreed(&python::compare(&interpreter, &log, &table, "base"));
    assert!(printed.contains("\"clock\": \"container\""), "{printed}");
    let rows = place.table().rows;
    let seqs: Vec<usize> = rows.iter().map(|row| row["seq"].parse().unwrap()).collect();
    assert_eq!(seqs, (0..rows.len()).collect::<Vec<_>>());
    assert!(rows.len() > 100, "{} frames in four seconds", rows.len());

    // Every frame was sent as a datagram.
    let received = received.join().unwrap();
    assert_eq!(received.len(), rows.len());
    for (sent, row) in received.iter().zip(&rows) {
        assert_eq!(sent["seq"].to_string(), row["seq"]);
        match row["theta_deg"].parse::<f64>() {
            Ok(theta_deg) => assert!((sent["theta_deg"].as_f64().unwrap() - theta_deg).abs() < 1e-6, "{sent}"),
            Err(_) => assert!(sent["theta_deg"].is_null() && sent["status"] != "ok", "{sent}"),
        }
        assert!(sent["host_ns"].as_i64().unwrap() > 1_600_000_000_000_000_000);
    }

    // The subscriber joined some time after the start and has everything from then on.
    let output = subscriber.wait_with_output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let got: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!((&got["counts"]["/tf"], &got["counts"]["/camera/calibration"]), (&1.into(), &1.into()));
    let angles = got["angles"].as_array().unwrap();
    assert!(!angles.is_empty());
    for angle in angles {
        let row = &rows[angle[0].as_u64().unwrap() as usize];
        match angle[1].as_f64() {
            Some(theta) => assert!((theta.to_degrees() - row["theta_deg"].parse::<f64>().unwrap()).abs() < 1e-6),
            None => assert_eq!(row["theta_deg"], ""),
        }
    }

    // Tracked again offline, frames that were not passed over give the same numbers, if none before them was.
    let offline = Command::new(env!("CARGO_BIN_EXE_catoptra"))
        .current_dir(place.folder.path())
        .arg("track")
        .arg(sample("planar.mkv"))
        .args(["--to", "0.5", "-o", "offline", "--rig"])
        .arg(&place.rig)
        .output()
        .unwrap();
    ended_with(&offline, 0);
    let whole = rows.iter().take_while(|row| row["coil_status"] != "skipped_overload");
    let offline = Table::read(&place.path("offline/track.csv"));
    for (live, offline) in whole.zip(&offline.rows) {
        assert_eq!(live, offline);
    }
}
