//! How the shape follows the currents.

use super::equilibrium::near;
use super::error::CatheterError;
use super::load::Load;
use super::model::Catheter;
use super::shape::Shape;
use nalgebra::{Matrix3, Vector3};

/// Step of the differences by a current, as part of the limit: errors of the square of it.
const STEP: f64 = 1e-4;

/// Derivatives by the currents of coils x, y, z: columns.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sensitivity {
    /// Derivatives of the tip, metres per ampere.
    pub tip_m_a: Matrix3<f64>,
    /// Derivatives of the tangent, 1 per ampere.
    pub tangent_a: Matrix3<f64>,
}

impl Shape {
    /// The shape under a load that differs little from this one's.
    ///
    /// # Errors
    /// [`CatheterError`] when it differs too much, or has no stable shape.
    pub fn moved_to(&self, catheter: &Catheter, load: &Load) -> Result<Self, CatheterError> {
        near(catheter, load, self.tip_frame)
    }

    /// How tip and tangent follow the currents. (A moment along B0 has no couple: one direction of currents moves
    /// nothing.)
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
