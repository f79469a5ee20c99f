//! The shape at rest under a load.
//!
//! Unknown is the frame of the section at the tip: the one from which the rod, integrated back to the clamp (`rod.rs`),
//! arrives with the clamp's frame. Newton's method on the three components of the rotation that is left there. The load
//! is raised from nothing, weight first, then currents and forces, and the shape followed: what is found is the branch
//! that belongs to rest, not any solution.
//!
//! That rotation's derivative is the identity for a straight rod without load. It becomes singular where the shape
//! becomes unstable (a conjugate point of the rod reaches the clamp), and has a negative eigenvalue beyond: such a load
//! is refused.

use super::error::CatheterError;
use super::load::{Load, Stage, forces};
use super::model::Catheter;
use super::rod::Forces;
use super::shape::Shape;
use nalgebra::{Complex, Matrix3, UnitQuaternion, Vector3};

/// The rotation that may be left at the clamp, radians.
const TOLERANCE_RAD: f64 = 1e-11;
/// Step of central differences, radians: rounding and curvature both stay below 1e-9.
const STEP_RAD: f64 = 1e-5;
const MAX_STEPS: usize = 12;
/// Newton's steps longer than this leave the branch.
const LONGEST_RAD: f64 = 0.5;
/// The load is raised by this part at first, and by no less than this.
const LOAD_STEP: (f64, f64) = (0.25, 1e-4);

/// The shape of the catheter under `load`.
///
/// # Errors
/// [`CatheterError`] when a current is beyond the limit, or there is no stable shape that can be reached from rest.
pub fn equilibrium(catheter: &Catheter, load: &Load) -> Result<Shape, CatheterError> {
    load.within(catheter)?;
    let mut tip = catheter.unloaded_tip();
    for stage in [Stage::Weight, Stage::Load] {
        tip = raise(tip, |part, tip| solve(catheter, &forces(catheter, load, stage, part), tip))?;
    }
    Ok(Shape::new(catheter, load, tip))
}

/// The shape nearest to `from` under `load`: for a load that differs little.
pub(super) fn near(catheter: &Catheter, load: &Load, from: UnitQuaternion<f64>) -> Result<Shape, CatheterError> {
    let found = solve(catheter, &forces(catheter, load, Stage::Load, 1.0), from);
    let tip = found.map_err(|why| why.at(1.0))?;
    Ok(Shape::new(catheter, load, tip))
}

/// Why there is no solution near.
enum NewtonError {
    Unstable,
    NotConverged { residual_rad: f64 },
}

impl NewtonError {
    fn at(self, part: f64) -> CatheterError {
        let percent = part * 100.0;
        match self {
            Self::Unstable => CatheterError::Unstable { percent },
            Self::NotConverged { residual_rad } => CatheterError::NotConverged { percent, residual_rad },
        }
    }
}

/// Raises the load from nothing to all of it.
fn raise(
    start: UnitQuaternion<f64>,
    solve: impl Fn(f64, UnitQuaternion<f64>) -> Result<UnitQuaternion<f64>, NewtonError>,
) -> Result<UnitQuaternion<f64>, CatheterError> {
    let (mut tip, mut reached, mut by) = (start, 0.0, LOAD_STEP.0);
    // The last change of the frame, and by how much of the load: where it will go next.
    let mut trend: Option<(Vector3<f64>, f64)> = None;
    while reached < 1.0 {
        let next = f64::min(reached + by, 1.0);
        let expected =
            trend.map_or(tip, |(turn, over)| tip * UnitQuaternion::from_scaled_axis(turn * ((next - reached) / over)));
        match solve(next, expected) {
            Ok(found) => {
                trend = Some(((tip.inverse() * found).scaled_axis(), next - reached));
                (tip, reached) = (found, next);
                by *= 1.5;
            }
            Err(why) if by < LOAD_STEP.1 => return Err(why.at(next)),
            Err(_) => by /= 4.0,
        }
    }
    Ok(tip)
}

/// Newton's method from a frame near the right one.
fn solve(catheter: &Catheter, forces: &Forces, start: UnitQuaternion<f64>) -> Result<UnitQuaternion<f64>, NewtonError> {
    let left = |tip: &UnitQuaternion<f64>| {
        let sections = catheter.integrate(tip, forces, 1);
        sections.last().map_or_else(Vector3::zeros, |clamp| clamp.frame.scaled_axis())
    };
    let mut tip = start;
    let mut residual = left(&tip);
    for _ in 0..MAX_STEPS {
        let columns = [Vector3::x(), Vector3::y(), Vector3::z()].map(|axis| {
            let at = |by: f64| left(&(tip * UnitQuaternion::from_scaled_axis(axis * by)));
            (at(STEP_RAD) - at(-STEP_RAD)) / (2.0 * STEP_RAD)
        });
        let derivative = Matrix3::from_columns(&columns);
        if residual.norm() < TOLERANCE_RAD {
            return if is_stable(&derivative) { Ok(tip) } else { Err(NewtonError::Unstable) };
        }
        let Some(step) = derivative.lu().solve(&-residual).filter(|step| step.norm() < LONGEST_RAD) else { break };
        tip *= UnitQuaternion::from_scaled_axis(step);
        residual = left(&tip);
    }
    Err(NewtonError::NotConverged { residual_rad: residual.norm() })
}

/// Whether no eigenvalue is real and negative. Two that are equal may come out as a pair that is hardly complex.
fn is_stable(derivative: &Matrix3<f64>) -> bool {
    let negative = |value: &Complex<f64>| value.re <= 0.0 && value.im.abs() < 1e-3 * value.re.abs();
    !derivative.complex_eigenvalues().iter().any(negative)
}

impl Catheter {
    /// The frame of the tip without any load: the curvature at rest, carried along the flexible parts.
    fn unloaded_tip(&self) -> UnitQuaternion<f64> {
        let turn = self.tube.rest_curvature_per_m;
        UnitQuaternion::from_scaled_axis(turn * self.flexible_m) * UnitQuaternion::from_scaled_axis(turn * self.tail_m)
    }
}
