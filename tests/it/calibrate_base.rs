//! `catoptra calibrate base` as a user runs it: the sample's base frame compared with the truth, and refusals.

use crate::support::command::{Place, ended_with, names, pictures, rig, sample, stdout};
use crate::support::encode;
use crate::support::encode::Recording;
use catoptra::rig::{Base, Rig};
use nalgebra::{Rotation3, Vector3};
use std::path::Path;
use std::process::{Command, Output};

/// The sample's rig without base frame, in a folder of its own.
fn place() -> Place {
    Place::with(&Rig { base: None, ..rig() })
}

fn command(place: &Place, rest: &Path, args: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_catoptra"));
    command
        .current_dir(place.folder.path())
        .args(["calibrate", "base"])
        .arg(rest)
        .args(["--rig", "rig.toml"])
        .args(args);
    command
}

fn calibrate(place: &Place, rest: &Path, args: &[&str]) -> Output {
    command(place, rest, args).output().unwrap()
}

fn base(place: &Place) -> (Base, toml::Table) {
    let rig = Rig::load(&place.rig).unwrap();
    (rig.base.unwrap(), rig.provenance["base"].as_table().unwrap().clone())
}

fn numbers(table: &toml::Table, key: &str) -> Vector3<f64> {
    Vector3::from_iterator(table[key].as_array().unwrap().iter().map(|v| v.as_float().unwrap()))
}

fn planar() -> String {
    sample("planar.mkv").to_str().unwrap().to_owned()
}

/// Turns about the axes of the true base frame, degrees.
fn turned_deg(found: &Base, truth: &Base) -> Vector3<f64> {
    let [found, truth] = [found, truth].map(|base| base.base_from_camera.rotation.to_rotation_matrix());
    Rotation3::scaled_axis(&(truth * found.inverse())).map(f64::to_degrees)
}

#[test]
fn the_sample_has_the_base_frame_it_was_rendered_with() {
    let (truth, place) = (rig().base.unwrap(), place());
    let output = calibrate(&place, &sample("rest.mkv"), &["--planar", &planar()]);
    ended_with(&output, 0);
    println!("{}", stdout(&output));
    assert!(stdout(&output).contains("counts as positive"));
    let (found, provenance) = base(&place);

    let [origin_sd_mm, axes_sd_deg] = ["origin_sd_mm", "axes_sd_deg"].map(|key| numbers(&provenance, key));
    let origin = |base: &Base| base.base_from_camera.inverse().translation.vector;
    let moved_mm = (origin(&found) - origin(&truth)) * 1e3;
    let turned_deg = turned_deg(&found, &truth);
    for (what, error, sd) in
        [("origin, mm", moved_mm, origin_sd_mm), ("turn about x, y, z, °", turned_deg, axes_sd_deg)]
    {
        let ratio = error.component_div(&sd);
        println!(
            "{what}: error {:.3} {:.3} {:.3}, over σ {:.2} {:.2} {:.2}",
            error.x, error.y, error.z, ratio.x, ratio.y, ratio.z
        );
        assert!(ratio.amax() < 3.0, "{what}: {ratio}");
    }
    // Large σ would make all of the above hold.
    assert!(origin_sd_mm.amax() < 0.1 && axes_sd_deg.amax() < 0.2, "{origin_sd_mm} {axes_sd_deg}");
    assert!(axes_sd_deg.z < 0.1, "{axes_sd_deg}");
    let b0_off_deg = found.b0.angle(&truth.b0).to_degrees();
    println!("B0: {b0_off_deg:.3}° off; z: {:.3}° off", turned_deg.xy().norm());
    assert!(b0_off_deg < 0.25, "{b0_off_deg}");
    assert_eq!(provenance["recording"].as_str(), Some("rest.mkv"));
    assert_eq!((provenance["frames"].as_integer(), provenance["planar_frames"].as_integer()), (Some(20), Some(300)));
    assert_eq!(names(place.folder.path()), ["rig.toml", "rig.toml.bak"]);
    ended_with(&rig_check(&place), 0);

    // Again without a swing: its B0 is kept, and the σ with it.
    let output = calibrate(&place, &sample("rest.mkv"), &["--gravity", "0,2,0"]);
    ended_with(&output, 0);
    assert!(stdout(&output).contains("the swing in planar.mkv, first deflection positive"), "{}", stdout(&output));
    let (kept, again) = base(&place);
    assert_eq!((kept.b0, kept.gravity), (found.b0, Some(Vector3::y())));
    assert_eq!(again["b0_from"], provenance["b0_from"]);
    assert!((numbers(&again, "axes_sd_deg") - axes_sd_deg).amax() < 1e-3);

    // The other sign is half a turn about z.
    let output = calibrate(&place, &sample("rest.mkv"), &["--planar", &planar(), "--first", "negative"]);
    ended_with(&output, 0);
    assert!(stdout(&output).contains("counts as negative"));
    let (other, _) = base(&place);
    assert!((other.b0 + found.b0).amax() < 1e-9);
    assert_eq!(other.gravity, Some(Vector3::y()));
}

fn rig_check(place: &Place) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_catoptra"));
    command.current_dir(place.folder.path()).args(["rig", "check", "rig.toml"]).output().unwrap()
}

#[test]
fn a_field_that_is_given_counts_by_its_direction() {
    let (truth, place) = (rig().base.unwrap(), place());
    let long = truth.b0 * 3.0;
    let b0 = format!("{},{},{}", long.x, long.y, long.z);
    let output = calibrate(&place, &sample("rest.mkv"), &["--b0", &b0, "--out", "new.toml"]);
    ended_with(&output, 0);
    assert!(stdout(&output).contains("it is written with length 1"), "{}", stdout(&output));
    let found = Rig::load(&place.path("new.toml")).unwrap().base.unwrap();
    assert!((found.b0 - truth.b0).amax() < 1e-9);
    // B0 is at right angles to the tube here: only z's error is left.
    assert!(turned_deg(&found, &truth).z.abs() < 0.01);
    assert!(Rig::load(&place.rig).unwrap().base.is_none(), "--rig is not --out");
    assert_eq!(names(place.folder.path()), ["new.toml", "rig.toml"]);
}

/// Runs that end with this exit code, say this, and leave the folder as it was.
fn refused(place: &Place, code: i32, rest: &Path, args: &[&str], words: &[&str]) {
    let before = (names(place.folder.path()), std::fs::read(&place.rig).unwrap());
    let said = ended_with(&calibrate(place, rest, args), code);
    for word in words {
        assert!(said.contains(word), "{word} is not in {said}");
    }
    assert!((names(place.folder.path()), std::fs::read(&place.rig).unwrap()) == before, "something was written");
}

const B0: [&str; 2] = ["--b0", "0.883,-0.014,0.469"];

#[test]
fn recordings_that_do_not_show_it_are_refused_with_the_reason() {
    let place = place();
    let [rest, circle] = ["rest.mkv", "circle.mkv"].map(sample);
    let of_rest = ["--planar", rest.to_str().unwrap()];
    let of_circle = ["--planar", circle.to_str().unwrap()];
    refused(&place, 3, &sample("planar.mkv"), &B0, &["planar.mkv: not at rest: the coil's direction scatters by"]);
    refused(&place, 3, &rest, &of_rest, &["rest.mkv: the coil is deflected from rest by 0.", "5° or more"]);
    refused(&place, 3, &rest, &of_circle, &["circle.mkv: not planar: the coil swings by", "--b0"]);
}

#[test]
fn too_few_pictures_are_refused() {
    let place = place();
    pictures("rest.mkv", 4, &place.path("four"));
    refused(
        &place,
        3,
        &place.path("four"),
        &B0,
        &["four: the base band was measured in only 4 of 4 frames: expected 5"],
    );

    // Five pictures of the catheter and six of nothing.
    pictures("rest.mkv", 5, &place.path("hidden"));
    let mut times = std::fs::read_to_string(place.path("hidden/times.csv")).unwrap();
    for i in 5..11 {
        let name = format!("frame{i}.png");
        image::RgbImage::from_pixel(1280, 1024, image::Rgb([120; 3])).save(place.path("hidden").join(&name)).unwrap();
        times += &format!("{name},{}\n", i as f64 / 60.0);
    }
    std::fs::write(place.path("hidden/times.csv"), times).unwrap();
    refused(&place, 3, &place.path("hidden"), &B0, &["only 5 of 11 frames", "first missed: not seen"]);
}

#[test]
fn a_recording_without_colour_is_refused() {
    let place = place();
    let pts: Vec<i64> = (0..8).map(|i| 17 * i).collect();
    encode::write(
        &place.path("grey.mkv"),
        &Recording { size_px: [1280, 1024], pts: &pts, b_frames: 0, ..Recording::default() },
    );
    let grey = "grey.mkv: pictures are grey; markers are recognised by their colour";
    refused(&place, 2, &place.path("grey.mkv"), &B0, &[grey]);
    let args = ["--planar", "grey.mkv"];
    refused(&place, 2, &sample("rest.mkv"), &args, &[grey]);
    encode::write(&place.path("small.mkv"), &Recording { pts: &pts, ..Recording::default() });
    refused(&place, 2, &place.path("small.mkv"), &B0, &["small.mkv: pictures of 64x48 pixels"]);
}

#[test]
fn wrong_arguments_are_named() {
    let place = place();
    let rest = sample("rest.mkv");
    let cases: [(&[&str], &[&str]); 12] = [
        (&[], &["rig.toml has no [base] with a b0 yet", "--planar VIDEO", "--b0 X,Y,Z"]),
        (&["--planar", "none.mkv"], &["none.mkv: no such file"]),
        (&["--b0", "0,0,0"], &["`0,0,0` is not a direction"]),
        (&["--b0", "NaN,0,1"], &["`NaN,0,1` is not a direction"]),
        (&["--b0", "1,0"], &["three numbers X,Y,Z"]),
        (&["--gravity", "0,0,0", "--b0", "1,0,0"], &["--gravity", "`0,0,0` is not a direction"]),
        (
            &["--b0", "-0.007,0.999,0.04"],
            &["--b0: B0 = -0.0070, 0.9992, 0.0400 lies at", "expected a direction across it"],
        ),
        (&["--b0", "1,0,0", "--planar", "a.mkv"], &["cannot be used with"]),
        (&["--b0", "1,0,0", "--first", "negative"], &["cannot be used with"]),
        (&["--first", "negative"], &["--planar"]),
        (&["--b0", "1,0,0", "--out", "none/rig.toml"], &["none/rig.toml: there is no such folder"]),
        (&["--b0", "1,0,0", "--rig", "other.toml"], &["--rig"]),
    ];
    for (args, words) in cases {
        refused(&place, 2, &rest, args, words);
    }
    refused(&place, 2, Path::new("none.mkv"), &B0, &["none.mkv: no such file"]);

    // A b0 of the rig file that lies along the tube is the file's fault, not the command line's.
    let truth = rig().base.unwrap();
    let z = truth.base_from_camera.rotation.inverse() * Vector3::z();
    let along = Place::with(&Rig { base: Some(Base { b0: z, ..truth }), ..rig() });
    refused(&along, 2, &rest, &[], &["rig.toml: base.b0: B0 ="]);

    let mut bare = rig();
    bare.markers[1].colours.clear();
    let bare = Place::with(&bare);
    refused(&bare, 2, &rest, &[], &["rest.mkv", "`coil`"]);
}

#[cfg(unix)]
#[test]
fn ctrl_c_leaves_the_old_rig_as_it_was() {
    use std::os::unix::process::ExitStatusExt as _;
    let place = place();
    let before = std::fs::read(&place.rig).unwrap();
    let mut child = command(&place, &sample("rest.mkv"), &["--planar", &planar()]).spawn().unwrap();
    std::thread::sleep(std::time::Duration::from_millis(500));
    assert!(crate::support::command::signal(&child, "INT"));
    let status = child.wait().unwrap();
    // By itself, or by the system when a busy machine had not begun yet.
    assert!(status.code() == Some(130) || status.signal() == Some(2), "it was to be interrupted before it was done");
    assert_eq!(std::fs::read(&place.rig).unwrap(), before);
    assert_eq!(names(place.folder.path()), ["rig.toml"]);
}
