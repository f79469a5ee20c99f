//! [`Drift`]: do the views still fit together? A mirror, camera or tank that was moved after the calibration shows as a
//! residual that does not average out.
//!
//! In: the estimates of a run, in order. Out: a [`DriftAlarm`] when the views have begun to disagree. Estimates are only read.
//!
//! Method: the residuals of all bands (a view alone minus the common answer) are averaged over blocks of frames, weighted by
//! their covariance, and the blocks over the last few seconds. Views disagree when that mean is both certain, many σ by the
//! scatter of the blocks (which are longer than the errors of a recording are correlated), and larger than what the models of
//! picture and tube leave. When they are so far apart that the tracker takes the bands in them for different things, there are no
//! residuals: then frames without a meeting of rays count.
//!
//! What it cannot detect: two views have but one direction in which they can contradict each other, across the plane of camera,
//! mirrored camera and band (up and down for a mirror beside the tank). What moves the image along that plane, a mirror shifted
//! along its normal or turned about an axis across that plane, changes the answer, not the residual; a camera and mirror that moved
//! together change neither. Nor can it tell which of two views is wrong.

use crate::estimate::{Estimate, Miss};
use crate::optics::OpticalPath;
use crate::rig::Rig;
use crate::source::Timestamp;
use nalgebra::{Matrix2, Point3, Vector2};
use std::collections::VecDeque;

/// Frames of a block. Measured on the sample, the autocorrelation of residuals is 0.35 from frame to frame and below 0.15 after ten.
const BLOCK: u32 = 10;
/// Blocks looked back at, at most and at least: 3 s and 1 s at 60 Hz.
const BLOCKS: (usize, usize) = (18, 6);
/// A mean is certain beyond this many of its standard deviations.
const CERTAIN: f64 = 6.0;
/// Views of a true rig were seen to disagree by up to 0.09 px in the mean (the sample at rest), models of the picture by 0.1 px.
const LEAST_PX: f64 = 0.3;
/// An alarm is over when the mean has fallen below this part of [`LEAST_PX`].
const OVER: f64 = 0.5;

/// Watches the residuals of a run.
#[derive(Debug, Clone, Default)]
pub struct Drift {
    views: Vec<OpticalPath>,
    blocks: VecDeque<Block>,
    open: Block,
    /// Where a band was last, camera frame, metres: for the scale of the picture.
    place: Option<Point3<f64>>,
    alarmed: bool,
    alarms: Vec<DriftAlarm>,
}

/// The views have begun to disagree.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DriftAlarm {
    /// Number of the frame at which it was noticed.
    pub seq: u64,
    /// Camera time of that frame.
    pub stamp: Timestamp,
    /// The view with the largest mean residual. When there are but two, the other may as well be the wrong one. `None` when
    /// the views are so far apart that there are no residuals.
    pub view: Option<usize>,
    /// By how much the views disagree, pixels, the largest while the alarm lasted; `None` when there are no residuals.
    pub size_px: Option<f64>,
    /// Its standard deviation.
    pub sd_px: Option<f64>,
    /// By how much they disagree in space at the bands, metres.
    pub size_m: f64,
}

impl DriftAlarm {
    /// What has happened, as half a sentence: `views direct and mirror disagree by 0.45 px (0.27 mm, σ 0.01 px)`; `views` are the
    /// rig's view names.
    pub fn words(&self, views: &[&str]) -> String {
        let mm = self.size_m * 1e3;
        let who = match self.view.and_then(|view| views.get(view)) {
            Some(view) if views.len() > 2 => format!("view {view} disagrees with the others"),
            _ => format!("views {} disagree", views.join(" and ")),
        };
        match (self.size_px, self.sd_px) {
            (Some(size), Some(sd)) => format!("{who} by {size:.2} px ({mm:.2} mm, σ {sd:.2} px)"),
            _ => format!("{who} by {mm:.1} mm and more, rays do not meet"),
        }
    }
}

#[derive(Debug, Clone, Default)]
struct Block {
    frames: u32,
    /// Frames in which at least half of the markers were refused because rays do not meet, and the sum of how far they miss.
    apart: u32,
    apart_sum_m: f64,
    /// For each view Σ C⁻¹ and Σ C⁻¹ r.
    sums: Vec<(Matrix2<f64>, Vector2<f64>)>,
}

/// What the last blocks say.
struct Mismatch {
    view: Option<usize>,
    size_px: Option<f64>,
    sd_px: Option<f64>,
    size_m: f64,
}

impl Drift {
    /// For runs with this rig.
    pub fn new(rig: &Rig) -> Self {
        Self { views: rig.views.iter().map(|view| view.optics.clone()).collect(), ..Self::default() }
    }

    /// All alarms so far, in order.
    pub fn alarms(&self) -> &[DriftAlarm] {
        &self.alarms
    }

    /// Adds a frame; an alarm when the views have begun to disagree, once until they agree again.
    pub fn add(&mut self, estimate: &Estimate) -> Option<DriftAlarm> {
        self.open.add(estimate, self.views.len());
        let place = estimate.markers.iter().find_map(|marker| marker.position.as_ref().ok());
        self.place = place.map(|position| position.point).or(self.place);
        if self.open.frames < BLOCK {
            return None;
        }
        self.blocks.push_back(std::mem::take(&mut self.open));
        if self.blocks.len() > BLOCKS.0 {
            self.blocks.pop_front();
        }
        let Some(found) = self.apart().or_else(|| self.residual()) else {
            self.alarmed = false;
            return None;
        };
        let certain = found.sd_px.zip(found.size_px).is_none_or(|(sd, size)| size > CERTAIN * sd && size > LEAST_PX);
        if self.alarmed {
            if let Some(alarm) = self.alarms.last_mut()
                && found.size_m > alarm.size_m
            {
                (alarm.size_m, alarm.view) = (found.size_m, found.view);
                (alarm.size_px, alarm.sd_px) = (found.size_px, found.sd_px);
            }
            self.alarmed = found.size_px.is_none_or(|size| size > OVER * LEAST_PX);
            return None;
        }
        if !certain {
            return None;
        }
        let Mismatch { view, size_px, sd_px, size_m } = found;
        let alarm = DriftAlarm { seq: estimate.seq, stamp: estimate.stamp, view, size_px, sd_px, size_m };
        self.alarmed = true;
        self.alarms.push(alarm);
        Some(alarm)
    }

    /// Whether rays do not meet at all in most of the frames.
    fn apart(&self) -> Option<Mismatch> {
        let frames: u32 = self.blocks.iter().map(|block| block.frames).sum();
        let apart: u32 = self.blocks.iter().map(|block| block.apart).sum();
        let most = self.blocks.len() >= BLOCKS.1 && 2 * apart > frames;
        let sum_m: f64 = self.blocks.iter().map(|block| block.apart_sum_m).sum();
        most.then(|| Mismatch { view: None, size_px: None, sd_px: None, size_m: sum_m / f64::from(apart) })
    }

    /// Mean residuals of the views, if there are enough.
    fn residual(&self) -> Option<Mismatch> {
        let mut means: Vec<(usize, f64, f64)> =
            (0..self.views.len()).filter_map(|view| self.mean_px(view).map(|(size, sd)| (view, size, sd))).collect();
        means.sort_by(|a, b| b.1.total_cmp(&a.1));
        // A disagreement is shared out between two views in opposite directions, each keeping the more the less it is certain
        // of itself: it is the sum of both, and so is its standard deviation.
        let [(view, first, first_sd), (_, second, second_sd), ..] = means[..] else { return None };
        let seen = self.views[view].project_with_jacobian(&self.place?).ok()?;
        let px_per_m = seen.d_pixel.norm() / std::f64::consts::SQRT_2;
        let (size_px, sd_px) = (first + second, first_sd + second_sd);
        Some(Mismatch { view: Some(view), size_px: Some(size_px), sd_px: Some(sd_px), size_m: size_px / px_per_m })
    }

    /// Length of a view's mean residual, and its standard deviation from the scatter of the blocks.
    fn mean_px(&self, view: usize) -> Option<(f64, f64)> {
        let means: Vec<Vector2<f64>> = self.blocks.iter().filter_map(|block| block.mean(view)).collect();
        if means.len() < BLOCKS.1 {
            return None;
        }
        let count = means.len() as f64;
        let mean = means.iter().sum::<Vector2<f64>>() / count;
        let size = mean.norm();
        let along = if size > 0.0 { mean / size } else { Vector2::x() };
        let squares: f64 = means.iter().map(|m| (m - mean).dot(&along).powi(2)).sum();
        Some((size, (squares / (count - 1.0) / count).sqrt()))
    }
}

impl Block {
    fn add(&mut self, estimate: &Estimate, views: usize) {
        self.frames += 1;
        self.sums.resize(views, Default::default());
        let missed_m = |miss: &Miss| match miss {
            Miss::RaysDiverge { distance_m } => Some(*distance_m),
            _ => None,
        };
        let apart = estimate.markers.iter().filter_map(|m| missed_m(m.position.as_ref().err()?));
        let (count, sum_m) = apart.fold((0, 0.0), |(count, sum), m| (count + 1, sum + m));
        if count > 0 && 2 * count >= estimate.markers.len() {
            self.apart += 1;
            self.apart_sum_m += sum_m / count as f64;
        }
        for marker in estimate.markers.iter().filter(|marker| marker.position.is_ok()) {
            for (sum, band) in self.sums.iter_mut().zip(&marker.views) {
                let Ok(band) = band else { continue };
                let Some(weight) = band.covariance_px2.try_inverse() else { continue };
                let pull = weight * band.residual_px;
                if weight.iter().chain(&pull).all(|v| v.is_finite()) {
                    sum.0 += weight;
                    sum.1 += pull;
                }
            }
        }
    }

    fn mean(&self, view: usize) -> Option<Vector2<f64>> {
        let (weight, pull) = self.sums.get(view)?;
        Some(weight.try_inverse()? * pull)
    }
}

#[cfg(test)]
mod tests {
    use super::super::drawn::Dice;
    use super::*;
    use crate::sink::fixture;

    /// A run with residuals of mean ± `mean` in the two views and correlated noise; alarms as (frame, alarm).
    fn alarms(frames: u64, mut change: impl FnMut(&mut Estimate, f64)) -> (Drift, Vec<DriftAlarm>) {
        let mut drift = Drift::new(&fixture::rig());
        let mut dice = Dice(3);
        let mut noise = 0.0;
        let told = (0..frames)
            .filter_map(|seq| {
                let mut estimate = fixture::complete(seq, seq as i64 * 16_666_667);
                noise = 0.4 * noise + dice.normal() * 0.09;
                change(&mut estimate, noise);
                drift.add(&estimate)
            })
            .collect();
        (drift, told)
    }

    fn set(estimate: &mut Estimate, mean: f64, noise: f64) {
        for marker in &mut estimate.markers {
            for (view, sign) in marker.views.iter_mut().zip([1.0, -1.0]) {
                view.as_mut().unwrap().residual_px = Vector2::new(0.001, sign * (mean + noise));
            }
        }
    }

    #[test]
    fn noise_and_what_models_leave_is_no_drift() {
        let (_, told) = alarms(20_000, |estimate, noise| set(estimate, 0.05, noise));
        assert_eq!(told, []);
        // Rare wild frames, and numbers that are none.
        let (_, told) = alarms(2_000, |estimate, noise| {
            let wild = if estimate.seq % 50 == 7 { 2.0 } else { 0.0 };
            set(estimate, wild, noise);
            if estimate.seq % 9 == 2 {
                set(estimate, f64::NAN, 0.0);
            }
        });
        assert_eq!(told, []);
    }

    #[test]
    fn views_that_part_are_told_once_with_their_distance() {
        let (drift, told) = alarms(900, |estimate, noise| {
            let mean = if (300..600).contains(&estimate.seq) { 0.4 } else { 0.0 };
            set(estimate, mean, noise);
        });
        let [alarm] = told[..] else { panic!("{told:?}") };
        assert!((330..480).contains(&alarm.seq), "{alarm:?}");
        // Afterwards the largest is kept: 0.4 px in each of two views.
        let [alarm] = drift.alarms()[..] else { panic!("{:?}", drift.alarms()) };
        assert!((alarm.size_px.unwrap() - 0.8).abs() < 0.1 && alarm.sd_px.unwrap() < 0.05, "{alarm:?}");
        let seen = fixture::rig().views[0].optics.project_with_jacobian(&drift.place.unwrap()).unwrap();
        let expected_m = 0.8 / (seen.d_pixel.norm() / 2f64.sqrt());
        assert!((alarm.size_m / expected_m - 1.0).abs() < 0.15, "{alarm:?} instead of {expected_m}");
        assert!(!drift.alarmed, "it is over");
    }

    #[test]
    fn a_second_parting_is_told_again() {
        let (drift, told) = alarms(1800, |estimate, noise| {
            set(estimate, if estimate.seq / 300 % 2 == 1 { 0.5 } else { 0.0 }, noise);
        });
        assert_eq!((told.len(), drift.alarms().len()), (3, 3));
    }

    #[test]
    fn rays_that_do_not_meet_at_all_are_told_and_one_strange_thing_is_not() {
        let missing = |estimate: &mut Estimate, markers: &[usize]| {
            for &m in markers {
                estimate.markers[m].position = Err(Miss::RaysDiverge { distance_m: 0.004 });
            }
        };
        let (_, told) = alarms(300, |estimate, _| missing(estimate, &[1, 2]));
        let [alarm] = told[..] else { panic!("{told:?}") };
        assert_eq!((alarm.seq, alarm.view, alarm.size_px), (59, None, None));
        assert!((alarm.size_m - 0.004).abs() < 1e-12);
        let (_, told) = alarms(300, |estimate, _| missing(estimate, &[2]));
        assert_eq!(told, []);
    }

    #[test]
    fn less_than_a_second_is_not_judged() {
        let (_, told) = alarms(59, |estimate, noise| set(estimate, 2.0, noise));
        assert_eq!(told, []);
        let (_, told) = alarms(60, |estimate, noise| set(estimate, 2.0, noise));
        assert_eq!(told.len(), 1);
    }
}
