//! Pictures of chessboards in a rig, rendered by [`catoptra::simulate`], with their exact corners.

use catoptra::calibrate::board::Board;
use catoptra::calibrate::geometry::Geometry;
use catoptra::optics::Surface;
use catoptra::rig::{Draft, View};
use catoptra::simulate::{Boards, Sensor};
use nalgebra::{Isometry3, Point2, Rotation3, Translation3, UnitQuaternion, Vector3};
use std::path::{Path, PathBuf};

/// What stands still while the board moves.
#[derive(Clone)]
pub(crate) struct Scene {
    pub(crate) size_px: [u32; 2],
    pub(crate) geometry: Geometry,
    /// For each view the corners of its part of the picture, in turn; none: all of the picture.
    pub(crate) regions: Vec<Vec<[f64; 2]>>,
    pub(crate) board: Board,
    /// Standard deviation of the blur, lens and pixel together.
    pub(crate) blur_px: f64,
    pub(crate) sensor: Sensor,
}

/// A sensor with noise of about this standard deviation, grey values: that of light, which BT.709's curve makes nearly
/// the same for all grey values but the darkest.
pub(crate) fn noise(sd: f64) -> Sensor {
    Sensor { full_well_e: Some((133.0 / sd).powi(2)), ..Sensor::default() }
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
            blur_px: 0.67,
            sensor: noise(2.0),
        }
    }

    /// The same camera with nothing before it.
    pub(crate) fn in_air(&self) -> Self {
        let geometry =
            Geometry { surfaces: Vec::new(), views: vec![("air".to_owned(), Vec::new())], ..self.geometry.clone() };
        Self { geometry, regions: vec![Vec::new()], ..self.clone() }
    }

    fn boards(&self) -> Boards {
        let view = |(k, (name, _)): (usize, &(String, Vec<usize>))| View {
            name: name.clone(),
            path: Vec::new(),
            optics: self.geometry.path(k),
            region_px: self.regions[k].iter().map(|[x, y]| Point2::new(*x, *y)).collect(),
            blur_px: None,
        };
        let views = self.geometry.views.iter().enumerate().map(view).collect();
        Boards::new(self.size_px, views, self.board.clone(), self.blur_px, self.sensor)
    }

    /// Whether a view shows the front of all corners of the board.
    pub(crate) fn shows(&self, view: usize, pose: &Isometry3<f64>) -> bool {
        let Some(corners) = self.boards().corners(view, pose) else { return false };
        let (along, down) = (corners[1] - corners[0], corners[self.board.columns] - corners[0]);
        let is_mirror = |surface: &&usize| matches!(self.geometry.surfaces[**surface].1, Surface::Mirror(_));
        let mirrored = self.geometry.views[view].1.iter().filter(is_mirror).count() % 2 == 1;
        let region = &self.regions[view];
        (along.perp(&down) > 0.0) != mirrored && corners.iter().all(|c| region.is_empty() || inside(region, c.x, c.y))
    }

    /// The picture; `seed` is that of its noise.
    pub(crate) fn picture(&self, pose: &Isometry3<f64>, seed: u64) -> image::GrayImage {
        let bytes = self.boards().picture(pose, seed);
        image::GrayImage::from_raw(self.size_px[0], self.size_px[1], bytes).unwrap()
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

/// Whether a place is inside of a convex polygon.
fn inside(corners: &[[f64; 2]], x: f64, y: f64) -> bool {
    let sides = corners.iter().zip(corners.iter().cycle().skip(1));
    let turns: Vec<f64> = sides.map(|(a, b)| (b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0])).collect();
    turns.iter().all(|t| *t > 0.0) || turns.iter().all(|t| *t < 0.0)
}
