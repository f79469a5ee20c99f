//! `catoptra calibrate camera` and `calibrate rig` with a ChArUco board, as a user runs them: drawn pictures of one of
//! OpenCV's boards, by a camera with distortion, directly and in a mirror in air, some of them cut off or partly
//! covered.

use crate::support::board::{Canvas, Placed};
use crate::support::charuco::Printed;
use catoptra::calibrate::geometry::tilt_axes;
use catoptra::optics::{Lens, Plane};
use catoptra::rig::{Camera, Draft};
use nalgebra::{Matrix3, Point2, Rotation3, Vector2, Vector3};
use rayon::prelude::*;
use std::path::Path;
use std::process::{Command, Output};

const BOARD: &str = "charuco:5x7:32mm:24mm:DICT_4X4_50";
const SIZE: [usize; 2] = [880, 656];

fn lens() -> Lens {
    Lens {
        focal_px: Vector2::new(1122.0, 1119.0),
        principal_point_px: Point2::new(445.0, 322.0),
        distortion: [-0.15, 0.1, 5e-4, -4e-4, 0.0],
        denominator: [0.0; 3],
    }
}

/// Where a pixel would be without distortion, by OpenCV's iteration: twelve steps leave 1e-7 px here.
fn straight(pixel: Point2<f64>) -> Point2<f64> {
    let Lens { focal_px, principal_point_px, distortion: [k1, k2, p1, p2, k3], .. } = lens();
    let seen = (pixel - principal_point_px).component_div(&focal_px);
    let mut p = seen;
    for _ in 0..12 {
        let (xy, s) = (p.x * p.y, p.norm_squared());
        let aside =
            Vector2::new(2.0 * p1 * xy + p2 * (s + 2.0 * p.x * p.x), p1 * (s + 2.0 * p.y * p.y) + 2.0 * p2 * xy);
        p = (seen - aside) / (1.0 + s * (k1 + s * (k2 + s * k3)));
    }
    principal_point_px + p.component_mul(&focal_px)
}

/// The mirror of the rig.
fn mirror() -> Plane {
    let normal = Vector3::new(-0.70, 0.02, -0.71).normalize();
    Plane::new(normal, normal.dot(&Vector3::new(0.15, 0.0, 1.0))).unwrap()
}

/// The board with its middle at `middle` (metres), turned about x, then y, then z (degrees); as the camera sees it
/// directly or in a mirror.
fn placed(middle: [f64; 3], turn_deg: [f64; 3], mirror: Option<&Plane>) -> Placed {
    let lens = lens();
    let [x, y, z] = turn_deg.map(f64::to_radians);
    let about = |axis, angle| Rotation3::from_axis_angle(&axis, angle);
    let turn = about(Vector3::z_axis(), z) * about(Vector3::y_axis(), y) * about(Vector3::x_axis(), x);
    let board: catoptra::calibrate::board::Board = BOARD.parse().unwrap();
    let (c, r) = ((board.columns - 1) as f64 / 2.0, (board.rows - 1) as f64 / 2.0);
    let along = |axis: usize| turn.matrix().column(axis) * board.square_m;
    let origin = Vector3::from(middle) - along(0) * c - along(1) * r;
    let mut columns = [along(0), along(1), origin];
    if let Some(plane) = mirror {
        let flip = Matrix3::identity() - plane.normal() * plane.normal().transpose() * 2.0;
        columns = columns.map(|column| flip * column);
        columns[2] += plane.normal() * (2.0 * plane.offset_m());
    }
    let (f, p) = (lens.focal_px, lens.principal_point_px);
    let camera = Matrix3::new(f.x, 0.0, p.x, 0.0, f.y, p.y, 0.0, 0.0, 1.0);
    Placed { board, picture_from_board: camera * Matrix3::from_columns(&columns) }
}

fn save(path: &Path, boards: &[Placed], covered: Option<[f64; 4]>) {
    let printed = Printed::load("5x7_4x4_50.png", 5);
    let mut canvas = Canvas { straight, ..Canvas::new(SIZE[0], SIZE[1]) };
    for board in boards {
        canvas.draw_as(board, |column, row| printed.grey(column, row));
    }
    let [left, top, right, bottom] = covered.unwrap_or_default();
    let cover = |x, y, v| if (left..right).contains(&x) && (top..bottom).contains(&y) { 140.0 } else { v };
    let bytes = canvas.changed(cover).blurred(0.7).noisy(2.0).bytes();
    image::GrayImage::from_raw(SIZE[0] as u32, SIZE[1] as u32, bytes).unwrap().save(path).unwrap();
}

fn catoptra(folder: &Path, args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_catoptra")).current_dir(folder).args(args).output().unwrap()
}

fn text(output: &Output) -> String {
    String::from_utf8_lossy(&output.stdout).into_owned() + &String::from_utf8_lossy(&output.stderr)
}

/// Standard deviations of a rig file's parameters: the diagonal of a covariance.
fn deviations(covariance: &toml::Value) -> Vec<f64> {
    let rows = covariance.as_array().unwrap().iter().enumerate();
    rows.map(|(i, row)| row[i].as_float().unwrap().sqrt()).collect()
}

/// All within 3.5 σ, most within 2.
fn hold(found: &[(String, f64, f64)]) {
    for (name, error, sd) in found {
        println!("{name} {error:+.2e}, σ {sd:.2e}, {:+.2} σ", error / sd);
        assert!(error.abs() < 3.5 * sd, "{name} is {error:+.3e} off, its σ is {sd:.3e}");
    }
    let near = found.iter().filter(|(_, error, sd)| error.abs() < 2.0 * sd).count();
    assert!(3 * near > 2 * found.len(), "only {near} of {} within 2 σ", found.len());
}

fn lens_errors(found: &Lens, sd: &[f64]) -> Vec<(String, f64, f64)> {
    let exact = lens();
    let values = |lens: &Lens| {
        let mut values = vec![lens.focal_px.x, lens.focal_px.y, lens.principal_point_px.x, lens.principal_point_px.y];
        values.extend(lens.distortion);
        values
    };
    let names = ["fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3"];
    let errors = values(found).into_iter().zip(values(&exact)).map(|(a, b)| a - b);
    names.iter().zip(errors).zip(sd).map(|((name, error), sd)| ((*name).to_owned(), error, *sd)).collect()
}

#[test]
fn lens_and_mirror_are_found_within_their_predicted_deviations_from_boards_seen_in_part() {
    let folder = tempfile::tempdir().unwrap();
    let (air, rig) = (folder.path().join("air"), folder.path().join("rig"));
    std::fs::create_dir(&air).unwrap();
    std::fs::create_dir(&rig).unwrap();
    // Tilted to all sides, all over the picture: seven of them reach beyond it.
    let tilts = [[30, 0], [-30, 0], [0, 32], [0, -32], [25, 25], [-25, 25], [25, -25], [-25, -25], [10, 40], [-40, 5]];
    (0..10).into_par_iter().for_each(|i: usize| {
        let [x, y] = tilts[i].map(f64::from);
        let (right, below) = ((i % 5) as f64 - 2.0, (i % 3) as f64 - 1.0);
        let middle = [0.1 * right, 0.065 * below, 0.62 + 0.03 * (i % 4) as f64];
        save(&air.join(format!("{i:02}.png")), &[placed(middle, [x, y, 37.0 * i as f64], None)], None);
    });
    let output = catoptra(folder.path(), &["calibrate", "camera", "air", "--board", BOARD, "--out", "rig.toml"]);
    println!("{}", text(&output));
    assert_eq!(output.status.code(), Some(0), "{}", text(&output));
    assert!(text(&output).contains("10 of 10 pictures used"), "{}", text(&output));
    let draft = Draft::load(&folder.path().join("rig.toml")).unwrap();
    assert_eq!(draft.provenance["camera"]["board"].as_str(), Some(BOARD));
    let sd = deviations(&draft.provenance["camera"]["lens_covariance"]);
    let mut found = lens_errors(&draft.camera.lens, &sd);

    // Facing halfway to camera and mirror; a thumb on some.
    let plane = mirror();
    (0..10).into_par_iter().for_each(|i: usize| {
        let wave = |step: f64| (i as f64 * step).sin();
        let middle = [-0.12 + 0.03 * wave(1.7), 0.04 * wave(2.3), 0.9 + 0.05 * wave(0.9)];
        let turn = [16.0 * wave(1.1), -54.0 + 10.0 * wave(2.9), 12.0 * wave(0.7)];
        let boards = [placed(middle, turn, None), placed(middle, turn, Some(&plane))];
        // Over a part of the direct image, or of the mirrored one.
        let thumb = |board: &Placed| {
            let at = board.place(3.0, 1.0);
            [at.x - 32.0, at.y - 48.0, at.x + 48.0, at.y + 24.0]
        };
        save(&rig.join(format!("{i:02}.png")), &boards, boards.get(i % 4).map(thumb));
    });
    let output = catoptra(folder.path(), &["calibrate", "rig", "rig", "--board", BOARD, "--rig", "rig.toml"]);
    println!("{}", text(&output));
    assert_eq!(output.status.code(), Some(0), "{}", text(&output));
    assert!(text(&output).contains("10 of 10 pictures used"), "{}", text(&output));
    let draft = Draft::load(&folder.path().join("rig.toml")).unwrap();
    let own = draft.surfaces["mirror"].plane();
    let turn = plane.normal().cross(&own.normal());
    let axes = tilt_axes(&own.normal());
    let errors = [turn.dot(&axes[0]), turn.dot(&axes[1]), own.offset_m() - plane.offset_m()];
    let names = draft.provenance["rig"]["parameters"].as_array().unwrap();
    let sd = deviations(&draft.provenance["rig"]["covariance"]);
    for (name, error) in ["mirror_tilt_0_rad", "mirror_tilt_1_rad", "mirror_offset_m"].into_iter().zip(errors) {
        let at = names.iter().position(|own| own.as_str() == Some(name)).unwrap();
        found.push((name.to_owned(), error, sd[at]));
    }
    hold(&found);
}

#[test]
fn boards_seen_in_a_mirror_only_are_told_and_not_used() {
    let folder = tempfile::tempdir().unwrap();
    let pictures = folder.path().join("mirror");
    std::fs::create_dir(&pictures).unwrap();
    for i in 0..3 {
        let board = placed([-0.12, 0.02 * f64::from(i), 0.9], [5.0 * f64::from(i), -54.0, 8.0], Some(&mirror()));
        save(&pictures.join(format!("{i}.png")), &[board], None);
    }
    let size_px = SIZE.map(|n| n as u32);
    let camera = Camera::new(size_px, lens());
    Draft::of_camera(camera).save(&folder.path().join("lens.toml")).unwrap();
    let refused = |args: &[&str], says: &str| {
        let output = catoptra(folder.path(), args);
        let output_text = text(&output);
        assert_eq!(output.status.code(), Some(3), "{output_text}");
        assert!(output_text.matches(says).count() == 3, "{output_text}");
        assert!(!folder.path().join("rig.toml").exists());
    };
    let rig = ["calibrate", "rig", "mirror", "--rig", "lens.toml", "--out", "rig.toml", "--board"];
    refused(&[&rig[..], &[BOARD]].concat(), "it shows the board only in a mirror, and not directly");
    // The reason of every picture is told, here a wrong word in the board's description.
    let other = "charuco:5x7:32mm:24mm:DICT_6X6_50";
    refused(&[&rig[..], &[other]].concat(), "its markers are of DICT_4X4_50, not of DICT_6X6_50");
    let camera = ["calibrate", "camera", "mirror", "--out", "rig.toml", "--board", BOARD];
    refused(&camera, "its board is mirrored");
}
