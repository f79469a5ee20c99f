//! The set-up to scale: camera, mirrors, walls, boards, and the light between them, from above and from the side.

use super::super::chart::QUIET;
use super::super::scale_drawing::{ScaleDrawing, met};
use crate::calibrate::bundle::{Corner, Solution};
use crate::calibrate::rig::RigCalibration;
use nalgebra::Point3;
use plotly::Plot;

/// For each surface, where the light of all corners meets it.
fn lit(solution: &Solution, corners: &[Corner]) -> Vec<Vec<Point3<f64>>> {
    let mut all = vec![Vec::new(); solution.geometry.surfaces.len()];
    for (view, (_, surfaces)) in solution.geometry.views.iter().enumerate() {
        let path = solution.geometry.path(view);
        for corner in corners.iter().filter(|corner| corner.view == view) {
            for (surface, point) in surfaces.iter().zip(met(&path, &corner.pixel).into_iter().skip(1)) {
                if let Some(own) = all.get_mut(*surface) {
                    own.push(point);
                }
            }
        }
    }
    all
}

/// Seen along the third axis: `axes` are the camera frame's axes that point right and up in the drawing, the second
/// with its sign.
pub(super) fn drawing(
    done: &RigCalibration,
    boards: &[Vec<Point3<f64>>],
    axes: (usize, usize, f64),
    titles: [&str; 2],
) -> Plot {
    let mut drawing = ScaleDrawing::new(axes, titles);
    let geometry = &done.solution.geometry;
    for (view, (name, _)) in geometry.views.iter().enumerate() {
        let path = geometry.path(view);
        let mut light = Vec::new();
        for (picture, pose) in done.solution.poses.iter().enumerate() {
            let own = done.corners.iter().filter(|c| c.view == view && c.picture == picture);
            // The board's centre represents it.
            let middle = own.min_by(|a, b| a.place.coords.norm().total_cmp(&b.place.coords.norm()));
            if let Some(corner) = middle {
                light.extend(met(&path, &corner.pixel).into_iter().map(Some));
                light.extend([Some(pose * corner.place), None]);
            }
        }
        drawing.light(view, name, &light);
    }
    let outline = |board: &Vec<Point3<f64>>| {
        board.iter().chain(board.first()).copied().map(Some).chain([None]).collect::<Vec<_>>()
    };
    let outlines: Vec<_> = boards.iter().flat_map(outline).collect();
    drawing.lines("boards", &outlines, QUIET, 1.4);
    for ((name, surface), points) in geometry.surfaces.iter().zip(lit(&done.solution, &done.corners)) {
        let distance = surface.plane().offset_m().abs() * 1e3;
        drawing.surface(name, surface, &points, &format!(", {distance:.1} mm from the lens"));
    }
    drawing.camera();
    drawing.finish()
}
