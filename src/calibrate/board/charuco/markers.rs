//! Markers in a picture: dark quadrilaterals in light surroundings, read cell by cell.
//!
//! OpenCV has its own detector, up to 4.6 in a module that many systems omit and from 4.7 under other names, and it
//! does not find mirrored markers. Only little of it is needed: outlines, and the words in them.

use nalgebra::{Point2, Vector2};
use opencv::Result;
use opencv::core::{Mat, Point, Size, Vector};
use opencv::imgproc;
use opencv::prelude::*;

use crate::calibrate::board::charuco::dictionary::Dictionary;
use crate::calibrate::board::flat::{homography, map, median_or_nan};
use crate::calibrate::board::grey::Grey;
use crate::calibrate::board::search::SEEN_PX;

/// Sides of the windows whose mean separates dark from light, pixels of the scaled picture; and by how many grey values
/// dark must be below it.
const WINDOWS: [(i32, f64); 4] = [(9, 7.0), (23, 7.0), (9, 3.0), (35, 3.0)];
/// Least side of a marker, pixels.
const MIN_PX: f64 = 8.0;
/// An outline counts as a quadrilateral if it deviates by less than this fraction of its length.
const STRAIGHTNESS: f64 = 0.04;
/// Fraction at each end of a side that is left out of its line fit: corners are round in blurred pictures.
const END_FRACTION: f64 = 0.15;
/// Least contrast between a marker's rim and its surroundings, grey values.
const MIN_CONTRAST: f64 = 8.0;
/// Fraction of the rim's cells that may be light, and of those around it that may be dark.
const MAX_WRONG_CELLS: f64 = 0.15;

/// A convex quadrilateral, darker than its surroundings; its corners clockwise (from x to y), pixels.
pub(super) struct Quad([Point2<f64>; 4]);

/// A word read in a quadrilateral, with the first cell at its first corner and rows towards the second.
pub(super) struct Reading {
    corners: [Point2<f64>; 4],
    word: u64,
    cells: usize,
    contrast: f64,
}

/// A marker in a picture.
#[derive(Debug, Clone)]
pub(super) struct Marker {
    pub(super) id: usize,
    /// Upper left, upper right, lower right, lower left as printed; pixels.
    pub(super) corners: [Point2<f64>; 4],
    pub(super) mirrored: bool,
    /// Cells that differ from the dictionary.
    pub(super) wrong: u32,
    /// Contrast between dark and light, grey values.
    pub(super) contrast: f64,
}

impl Marker {
    /// Where its diagonals meet.
    pub(super) fn middle(&self) -> Point2<f64> {
        let [a, b, c, d] = self.corners;
        let (along, across) = (c - a, d - b);
        a + along * ((b - a).perp(&across) / along.perp(&across))
    }

    /// Length of a side, pixels.
    pub(super) fn side_px(&self) -> f64 {
        side_px(&self.corners)
    }

    /// Whether two are readings of the same quadrilateral.
    pub(super) fn is_at(&self, other: &Self) -> bool {
        (self.middle() - other.middle()).norm() < self.side_px().max(other.side_px()) / 2.0
    }
}

fn side_px(corners: &[Point2<f64>; 4]) -> f64 {
    (0..4).map(|i| (corners[(i + 1) % 4] - corners[i]).norm()).sum::<f64>() / 4.0
}

/// All quadrilaterals, from the picture at several scales: small is fast and less noisy, large shows small ones.
pub(super) fn quads(pixels: &Mat) -> Result<Vec<Quad>> {
    let (width, height) = (pixels.cols(), pixels.rows());
    let long = width.max(height);
    let mut found = Vec::new();
    for seen_px in SEEN_PX.into_iter().filter(|seen| *seen < long).chain([long.min(SEEN_PX[3])]) {
        let scale = f64::from(seen_px) / f64::from(long);
        let size = Size::new(
            (f64::from(width) * scale).round().max(1.0) as i32,
            (f64::from(height) * scale).round().max(1.0) as i32,
        );
        let (mut seen, mut dark) = (Mat::default(), Mat::default());
        imgproc::resize(pixels, &mut seen, size, 0.0, 0.0, imgproc::INTER_AREA)?;
        let scale = Vector2::new(f64::from(size.width) / f64::from(width), f64::from(size.height) / f64::from(height));
        for (window, below) in WINDOWS {
            let (mean, inverse) = (imgproc::ADAPTIVE_THRESH_MEAN_C, imgproc::THRESH_BINARY_INV);
            imgproc::adaptive_threshold(&seen, &mut dark, 255.0, mean, inverse, window, below)?;
            let mut outlines = Vector::<Vector<Point>>::new();
            imgproc::find_contours_def(&dark, &mut outlines, imgproc::RETR_LIST, imgproc::CHAIN_APPROX_NONE)?;
            for outline in outlines {
                if let Some(corners) = quad(&outline)? {
                    // Pixel centres are at integers: pixel edges, at halves, coincide.
                    let half = Vector2::repeat(0.5);
                    let whole = |c: Point2<f64>| Point2::from((c.coords + half).component_div(&scale) - half);
                    found.push(Quad(corners.map(whole)));
                }
            }
        }
    }
    Ok(found)
}

/// The corners of an outline that is a quadrilateral around dark pixels.
fn quad(outline: &Vector<Point>) -> Result<Option<[Point2<f64>; 4]>> {
    if (outline.len() as f64) < 3.5 * MIN_PX {
        return Ok(None);
    }
    let mut ends = Vector::<Point>::new();
    imgproc::approx_poly_dp(outline, &mut ends, STRAIGHTNESS * imgproc::arc_length(outline, true)?, true)?;
    // Outlines of dark areas are traced one way round, those of holes the other way.
    let around_dark = imgproc::contour_area(outline, true)? < 0.0;
    if ends.len() != 4 || !around_dark || !imgproc::is_contour_convex(&ends)? {
        return Ok(None);
    }
    let points: Vec<Point> = outline.to_vec();
    let mut ends: Vec<usize> = ends.iter().filter_map(|end| points.iter().position(|p| *p == end)).collect();
    ends.sort_unstable();
    let [a, b, c, d] = ends[..] else { return Ok(None) };
    let sides = [(a, b), (b, c), (c, d), (d, a + points.len())].map(|(from, to)| line(&points, from, to));
    let [Some(first), Some(second), Some(third), Some(fourth)] = sides else { return Ok(None) };
    let corners = [meet(first, second), meet(second, third), meet(third, fourth), meet(fourth, first)];
    let [Some(mut a), Some(mut b), Some(mut c), Some(mut d)] = corners else { return Ok(None) };
    let turn = (b - a).perp(&(c - b));
    if turn < 0.0 {
        (b, d) = (d, b);
    }
    // Outlines run through the centres of the outermost dark pixels; the edge is half a pixel further out.
    let middle = nalgebra::center(&nalgebra::center(&a, &c), &nalgebra::center(&b, &d));
    let corners = [a, b, c, d];
    let side = side_px(&corners);
    for corner in [&mut a, &mut b, &mut c, &mut d] {
        *corner += (*corner - middle) / side;
    }
    let sides = [b - a, c - b, d - c, a - d].map(|side| side.norm());
    let least = sides.into_iter().fold(f64::INFINITY, f64::min);
    let most = sides.into_iter().fold(0.0, f64::max);
    Ok((least > MIN_PX / 2.0 && side > MIN_PX && most < 5.0 * least).then_some([a, b, c, d]))
}

/// The line through the outline between two of its points, without the ends: a point and a direction.
fn line(outline: &[Point], from: usize, to: usize) -> Option<(Point2<f64>, Vector2<f64>)> {
    let end = ((to.checked_sub(from)?) as f64 * END_FRACTION) as usize;
    let points = (from + end..=to - end).filter_map(|i| outline.get(i % outline.len()));
    let points: Vec<_> = points.map(|p| Vector2::new(f64::from(p.x), f64::from(p.y))).collect();
    let mean = points.iter().sum::<Vector2<f64>>() / points.len() as f64;
    let scatter = points.iter().map(|p| (p - mean) * (p - mean).transpose()).sum::<nalgebra::Matrix2<f64>>();
    let eigen = scatter.symmetric_eigen();
    (points.len() > 2).then(|| (mean.into(), eigen.eigenvectors.column(eigen.eigenvalues.imax()).into_owned()))
}

fn meet((a, along_a): (Point2<f64>, Vector2<f64>), (b, along_b): (Point2<f64>, Vector2<f64>)) -> Option<Point2<f64>> {
    let turn = along_a.perp(&along_b);
    (turn.abs() > 0.1).then(|| a + along_a * ((b - a).perp(&along_b) / turn))
}

impl Quad {
    /// The word in it, read as a marker with `cells` per side; `around`: width of the light margin around a marker, as
    /// a fraction of its side. `None` when it has no dark rim in light surroundings.
    pub(super) fn read(&self, picture: &Grey, cells: usize, around: f64) -> Option<Reading> {
        let Self(corners) = *self;
        let n = cells as f64 + 2.0;
        let ends = [(0.0, 0.0), (n, 0.0), (n, n), (0.0, n)].map(|(x, y)| Point2::new(x, y));
        let flat = homography(&ends.into_iter().zip(corners).collect::<Vec<_>>())?;
        let grey = |x: f64, y: f64| picture.at(map(&flat, x, y)?);
        let cell = |column: usize, row: usize| -> Option<f64> {
            let places = [(0.5, 0.5), (0.3, 0.3), (0.7, 0.3), (0.7, 0.7), (0.3, 0.7)];
            let sum: Option<f64> = places.iter().map(|(u, v)| grey(column as f64 + u, row as f64 + v)).sum();
            Some(sum? / places.len() as f64)
        };
        let last = cells + 1;
        let whole = 0..=last;
        let rim = whole.clone().flat_map(|i| [(i, 0), (i, last), (0, i), (last, i)]);
        let rim: Vec<f64> = rim.map(|(column, row)| cell(column, row)).collect::<Option<_>>()?;
        let off = (around * n / 2.0).min(0.5);
        let outside = whole.flat_map(|i| {
            let at = i as f64 + 0.5;
            [(at, -off), (at, n + off), (-off, at), (n + off, at)]
        });
        let outside: Vec<f64> = outside.map(|(x, y)| grey(x, y)).collect::<Option<_>>()?;
        let (dark, light) = (median_or_nan(rim.iter().copied()), median_or_nan(outside.iter().copied()));
        let limit = (dark + light) / 2.0;
        let unclean = |greys: &[f64], wrong: &dyn Fn(f64) -> bool| {
            greys.iter().filter(|grey| wrong(**grey)).count() as f64 > MAX_WRONG_CELLS * greys.len() as f64
        };
        if light - dark < MIN_CONTRAST || unclean(&rim, &|g| g > limit) || unclean(&outside, &|g| g < limit) {
            return None;
        }
        let mut word = 0;
        for (row, column) in (1..=cells).flat_map(|row| (1..=cells).map(move |column| (row, column))) {
            word = word << 1 | u64::from(cell(column, row)? > limit);
        }
        Some(Reading { corners, word, cells, contrast: light - dark })
    }
}

impl Reading {
    /// All markers it may be, with up to `most_wrong` wrong cells, in all rotations and mirrored.
    pub(super) fn markers(&self, dictionary: Dictionary, most_wrong: u32) -> Vec<Marker> {
        let [a, b, c, d] = self.corners;
        let mut found = Vec::new();
        let mut corners = [a, b, c, d];
        let mut word = self.word;
        for _ in 0..4 {
            let [a, b, c, d] = corners;
            for (mirrored, word, corners) in [(false, word, corners), (true, self.transposed(word), [a, d, c, b])] {
                for (id, own) in dictionary.words().iter().enumerate() {
                    let wrong = (own ^ word).count_ones();
                    if wrong <= most_wrong {
                        found.push(Marker { id, corners, mirrored, wrong, contrast: self.contrast });
                    }
                }
            }
            corners.rotate_left(1);
            // Old columns become rows, the last column first.
            word = self.permuted(word, |row, column| (column, self.cells - 1 - row));
        }
        found
    }

    fn transposed(&self, word: u64) -> u64 {
        self.permuted(word, |row, column| (column, row))
    }

    /// The word whose cell (row, column) is cell `from(row, column)` of another.
    fn permuted(&self, word: u64, from: impl Fn(usize, usize) -> (usize, usize)) -> u64 {
        let n = self.cells;
        let places = (0..n).flat_map(|row| (0..n).map(move |column| (row, column)));
        places
            .map(|(row, column)| from(row, column))
            .fold(0, |to, (row, column)| to << 1 | word >> (n * n - 1 - (row * n + column)) & 1)
    }
}
