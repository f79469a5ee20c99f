//! Pictures of a chessboard for `calibrate camera` and `calibrate rig`: in air without mirrors, and as the rig shows it.
//!
//! The board stands where the catheter is, turned so that all views see its front, tilted to all sides. Each pixel
//! looks at as many places of it as blur and its own square spread it over.

use super::light::linear;
use super::look::is_mirrored;
use super::scene::in_picture;
use super::sensor::{Reader, Sensor};
use crate::calibrate::board::{Board, BoardError};
use crate::optics::{OpticalPath, Surface};
use crate::rig::{Rig, View};
use nalgebra::{Isometry3, Point2, Point3, Rotation3, Translation3, UnitQuaternion, Vector2, Vector3};

/// Samples a pixel is drawn with.
const SAMPLES: usize = 48;
/// Stored values of dark squares; of light ones and the paper; of what is behind the board.
const DARK: f64 = 46.0;
const LIGHT: f64 = 205.0;
const GROUND: f64 = 112.0;
/// Tilts, degrees: in air, and in the rig, where all views must see the front.
const TILT_DEG: (f64, f64) = (40.0, 30.0);
/// Part of the picture's width that a board in air fills.
const FILLS: (f64, f64) = (0.35, 0.6);
/// How far from the catheter's middle a board in the rig stands, by its own width.
const ASIDE: f64 = 0.45;
/// Poses tried for each picture.
const ATTEMPTS: usize = 20_000;

/// Where boards stand.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum BoardSet {
    /// Before the bare camera.
    Air,
    /// In the rig, seen in all of its views.
    Rig,
}

/// Why there are no pictures.
#[derive(Debug, thiserror::Error)]
pub enum BoardsError {
    /// No pose is seen as a whole.
    #[error(
        "no place is found where {views} show a whole board of {width_mm:.0} mm: take a smaller one, or larger regions"
    )]
    NoPlace {
        /// Which views.
        views: String,
        /// Its longer side, mm.
        width_mm: f64,
    },
    /// No board at all.
    #[error(transparent)]
    Board(#[from] BoardError),
}

/// Draws boards.
pub struct Boards {
    size_px: [usize; 2],
    views: Vec<View>,
    board: Board,
    reader: Reader,
    blur_px: f64,
    set: BoardSet,
    /// Where boards stand in the rig: middle, and how the camera and mirrors look at it.
    around: (Point3<f64>, Vector3<f64>),
    rig: Rig,
}

impl Boards {
    /// For a rig; `around` is where the catheter is, camera frame.
    pub fn new(rig: &Rig, board: Board, set: BoardSet, around: Point3<f64>, blur_px: f64, sensor: Sensor) -> Self {
        let views = match set {
            BoardSet::Rig => rig.views.clone(),
            BoardSet::Air => vec![View {
                name: "air".to_owned(),
                path: Vec::new(),
                optics: OpticalPath { lens: rig.camera.lens, surfaces: Vec::new() },
                region_px: Vec::new(),
            }],
        };
        let seen = |view: &View| view.optics.project_with_jacobian(&around).ok().map(|seen| seen.ray.direction);
        let sight: Vector3<f64> = views.iter().filter_map(seen).sum();
        let sight = sight.try_normalize(1e-6).unwrap_or_else(Vector3::z);
        let size_px = rig.camera.size_px.map(|n| n as usize);
        Self {
            size_px,
            views,
            board,
            reader: Reader::new(sensor),
            blur_px,
            set,
            around: (around, sight),
            rig: rig.clone(),
        }
    }

    /// So many poses of the board's middle, camera frame, the same for a seed.
    ///
    /// # Errors
    /// [`BoardsError::NoPlace`] when no pose is seen as a whole.
    pub fn poses(&self, count: usize, seed: u64) -> Result<Vec<Isometry3<f64>>, BoardsError> {
        let mut random = fastrand::Rng::with_seed(seed ^ 0x626f_6172);
        let mut poses = Vec::with_capacity(count);
        for k in 0..count {
            let found = (0..ATTEMPTS).find_map(|_| {
                let pose = self.pose(k, &mut random);
                self.views.iter().all(|view| self.shows(view, &pose)).then_some(pose)
            });
            poses.push(found.ok_or_else(|| BoardsError::NoPlace {
                views: self.views.iter().map(|view| format!("`{}`", view.name)).collect::<Vec<_>>().join(" and "),
                width_mm: self.board.columns.max(self.board.rows) as f64 * self.board.square_m * 1e3,
            })?);
        }
        Ok(poses)
    }

    fn pose(&self, k: usize, random: &mut fastrand::Rng) -> Isometry3<f64> {
        let mut uniform = |from: f64, to: f64| from + (to - from) * random.f64();
        let width_m = (self.board.columns + 1) as f64 * self.board.square_m;
        let tilt = if self.set == BoardSet::Air { TILT_DEG.0 } else { TILT_DEG.1 };
        // Tilts go round, so that few pictures have all of them.
        let round = k as f64 * 2.4 + uniform(-0.4, 0.4);
        let size = (tilt * uniform(0.55, 1.0)).to_radians();
        let turn = Rotation3::from_axis_angle(&Vector3::z_axis(), uniform(-10.0, 10.0_f64).to_radians())
            * Rotation3::from_euler_angles(size * round.sin(), size * round.cos(), 0.0);
        let (middle, facing) = match self.set {
            BoardSet::Air => {
                let lens = &self.rig.camera.lens;
                let distance_m = lens.focal_px.x * width_m / (uniform(FILLS.0, FILLS.1) * self.size_px[0] as f64);
                let pixel = Point2::new(
                    uniform(0.15, 0.85) * self.size_px[0] as f64,
                    uniform(0.15, 0.85) * self.size_px[1] as f64,
                );
                let at = lens.undistort(&pixel).unwrap_or_else(Point2::origin);
                (Point3::new(at.x, at.y, 1.0) * distance_m, Vector3::z())
            }
            BoardSet::Rig => {
                let mut aside = || uniform(-ASIDE, ASIDE) * width_m;
                (self.around.0 + Vector3::new(aside(), aside(), aside()), self.around.1)
            }
        };
        // The board's z points away from who looks at its front, its y down.
        let down = if self.set == BoardSet::Air {
            Vector3::y()
        } else {
            self.rig.base.as_ref().map_or_else(Vector3::y, |b| b.base_from_camera.rotation.inverse() * Vector3::z())
        };
        let across = down.cross(&facing).try_normalize(1e-6).unwrap_or_else(Vector3::x);
        let basis = Rotation3::from_basis_unchecked(&[across, facing.cross(&across), facing]);
        let turn = UnitQuaternion::from_rotation_matrix(&(basis * turn));
        Isometry3::from_parts(Translation3::from(middle.coords), turn)
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
    fn shows(&self, view: &View, pose: &Isometry3<f64>) -> bool {
        let (columns, rows) = (self.board.columns as f64, self.board.rows as f64);
        let at = |column: f64, row: f64| self.place(&view.optics, pose, column, row);
        let rim = [(-2.0, -2.0), (columns + 1.0, -2.0), (columns + 1.0, rows + 1.0), (-2.0, rows + 1.0)];
        let rim = rim.map(|(column, row)| at(column, row));
        let whole = rim.iter().flatten().filter(|p| in_picture(&self.rig, p) && view.contains(p)).count() == rim.len();
        let [Some(a), Some(b), _, Some(d)] = rim else { return false };
        whole && ((b - a).perp(&(d - a)) > 0.0) != is_flipped(&view.optics)
    }

    /// The picture, grey values row by row; `seed` is that of its noise.
    pub fn picture(&self, pose: &Isometry3<f64>, seed: u64) -> Vec<u8> {
        let [width, height] = self.size_px;
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
        let colours = self.reader.read(self.size_px, seed, |y, to| {
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
        let bound = |of: fn(&Point2<f64>) -> f64, most: usize| {
            let low = ends.iter().map(of).fold(f64::INFINITY, f64::min) - 4.0 * self.blur_px;
            let high = ends.iter().map(of).fold(f64::NEG_INFINITY, f64::max) + 4.0 * self.blur_px;
            low.floor().clamp(0.0, most as f64) as usize..(high.ceil() + 1.0).clamp(0.0, most as f64) as usize
        };
        let (xs, ys) = (bound(|p| p.x, self.size_px[0]), bound(|p| p.y, self.size_px[1]));
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
                let Some(sample) = light.get_mut(y * self.size_px[0] + x) else { continue };
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
