//! Cameras and views from and for other tools: in those tools' own form, round trips, and refusals.

use catoptra::optics::Lens;
use catoptra::rig::formats::{Format, dlt};
use catoptra::rig::{Camera, Draft};
use nalgebra::{Isometry3, Point2, Point3, Vector2};
use proptest::prelude::*;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

const FORMATS: [Format; 3] = [Format::OpenCv, Format::Ros, Format::Kalibr];

/// A camera without distortion in air, two mirrors, and a tank that one view looks into.
const RIG: &str = r#"
[camera]
width_px = 1280
height_px = 1024
focal_px = [2712.4, 2706.9]
principal_point_px = [643.7, 508.2]
distortion = [0.0, 0.0, 0.0, 0.0, 0.0]

[surfaces.side_mirror]
kind = "mirror"
normal = [-0.699727527695, 0.016520755186, -0.71421877015]
offset_mm = -1104.831516149

[surfaces.top_mirror]
kind = "mirror"
normal = [0.0, 0.8, -0.6]
offset_mm = -700.0

[surfaces.front_wall]
kind = "wall"
normal = [0.0, 0.0, -1.0]
offset_mm = -1000.0
thickness_mm = 5.0
index_outside = 1.0
index_wall = 1.52
index_inside = 1.333

[[view]]
name = "direct"
path = []

[[view]]
name = "mirror"
path = ["side_mirror"]

[[view]]
name = "twice"
path = ["top_mirror", "side_mirror"]

[[view]]
name = "tank"
path = ["front_wall"]
"#;

const BASE: &str = r#"
[base]
b0 = [1.0, 0.0, 0.0]

[base.base_from_camera]
rotation = [[0.6, 0.0, 0.8], [0.8, 0.0, -0.6], [0.0, 1.0, 0.0]]
translation_mm = [-900.0, 700.0, 40.0]
"#;

fn rig(text: &str) -> Draft {
    Draft::from_toml_str(text, Path::new("rig.toml")).unwrap()
}

fn sample(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/cameras").join(name)
}

fn sample_text(name: &str) -> String {
    std::fs::read_to_string(sample(name)).unwrap()
}

/// The camera that all the samples tell of.
fn camera() -> Camera {
    let lens = Lens {
        focal_px: Vector2::new(2712.4, 2706.9),
        principal_point_px: Point2::new(643.7, 508.2),
        distortion: [-0.11, 0.14, 0.0006, -0.0004, 0.0],
        denominator: [0.0; 3],
    };
    Camera::new([1280, 1024], lens)
}

#[test]
fn files_of_the_tools_are_recognised_and_read() {
    for (name, format) in [
        ("opencv4.yml", Format::OpenCv),
        ("opencv_tutorial.yml", Format::OpenCv),
        ("opencv5_rational.yml", Format::OpenCv),
        ("ros.yaml", Format::Ros),
        ("ros_echo.yaml", Format::Ros),
        ("kalibr.yaml", Format::Kalibr),
    ] {
        let text = sample_text(name);
        assert_eq!(Format::guess(&text, Path::new(name)).unwrap(), format, "{name}");
        assert_eq!(format.read(&text, Path::new(name)).unwrap(), camera(), "{name}");
        // As an editor on Windows saves it.
        let windows = format!("\u{feff}{}", text.replace('\n', "\r\n"));
        assert_eq!(format.read(&windows, Path::new(name)).unwrap(), camera(), "{name}");
    }
}

#[test]
fn a_file_of_ros_written_through_opencv_is_of_ros() {
    let text = sample_text("opencv4.yml") + "camera_name: old\ndistortion_model: equidistant\n";
    assert_eq!(Format::guess(&text, Path::new("f")).unwrap(), Format::Ros);
    assert!(Format::Ros.read(&text, Path::new("f")).is_err());
}

/// The message of a sample with one place changed.
fn refusal(name: &str, from: &str, to: &str) -> String {
    let text = sample_text(name);
    assert!(text.contains(from), "{from} is not in {name}");
    let text = text.replacen(from, to, 1);
    let file = Path::new(name);
    let read = Format::guess(&text, file).and_then(|format| format.read(&text, file));
    read.expect_err(&format!("{name} with {to}")).to_string()
}

#[test]
fn what_a_rig_cannot_hold_is_refused_with_its_value() {
    let cases: &[(&str, &str, &str, &[&str])] = &[
        ("opencv4.yml", "fisheye_model: 0", "fisheye_model: 1", &["fisheye_model = 1", "expected 0", "fisheye"]),
        (
            "opencv5_rational.yml",
            "0., 0., 0., 0., 0., 0., 0., 0., 0., 0. ]",
            "0., 0.25, 0., 0., 0., 0., 0., 0., -1e-3, 0. ]",
            &["distCoeffs = [-0.11, 0.14000000000000001, ", "nothing but zeros", "there is tau_x = -0.001"],
        ),
        ("opencv5_rational.yml", "cols: 14", "cols: 13", &["distCoeffs.data = [", "1 x 13 numbers, there are 14"]),
        ("opencv4.yml", "image_width: 1280\n", "", &["image_width: missing", "size of the pictures"]),
        ("opencv4.yml", "image_width: 1280", "image_width: wide", &["image_width = \"wide\"", "1 to 65535"]),
        ("opencv4.yml", "image_height: 1024", "image_height: 0", &["image_height = 0", "1 to 65535"]),
        (
            "opencv4.yml",
            "2.7124000000000001e+03, 0.,",
            "2.7124000000000001e+03, 1.5,",
            &["camera_matrix = [2.7124000000000001e+03, 1.5, ", "[fx, 0, cx"],
        ),
        (
            "opencv4.yml",
            "2.7124000000000001e+03",
            "-2.7124000000000001e+03",
            &["camera_matrix", "-2712.4 px", "positive"],
        ),
        ("opencv4.yml", "6.4370000000000005e+02", ".Nan", &["camera_matrix.data", "\".Nan\" is none"]),
        ("opencv4.yml", "6.4370000000000005e+02", ".nan", &["camera_matrix.data", ".nan is none"]),
        ("opencv4.yml", "distortion_coefficients", "distortion", &["distortion_coefficients: missing", "k1, k2"]),
        ("ros.yaml", "plumb_bob", "equidistant", &["distortion_model = \"equidistant\"", "expected plumb_bob"]),
        (
            "ros_echo.yaml",
            "0.0]\nK",
            "0.0, 0.3, 0.0, 0.0]\nK",
            &["distortion_model = \"plumb_bob\"", "rational_polynomial", "k4, k5, k6 are [0.3, 0.0, 0.0]"],
        ),
        (
            "ros.yaml",
            "cols: 5\n  data: [-0.11, 0.14, 0.0006, -0.0004, 0.000000]",
            "cols: 3\n  data: [0.1, 0, 0]",
            &["distortion_coefficients = [0.1, 0, 0]", "4, 5, 8, 12 or 14 coefficients, there are 3"],
        ),
        ("kalibr.yaml", "pinhole", "omni", &["cam0.camera_model = \"omni\"", "expected pinhole"]),
        ("kalibr.yaml", "radtan", "equi", &["cam0.distortion_model = \"equi\"", "expected radtan"]),
        ("kalibr.yaml", "[1280, 1024]", "[1280.5, 1024]", &["cam0.resolution = [1280.5, 1024]", "whole numbers"]),
        ("kalibr.yaml", "  resolution: [1280, 1024]\n", "", &["cam0.resolution: missing", "[width, height]"]),
        ("kalibr.yaml", "2706.9, ", "", &["cam0.intrinsics = [2712.4, 643.7, 508.2]", "[fu, fv, pu, pv]"]),
        ("kalibr.yaml", "0.14, ", "", &["cam0.distortion_coeffs = [-0.11, 0.0006, -0.0004]", "[k1, k2, r1, r2]"]),
        ("kalibr.yaml", "cam0:", "cam1: {}\ncam0:", &["cam1, cam0", "expected one camera"]),
        ("kalibr.yaml", "cam0:", "imu0:", &["kalibr.yaml:1: expected a camera_matrix", "cam0"]),
        ("opencv4.yml", "%YAML:1.0", "<?xml version=\"1.0\"?>", &["opencv4.yml:1: is XML", ".yml"]),
        ("ros.yaml", "camera_name: narrow", "camera_name: [", &["ros.yaml:", "not YAML"]),
    ];
    for (name, from, to, said) in cases {
        let message = refusal(name, from, to);
        for part in *said {
            assert!(message.contains(part), "{message:?} does not say {part:?}");
        }
    }
}

#[test]
fn four_coefficients_are_five_with_a_zero() {
    let text = sample_text("ros.yaml").replace("-0.0004, 0.000000]", "-0.0004]").replace("cols: 5", "cols: 4");
    assert_eq!(Format::Ros.read(&text, Path::new("f")).unwrap(), camera());
    let rational = sample_text("ros_echo.yaml")
        .replace("plumb_bob", "rational_polynomial")
        .replace("0.0]\nK", "0.0, 0.0, 0.0, 0.0]\nK");
    assert_eq!(Format::Ros.read(&rational, Path::new("f")).unwrap(), camera());
}

proptest! {
    #[test]
    fn there_and_back_every_digit_stays(
        focal in prop::array::uniform2(1.0..1e5),
        centre in prop::array::uniform2(-1e4..1e4),
        distortion in prop::array::uniform5(-1.0..1.0),
        rational in prop::array::uniform3(-1.0..1.0),
        small in -20..0_i32,
        size_px in prop::array::uniform2(1_u32..65_536),
    ) {
        // From 1 down to 1e-20: no exponent may come between.
        let mut distortion = distortion.map(|k: f64| k * 10_f64.powi(small));
        for format in FORMATS {
            let mut denominator = rational;
            if format == Format::Kalibr {
                distortion[4] = 0.0;
                denominator = [0.0; 3];
            }
            let lens = Lens { focal_px: focal.into(), principal_point_px: centre.into(), distortion, denominator };
            let camera = Camera::new(size_px, lens);
            let text = format.write(&Draft::of_camera(camera.clone()), None, Path::new("rig.toml")).unwrap();
            prop_assert_eq!(Format::guess(&text, Path::new("f")).unwrap(), format);
            prop_assert_eq!(format.read(&text, Path::new("f")).unwrap(), camera);
            let exponent = |w: &[u8]| w[0].is_ascii_digit() && w[1] == b'e';
            prop_assert!(!text.as_bytes().windows(2).any(exponent), "{}", text);
        }
    }
}

#[test]
fn what_a_camera_s_format_cannot_hold_is_refused() {
    let (rig, name) = (rig(RIG), Path::new("rig.toml"));
    for format in FORMATS {
        assert!(format.write(&rig, Some("direct"), name).is_ok());
        let refused = |view| format.write(&rig, Some(view), name).unwrap_err().to_string();
        let holds = format!("{format} holds the camera alone, no reflection, no refraction");
        let mirror = refused("mirror");
        assert!(mirror.contains("rig.toml: view.mirror.path = [\"side_mirror\"]: expected no mirror"), "{mirror}");
        assert!(mirror.contains(&holds) && mirror.ends_with("DLT coefficients can hold this view"), "{mirror}");
        let tank = refused("tank");
        assert!(tank.contains("[\"front_wall\"]") && tank.ends_with(&holds), "{tank}");
        let unknown = refused("miror");
        assert!(unknown.contains("view = \"miror\"") && unknown.contains("did you mean \"mirror\"?"), "{unknown}");
        let none = format.write(&Draft::of_camera(camera()), Some("mirror"), name).unwrap_err().to_string();
        assert!(none.ends_with("expected no view: this rig has none yet"), "{none}");
    }
    let mut barrel = camera();
    barrel.lens.distortion[4] = 0.03;
    let k3 = Format::Kalibr.write(&Draft::of_camera(barrel), None, name).unwrap_err().to_string();
    assert!(
        k3.contains("camera.distortion = [-0.11, 0.14, 0.0006, -0.0004, 0.03]: expected k3 = 0, it is 0.03"),
        "{k3}"
    );
    let mut wide = camera();
    wide.lens.denominator = [0.2, 0.0, 0.0];
    let k4 = Format::Kalibr.write(&Draft::of_camera(wide), None, name).unwrap_err().to_string();
    assert!(k4.contains("camera.denominator = [0.2, 0.0, 0.0]: expected no denominator"), "{k4}");
}

/// The columns of a DLT file.
fn columns(text: &str) -> Vec<Vec<f64>> {
    let rows: Vec<Vec<f64>> = text.lines().map(|l| l.split(',').map(|n| n.parse().unwrap()).collect()).collect();
    assert_eq!(rows.len(), 11);
    (0..rows[0].len()).map(|c| rows.iter().map(|row| row[c]).collect()).collect()
}

/// Where a DLT sees a point, both in the DLT's own units.
fn seen(l: &[f64], p: &Point3<f64>) -> Point2<f64> {
    let sum = |i: usize, last: f64| l[i] * p.x + l[i + 1] * p.y + l[i + 2] * p.z + last;
    Point2::new(sum(0, l[3]), sum(4, l[7])) / sum(8, 1.0)
}

proptest! {
    // From pixels on, so that every view sees the point; further left and down the second mirror of `twice` is missed.
    #[test]
    fn a_dlt_sees_what_the_view_sees(u in 640.0..1280.0, v in 0.0..512.0, distance_m in 0.05..1.0) {
        let name = Path::new("rig.toml");
        for text in [RIG.to_owned(), RIG.to_owned() + BASE] {
            let rig = rig(&text);
            let world_from_camera = match &rig.base {
                Some(base) => base.base_from_camera,
                None => Isometry3::translation(0.0, 0.0, -dlt::ORIGIN_M),
            };
            for view in &rig.views[..3] {
                let point = view.optics.trace(&Point2::new(u, v)).unwrap().at(distance_m);
                let pixel = view.optics.project(&point).unwrap();
                let world_mm = world_from_camera * point * 1e3;
                for first_pixel in [0.0, 1.0] {
                    let l = columns(&dlt::write(&rig, Some(&view.name), first_pixel, name).unwrap());
                    let off = seen(&l[0], &world_mm) - pixel - Vector2::repeat(first_pixel);
                    prop_assert!(off.norm() < 1e-9, "{}: {off}", view.name);
                }
            }
        }
    }
}

#[test]
fn a_mirror_turns_the_hand_and_two_turn_it_back() {
    let text = RIG.split("[[view]]\nname = \"tank\"").next().unwrap().to_owned() + BASE;
    let rig = rig(&text);
    let all = columns(&dlt::write(&rig, None, 0.0, Path::new("rig.toml")).unwrap());
    let base = rig.base.as_ref().unwrap().base_from_camera;
    let determinants: Vec<bool> = all
        .iter()
        .zip(&rig.views)
        .map(|(l, view)| {
            let rows = nalgebra::Matrix3::new(l[0], l[1], l[2], l[4], l[5], l[6], l[8], l[9], l[10]);
            // The scale's sign is that of the depth of the origin, seen through the mirrors.
            let origin = base.inverse() * Point3::origin();
            let image = view.optics.surfaces.iter().rev().fold(origin, |p, s| s.plane().reflect(&p));
            rows.determinant() * image.z.signum() > 0.0
        })
        .collect();
    assert_eq!(determinants, [true, false, true]);
}

#[test]
fn what_is_no_dlt_is_refused_with_the_reason() {
    let name = Path::new("rig.toml");
    let refused = |text: &str, view| dlt::write(&rig(text), view, 0.0, name).unwrap_err().to_string();
    let wall = refused(RIG, Some("tank"));
    assert!(wall.contains("view.tank.path = [\"front_wall\"]: expected mirrors only"), "{wall}");
    assert!(wall.contains("`front_wall` is a wall (indices 1 | 1.52 | 1.333)"), "{wall}");
    assert_eq!(refused(RIG, None), wall, "all views: one of them is behind the wall");
    let distorted = RIG.replace("[0.0, 0.0, 0.0, 0.0, 0.0]", "[0.0, 0.02, 0.0, 0.0, 0.0]");
    let lens = refused(&distorted, Some("mirror"));
    assert!(lens.contains("camera.distortion = [0.0, 0.02, 0.0, 0.0, 0.0]: expected zeros"), "{lens}");
    assert!(lens.contains("Undistort the pictures"), "{lens}");
    // The base's origin beside the lens.
    let beside = RIG.to_owned() + &BASE.replace("[-900.0, 700.0, 40.0]", "[-60.0, -80.0, 40.0]");
    let depth = refused(&beside, Some("direct"));
    assert!(depth.contains("view.direct") && depth.contains("before or behind the lens: it lies"), "{depth}");
    let bare = dlt::write(&Draft::of_camera(camera()), None, 0.0, name).unwrap_err().to_string();
    assert!(bare.contains("view: expected at least one [[view]]"), "{bare}");
    assert!(refused(RIG, Some("twise")).contains("did you mean \"twice\"?"));
}

fn catoptra(arguments: &[&str]) -> Output {
    let root = env!("CARGO_MANIFEST_DIR");
    Command::new(env!("CARGO_BIN_EXE_catoptra")).current_dir(root).args(arguments).output().unwrap()
}

fn said(output: &Output) -> (Option<i32>, String, String) {
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    (output.status.code(), text(&output.stdout), text(&output.stderr))
}

const DEV_TANK: &str = "sample_frames/truth/rig.toml";

#[test]
fn a_camera_goes_out_and_comes_in_again() {
    let folder = tempfile::tempdir().unwrap();
    let place = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    for format in ["opencv", "ros", "kalibr"] {
        let (file, out) = (place(format), place(&format!("{format}.toml")));
        let (code, stdout, stderr) = said(&catoptra(&["rig", "export", DEV_TANK, "--format", format, "-o", &file]));
        assert_eq!((code, stdout.starts_with(&format!("written: {file}, "))), (Some(0), true), "{stdout} {stderr}");
        assert!(
            stderr.contains("holds the camera alone: front_wall, side_mirror, side_wall are not in it"),
            "{stderr}"
        );
        let (code, stdout, stderr) = said(&catoptra(&["rig", "import", &file, "--out", &out]));
        assert_eq!((code, stdout), (Some(0), format!("written: {out}\n")), "{stderr}");
        assert!(stderr.contains(": read as ") && stderr.contains("the lens came without σ"), "{stderr}");
        let draft = Draft::load(Path::new(&out)).unwrap();
        assert_eq!(draft.camera, camera());
        assert!(draft.provenance["camera"]["inputs_sha256"].get(format).is_some());
        let shown = said(&catoptra(&["rig", "export", &out, "--format", format])).1;
        assert_eq!(shown, std::fs::read_to_string(&file).unwrap());
        // The same again.
        assert_eq!(said(&catoptra(&["rig", "export", DEV_TANK, "--format", format, "-o", &file])).0, Some(0));
    }
    let (code, _, stderr) = said(&catoptra(&["-q", "rig", "import", &place("ros"), "--out", &place("quiet.toml")]));
    assert_eq!((code, stderr.as_str()), (Some(0), ""));
}

/// One that was exported before is replaced.
#[test]
fn an_export_does_not_replace_the_file_of_a_tool() {
    let folder = tempfile::tempdir().unwrap();
    let air = folder.path().join("air.toml");
    std::fs::write(&air, RIG).unwrap();
    let air = air.to_str().unwrap();
    let file = folder.path().join("camera");
    let export = |rig: &str, format: &str| {
        let out = file.to_str().unwrap();
        let (code, _, stderr) = said(&catoptra(&["rig", "export", rig, "--format", format, "-o", out]));
        (code, stderr)
    };
    for name in ["opencv4.yml", "opencv_tutorial.yml", "ros.yaml", "ros_echo.yaml", "kalibr.yaml"] {
        std::fs::copy(sample(name), &file).unwrap();
        let (code, stderr) = export(DEV_TANK, "opencv");
        assert!(code == Some(2) && stderr.contains("exists and is not an export of this command"), "{name}: {stderr}");
        assert_eq!(std::fs::read_to_string(&file).unwrap(), sample_text(name));
    }
    std::fs::remove_file(&file).unwrap();
    let dlt = RIG.replace("path = [\"front_wall\"]", "path = []");
    let views = folder.path().join("views.toml");
    std::fs::write(&views, dlt).unwrap();
    for (rig, format) in
        [(DEV_TANK, "opencv"), (air, "opencv"), (air, "ros"), (views.to_str().unwrap(), "dlt"), (air, "kalibr")]
    {
        let (code, stderr) = export(rig, format);
        assert_eq!(code, Some(0), "{format}: {stderr}");
    }
}

#[test]
fn a_new_lens_takes_what_was_found_with_the_old_one() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("rig.toml");
    std::fs::copy(Path::new(env!("CARGO_MANIFEST_DIR")).join(DEV_TANK), &out).unwrap();
    let before = Draft::load(&out).unwrap();
    let arguments = ["rig", "import", "tests/data/cameras/ros.yaml", "--format", "ros", "--out", out.to_str().unwrap()];
    let (code, _, stderr) = said(&catoptra(&arguments));
    assert_eq!(code, Some(0), "{stderr}");
    assert!(
        stderr.contains("views and base frame of the old file were found with the old lens and are left out"),
        "{stderr}"
    );
    assert!(!stderr.contains("read as"), "the format was given: {stderr}");
    let after = Draft::load(&out).unwrap();
    assert!(after.surfaces.is_empty() && after.views.is_empty() && after.base.is_none());
    assert_eq!((after.markers, after.catheter), (before.markers.clone(), before.catheter.clone()));
    assert_eq!(after.camera, Camera { lens: camera().lens, ..before.camera.clone() }, "blur and chroma offset stay");
    assert_eq!(Draft::load(&folder.path().join("rig.toml.bak")).unwrap(), before);
}

/// Places that were learned are not given by hand after a new lens, and pictures of another size are another camera's.
#[test]
fn what_was_learned_stays_learned_and_another_size_takes_what_the_old_pictures_gave() {
    let folder = tempfile::tempdir().unwrap();
    let (file, out) = (folder.path().join("camera.yaml"), folder.path().join("rig.toml"));
    let ros = sample_text("ros.yaml");
    let learned = Path::new(env!("CARGO_MANIFEST_DIR")).join("calibration/dev_tank/rig.toml");
    let import = |text: &str| {
        std::fs::copy(&learned, &out).unwrap();
        std::fs::write(&file, text).unwrap();
        let done = said(&catoptra(&["rig", "import", file.to_str().unwrap(), "--out", out.to_str().unwrap()]));
        assert_eq!(done.0, Some(0), "{}", done.2);
        (Draft::load(&out).unwrap(), done.2)
    };
    let before = Draft::load(&learned).unwrap();
    assert_eq!(before.provenance["markers"]["places"].as_str(), Some("measured"));
    let (same, told) = import(&ros);
    assert_eq!(same.provenance["markers"], before.provenance["markers"]);
    assert!(same.camera.blur_px.is_some() && told.contains("if this is another camera or lens"), "{told}");
    let (other, told) = import(&ros.replace("image_width: 1280", "image_width: 1282"));
    assert_eq!(other.provenance["markers"], before.provenance["markers"]);
    assert_eq!(other.camera, Camera::new([1282, 1024], camera().lens));
    assert!(other.markers.iter().all(|m| m.usual_residuals.is_empty() && m.centre_m.is_some()));
    assert!(told.contains("pictures of another size and are left out"), "{told}");
}

#[test]
fn the_command_refuses_with_exit_code_2() {
    let folder = tempfile::tempdir().unwrap();
    let place = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    std::fs::write(place("notes.toml"), "not a rig").unwrap();
    std::fs::write(place("air.toml"), RIG).unwrap();
    let air = place("air.toml");
    let ros = "tests/data/cameras/ros.yaml";
    let cases: &[(&[&str], &str)] = &[
        (&["export", DEV_TANK, "--format", "ros", "--view", "mirror"], "no reflection, no refraction"),
        (&["export", DEV_TANK, "--format", "dlt"], "DLT coefficients hold no distortion"),
        (&["export", &air, "--format", "dlt", "--view", "tank"], "hold no refraction"),
        (&["export", &air, "--format", "ros", "--first-pixel", "1"], "--first-pixel is for dlt"),
        (&["export", &air, "--format", "ros", "-o", &air], "is the rig itself"),
        (&["export", &air, "--format", "matlab"], "possible values: opencv, ros, kalibr, dlt"),
        (&["import", "no_such.yaml", "--out", &place("new.toml")], "cannot read no_such.yaml"),
        (&["import", ros, "--format", "kalibr", "--out", &place("new.toml")], "cam0: missing, expected the camera"),
        (&["import", ros, "--out", &place("notes.toml")], "exists and is not a rig file"),
    ];
    for (arguments, expected) in cases {
        let (code, stdout, stderr) = said(&catoptra(&[&["rig"], *arguments].concat()));
        assert_eq!((code, stdout.as_str()), (Some(2), ""), "{arguments:?}: {stderr}");
        assert!(stderr.contains(expected), "{arguments:?}: {stderr}");
    }
    assert!(!folder.path().join("new.toml").exists());
    assert_eq!(std::fs::read_to_string(&air).unwrap(), RIG);
}

#[test]
fn what_a_dlt_s_numbers_mean_is_told_beside_them() {
    let folder = tempfile::tempdir().unwrap();
    let air = folder.path().join("air.toml");
    std::fs::write(&air, RIG).unwrap();
    let arguments =
        ["rig", "export", air.to_str().unwrap(), "--format", "dlt", "--view", "mirror", "--first-pixel", "1"];
    let (code, stdout, stderr) = said(&catoptra(&arguments));
    assert_eq!((code, columns(&stdout).len()), (Some(0), 1), "{stderr}");
    for part in ["columns: mirror", "origin moved 1000 mm forward", "(1, 1) in the centre of the top-left"] {
        assert!(stderr.contains(part), "{stderr}");
    }
    std::fs::write(&air, RIG.to_owned() + BASE).unwrap();
    let (_, _, stderr) = said(&catoptra(&arguments[..7]));
    assert!(stderr.contains("mm in the base frame") && stderr.contains("(0, 0) in the centre"), "{stderr}");
}
