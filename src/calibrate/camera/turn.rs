//! [`Turn`]: what flipping a picture, or turning it by 180°, does to its corners and its lens.

use crate::calibrate::board::Board;
use crate::calibrate::bundle::{Corner, Solution};
use crate::calibrate::geometry::{Geometry, Parameter};
use crate::optics::Lens;
use crate::whitening::chi_square;
use nalgebra::{DVector, Isometry3, Matrix3, Point2, Rotation3, Translation3, UnitQuaternion, Vector3};
use std::fmt;

/// How pictures differ from those that the camera took.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Turn {
    /// Left and right are exchanged.
    LeftRight,
    /// Top and bottom are exchanged.
    TopBottom,
    /// Turned by 180°: both.
    Half,
}

impl fmt::Display for Turn {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::LeftRight => "flipped left to right",
            Self::TopBottom => "flipped upside down",
            Self::Half => "turned by 180°",
        })
    }
}

impl Turn {
    pub(super) const ALL: [Self; 3] = [Self::LeftRight, Self::TopBottom, Self::Half];

    /// The axes of the picture that run backwards.
    pub(super) fn axes(self) -> &'static [usize] {
        match self {
            Self::LeftRight => &[0],
            Self::TopBottom => &[1],
            Self::Half => &[0, 1],
        }
    }

    /// Parameters of a lens that are others in a turned picture: the principal point; p2 along x, p1 along y.
    fn changes(self) -> Vec<Parameter> {
        self.axes().iter().flat_map(|axis| [Parameter::Principal(*axis), Parameter::Distortion(3 - axis)]).collect()
    }

    fn pixel(self, mut pixel: Point2<f64>, size_px: [u32; 2]) -> Point2<f64> {
        for axis in self.axes() {
            pixel[*axis] = f64::from(size_px[*axis]) - 1.0 - pixel[*axis];
        }
        pixel
    }

    pub(super) fn lens(self, mut lens: Lens, size_px: [u32; 2]) -> Lens {
        lens.principal_point_px = self.pixel(lens.principal_point_px, size_px);
        for axis in self.axes() {
            lens.distortion[3 - axis] *= -1.0;
        }
        lens
    }

    /// How far a lens is from one that is the same turned: χ² per degree of freedom.
    pub(super) fn apart(self, found: &Solution, size_px: [u32; 2]) -> Option<f64> {
        let turned = Geometry { lens: self.lens(found.geometry.lens, size_px), ..found.geometry.clone() };
        let changes = self.changes();
        let at = |parameter: &Parameter| found.free.iter().position(|free| free == parameter);
        let at = changes.iter().map(at).collect::<Option<Vec<usize>>>()?;
        // Half of the distance: the turned lens is as far on the other side.
        let off = changes.iter().map(|parameter| (found.geometry.value(*parameter) - turned.value(*parameter)) / 2.0);
        let covariance = found.covariance.select_rows(&at).select_columns(&at);
        Some(chi_square(&DVector::from_iterator(at.len(), off), covariance)? / at.len() as f64)
    }

    /// All pictures turned. `None` where the board would not have been found: one with markers in flipped pictures.
    pub(super) fn pictures(self, (solved, corners): &Pictures, board: &Board, size_px: [u32; 2]) -> Option<Pictures> {
        let signs = Vector3::from_fn(|axis, _| if self.axes().contains(&axis) { -1.0 } else { 1.0 });
        let of_camera = Matrix3::from_diagonal(&signs);
        let of_board = if self == Self::Half { Matrix3::identity() } else { mirrored(board)? };
        let corner = |corner: &Corner| {
            let (place, pixel) = (of_board * corner.place, self.pixel(corner.pixel, size_px));
            Corner { place, pixel, ..*corner }
        };
        let pose = |pose: &Isometry3<f64>| {
            let turn = of_camera * pose.rotation.to_rotation_matrix().into_inner() * of_board;
            let turn = UnitQuaternion::from(Rotation3::from_matrix_unchecked(turn));
            Isometry3::from_parts(Translation3::from(of_camera * pose.translation.vector), turn)
        };
        let poses = solved.poses.iter().map(pose).collect();
        Some((Solution { poses, ..solved.clone() }, corners.iter().map(corner).collect()))
    }
}

/// From the corners of a board to those that are found in their place in a flipped picture.
fn mirrored(board: &Board) -> Option<Matrix3<f64>> {
    let places = board.centred_points();
    let found = *board.orders().first()?.first()?;
    let (own, found) = (places.first()?, places.get(found)?);
    let signs = own.coords.zip_map(&found.coords, |own, found| if own * found < 0.0 { -1.0 } else { 1.0 });
    (signs.product() < 0.0).then(|| Matrix3::from_diagonal(&signs))
}

/// A solution with the pictures' poses, and their corners.
pub(super) type Pictures = (Solution, Vec<Corner>);
