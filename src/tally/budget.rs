//! The error budget of a run: the contribution of each source of error to θ and to a coordinate of the tip in the base
//! frame, on average over the three, 1σ, typical of the run.
//!
//! - *image noise*: median over the frames of the tracker's own σ, for one frame. It averages out over frames; the
//!   others do not.
//! - *calibration*: the effect of the rig's covariance at the places where the catheter was
//!   (`crate::calibrate::rig::share`).
//! - *base frame*: σ of its origin and axes, as `calibrate base` recorded them.
//! - *time stamps*: their resolution (the largest step that all stamps are multiples of), uniformly distributed, times
//!   the RMS speed. It matters for dynamics, not for positions. Unknown for stamps that are arrival times, and where
//!   that step is the frame interval itself, as in 20 ms at 50 fps.
//!
//! Cannot tell: errors that no σ covers, such as a moved mirror, or places outside the boards' volume.

use crate::calibrate::rig::share::{CatheterPose, of_coordinate, share};
use crate::estimate::Estimate;
use crate::rig::{Draft, Rig};
use crate::source::times::{Resolution, seconds};
use crate::track::theta_derivative_by_turn;
use nalgebra::Vector3;

/// Most moments kept, spread evenly over the run.
const MAX_MOMENTS: usize = 256;
/// Clock of stamps that give the arrival of a frame, not its exposure.
const ARRIVAL: &str = "host_arrival";

/// A source of error, and its contribution to θ, radians, and to a coordinate of the tip, metres: on average over the
/// three, as every σ of a place is given.
#[derive(Debug, Clone, PartialEq)]
pub struct Contribution {
    /// What it is.
    pub name: &'static str,
    /// θ and a coordinate of the tip, or why they are unknown.
    pub share: Result<(f64, f64), String>,
}

/// Data collected for the budget during the run.
#[derive(Debug, Clone, Default)]
pub(super) struct BudgetData {
    rig: Option<Draft>,
    /// σ of the base frame: origin, metres; turns about its axes, radians.
    base_sd: Option<(Vector3<f64>, Vector3<f64>)>,
    coil: usize,
    tip: usize,
    poses: Vec<CatheterPose>,
    stride: u64,
    seen: u64,
    /// Stamp, θ and tip of the previous frame.
    last: Option<(i64, f64, Vector3<f64>)>,
    stamps: Resolution,
    /// Sums of squared speeds of θ and of the tip, less the part of noise; their number.
    speeds: (f64, f64, u64),
}

impl BudgetData {
    pub(super) fn new(rig: &Rig) -> Self {
        let coil = rig.catheter.coil;
        let tip = rig.tip();
        let base_sd = rig.origin_sd_m().zip(rig.axes_sd_rad());
        let rig = rig.base.is_some().then(|| rig.clone().into());
        Self { rig, base_sd, coil, tip, stride: 1, ..Self::default() }
    }

    /// Index of the tip's marker.
    pub(super) fn tip(&self) -> usize {
        self.tip
    }

    pub(super) fn add(&mut self, estimate: &Estimate) {
        let ns = estimate.stamp.ns;
        self.stamps.add(ns);
        let place = |marker: usize| estimate.markers.get(marker)?.position.as_ref().ok();
        let (Some(coil), Some(tip), Ok(tangent), Ok(deflection)) =
            (place(self.coil), place(self.tip), &estimate.tangent, &estimate.deflection)
        else {
            self.last = None;
            return;
        };
        if let Some((before_ns, theta_rad, at)) = self.last
            && ns > before_ns
        {
            let dt_s = seconds(ns.saturating_sub(before_ns));
            let noise = (2.0 * deflection.theta_sd_rad.powi(2), 2.0 * tip.covariance.trace());
            self.speeds.0 += ((deflection.theta_rad - theta_rad).powi(2) - noise.0) / (dt_s * dt_s);
            self.speeds.1 += ((tip.point.coords - at).norm_squared() - noise.1) / (dt_s * dt_s);
            self.speeds.2 += 1;
        }
        self.last = Some((ns, deflection.theta_rad, tip.point.coords));
        if self.seen.is_multiple_of(self.stride.max(1)) {
            self.poses.push(CatheterPose { coil: coil.point, tangent: tangent.direction, tip: tip.point });
        }
        self.seen += 1;
        if self.poses.len() > MAX_MOMENTS {
            let mut even = false;
            self.poses.retain(|_| {
                even = !even;
                even
            });
            self.stride *= 2;
        }
    }

    /// `noise`: median σ of θ, radians, and of a coordinate of the tip, metres; `clock` of the stamps. `None` without a
    /// base frame or a measured frame.
    pub(super) fn budget(&self, noise: Option<(f64, f64)>, clock: &str) -> Option<Vec<Contribution>> {
        let rig = self.rig.as_ref()?;
        let (theta_rad, tip_m) = noise?;
        let of_calibration = share(rig, &self.poses)
            .map(|own| (own.theta_rad.0, of_coordinate(own.tip_m.0)))
            .map_err(|why| why.to_string());
        Some(vec![
            Contribution { name: "image noise, one frame", share: Ok((theta_rad, tip_m)) },
            Contribution { name: "calibration", share: of_calibration },
            Contribution { name: "base frame", share: self.of_base(rig) },
            Contribution { name: "time stamps", share: self.of_stamps(clock) },
        ])
    }

    fn of_base(&self, rig: &Draft) -> Result<(f64, f64), String> {
        let missing = || "the rig file holds no σ of its base frame".to_owned();
        let (origin_m, axes_rad) = self.base_sd.ok_or_else(missing)?;
        let base_from_camera = rig.base.as_ref().ok_or_else(missing)?.base_from_camera;
        // A rotation ω moves a point at r by ω × r.
        let of_turn = |pose: &CatheterPose| {
            let r = (base_from_camera * pose.tip).coords;
            (0..3).map(|i| axes_rad[i].powi(2) * (r.norm_squared() - r[i] * r[i])).sum::<f64>()
        };
        let count = self.poses.len().max(1) as f64;
        let of_theta = |pose: &CatheterPose| {
            let by_turn = theta_derivative_by_turn(&(base_from_camera * pose.tangent));
            by_turn.transpose().component_mul(&axes_rad).norm_squared()
        };
        let mean = |of: &dyn Fn(&CatheterPose) -> f64| self.poses.iter().map(of).sum::<f64>() / count;
        Ok((mean(&of_theta).sqrt(), of_coordinate((origin_m.norm_squared() + mean(&of_turn)).sqrt())))
    }

    fn of_stamps(&self, clock: &str) -> Result<(f64, f64), String> {
        if clock == ARRIVAL {
            return Err("stamps are times of arrival: how late they are is not known".to_owned());
        }
        let (theta, tip, count) = self.speeds;
        if count == 0 {
            return Err("no two frames in sequence are answered".to_owned());
        }
        let hidden = || "all stamps are multiples of the frame interval: their resolution does not show".to_owned();
        let sd_s = self.stamps.sd_s().ok_or_else(hidden)?;
        let rms = |sum: f64| (sum / count as f64).max(0.0).sqrt();
        Ok((rms(theta) * sd_s, of_coordinate(rms(tip) * sd_s)))
    }
}

/// All known contributions combined: θ, radians, and a coordinate of the tip, metres.
pub fn together(sources: &[Contribution]) -> (f64, f64) {
    let squares = sources.iter().filter_map(|source| source.share.as_ref().ok());
    let (theta, tip) = squares.fold((0.0, 0.0), |sum, own| (sum.0 + own.0 * own.0, sum.1 + own.1 * own.1));
    (theta.sqrt(), tip.sqrt())
}

/// What that sum is called.
pub fn together_name(sources: &[Contribution]) -> &'static str {
    if sources.iter().all(|source| source.share.is_ok()) { "together" } else { "together, of those known" }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn data(stamps: &[i64]) -> BudgetData {
        let mut data = BudgetData { speeds: (1.0, 4.0, 1), ..BudgetData::default() };
        stamps.iter().for_each(|ns| data.stamps.add(*ns));
        data
    }

    #[test]
    fn stamps_as_regular_as_the_frames_do_not_show_their_resolution() {
        let of = |stamps: &[i64]| data(stamps).of_stamps("container");
        let (theta_rad, tip_m) = of(&[0, 17_000_000, 33_000_000, 50_000_000]).unwrap();
        assert!(
            (theta_rad - 1e-3 / 12.0_f64.sqrt()).abs() < 1e-9
                && (tip_m - 2.0 / 3.0_f64.sqrt() * theta_rad).abs() < 1e-9
        );
        // 50 frames per second, of which two are lost.
        let regular = of(&[3_000_000, 23_000_000, 83_000_000, 103_000_000]).unwrap_err();
        assert_eq!(regular, "all stamps are multiples of the frame interval: their resolution does not show");
    }

    #[test]
    fn what_is_known_adds_up_in_squares() {
        let source = |share| Contribution { name: "", share };
        let all = [source(Ok((3.0, 1.0))), source(Err("why".into())), source(Ok((4.0, 0.0)))];
        assert_eq!(together(&all), (5.0, 1.0));
    }
}
