//! Boards taped flat to a wall: pictures that fix the wall's position.

use super::error::{RigCalibrationError, surface};
use super::initial::ordered;
use super::options::TapedBoard;
use crate::calibrate::board::Board;
use crate::calibrate::bundle::pose::{TargetShape, seen_pose};
use crate::calibrate::bundle::prior::Prior;
use crate::calibrate::bundle::{Bundle, Corner};
use crate::calibrate::geometry::Geometry;
use crate::optics::{Lens, Plane, Surface};
use nalgebra::{Isometry3, Point2, Point3, Translation3, Unit, UnitQuaternion, Vector3};
use std::f64::consts::PI;

/// σ of a taped board's distance from its wall, metres, beside its thickness.
const TAPED_SD_M: f64 = 2e-4;

/// A board taped to a wall, as an additional picture.
pub(crate) struct Taped {
    name: String,
    surface: usize,
    path: Vec<usize>,
    pose: Isometry3<f64>,
    corners: Vec<(Point3<f64>, Point2<f64>)>,
    half_m: f64,
    thickness_m: f64,
}

impl Taped {
    /// The board is seen along the path to the wall: via the surfaces before it in the first view through it.
    pub(crate) fn new(
        board: &Board,
        lens: &Lens,
        geometry: &Geometry,
        TapedBoard { wall, picture, thickness_m }: &TapedBoard,
    ) -> Result<Self, RigCalibrationError> {
        let surface = surface(geometry, wall)?;
        let path: Vec<usize> = geometry
            .views
            .iter()
            .find_map(|(_, path)| Some(path[..path.iter().position(|s| *s == surface)?].to_vec()))
            .unwrap_or_default();
        let mirrors: Vec<Plane> = path
            .iter()
            .filter_map(|s| match geometry.surfaces[*s].1 {
                Surface::Mirror(mirror) => Some(mirror.plane),
                Surface::Wall(_) => None,
            })
            .collect();
        let places = board.centred_points();
        let odd = mirrors.len() % 2 == 1;
        if picture.image.mirrored.is_some_and(|mirrored| mirrored != odd) {
            return Err(RigCalibrationError::Taped {
                name: picture.name.clone(),
                wall: wall.to_owned(),
                mirrored: odd,
            });
        }
        let order = if odd { board.orders().into_iter().next() } else { None };
        let corners = ordered(&places, &picture.image, order.as_deref());
        let seen = seen_pose(lens, &corners, TargetShape::Flat)?;
        let mut seen = seen.ok_or_else(|| RigCalibrationError::NoTapedPose { name: picture.name.clone() })?;
        // The board itself, not its reflection. I − 2nnᵀ is minus half a turn about n, and the factor that turns a flat
        // board's mirror image into a rotation, diag(1, 1, −1), is minus half a turn about z.
        for plane in &mirrors {
            let over = UnitQuaternion::from_axis_angle(&Unit::new_normalize(plane.normal()), PI);
            let half_turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), PI);
            let middle = plane.reflect(&Point3::from(seen.translation.vector));
            seen = Isometry3::from_parts(Translation3::from(middle.coords), over * seen.rotation * half_turn);
        }
        let half_m = places.iter().map(|p| p.coords.norm()).fold(0.0, f64::max);
        Ok(Self { name: picture.name.clone(), surface, path, pose: seen, corners, half_m, thickness_m: *thickness_m })
    }

    pub(crate) fn add(self, to: &mut Bundle) {
        let (picture, view) = (to.poses.len(), to.geometry.views.len());
        to.geometry.views.push(("taped".to_owned(), self.path));
        to.poses.push(self.pose);
        to.names.push(self.name);
        to.corners.extend(self.corners.into_iter().map(|(place, pixel)| Corner {
            picture,
            view,
            place,
            pixel,
            relative_sd: 1.0,
        }));
        let Self { surface, half_m, thickness_m, .. } = self;
        to.known.push(Prior::Taped { picture, surface, thickness_m, sd_m: TAPED_SD_M, half_m });
    }
}
