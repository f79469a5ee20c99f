//! How the rig's bands sit on the catheter, and where the clamp is.

use super::error::SceneError;
use crate::catheter::{Bands, Catheter};
use crate::rig::Rig;
use nalgebra::{Isometry3, Translation3};

/// From the clamp to the first band, metres, where no catheter says otherwise.
const FREE_M: f64 = 3e-3;
/// Length of the stiff part, metres, where no rig says otherwise; the coil's band at least.
const STIFF_M: f64 = 14e-3;
/// How far a catheter's lengths may be off the bands' places, metres.
const OFF_M: f64 = 1e-3;

/// A catheter with the rig's bands on it; distances count from the clamp along the tube, metres.
#[derive(Debug, Clone)]
pub struct Mount {
    /// The rod, with the places of the rig's bands.
    pub catheter: Catheter,
    /// Middle of each band, in the rig's order.
    pub centres_m: Vec<f64>,
    /// Where each band begins and ends.
    pub bands_m: Vec<(f64, f64)>,
    /// Length of the tube.
    pub length_m: f64,
    /// Transform from the clamp's frame (z along the straight tube, x along B0) to the camera's.
    pub camera_from_clamp: Isometry3<f64>,
}

impl Mount {
    /// Puts the rig's bands on a catheter: that given, or the paper's prototype brought to the bands' places.
    ///
    /// # Errors
    /// [`SceneError`] when the rig does not say where the catheter or its bands are, or the two do not fit.
    pub fn of(rig: &Rig, given: Option<&Catheter>) -> Result<Self, SceneError> {
        let base = rig.base.as_ref().ok_or(SceneError::NoBase)?;
        let places = rig.markers.iter().map(|marker| {
            let centre_m = marker.centre_m.ok_or_else(|| SceneError::NoPlace { marker: marker.name.clone() })?;
            Ok((centre_m, marker.length_m))
        });
        let places = places.collect::<Result<Vec<_>, SceneError>>()?;
        let nothing = || SceneError::NoPlace { marker: "coil".to_owned() };
        let (coil_m, band_m) = places.get(rig.catheter.coil).copied().ok_or_else(nothing)?;
        let begin_m = places.iter().map(|(centre, length)| centre - length / 2.0).fold(f64::INFINITY, f64::min);
        let last_m = places.iter().map(|(centre, length)| centre + length / 2.0).fold(f64::NEG_INFINITY, f64::max);
        let end_m = rig.catheter.end.and_then(|end| places.get(end)).map(|(centre, length)| centre + length / 2.0);
        let (mut catheter, clamp_m) = match given {
            Some(catheter) => (catheter.clone(), coil_m - catheter.flexible_m - catheter.coil_m / 2.0),
            None => {
                let clamp_m = begin_m - FREE_M;
                let stiff_m = rig.catheter.rigid_m.unwrap_or(STIFF_M).max(band_m);
                let tail_m = end_m.unwrap_or(last_m) - coil_m - stiff_m / 2.0;
                let mut catheter = Catheter::prototype();
                catheter.flexible_m = coil_m - stiff_m / 2.0 - clamp_m;
                catheter.coil_m = stiff_m;
                catheter.tail_m = tail_m;
                let scale = rig.catheter.diameter_m / 2.0 / catheter.tube.outer_radius_m;
                catheter.tube.outer_radius_m *= scale;
                catheter.tube.inner_radius_m *= scale;
                (catheter, clamp_m)
            }
        };
        for (what, length_m) in [("between clamp and coil", catheter.flexible_m), ("behind the coil", catheter.tail_m)]
        {
            if length_m.is_nan() || length_m <= 0.0 {
                return Err(SceneError::NoRoom { what, length_mm: length_m * 1e3 });
            }
        }
        let length_m = catheter.length_m();
        if begin_m < clamp_m - OFF_M {
            return Err(SceneError::BehindClamp { off_mm: (clamp_m - begin_m) * 1e3 });
        }
        let ends_m = end_m.map_or_else(|| length_m.max(last_m - clamp_m), |end| end - clamp_m);
        if (ends_m - length_m).abs() > OFF_M {
            return Err(SceneError::Length { rod_mm: length_m * 1e3, bands_mm: ends_m * 1e3 });
        }
        let centres_m: Vec<f64> = places.iter().map(|(centre, _)| centre - clamp_m).collect();
        let bands_m = places.iter().map(|(c, l)| (c - l / 2.0 - clamp_m, c + l / 2.0 - clamp_m)).collect();
        // The base frame's origin is the first band at rest, where the tube is straight.
        let first_m = centres_m.iter().copied().fold(f64::INFINITY, f64::min);
        let base_from_clamp = Translation3::new(0.0, 0.0, -first_m);
        let camera_from_clamp = base.base_from_camera.inverse() * base_from_clamp;
        let tip_m = centres_m.get(rig.tip()).copied().unwrap_or(length_m);
        catheter.bands = Some(Bands { base_m: first_m, tip_m });
        Ok(Self { catheter, centres_m, bands_m, length_m: ends_m, camera_from_clamp })
    }
}
