//! The optics compared with pictures by an independent path tracer: corners of a board seen through air, glass, water
//! and a mirror, detected in the picture and projected from their exact positions.

use catoptra::calibrate::board::{Board, find_boards};
use catoptra::calibrate::board::{Grey, Rows};
use catoptra::optics::{Lens, Mirror, OpticalPath, Plane, Surface, Wall};
use nalgebra::{Point2, Point3, Vector2, Vector3};
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
            denominator: [0.0; 3],
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

/// Detected minus projected, corner by corner: a mirror image's are in the only order that the colours leave it.
fn residuals(view: &str, path: &OpticalPath) -> Vec<Vector2<f64>> {
    let (corners, begin) = truth(view);
    let projected: Vec<_> = corners.iter().map(|c| path.project(c).unwrap().coords - begin).collect();
    let board: Board = "9x6:12mm".parse().unwrap();
    let picture = Grey::load(Path::new(&format!("{FOLDER}/{view}.png")), Rows::AsShown).unwrap();
    let found = find_boards(&picture, &board, 1).unwrap().remove(0);
    assert_eq!(found.corners.len(), 54);
    let orders = board.orders();
    let index = |i: usize| if view == "mirror" { orders[0][i] } else { i };
    found.corners.iter().map(|(i, place)| place.coords - projected[index(*i)]).collect()
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

// Over all 38 pictures of the sample rig: 0.048 px in air, 0.069 px direct, 0.068 px mirror (RMS per coordinate).

#[test]
fn board_in_air_is_seen_where_it_is() {
    corners_agree("air", 0.06);
}

#[test]
fn board_in_water_is_seen_where_it_is() {
    corners_agree("direct", 0.08);
}

#[test]
fn board_in_water_by_way_of_the_mirror_is_seen_where_it_is() {
    corners_agree("mirror", 0.08);
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
