//! Draws pictures of a chessboard as a rig shows it: through its lens, in its mirrors, through its glass and water.

use catoptra::calibrate::board::Board;
use catoptra::calibrate::geometry::Geometry;
use catoptra::optics::{OpticalPath, Surface};
use catoptra::rig::Draft;
use nalgebra::{Isometry3, Point2, Point3, Rotation3, Translation3, UnitQuaternion, Vector2, Vector3};
use std::path::{Path, PathBuf};

/// Samples a pixel is drawn with, spread as the blur is.
const SAMPLES: usize = 48;
/// Grey values of dark squares; of light ones and the paper.
const DARK: f64 = 40.0;
const LIGHT: f64 = 215.0;

/// What stands still while the board moves.
#[derive(Clone)]
pub(crate) struct Scene {
    pub(crate) size_px: [u32; 2],
    pub(crate) geometry: Geometry,
    /// For each view the corners of its part of the picture, in turn; none: all of the picture.
    pub(crate) regions: Vec<Vec<[f64; 2]>>,
    pub(crate) board: Board,
    /// Standard deviation of the blur.
    pub(crate) blur_px: f64,
    /// Standard deviation of the noise, grey values.
    pub(crate) noise: f64,
}

impl Scene {
    /// As a rig file has it.
    pub(crate) fn of(rig: &Path, board: &str) -> Self {
        let draft = Draft::load(rig).unwrap();
        let surfaces: Vec<(String, Surface)> = draft.surfaces.into_iter().collect();
        let index = |name: &String| surfaces.iter().position(|(own, _)| own == name).unwrap();
        let views = draft.views.iter().map(|v| (v.name.clone(), v.path.iter().map(index).collect())).collect();
        Self {
            size_px: draft.camera.size_px,
            geometry: Geometry { lens: draft.camera.lens, surfaces, views },
            regions: vec![Vec::new(); draft.views.len()],
            board: board.parse().unwrap(),
            blur_px: 0.6,
            noise: 2.0,
        }
    }

    /// The same camera with nothing before it.
    pub(crate) fn in_air(&self) -> Self {
        let geometry =
            Geometry { surfaces: Vec::new(), views: vec![("air".to_owned(), Vec::new())], ..self.geometry.clone() };
        Self { geometry, regions: vec![Vec::new()], ..self.clone() }
    }

    /// Where a view shows a place of the board, given in squares from corner 0.
    fn place(&self, path: &OpticalPath, pose: &Isometry3<f64>, column: f64, row: f64) -> Option<Point2<f64>> {
        let [c, r] = [self.board.columns, self.board.rows].map(|n| (n - 1) as f64 / 2.0);
        let place = Point3::new(column - c, row - r, 0.0) * self.board.square_m;
        path.project(&(pose * place)).ok()
    }

    /// The inner corners in a view, in the order of `Board::points`; `pose` is that of the board's middle.
    pub(crate) fn corners(&self, view: usize, pose: &Isometry3<f64>) -> Option<Vec<Point2<f64>>> {
        let path = self.geometry.path(view);
        let corner = |i: usize| (i % self.board.columns, i / self.board.columns);
        let corners = (0..self.board.columns * self.board.rows).map(corner);
        corners.map(|(c, r)| self.place(&path, pose, c as f64, r as f64)).collect()
    }

    /// Whether a view shows the front of all of the board.
    pub(crate) fn shows(&self, view: usize, pose: &Isometry3<f64>) -> bool {
        let Some(corners) = self.corners(view, pose) else { return false };
        let (along, down) = (corners[1] - corners[0], corners[self.board.columns] - corners[0]);
        let region = &self.regions[view];
        (along.perp(&down) > 0.0) != self.is_mirrored(view)
            && corners.iter().all(|c| region.is_empty() || inside(region, c.x, c.y))
    }

    /// The picture, grey values row by row; `seed` is that of its noise.
    pub(crate) fn picture(&self, pose: &Isometry3<f64>, seed: u64) -> image::GrayImage {
        let mut samples = self.ground();
        // The board itself stands before its images.
        for view in (0..self.geometry.views.len()).rev() {
            self.draw(&mut samples, view, pose);
        }
        // Not of `Random`: with some of its draws a set that leaves the wall open is refused without saying so, see
        // `calibrate_sets.rs`.
        let mut state = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
        let mut noise = || {
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            // Four uniform numbers of 16 bits: variance 1/3.
            let sum: u64 = (0..4).map(|i| (state >> (16 * i)) & 0xffff).sum();
            (sum as f64 / 65535.0 - 2.0) * 3_f64.sqrt()
        };
        let bytes = samples.iter().map(|v| (f64::from(*v) + self.noise * noise()).round().clamp(0.0, 255.0) as u8);
        image::GrayImage::from_raw(self.size_px[0], self.size_px[1], bytes.collect()).unwrap()
    }

    /// A wall in uneven light, mirrors darker.
    fn ground(&self) -> Vec<f32> {
        let [width, height] = self.size_px;
        let waves: Vec<(f64, f64)> = (0..width).map(|x| (9.0 * f64::from(x) / f64::from(width)).sin_cos()).collect();
        let mut samples = Vec::with_capacity((width * height) as usize);
        for y in 0..height {
            let (sin, cos) = (5.0 * f64::from(y) / f64::from(height)).sin_cos();
            let panes: Vec<_> = self.regions.iter().skip(1).filter_map(|r| crossing(r, f64::from(y))).collect();
            samples.extend(waves.iter().enumerate().map(|(x, wave)| {
                let in_pane = panes.iter().any(|pane| pane.contains(&(x as f64)));
                let pane = if in_pane { 30.0 } else { 0.0 };
                (90.0 + 40.0 * x as f64 / f64::from(width) + 15.0 * (wave.0 * cos + wave.1 * sin) - pane) as f32
            }));
        }
        samples
    }

    fn draw(&self, samples: &mut [f32], view: usize, pose: &Isometry3<f64>) {
        let path = self.geometry.path(view);
        let (columns, rows) = (self.board.columns as f64, self.board.rows as f64);
        let rim = [(-2.0, -2.0), (columns + 1.0, -2.0), (columns + 1.0, rows + 1.0), (-2.0, rows + 1.0)];
        let Some(ends) = rim.iter().map(|(c, r)| self.place(&path, pose, *c, *r)).collect::<Option<Vec<_>>>() else {
            return;
        };
        let [width, height] = self.size_px.map(f64::from);
        let bound = |of: fn(&Point2<f64>) -> f64, most: f64| {
            let low = ends.iter().map(of).fold(f64::INFINITY, f64::min) - 4.0 * self.blur_px;
            let high = ends.iter().map(of).fold(f64::NEG_INFINITY, f64::max) + 4.0 * self.blur_px;
            low.floor().clamp(0.0, most) as usize..(high.ceil() + 1.0).clamp(0.0, most) as usize
        };
        let (xs, ys) = (bound(|p| p.x, width), bound(|p| p.y, height));
        let mirrored = self.is_mirrored(view);
        let offsets = offsets(self.blur_px);
        // Places on the board at the corners of pixels: between them it is as good as flat.
        let line = |y: usize| -> Vec<Option<Vector2<f64>>> {
            let at = |x: usize| self.on_board(&path, pose, Point2::new(x as f64 - 0.5, y as f64 - 0.5));
            (xs.start..=xs.end).map(at).collect()
        };
        let mut above = line(ys.start);
        for y in ys {
            let below = line(y + 1);
            for (i, x) in xs.clone().enumerate() {
                let (Some(a), Some(b), Some(c), Some(d)) = (above[i], above[i + 1], below[i], below[i + 1]) else {
                    continue;
                };
                if !self.regions[view].is_empty() && !inside(&self.regions[view], x as f64, y as f64) {
                    continue;
                }
                let (middle, right, down) = ((a + b + c + d) / 4.0, (b + d - a - c) / 2.0, (c + d - a - b) / 2.0);
                let from_behind = (right.perp(&down) < 0.0) != mirrored;
                let sample = &mut samples[y * self.size_px[0] as usize + x];
                let ground = f64::from(*sample);
                let light = 0.75 + 0.25 * (x as f64 / width);
                let sum: f64 = offsets
                    .iter()
                    .map(|o| {
                        let at = middle + right * o.x + down * o.y;
                        self.grey(at, from_behind).map_or(ground, |grey| grey * light)
                    })
                    .sum();
                *sample = (sum / offsets.len() as f64) as f32;
            }
            above = below;
        }
    }

    fn is_mirrored(&self, view: usize) -> bool {
        let is_mirror = |surface: usize| matches!(self.geometry.surfaces[surface].1, Surface::Mirror(_));
        self.geometry.views[view].1.iter().filter(|s| is_mirror(**s)).count() % 2 == 1
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

    /// Saves a picture for each pose as `NAME00.png` …
    pub(crate) fn save(&self, poses: &[Isometry3<f64>], folder: &Path, name: &str) -> Vec<PathBuf> {
        std::fs::create_dir_all(folder).unwrap();
        let save = |(i, pose): (usize, &Isometry3<f64>)| {
            let path = folder.join(format!("{name}{i:02}.png"));
            self.picture(pose, i as u64 + 1).save(&path).unwrap();
            path
        };
        poses.iter().enumerate().map(save).collect()
    }
}

/// Pose of a board's middle, metres, turned about its own x, then y, then z, degrees; without a turn it faces the
/// camera.
pub(crate) fn pose(middle_m: [f64; 3], turn_deg: [f64; 3]) -> Isometry3<f64> {
    let [x, y, z] = turn_deg.map(f64::to_radians);
    let turn = Rotation3::from_axis_angle(&Vector3::z_axis(), z)
        * Rotation3::from_axis_angle(&Vector3::y_axis(), y)
        * Rotation3::from_axis_angle(&Vector3::x_axis(), x);
    Isometry3::from_parts(Translation3::from(middle_m), UnitQuaternion::from_rotation_matrix(&turn))
}

/// Places in a pixel, or about it, as a Gaussian blur and the pixel's own area spread them: a sunflower's seeds.
fn offsets(blur_px: f64) -> Vec<Vector2<f64>> {
    let sd = (blur_px * blur_px + 1.0 / 12.0).sqrt();
    let seed = |i: usize| {
        let radius = sd * (-2.0 * (1.0 - (i as f64 + 0.5) / SAMPLES as f64).ln()).sqrt();
        let (sin, cos) = (i as f64 * 2.399_963_229_728_653).sin_cos();
        Vector2::new(radius * cos, radius * sin)
    };
    let mut offsets: Vec<Vector2<f64>> = (0..SAMPLES).map(seed).collect();
    let mean = offsets.iter().sum::<Vector2<f64>>() / SAMPLES as f64;
    offsets.iter_mut().for_each(|o| *o -= mean);
    offsets
}

/// Where a row crosses a convex polygon.
fn crossing(corners: &[[f64; 2]], y: f64) -> Option<std::ops::Range<f64>> {
    let sides = corners.iter().zip(corners.iter().cycle().skip(1)).filter(|(a, b)| (a[1] > y) != (b[1] > y));
    let xs: Vec<f64> = sides.map(|(a, b)| a[0] + (b[0] - a[0]) * (y - a[1]) / (b[1] - a[1])).collect();
    let [a, b] = xs[..] else { return None };
    Some(a.min(b)..a.max(b))
}

/// Whether a place is inside of a convex polygon.
pub(crate) fn inside(corners: &[[f64; 2]], x: f64, y: f64) -> bool {
    crossing(corners, y).is_some_and(|row| row.contains(&x))
}
