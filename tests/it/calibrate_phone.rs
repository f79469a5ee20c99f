//! Photographs by a telephone, in air, of a board in front of two mirrors: `catoptra calibrate camera` and
//! `calibrate rig --mirrors 2` on 12-megapixel JPEGs with orientation tags, in which the board is small and not in
//! every mirror.

use crate::support::boards::{Scene, noise, pose};
use catoptra::calibrate::geometry::{Geometry, tilt_axes};
use catoptra::optics::{Lens, Mirror, Plane, Surface};
use catoptra::rig::Draft;
use image::ImageEncoder as _;
use nalgebra::{Isometry3, Point2, Vector2, Vector3};
use rayon::prelude::*;
use std::path::Path;
use std::process::{Command, Output};
use std::time::Instant;

const BOARD: &str = "9x6:25mm";

/// A telephone with a mirror to the left of the board and one on the table below it.
fn scene() -> Scene {
    let mirror = |normal: [f64; 3], offset_m: f64| {
        Surface::Mirror(Mirror { plane: Plane::new(Vector3::from(normal).normalize(), offset_m).unwrap() })
    };
    Scene {
        size_px: [4032, 3024],
        geometry: Geometry {
            lens: Lens {
                focal_px: Vector2::new(3056.0, 3049.0),
                principal_point_px: Point2::new(2031.0, 1498.0),
                distortion: [0.06, -0.12, 4e-4, -3e-4, 0.05],
                denominator: [0.0; 3],
            },
            surfaces: vec![
                ("mirror_1".to_owned(), mirror([0.94, 0.02, -0.34], -0.88)),
                ("mirror_2".to_owned(), mirror([0.03, -0.94, -0.34], -0.905)),
            ],
            views: vec![
                ("direct".to_owned(), vec![]),
                ("mirror_1".to_owned(), vec![0]),
                ("mirror_2".to_owned(), vec![1]),
            ],
        },
        // Panes: nothing is seen in a mirror beyond its edges.
        regions: vec![
            Vec::new(),
            vec![[650.0, 700.0], [1560.0, 800.0], [1560.0, 2000.0], [650.0, 2100.0]],
            vec![[1500.0, 2130.0], [2900.0, 2130.0], [3100.0, 2980.0], [1300.0, 2980.0]],
        ],
        board: BOARD.parse().unwrap(),
        blur_px: 0.95,
        sensor: noise(4.0),
    }
}

/// As the telephone stores it, with an EXIF orientation.
fn store(picture: &image::GrayImage, path: &Path, orientation: u8) {
    // Skin tones and wood: what a telephone stores is coloured.
    let colour = image::RgbImage::from_fn(picture.width(), picture.height(), |x, y| {
        let grey = u16::from(picture.get_pixel(x, y).0[0]);
        image::Rgb([grey.min(255) as u8, (grey * 98 / 100) as u8, (grey * 92 / 100) as u8])
    });
    let file = std::io::BufWriter::new(std::fs::File::create(path).unwrap());
    let mut encoder = image::codecs::jpeg::JpegEncoder::new_with_quality(file, 88);
    // TIFF header, little endian, one directory with one entry: orientation (0x112), short, 1 value.
    let mut exif = b"II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0\x01\0\0\0\0\0\0\0".to_vec();
    exif[18] = orientation;
    encoder.set_exif_metadata(exif).unwrap();
    encoder.write_image(&colour, colour.width(), colour.height(), image::ExtendedColorType::Rgb8).unwrap();
}

fn take(scene: &Scene, poses: &[Isometry3<f64>], folder: &Path, orientation: impl Fn(usize) -> u8 + Sync) {
    std::fs::create_dir(folder).unwrap();
    poses.par_iter().enumerate().for_each(|(i, pose)| {
        store(&scene.picture(pose, i as u64 + 1), &folder.join(format!("IMG_{i:04}.jpg")), orientation(i));
    });
}

fn catoptra(folder: &Path, args: &[&str]) -> (Output, f64) {
    let began = Instant::now();
    let output = Command::new(env!("CARGO_BIN_EXE_catoptra")).current_dir(folder).args(args).output().unwrap();
    println!("{}{}", String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    (output, began.elapsed().as_secs_f64())
}

/// Error over σ of a parameter; `covariance` is a table of numbers.
fn hold(what: &str, error: f64, covariance: &toml::Value, index: usize) {
    let sd = covariance[index][index].as_float().unwrap().sqrt();
    println!("{what}: {error:+.3e}, σ {sd:.3e}, {:+.2}", error / sd);
    assert!(error.abs() < 3.5 * sd, "{what} is {error:+.3e} off, its σ is {sd:.3e}");
}

#[test]
fn photographs_of_12_megapixels_with_two_mirrors_are_calibrated_from_end_to_end() {
    let scene = scene();
    let folder = tempfile::tempdir().unwrap();
    // The board in the hand, all over the picture, telephone held upright: orientation 6.
    let lens_poses: Vec<_> = (0..8)
        .map(|i| {
            let angle = f64::from(i) * 2.4;
            let middle = [0.30 * angle.cos(), 0.22 * angle.sin(), 0.95 + 0.15 * (f64::from(i) * 1.7).sin()];
            pose(middle, [30.0 * (angle + 0.6).sin(), 32.0 * angle.cos(), 20.0 * (2.0 * angle).sin()])
        })
        .collect();
    let began = Instant::now();
    take(&scene.in_air(), &lens_poses, &folder.path().join("lens"), |_| 6);
    // The telephone on a stand, 1.5 to 1.9 m from the board; it guesses its orientation anew each time.
    // Between direct view and mirrors; turned away from one of them; from both.
    let towards = [
        [21.0, 24.0],
        [12.0, 30.0],
        [30.0, 16.0],
        [20.0, 30.0],
        [24.0, 14.0],
        [22.0, -30.0],
        [-45.0, 24.0],
        [-45.0, -30.0],
    ];
    let rig_poses: Vec<_> = (0..)
        .zip(towards)
        .map(|(i, [x, y])| {
            let angle = f64::from(i) * 2.4;
            let middle =
                [0.08 + 0.06 * angle.cos(), -0.06 + 0.05 * angle.sin(), 1.70 + 0.12 * (f64::from(i) * 1.3).sin()];
            pose(middle, [x, y, 12.0 * (2.0 * angle).sin()])
        })
        .collect();
    let shown: Vec<[bool; 2]> = rig_poses.iter().map(|pose| [1, 2].map(|view| scene.shows(view, pose))).collect();
    println!("mirrors that show all of the board: {shown:?}");
    take(&scene, &rig_poses, &folder.path().join("rig"), |i| [6, 6, 1, 8][i % 4]);
    println!("rendered in {:.1} s", began.elapsed().as_secs_f64());

    let (output, seconds) =
        catoptra(folder.path(), &["calibrate", "camera", "lens", "--board", BOARD, "--out", "phone.toml"]);
    assert_eq!(output.status.code(), Some(0));
    println!("calibrate camera: {:.2} s per picture", seconds / lens_poses.len() as f64);
    let args = ["calibrate", "rig", "rig", "--board", BOARD, "--rig", "phone.toml", "--mirrors", "2"];
    let (output, seconds) = catoptra(folder.path(), &args);
    assert_eq!(output.status.code(), Some(0));
    println!("calibrate rig: {:.2} s per picture", seconds / rig_poses.len() as f64);

    let found = Draft::load(&folder.path().join("phone.toml")).unwrap();
    assert_eq!(found.camera.size_px, scene.size_px, "the pictures as stored");
    let provenance = &found.provenance["rig"];
    let parameters: Vec<&str> =
        provenance["parameters"].as_array().unwrap().iter().filter_map(|p| p.as_str()).collect();
    let index = |name: &str| parameters.iter().position(|p| *p == name).unwrap();
    let covariance = &provenance["covariance"];
    let (lens, truth) = (found.camera.lens, scene.geometry.lens);
    hold("focal length x", lens.focal_px.x - truth.focal_px.x, covariance, index("focal_x_px"));
    hold("focal length y", lens.focal_px.y - truth.focal_px.y, covariance, index("focal_y_px"));
    for (name, surface) in &scene.geometry.surfaces {
        let (plane, truth) = (found.surfaces[name].plane(), surface.plane());
        let turn = truth.normal().cross(&plane.normal());
        for (axis, about) in tilt_axes(&plane.normal()).iter().enumerate() {
            hold(
                &format!("{name} turn {axis}"),
                turn.dot(about),
                covariance,
                index(&format!("{name}_tilt_{axis}_rad")),
            );
        }
        let offset = plane.offset_m() - truth.offset_m();
        hold(&format!("{name} distance"), offset, covariance, index(&format!("{name}_offset_m")));
    }
    // Every picture is used, or named with the reason; 54 corners for each view that shows all of the board.
    let printed = String::from_utf8_lossy(&output.stdout);
    for (i, shown) in shown.iter().enumerate() {
        let line = printed.lines().find(|line| line.starts_with(&format!("IMG_{i:04}.jpg"))).unwrap();
        let corners = 54 * (1 + shown.iter().filter(|s| **s).count());
        let as_it_should = match corners {
            54 => line.contains("left out: it shows the board only once"),
            _ => line.split_whitespace().nth(1) == Some(&corners.to_string()),
        };
        assert!(as_it_should, "{line}, expected {corners} corners");
    }
    let count = |views: usize| shown.iter().filter(|s| s.iter().filter(|s| **s).count() == views).count();
    assert!([count(2), count(1), count(0)] == [5, 2, 1], "the test shows what it is to show: {shown:?}");
}
