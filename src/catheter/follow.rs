//! Currents that lead the tip along a path, as well as one coil set can.
//!
//! For each point of the path the currents i in the box |i| ≤ limit are sought for which
//!
//! ```text
//! |W (tip(i) − target)|² + |λ i|²
//! ```
//!
//! is least. W weighs the axes: for a drawing in the x-y plane the way along z is free, so that it is projected along z
//! on what the tip reaches; for a path in space all three count, and the nearest point that is reached is found. The
//! tip moves on a surface only, so that one direction of currents is left open: λ, small, takes the smallest currents
//! that do it. Damped Gauss-Newton from the point before; a current that meets its limit stays there while it is pushed
//! beyond.
//!
//! Source of the method: Liu et al., "Iterative Jacobian-based inverse kinematics and open-loop control of an
//! MRI-guided magnetically actuated steerable catheter system" (2017), doi:10.1109/TMECH.2017.2704526.

use super::equilibrium::equilibrium;
use super::error::CatheterError;
use super::load::Load;
use super::model::Catheter;
use super::shape::Shape;
use nalgebra::{Matrix3, Point3, Vector3};

/// Length of tip motion that full current is worth: what λ costs the tip is below a micrometre.
const CURRENT_WEIGHT_M: f64 = 1e-5;
/// A step of the currents below this part of the limit ends the search.
const STEP_TOLERANCE: f64 = 1e-6;
const MAX_STEPS: usize = 60;
/// The tip is there: λ alone leaves less.
const REACHED_TOLERANCE_M: f64 = 1e-6;
/// Steps longer than this part of the limit are shortened: the shape is followed, not jumped.
const MAX_STEP: f64 = 0.25;

/// Where the tip should be.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Target {
    /// At this x and y, metres, wherever along z that is.
    Across([f64; 2]),
    /// As near to this point as it can get, metres.
    Space(Point3<f64>),
}

/// What the tip does for a target.
#[derive(Debug, Clone)]
pub struct Followed {
    /// Currents of the coils x, y, z, amperes.
    pub currents_a: Vector3<f64>,
    /// The shape for these currents.
    pub shape: Shape,
    /// Distance of the tip from the target, metres; what lies along z does not count where z is free.
    pub off_m: f64,
    /// Whether a current is at its limit.
    pub at_limit: bool,
}

/// Finds the currents for each target, one after the other.
///
/// # Errors
/// [`CatheterError`] when there is no target, one is not finite, or no shape is found on the way.
pub fn follow(catheter: &Catheter, targets: &[Target]) -> Result<Vec<Followed>, CatheterError> {
    follow_with_progress(catheter, targets, |_| ())
}

/// As [`follow`], which may take seconds for each point that is out of reach; `each` is told of every point.
///
/// # Errors
/// As [`follow`].
pub(crate) fn follow_with_progress(
    catheter: &Catheter,
    targets: &[Target],
    mut each: impl FnMut(&Followed),
) -> Result<Vec<Followed>, CatheterError> {
    let starts = starts(catheter)?;
    let mut followed: Vec<Followed> = Vec::with_capacity(targets.len());
    for (index, target) in targets.iter().enumerate() {
        let finite = match target {
            Target::Across(at) => at.iter().all(|v| v.is_finite()),
            Target::Space(at) => at.iter().all(|v| v.is_finite()),
        };
        if !finite {
            return Err(CatheterError::Path(format!("point {} of the path is not finite", index + 1)));
        }
        let before = followed.last().map(|last| (last.shape.clone(), last.currents_a));
        let mut best: Option<Followed> = None;
        for (shape, currents_a) in before.into_iter().chain(starts.iter().cloned()) {
            let found = toward(catheter, target, shape, currents_a);
            let reached = found.off_m < REACHED_TOLERANCE_M;
            if best.as_ref().is_none_or(|best| found.off_m < best.off_m) {
                best = Some(found);
            }
            if reached {
                break;
            }
        }
        best.iter().for_each(&mut each);
        followed.extend(best);
    }
    if followed.is_empty() {
        return Err(CatheterError::Path("the path has no point".to_owned()));
    }
    Ok(followed)
}

/// Where a search starts when it does not arrive from the point before: out of reach the nearest point may be
/// elsewhere.
fn starts(catheter: &Catheter) -> Result<Vec<(Shape, Vector3<f64>)>, CatheterError> {
    let part = |part: f64| Vector3::z() * (part * catheter.coils.limit_a);
    let start = |currents_a: Vector3<f64>| Ok((equilibrium(catheter, &Load::currents(currents_a))?, currents_a));
    [0.0, 0.3, -0.3].map(part).into_iter().map(start).collect()
}

impl Target {
    /// Weighted way from the tip to the target.
    fn off(&self, tip: &Point3<f64>) -> Vector3<f64> {
        match self {
            Self::Across([x, y]) => Vector3::new(x - tip.x, y - tip.y, 0.0),
            Self::Space(point) => point - tip,
        }
    }

    fn weights(&self) -> Matrix3<f64> {
        match self {
            Self::Across(_) => Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, 0.0)),
            Self::Space(_) => Matrix3::identity(),
        }
    }
}

fn toward(catheter: &Catheter, target: &Target, mut shape: Shape, mut currents_a: Vector3<f64>) -> Followed {
    let limit_a = catheter.coils.limit_a;
    let lambda = CURRENT_WEIGHT_M / limit_a;
    let cost = |shape: &Shape, currents_a: &Vector3<f64>| {
        target.off(&shape.tip).norm_squared() + (currents_a * lambda).norm_squared()
    };
    // Of Levenberg, in units of the currents' own weight.
    let mut damping = 1.0;
    for _ in 0..MAX_STEPS {
        // At the edge of stability there is none, and no way on.
        let Ok(sensitivity) = shape.sensitivity(catheter) else { break };
        let by_currents = target.weights() * sensitivity.tip_m_a;
        let off = target.off(&shape.tip);
        let step = loop {
            let mut step = step_in_box(&by_currents, &off, &currents_a, lambda, damping, limit_a);
            let longest = step.amax() / (MAX_STEP * limit_a);
            if longest > 1.0 {
                step /= longest;
            }
            let next = (currents_a + step).map(|i| i.clamp(-limit_a, limit_a));
            if step.amax() < STEP_TOLERANCE * limit_a {
                break None;
            }
            match shape.moved_to(catheter, &Load::currents(next)) {
                Ok(there) if cost(&there, &next) < cost(&shape, &currents_a) => break Some((there, next)),
                _ => damping *= 10.0,
            }
        };
        let Some((there, next)) = step else { break };
        (shape, currents_a) = (there, next);
        damping = f64::max(damping * 0.1, 1e-3);
    }
    Followed {
        off_m: target.off(&shape.tip).norm(),
        at_limit: currents_a.amax() > limit_a * (1.0 - 1e-6),
        currents_a,
        shape,
    }
}

/// The damped step, with currents held that it would push beyond their limit.
fn step_in_box(
    by_currents: &Matrix3<f64>,
    off: &Vector3<f64>,
    currents_a: &Vector3<f64>,
    lambda: f64,
    damping: f64,
    limit_a: f64,
) -> Vector3<f64> {
    let gradient = by_currents.transpose() * off - currents_a * lambda.powi(2);
    let mut free = Vector3::repeat(true);
    loop {
        let mut matrix = by_currents.transpose() * by_currents;
        let mut right = gradient;
        for i in 0..3 {
            matrix[(i, i)] += lambda.powi(2) * (1.0 + damping);
            if !free[i] {
                right[i] = 0.0;
                matrix.row_mut(i).fill(0.0);
                matrix.column_mut(i).fill(0.0);
                matrix[(i, i)] = 1.0;
            }
        }
        let step = matrix.cholesky().map_or_else(Vector3::zeros, |matrix| matrix.solve(&right));
        let held = |i: usize| free[i] && currents_a[i].abs() >= limit_a * (1.0 - 1e-9) && step[i] * currents_a[i] > 0.0;
        match (0..3).find(|i| held(*i)) {
            Some(i) => free[i] = false,
            None => return step,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    /// Beside the axis: around it one coil set cannot go, its couples bend towards B0 only and twist.
    fn circle(radius_m: f64, points: usize) -> Vec<Target> {
        let at = |k: usize| (k as f64 / points as f64 * TAU).sin_cos();
        (0..points).map(|k| Target::Across([0.028 + radius_m * at(k).1, radius_m * at(k).0])).collect()
    }

    #[test]
    fn a_circle_within_reach_is_followed() {
        let catheter = Catheter::prototype();
        let followed = follow(&catheter, &circle(0.008, 24)).unwrap();
        for point in &followed {
            assert!(point.off_m < 1e-6 && !point.at_limit, "{} {}", point.off_m, point.currents_a);
        }
        // The other way: what these currents do is where the tip should be.
        let shape = equilibrium(&catheter, &Load::currents(followed[5].currents_a)).unwrap();
        assert!((shape.tip - followed[5].shape.tip).norm() < 1e-9);
        // The smallest currents are used: none along what moves nothing.
        let by = shape.sensitivity(&catheter).unwrap().tip_m_a.svd(false, true);
        let idle = by.v_t.unwrap().row(2).transpose();
        assert!(idle.dot(&followed[5].currents_a).abs() < 0.02 * followed[5].currents_a.norm());
    }

    #[test]
    fn out_of_reach_the_tip_stays_at_the_limit_and_the_distance_is_told() {
        let catheter = Catheter::prototype();
        let followed = follow(&catheter, &[Target::Across([0.03, 0.0]), Target::Across([0.2, 0.0])]).unwrap();
        assert!(followed[0].off_m < 1e-6);
        let far = &followed[1];
        assert!(far.off_m > 0.1, "{} {}", far.off_m, far.currents_a);
    }

    /// From the one side of the axis to the other there is no way within reach of the path.
    #[test]
    fn both_sides_of_a_circle_that_is_out_of_reach_are_met() {
        let catheter = Catheter::prototype();
        let around = circle(0.02, 8).into_iter().map(|target| match target {
            Target::Across([x, y]) => Target::Across([x - 0.028, y]),
            space => space,
        });
        let followed = follow(&catheter, &around.collect::<Vec<_>>()).unwrap();
        assert!(followed[0].off_m < 1e-6 && followed[4].off_m < 1e-6, "{} {}", followed[0].off_m, followed[4].off_m);
        assert!(followed.iter().all(|f| f.off_m < 0.018), "{:?}", followed.iter().map(|f| f.off_m).collect::<Vec<_>>());
    }

    #[test]
    fn a_path_in_space_is_met_at_its_nearest_point() {
        let catheter = Catheter::prototype();
        let reached = equilibrium(&catheter, &Load::currents(Vector3::new(0.0, 0.03, 0.05))).unwrap().tip;
        let followed = follow(&catheter, &[Target::Space(reached)]).unwrap();
        assert!(followed[0].off_m < 2e-6, "{}", followed[0].off_m);
    }

    #[test]
    fn a_path_that_is_none_is_refused() {
        let catheter = Catheter::prototype();
        assert_eq!(follow(&catheter, &[]).unwrap_err().to_string(), "the path has no point");
        let error = follow(&catheter, &[Target::Across([f64::NAN, 0.0])]).unwrap_err().to_string();
        assert_eq!(error, "point 1 of the path is not finite");
    }
}
