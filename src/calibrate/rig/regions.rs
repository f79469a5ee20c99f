//! Where in the picture each view is: between the boards of one view and those of the next.

use crate::calibrate::bundle::Corner;
use crate::calibrate::geometry::bounds;
use crate::optics::OpticalPath;
use crate::rig::polygon;
use nalgebra::{Point2, Rotation2, Vector2};
use std::f64::consts::TAU;

/// A view extends beyond its boards by this fraction of their size on every side: further out its rays are unknown.
const BEYOND: f64 = 0.5;

/// Step of the search for pixels without a ray, and number of directions of the lines that cut them off.
const STEP_PX: f64 = 4.0;
const DIRECTIONS: usize = 32;

/// The region of each view in the picture: around its boards, cut along lines halfway to the boards of the other views,
/// and without pixels that have no ray, beyond the edge of a wall or a mirror. Two views are not cut if no line
/// perpendicular to the line between their centres separates their boards.
pub(crate) fn regions(corners: &[Corner], views: &[OpticalPath], size_px: [u32; 2]) -> Vec<Vec<Point2<f64>>> {
    let of_view = |view: usize| corners.iter().filter(move |c| c.view == view).map(|c| c.pixel.coords);
    let centre = |view: usize| of_view(view).sum::<Vector2<f64>>() / of_view(view).count().max(1) as f64;
    let [right, bottom] = size_px.map(|size| f64::from(size) - 0.5);
    views
        .iter()
        .enumerate()
        .map(|(view, optics)| {
            let [low, high] = bounds(of_view(view));
            let beyond = (high - low) * BEYOND;
            let (low, high) = (low - beyond, high + beyond);
            let (x0, y0) = (low.x.max(-0.5), low.y.max(-0.5));
            let (x1, y1) = (high.x.min(right), high.y.min(bottom));
            let around = [(x0, y0), (x1, y0), (x1, y1), (x0, y1)];
            let mut region: Vec<Point2<f64>> = around.map(|(x, y)| Point2::new(x, y)).to_vec();
            for other in (0..views.len()).filter(|other| *other != view) {
                let away = (centre(other) - centre(view)).normalize();
                let last = of_view(view).map(|p| p.dot(&away)).fold(f64::NEG_INFINITY, f64::max);
                let first = of_view(other).map(|p| p.dot(&away)).fold(f64::INFINITY, f64::min);
                if last < first {
                    region = cut(&region, &away, (last + first) / 2.0);
                }
            }
            let boards: Vec<Vector2<f64>> = of_view(view).collect();
            visible_part(region, &boards, |pixel| optics.trace(pixel).is_ok())
        })
        .collect()
}

/// The part of a region whose pixels have rays: the rest is cut off by the straight line that keeps the most, and all
/// of the boards. If no line does, the region is kept, and `rig check` warns.
fn visible_part(
    region: Vec<Point2<f64>>,
    boards: &[Vector2<f64>],
    has_ray: impl Fn(&Point2<f64>) -> bool,
) -> Vec<Point2<f64>> {
    let blind: Vec<Vector2<f64>> = inside(&region).filter(|pixel| !has_ray(pixel)).map(|pixel| pixel.coords).collect();
    if blind.is_empty() {
        return region;
    }
    let parted = (0..DIRECTIONS).filter_map(|i| {
        let away = Rotation2::new(TAU * i as f64 / DIRECTIONS as f64) * Vector2::x();
        let limit = blind.iter().map(|p| p.dot(&away)).fold(f64::INFINITY, f64::min) - STEP_PX;
        boards.iter().all(|p| p.dot(&away) < limit).then(|| cut(&region, &away, limit))
    });
    let area = |region: &Vec<Point2<f64>>| polygon::area_and_centre(region).0;
    parted.max_by(|a, b| area(a).total_cmp(&area(b))).unwrap_or(region)
}

/// Pixels of a region, [`STEP_PX`] apart.
fn inside(region: &[Point2<f64>]) -> impl Iterator<Item = Point2<f64>> {
    let [low, high] = bounds(region.iter().map(|p| p.coords));
    let steps = ((high - low) / STEP_PX).map(|count| count.max(0.0) as u32);
    let pixel = move |i: u32, j: u32| Point2::from(low + Vector2::new(f64::from(i), f64::from(j)) * STEP_PX);
    let all = (0..=steps.y).flat_map(move |j| (0..=steps.x).map(move |i| pixel(i, j)));
    all.filter(|pixel| polygon::contains(region, pixel))
}

/// The part of a convex polygon where direction·p ≤ limit.
fn cut(polygon: &[Point2<f64>], direction: &Vector2<f64>, limit: f64) -> Vec<Point2<f64>> {
    let beyond = |p: &Point2<f64>| direction.dot(&p.coords) - limit;
    let next = polygon.iter().cycle().skip(1);
    let mut kept = Vec::new();
    for (a, b) in polygon.iter().zip(next) {
        let (from, to) = (beyond(a), beyond(b));
        if from <= 0.0 {
            kept.push(*a);
        }
        if (from < 0.0 && to > 0.0) || (from > 0.0 && to < 0.0) {
            kept.push(a + (b - a) * (from / (from - to)));
        }
    }
    kept
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::optics::Lens;

    fn air() -> OpticalPath {
        let lens = Lens {
            focal_px: Vector2::new(300.0, 300.0),
            principal_point_px: Point2::new(180.0, 180.0),
            distortion: [0.0; 5],
            denominator: [0.0; 3],
        };
        OpticalPath { lens, surfaces: Vec::new() }
    }

    #[test]
    fn views_reach_around_their_boards_and_to_each_other() {
        let corner = |view: usize, x: f64, y: f64| Corner {
            picture: 0,
            view,
            place: nalgebra::Point3::origin(),
            pixel: Point2::new(x, y),
            relative_sd: 1.0,
        };
        let corners =
            [corner(0, 100.0, 100.0), corner(0, 200.0, 300.0), corner(1, 240.0, 100.0), corner(1, 340.0, 300.0)];
        let found = regions(&corners, &[air(), air()], [360, 360]);
        let expected = [[50.0, 0.0, 220.0, 359.5], [220.0, 0.0, 359.5, 359.5]];
        for (region, [x0, y0, x1, y1]) in found.iter().zip(expected) {
            let bounds = |of: fn(&Point2<f64>) -> f64| {
                let values = || region.iter().map(of);
                (values().fold(f64::INFINITY, f64::min), values().fold(f64::NEG_INFINITY, f64::max))
            };
            assert_eq!((bounds(|p| p.x), bounds(|p| p.y)), ((x0, x1), (y0, y1)));
        }
    }

    #[test]
    fn what_has_no_ray_is_cut_off_beside_the_boards() {
        let region = [(0.0, 0.0), (400.0, 0.0), (400.0, 300.0), (0.0, 300.0)].map(|(x, y)| Point2::new(x, y)).to_vec();
        let boards = [Vector2::new(120.0, 60.0), Vector2::new(300.0, 250.0)];
        // The edge of a wall, a line from (40, 0) to (80, 300).
        let has_ray = |p: &Point2<f64>| p.x > 40.0 + p.y * 40.0 / 300.0;
        let found = visible_part(region.clone(), &boards, has_ray);
        assert!(inside(&found).all(|p| has_ray(&p)), "{found:?}");
        assert!(boards.iter().all(|p| polygon::contains(&found, &Point2::from(*p))), "{found:?}");
        // 340 x 300 px² have a ray.
        let area = polygon::area_and_centre(&found).0;
        assert!(area > 0.95 * 340.0 * 300.0, "{area}");
        assert_eq!(visible_part(region.clone(), &boards, |_| true), region);
        // A blind spot among the boards cannot be cut off by a line.
        assert_eq!(visible_part(region.clone(), &boards, |p| (p - Point2::new(200.0, 150.0)).norm() > 9.0), region);
    }

    #[test]
    fn a_square_cut_in_half() {
        let square = [(0.0, 0.0), (4.0, 0.0), (4.0, 2.0), (0.0, 2.0)].map(|(x, y)| Point2::new(x, y));
        let left = cut(&square, &Vector2::x(), 1.0);
        assert_eq!(left, [(0.0, 0.0), (1.0, 0.0), (1.0, 2.0), (0.0, 2.0)].map(|(x, y)| Point2::new(x, y)));
        assert_eq!(cut(&square, &Vector2::x(), 9.0), square);
    }
}
