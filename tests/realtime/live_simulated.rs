//! `catoptra live sim:…`: a simulated camera keeps its pace or loses frames as a camera does, and is tracked to its
//! truth; with the currents of a list of the laboratory's amplifier.

use catoptra::series::Recording;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::time::Duration;

fn rig() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("calibration/dev_tank/rig.toml")
}

fn catoptra(folder: &Path, args: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_catoptra"));
    command.current_dir(folder).args(args).arg("--rig").arg(rig()).output().unwrap()
}

fn good(output: &Output) {
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

/// Each stamp is as many frames after the one before as were lost, and one.
fn all_accounted_for(run: &Recording, interval_ns: f64) -> u64 {
    for pair in run.frames.windows(2) {
        let frames = ((pair[1].stamp_ns - pair[0].stamp_ns) as f64 / interval_ns).round() as u64;
        assert_eq!(frames, pair[1].gap + 1, "at {} ns", pair[1].stamp_ns);
    }
    run.frames.iter().map(|frame| frame.gap).sum()
}

#[test]
fn a_simulated_camera_is_tracked_to_the_truth_of_the_recording_and_logs_a_list_of_currents() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("i.play"), "1, 0, 200\r\n3, 40, 300\r\n2, -10, 0\r\n3, 0, 0\r\n").unwrap();
    let rate = ["--fps", "8"];
    let live = ["live", "sim:planar", "--duration", "3", "--currents", "i.play", "-o", "live"];
    good(&catoptra(folder.path(), &[&live[..], &rate].concat()));
    let recorded = ["simulate", "--motion", "planar", "--duration", "3s", "--codec", "ffv1", "-o", "recorded"];
    good(&catoptra(folder.path(), &[&recorded[..], &rate].concat()));
    let run = Recording::read(&folder.path().join("live/log.mcap")).unwrap();
    let truth = Recording::read(&folder.path().join("recorded/truth.csv")).unwrap();
    assert_eq!(run.clock.as_deref(), Some("device"));
    let lost = all_accounted_for(&run, 1e9 / 8.0);
    // The run's time begins before the first picture is rendered.
    assert!(run.frames.len() as u64 + lost >= 8, "{} frames, {lost} lost", run.frames.len());
    let mut compared = 0;
    for frame in &run.frames {
        let Some(exact) = truth.frames.iter().find(|exact| exact.stamp_ns == frame.stamp_ns) else { continue };
        for (a, b) in exact.places.iter().zip(&frame.places) {
            let (Some(a), Some(b)) = (a.point, b.point) else { continue };
            assert!((a - b).norm() < 0.05e-3, "{} ns: {:.3} mm", frame.stamp_ns, (a - b).norm() * 1e3);
            compared += 1;
        }
    }
    assert!(compared > 15, "{compared} places");
    let currents: Vec<Vec<f64>> = run.currents.iter().map(|current| current.values_a.clone()).collect();
    assert_eq!(currents, [[0.0; 3], [0.0, 0.0, 0.04], [0.0, -0.01, 0.0]]);
    let apart = |k: usize| run.currents[k].host_ns.unwrap() - run.currents[k - 1].host_ns.unwrap();
    assert_eq!((apart(1), apart(2)), (200_000_000, 300_000_000));
}

#[test]
fn a_live_run_is_collected_like_any_other() {
    let folder = tempfile::tempdir().unwrap();
    good(&catoptra(folder.path(), &["live", "sim:rest", "--duration", "2s", "--fps", "8", "-o", "live"]));
    let text = std::fs::read_to_string(folder.path().join("live/summary.json")).unwrap();
    let summary: serde_json::Value = serde_json::from_str(&text).unwrap();
    assert_eq!((&summary["outcome"], &summary["name"]), (&"tracked".into(), &"live".into()));
    assert_eq!(summary["recording"], "sim:rest");
    assert!(summary["sha256"]["recording"].is_null() && summary["sha256"]["rig"].is_string(), "{text}");
    let mut collect = Command::new(env!("CARGO_BIN_EXE_catoptra"));
    let collected = collect.current_dir(folder.path()).args(["collect", "live", "-o", "study"]).output().unwrap();
    good(&collected);
    let said = String::from_utf8(collected.stdout).unwrap();
    let frames = summary["measured"]["frames"].as_u64().unwrap();
    assert!(frames > 1 && said.starts_with(&format!("1 run, {frames} frames")), "{said}");
}

#[test]
fn a_run_whose_currents_are_lost_goes_on_and_has_failed() {
    let folder = tempfile::tempdir().unwrap();
    let table = folder.path().join("i.csv");
    std::fs::write(&table, "host_ns,i1_a\n").unwrap();
    let live = ["live", "sim:rest", "--duration", "3", "--fps", "8", "--currents", "file:i.csv", "-o", "live"];
    let output = std::thread::scope(|scope| {
        let run = scope.spawn(|| catoptra(folder.path(), &live));
        while !folder.path().join("live/log.mcap").exists() && !run.is_finished() {
            std::thread::sleep(Duration::from_millis(20));
        }
        let other = folder.path().join("other.csv");
        std::fs::write(&other, "host_ns,i1_a\n").unwrap();
        std::fs::rename(&other, &table).unwrap();
        run.join().unwrap()
    });
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(1), "{said}");
    assert!(said.contains("another file has taken the place") && said.contains("the currents were lost"), "{said}");
    let summary = std::fs::read_to_string(folder.path().join("live/summary.json")).unwrap();
    assert!(summary.contains("the currents were lost"), "{summary}");
    assert!(Recording::read(&folder.path().join("live/log.mcap")).unwrap().frames.len() > 8);
}

#[test]
fn frames_that_cannot_be_rendered_in_time_are_lost_and_counted() {
    let folder = tempfile::tempdir().unwrap();
    good(&catoptra(
        folder.path(),
        &["live", "sim:rest", "--duration", "6", "--fps", "2000", "--exposure", "0.1", "-o", "live"],
    ));
    let run = Recording::read(&folder.path().join("live/track.csv")).unwrap();
    let lost = all_accounted_for(&run, 5e5);
    // No processor renders two thousand of these per second.
    assert!(run.frames.len() > 20 && lost > 2000, "{} frames, {lost} lost", run.frames.len());
}

#[test]
fn what_cannot_be_simulated_is_told() {
    let folder = tempfile::tempdir().unwrap();
    for (args, what) in [
        (&["live", "sim:jump"][..], "motion jump: is neither rest, planar, circle nor lemniscate, and no such file"),
        (&["live", "sim:rest", "--gain", "2"], "--gain is for real cameras"),
        (&["live", "sim:rest", "--fps", "2000"], "is longer than a frame at 2000 Hz"),
        (&["live", "sim:rest", "--currents", "none.play"], "none.play"),
    ] {
        let output = catoptra(folder.path(), args);
        let printed = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(2), "{printed}");
        assert!(printed.contains(what), "{what:?} is not in {printed}");
        assert!(!folder.path().join("live-1").exists(), "nothing was written");
    }
}
