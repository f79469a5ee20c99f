//! Rig files from end to end: read, checked, written, explained by `catoptra rig check`.

use catoptra::optics::{Mirror, Plane, Surface};
use catoptra::rig::check::{Warning, check};
use catoptra::rig::{Draft, Rig, RigError};
use nalgebra::{Isometry3, Point2, Point3, UnitQuaternion, Vector3};
use proptest::prelude::*;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

/// A camera that looks straight into a tank, and a mirror at 45° on the right: angles and places can be had by hand.
const RIG: &str = r#"
[camera]
width_px = 1280
height_px = 1024
focal_px = [2700.0, 2700.0]
principal_point_px = [640.0, 512.0]
distortion = [0.0, 0.0, 0.0, 0.0, 0.0]
blur_px = 0.7

[surfaces.front_wall]
kind = "wall"
normal = [0.0, 0.0, -1.0]
offset_mm = -1000.0
thickness_mm = 5.0
index_outside = 1.0
index_wall = 1.52
index_inside = 1.333

[surfaces.side_wall]
kind = "wall"
normal = [1.0, 0.0, 0.0]
offset_mm = 60.0
thickness_mm = 5.0
index_outside = 1.0
index_wall = 1.52
index_inside = 1.333

[surfaces.side_mirror]
kind = "mirror"
normal = [-0.707106781187, 0.0, -0.707106781187]
offset_mm = -855.599205236

[[view]]
name = "direct"
path = ["front_wall"]
region_px = [[540.0, 412.0], [740.0, 412.0], [740.0, 612.0], [540.0, 612.0]]

[[view]]
name = "mirror"
path = ["side_mirror", "side_wall"]
region_px = [[810.0, 412.0], [1010.0, 412.0], [1010.0, 612.0], [810.0, 612.0]]

[[marker]]
name = "base"
length_mm = 6.0
centre_mm = 6.0

[marker.colour]
discriminant_rgb = [0.012, -0.004, -0.011]
bias = -0.25
rgb = [150.0, 120.0, 40.0]

[[marker]]
name = "coil"
length_mm = 12.0
centre_mm = 85.0

[[marker]]
name = "tip"
length_mm = 6.0
centre_mm = 107.0

[catheter]
diameter_mm = 3.2
coil = "coil"
end = "tip"

[base]
b0 = [1.0, 0.0, 0.0]
gravity = [0.0, 1.0, 0.0]

[base.base_from_camera]
rotation = [[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]
translation_mm = [3.0, 1094.0, 40.0]

[provenance]
source = "a test"
residual_px = 0.05
inputs = { board = "12 mm" }
"#;

fn read(text: &str) -> Result<Rig, RigError> {
    Rig::from_toml_str(text, Path::new("rig.toml"))
}

/// [`RIG`] with one place changed.
fn changed(from: &str, to: &str) -> String {
    assert!(RIG.contains(from), "{from} is not in the test rig");
    RIG.replacen(from, to, 1)
}

fn dev_tank() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("sample_frames/truth/rig.toml")
}

#[test]
fn millimetres_become_metres_and_names_become_indices() {
    let rig = read(RIG).unwrap();
    assert_eq!(rig.camera.size_px, [1280, 1024]);
    assert_eq!(rig.camera.blur_px, Some(0.7));
    let Surface::Wall(front) = rig.surfaces["front_wall"] else { panic!("front_wall is a wall") };
    assert_eq!((front.thickness_m, front.index_wall, front.outer.offset_m()), (0.005, 1.52, -1.0));
    assert_eq!(rig.view("mirror"), Some(1));
    assert_eq!(rig.views[1].optics.surfaces, vec![rig.surfaces["side_mirror"], rig.surfaces["side_wall"]]);
    assert_eq!((rig.catheter.coil, rig.catheter.end, rig.marker("base")), (1, Some(2), Some(0)));
    assert_eq!(rig.catheter.diameter_m, 0.0032);
    assert_eq!((rig.markers[1].length_m, rig.markers[1].centre_m), (0.012, Some(0.085)));
    let planes = &rig.markers[0].colour(1).unwrap().planes;
    assert_eq!((planes.len(), planes[0].weights), (1, Vector3::new(0.012, -0.004, -0.011)), "one for all views");
    // Row y = (0, 0, -1): a point 1 m ahead of the camera, 1 mm to the right.
    let in_base = rig.base.unwrap().base_from_camera * Point3::new(0.001, 0.0, 1.0);
    assert!((in_base - Point3::new(0.004, 0.094, 0.040)).norm() < 1e-12, "{in_base}");
    assert!(rig.views[0].contains(&Point2::new(600.0, 500.0)) && !rig.views[0].contains(&Point2::new(800.0, 500.0)));
}

/// Every mistake is told with the key, the value, and what would be right.
#[test]
fn mistakes_are_named() {
    let cases: &[(&str, &str, &[&str])] = &[
        ("focal_px", "focal_pix", &["unknown key `focal_pix`", "did you mean `focal_px`?"]),
        ("[catheter]", "[cateter]", &["unknown key `cateter`", "did you mean `catheter`?"]),
        ("width_px = 1280", "width_px = 0", &["camera.width_px = 0", "1 to 65535"]),
        ("[2700.0, 2700.0]", "[nan, 2700.0]", &["camera.focal_px = NaN", "positive"]),
        ("[640.0, 512.0]", "[640.0, inf]", &["camera.principal_point_px = [640.0, inf]", "finite"]),
        ("[0.0, 0.0, 0.0, 0.0, 0.0]", "[0.0, nan, 0.0, 0.0, 0.0]", &["camera.distortion", "NaN", "finite"]),
        ("blur_px = 0.7", "blur_px = -0.7", &["camera.blur_px = -0.7", "positive"]),
        ("path = [\"front", "blur_px = 0.0\npath = [\"front", &["view.direct.blur_px = 0", "positive"]),
        ("blur_px = 0.7", "colour_offset_px = [0.0, 2.5]", &["camera.colour_offset_px = 2.5", "2 px or less"]),
        ("blur_px = 0.7", "readout_ms = 300.0", &["camera.readout_ms = 300", "at most 200, and at least -200"]),
        ("[0.0, 0.0, -1.0]", "[0.0, 0.6, -0.9]", &["surfaces.front_wall.normal", "length 1, it is 1.081665", "0.5547"]),
        ("[0.0, 0.0, -1.0]", "[0.0, nan, -1.0]", &["surfaces.front_wall.normal = [0.0, NaN, -1.0]", "finite"]),
        ("[0.0, 0.0, -1.0]", "[0.0, 0.0, 0.0]", &["surfaces.front_wall.normal", "it is 0.000000"]),
        ("offset_mm = -1000.0", "offset_mm = inf", &["surfaces.front_wall.offset_mm = inf", "finite"]),
        ("thickness_mm = 5.0", "thickness_mm = 0.0", &["surfaces.front_wall.thickness_mm = 0", "positive"]),
        ("thickness_mm = 5.0\n", "", &["surfaces.front_wall.thickness_mm: missing, a wall needs it"]),
        ("index_inside = 1.333", "index_inside = 0.75", &["surfaces.front_wall.index_inside = 0.75", "water 1.333"]),
        ("index_wall = 1.52", "index_wall = nan", &["surfaces.front_wall.index_wall = NaN", "1 to 3"]),
        (
            "kind = \"mirror\"",
            "kind = \"mirror\"\nindex_wall = 1.5",
            &["surfaces.side_mirror.index_wall", "only a wall"],
        ),
        ("kind = \"mirror\"", "kind = \"miror\"", &["`miror`", "`mirror`"]),
        (
            "[-0.707106781187, 0.0, -0.707106781187]\noffset_mm = -855",
            "[0.707106781187, 0.0, 0.707106781187]\noffset_mm = 855",
            &["surfaces.side_mirror.offset_mm = 855.599205236", "negative", "where the camera is"],
        ),
        ("[\"front_wall\"]", "[\"frontwall\"]", &["view.direct.path = \"frontwall\"", "did you mean \"front_wall\"?"]),
        (
            "[\"side_mirror\", \"side_wall\"]",
            "[\"side_wall\", \"side_mirror\"]",
            &["view.mirror.path", "region's centre", "total reflection"],
        ),
        ("[\"front_wall\"]", "[\"front_wall\", \"front_wall\"]", &["view.direct.path", "does not meet a surface"]),
        ("name = \"mirror\"", "name = \"direct\"", &["view.name = \"direct\"", "different name"]),
        ("name = \"mirror\"", "name = \"a mirror\"", &["view.name = \"a mirror\"", "letters, digits"]),
        (", [740.0, 612.0], [540.0, 612.0]]", "]", &["view.direct.region_px", "at least 3 corners"]),
        (
            "[740.0, 612.0]",
            "[740.0, 1024.0]",
            &["view.direct.region_px = [740.0, 1024.0]", "inside the picture", "1023.5"],
        ),
        ("[740.0, 612.0], [540.0, 612.0]", "[540.0, 412.0]", &["view.direct.region_px", "around an area"]),
        ("name = \"tip\"", "name = \"coil\"", &["marker.name = \"coil\"", "different name"]),
        ("length_mm = 12.0", "length_mm = -12.0", &["marker.coil.length_mm = -12", "positive"]),
        ("centre_mm = 6.0", "centre_mm = 2.0", &["marker.base.centre_mm = 2", "at least 3"]),
        (
            "centre_mm = 107.0",
            "centre_mm = 93.0",
            &["marker.tip.centre_mm = 93.0", "reaches to 91.0 mm", "94.0 or more"],
        ),
        (
            "centre_mm = 85.0",
            "centre_mm = 85.0\nusual_residuals = [3.0]",
            &["marker.coil.usual_residuals = [3.0]", "2 numbers, one for each view"],
        ),
        (
            "centre_mm = 85.0",
            "centre_mm = 85.0\nusual_residuals = [3.0, -1.0]",
            &["marker.coil.usual_residuals = -1", "positive"],
        ),
        ("bias = -0.25", "bias = nan", &["marker.base.colour.bias = NaN", "finite"]),
        ("[150.0, 120.0, 40.0]", "[150.0, 420.0, 40.0]", &["marker.base.colour.rgb", "0 to 255"]),
        ("[0.012, -0.004, -0.011]", "[0.0, 0.0, 0.0]", &["marker.base.colour.discriminant_rgb", "not all zero"]),
        ("diameter_mm = 3.2", "diameter_mm = 0.0", &["catheter.diameter_mm = 0", "positive"]),
        ("diameter_mm = 3.2", "diameter_mm = 3200000.0", &["catheter.diameter_mm = 3200000", "at most 1000"]),
        ("coil = \"coil\"", "coil = \"coill\"", &["catheter.coil = \"coill\"", "did you mean \"coil\"?"]),
        ("end = \"tip\"", "end = \"nothing\"", &["catheter.end = \"nothing\"", "base, coil, tip"]),
        ("end = \"tip\"", "end = \"coil\"", &["catheter.end = \"coil\"", "the last marker along the tube, \"tip\""]),
        (
            "[0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]",
            "[0.0, 0.0, -1.0], [0.0, 0.9, 0.1]]",
            &["base.base_from_camera.rotation", "off by"],
        ),
        ("[0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]", "[0.0, 0.0, 1.0], [0.0, 1.0, 0.0]]", &["rotation", "right-handed"]),
        ("[3.0, 1094.0, 40.0]", "[3.0, nan, 40.0]", &["base.base_from_camera.translation_mm", "finite"]),
        ("b0 = [1.0, 0.0, 0.0]", "b0 = [3.0, 0.0, 0.0]", &["base.b0 = [3.0, 0.0, 0.0]", "length 1"]),
        ("gravity = [0.0, 1.0, 0.0]", "gravity = [0.0, 9.81, 0.0]", &["base.gravity", "[0.0, 1.0, 0.0]"]),
        (
            "[provenance]",
            "[provenance.rig]\ncovariance = [[1e-6, nan], [0.0, 1e-6]]\n[provenance]",
            &["provenance.rig.covariance[0][1] = NaN", "a finite number"],
        ),
        (
            "[provenance]",
            "[provenance.rig]\ncovariance = [[1e-6, 0.0], [0.0, -1e-6]]\n[provenance]",
            &["provenance.rig.covariance[1][1] = -0.000001", "not negative"],
        ),
        (
            "[provenance]",
            "[provenance.camera]\nlens_covariance = [[inf]]\n[provenance]",
            &["provenance.camera.lens_covariance[0][0] = inf", "a finite number"],
        ),
        (
            "[provenance]",
            "[provenance.camera]\nlens_covariance = [[1.0, 0.0], [0.0, 1.0]]\n[provenance]",
            &["provenance.camera.lens_covariance = 2 rows", "9 rows of 9 numbers, one for each number of the lens"],
        ),
        (
            "[provenance]",
            "[provenance.rig]\nparameters = [\"a\", \"b\"]\ncovariance = [[1.0, 0.0], [0.0]]\n[provenance]",
            &["provenance.rig.covariance[1] = 1 numbers", "2 rows of 2 numbers, one for each of rig.parameters"],
        ),
        (
            "[provenance]",
            "[provenance.rig]\nparameters = [\"a\"]\ncovariance = [[\"1e-6\"]]\n[provenance]",
            &["provenance.rig.covariance[0][0] = \"1e-6\"", "a number"],
        ),
        (
            "[provenance]",
            "[provenance.rig]\nvolume_mm = [[0.0, 0.0, 0.0]]\n[provenance]",
            &["provenance.rig.volume_mm = 1 rows", "2 rows of 3 numbers, lowest and highest corner"],
        ),
        (
            "[provenance]",
            "[provenance.rig]\nparameters = [\"a\", \"a\"]\ncovariance = [[4.0, 1.0], [1.0, 4.0]]\n[provenance]",
            &["provenance.rig.parameters[1] = \"a\"", "each parameter once"],
        ),
        (
            "[provenance]",
            "[provenance.base]\norigin_sd_mm = [-1.0, 0, 0]\n[provenance]",
            &["provenance.base.origin_sd_mm = [-1.0, 0, 0]", "three standard deviations, none below 0"],
        ),
        (
            "[provenance]",
            "[provenance.rig]\nparameters = [\"a\", \"b\"]\ncovariance = [[4.0, 1.0], [1.1, 4.0]]\n[provenance]",
            &["provenance.rig.covariance[1][0] = 1.1", "1, as in row 0 and column 1: a covariance is symmetric"],
        ),
        (
            "[provenance]",
            "[provenance.rig]\nparameters = [\"a\", \"b\"]\ncovariance = [[4.0, 5.0], [5.0, 4.0]]\n[provenance]",
            &["provenance.rig.covariance = ", "the least eigenvalue of its correlations is -0.25"],
        ),
        (
            "[provenance]",
            "[provenance.camera.lens]\nfocal_px = [2700.0]\n[provenance]",
            &["provenance.camera.lens.focal_px = [2700.0]", "a list of 2 finite numbers"],
        ),
    ];
    for (from, to, expected) in cases {
        let message = read(&changed(from, to)).expect_err(to).to_string();
        assert!(message.starts_with("rig.toml:"), "{message}");
        for part in *expected {
            assert!(message.contains(part), "{to}: {message:?} lacks {part:?}");
        }
    }
}

#[test]
fn a_rig_needs_views_and_markers() {
    let without = |section: &str| {
        let mut kept = String::new();
        let mut skip = false;
        for line in RIG.lines() {
            if line.starts_with('[') {
                skip = line.starts_with(section) || (section == "[[marker" && line.starts_with("[marker"));
            }
            if !skip {
                kept.push_str(line);
                kept.push('\n');
            }
        }
        read(&kept).unwrap_err().to_string()
    };
    assert_eq!(without("[[view"), "rig.toml: view: expected at least one [[view]]: `catoptra calibrate rig` adds them");
    assert_eq!(
        without("[[marker"),
        "rig.toml: marker: expected at least one [[marker]]: `catoptra calibrate markers` adds them"
    );
}

#[test]
fn a_draft_has_what_is_known_so_far_and_is_read_as_it_was_written() {
    let whole = Draft::from_toml_str(RIG, Path::new("rig.toml")).unwrap();
    let mut draft = Draft::of_camera(whole.camera.clone());
    let again = |draft: &Draft| Draft::from_toml_str(&draft.to_toml_string(), Path::new("rig.toml")).unwrap();
    assert_eq!(again(&draft), draft);
    assert!(draft.clone().complete(Path::new("a.toml")).unwrap_err().to_string().starts_with("a.toml: view: expected"));
    (draft.surfaces, draft.views) = (whole.surfaces.clone(), whole.views.clone());
    assert_eq!(again(&draft).views, draft.views);
    assert!(draft.complete(Path::new("a.toml")).unwrap_err().to_string().starts_with("a.toml: marker: expected"));
    assert_eq!(Draft::from(read(RIG).unwrap()), whole);
}

#[test]
fn media_must_agree_between_walls() {
    // Through the front into water, then out through a side wall that has oil inside.
    let text = changed("path = [\"front_wall\"]", "path = [\"front_wall\", \"back_wall\"]")
        + "[surfaces.back_wall]\nkind = \"wall\"\nnormal = [0.0, 0.0, 1.0]\noffset_mm = 1300.0\nthickness_mm = 5.0\n\
           index_outside = 1.0\nindex_wall = 1.52\nindex_inside = 1.4\n";
    let message = read(&text).unwrap_err().to_string();
    assert!(message.contains("`back_wall` is met from index 1.4 while the ray is in 1.333"), "{message}");
    assert!(read(&text.replace("index_inside = 1.4\n", "index_inside = 1.333\n")).is_ok());
}

#[test]
fn what_is_read_and_written_reads_the_same() {
    let own_blur = changed("name = \"mirror\"\n", "name = \"mirror\"\nblur_px = 0.9\n");
    let of = |text: &str| read(text).unwrap().blurs_px().map(|px| px.unwrap().into()).collect::<Vec<[f64; 2]>>();
    assert_eq!(of(&own_blur), [[0.7; 2], [0.9; 2]]);
    let along_x = changed("name = \"mirror\"\n", "name = \"mirror\"\nblur_px = [1.1, 0.5]\n");
    assert_eq!(of(&along_x), [[0.7; 2], [1.1, 0.5]]);
    let three = read(&along_x.replace("[1.1, 0.5]", "[1, 2, 3]")).unwrap_err().to_string();
    assert!(three.contains("a number of pixels, or two: along x and along y"), "{three}");
    let rolling = changed("blur_px = 0.7", "readout_ms = -14.5");
    assert_eq!(read(&rolling).unwrap().camera.readout_s, Some(-14.5e-3));
    let beside = changed("blur_px = 0.7", "colour_offset_px = [-1.0, 0.25]");
    assert_eq!(read(&beside).unwrap().camera.colour_offset_px, [-1.0, 0.25]);
    for text in [RIG.to_owned(), own_blur, along_x, rolling, beside, std::fs::read_to_string(dev_tank()).unwrap()] {
        let rig = read(&text).unwrap();
        let written = rig.to_toml_string();
        let again = read(&written).unwrap();
        assert_eq!(again.to_toml_string(), written);
        assert_eq!((&again.camera, &again.markers, &again.catheter), (&rig.camera, &rig.markers, &rig.catheter));
        assert_eq!(again.provenance, rig.provenance);
        for (view, other) in rig.views.iter().zip(&again.views) {
            assert_eq!((&view.name, &view.path, &view.region_px), (&other.name, &other.path, &other.region_px));
            assert_eq!(view.blur_px, other.blur_px);
        }
        let (a, b) = (rig.base.unwrap().base_from_camera, again.base.unwrap().base_from_camera);
        assert!((a.to_matrix() - b.to_matrix()).amax() < 2e-12);
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// After one passage through a file nothing changes any more, to the last bit, and the passage itself costs 1e-12.
    #[test]
    fn any_geometry_survives_the_file(
        normal in prop::array::uniform3(-1.0..1.0_f64), offset_m in -2.0..-0.5_f64,
        turn in prop::array::uniform3(-3.0..3.0_f64), shift_m in prop::array::uniform3(-2.0..2.0_f64),
        focal in 500.0..5000.0_f64, length_m in 0.001..0.02_f64,
    ) {
        prop_assume!(Vector3::from(normal).norm() > 0.1);
        let mut rig = read(RIG).unwrap();
        let plane = Plane::new(Vector3::from(normal).normalize(), offset_m).unwrap();
        rig.surfaces.insert("spare_mirror".into(), Surface::Mirror(Mirror { plane }));
        let rotation = UnitQuaternion::from_scaled_axis(Vector3::from(turn));
        let base = rig.base.as_mut().unwrap();
        base.base_from_camera = Isometry3::from_parts(Vector3::from(shift_m).into(), rotation);
        rig.camera.lens.focal_px.x = focal;
        for view in &mut rig.views {
            view.optics.lens = rig.camera.lens;
        }
        rig.markers[0].length_m = length_m;
        rig.markers[0].centre_m = None;

        let once = read(&rig.to_toml_string()).unwrap();
        let twice = read(&once.to_toml_string()).unwrap();
        prop_assert_eq!(&once, &twice);
        let (Surface::Mirror(a), Surface::Mirror(b)) = (rig.surfaces["spare_mirror"], once.surfaces["spare_mirror"])
            else { panic!("both are mirrors") };
        prop_assert!((a.plane.normal() - b.plane.normal()).amax() < 2e-12);
        prop_assert!((a.plane.offset_m() - b.plane.offset_m()).abs() < 1e-12);
        let (a, b) = (rig.base.unwrap().base_from_camera, once.base.unwrap().base_from_camera);
        prop_assert!((a.to_matrix() - b.to_matrix()).amax() < 2e-12);
        prop_assert!((rig.markers[0].length_m - once.markers[0].length_m).abs() < 1e-12);
    }
}

#[test]
fn saving_replaces_the_file_whole_or_not_at_all() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("rig.toml");
    let mut rig = read(RIG).unwrap();
    rig.save(&path).unwrap();
    rig.markers[1].length_m = 0.010;
    rig.save(&path).unwrap();
    assert_eq!(Rig::load(&path).unwrap().markers[1].length_m, 0.010);

    rig.catheter.diameter_m = f64::NAN;
    assert!(rig.save(&path).unwrap_err().to_string().contains("catheter.diameter_mm"));
    assert_eq!(Rig::load(&path).unwrap().markers[1].length_m, 0.010);
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1, "no other file is left");

    rig.catheter.diameter_m = 0.003;
    let nowhere = folder.path().join("no/such/folder/rig.toml");
    assert!(matches!(rig.save(&nowhere), Err(RigError::Write { file, .. }) if file == nowhere));
}

#[test]
fn light_paths_by_hand() {
    let seen = check(&read(RIG).unwrap().into()).unwrap();
    // direct: along the optical axis, straight through the pane.
    let direct = &seen.views[0];
    assert!((direct.centre_px - Point2::new(640.0, 512.0)).norm() < 1e-9);
    assert!(direct.crossings[0].incidence_rad < 1e-9);
    assert!((direct.crossings[0].point - Point3::new(0.0, 0.0, 1.005)).norm() < 1e-9);
    // mirror: pixel 910 looks along (0.1, 0, 1), meets x + z = 1210 mm at (110, 0, 1100), leaves along (-1, 0, -0.1).
    let mirror = &seen.views[1];
    assert!((mirror.crossings[0].point - Point3::new(0.110, 0.0, 1.100)).norm() < 1e-9);
    assert!((mirror.crossings[0].incidence_rad.to_degrees() - 39.2894).abs() < 1e-4); // 45° - atan 0.1
    assert!((mirror.crossings[1].incidence_rad.to_degrees() - 5.7106).abs() < 1e-4); // atan 0.1
    assert_eq!(mirror.crossings[1].media, Some((1.0, 1.333)));
    // It enters the glass at (60, 0, 1095). sin = 0.0995037 in air, /1.52 in glass, /1.333 in water.
    let (in_glass, in_water) = ((0.0995037_f64 / 1.52).asin(), (0.0995037_f64 / 1.333).asin());
    let z = 1.095 - 0.005 * in_glass.tan() - 0.055 * in_water.tan();
    let meeting = seen.closest_approach.unwrap();
    assert!((meeting.point - Point3::new(0.0, 0.0, z)).norm() < 1e-7, "{}", meeting.point);
    assert!(meeting.apart_m < 1e-9);
    assert!((meeting.angle_rad - std::f64::consts::FRAC_PI_2 - in_water).abs() < 1e-6);
    // Seen straight on, water is 1/1.333 and glass 1/1.52 as deep as it is.
    let refraction = direct.refraction.unwrap();
    assert!((refraction.nearer_m - ((z - 1.005) * (1.0 - 1.0 / 1.333) + 0.005 * (1.0 - 1.0 / 1.52))).abs() < 1e-7);
    assert!(refraction.beside_m < 1e-9);
    // Multiples of 16 px: columns 544 to 736, rows 416 to 608.
    assert_eq!((direct.round_trip.pixels, direct.round_trip.with_ray), (13 * 13, 13 * 13));
    assert!(seen.usable() && mirror.round_trip.max_error_px < 1e-9);
    // 2·atan(640/2700), 2·atan(512/2700), the half pixel of the off-centre principal point aside.
    assert!((seen.field_of_view_rad[0].unwrap().to_degrees() - 26.67).abs() < 0.01);
    assert!((seen.field_of_view_rad[1].unwrap().to_degrees() - 21.48).abs() < 0.01);
    assert_eq!(seen.warnings, [Warning::NoColour { markers: vec!["coil".into(), "tip".into()] }]);
}

#[test]
fn bands_of_one_colour_are_told() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("calibration/dev_tank/rig.toml");
    let mut rig = Draft::load(&path).unwrap();
    let same = |rig: &Draft| {
        let warnings = check(rig).unwrap().warnings;
        warnings.iter().filter(|w| matches!(w, Warning::SameColour { .. })).map(ToString::to_string).collect::<Vec<_>>()
    };
    assert_eq!(same(&rig), Vec::<String>::new());
    rig.markers[2].colours = rig.markers[0].colours.clone();
    let said = same(&rig);
    assert!(matches!(said.as_slice(), [said] if said.starts_with("base and tip have the same colour in view direct")));
}

#[test]
fn warnings_say_what_is_missing_or_odd() {
    let warned = |text: &str| -> Vec<String> {
        check(&read(text).unwrap().into()).unwrap().warnings.iter().map(ToString::to_string).collect()
    };
    let any = |warnings: &[String], part: &str| {
        assert!(warnings.iter().any(|w| w.contains(part)), "{warnings:?} lack {part:?}");
    };
    any(&warned(&changed("blur_px = 0.7\n", "")), "blur_px is not given");
    any(&warned(&changed("centre_mm = 85.0\n", "")), "centre_mm not given for coil");
    any(&warned(&changed("b0 = [1.0, 0.0, 0.0]", "b0 = [0.0, 0.0, -1.0]")), "b0 is 90.0° off");
    any(&warned(&changed("[640.0, 512.0]", "[440.0, 512.0]")), "principal point is 200 px");
    // In metres, not given, and in no view.
    for (place, word) in [
        ("[0.003, 1.094, 0.04]", "mm from where the views look"),
        ("[0.0, 0.0, 0.0]", "mm from where the views look"),
        ("[3.0, 1094.0, 150.0]", "in no view's region"),
    ] {
        any(&warned(&changed("[3.0, 1094.0, 40.0]", place)), word);
    }
    any(&warned(&changed("[740.0, 612.0]", "[900.0, 612.0]")), "the regions of direct and mirror overlap");
    assert!(!warned(RIG).iter().any(|w| w.contains("pixels wide")));
    any(&warned(&changed("diameter_mm = 3.2", "diameter_mm = 1.6")), "view mirror: the tube is 3.");
    let region = "region_px = [[540.0, 412.0], [740.0, 412.0], [740.0, 612.0], [540.0, 612.0]]\n";
    any(&warned(&changed(region, "")), "view direct has no region_px");
    let base = RIG.find("[base]").unwrap();
    any(&warned(&RIG[..base]), "no [base]");
    let mirror =
        changed("index_inside = 1.333\n\n[surfaces.side_mirror]", "index_inside = 1.4\n\n[surfaces.side_mirror]");
    any(&warned(&mirror), "different index [1.333, 1.4]");
    let (head, tail) = (RIG.find("[[view]]\nname = \"mirror\"").unwrap(), RIG.find("[[marker]]").unwrap());
    let one_view = warned(&format!("{}{}", &RIG[..head], &RIG[tail..]));
    any(&one_view, "one view only");
    any(&one_view, "surface side_mirror is on no view's path");
    // A mirror turned until its rays graze it: its normal 80° from the central ray (0.1, 0, 1).
    let n = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), 80.0_f64.to_radians())
        * -Vector3::new(0.1, 0.0, 1.0).normalize();
    let grazing = changed(
        "[-0.707106781187, 0.0, -0.707106781187]\noffset_mm = -855.599205236",
        &format!("[{:.12}, 0.0, {:.12}]\noffset_mm = {:.9}", n.x, n.z, 110.0 * n.x + 1100.0 * n.z),
    );
    let grazing = grazing.replace("path = [\"side_mirror\", \"side_wall\"]", "path = [\"side_mirror\"]");
    any(&warned(&grazing), "side_mirror is met nearly edge-on (80.0°");
    assert!(!warned(RIG).iter().any(|w| w.contains("the central rays of the views")));
    // A mirror that leans.
    let leaning = changed(
        "[-0.707106781187, 0.0, -0.707106781187]\noffset_mm = -855.599205236",
        "[-0.656532164299, 0.371390676354, -0.656532164299]\noffset_mm = -794.403918801",
    );
    any(&warned(&leaning), "the central rays of the views");
}

#[expect(clippy::unwrap_used, reason = "called by tests only: a program that cannot be started fails them")]
fn catoptra(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_catoptra"))
        .args(arguments)
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .output()
        .unwrap()
}

#[test]
fn the_command_explains_the_sample_rig() {
    let out = catoptra(&["rig", "check", "sample_frames/truth/rig.toml"]);
    let text = String::from_utf8(out.stdout).unwrap();
    assert_eq!(out.status.code(), Some(0), "{}", String::from_utf8_lossy(&out.stderr));
    for part in [
        "1280 x 1024 px",
        "camera in air 1 -> through front_wall (glass 1.52) into water 1.333 -> marker",
        "camera in air 1 -> reflected by side_mirror -> through side_wall (glass 1.52) into water 1.333 -> marker",
        "met 1267.1 mm along it",
        "origin           (-105.6, -51.9, 1397.7) mm",
        "0 points lost",
        "made from the renderer's truth",
    ] {
        assert!(text.contains(part), "{part:?} is not in\n{text}");
    }
}

#[test]
fn exit_codes_and_messages_of_bad_rig_files() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("rig.toml");
    let cases = [
        ("blur_px", "blurr_px", "unknown key `blurr_px`, did you mean `blur_px`?"),
        ("offset_mm = -1000.0", "offset_mm = nan", "surfaces.front_wall.offset_mm = NaN: expected a finite number"),
        ("[0.0, 0.0, -1.0]", "[0.0, 0.1, -1.0]", "surfaces.front_wall.normal = [0.0, 0.1, -1.0]: expected length 1"),
        (
            "\"side_wall\"]",
            "\"side_wal\"]",
            "view.mirror.path = \"side_wal\": expected the name of a surface, did you mean",
        ),
    ];
    for (from, to, message) in cases {
        std::fs::write(&path, changed(from, to)).unwrap();
        let out = catoptra(&["rig", "check", path.to_str().unwrap()]);
        let stderr = String::from_utf8(out.stderr).unwrap();
        assert_eq!(out.status.code(), Some(2), "{stderr}");
        assert!(stderr.starts_with("error: ") && stderr.contains(message), "{stderr}");
        assert_eq!(stderr.matches(message).count(), 1, "told once: {stderr}");
        assert!(out.stdout.is_empty());
    }
    let out = catoptra(&["rig", "check", "no_such_rig.toml"]);
    let stderr = String::from_utf8(out.stderr).unwrap();
    assert_eq!(out.status.code(), Some(2));
    assert!(stderr.starts_with("error: cannot read rig file no_such_rig.toml\n  because: No such file"), "{stderr}");
    assert_eq!(catoptra(&["rig", "chek"]).status.code(), Some(2));
    assert_eq!(catoptra(&["rig", "check", "--help"]).status.code(), Some(0));
}

#[test]
fn a_reader_that_stops_reading_is_no_failure() {
    let mut child = Command::new(env!("CARGO_BIN_EXE_catoptra"))
        .args(["rig", "check", dev_tank().to_str().unwrap()])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    drop(child.stdout.take());
    let out = child.wait_with_output().unwrap();
    assert_eq!((out.status.code(), out.stderr.as_slice()), (Some(0), b"".as_slice()));
}

/// The renderer's truth, turned into a rig file by the script: the committed one, and one without a tank.
#[test]
fn the_script_makes_rigs_from_truth() {
    let python = std::env::var("CATOPTRA_PYTHON").unwrap_or_else(|_| "python3".into());
    if Command::new(&python).arg("--version").output().is_err() {
        return; // Nothing else in the project needs Python.
    }
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let rest = root.join("sample_frames/truth/rest.csv");
    let script = |truth: &Path| {
        let out = Command::new(&python)
            .arg(root.join("scripts/rig_from_truth.py"))
            .args([truth, &rest])
            .args(["--region", "mirror:706,280,1085,269,1078,730,701,702"])
            .output()
            .unwrap();
        assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
        read(&String::from_utf8(out.stdout).unwrap()).unwrap()
    };
    let truth = root.join("sample_frames/truth/rig.json");
    let (made, committed) = (script(&truth), Rig::load(&dev_tank()).unwrap());
    assert_eq!(made.camera.lens, committed.camera.lens);
    assert_eq!(made.views[1].region_px, committed.views[1].region_px);
    for (name, surface) in &made.surfaces {
        let other = committed.surfaces[name].plane();
        assert!((surface.plane().normal() - other.normal()).amax() < 2e-12, "{name}");
        assert!((surface.plane().offset_m() - other.offset_m()).abs() < 1e-12, "{name}");
    }
    // The tube at rest hangs from the base frame's origin along z.
    let base = made.base.unwrap().base_from_camera;
    assert!((base * Point3::new(-0.105637320, -0.051949242, 1.397731792)).coords.norm() < 1e-9);
    assert!(
        (base * Vector3::new(-0.00697461568507852, 0.9990238754814212, 0.043619387365336) - Vector3::z()).norm() < 1e-9
    );

    let folder = tempfile::tempdir().unwrap();
    let in_air = folder.path().join("rig.json");
    let text = std::fs::read_to_string(&truth).unwrap().replace("\"tank\":", "\"no_tank\":");
    std::fs::write(&in_air, text).unwrap();
    let rig = script(&in_air);
    assert_eq!((rig.views[0].path.len(), rig.views[1].path.as_slice()), (0, ["side_mirror".to_owned()].as_slice()));
    assert!(check(&rig.clone().into()).unwrap().usable());
}

/// After each calibration there is something to look at, and what is missing is named with the command that finds it.
#[test]
fn a_rig_that_is_not_finished_is_shown_as_far_as_it_has_got() {
    let folder = tempfile::tempdir().unwrap();
    let whole = Draft::load(&Path::new(env!("CARGO_MANIFEST_DIR")).join("calibration/dev_tank/rig.toml")).unwrap();
    let shown = |name: &str, draft: &Draft| {
        let path = folder.path().join(name);
        draft.save(&path).unwrap();
        let out = catoptra(&["rig", "check", path.to_str().unwrap()]);
        assert_eq!(out.status.code(), Some(0), "{}", String::from_utf8_lossy(&out.stderr));
        String::from_utf8(out.stdout).unwrap()
    };
    let after_rig = Draft { markers: Vec::new(), catheter: None, base: None, ..whole.clone() };
    let text = shown("after_rig.toml", &after_rig);
    for part in [
        "focal length     ",
        "   σ ",
        "mirror           mirror\n",
        " ± ",
        "view direct",
        "bands and tube            catoptra calibrate markers",
        "base frame and B0         catoptra calibrate base",
        "no warnings",
    ] {
        assert!(text.contains(part), "{part:?} is not in {text}");
    }
    let after_camera = Draft { surfaces: Default::default(), views: Vec::new(), ..after_rig };
    let text = shown("after_camera.toml", &after_camera);
    assert!(text.contains("mirrors, walls and views  catoptra calibrate rig"), "{text}");
    assert!(!shown("whole.toml", &whole).contains("still missing"));
}

#[test]
fn covariances_may_be_written_without_decimal_points() {
    let row = |k: usize| format!("[{}]", (0..9).map(|i| if i == k { "4" } else { "0" }).collect::<Vec<_>>().join(", "));
    let lens = (0..9).map(row).collect::<Vec<_>>().join(", ");
    let noted = format!(
        "[provenance.camera]\nlens_covariance = [{lens}]\n[provenance.rig]\nparameters = [\"mirror_offset_m\", \
         \"wall_offset_m\"]\ncovariance = [[9, 0], [0, 0.25]]\nvolume_mm = [[-10, 0, 5], [10, 20.5, 30]]\n[provenance]"
    );
    let draft = Draft::from(read(&changed("[provenance]", &noted)).unwrap());
    let noted = ["focal_x_px", "k3", "mirror_offset_m", "wall_offset_m", "k4"].map(|name| draft.noted_sd(name));
    assert_eq!(noted, [Some(2.0), Some(2.0), Some(3.0), Some(0.5), None]);
    let checked = Draft::from_toml_str(&draft.to_toml_string(), Path::new("again.toml")).unwrap();
    assert_eq!(checked, draft);
}

#[test]
fn deviations_of_an_imported_lens_are_kept() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("rig.toml");
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/cameras/ros.yaml");
    let import =
        |sd: &str| catoptra(&["rig", "import", file.to_str().unwrap(), "--sd", sd, "--out", out.to_str().unwrap()]);
    assert_eq!(import("1,2,3").status.code(), Some(2));
    assert!(!out.exists());
    let done = import("1.5,1.5,0.9,0.8,3e-3,0.02,2e-4,2e-4,0.05");
    assert_eq!(done.status.code(), Some(0), "{}", String::from_utf8_lossy(&done.stderr));
    let draft = Draft::load(&out).unwrap();
    assert!((draft.noted_sd("focal_x_px").unwrap() - 1.5).abs() < 1e-9);
    assert!((draft.noted_sd("k3").unwrap() - 0.05).abs() < 1e-9);
}

/// At the catheter, errors of a lens that came without σ are not among those of the calibration.
#[test]
fn a_lens_that_is_taken_as_exact_is_told_at_the_catheter() {
    let folder = tempfile::tempdir().unwrap();
    let told = |parameters: &str| {
        let mut draft = Draft::load(&dev_tank()).unwrap();
        let noted = format!("parameters = [{parameters}, \"front_wall_offset_m\"]\ncovariance = [[1, 0], [0, 4e-6]]");
        draft.provenance.insert("rig".into(), noted.parse::<toml::Table>().unwrap().into());
        let rig = folder.path().join("rig.toml");
        draft.save(&rig).unwrap();
        let done = catoptra(&["rig", "check", rig.to_str().unwrap(), "--recording", "sample_frames/rest.mkv"]);
        let text = String::from_utf8_lossy(&done.stdout).into_owned();
        assert!(done.status.success() && text.contains("share of errors at the catheter"), "{text}");
        text.contains("the lens is taken as exact")
    };
    assert_eq!([told("\"side_mirror_tilt_0_rad\""), told("\"focal_x_px\"")], [true, false]);
}

/// A camera of another tool whose numbers are those of no camera, or of other pictures.
#[test]
fn an_imported_lens_that_is_doubtful_is_warned_of_and_one_of_other_pictures_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let (file, out) = (folder.path().join("camera.yaml"), folder.path().join("rig.toml"));
    let ros = include_str!("../data/cameras/ros.yaml");
    let import = |text: &str| {
        std::fs::write(&file, text).unwrap();
        let done = catoptra(&["rig", "import", file.to_str().unwrap(), "--out", out.to_str().unwrap()]);
        (done.status.code(), String::from_utf8_lossy(&done.stderr).into_owned())
    };
    let doubtful = |from: &str, to: &str, word: &str| {
        let (code, said) = import(&ros.replace(from, to));
        assert!(code == Some(0) && said.contains("WARN") && said.contains(word), "{to}: {said}");
    };
    let (code, said) = import(ros);
    assert!(code == Some(0) && !said.contains("WARN"), "{said}");
    doubtful("2712.4", "8.0", "are they in pixels");
    doubtful("2712.4", "1200.0", "stretched");
    doubtful("643.7", "1930.0", "principal point");
    doubtful("-0.11", "-9.0", "corner (0, 0) has no direction");
    for (more, word) in [
        ("binning_x: 2\n", "binning_x"),
        ("roi: {x_offset: 0, y_offset: 8, height: 512, width: 1280, do_rectify: false}\n", "roi.height"),
    ] {
        let (code, said) = import(&format!("{ros}{more}"));
        assert!(code == Some(2) && said.contains(word), "{more}: {said}");
    }
    // Coefficients of another model, under any key by which programs name it.
    let opencv = include_str!("../data/cameras/opencv4.yml");
    for (more, code) in [
        ("camera_model: fisheye\n", 2),
        ("model: \"Kannala-Brandt\"\n", 2),
        ("lens_model: EQUIDISTANT\n", 2),
        ("projection_model: omni\n", 2),
        ("model_type: fov\n", 2),
        ("binning_x: 2\n", 2),
        ("camera_model: \"acA1300-60gc\"\n", 0),
        ("model_type: PINHOLE\n", 0),
        ("lens_model: brown_conrady\n", 0),
    ] {
        let (found, said) = import(&format!("{opencv}{more}"));
        let word = more.split(':').next().unwrap();
        assert!(found == Some(code) && (code == 0 || said.contains(word)), "{more}: {said}");
    }
    let (code, said) = import(&format!("{opencv}cameraMatrix: [1.0, 0.0, 2.0, 0.0, 1.0, 2.0, 0.0, 0.0, 1.0]\n"));
    assert!(code == Some(2) && said.contains("keep one of them"), "{said}");
    let four = "image_width: 640\nimage_height: 480\ncamera_matrix: [600, 0, 320, 0, 600, 240, 0, 0, 1]\n";
    for (p1, warned) in [("0.0004", false), ("0.02", true)] {
        let (code, said) = import(&format!("{four}distortion_coefficients: [-0.03, 0.01, {p1}, 0.001]\n"));
        assert!(code == Some(0) && said.contains("k1 to k4 of a fisheye") == warned, "{p1}: {said}");
    }
    let whole = "binning_x: 0\nbinning_y: 1\nroi: {x_offset: 0, y_offset: 0, height: 0, width: 0}\n";
    assert_eq!(import(&format!("{ros}{whole}")).0, Some(0));
}

/// A model of several planes for each view is read as it was written; one for some views only is refused.
#[test]
fn colours_of_each_view_come_back_and_one_that_is_missing_is_named() {
    let (_, old) = RIG.split_once("[marker.colour]").unwrap();
    let end = old.find("\n\n").unwrap();
    let colours = |views: &[&str]| -> String {
        let of = |view: &&str| {
            format!(
                "[[marker.colours]]\nview = \"{view}\"\nplanes = [[0.01, 0.0, -0.01, 0.2], [0.0, 0.02, -0.01, 0.1]]\n\
                 rgb = [150.0, 120.0, 40.0]\n"
            )
        };
        views.iter().map(of).collect()
    };
    let with = |colours: String| RIG.replacen(&format!("[marker.colour]{}", &old[..end]), &colours, 1);
    let rig = read(&with(colours(&["direct", "mirror"]))).unwrap();
    assert_eq!(rig.markers[0].colours.len(), 2);
    assert_eq!(rig.markers[0].colour(1).unwrap().planes.len(), 2);
    assert_eq!(read(&rig.to_toml_string()).unwrap().markers, rig.markers);
    let message = read(&with(colours(&["mirror"]))).unwrap_err().to_string();
    assert!(message.contains("marker.base.colours") && message.contains("direct, mirror"), "{message}");
    let surplus = "[[marker.colours]]\nplanes = [[0.01, 0.0, 0.0, 0.2]]\nrgb = [150.0, 120.0, 40.0]\n";
    let message = read(&with(colours(&["direct", "mirror"]) + surplus)).unwrap_err().to_string();
    assert!(message.contains("marker.base.colours") && message.contains("one entry for each view"), "{message}");
    let none =
        with(colours(&["direct", "mirror"])).replacen("[[0.01, 0.0, -0.01, 0.2], [0.0, 0.02, -0.01, 0.1]]", "[]", 1);
    assert!(read(&none).unwrap_err().to_string().contains("one plane or more"));
}
