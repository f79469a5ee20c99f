//! `catoptra track` on the sample recordings: the content of its files, and what does not affect them.

use crate::support::command::*;
use nalgebra::Vector3;

#[test]
fn every_frame_is_answered_near_the_truth_and_is_in_every_file() {
    let place = Place::new();
    let output = place.track(&sample("planar.mkv"), &["--frame", "camera", "--overlay", "--to", "0.4"]);
    assert_eq!(ended_with(&output, 0), "", "nothing to complain about");
    let truth = Table::read(&sample("truth/planar.csv"));
    let table = place.table();
    assert_eq!(place.frames_in_all_files(), 25);
    let stamps_ns: Vec<_> = truth.numbers("t_s").iter().map(|t_s| (t_s * 1e3).round() * 1e6).collect();
    assert_eq!(table.numbers("stamp_ns"), stamps_ns[..25]);
    for name in ["base", "coil", "tip"] {
        let limit_mm = if name == "base" { 0.6 } else { 0.25 };
        for (k, (place, truth)) in table.vectors(name, "_mm").iter().zip(truth.vectors(name, "")).enumerate() {
            let error_mm = (place - truth).norm();
            assert!(error_mm < limit_mm, "{name} is {error_mm} mm off in frame {k}");
        }
    }
    for (k, (theta, truth)) in table.numbers("theta_deg").iter().zip(truth.numbers("theta_deg")).enumerate() {
        assert!((theta - truth).abs() < 1.0, "θ is {theta}° instead of {truth}° in frame {k}");
    }

    assert_eq!(
        names(&place.path("out")),
        ["log.mcap", "overlay.mp4", "report.html", "run.toml", "summary.json", "track.csv"]
    );
    assert_eq!(frames(&place.path("out/overlay.mp4")).len(), 25);
    let rig = std::fs::read_to_string(&place.rig).unwrap();
    assert_eq!(attached(&place.path("out/log.mcap"), "rig.toml"), rig);
    let options = attached(&place.path("out/log.mcap"), "options.toml");
    assert!(options.contains("frame = \"camera\"") && options.contains("to_s = 0.4"), "{options}");
    let run = std::fs::read_to_string(place.path("out/run.toml")).unwrap();
    assert!(run.contains(&options));
    // What each source of error adds comes after it.
    let budget = run.parse::<toml::Table>().unwrap()["error_budget"].clone();
    for source in ["image_noise", "time_stamps", "together"] {
        assert!(budget[source]["theta_deg"].as_float().unwrap() >= 0.0, "{run}");
    }
    let printed = stdout(&output);
    for part in ["25 frames, 0.000 s to 0.400 s; none lost between them", "results in out", "overlay.mp4"] {
        assert!(printed.contains(part), "{part} is not in {printed}");
    }
    let row = |name: &str| printed.lines().find(|line| line.trim_start().starts_with(name)).unwrap().to_owned();
    assert!(row("tip").contains("25  100.0 %") && row("tip").contains(" mm"), "{printed}");
    assert!(row("deflection").contains("from "), "{printed}");
}

/// Nothing in PNG files says that a coder had changed them, but it had.
#[test]
fn pictures_extracted_from_a_video_are_no_better_than_the_video() {
    let place = Place::new();
    let of_video = place.track(&sample("planar.mkv"), &["--to", "0.1"]);
    assert_eq!(ended_with(&of_video, 0), "");
    let video = place.table();
    let copy = Place::new();
    let folder = copy.path("extracted");
    pictures("planar.mkv", video.numbers("seq").len(), &folder);
    let said = ended_with(&copy.track(&folder, &[]), 0);
    assert_eq!(said.matches("have the same chroma").count(), 1, "{said}");
    let extracted = copy.table();
    for column in ["base_sd_mm", "coil_sd_mm", "tip_sd_mm", "tan_sd_deg"] {
        for (copied, original) in extracted.numbers(column).iter().zip(video.numbers(column)) {
            assert!(*copied > 0.8 * original, "{column} is {copied}, but {original} in the video");
        }
    }
}

#[test]
fn the_base_frame_turns_and_shifts_the_camera_frame() {
    let place = Place::new();
    ended_with(&place.track(&sample("rest.mkv"), &["--to", "0.1", "--csv=camera.csv", "--frame=camera"]), 0);
    assert_eq!(names(&place.path("out")), ["log.mcap", "report.html", "run.toml", "summary.json"]);
    ended_with(&place.track(&sample("rest.mkv"), &["--to", "0.1", "--csv"]), 0);
    let base_from_camera = rig().base.unwrap().base_from_camera;
    let (camera, base) = (Table::read(&place.path("camera.csv")), place.table());
    for name in ["base", "coil", "tip"] {
        for (c, b) in camera.vectors(name, "_mm").into_iter().zip(base.vectors(name, "_mm")) {
            let expected = base_from_camera * nalgebra::Point3::from(c * 1e-3) * 1e3;
            assert!((expected.coords - b).norm() < 1e-5, "{name}: {expected} and {b}");
        }
    }
    for (c, b) in camera.vectors("tan", "").into_iter().zip(base.vectors("tan", "")) {
        assert!((base_from_camera * c - b).norm() < 1e-6);
        assert!((b - Vector3::z()).norm() < 0.02, "at rest the coil points along z, not {b}");
    }
}

#[test]
fn threads_and_windows_change_nothing() {
    let results = |args: &[&str]| {
        let place = Place::new();
        ended_with(&place.track(&sample("circle.mkv"), &[&["--to", "0.25"], args].concat()), 0);
        (std::fs::read_to_string(place.path("out/track.csv")).unwrap(), estimates(&place.path("out/log.mcap")))
    };
    let one = results(&["--threads", "1"]);
    assert_eq!((one.0.lines().count(), one.1.len()), (17, 16));
    for threads in ["2", "5"] {
        assert!(results(&["--threads", threads]) == one, "{threads} threads");
    }
    assert!(results(&["--full-frame"]) == one, "full frame");
}

#[test]
fn a_span_has_the_frames_of_the_whole_at_their_own_times() {
    let place = Place::new();
    ended_with(&place.track(&sample("planar.mkv"), &["--from", "1.0", "--to", "1.1"]), 0);
    let stamps: Vec<_> = place.table().rows.iter().map(|row| row["t_s"].clone()).collect();
    assert_eq!(
        stamps,
        ["1.000000000", "1.017000000", "1.033000000", "1.050000000", "1.067000000", "1.083000000", "1.100000000"]
    );
    assert_eq!(place.table().rows[0]["seq"], "0");
    assert_eq!(place.frames_in_all_files(), 7);
}

#[test]
fn pictures_are_tracked_with_the_times_of_their_table_or_a_stated_rate() {
    let place = Place::new();
    let folder = place.path("pictures");
    pictures("planar.mkv", 3, &folder);
    ended_with(&place.track(&folder, &[]), 0);
    assert_eq!(place.table().numbers("t_s"), [0.0, 0.017, 0.033]);
    assert_eq!(place.frames_in_all_files(), 3);
    let truth = Table::read(&sample("truth/planar.csv")).numbers("theta_deg");
    for (theta, truth) in place.table().numbers("theta_deg").iter().zip(truth) {
        assert!((theta - truth).abs() < 2.0, "θ is {theta}° instead of {truth}°");
    }

    std::fs::remove_file(folder.join("times.csv")).unwrap();
    ended_with(&place.track(&folder, &["--fps", "60000/1001"]), 0);
    assert_eq!(place.table().numbers("stamp_ns"), [0.0, 16_683_333.0, 33_366_667.0]);
    assert!(attached(&place.path("out/log.mcap"), "options.toml").contains("fps = "));
}

#[test]
fn a_run_is_replaced_by_one_of_the_same_recording_only() {
    let place = Place::new();
    let short = ["--to", "0.05"];
    ended_with(&place.track(&sample("rest.mkv"), &["--to", "0.05", "--overlay"]), 0);
    // The same command again: nothing to say.
    assert_eq!(ended_with(&place.track(&sample("rest.mkv"), &["--to", "0.05", "--overlay"]), 0), "");
    let said = ended_with(&place.track(&sample("rest.mkv"), &["--to", "0.02"]), 0);
    assert!(said.contains("with other options, are replaced"), "{said}");
    assert_eq!(place.frames_in_all_files(), 2);
    assert!(!place.path("out/overlay.mp4").exists(), "an overlay of the earlier run is left");

    let said = ended_with(&place.track(&sample("planar.mkv"), &short), 2);
    assert!(said.contains("rest.mkv") && said.contains("another folder"), "{said}");
    assert_eq!(place.frames_in_all_files(), 2);
}

#[test]
fn results_go_into_a_folder_named_after_the_recording_and_quiet_is_quiet() {
    let place = Place::new();
    let output = std::process::Command::new(env!("CARGO_BIN_EXE_catoptra"))
        .current_dir(place.folder.path())
        .args(["-q", "track", "--to=0", "--rig", "rig.toml"])
        .arg(sample("rest.mkv"))
        .output()
        .unwrap();
    assert_eq!(ended_with(&output, 0), "");
    assert_eq!(stdout(&output), "");
    assert_eq!(Table::read(&place.path("rest-track/track.csv")).rows.len(), 1);
}
