//! `catoptra calibrate base`: the base frame, from a recording at rest and the direction of B0.
//!
//! In: the tracker's measurements of a recording at rest and, unless B0's direction is known, of a swing in the plane
//! of B0 and the tangent at rest. Out: the frame's transform, B0, and their covariances.
//!
//! 1. Origin: mean position of the first marker, the one next to the clamp. z: mean tangent of the coil. Both must be
//!    at rest; `at_rest.rs` explains their covariance.
//! 2. x: along B0 made orthogonal to z. From a swing, B0 is taken to be the direction in its plane at right angles to
//!    z.
//! 3. y = z × x.
//!
//! The covariances are those of the measurement in the camera frame for an exact rig. The uncertainty of lens, mirror
//! and walls moves the frame together with everything measured in it, so displacements and θ are not affected.
//!
//! Cannot detect: the sign of B0 (pictures do not show it: the first deflection of the swing is taken for positive), a
//! swing in the wrong plane, a rest position with current on.

mod at_rest;
mod swing;

pub use swing::Swing;

use crate::estimate::{Miss, Position, Tangent};
use crate::rig::{Base, Rig};
use crate::source::{FrameSource, SourceError, Timestamp};
use crate::track::{TrackError, TrackOptions, Tracker};
use at_rest::{BLOCKS, NotAtRest, RestMean, mean_at_rest};
use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, UnitQuaternion, Vector3};
use std::fmt;
use swing::{MIN_SWING_RAD, NoPlane};

/// B0 closer to the tangent at rest than this leaves x undetermined: at 5° its error is ten times the tangent's.
const MIN_ANGLE_RAD: f64 = 5.0 * std::f64::consts::PI / 180.0;
/// Motion that does not harm the frame, whatever the σ of the pictures: metres, radians.
const MOTION_TOLERANCE: (f64, f64) = (0.05e-3, 0.1 * std::f64::consts::PI / 180.0);

/// Measurements of base band and coil in a recording.
#[derive(Debug, Clone, Default)]
pub struct Observed {
    /// Frames in the recording.
    pub frames: usize,
    /// Positions of the base band, where measured; in order of time.
    pub base: Vec<Position>,
    /// The coil's tangents, where measured.
    pub tangents: Vec<(Timestamp, Tangent)>,
    /// The first reasons why base band and tangent were not measured.
    pub first_miss: [Option<Miss>; 2],
}

/// Where B0's direction comes from.
#[derive(Debug, Clone, Copy)]
pub enum Field<'a> {
    /// It is known: a vector in the camera frame of any length, and the σ of its angle about the tangent at rest,
    /// radians.
    Known(Vector3<f64>, f64),
    /// From a swing in the plane of B0 and the tangent at rest.
    Swing {
        /// Measurements of the swing.
        observed: &'a Observed,
        /// Whether the first deflection is towards B0.
        first_is_positive: bool,
    },
}

/// The base frame and its covariances.
#[derive(Debug, Clone)]
pub struct BaseCalibration {
    /// The frame; gravity is not known here.
    pub base: Base,
    /// Origin in the camera frame, metres.
    pub origin: Point3<f64>,
    /// Covariance of the origin in the camera frame, m².
    pub origin_covariance: Matrix3<f64>,
    /// Covariance of the frame's rotation about its own axes x, y, z, rad². The rotation about y is the error of θ's
    /// zero.
    pub axes_covariance: Matrix3<f64>,
    /// The swing, if B0 comes from one.
    pub swing: Option<Swing>,
}

/// Which of the two recordings.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Run {
    /// At rest.
    Rest,
    /// In the plane of B0.
    Planar,
}

/// A quantity measured in a recording.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Quantity {
    /// Position of the base band.
    Base,
    /// Direction of the coil.
    Tangent,
}

impl fmt::Display for Quantity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Base => "the base band",
            Self::Tangent => "the coil's direction",
        })
    }
}

impl Quantity {
    /// A value of this quantity, for people.
    fn with_unit(self, value: f64) -> String {
        match self {
            Self::Base => format!("{:.3} mm", value * 1e3),
            Self::Tangent => format!("{:.2}°", value.to_degrees()),
        }
    }
}

/// Why there is no base frame.
#[derive(Debug, thiserror::Error)]
pub enum BaseError {
    /// A recording failed.
    #[error(transparent)]
    Source(#[from] SourceError),
    /// The pictures do not belong to the rig, or the rig has no colours.
    #[error(transparent)]
    Track(#[from] TrackError),
    /// A recording in which too little was measured.
    #[error(
        "{quantity} was measured in only {measured} of {frames} frames: expected {BLOCKS} or more, and half of all"
    )]
    TooFew {
        /// Which recording.
        run: Run,
        /// The quantity that was not measured.
        quantity: Quantity,
        /// Frames in which it was measured.
        measured: usize,
        /// Frames in all.
        frames: usize,
        /// The first reason why it was not.
        miss: Option<Miss>,
    },
    /// Motion in a recording at rest.
    #[error(
        "not at rest: {quantity} scatters by {} (RMS), {} would be the limit of noise; wait until catheter and water \
         are still",
        quantity.with_unit(*rms), quantity.with_unit(*allowed)
    )]
    Moves {
        /// What moves.
        quantity: Quantity,
        /// RMS scatter in the worst direction, metres or radians.
        rms: f64,
        /// The limit.
        allowed: f64,
    },
    /// Slow motion in a recording at rest.
    #[error(
        "not at rest: {quantity} drifts by {} from the first to the last fifth of the recording, {} would be the limit \
         of noise; wait until it has settled, and see that nothing slips",
        quantity.with_unit(*by), quantity.with_unit(*allowed)
    )]
    Drifts {
        /// What drifts.
        quantity: Quantity,
        /// From the first to the last fifth of the recording, metres or radians.
        by: f64,
        /// The limit.
        allowed: f64,
    },
    /// A planar run that moves too little.
    #[error(
        "the coil is deflected from rest by {:.1}° at most: {:.0}° or more are needed to find the plane of its swing",
        largest_rad.to_degrees(), MIN_SWING_RAD.to_degrees()
    )]
    HardlyMoves {
        /// 95 % of the frames stay below this, radians.
        largest_rad: f64,
    },
    /// A planar run that is not planar.
    #[error(
        "not planar: the coil swings by {:.1}° (RMS) along the best plane through its rest, and by {:.1}° across it; \
         drive one coil only, and slowly, or give B0 with --b0",
        along_rad.to_degrees(), across_rad.to_degrees()
    )]
    NotPlanar {
        /// RMS deflection along the best plane, radians.
        along_rad: f64,
        /// RMS deflection across it beyond the noise, radians.
        across_rad: f64,
    },
    /// B0 does not determine x.
    #[error(
        "B0 = {:.4}, {:.4}, {:.4} lies at {:.1}° to the tangent at rest, {:.4}, {:.4}, {:.4}: expected a direction \
         across it; both are in the camera frame (x right, y down, z forward)",
        b0.x, b0.y, b0.z, angle_rad.to_degrees(), tangent.x, tangent.y, tangent.z
    )]
    Along {
        /// Unit direction of B0, camera frame.
        b0: Vector3<f64>,
        /// Unit tangent at rest, camera frame.
        tangent: Vector3<f64>,
        /// Angle between their lines, radians.
        angle_rad: f64,
    },
    /// A vector without a direction.
    #[error("B0 = {0}, {1}, {2}: expected finite numbers that are not all 0", b0.x, b0.y, b0.z)]
    NoDirection {
        /// As given.
        b0: Vector3<f64>,
    },
}

/// Tracks a recording to its end; `progress` gets the number of frames done. One that ends early is valid as far as it
/// goes.
///
/// # Errors
/// When the recording fails or does not fit the rig.
pub fn observe(rig: &Rig, source: &mut dyn FrameSource, mut progress: impl FnMut(u64)) -> Result<Observed, BaseError> {
    let mut tracker = Tracker::new(rig, TrackOptions::default())?;
    let mut observed = Observed::default();
    while let Some(frame) = source.next_of_readable(observed.frames > 0)? {
        let estimate = tracker.step(&frame)?;
        while let Some(warning) = tracker.warning() {
            tracing::warn!("{warning}");
        }
        observed.frames += 1;
        let [base_miss, tangent_miss] = &mut observed.first_miss;
        match estimate.markers.into_iter().next().map(|marker| marker.position) {
            Some(Ok(position)) => observed.base.push(position),
            Some(Err(miss)) => {
                base_miss.get_or_insert(miss);
            }
            None => {}
        }
        match estimate.tangent {
            Ok(tangent) => observed.tangents.push((estimate.stamp, tangent)),
            Err(miss) => {
                tangent_miss.get_or_insert(miss);
            }
        }
        progress(observed.frames as u64);
    }
    Ok(observed)
}

/// The base frame from the measurements at rest and B0's direction.
///
/// # Errors
/// [`BaseError`], with the numbers.
pub fn calibrate_base(rest: &Observed, field: Field<'_>) -> Result<BaseCalibration, BaseError> {
    enough(rest, Run::Rest, Quantity::Base)?;
    enough(rest, Run::Rest, Quantity::Tangent)?;
    let places: Vec<_> = rest.base.iter().map(|p| (p.point.coords, p.covariance)).collect();
    let origin = mean_at_rest(&places, MOTION_TOLERANCE.0).map_err(|motion| moving(Quantity::Base, motion))?;
    let directions: Vec<_> = rest.tangents.iter().map(|(_, t)| (t.direction, with_length(t))).collect();
    let tangent = mean_at_rest(&directions, MOTION_TOLERANCE.1).map_err(|motion| moving(Quantity::Tangent, motion))?;
    let z = tangent.mean.normalize();

    let (x, b0, turn_sd_rad, turn_with_z, swing) = match field {
        Field::Known(b0, sd_rad) => {
            let (b0, x) = across_z(b0, &z)?;
            // B0 does not depend on z: the closer it is to z, the more z's error turns x.
            (x, b0, sd_rad, b0.dot(&z) / b0.dot(&x), None)
        }
        Field::Swing { observed, first_is_positive } => {
            enough(observed, Run::Planar, Quantity::Tangent)?;
            let tangents: Vec<_> = observed.tangents.iter().map(|(at, t)| (*at, t.direction, t.covariance)).collect();
            let swing = swing::plane(&tangents, &z, first_is_positive)?;
            (swing.x, swing.x, swing.turn_sd_rad, swing.turn_with_z, Some(swing))
        }
    };
    let y = z.cross(&x);
    let rotation = Matrix3::from_rows(&[x.transpose(), y.transpose(), z.transpose()]);
    let quaternion = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(rotation));
    let base_from_camera = Isometry3::from_parts((-(quaternion * origin.mean)).into(), quaternion);
    Ok(BaseCalibration {
        base: Base { base_from_camera, b0, gravity: None },
        origin: origin.mean.into(),
        origin_covariance: origin.covariance,
        axes_covariance: axes_covariance(&tangent, &rotation, turn_sd_rad, turn_with_z),
        swing,
    })
}

fn enough(observed: &Observed, run: Run, quantity: Quantity) -> Result<(), BaseError> {
    let [base_miss, tangent_miss] = &observed.first_miss;
    let (measured, miss) = match quantity {
        Quantity::Base => (observed.base.len(), base_miss),
        Quantity::Tangent => (observed.tangents.len(), tangent_miss),
    };
    let frames = observed.frames;
    if measured < BLOCKS || measured * 2 < frames {
        return Err(BaseError::TooFew { run, quantity, measured, frames, miss: miss.clone() });
    }
    Ok(())
}

fn moving(quantity: Quantity, motion: NotAtRest) -> BaseError {
    match motion {
        NotAtRest::Scatter { rms, allowed } => BaseError::Moves { quantity, rms, allowed },
        NotAtRest::Drift { by, allowed } => BaseError::Drifts { quantity, by, allowed },
    }
}

impl From<NoPlane> for BaseError {
    fn from(no: NoPlane) -> Self {
        match no {
            NoPlane::HardlyMoves { largest_rad } => Self::HardlyMoves { largest_rad },
            NoPlane::NotPlanar { along_rad, across_rad } => Self::NotPlanar { along_rad, across_rad },
        }
    }
}

/// Covariance of a tangent made regular: a unit vector has none along itself; the one across is used there.
fn with_length(tangent: &Tangent) -> Matrix3<f64> {
    let t = tangent.direction;
    tangent.covariance + t * t.transpose() * tangent.sd_rad().powi(2)
}

/// B0 and its part at right angles to z, as unit vectors.
fn across_z(b0: Vector3<f64>, z: &Vector3<f64>) -> Result<(Vector3<f64>, Vector3<f64>), BaseError> {
    // The largest component first: squares of very large or small numbers are not finite, or 0.
    let largest = b0.amax();
    if !(b0.iter().all(|v| v.is_finite()) && largest > 0.0) {
        return Err(BaseError::NoDirection { b0 });
    }
    let b0 = (b0 / largest).normalize();
    let x = b0 - z * b0.dot(z);
    let angle_rad = x.norm().atan2(b0.dot(z).abs());
    if angle_rad < MIN_ANGLE_RAD {
        return Err(BaseError::Along { b0, tangent: *z, angle_rad });
    }
    Ok((b0, x.normalize()))
}

/// Rotations of the frame about its axes. An error (a, b) of z along x and y is a rotation by −b about x and by a about
/// y; a rotation about x also turns x about z by `turn_with_z`.
fn axes_covariance(tangent: &RestMean, rotation: &Matrix3<f64>, turn_sd_rad: f64, turn_with_z: f64) -> Matrix3<f64> {
    let of_z = rotation * tangent.covariance * rotation.transpose();
    let turns = Matrix3::new(0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, -turn_with_z, 0.0);
    let mut covariance = turns * of_z * turns.transpose();
    covariance[(2, 2)] += turn_sd_rad.powi(2);
    covariance
}

#[cfg(test)]
mod tests;
