//! `catoptra track` with unusable input: the exit code, the message, and the files left behind.

use crate::support::command;
use crate::support::command::*;
use crate::support::encode::{Recording, write};
use catoptra::optics::Surface;
use catoptra::rig::Rig;
use ffmpeg_the_third::format::Pixel;
use std::path::Path;
use std::process::Command;

/// Fails unless the run is refused with all these words before anything is written.
fn refused(place: &Place, source: &Path, args: &[&str], words: &[&str]) {
    let output = place.track(source, args);
    let said = ended_with(&output, 2);
    for word in words {
        assert!(said.contains(word), "{word} is not in {said}");
    }
    assert_eq!(stdout(&output), "");
    assert!(!place.path("out").exists(), "an output folder was made");
}

#[test]
fn no_such_file() {
    let place = Place::new();
    refused(&place, Path::new("none.mkv"), &[], &["none.mkv: no such file or folder"]);
}

#[test]
fn not_a_video() {
    let place = Place::new();
    std::fs::write(place.path("notes.mkv"), "Tuesday: the tank leaks.\n".repeat(100)).unwrap();
    refused(&place, Path::new("notes.mkv"), &[], &["notes.mkv: is not a video"]);
    std::fs::create_dir(place.path("empty")).unwrap();
    refused(&place, Path::new("empty"), &[], &["empty: no picture in this folder"]);
}

#[test]
fn a_recording_without_a_readable_frame() {
    let place = Place::new();
    let whole = std::fs::read(sample("rest.mkv")).unwrap();
    std::fs::write(place.path("cut.mkv"), &whole[..900]).unwrap();
    refused(&place, Path::new("cut.mkv"), &[], &["cut.mkv"]);
}

#[test]
fn a_truncated_recording_is_tracked_to_its_last_good_frame() {
    let place = Place::new();
    let whole = std::fs::read(sample("circle.mkv")).unwrap();
    std::fs::write(place.path("cut.mkv"), &whole[..whole.len() / 6]).unwrap();
    let output = place.track(Path::new("cut.mkv"), &["--overlay"]);
    let said = ended_with(&output, 0);
    let frames = place.frames_in_all_files();
    assert!((5..60).contains(&frames), "{frames} frames");
    let last_s = *place.table().numbers("t_s").last().unwrap();
    let warning = format!("{frames} frames could be read, the last one at {last_s} s");
    assert!(said.contains("ends early") && said.contains(&warning), "{warning} is not in {said}");
    assert!(!said.contains(" @ 0x"), "libav speaks for itself: {said}");
    assert_eq!(command::frames(&place.path("out/overlay.mp4")).len(), frames);
}

#[test]
fn colour_for_every_fourth_pixel_only_is_warned_of() {
    let place = Place::new();
    let recording = Recording {
        size_px: [1280, 1024],
        pts: &[0, 17, 33],
        encoder: "ffv1",
        pixel: Pixel::YUV411P,
        chroma: 100,
        ..Recording::default()
    };
    write(&place.path("dv.mkv"), &recording);
    let said = ended_with(&place.track(Path::new("dv.mkv"), &[]), 3);
    assert!(said.contains("dv.mkv: colour is stored for every 4 pixels only (4:1:1)"), "{said}");
    assert_eq!(place.frames_in_all_files(), 3);
}

#[test]
fn a_source_that_breaks_keeps_what_was_tracked() {
    let place = Place::new();
    let folder = place.path("pictures");
    pictures("rest.mkv", 3, &folder);
    image::RgbImage::new(640, 512).save(folder.join("frame2.png")).unwrap();
    let said = ended_with(&place.track(&folder, &[]), 1);
    assert!(
        said.contains("640x512") && said.contains("2 frames tracked and written, the last one at 0.017 s"),
        "{said}"
    );
    assert_eq!(place.frames_in_all_files(), 2);
}

#[test]
fn pictures_of_another_size_than_the_rig() {
    let mut rig = rig();
    rig.camera.size_px = [1920, 1200];
    let place = Place::with(&rig);
    refused(&place, &sample("rest.mkv"), &[], &["rest.mkv", "1280x1024", "1920x1200", "rig.toml"]);
}

#[test]
fn grey_pictures() {
    let place = Place::new();
    let folder = place.path("grey");
    std::fs::create_dir(&folder).unwrap();
    image::GrayImage::new(1280, 1024).save(folder.join("a.png")).unwrap();
    refused(&place, &folder, &["--fps", "60"], &["grey: pictures are grey"]);
}

#[test]
fn a_rig_that_is_not_complete() {
    let mut colourless = rig();
    colourless.markers[1].colours.clear();
    let place = Place::with(&colourless);
    refused(&place, &sample("rest.mkv"), &[], &["rig.toml", "coil", "catoptra calibrate markers"]);

    let baseless = Rig { base: None, ..rig() };
    let place = Place::with(&baseless);
    refused(&place, &sample("rest.mkv"), &[], &["rig.toml", "[base]", "catoptra calibrate base", "--frame camera"]);
    let output = place.track(&sample("rest.mkv"), &["--frame", "camera", "--to", "0.05"]);
    ended_with(&output, 0);
    assert!(place.table().rows.iter().all(|row| row["theta_deg"].is_empty() && !row["tan_x"].is_empty()));
    assert!(!stdout(&output).contains("deflection"), "{}", stdout(&output));
}

#[test]
fn a_rig_file_with_a_mistake() {
    let place = Place::new();
    let text = std::fs::read_to_string(&place.rig).unwrap().replace("diameter_mm", "diametre_mm");
    std::fs::write(&place.rig, text).unwrap();
    refused(&place, &sample("rest.mkv"), &[], &["diametre_mm", "diameter_mm"]);
    std::fs::remove_file(&place.rig).unwrap();
    refused(&place, &sample("rest.mkv"), &[], &["rig.toml"]);
}

#[test]
fn options_that_mean_nothing() {
    let place = Place::new();
    let video = sample("rest.mkv");
    refused(&place, &video, &["--from", "0.2", "--to", "0.1"], &["0.2 s to 0.1 s"]);
    refused(&place, &video, &["--from", "7"], &["7 s", "0.317 s"]);
    refused(&place, &video, &["--from", "late"], &["expected a time"]);
    refused(&place, &video, &["--to", "-1"], &["-1 s", "the first, at 0 s"]);
    refused(&place, &video, &["--fps", "60"], &["has its own time stamps"]);
    refused(&place, &video, &["--threads", "0"], &["1..=256"]);
}

#[test]
fn a_marker_that_is_never_seen() {
    let mut rig = rig();
    rig.markers[2].colours.iter_mut().flat_map(|colour| &mut colour.planes).for_each(|plane| plane.bias -= 3.0);
    let place = Place::with(&rig);
    let output = place.track(&sample("rest.mkv"), &["--to", "0.1"]);
    let said = ended_with(&output, 3);
    for part in ["marker tip was not located in any of 7 frames", "7 not seen in direct", "catoptra calibrate markers"]
    {
        assert!(said.contains(part), "{part} is not in {said}");
    }
    assert!(!said.contains("marker base"), "{said}");
    assert_eq!(place.frames_in_all_files(), 7);
    assert!(place.table().rows.iter().all(|row| row["tip_status"] == "not_seen_direct" && row["base_status"] == "ok"));
    assert!(stdout(&output).contains("results in out"));
}

#[test]
fn an_output_folder_that_cannot_be_written() {
    let place = Place::new();
    std::fs::write(place.path("out"), "in the way").unwrap();
    let said = ended_with(&place.track(&sample("rest.mkv"), &[]), 2);
    assert!(said.contains("out: is a file"), "{said}");
    let mut below = Command::new(env!("CARGO_BIN_EXE_catoptra"));
    below.current_dir(place.folder.path()).arg("track").arg(sample("rest.mkv"));
    let said = ended_with(&below.args(["--rig", "rig.toml", "-o", "out/below"]).output().unwrap(), 1);
    assert!(said.contains("out/below: cannot be written"), "{said}");
    assert_eq!(std::fs::read_to_string(place.path("out")).unwrap(), "in the way");

    std::fs::remove_file(place.path("out")).unwrap();
    let said = ended_with(&place.track(&sample("rest.mkv"), &["--csv=none/table.csv"]), 1);
    assert!(said.contains("none/table.csv"), "{said}");
}

#[test]
fn files_of_others_and_inputs_are_not_written_over() {
    let place = Place::new();
    std::fs::create_dir(place.path("out")).unwrap();
    std::fs::write(place.path("out/track.csv"), "mine").unwrap();
    let said = ended_with(&place.track(&sample("rest.mkv"), &[]), 2);
    assert!(said.contains("track.csv"), "{said}");
    assert_eq!(std::fs::read_to_string(place.path("out/track.csv")).unwrap(), "mine");

    let rig = std::fs::read(&place.rig).unwrap();
    let said = ended_with(&place.track(&sample("rest.mkv"), &["--csv=rig.toml"]), 2);
    assert!(said.contains("would be overwritten"), "{said}");
    assert_eq!(std::fs::read(&place.rig).unwrap(), rig);
}

#[test]
fn what_a_rig_check_warns_of_is_told_by_a_run() {
    let mut rig = rig();
    if let Some(Surface::Wall(wall)) = rig.surfaces.get_mut("front_wall") {
        wall.thickness_m = 5e-6;
    }
    rig.base = None;
    let place = Place::with(&rig);
    let said = stderr(&place.track(&sample("rest.mkv"), &["--frame", "camera", "--to", "0.05"]));
    assert!(said.contains("rig.toml: the thickness of wall front_wall is 0.005 mm"), "{said}");
    assert!(!said.contains("[base]"), "{said}");
    let place = Place::new();
    assert_eq!(stderr(&place.track(&sample("rest.mkv"), &["--to", "0.05"])), "");
}

/// A limit on the size of files stands for a full disk: the log meets it on the way, the report at its end.
#[test]
#[cfg(unix)]
fn a_full_disk_ends_the_run_and_the_table_is_whole() {
    let place = Place::new();
    let output = Command::new("sh")
        .current_dir(place.folder.path())
        .args(["-c", "ulimit -f 300; exec \"$@\"", "sh", env!("CARGO_BIN_EXE_catoptra"), "track"])
        .arg(sample("planar.mkv"))
        .args(["--rig", "rig.toml", "-o", "out"])
        .output()
        .unwrap();
    let said = ended_with(&output, 1);
    assert!(said.contains("out/log.mcap: File too large") && said.contains("out/report.html"), "{said}");
    let rows = place.table().rows.len();
    assert!((5..250).contains(&rows), "{rows} rows");
    assert!(said.contains(&format!("{rows} frames tracked")), "{said}");
}
