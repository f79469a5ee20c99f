//! `catoptra simulate` and `catoptra plan` from end to end: rendered recordings are tracked to their truth, boards
//! calibrate to the rig they were drawn with, the same seed gives the same files, and what cannot be seen is reported.

use catoptra::rig::Rig;
use catoptra::series::Recording;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

fn sample_rig() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("calibration/dev_tank/rig.toml")
}

fn bench_rig() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/rigs/paper_bench.toml")
}

fn catoptra(folder: &Path, args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_catoptra")).current_dir(folder).args(args).output().unwrap()
}

fn good(output: &Output) -> String {
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8_lossy(&output.stdout).into_owned()
}

fn simulate(folder: &Path, rig: &Path, args: &[&str]) -> Output {
    catoptra(folder, &[&["simulate", "--rig", rig.to_str().unwrap()], args].concat())
}

fn refused(output: &Output, what: &str) {
    let printed = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{printed}");
    assert!(printed.contains(what), "{what:?} is not in {printed}");
}

/// Errors over their σ, squared, and the largest error of a marker (metres).
fn compared(truth: &Path, table: &Path) -> (Vec<f64>, f64, usize) {
    let (truth, run) = (Recording::read(truth).unwrap(), Recording::read(table).unwrap());
    let (mut normalised, mut worst_m, mut count) = (Vec::new(), 0.0_f64, 0);
    assert_eq!(truth.frames.len(), run.frames.len());
    for (exact, found) in truth.frames.iter().zip(&run.frames) {
        assert_eq!(exact.stamp_ns, found.stamp_ns, "seq {}", exact.seq);
        for (a, b) in exact.places.iter().zip(&found.places) {
            let (Some(a), Some(b), Some(sd_m)) = (a.point, b.point, b.sd_m) else { continue };
            normalised.push((a - b).norm_squared() / 3.0 / sd_m.powi(2));
            worst_m = worst_m.max((a - b).norm());
            count += 1;
        }
        if let (Some(a), Some(b), Some(sd)) = (exact.theta_rad, found.theta_rad, found.theta_sd_rad) {
            normalised.push(((a - b) / sd).powi(2));
        }
    }
    (normalised, worst_m, count)
}

/// With lost and uneven frames: every stamp of the truth is that of a row, to the nanosecond.
#[test]
fn what_is_rendered_is_tracked_to_its_truth() {
    for (rig, codec, worst_mm) in [(sample_rig(), "ffv1", 0.05), (bench_rig(), "h264", 0.15)] {
        let folder = tempfile::tempdir().unwrap();
        let args = ["--motion", "planar", "--duration", "0.6s", "--codec", codec, "--jitter", "2ms", "--lost", "10"];
        good(&simulate(folder.path(), &rig, &[&args[..], &["-o", "sim"]].concat()));
        let track = ["track", "sim/recording.mkv", "--rig", "sim/rig.toml", "-o", "out"];
        good(&catoptra(folder.path(), &track));
        let (normalised, worst_m, count) =
            compared(&folder.path().join("sim/truth.csv"), &folder.path().join("out/track.csv"));
        let mean = normalised.iter().sum::<f64>() / normalised.len() as f64;
        // Measured: 0.1 to 0.9; the tracker allows for coders and clamps that are worse.
        assert!(mean < 1.4, "{codec}: normalised squared error {mean}");
        assert!(worst_m < worst_mm * 1e-3 && count > 80, "{codec}: {} mm, {count} places", worst_m * 1e3);
    }
}

/// A coder takes the noise out of what rests, and errs again once it moves: no frame is refused for that.
#[test]
fn a_step_after_a_rest_is_tracked_in_a_coded_video() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("step.csv"), "t_s,x_a,y_a,z_a\n0.5,0,0,0.03\n").unwrap();
    let args = ["--motion", "step.csv", "--fps", "60Hz", "--duration", "1.2s", "-o", "sim"];
    good(&simulate(folder.path(), &sample_rig(), &args));
    good(&catoptra(folder.path(), &["track", "sim/recording.mkv", "--rig", "sim/rig.toml", "-o", "out"]));
    let (normalised, _, count) = compared(&folder.path().join("sim/truth.csv"), &folder.path().join("out/track.csv"));
    let mean = normalised.iter().sum::<f64>() / normalised.len() as f64;
    assert!(count >= 3 * 70 && mean < 1.4, "{count} places of 216, normalised squared error {mean}");
}

#[test]
fn the_same_seed_gives_the_same_pictures_at_any_thread_count() {
    let folder = tempfile::tempdir().unwrap();
    let drawn = |threads: &str, seed: &str, out: &str| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_catoptra"));
        let command = command.current_dir(folder.path()).env("RAYON_NUM_THREADS", threads);
        let command = command.args(["simulate", "--rig"]).arg(sample_rig());
        let args = ["--motion", "circle", "--duration", "50ms", "--codec", "png", "--bayer", "--distractors", "5"];
        good(&command.args(args).args(["--seed", seed, "-o", out]).output().unwrap());
        let file = |name: &str| fs::read(folder.path().join(out).join(name)).unwrap();
        ["000000.png", "000002.png", "times.csv", "truth.csv"].map(file)
    };
    let one = drawn("1", "3", "a");
    assert!(one == drawn("2", "3", "b"));
    assert!(one[0] != drawn("2", "4", "c")[0]);
}

#[test]
fn boards_calibrate_to_the_rig_they_were_drawn_with() {
    let folder = tempfile::tempdir().unwrap();
    good(&simulate(folder.path(), &sample_rig(), &["--boards", "9", "-o", "boards"]));
    let names = |set: &str| (0..9).map(|k| format!("boards/{set}{k:03}.png")).collect::<Vec<_>>();
    let (air, tank) = (names("air"), names("rig"));
    let board = ["--board", "9x6:12mm"];
    let run = |verb: &str, pictures: &[String], more: &[&str]| {
        let pictures: Vec<&str> = pictures.iter().map(String::as_str).collect();
        good(&catoptra(folder.path(), &[&["calibrate", verb], &pictures[..], &board, more].concat()))
    };
    run("camera", &air, &["--out", "rig.toml"]);
    let doubted = |pictures: &[String]| {
        let pictures: Vec<&str> = pictures.iter().map(String::as_str).collect();
        let args = [&["calibrate", "camera"], &pictures[..], &board, &["--out", "other.toml"]].concat();
        let output = catoptra(folder.path(), &args);
        String::from_utf8_lossy(&output.stderr).contains("show the board twice")
    };
    assert!(doubted(&tank) && !doubted(&air));
    let known = ["--tank", "254x254x267mm", "--glass", "5mm", "--distance", "front_wall=1264mm:2mm"];
    run("rig", &tank, &[&["--rig", "rig.toml"], &known[..]].concat());
    let truth = Rig::load(&sample_rig()).unwrap();
    let found = catoptra::rig::Draft::load(&folder.path().join("rig.toml")).unwrap();
    let noted = |key: &str| found.provenance["rig"][key].as_array().unwrap().clone();
    let covariance = noted("covariance");
    for (k, name) in noted("parameters").iter().enumerate() {
        let sd = covariance[k].as_array().unwrap()[k].as_float().unwrap().sqrt();
        let name = name.as_str().unwrap();
        let error = match name {
            "focal_x_px" => found.camera.lens.focal_px.x - truth.camera.lens.focal_px.x,
            "focal_y_px" => found.camera.lens.focal_px.y - truth.camera.lens.focal_px.y,
            "principal_point_x_px" => found.camera.lens.principal_point_px.x - truth.camera.lens.principal_point_px.x,
            "principal_point_y_px" => found.camera.lens.principal_point_px.y - truth.camera.lens.principal_point_px.y,
            name if name.ends_with("_offset_m") => {
                let surface = name.trim_end_matches("_offset_m");
                found.surfaces[surface].plane().offset_m() - truth.surfaces[surface].plane().offset_m()
            }
            _ => continue,
        };
        assert!(error.abs() < 3.0 * sd, "{name}: {error} with σ {sd}");
    }
}

#[test]
fn poses_of_a_tracked_run_are_rendered_again() {
    let folder = tempfile::tempdir().unwrap();
    let args = ["--motion", "circle", "--duration", "0.1s", "--codec", "png", "-o", "first"];
    good(&simulate(folder.path(), &sample_rig(), &args));
    let again = ["--motion", "first/truth.csv", "--codec", "png", "-o", "second"];
    good(&simulate(folder.path(), &sample_rig(), &again));
    let (_, worst_m, count) = compared(&folder.path().join("first/truth.csv"), &folder.path().join("second/truth.csv"));
    assert!(worst_m < 1e-8 || count == 0, "{worst_m} m");
    let rate = simulate(folder.path(), &sample_rig(), &[&again[..4], &["--fps", "10", "-o", "third"]].concat());
    refused(&rate, "--fps: a tracked run is simulated at its own times");
    // Time that does not rise is refused.
    let text = fs::read_to_string(folder.path().join("first/truth.csv")).unwrap();
    let mut lines: Vec<&str> = text.lines().collect();
    lines.swap(2, 4);
    fs::write(folder.path().join("swapped.csv"), lines.join("\r\n") + "\r\n").unwrap();
    let output = simulate(folder.path(), &sample_rig(), &["--motion", "swapped.csv", "-o", "third"]);
    assert_eq!(output.status.code(), Some(2), "{}", String::from_utf8_lossy(&output.stderr));
}

/// Times of a clock begin with the first row; those from a start may not begin before it.
#[test]
fn currents_with_times_of_a_clock_move_the_catheter() {
    let folder = tempfile::tempdir().unwrap();
    let table = |name: &str, head: &str, times: [&str; 2]| {
        let text = format!("{head},x_a,y_a,z_a\n{},0.05,0,0.05\n{},0.05,0,0.05\n", times[0], times[1]);
        fs::write(folder.path().join(name), text).unwrap();
    };
    table("host.csv", "host_ns", ["1700000000000000000", "1700000000200000000"]);
    table("start.csv", "t_s", ["0", "0.2"]);
    table("early.csv", "t_s", ["-1", "0.2"]);
    let args = |file: &'static str, out: &'static str| {
        ["--motion", file, "--duration", "0.3s", "--fps", "10Hz", "--codec", "png", "-o", out]
    };
    for (file, out) in [("host.csv", "host"), ("start.csv", "start")] {
        good(&simulate(folder.path(), &sample_rig(), &args(file, out)));
    }
    let truth = |out: &str| fs::read_to_string(folder.path().join(out).join("truth.csv")).unwrap();
    assert_eq!(truth("host"), truth("start"));
    let last = truth("host").lines().last().unwrap().split(',').nth(3).unwrap().parse::<f64>().unwrap();
    assert!(last.abs() > 1.0, "{last}°");
    refused(&simulate(folder.path(), &sample_rig(), &args("early.csv", "early")), "its first row is at -1 s");
}

#[test]
fn what_cannot_be_seen_is_refused_with_the_reason() {
    let folder = tempfile::tempdir().unwrap();
    let bench = fs::read_to_string(bench_rig()).unwrap();
    let changed = |name: &str, from: &str, to: &str| {
        assert!(bench.contains(from), "{from}");
        let file = folder.path().join(name);
        fs::write(&file, bench.replace(from, to)).unwrap();
        file
    };
    let run = |rig: &Path| simulate(folder.path(), rig, &["--motion", "rest", "--duration", "20ms", "-o", "out"]);
    // The catheter before the tank.
    let outside = changed("outside.toml", "translation_mm = [-6100.0", "translation_mm = [-5900.0");
    refused(&run(&outside), "view `direct` shows nothing of the catheter at rest: it is outside of the tank");
    // A mirror turned away.
    let turned = "normal = [-0.707106781187, 0.0, -0.707106781187]\noffset_mm = -4412.346314604";
    let away =
        changed("away.toml", turned, "normal = [0.707106781187, 0.0, -0.707106781187]\noffset_mm = -4412.346314604");
    let printed = String::from_utf8_lossy(&run(&away).stderr).into_owned();
    assert_eq!(run(&away).status.code(), Some(2), "{printed}");
    assert!(printed.contains("mirror"), "{printed}");
    // Camera inside the tank.
    let inside = changed("inside.toml", "offset_mm = -5973.0", "offset_mm = 200.0");
    let printed = String::from_utf8_lossy(&run(&inside).stderr).into_owned();
    assert_eq!(run(&inside).status.code(), Some(2), "{printed}");
    assert!(printed.contains("front_wall"), "{printed}");
    // A rolling shutter, which is not drawn.
    refused(&run(&changed("rolling.toml", "[camera]\n", "[camera]\nreadout_ms = 15.0\n")), "has a rolling shutter");
    // No places along the tube; no base.
    let places = changed("places.toml", "centre_mm = 91.8\n", "");
    refused(&run(&places), "marker `coil` has no centre_mm");
    let cut = bench.find("# x along B0").unwrap();
    let baseless = folder.path().join("baseless.toml");
    fs::write(&baseless, &bench[..cut]).unwrap();
    refused(&run(&baseless), "has no [base]");
    refused(&simulate(folder.path(), &bench_rig(), &["--motion", "jump", "-o", "out"]), "is neither rest, planar");
    let long = ["--motion", "rest", "--exposure", "30ms", "-o", "out"];
    refused(&simulate(folder.path(), &bench_rig(), &long), "longer than a frame");
    let overlapping = ["--motion", "rest", "--exposure", "16ms", "--jitter", "3ms", "-o", "out"];
    refused(&simulate(folder.path(), &bench_rig(), &overlapping), "exposures of 16 ms overlap");
    let uneven = ["--motion", "rest", "--exposure", "0", "--jitter", "5ms", "-o", "out"];
    refused(&simulate(folder.path(), &bench_rig(), &uneven), "expected at most 3.19 ms at 60 Hz");
    let boards = ["--boards", "1", "--jitter", "5ms", "-o", "out"];
    refused(&simulate(folder.path(), &bench_rig(), &boards), "cannot be used with");
    refused(&simulate(folder.path(), &bench_rig(), &["--board", "7x5:10mm", "-o", "out"]), "--boards");
    assert!(!folder.path().join("out").exists(), "nothing was written");
}

#[test]
fn a_plan_tells_what_is_seen_and_how_well() {
    let folder = tempfile::tempdir().unwrap();
    let rig = bench_rig();
    let text = good(&catoptra(folder.path(), &["plan", "--rig", rig.to_str().unwrap(), "-o", "plan.html"]));
    assert!(text.contains("27 of 27 shapes are seen in all views") && text.contains("supposing 14 boards"), "{text}");
    let page = fs::read_to_string(folder.path().join("plan.html")).unwrap();
    for part in ["plot-above", "plot-near", "plot-side", "plot-tips", "What would help", "px/mm"] {
        assert!(page.contains(part), "{part}");
    }
    refused(
        &catoptra(folder.path(), &["plan", "--rig", rig.to_str().unwrap(), "-o", "none/plan.html"]),
        "there is no such folder",
    );
}
