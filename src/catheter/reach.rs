//! Where the tip can get to within the current limit.
//!
//! A moment along B0 has no couple, so that at each shape one direction of currents moves nothing: of three currents
//! two count, and the tip of a catheter with one coil set reaches a surface, not a volume. Currents along such a
//! direction leave the box of allowed currents through a face, so that the faces reach all that the box reaches: they
//! are what is sampled.

use super::equilibrium::equilibrium;
use super::error::CatheterError;
use super::load::Load;
use super::model::Catheter;
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;

/// What is reached.
#[derive(Debug, Clone)]
pub struct Reach {
    /// Shapes on a grid over the faces of the box of currents.
    pub reached: Vec<Reached>,
    /// Grid points whose shape is unstable, or was not found.
    pub without_shape: usize,
    /// Largest ratio of the smallest to the largest singular value of ∂tip/∂currents on the grid's corners and middles:
    /// 0 for a surface.
    pub thickness: f64,
}

/// One shape.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reached {
    /// Currents of the coils x, y, z, amperes.
    pub currents_a: Vector3<f64>,
    /// The tip, metres.
    pub tip: Point3<f64>,
    /// The coil's tangent.
    pub tangent: Vector3<f64>,
    /// θ, radians.
    pub theta_rad: f64,
}

/// Samples the reach with `per_edge` currents along each edge of the box, or one more if that is even: the largest θ
/// may be that of one coil alone, in the middle of a face.
///
/// # Errors
/// When the catheter has no stable shape at rest.
pub fn reach(catheter: &Catheter, per_edge: usize) -> Result<Reach, CatheterError> {
    equilibrium(catheter, &Load::currents(Vector3::zeros()))?;
    let most = per_edge.saturating_sub(1).next_multiple_of(2).max(2);
    let grid = (0..=most).flat_map(|i| (0..=most).flat_map(move |j| (0..=most).map(move |k| [i, j, k])));
    let faces: Vec<[usize; 3]> = grid.filter(|at| at.iter().any(|i| *i == 0 || *i == most)).collect();
    let solved: Vec<Option<(Reached, Option<f64>)>> = faces
        .par_iter()
        .map(|at| {
            let part = at.map(|i| 2.0 * i as f64 / most as f64 - 1.0);
            let currents_a = Vector3::from(part) * catheter.coils.limit_a;
            let shape = equilibrium(catheter, &Load::currents(currents_a)).ok()?;
            let notable = at.iter().all(|i| *i == 0 || *i == most || 2 * *i == most);
            let thickness = if notable { shape.sensitivity(catheter).ok().map(|by| by.thickness()) } else { None };
            let (tip, tangent, theta_rad) = (shape.tip, shape.tangent, shape.theta_rad());
            Some((Reached { currents_a, tip, tangent, theta_rad }, thickness))
        })
        .collect();
    let without_shape = solved.iter().filter(|found| found.is_none()).count();
    let thickness = solved.iter().flatten().filter_map(|(_, thickness)| *thickness).fold(0.0, f64::max);
    Ok(Reach { reached: solved.into_iter().flatten().map(|(reached, _)| reached).collect(), without_shape, thickness })
}

impl Reach {
    /// Smallest and largest θ, radians.
    pub fn theta_rad(&self) -> (f64, f64) {
        let all = self.reached.iter().map(|r| r.theta_rad);
        all.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), theta| (low.min(theta), high.max(theta)))
    }

    /// Corners of the box around all tips, metres.
    pub fn tip_box(&self) -> [Point3<f64>; 2] {
        let far = Point3::from(Vector3::repeat(f64::INFINITY));
        let all = self.reached.iter().map(|r| r.tip);
        all.fold([far, -far], |[low, high], tip| [low.inf(&tip), high.sup(&tip)])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_coil_set_reaches_a_surface_that_is_the_same_on_both_sides() {
        let found = reach(&Catheter::prototype(), 5).unwrap();
        // With a moment against B0, like a compass needle held the wrong way round, three have no stable shape.
        assert_eq!((found.reached.len(), found.without_shape), (95, 3));
        assert!(found.thickness < 1e-6, "{}", found.thickness);
        let (low, high) = found.theta_rad();
        assert!((low + high).abs() < 1e-6, "{low} {high}");
        let [least, most] = found.tip_box();
        assert!((least.x + most.x).abs() < 1e-8 && (least.y + most.y).abs() < 1e-8, "{least} {most}");
    }

    /// Without a field nothing moves.
    #[test]
    fn without_a_field_nothing_is_reached() {
        let mut catheter = Catheter::prototype();
        catheter.surroundings.b0_t = Vector3::zeros();
        let found = reach(&catheter, 2).unwrap();
        let [least, most] = found.tip_box();
        assert!((most - least).norm() < 1e-12);
    }
}
