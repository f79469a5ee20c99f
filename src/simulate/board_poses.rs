//! Where boards stand for `calibrate camera` and `calibrate rig`: in air without mirrors, and where the catheter is,
//! turned so that all views see the front, tilted to all sides.

use super::boards::Boards;
use super::sensor::Sensor;
use crate::calibrate::board::{Board, BoardError};
use crate::optics::OpticalPath;
use crate::rig::{Rig, View};
use nalgebra::{Isometry3, Point2, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};

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

/// Where boards stand in a rig, or before its bare camera.
pub struct BoardPoses {
    set: BoardSet,
    rig: Rig,
    /// Where boards in the rig stand, and from where all views look at them, camera frame.
    middle: Point3<f64>,
    sight: Vector3<f64>,
}

impl BoardPoses {
    /// For a rig; `middle` is where the catheter is, camera frame.
    pub fn new(rig: &Rig, set: BoardSet, middle: Point3<f64>) -> Self {
        let seen = |view: &View| view.optics.project_with_jacobian(&middle).ok().map(|seen| seen.ray.direction);
        let sight: Vector3<f64> = rig.views.iter().filter_map(seen).sum();
        let sight = sight.try_normalize(1e-6).unwrap_or_else(Vector3::z);
        Self { set, rig: rig.clone(), middle, sight }
    }

    /// Boards as the views show them that this set is for.
    pub fn boards(&self, board: Board, blur_px: f64, sensor: Sensor) -> Boards {
        let views = match self.set {
            BoardSet::Rig => self.rig.views.clone(),
            BoardSet::Air => vec![View {
                name: "air".to_owned(),
                path: Vec::new(),
                optics: OpticalPath { lens: self.rig.camera.lens, surfaces: Vec::new() },
                region_px: Vec::new(),
                blur_px: None,
            }],
        };
        Boards::new(self.rig.camera.size_px, views, board, blur_px, sensor)
    }

    /// So many poses of the boards' middle, camera frame, the same for a seed.
    ///
    /// # Errors
    /// [`BoardsError::NoPlace`] when no pose is seen as a whole.
    pub fn poses(&self, boards: &Boards, count: usize, seed: u64) -> Result<Vec<Isometry3<f64>>, BoardsError> {
        let mut random = fastrand::Rng::with_seed(seed ^ 0x626f_6172);
        let mut poses = Vec::with_capacity(count);
        for k in 0..count {
            let found = (0..ATTEMPTS).find_map(|_| {
                let pose = self.pose(boards, k, &mut random);
                boards.views().iter().all(|view| boards.shows(view, &pose)).then_some(pose)
            });
            poses.push(found.ok_or_else(|| BoardsError::NoPlace {
                views: boards.views().iter().map(|view| format!("`{}`", view.name)).collect::<Vec<_>>().join(" and "),
                width_mm: boards.board().columns.max(boards.board().rows) as f64 * boards.board().square_m * 1e3,
            })?);
        }
        Ok(poses)
    }

    fn pose(&self, boards: &Boards, k: usize, random: &mut fastrand::Rng) -> Isometry3<f64> {
        let mut uniform = |from: f64, to: f64| from + (to - from) * random.f64();
        let board = boards.board();
        let width_m = (board.columns + 1) as f64 * board.square_m;
        let tilt = if self.set == BoardSet::Air { TILT_DEG.0 } else { TILT_DEG.1 };
        // Tilts go round, so that few pictures have all of them.
        let round = k as f64 * 2.4 + uniform(-0.4, 0.4);
        let size = (tilt * uniform(0.55, 1.0)).to_radians();
        let turn = Rotation3::from_axis_angle(&Vector3::z_axis(), uniform(-10.0, 10.0_f64).to_radians())
            * Rotation3::from_euler_angles(size * round.sin(), size * round.cos(), 0.0);
        let (middle, facing) = match self.set {
            BoardSet::Air => {
                let lens = &self.rig.camera.lens;
                let [width_px, height_px] = self.rig.camera.size_px.map(f64::from);
                let distance_m = lens.focal_px.x * width_m / (uniform(FILLS.0, FILLS.1) * width_px);
                let pixel = Point2::new(uniform(0.15, 0.85) * width_px, uniform(0.15, 0.85) * height_px);
                let at = lens.undistort(&pixel).unwrap_or_else(Point2::origin);
                (Point3::new(at.x, at.y, 1.0) * distance_m, Vector3::z())
            }
            BoardSet::Rig => {
                let mut aside = || uniform(-ASIDE, ASIDE) * width_m;
                (self.middle + Vector3::new(aside(), aside(), aside()), self.sight)
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
}
