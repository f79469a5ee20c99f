//! Widens covariances by what the fit of a frame cannot know.

use super::Tracker;
use crate::estimate::Estimate;
use crate::source::Timestamp;
use crate::track::answer::carried;
use crate::track::fit::group_fit::Fitted;
use crate::track::model::tube_shape::ShapeStep;
use nalgebra::Matrix3;

impl Tracker {
    /// Widens covariances to match the scatter of positions and tangent from frame to frame, and how late they are in
    /// blended pictures; those of positions by the shake of the base band, and its own by how far a coder that predicts
    /// carried it. Only a rig with a base frame says that this band, the first, rests.
    pub(super) fn widen(&mut self, estimate: &mut Estimate, predicted: bool) {
        let stamp = estimate.stamp;
        self.stamps.add(stamp.ns);
        let known = (self.model.error.persisting, self.stamps.sd_s().unwrap_or(0.0));
        let base = estimate.markers.first().map(|base| &base.position);
        let mut carried = Matrix3::zeros();
        if let (Some(Ok(base)), Some(_)) = (base, self.rig.resting_base()) {
            let direction = estimate.tangent.as_ref().ok().map(|tangent| &tangent.direction);
            self.shake.add(stamp, base, direction);
            self.moved.add(stamp, base, direction);
            if predicted && let Some((off, covariance)) = self.moved.since_first() {
                carried = carried::covariance(&off, &covariance);
            }
        }
        let (shake, moved) = (self.shake.at(stamp), self.moved.covariance());
        let astray = shake + moved;
        // A coder that carries the band along moves it, too.
        let of_base = shake + if carried.trace() > moved.trace() { carried } else { moved };
        for (m, (marker, scatter)) in estimate.markers.iter_mut().zip(&mut self.scatter).enumerate() {
            if let Ok(position) = &mut marker.position {
                position.covariance *= scatter.add(stamp, position.point.coords, &position.covariance, known);
                position.covariance += if m == 0 { of_base } else { astray };
            }
        }
        if let (Ok(tangent), Some(scatter)) = (&mut estimate.tangent, self.scatter.last_mut()) {
            tangent.covariance *= scatter.add(stamp, tangent.direction, &tangent.covariance, known);
        }
        let late = |way_m| self.blending.late().max(self.denoised.late(way_m));
        self.ways.widen(estimate, self.rig.catheter.coil, late);
    }

    /// Widens covariances by how much late colours move the fits.
    pub(super) fn widen_by_lag(&self, stamp: Timestamp, fitted: &mut [Fitted]) {
        let late = self.lag.late();
        if late == 0.0 {
            return;
        }
        for fitted in fitted {
            let Ok(fit) = &fitted.result else { continue };
            let Some(ways_px) = self.ways_px(stamp, fitted, fit) else { continue };
            let behind = fit.views.iter().zip(&ways_px).map(|(view, way_px)| view.slip_response * (way_px * late));
            let behind: ShapeStep = behind.sum();
            if let Ok(fit) = &mut fitted.result {
                fit.covariance += behind * behind.transpose();
            }
        }
    }
}
