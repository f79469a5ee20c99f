//! Where in the picture each view is: between the boards of one view and those of the next.

use super::bundle::Corner;
use nalgebra::{Point2, Vector2};

/// A view reaches beyond its boards by this part of their extent, to every side: further out nothing is known of its rays.
const BEYOND: f64 = 0.5;

/// Where each view is in the picture: around its boards, and cut along lines halfway to the boards of the other views. Two
/// views whose boards no line across their centres parts are not cut.
pub(super) fn regions(corners: &[Corner], views: usize, size_px: [u32; 2]) -> Vec<Vec<Point2<f64>>> {
    let of_view = |view: usize| corners.iter().filter(move |c| c.view == view).map(|c| c.pixel.coords);
    let centre = |view: usize| of_view(view).sum::<Vector2<f64>>() / of_view(view).count().max(1) as f64;
    let [right, bottom] = size_px.map(|size| f64::from(size) - 0.5);
    (0..views)
        .map(|view| {
            let bound = |pick: fn(f64, f64) -> f64, start: f64| {
                of_view(view).fold(Vector2::repeat(start), |b, p| b.zip_map(&p, pick))
            };
            let (low, high) = (bound(f64::min, f64::INFINITY), bound(f64::max, f64::NEG_INFINITY));
            let beyond = (high - low) * BEYOND;
            let (low, high) = (low - beyond, high + beyond);
            let (x0, y0) = (low.x.max(-0.5), low.y.max(-0.5));
            let (x1, y1) = (high.x.min(right), high.y.min(bottom));
            let around = [(x0, y0), (x1, y0), (x1, y1), (x0, y1)];
            let mut region: Vec<Point2<f64>> = around.map(|(x, y)| Point2::new(x, y)).to_vec();
            for other in (0..views).filter(|other| *other != view) {
                let away = (centre(other) - centre(view)).normalize();
                let last = of_view(view).map(|p| p.dot(&away)).fold(f64::NEG_INFINITY, f64::max);
                let first = of_view(other).map(|p| p.dot(&away)).fold(f64::INFINITY, f64::min);
                if last < first {
                    region = cut(&region, &away, (last + first) / 2.0);
                }
            }
            region
        })
        .collect()
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

    #[test]
    fn views_reach_around_their_boards_and_to_each_other() {
        let corner = |view: usize, x: f64, y: f64| Corner {
            picture: 0,
            view,
            place: nalgebra::Point3::origin(),
            pixel: Point2::new(x, y),
        };
        let corners =
            [corner(0, 100.0, 100.0), corner(0, 200.0, 300.0), corner(1, 240.0, 100.0), corner(1, 340.0, 300.0)];
        let found = regions(&corners, 2, [360, 360]);
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
    fn a_square_cut_in_half() {
        let square = [(0.0, 0.0), (4.0, 0.0), (4.0, 2.0), (0.0, 2.0)].map(|(x, y)| Point2::new(x, y));
        let left = cut(&square, &Vector2::x(), 1.0);
        assert_eq!(left, [(0.0, 0.0), (1.0, 0.0), (1.0, 2.0), (0.0, 2.0)].map(|(x, y)| Point2::new(x, y)));
        assert_eq!(cut(&square, &Vector2::x(), 9.0), square);
    }
}
