//! Poses of the board: steps, derivatives, and conversion from OpenCV's form.

use crate::optics::Lens;
use nalgebra::{Isometry3, Point2, Point3, Rotation3, Translation3, UnitQuaternion, Vector3, Vector6};
use opencv::calib3d;
use opencv::core::{Mat, MatExprTraitConst, MatTraitConst, Point2f, Point3f, Vector};

/// A pose moved by a step: translation in the camera frame, then rotation vector about the board's origin in its own
/// axes.
pub(crate) fn turned(pose: &Isometry3<f64>, step: &Vector6<f64>) -> Isometry3<f64> {
    let turn = UnitQuaternion::from_scaled_axis(Vector3::new(step[3], step[4], step[5]));
    let to = Translation3::from(pose.translation.vector + Vector3::new(step[0], step[1], step[2]));
    Isometry3::from_parts(to, pose.rotation * turn)
}

/// d value / d pose step, from d value / d place of a point of the board.
pub(crate) fn by_pose(pose: &Isometry3<f64>, place: &Point3<f64>, d_place: &Vector3<f64>) -> Vector6<f64> {
    let in_board: Vector3<f64> = pose.rotation.inverse() * d_place;
    // d(R exp(ω) p)/dω = −R [p]ₓ, and gᵀ(−R [p]ₓ) = (p × Rᵀg)ᵀ.
    let turn = place.coords.cross(&in_board);
    Vector6::new(d_place.x, d_place.y, d_place.z, turn.x, turn.y, turn.z)
}

/// A pose from OpenCV's rotation vector and translation, three numbers each.
pub(crate) fn pose_from_opencv(turn: &Mat, shift: &Mat) -> opencv::Result<Isometry3<f64>> {
    let vector = |mat: &Mat| -> opencv::Result<Vector3<f64>> {
        Ok(Vector3::new(*mat.at::<f64>(0)?, *mat.at::<f64>(1)?, *mat.at::<f64>(2)?))
    };
    let turn = UnitQuaternion::from(Rotation3::new(vector(turn)?));
    Ok(Isometry3::from_parts(Translation3::from(vector(shift)?), turn))
}

/// The shape of what is seen.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum TargetShape {
    Flat,
    Solid,
}

/// Pose of a target from one image, as if in air: OpenCV's `solvePnP` on undistorted points. `None` where there is
/// none.
pub(crate) fn seen_pose(
    lens: &Lens,
    points: &[(Point3<f64>, Point2<f64>)],
    shape: TargetShape,
) -> opencv::Result<Option<Isometry3<f64>>> {
    let seen = || points.iter().filter_map(|(place, pixel)| Some((place, lens.undistort(pixel)?)));
    let objects: Vector<Point3f> = seen().map(|(p, _)| Point3f::new(p.x as f32, p.y as f32, p.z as f32)).collect();
    let images: Vector<Point2f> = seen().map(|(_, n)| Point2f::new(n.x as f32, n.y as f32)).collect();
    let camera = Mat::eye(3, 3, opencv::core::CV_64F)?.to_mat()?;
    let (mut turn, mut shift) = (Mat::default(), Mat::default());
    let method = match shape {
        TargetShape::Flat => calib3d::SOLVEPNP_IPPE,
        TargetShape::Solid => calib3d::SOLVEPNP_SQPNP,
    };
    let none = Mat::default();
    if !calib3d::solve_pnp(&objects, &images, &camera, &none, &mut turn, &mut shift, false, method)? {
        return Ok(None);
    }
    let pose = pose_from_opencv(&turn, &shift)?;
    Ok(pose.to_homogeneous().iter().all(|v| v.is_finite()).then_some(pose))
}

/// The largest angle between the normals of two boards.
pub(crate) fn spread_rad(poses: &[Isometry3<f64>]) -> f64 {
    let normals: Vec<Vector3<f64>> = poses.iter().map(|pose| pose.rotation * Vector3::z()).collect();
    let angles = normals.iter().enumerate().flat_map(|(i, a)| normals[..i].iter().map(move |b| a.angle(b)));
    angles.fold(0.0, f64::max)
}
