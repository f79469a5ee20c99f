//! `catoptra calibrate camera` and `calibrate rig` as a user runs them, on the sample rig's pictures of a board:
//! results compared with the renderer's truth, and refusals. `sample_rig.rs` tests tracking with the result.

use crate::support::truth::{file, rig};
use catoptra::calibrate::geometry::tilt_axes;
use catoptra::rig::Draft;
use nalgebra::DMatrix;
use std::path::Path;
use std::process::{Command, Output};
use std::sync::OnceLock;
use tempfile::TempDir;

fn catoptra(folder: &Path, args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_catoptra")).current_dir(folder).args(args).output().unwrap()
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

fn camera(folder: &Path, pictures: &[&str], out: &str) -> Output {
    catoptra(folder, &[&["calibrate", "camera"], pictures, &["--board", "9x6:12mm", "--out", out]].concat())
}

fn sample(folder: &str) -> String {
    file("calibration/dev_tank").join(folder).to_string_lossy().into_owned()
}

/// The lens, calibrated once for all tests.
fn lens() -> &'static str {
    static LENS: OnceLock<String> = OnceLock::new();
    LENS.get_or_init(|| {
        let folder = tempfile::tempdir().unwrap();
        let output = camera(folder.path(), &[&sample("intrinsics")], "rig.toml");
        assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
        std::fs::read_to_string(folder.path().join("rig.toml")).unwrap()
    })
}

/// A folder with `rig.toml`, the lens in it, after `calibrate rig` with some more arguments.
fn calibrated(more: &[&str]) -> (TempDir, Output) {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("rig.toml"), lens()).unwrap();
    let args = ["calibrate", "rig", &sample("mirror"), "--board", "9x6:12mm", "--rig", "rig.toml", "--glass", "5mm"];
    // The renderer's water is of 20 °C.
    let output = catoptra(folder.path(), &[&args, more].concat());
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    (folder, output)
}

/// Every parameter of a rig file's adjustment: name, error against the truth, predicted σ; SI units, pixels.
fn errors(found: &Draft) -> Vec<(String, f64, f64)> {
    let truth = rig();
    let provenance = found.provenance["rig"].as_table().unwrap();
    let covariance: Vec<Vec<f64>> = provenance["covariance"]
        .as_array()
        .unwrap()
        .iter()
        .map(|row| row.as_array().unwrap().iter().map(|v| v.as_float().unwrap()).collect())
        .collect();
    let error = |name: &str| {
        let (lens, exact) = (&found.camera.lens, &truth.camera.lens);
        let pairs = [
            ("focal_x_px", lens.focal_px.x, exact.focal_px.x),
            ("focal_y_px", lens.focal_px.y, exact.focal_px.y),
            ("principal_point_x_px", lens.principal_point_px.x, exact.principal_point_px.x),
            ("principal_point_y_px", lens.principal_point_px.y, exact.principal_point_px.y),
        ];
        let distortion =
            ["k1", "k2", "p1", "p2", "k3"].into_iter().zip(lens.distortion.into_iter().zip(exact.distortion));
        let pair = pairs.into_iter().chain(distortion.map(|(name, (a, b))| (name, a, b))).find(|p| p.0 == name);
        if let Some((_, found, exact)) = pair {
            return found - exact;
        }
        let (surface, what) = ["front_wall", "mirror", "side_wall"]
            .into_iter()
            .find_map(|surface| Some((surface, name.strip_prefix(surface)?)))
            .unwrap();
        let plane = found.surfaces[surface].plane();
        let exact = truth.surfaces[if surface == "mirror" { "side_mirror" } else { surface }].plane();
        match what {
            "_offset_m" => plane.offset_m() - exact.offset_m(),
            _ => {
                let axis = usize::from(what == "_tilt_1_rad");
                exact.normal().cross(&plane.normal()).dot(&tilt_axes(&plane.normal())[axis])
            }
        }
    };
    let names = provenance["parameters"].as_array().unwrap().iter().map(|name| name.as_str().unwrap().to_owned());
    names.enumerate().map(|(i, name)| (name.clone(), error(&name), covariance[i][i].sqrt())).collect()
}

/// All within 3.5 σ, most within 2; prints a table.
fn hold(what: &str, found: &[(String, f64, f64)]) {
    println!("\n{what}\n\n| parameter | error | σ | error/σ |\n|---|---|---|---|");
    for (name, error, sd) in found {
        println!("| {name} | {error:+.2e} | {sd:.2e} | {:+.2} |", error / sd);
        assert!(error.abs() < 3.5 * sd, "{what}: {name} is {error:+.3e} off, its σ is {sd:.3e}");
    }
    let near = found.iter().filter(|(_, error, sd)| error.abs() < 2.0 * sd).count();
    assert!(3 * near > 2 * found.len(), "{what}: only {near} of {} within 2 σ", found.len());
}

fn sd(found: &[(String, f64, f64)], name: &str) -> f64 {
    found.iter().find(|(own, ..)| own == name).unwrap().2
}

#[test]
fn the_sample_rig_is_found_within_its_predicted_deviations() {
    let (folder, output) = calibrated(&["--tank", "254x254x267mm"]);
    let found = errors(&Draft::load(&folder.path().join("rig.toml")).unwrap());
    hold("boards in the water alone", &found);
    // What a covariance computed for exactly these pictures says, with some room: mirror 0.02 to 0.05° and 2.6 mm,
    // walls 10 mm, principal point 1.8 px. The lens's σ also covers a print that is slightly uneven.
    for axis in ["mirror_tilt_0_rad", "mirror_tilt_1_rad"] {
        assert!((0.015..0.08).contains(&sd(&found, axis).to_degrees()));
    }
    assert!((1.5e-3..4.5e-3).contains(&sd(&found, "mirror_offset_m")));
    assert!((5e-3..18e-3).contains(&sd(&found, "front_wall_offset_m")));
    // The scatter of fourteen pictures says 2.9 px; it is 3.1 px off.
    assert!((1.2..4.0).contains(&sd(&found, "principal_point_x_px")));
    let printed = text(&output.stdout);
    assert!(printed.contains("12 of 12 pictures used"), "{printed}");
    assert!(printed.contains("weakest: everything together along"), "{printed}");
    assert!(printed.contains("help most in the camera frame: the distance of front_wall"), "{printed}");

    // The lens of `calibrate camera` was not lost, and the old file is kept.
    assert_eq!(std::fs::read_to_string(folder.path().join("rig.toml.bak")).unwrap(), lens());
}

/// The lens starts as `calibrate camera` left it, not from what the last run made of it.
#[test]
fn the_same_pictures_again_give_the_same_rig() {
    let (folder, _) = calibrated(&["--tank", "254x254x267mm"]);
    let path = folder.path().join("rig.toml");
    let once = Draft::load(&path).unwrap();
    assert_ne!(once.camera.lens, Draft::from_toml_str(lens(), Path::new("lens.toml")).unwrap().camera.lens);
    let args = ["calibrate", "rig", &sample("mirror"), "--board", "9x6:12mm", "--rig", "rig.toml", "--glass", "5mm"];
    let again = [&args[..], &["--tank", "254x254x267mm"]].concat();
    let output = catoptra(folder.path(), &again);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let twice = Draft::load(&path).unwrap();
    let numbers = |rig: &Draft| {
        let lens = &rig.camera.lens;
        let mut all = vec![lens.focal_px.x, lens.focal_px.y, lens.principal_point_px.x, lens.principal_point_px.y];
        all.extend(lens.coefficients());
        all.extend(
            rig.surfaces.values().flat_map(|s| [s.plane().offset_m()].into_iter().chain(s.plane().normal().data.0[0])),
        );
        all
    };
    for (once, twice) in numbers(&once).into_iter().zip(numbers(&twice)) {
        assert!((once - twice).abs() < 1e-9, "{once} {twice}");
    }

    // Older versions did not keep the lens of `calibrate camera`.
    let mut older = twice.clone();
    older.provenance["camera"].as_table_mut().unwrap().remove("lens").unwrap();
    older.save(&path).unwrap();
    let output = catoptra(folder.path(), &again);
    let said = text(&output.stderr);
    assert!(output.status.code() == Some(2) && said.contains("provenance.camera.lens: missing"), "{said}");
    assert!(said.contains("run `catoptra calibrate camera` again"), "{said}");
    assert_eq!(Draft::load(&path).unwrap(), older);
}

#[test]
fn a_tape_measure_makes_the_walls_certain_and_free_walls_are_found_too() {
    let (folder, _) = calibrated(&["--tank", "254x254x267mm", "--distance", "front_wall=1264mm:2mm"]);
    let found = errors(&Draft::load(&folder.path().join("rig.toml")).unwrap());
    hold("with a tape measure", &found);
    assert!(sd(&found, "front_wall_offset_m") < 2.1e-3);
    assert!(sd(&found, "mirror_offset_m") < 1.5e-3);
    let (folder, _) = calibrated(&[]);
    hold("walls free of each other", &errors(&Draft::load(&folder.path().join("rig.toml")).unwrap()));
}

/// A rig file without covariance of the lens: said, and the lens held.
#[test]
fn a_lens_from_elsewhere_is_taken_for_exact() {
    let folder = tempfile::tempdir().unwrap();
    let mut draft = Draft::of_camera(rig().camera);
    draft.provenance.insert("camera".into(), toml::Table::new().into());
    draft.save(&folder.path().join("rig.toml")).unwrap();
    let args = ["calibrate", "rig", &sample("mirror"), "--board", "9x6:12mm", "--rig", "rig.toml", "--glass", "5mm"];
    let output = catoptra(folder.path(), &args);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    assert!(text(&output.stderr).contains("doubt: ") && text(&output.stderr).contains("the lens is taken as exact"));
    let found = Draft::load(&folder.path().join("rig.toml")).unwrap();
    let doubts = found.provenance["rig"]["doubts"].as_array().unwrap();
    assert!(doubts.iter().any(|doubt| doubt.as_str().unwrap().contains("no σ contains its errors")), "{doubts:?}");
    assert_eq!(found.camera.lens, rig().camera.lens);
    assert_eq!(found.provenance["rig"]["parameters"].as_array().unwrap().len(), 9);
    let covariance = found.provenance["rig"]["covariance"].as_array().unwrap();
    assert!(DMatrix::from_fn(9, 9, |i, j| covariance[i][j].as_float().unwrap()).cholesky().is_some());
}

#[test]
fn bad_input_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let picture = |name: &str| file("calibration/dev_tank/intrinsics").join(name).to_string_lossy().into_owned();
    let refused = |code: i32, part: &str, output: &Output| {
        let output_text = text(&output.stdout) + &text(&output.stderr);
        assert_eq!(output.status.code(), Some(code), "{output_text}");
        assert!(output_text.contains(part), "{output_text:?} lacks {part:?}");
        assert!(!output_text.contains("panicked"), "{output_text}");
        assert!(!folder.path().join("rig.toml").exists());
    };
    refused(2, "nothing.png", &camera(folder.path(), &["nothing.png"], "rig.toml"));
    std::fs::write(folder.path().join("text.png"), "no picture").unwrap();
    refused(2, "text.png", &camera(folder.path(), &["text.png"], "rig.toml"));
    std::fs::create_dir(folder.path().join("empty")).unwrap();
    refused(2, "no pictures in this folder", &camera(folder.path(), &["empty"], "rig.toml"));
    refused(3, "at least 5 are needed", &camera(folder.path(), &[&picture("00.png"), &picture("01.png")], "rig.toml"));
    // One picture many times is one picture.
    let same = [picture("00.png"), picture("00.png"), picture("00.png"), picture("00.png"), picture("00.png")];
    refused(
        3,
        "found in 1 different picture,",
        &camera(folder.path(), &same.each_ref().map(String::as_str), "rig.toml"),
    );
    refused(2, "no such folder", &camera(folder.path(), &[&picture("00.png")], "nowhere/rig.toml"));
    let board = |board: &str| {
        catoptra(folder.path(), &["calibrate", "camera", &picture("00.png"), "--board", board, "--out", "rig.toml"])
    };
    refused(2, "is not a board", &board("9x6"));
    refused(2, "cannot be used", &board("7x7:12mm"));
    refused(3, "there is a grid of 9x6", &board("8x5:12mm"));

    std::fs::write(folder.path().join("lens.toml"), lens()).unwrap();
    let rig = |args: &[&str]| {
        let common = ["calibrate", "rig", "--board", "9x6:12mm", "--rig", "lens.toml", "--out", "rig.toml"];
        catoptra(folder.path(), &[&common, args].concat())
    };
    // Boards that no mirror shows, mirrors that no picture shows.
    refused(3, "it shows the board only once", &rig(&[&picture("00.png"), "--glass", "5mm"]));
    let [a, b, c] = ["00.png", "04.png", "08.png"].map(|name| format!("{}/{name}", sample("mirror")));
    refused(3, "in 1 mirror, expected 2", &rig(&[&a, &b, &c, "--glass", "5mm", "--mirrors", "2"]));
    refused(2, "--glass <5mm>", &rig(&[&sample("mirror"), "--tank", "254x254x267mm"]));
    let tank =
        |size: &str| rig(&[&sample("mirror"), "--tank", size, "--glass", "5mm", "--distance", "front_wall=1264mm:2mm"]);
    refused(3, "behind the front of front_wall, and the tank is 100 mm deep", &tank("254x100x267mm"));
    refused(3, "along front_wall, and the tank is 100 mm along its diagonal", &tank("80x254x60mm"));
    // Each fails differently; what is wrong is the distance.
    for distance_mm in [1220, 1330] {
        let distance = format!("front_wall={distance_mm}mm:2mm");
        let given = ["--tank", "254x254x267mm", "--glass", "5mm", "--distance", &distance];
        let told = format!("mm from the camera, and it was given as {distance_mm} ± 2 mm: is that right? With it, ");
        refused(3, &told, &rig(&[&[&*sample("mirror")], &given[..]].concat()));
    }
    refused(2, "expected 0 to 50", &rig(&[&sample("mirror"), "--glass", "5mm", "--temperature", "99"]));
    refused(2, "no surface `wall`", &rig(&[&a, &b, &c, "--glass", "5mm", "--distance", "wall=1264mm:2mm"]));
}
