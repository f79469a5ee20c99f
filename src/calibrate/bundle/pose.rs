//! Poses of the board: steps, derivatives, and conversion from OpenCV's form.

use nalgebra::{Isometry3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3, Vector6};
use opencv::core::{Mat, MatTraitConst};

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

/// The largest angle between the normals of two boards.
pub(crate) fn spread_rad(poses: &[Isometry3<f64>]) -> f64 {
    let normals: Vec<Vector3<f64>> = poses.iter().map(|pose| pose.rotation * Vector3::z()).collect();
    let angles = normals.iter().enumerate().flat_map(|(i, a)| normals[..i].iter().map(move |b| a.angle(b)));
    angles.fold(0.0, f64::max)
}
