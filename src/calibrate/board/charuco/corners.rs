//! The inner corners of a board whose markers are known: predicted from neighbouring markers and corners and refined in
//! the picture, from the markers outwards as far as squares alternate.

use nalgebra::{Matrix3, Point2, Vector2};
use opencv::Result;
use opencv::core::Mat;

use crate::calibrate::board::charuco::layout::Layout;
use crate::calibrate::board::charuco::markers::Marker;
use crate::calibrate::board::flat::{homography, map, median_or_nan};
use crate::calibrate::board::grey::Grey;
use crate::calibrate::board::search::{WINDOW, WINDOW_PX, refined};

/// Markers and corners within this many columns and rows predict a corner.
const NEAR: f64 = 2.1;
/// Largest distance of a corner from its prediction, squares: anything further is another edge.
const MAX_SHIFT: f64 = 0.25;
/// The squares around a corner must differ by this fraction of the markers' contrast.
const MIN_ALTERNATION: f64 = 0.3;
/// A half turn may change a corner's surroundings by this fraction of the markers' contrast (RMS): noise, small squares
/// and their perspective give up to 0.15, the edge of a thumb 0.3.
const ASYMMETRIC: f64 = 0.2;
/// Where the grey of a dark square is sampled, from its corner, squares.
const INSIDE: f64 = 0.25;

/// A board in a picture, while its corners are found.
pub(super) struct Search<'a> {
    pub(super) picture: &'a Grey,
    pub(super) pixels: &'a Mat,
    pub(super) layout: &'a Layout,
    pub(super) markers: &'a [Marker],
}

impl Search<'_> {
    /// All inner corners, row-major; `None` where not seen.
    pub(super) fn corners(&self) -> Result<Vec<Option<Point2<f64>>>> {
        let [columns, rows] = self.layout.squares.map(|n| n - 1);
        let of_markers = self.layout.pairs(self.markers);
        let place = |i: usize| Point2::new((i % columns) as f64, (i / columns) as f64);
        let mut corners: Vec<Option<Point2<f64>>> = vec![None; columns * rows];
        loop {
            let found: Vec<_> = (0..).zip(&corners).filter_map(|(i, corner)| Some((place(i), (*corner)?))).collect();
            let mut more = false;
            for (i, corner) in corners.iter_mut().enumerate().filter(|(_, corner)| corner.is_none()) {
                let near = |(own, _): &&(Point2<f64>, Point2<f64>)| (own - place(i)).amax() <= NEAR;
                let around: Vec<_> = of_markers.iter().chain(&found).filter(near).copied().collect();
                if let Some(flat) = homography(&around) {
                    *corner = self.corner(place(i), &flat)?;
                    more |= corner.is_some();
                }
            }
            if !more {
                return Ok(corners);
            }
        }
    }

    /// The corner near its place by a homography; `None` when there is none.
    fn corner(&self, place: Point2<f64>, flat: &Matrix3<f64>) -> Result<Option<Point2<f64>>> {
        let beside = [(1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)].map(|(x, y)| place + Vector2::new(x, y));
        let (Some(expected), Some(beside)) =
            (map(flat, place.x, place.y), beside.into_iter().map(|p| map(flat, p.x, p.y)).collect::<Option<Vec<_>>>())
        else {
            return Ok(None);
        };
        let square_px = beside.iter().map(|p| (p - expected).norm()).fold(f64::INFINITY, f64::min);
        // The window should not reach the markers; with few and blurred pixels it is larger.
        let half_px = (WINDOW.min(self.layout.plain()) * square_px).max(f64::from(WINDOW_PX.0));
        for half_px in [half_px, half_px + 1.0, half_px + 2.0] {
            let reach = half_px.min(f64::from(WINDOW_PX.1)) + MAX_SHIFT * square_px + 1.0;
            let ends = [(-reach, -reach), (reach, reach)].map(|(x, y)| expected + Vector2::new(x, y));
            if ends.into_iter().any(|end| self.picture.at(end).is_none()) {
                return Ok(None);
            }
            let corner = refined(self.pixels, expected, half_px)?;
            let moved = corner - expected;
            if moved.norm() < MAX_SHIFT * square_px
                && self.alternates(place, flat, moved)
                && self.is_symmetric(corner, half_px)
            {
                return Ok(Some(corner));
            }
        }
        Ok(None)
    }

    /// Whether a half turn leaves a corner's surroundings the same: not where something covers a part of them and
    /// shifts the corner.
    fn is_symmetric(&self, corner: Point2<f64>, half_px: f64) -> bool {
        let reach = half_px.min(f64::from(WINDOW_PX.1)) as i32;
        let (mut sum, mut count) = (0.0, 0);
        for (x, y) in (-reach..=reach).flat_map(|y| (-reach..=reach).map(move |x| (x, y))) {
            let off = Vector2::new(f64::from(x), f64::from(y));
            let (Some(here), Some(there)) = (self.picture.at(corner + off), self.picture.at(corner - off)) else {
                return false;
            };
            sum += (here - there).powi(2);
            count += 1;
        }
        (sum / f64::from(count)).sqrt() < ASYMMETRIC * self.contrast()
    }

    /// Median contrast of the markers.
    fn contrast(&self) -> f64 {
        median_or_nan(self.markers.iter().map(|marker| marker.contrast))
    }

    /// Whether the squares around a corner alternate between dark and light as on the board. `moved`: its distance from
    /// its place by the homography.
    fn alternates(&self, place: Point2<f64>, flat: &Matrix3<f64>, moved: Vector2<f64>) -> bool {
        let grey = |u: f64, v: f64| self.picture.at(map(flat, place.x + u, place.y + v)? + moved);
        let (mut darkest, mut lightest) = (f64::INFINITY, f64::NEG_INFINITY);
        for (right, below) in [(0, 0), (1, 0), (1, 1), (0, 1)] {
            // Square (C, R) ends at corner (C, R).
            let light = self.layout.is_light(place.x as usize + right, place.y as usize + below);
            let side = |towards: usize| if towards == 0 { -1.0 } else { 1.0 };
            let (x, y) = (side(right), side(below));
            let middle = self.layout.plain() / 2.0;
            let places: &[(f64, f64)] = if light { &[(INSIDE, middle), (middle, INSIDE)] } else { &[(INSIDE, INSIDE)] };
            for (u, v) in places {
                let Some(grey) = grey(x * u, y * v) else { return false };
                if light {
                    darkest = darkest.min(grey);
                } else {
                    lightest = lightest.max(grey);
                }
            }
        }
        darkest - lightest > MIN_ALTERNATION * self.contrast()
    }
}
