//! ChArUco boards: OpenCV's own, photographed by OpenCV's own camera or drawn here; what is found against where they are.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]
#![allow(clippy::print_stdout, reason = "the figures are worth a look")]

mod board_common;

use catoptra::calibrate::board::{Board, BoardError, BoardImage, Unread, find_boards};
use catoptra::calibrate::grey::{Grey, Rows};
use nalgebra::Point2;
use std::path::{Path, PathBuf};

const FIVE: &str = "charuco:5x7:32mm:24mm:DICT_4X4_50";

fn data(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/charuco").join(name)
}

fn board(text: &str) -> Board {
    text.parse().unwrap()
}

/// Corners of an image as OpenCV projects them.
fn truth(picture: &str, image: usize) -> (bool, Vec<Point2<f64>>) {
    let text = std::fs::read_to_string(data("corners.csv")).unwrap();
    let rows = text.lines().skip(1).map(|line| line.split(',').collect::<Vec<_>>());
    let own: Vec<_> = rows.filter(|row| row[0] == picture && row[1] == image.to_string()).collect();
    let number = |text: &str| text.parse::<f64>().unwrap();
    (own[0][2] == "1", own.iter().map(|row| Point2::new(number(row[4]), number(row[5]))).collect())
}

/// RMS per coordinate against the truth, index by index, and the greatest distance.
fn compare(found: &BoardImage, truth: &[Point2<f64>]) -> (f64, f64) {
    let off: Vec<f64> = found.corners.iter().map(|(i, place)| (place - truth[*i]).norm()).collect();
    let rms = (off.iter().map(|o| o * o).sum::<f64>() / (2 * off.len()) as f64).sqrt();
    (rms, off.into_iter().fold(0.0, f64::max))
}

fn assert_near(what: &str, found: &BoardImage, truth: &[Point2<f64>]) {
    let (rms, greatest) = compare(found, truth);
    println!(
        "{what}: {} of {} corners, RMS {rms:.3} px, greatest {greatest:.3} px; square {:.1}, edge {:.2} px, contrast {:.0}",
        found.corners.len(),
        truth.len(),
        found.square_px,
        found.edge_px,
        found.contrast
    );
    assert!(rms < 0.08 && greatest < 0.5, "{what}: RMS {rms} px, greatest {greatest} px");
}

fn photograph(name: &str) -> Grey {
    Grey::load(&data(name), Rows::AsStored).unwrap()
}

#[test]
fn opencvs_boards_photographed_by_opencvs_camera() {
    for (name, text, images) in [
        ("direct.jpg", FIVE, 1),
        ("mirror.jpg", FIVE, 2),
        ("part.jpg", FIVE, 1),
        ("legacy.jpg", "charuco:5x6:32mm:25.6mm:DICT_6X6_250:legacy", 1),
    ] {
        let found = find_boards(&photograph(name), &board(text), 3).unwrap();
        assert_eq!(found.len(), images, "{name}");
        for (image, found) in found.iter().enumerate() {
            let (mirrored, truth) = truth(name, image);
            assert_eq!(found.mirrored, Some(mirrored), "{name}");
            assert_near(&format!("{name}, image {image}"), found, &truth);
            let most = if name == "part.jpg" { truth.len() - 4 } else { truth.len() };
            let least = if name == "part.jpg" { 10 } else { truth.len() };
            assert!((least..=most).contains(&found.corners.len()), "{name}: {}", found.corners.len());
        }
    }
}
