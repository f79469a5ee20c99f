//! What acts on the catheter, and how it is raised from nothing.

use super::error::CatheterError;
use super::model::Catheter;
use super::rod::Forces;
use nalgebra::Vector3;

/// What acts on the catheter beside its weight.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Load {
    /// Currents of the coils x, y, z, amperes.
    pub currents_a: Vector3<f64>,
    /// Force at the tip, N, base frame.
    pub tip_n: Vector3<f64>,
    /// Couple at the tip, N·m, base frame.
    pub tip_nm: Vector3<f64>,
}

impl Load {
    /// Currents of the coils x, y, z in amperes, and nothing at the tip.
    pub fn currents(currents_a: Vector3<f64>) -> Self {
        Self { currents_a, tip_n: Vector3::zeros(), tip_nm: Vector3::zeros() }
    }

    /// Refuses currents beyond the limit.
    pub(super) fn within(&self, catheter: &Catheter) -> Result<(), CatheterError> {
        for (coil, current_a) in ["x", "y", "z"].into_iter().zip(self.currents_a.iter()) {
            let limit_a = catheter.coils.limit_a;
            if current_a.is_nan() || current_a.abs() > limit_a * (1.0 + 1e-9) {
                return Err(CatheterError::Current { coil, current_ma: current_a * 1e3, limit_ma: limit_a * 1e3 });
            }
        }
        Ok(())
    }
}

/// What is raised: first the weight, then all else.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Stage {
    Weight,
    Load,
}

/// What acts while the load is raised.
pub(super) fn forces(catheter: &Catheter, load: &Load, stage: Stage, part: f64) -> Forces {
    let (weight, part) = if stage == Stage::Weight { (part, 0.0) } else { (1.0, part) };
    Forces {
        tip_n: load.tip_n * part,
        tip_nm: load.tip_nm * part,
        moment_am2: catheter.coils.moment_per_ampere_m2 * load.currents_a * part,
        field_t: catheter.surroundings.b0_t,
        weight,
    }
}

/// All that acts under the whole load.
pub(super) fn all_forces(catheter: &Catheter, load: &Load) -> Forces {
    forces(catheter, load, Stage::Load, 1.0)
}
