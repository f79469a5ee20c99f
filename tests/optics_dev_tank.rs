//! The optics against pictures made by someone else's: corners of a board, path-traced through air, glass, water and a
//! mirror, found by OpenCV in the picture and projected by us from where they exactly are.

#![expect(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "a test reports by panicking and printing"
)]

use catoptra::optics::{Lens, Mirror, OpticalPath, Plane, Surface, Wall};
use nalgebra::{Point2, Point3, Vector2, Vector3};
use opencv::core::{Mat, Point2f, Size, TermCriteria, TermCriteria_COUNT, TermCriteria_EPS, Vector};
use opencv::prelude::*;
use opencv::{calib3d, core, imgcodecs, imgproc};
use std::path::Path;

const FOLDER: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/dev_tank_boards");

/// The rig as the renderer had it.
fn path(view: &str) -> OpticalPath {
    let plane = |x, y, z, offset_mm: f64| Plane::new(Vector3::new(x, y, z), offset_mm * 1e-3).unwrap();
    let wall = |outer| {
        Surface::Wall(Wall { outer, thickness_m: 0.005, index_outside: 1.0, index_wall: 1.52, index_inside: 1.333 })
    };
    let front = plane(-0.05263878181809977, 0.04319317606051762, -0.997679060715675, -1264.1709741292264);
    let side = plane(0.9985892616009606, 0.00925449944010505, -0.052286144009298964, -52.05106334272037);
    let mirror = plane(-0.6997275276946341, 0.01652075518608834, -0.7142187701499005, -1104.83151614907);
    OpticalPath {
        lens: Lens {
            focal_px: Vector2::new(2712.4, 2706.9),
            principal_point_px: Point2::new(643.7, 508.2),
            distortion: [-0.11, 0.14, 0.0006, -0.0004, 0.0],
        },
        surfaces: match view {
            "air" => vec![],
            "direct" => vec![wall(front)],
            "mirror" => vec![Surface::Mirror(Mirror { plane: mirror }), wall(side)],
            other => panic!("no view {other}"),
        },
    }
}

/// The exact corners of a view, and where its cut-out begins in the full picture.
fn truth(view: &str) -> (Vec<Point3<f64>>, Vector2<f64>) {
    let mut rows = csv::Reader::from_path(Path::new(FOLDER).join("corners.csv")).unwrap();
    let (mut corners, mut begin) = (Vec::new(), Vector2::zeros());
    for row in rows.deserialize::<(String, f64, f64, f64, f64, f64)>() {
        let (name, left, top, x_mm, y_mm, z_mm) = row.unwrap();
        if name == view {
            corners.push(Point3::new(x_mm, y_mm, z_mm) * 1e-3);
            begin = Vector2::new(left, top);
        }
    }
    assert_eq!(corners.len(), 54);
    (corners, begin)
}

/// The corners OpenCV finds, in pixels of the cut-out.
fn detect(view: &str) -> Vec<Vector2<f64>> {
    let file = format!("{FOLDER}/{view}.png");
    let mut picture = imgcodecs::imread(&file, imgcodecs::IMREAD_GRAYSCALE).unwrap();
    let mirrored = view == "mirror";
    if mirrored {
        // The detector does not know left-handed boards: flip the picture, map back.
        let mut flipped = Mat::default();
        core::flip(&picture, &mut flipped, 1).unwrap();
        picture = flipped;
    }
    let mut corners = Vector::<Point2f>::new();
    let flags = calib3d::CALIB_CB_NORMALIZE_IMAGE;
    let found = calib3d::find_chessboard_corners_sb(&picture, Size::new(9, 6), &mut corners, flags).unwrap();
    assert!(found, "no board found in {file}");

    // The detector's own refinement is three times worse than the classic one, in a window of a third of a square.
    let between = |a: usize, b: usize| {
        let (a, b) = (corners.get(a).unwrap(), corners.get(b).unwrap());
        f64::from(a.x - b.x).hypot(f64::from(a.y - b.y))
    };
    let square_px = (0..54).filter(|i| i % 9 > 0).map(|i| between(i, i - 1)).fold(f64::INFINITY, f64::min);
    let half = (0.35 * square_px).clamp(2.0, 8.0) as i32;
    let until = TermCriteria::new(TermCriteria_COUNT + TermCriteria_EPS, 60, 1e-4).unwrap();
    imgproc::corner_sub_pix(&picture, &mut corners, Size::new(half, half), Size::new(-1, -1), until).unwrap();

    let last_column = f64::from(picture.cols() - 1);
    let map_back = |x: f64| if mirrored { last_column - x } else { x };
    corners.iter().map(|c| Vector2::new(map_back(f64::from(c.x)), f64::from(c.y))).collect()
}

/// Detected minus projected, each detected corner with the nearest projected one.
fn residuals(view: &str, path: &OpticalPath) -> Vec<Vector2<f64>> {
    let (corners, begin) = truth(view);
    let projected: Vec<_> = corners.iter().map(|c| path.project(c).unwrap().coords - begin).collect();
    let mut taken = [false; 54];
    let found = detect(view);
    assert_eq!(found.len(), 54);
    let nearest = |c: &Vector2<f64>| {
        let by_distance = |a: &usize, b: &usize| (projected[*a] - c).norm().total_cmp(&(projected[*b] - c).norm());
        (0..54).min_by(by_distance).unwrap()
    };
    for corner in &found {
        taken[nearest(corner)] = true;
    }
    assert!(taken.iter().all(|t| *t), "{view}: two detected corners claim one projected");
    found.iter().map(|c| c - projected[nearest(c)]).collect()
}

/// RMS per coordinate, length of the mean offset, greatest offset.
fn summary(residuals: &[Vector2<f64>]) -> (f64, f64, f64) {
    let n = residuals.len() as f64;
    let rms = (residuals.iter().map(Vector2::norm_squared).sum::<f64>() / (2.0 * n)).sqrt();
    let mean = (residuals.iter().sum::<Vector2<f64>>() / n).norm();
    (rms, mean, residuals.iter().map(Vector2::norm).fold(0.0, f64::max))
}

fn corners_agree(view: &str, rms_px: f64) {
    let (rms, mean, greatest) = summary(&residuals(view, &path(view)));
    println!("{view}: RMS {rms:.3} px per coordinate, mean offset {mean:.3} px, greatest {greatest:.3} px");
    assert!(rms < rms_px, "RMS {rms} px");
    assert!(mean < 0.03, "mean offset {mean} px");
    assert!(greatest < 0.3, "greatest offset {greatest} px");
}

// Over all 38 pictures of the sample rig: 0.049 px in air, 0.072 px direct, 0.069 px mirror (RMS per coordinate).

#[test]
fn board_in_air_is_seen_where_it_is() {
    corners_agree("air", 0.06);
}

#[test]
fn board_in_water_is_seen_where_it_is() {
    corners_agree("direct", 0.09);
}

#[test]
fn board_in_water_by_way_of_the_mirror_is_seen_where_it_is() {
    corners_agree("mirror", 0.09);
}

#[test]
fn a_pane_taken_for_water_is_told_from_glass() {
    // The test above would notice this much: 5 mm of glass count as water.
    for view in ["direct", "mirror"] {
        let mut wrong = path(view);
        for surface in &mut wrong.surfaces {
            if let Surface::Wall(wall) = surface {
                wall.index_wall = wall.index_inside;
            }
        }
        let (corners, _) = truth(view);
        let right = path(view);
        let shifts: Vec<_> = corners.iter().map(|c| wrong.project(c).unwrap() - right.project(c).unwrap()).collect();
        let (rms, mean, _) = summary(&shifts);
        println!("{view}: pane as water moves the picture by {rms:.3} px RMS, {mean:.3} px on average");
        assert!(mean > 0.03, "mean shift {mean} px");
    }
}

#[test]
fn without_refraction_the_board_is_elsewhere() {
    for view in ["direct", "mirror"] {
        let mut straight = path(view);
        straight.surfaces.retain(|surface| matches!(surface, Surface::Mirror(_)));
        let (corners, _) = truth(view);
        let shifts: Vec<_> =
            corners.iter().map(|c| straight.project(c).unwrap() - path(view).project(c).unwrap()).collect();
        let (rms, mean, _) = summary(&shifts);
        println!("{view}: without water the picture moves by {rms:.2} px RMS, {mean:.2} px on average");
        assert!(mean > 1.0, "mean shift {mean} px");
    }
}
