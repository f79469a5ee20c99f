//! Pictures of a chessboard as views show it. Each pixel looks at as many places of it as blur and its own square
//! spread it over.

use super::light::linear;
use super::look::is_mirrored;
use super::scene::is_within;
use super::sensor::{Reader, Sensor};
use crate::calibrate::board::Board;
use crate::optics::{OpticalPath, Surface};
use crate::rig::View;
use nalgebra::{Isometry3, Point2, Point3, Vector2};

/// Samples a pixel is drawn with.
const SAMPLES: usize = 48;
/// Stored values of dark squares; of light ones and the paper; of what is behind the board.
const DARK: f64 = 46.0;
const LIGHT: f64 = 205.0;
const GROUND: f64 = 112.0;

/// Draws boards.
pub struct Boards {
    size_px: [u32; 2],
    views: Vec<View>,
    board: Board,
    reader: Reader,
    blur_px: f64,
}

impl Boards {
    /// Of a camera with pictures of this size and these views; `blur_px` is that of lens and pixel together.
    pub fn new(size_px: [u32; 2], views: Vec<View>, board: Board, blur_px: f64, sensor: Sensor) -> Self {
        Self { size_px, views, board, reader: Reader::new(sensor), blur_px }
    }

    pub(super) fn views(&self) -> &[View] {
        &self.views
    }

    pub(super) fn board(&self) -> &Board {
        &self.board
    }

    /// Where a view shows a place of the board, given in squares from corner 0.
    fn place(&self, path: &OpticalPath, pose: &Isometry3<f64>, column: f64, row: f64) -> Option<Point2<f64>> {
        let [c, r] = [self.board.columns, self.board.rows].map(|n| (n - 1) as f64 / 2.0);
        path.project(&(pose * (Point3::new(column - c, row - r, 0.0) * self.board.square_m))).ok()
    }

    /// The inner corners in a view, in the order of [`Board::points`].
    pub fn corners(&self, view: usize, pose: &Isometry3<f64>) -> Option<Vec<Point2<f64>>> {
        let path = &self.views.get(view)?.optics;
        let corner = |i: usize| (i % self.board.columns, i / self.board.columns);
        let corners = (0..self.board.columns * self.board.rows).map(corner);
        corners.map(|(c, r)| self.place(path, pose, c as f64, r as f64)).collect()
    }

    /// Whether a view shows the front of all of the board, its paper too.
    pub(super) fn shows(&self, view: &View, pose: &Isometry3<f64>) -> bool {
        let (columns, rows) = (self.board.columns as f64, self.board.rows as f64);
        let at = |column: f64, row: f64| self.place(&view.optics, pose, column, row);
        let rim = [(-2.0, -2.0), (columns + 1.0, -2.0), (columns + 1.0, rows + 1.0), (-2.0, rows + 1.0)];
        let rim = rim.map(|(column, row)| at(column, row));
        let whole =
            rim.iter().flatten().filter(|p| is_within(self.size_px, p) && view.contains(p)).count() == rim.len();
        let [Some(a), Some(b), _, Some(d)] = rim else { return false };
        whole && ((b - a).perp(&(d - a)) > 0.0) != is_flipped(&view.optics)
    }

    /// The picture, grey values row by row; `seed` is that of its noise.
    pub fn picture(&self, pose: &Isometry3<f64>, seed: u64) -> Vec<u8> {
        let [width, height] = self.size_px.map(|n| n as usize);
        let shade =
            |x: usize, y: usize| 0.9 + 0.16 * x as f64 / width as f64 + 0.05 * (5.0 * y as f64 / height as f64).sin();
        let mut light: Vec<f32> =
            (0..width * height).map(|i| (linear(GROUND) * shade(i % width, i / width)) as f32).collect();
        // The board itself stands before its images.
        let mut views: Vec<&View> = self.views.iter().collect();
        views.sort_by_key(|view| !is_mirrored(&view.optics));
        for view in views {
            self.draw(&mut light, view, pose);
        }
        let colours = self.reader.read([width, height], seed, |y, to| {
            to.extend(light.iter().skip(y * width).take(width).flat_map(|v| [*v; 3]));
        });
        colours.into_iter().step_by(3).collect()
    }

    fn draw(&self, light: &mut [f32], view: &View, pose: &Isometry3<f64>) {
        let path = &view.optics;
        let (columns, rows) = (self.board.columns as f64, self.board.rows as f64);
        let rim = [(-2.0, -2.0), (columns + 1.0, -2.0), (columns + 1.0, rows + 1.0), (-2.0, rows + 1.0)];
        let ends = rim.iter().map(|(c, r)| self.place(path, pose, *c, *r)).collect::<Option<Vec<_>>>();
        let Some(ends) = ends else { return };
        let [width, height] = self.size_px.map(|n| n as usize);
        let bound = |of: fn(&Point2<f64>) -> f64, most: usize| {
            let low = ends.iter().map(of).fold(f64::INFINITY, f64::min) - 4.0 * self.blur_px;
            let high = ends.iter().map(of).fold(f64::NEG_INFINITY, f64::max) + 4.0 * self.blur_px;
            low.floor().clamp(0.0, most as f64) as usize..(high.ceil() + 1.0).clamp(0.0, most as f64) as usize
        };
        let (xs, ys) = (bound(|p| p.x, width), bound(|p| p.y, height));
        let flipped = is_flipped(path);
        let offsets = offsets(self.blur_px);
        let dim = if is_mirrored(path) { 0.85 } else { 1.0 };
        // Places on the board at the corners of pixels: between them it is as good as flat.
        let line = |y: usize| -> Vec<Option<Vector2<f64>>> {
            let at = |x: usize| self.on_board(path, pose, Point2::new(x as f64 - 0.5, y as f64 - 0.5));
            (xs.start..=xs.end).map(at).collect()
        };
        let mut above = line(ys.start);
        for y in ys {
            let below = line(y + 1);
            for ((x, above), below) in xs.clone().zip(above.windows(2)).zip(below.windows(2)) {
                let (&[Some(a), Some(b)], &[Some(c), Some(d)]) = (above, below) else { continue };
                if !view.contains(&Point2::new(x as f64, y as f64)) {
                    continue;
                }
                let (middle, right, down) = ((a + b + c + d) / 4.0, (b + d - a - c) / 2.0, (c + d - a - b) / 2.0);
                let from_behind = (right.perp(&down) < 0.0) != flipped;
                let Some(sample) = light.get_mut(y * width + x) else { continue };
                let ground = f64::from(*sample);
                let sum: f64 = offsets
                    .iter()
                    .map(|o| {
                        let at = middle + right * o.x + down * o.y;
                        self.grey(at, from_behind).map_or(ground, |grey| linear(grey) * dim)
                    })
                    .sum();
                *sample = (sum / offsets.len() as f64) as f32;
            }
            above = below;
        }
    }

    /// Column and row on the board that a pixel looks at.
    fn on_board(&self, path: &OpticalPath, pose: &Isometry3<f64>, pixel: Point2<f64>) -> Option<Vector2<f64>> {
        let ray = path.trace(&pixel).ok()?;
        let (origin, direction) = (pose.inverse() * ray.origin, pose.inverse() * ray.direction);
        let way = -origin.z / direction.z;
        let at = (origin + direction * way).xy() / self.board.square_m;
        let middle = Vector2::new((self.board.columns - 1) as f64, (self.board.rows - 1) as f64) / 2.0;
        (way > 0.0).then_some(at.coords + middle)
    }

    /// `None` beyond the paper, a square around the outer squares.
    fn grey(&self, at: Vector2<f64>, from_behind: bool) -> Option<f64> {
        let (columns, rows) = (self.board.columns as f64, self.board.rows as f64);
        let within = |rim: f64| (-rim..columns - 1.0 + rim).contains(&at.x) && (-rim..rows - 1.0 + rim).contains(&at.y);
        let dark = (at.x.floor() + at.y.floor()).rem_euclid(2.0) == 0.0;
        match (within(1.0), within(2.0)) {
            (true, _) if dark && !from_behind => Some(DARK),
            (_, true) => Some(LIGHT),
            (_, false) => None,
        }
    }
}

/// Whether a path shows things the wrong way round.
fn is_flipped(path: &OpticalPath) -> bool {
    path.surfaces.iter().filter(|surface| matches!(surface, Surface::Mirror(_))).count() % 2 == 1
}

/// Places in a pixel, or about it, as the blur of this standard deviation spreads them: a sunflower's seeds.
fn offsets(blur_px: f64) -> Vec<Vector2<f64>> {
    let seed = |i: usize| {
        let radius = blur_px * (-2.0 * (1.0 - (i as f64 + 0.5) / SAMPLES as f64).ln()).sqrt();
        let (sin, cos) = (i as f64 * 2.399_963_229_728_653).sin_cos();
        Vector2::new(radius * cos, radius * sin)
    };
    let mut offsets: Vec<Vector2<f64>> = (0..SAMPLES).map(seed).collect();
    let mean = offsets.iter().sum::<Vector2<f64>>() / SAMPLES as f64;
    offsets.iter_mut().for_each(|o| *o -= mean);
    offsets
}
