//! A Kirchhoff rod that neither stretches nor shears, integrated from its free end to the clamp.
//!
//! With r the centre line, R the section's frame, u its curvature and twist in that frame, m and n what the part beyond
//! s exerts on the part before it (moment, force; base frame), f the weight per length:
//!
//! ```text
//! r' = R e₃,   R' = R û,   u = u₀ + K⁻¹ Rᵀ m,   m' = −r' × n,   n' = −f,   K = diag(EI, EI, GJ)
//! ```
//!
//! At the free end m and n are given, so that n is known everywhere and the frame there is all that has to be found
//! (`equilibrium.rs`). The coil set is stiff (u = u₀ is taken as 0 there); its couple acts on its middle, which is the
//! same as anywhere else on it. Fourth-order Runge-Kutta, whose step is [`STEP_M`] or a little less.

use super::model::Catheter;
use nalgebra::{Point3, Quaternion, UnitQuaternion, Vector3};

/// Longest step along the rod, metres. Halving it moves the tip by less than a nanometre (a test).
const STEP_M: f64 = 1e-3;

/// What acts on a rod beside its own weight; base frame.
#[derive(Debug, Clone, Copy)]
pub(super) struct Forces {
    /// Force at the tip, N.
    pub tip_n: Vector3<f64>,
    /// Couple at the tip, N·m.
    pub tip_nm: Vector3<f64>,
    /// Magnetic moment of the coils in the section's frame, A·m².
    pub moment_am2: Vector3<f64>,
    /// Field, tesla.
    pub field_t: Vector3<f64>,
    /// What part of the weight acts.
    pub weight: f64,
}

/// A cross-section.
#[derive(Debug, Clone, Copy)]
pub(super) struct Section {
    /// From the clamp along the rod, metres.
    pub arc_m: f64,
    pub point: Point3<f64>,
    pub frame: UnitQuaternion<f64>,
    /// What the part beyond exerts, N·m, base frame.
    pub moment_nm: Vector3<f64>,
}

/// A piece of rod of one stiffness.
struct Part {
    length_m: f64,
    /// 1/EI, 1/EI, 1/GJ; nothing where it is stiff.
    compliance: Option<Vector3<f64>>,
    rest_curvature: Vector3<f64>,
    weight_n_m: Vector3<f64>,
}

/// Where the integration is.
#[derive(Clone, Copy)]
struct At {
    point: Vector3<f64>,
    /// Of length one up to the integrator's error.
    frame: Quaternion<f64>,
    moment: Vector3<f64>,
}

impl At {
    fn stepped(&self, by: f64, slope: &Self) -> Self {
        Self {
            point: self.point + slope.point * by,
            frame: self.frame + slope.frame * by,
            moment: self.moment + slope.moment * by,
        }
    }
}

impl Part {
    /// Derivatives along the rod where the force is `force`.
    fn slope(&self, at: &At, force: &Vector3<f64>) -> At {
        let frame = UnitQuaternion::new_normalize(at.frame);
        let along = frame * Vector3::z();
        let curvature = match &self.compliance {
            Some(compliance) => {
                self.rest_curvature + compliance.component_mul(&frame.inverse_transform_vector(&at.moment))
            }
            None => Vector3::zeros(),
        };
        At { point: along, frame: at.frame * Quaternion::from_imag(curvature) * 0.5, moment: -along.cross(force) }
    }
}

impl Catheter {
    /// The rod from the tip to the clamp when the section at the tip has this frame: the sections between, tip first,
    /// the last one at the clamp. The clamp is then at the origin, but only for the right frame is its own the
    /// identity.
    pub(super) fn integrate(&self, tip: &UnitQuaternion<f64>, forces: &Forces, finer: usize) -> Vec<Section> {
        let weight = self.tube_weight_n_m() * forces.weight;
        let compliance =
            Vector3::new(1.0 / self.tube.bending_nm2(), 1.0 / self.tube.bending_nm2(), 1.0 / self.tube.torsion_nm2());
        let flexible = |length_m: f64| Part {
            length_m,
            compliance: Some(compliance),
            rest_curvature: self.tube.rest_curvature_per_m,
            weight_n_m: weight,
        };
        let half_coil = || Part {
            length_m: self.coil_m / 2.0,
            compliance: None,
            rest_curvature: Vector3::zeros(),
            weight_n_m: weight + self.coil_weight_n() * (forces.weight / self.coil_m),
        };
        let parts = [flexible(self.tail_m), half_coil(), half_coil(), flexible(self.flexible_m)];
        let mut at = At { point: Vector3::zeros(), frame: *tip.quaternion(), moment: forces.tip_nm };
        let (mut arc_m, mut force) = (self.length_m(), forces.tip_n);
        let section = |arc_m: f64, at: &At| Section {
            arc_m,
            point: at.point.into(),
            frame: UnitQuaternion::new_normalize(at.frame),
            moment_nm: at.moment,
        };
        let mut sections = vec![section(arc_m, &at)];
        for (index, part) in parts.iter().enumerate() {
            let steps = (part.length_m / STEP_M).ceil().max(1.0) as usize * finer;
            let step = part.length_m / steps as f64;
            for _ in 0..steps {
                let forces_n = [0.0, 0.5, 1.0].map(|part_of| force + part.weight_n_m * (part_of * step));
                let a = part.slope(&at, &forces_n[0]);
                let b = part.slope(&at.stepped(-step / 2.0, &a), &forces_n[1]);
                let c = part.slope(&at.stepped(-step / 2.0, &b), &forces_n[1]);
                let d = part.slope(&at.stepped(-step, &c), &forces_n[2]);
                at = [(1.0, a), (2.0, b), (2.0, c), (1.0, d)]
                    .iter()
                    .fold(at, |at, (weight, slope)| at.stepped(-step * weight / 6.0, slope));
                at.frame = at.frame.normalize();
                force = forces_n[2];
                arc_m -= step;
                sections.push(section(arc_m, &at));
            }
            // Between the halves of the coil set: Eq. 1, in the base frame.
            if index == 1 {
                let frame = UnitQuaternion::new_normalize(at.frame);
                at.moment += (frame * forces.moment_am2).cross(&forces.field_t);
            }
        }
        let clamp = at.point;
        for section in &mut sections {
            section.point -= clamp;
        }
        sections
    }
}
