//! The catheter's shape, and how it follows the currents.

use super::equilibrium::{Load, all_forces, near};
use super::error::CatheterError;
use super::model::Catheter;
use super::rod::Section;
use nalgebra::{Matrix3, Point3, UnitQuaternion, Vector3};

/// Step of the differences by a current, as part of the limit: errors of the square of it.
const STEP: f64 = 1e-4;

/// A shape at rest.
#[derive(Debug, Clone)]
pub struct Shape {
    /// The centre line from the clamp to the tip, every millimetre or closer: distance along it and place, metres.
    pub centre_line: Vec<(f64, Point3<f64>)>,
    /// Middle of the coil set.
    pub coil: Point3<f64>,
    /// Direction of the tube at the coil set, towards the tip; length 1.
    pub tangent: Vector3<f64>,
    /// End of the tube.
    pub tip: Point3<f64>,
    /// Moment at the clamp, N·m.
    pub clamp_nm: Vector3<f64>,
    load: Load,
    tip_frame: UnitQuaternion<f64>,
}

/// Derivatives by the currents of coils x, y, z: columns.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sensitivity {
    /// Of the tip, metres per ampere.
    pub tip_m_a: Matrix3<f64>,
    /// Of the tangent, 1 per ampere.
    pub tangent_a: Matrix3<f64>,
}

impl Shape {
    pub(super) fn new(catheter: &Catheter, load: &Load, tip_frame: UnitQuaternion<f64>) -> Self {
        let mut sections = catheter.integrate(&tip_frame, &all_forces(catheter, load), 1);
        sections.reverse();
        let coil_m = catheter.flexible_m + catheter.coil_m / 2.0;
        let from_coil = |section: &&Section| (section.arc_m - coil_m).abs();
        let coil = sections.iter().min_by(|a, b| from_coil(a).total_cmp(&from_coil(b)));
        Self {
            coil: coil.map_or_else(Point3::origin, |coil| coil.point),
            tangent: coil.map_or_else(Vector3::z, |coil| coil.frame * Vector3::z()),
            tip: sections.last().map_or_else(Point3::origin, |tip| tip.point),
            clamp_nm: sections.first().map_or_else(Vector3::zeros, |clamp| clamp.moment_nm),
            centre_line: sections.iter().map(|section| (section.arc_m, section.point)).collect(),
            load: *load,
            tip_frame,
        }
    }

    /// θ, radians.
    pub fn theta_rad(&self) -> f64 {
        self.tangent.x.atan2(self.tangent.z)
    }

    /// Angle between the tangent and z, radians.
    pub fn polar_rad(&self) -> f64 {
        self.tangent.z.clamp(-1.0, 1.0).acos()
    }

    /// The shape under a load that differs little from this one's.
    ///
    /// # Errors
    /// [`CatheterError`] when it differs too much, or has no stable shape.
    pub fn moved_to(&self, catheter: &Catheter, load: &Load) -> Result<Self, CatheterError> {
        near(catheter, load, self.tip_frame)
    }

    /// How tip and tangent follow the currents. (A moment along B0 has no couple: one direction of currents moves nothing.)
    ///
    /// # Errors
    /// [`CatheterError`] at the edge of stability.
    pub fn sensitivity(&self, catheter: &Catheter) -> Result<Sensitivity, CatheterError> {
        let step_a = STEP * catheter.coils.limit_a;
        let mut columns = [(Vector3::zeros(), Vector3::zeros()); 3];
        for (coil, column) in columns.iter_mut().enumerate() {
            let at = |by: f64| {
                let mut load = self.load;
                load.currents_a[coil] += by;
                self.moved_to(catheter, &load)
            };
            let (above, below) = (at(step_a)?, at(-step_a)?);
            *column = ((above.tip - below.tip) / (2.0 * step_a), (above.tangent - below.tangent) / (2.0 * step_a));
        }
        Ok(Sensitivity {
            tip_m_a: Matrix3::from_columns(&columns.map(|c| c.0)),
            tangent_a: Matrix3::from_columns(&columns.map(|c| c.1)),
        })
    }
}

impl Sensitivity {
    /// Smallest by largest singular value of ∂tip/∂currents: 0 where the tip moves on a surface.
    pub fn thickness(&self) -> f64 {
        let values = self.tip_m_a.svd(false, false).singular_values;
        if values.max() > 0.0 { values.min() / values.max() } else { 0.0 }
    }
}

#[cfg(test)]
mod tests;
