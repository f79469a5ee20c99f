//! Effect of a rig's calibration errors on a measured catheter, at the places where it was.
//!
//! In: a rig file with the covariance that `calibrate rig` wrote into it; base, coil and tip of a recording. Out:
//! [`Share`].
//!
//! A triangulated point moves by K δp for an error δp of the geometry (`expected_error`). Tip and θ are measured in the
//! base frame, which was found with the same geometry at rest, so common errors cancel,
//!
//!   δθ = ∂θ/∂t·δt + ∂θ/∂ω·ω,   δtip = K(tip) − K(origin) − ω × (tip − origin),   ω = z × δz,
//!
//! with z the base frame's axis, ω its turn, and δt the difference of K at both ends of a short piece along the tangent
//! t. (In the plane of B0, ∂θ/∂ω·ω is −x·δz.)
//!
//! Cannot tell: errors that no covariance covers (a moved mirror, a bent wall). Outside the boards' volume the
//! covariance itself is less reliable.

use super::expected_error::answer;
use crate::calibrate::geometry::{Geometry, Parameter, Projector};
use crate::median::upper_median_and_largest;
use crate::rig::Draft;
use crate::track::{theta_derivative, theta_derivative_by_turn};
use nalgebra::{DMatrix, Matrix3xX, Point3, Vector3};

/// Half the length over which the tangent's error is evaluated, metres.
const HALF_M: f64 = 5e-3;

/// A catheter at one moment, camera frame.
#[derive(Debug, Clone, Copy)]
pub(crate) struct CatheterPose {
    /// The coil, metres.
    pub coil: Point3<f64>,
    /// Its tangent, a unit vector.
    pub tangent: Vector3<f64>,
    /// The tip, metres.
    pub tip: Point3<f64>,
}

/// 1σ from the calibration, over the given moments.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Share {
    /// θ, radians: median and largest.
    pub theta_rad: (f64, f64),
    /// The tip in the base frame, root of the trace, metres: median and largest.
    pub tip_m: (f64, f64),
    /// Largest distance of the catheter outside the box covered by the boards, metres; `None` when the file does not
    /// state it.
    pub outside_m: Option<f64>,
}

/// Why there is no result.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub(crate) enum NoShare {
    /// No base frame.
    #[error("the rig has no base frame yet (catoptra calibrate base)")]
    Base,
    /// No covariance.
    #[error("the rig file does not hold the covariance that `catoptra calibrate rig` writes into [provenance.rig]")]
    Covariance,
    /// No positions.
    #[error("no place is seen by two views")]
    Place,
}

/// The contribution of the calibration at these moments.
///
/// # Errors
/// [`NoShare`].
pub(crate) fn share(rig: &Draft, poses: &[CatheterPose]) -> Result<Share, NoShare> {
    let base = rig.base.as_ref().ok_or(NoShare::Base)?;
    let (geometry, free, covariance) = recorded_geometry(rig).ok_or(NoShare::Covariance)?;
    let projector = Projector::new(&geometry, &free);
    let moved = |place: &Point3<f64>| Some(answer(&projector, &geometry, place)?.0);
    let turned = |place: &Point3<f64>, way: &Vector3<f64>| {
        Some((moved(&(place + way * HALF_M))? - moved(&(place - way * HALF_M))?) / (2.0 * HALF_M))
    };
    let camera_from_base = base.base_from_camera.inverse();
    let origin = camera_from_base * Point3::origin();
    let base_from_camera = base.base_from_camera.rotation.to_rotation_matrix();
    let z = camera_from_base.rotation * Vector3::z();
    let at_rest = || Some((moved(&origin)?, turned(&origin, &z)?));
    let (of_origin, of_z) = at_rest().ok_or(NoShare::Place)?;
    // Rotation error of the frame: z × δz.
    let of_turn = z.cross_matrix() * &of_z;
    let one = |pose: &CatheterPose| -> Option<[f64; 2]> {
        let of_t = turned(&pose.coil, &pose.tangent)?;
        let t = base_from_camera * pose.tangent;
        let [by_tangent, by_turn] =
            [theta_derivative(&t), theta_derivative_by_turn(&t)].map(|own| own * base_from_camera.matrix());
        let theta = by_tangent * of_t + by_turn * &of_turn;
        let tip: Matrix3xX<f64> = moved(&pose.tip)? - &of_origin + (pose.tip - origin).cross_matrix() * &of_turn;
        let variance = |rows: &DMatrix<f64>| (rows * &covariance * rows.transpose()).trace().max(0.0).sqrt();
        let dynamic = |rows: &[f64], count: usize| DMatrix::from_column_slice(count, rows.len() / count, rows);
        Some([variance(&dynamic(theta.as_slice(), 1)), variance(&dynamic(tip.as_slice(), 3))])
    };
    let each: Vec<[f64; 2]> = poses.iter().filter_map(one).collect();
    if each.is_empty() {
        return Err(NoShare::Place);
    }
    let over = |which: usize| upper_median_and_largest(each.iter().map(|both| both[which]).collect());
    Ok(Share { theta_rad: over(0), tip_m: over(1), outside_m: outside_m(rig, poses) })
}

/// Parameters of the rig's geometry and their covariance, as recorded by `calibrate rig`.
pub(crate) fn recorded_geometry(rig: &Draft) -> Option<(Geometry, Vec<Parameter>, DMatrix<f64>)> {
    let geometry = Geometry::of(rig.camera.lens, &rig.surfaces, &rig.views)?;
    let index = |name: &str| geometry.surfaces.iter().position(|(own, _)| own == name);
    let parameter = |name: &str| Parameter::from_name(name, |surface| index(surface));
    let (names, covariance) = rig.rig_covariance()?;
    let free: Vec<Parameter> = names.into_iter().map(parameter).collect::<Option<_>>()?;
    Some((geometry, free, covariance))
}

fn outside_m(rig: &Draft, poses: &[CatheterPose]) -> Option<f64> {
    let [low, high] = rig.boards_volume_m()?;
    let beyond = |place: &Point3<f64>| {
        let below = (low - place.coords).sup(&(place.coords - high));
        below.map(|side| side.max(0.0)).norm()
    };
    poses.iter().flat_map(|pose| [beyond(&pose.coil), beyond(&pose.tip)]).reduce(f64::max)
}

/// σ of a coordinate, on average over the three, of an error that is this large in space.
pub(crate) fn of_coordinate(trace_root_m: f64) -> f64 {
    trace_root_m / 3.0_f64.sqrt()
}
