//! Where in the picture each view is: between the boards of one view and those of the next.

use super::bundle::Corner;
use nalgebra::{Point2, Vector2};

/// Where each view is in the picture: the picture cut along lines halfway between the boards of two views. Two views whose
/// boards no line across their centres parts are not cut.
pub(super) fn regions(corners: &[Corner], views: usize, size_px: [u32; 2]) -> Vec<Vec<Point2<f64>>> {
    let of_view = |view: usize| corners.iter().filter(move |c| c.view == view).map(|c| c.pixel.coords);
    let centre = |view: usize| of_view(view).sum::<Vector2<f64>>() / of_view(view).count().max(1) as f64;
    let [right, bottom] = size_px.map(|size| f64::from(size) - 0.5);
    (0..views)
        .map(|view| {
            let whole = [(-0.5, -0.5), (right, -0.5), (right, bottom), (-0.5, bottom)];
            let mut region: Vec<Point2<f64>> = whole.map(|(x, y)| Point2::new(x, y)).to_vec();
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
    fn a_square_cut_in_half() {
        let square = [(0.0, 0.0), (4.0, 0.0), (4.0, 2.0), (0.0, 2.0)].map(|(x, y)| Point2::new(x, y));
        let left = cut(&square, &Vector2::x(), 1.0);
        assert_eq!(left, [(0.0, 0.0), (1.0, 0.0), (1.0, 2.0), (0.0, 2.0)].map(|(x, y)| Point2::new(x, y)));
        assert_eq!(cut(&square, &Vector2::x(), 9.0), square);
    }
}
