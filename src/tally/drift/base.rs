//! Is the base band still at the origin of the base frame?
//!
//! It is clamped, so it stays where `calibrate base` found it, whatever the catheter does. So it reveals what two views
//! alone cannot: a mirror shifted along its normal or turned left or right, and a camera that moved together with its
//! mirror.
//!
//! Method: the band's position is averaged over blocks of frames, weighted by its covariance, and the blocks over the
//! last few seconds. It has moved when its distance from the origin is both significant, given the σ of the origin,
//! that of this run and the scatter of the blocks, and larger than a band close to its clamp may move when the tube
//! bends.
//!
//! What it cannot detect: whether it was the clamp or the camera that moved; changes that leave this one point in
//! place, such as a mirror turned about an axis through the image of the band.

use crate::estimate::Estimate;
use crate::rig::Rig;
use crate::tally::drift::{ALARM_RELEASE, Drifted, Finding, Sum, Window, mean, mean_of_few};
use nalgebra::{Matrix3, Point3, Vector3};

/// A distance is significant beyond this many standard deviations, which include the systematic errors.
const SIGNIFICANT_SD: f64 = 4.0;
/// Smaller distances may come from the tube's bending at the band. On the sample, the band is measured up to 0.09 mm
/// from the origin.
const MIN_M: f64 = 0.3e-3;
/// σ assumed for an origin without one, along each axis, metres: twice that of the sample's recording at rest.
const STATED_SD_M: f64 = 0.1e-3;

/// Watches the first marker, the one next to the clamp.
#[derive(Debug, Clone)]
pub(crate) struct BaseBand {
    /// Camera frame, metres.
    origin: Point3<f64>,
    /// Covariance of the distance without the scatter of the blocks.
    systematic: Matrix3<f64>,
    /// The band's offsets from the origin, camera frame, metres.
    window: Window<Sum<3>>,
}

impl BaseBand {
    /// For a rig that tells where its first band rests.
    pub(crate) fn new(rig: &Rig) -> Option<Self> {
        let origin = rig.resting_base()?.base_from_camera.inverse() * Point3::origin();
        let sd_m = rig.origin_sd_m().unwrap_or_else(|| Vector3::repeat(STATED_SD_M));
        // The origin's variance, and as much again: errors of the image model about the band are the same in all frames
        // of a run.
        let systematic = Matrix3::from_diagonal(&sd_m.map(|sd| 2.0 * sd * sd));
        Some(Self { origin, systematic, window: Window::default() })
    }

    pub(crate) fn add(&mut self, estimate: &Estimate) {
        let Some(Ok(position)) = estimate.markers.first().map(|marker| &marker.position) else { return };
        self.window.open.add([(position.point - self.origin, position.covariance)]);
    }

    /// Ends a block; returns the finding of the last ones.
    pub(crate) fn found(&mut self) -> Option<Finding> {
        self.window.close();
        self.distance(mean(self.window.blocks.iter())?)
    }

    /// The finding of a run that had too few frames for [`Self::found`].
    pub(crate) fn found_at_end(&self) -> Option<Finding> {
        self.distance(mean_of_few(self.window.all())?)
    }

    fn distance(&self, (away, sd_of_run_m): (Vector3<f64>, f64)) -> Option<Finding> {
        let along = away.try_normalize(0.0)?;
        let systematic_m = along.dot(&(self.systematic * along)).sqrt();
        let (size_m, sd_m) = (away.norm(), systematic_m.hypot(sd_of_run_m));
        let limit_m = MIN_M.max(SIGNIFICANT_SD * sd_m);
        Some(Finding {
            what: Drifted::Base { sd_m },
            size_m,
            raises: size_m > limit_m,
            // A badly known origin may keep a base band that is in place further off than half of the least distance.
            ends: size_m <= ALARM_RELEASE * MIN_M.max(SIGNIFICANT_SD * systematic_m),
            limit: Some(limit_m),
        })
    }
}
