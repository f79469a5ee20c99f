//! The base frame of a rig file.

use super::super::file::BaseFile;
use super::super::numbers::rotation_of;
use super::super::{Base, RigError};
use super::{Check, FARTHEST_MM};
use crate::optics::UNIT_TOLERANCE;
use nalgebra::{Isometry3, Matrix3, Translation3, Vector3};

impl Check<'_> {
    pub(super) fn base(&self, raw: &BaseFile) -> Result<Base, RigError> {
        let key = "base.base_from_camera.rotation";
        let rows = raw.base_from_camera.rotation;
        self.finite(key, rows.as_flattened())?;
        let matrix = Matrix3::from_row_slice(rows.as_flattened());
        let off = (matrix * matrix.transpose() - Matrix3::identity()).amax();
        if off > 2.0 * UNIT_TOLERANCE {
            let expected = format!("a rotation: unit rows at right angles, they are off by {off:.2e}");
            return Err(self.value(key, format!("{rows:?}"), expected));
        }
        if matrix.determinant() < 0.0 {
            return Err(self.value(key, format!("{rows:?}"), "a right-handed rotation, its determinant is -1"));
        }
        self.within("base.base_from_camera.translation_mm", &raw.base_from_camera.translation_mm, FARTHEST_MM)?;
        let rotation = rotation_of(&matrix);
        let translation = Translation3::from(Vector3::from(raw.base_from_camera.translation_mm.map(|x| x / 1e3)));
        Ok(Base {
            base_from_camera: Isometry3::from_parts(translation, rotation),
            b0: self.unit("base.b0", raw.b0)?,
            gravity: raw.gravity.map(|g| self.unit("base.gravity", g)).transpose()?,
        })
    }
}
