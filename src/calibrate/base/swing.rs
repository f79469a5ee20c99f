//! The plane in which the coil swings, from its tangents.
//!
//! The plane contains the tangent at rest z. Seen along z each tangent is a point q, the sine of its deflection away
//! from the origin; the direction x of the swing is the principal axis of all q (about the origin, not their mean), and
//! the scatter along the other axis tells how planar the swing is.
//!
//! σ of x about z: frames in which the coil points the same way, to within [`POSE_RAD`], show the same picture and
//! share one error; others have independent errors. σ is predicted from the tracker's covariances and also estimated
//! from the scatter across the plane; the larger one counts. An error of z also turns x, if the swing is one-sided:
//! [`Swing::turn_with_z`].

use crate::source::Timestamp;
use nalgebra::{Matrix2, Matrix2x3, Matrix3, SymmetricEigen, Vector2, Vector3};
use std::collections::BTreeMap;

/// A smaller swing does not determine its plane: 5°.
pub(super) const MIN_SWING_RAD: f64 = 5.0 * DEGREE;
/// Fraction of the swing across its plane beyond which it is not planar: B0 is then uncertain by as much (6°).
const MAX_ACROSS: f64 = 0.1;
/// Deflections that count for the sign: beyond 3°, and beyond 3 σ.
const MIN_SIGN_DEFLECTION: (f64, f64) = (3.0 * DEGREE, 3.0);
/// Poses that differ by less share one error. 1° moves the coil, at the end of a tube of some ten centimetres, by about
/// a pixel in the picture.
const POSE_RAD: f64 = DEGREE;

/// Deflection to one side over that to the other below which a swing is one-sided.
const ONE_SIDED: f64 = 0.25;

const DEGREE: f64 = std::f64::consts::PI / 180.0;

/// A swing and its plane.
#[derive(Debug, Clone, Copy)]
pub struct Swing {
    /// Frames in which the tangent was measured.
    pub measured: usize,
    /// Smallest and largest deflection in the plane, radians, with the chosen sign.
    pub range_rad: [f64; 2],
    /// RMS of the deflection across the plane, radians.
    pub across_rad: f64,
    /// Time of the deflection that determines the sign.
    pub first: Timestamp,
    /// How long that is after the first tangent, seconds.
    pub first_after_s: f64,
    /// Unit vector in the plane, at right angles to the tangent at rest.
    pub(super) x: Vector3<f64>,
    /// σ of x about z, radians, for an exact z.
    pub(super) turn_sd_rad: f64,
    /// Rotation of x about z per rotation of z about x.
    pub(super) turn_with_z: f64,
}

impl Swing {
    /// Whether it goes almost only to one side of the direction at rest.
    pub fn is_one_sided(&self) -> bool {
        let [low, high] = self.range_rad;
        let sides = [-low, high].map(|side| side.max(0.0));
        sides[0].min(sides[1]) < ONE_SIDED * sides[0].max(sides[1])
    }
}

/// Why there is no plane.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum NoPlane {
    /// The largest deflection (95 % of the frames stay below).
    HardlyMoves { largest_rad: f64 },
    /// RMS of the deflection along and across the best plane, the latter beyond its noise.
    NotPlanar { along_rad: f64, across_rad: f64 },
}

/// The plane of the swing of `tangents` (unit vectors with their covariances, in order of time) about the unit vector
/// `z`. The first deflection is taken as positive, or as negative on request.
pub(super) fn plane(
    tangents: &[(Timestamp, Vector3<f64>, Matrix3<f64>)],
    z: &Vector3<f64>,
    first_is_positive: bool,
) -> Result<Swing, NoPlane> {
    let count = tangents.len() as f64;
    let across_z = across(z);
    let seen: Vec<(Vector2<f64>, Matrix2<f64>)> =
        tangents.iter().map(|(_, t, c)| (across_z * t, across_z * c * across_z.transpose())).collect();
    let mut sizes: Vec<f64> = seen.iter().map(|(q, _)| q.norm()).collect();
    sizes.sort_by(f64::total_cmp);
    let largest_rad = sizes.get(sizes.len() * 19 / 20).map_or(0.0, |sin| sin.min(1.0).asin());
    if largest_rad < MIN_SWING_RAD {
        return Err(NoPlane::HardlyMoves { largest_rad });
    }

    let SymmetricEigen { eigenvectors, eigenvalues } =
        seen.iter().map(|(q, _)| q * q.transpose()).sum::<Matrix2<f64>>().symmetric_eigen();
    let direction: Vector2<f64> = eigenvectors.column(eigenvalues.imax()).into();
    let normal = Vector2::new(-direction.y, direction.x);
    let [along_rad, across_rad] = [eigenvalues.max(), eigenvalues.min()].map(|v| (v.max(0.0) / count).sqrt());
    let noise = seen.iter().map(|(_, c)| normal.dot(&(c * normal))).sum::<f64>() / count;
    let beyond_rad = (across_rad.powi(2) - noise).max(0.0).sqrt();
    if beyond_rad > MAX_ACROSS * along_rad {
        return Err(NoPlane::NotPlanar { along_rad, across_rad: beyond_rad });
    }

    let frames: Vec<SwingComponents> = seen.iter().map(|(q, c)| SwingComponents::of(q, c, &direction)).collect();
    let (first, sign) = sign(tangents, &frames);
    let sign = if first_is_positive { sign } else { -sign };
    let x = across_z.transpose() * direction * sign;
    // Turning z about x shifts all tangents sideways by as much, those far from rest by less.
    let shifted: f64 = frames.iter().zip(tangents).map(|(f, (_, t, _))| f.along * t.dot(z)).sum();
    let turn_with_z = shifted / frames.iter().map(|f| f.along.powi(2)).sum::<f64>();
    let angles = tangents.iter().map(|(_, t, _)| x.dot(t).atan2(z.dot(t)));
    Ok(Swing {
        measured: tangents.len(),
        range_rad: angles.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], a| [low.min(a), high.max(a)]),
        across_rad,
        first,
        first_after_s: tangents.first().map_or(0.0, |(began, ..)| first.seconds_since(*began)),
        x,
        turn_sd_rad: turn_sd_rad(&frames),
        turn_with_z: sign * turn_with_z,
    })
}

/// A tangent relative to the plane: along the swing, across it, and their σ.
struct SwingComponents {
    along: f64,
    across: f64,
    along_sd: f64,
    across_sd: f64,
}

impl SwingComponents {
    fn of(q: &Vector2<f64>, covariance: &Matrix2<f64>, direction: &Vector2<f64>) -> Self {
        let normal = Vector2::new(-direction.y, direction.x);
        let sd = |v: &Vector2<f64>| v.dot(&(covariance * v)).max(0.0).sqrt();
        Self { along: direction.dot(q), across: normal.dot(q), along_sd: sd(direction), across_sd: sd(&normal) }
    }
}

/// Two axes at right angles to a unit vector and to each other; right-handed with it: a × b = z.
fn across(z: &Vector3<f64>) -> Matrix2x3<f64> {
    let least = Vector3::ith(z.iamin(), 1.0);
    let a = z.cross(&least).normalize();
    Matrix2x3::from_rows(&[a.transpose(), z.cross(&a).transpose()])
}

/// The first deflection that counts: its time and sign. Two in succession must agree, as one may be a mistake.
fn sign(tangents: &[(Timestamp, Vector3<f64>, Matrix3<f64>)], frames: &[SwingComponents]) -> (Timestamp, f64) {
    let counts =
        |f: &SwingComponents| f.along.abs() > MIN_SIGN_DEFLECTION.0.sin().max(MIN_SIGN_DEFLECTION.1 * f.along_sd);
    let first = frames.windows(2).position(|pair| match pair {
        [one, next] => counts(one) && counts(next) && one.along * next.along > 0.0,
        _ => false,
    });
    // A swing too fast for that has too few frames: then the largest deflection counts.
    let largest = || (0..frames.len()).max_by(|a, b| frames[*a].along.abs().total_cmp(&frames[*b].along.abs()));
    let at = first.or_else(largest).unwrap_or(0);
    (tangents[at].0, frames[at].along.signum())
}

/// The rotation is Σ w·across with w = along/Σ along²; all frames of a pose share one error.
fn turn_sd_rad(frames: &[SwingComponents]) -> f64 {
    let total: f64 = frames.iter().map(|f| f.along.powi(2)).sum();
    let mut poses: BTreeMap<i64, [f64; 2]> = BTreeMap::new();
    for frame in frames {
        let weight = frame.along / total;
        let pose = poses.entry((frame.along / POSE_RAD).round() as i64).or_default();
        pose[0] += weight * frame.across_sd;
        pose[1] += weight * frame.across;
    }
    let [predicted, seen] = [0, 1].map(|i| poses.values().map(|pose| pose[i].powi(2)).sum::<f64>());
    let fitted = poses.len() as f64 / (poses.len().max(2) - 1) as f64;
    predicted.max(seen * fitted).sqrt()
}
