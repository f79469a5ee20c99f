//! [`Drift`]: is the rig still as it was calibrated? A mirror, camera or tank that has moved since shows in errors that
//! do not average out.
//!
//! In: the estimates of a run, in order. Out: a [`DriftAlarm`] when drift begins, which is kept when it is over.
//! Estimates are only read.
//!
//! Two things are watched, each over the last few seconds, in blocks of frames:
//! - whether the views agree on where the bands are (`views`);
//! - whether the base band is at the origin of the base frame, if the rig has one (`base`).
//!
//! A run that is too short for the scatter of its blocks is judged at its end ([`Drift::end`]), as if the errors were
//! the same in all its frames.
//!
//! What neither can detect: camera, mirror, tank and clamp that moved together.

mod base;
mod views;

use crate::estimate::Estimate;
use crate::rig::Rig;
use crate::source::Timestamp;
use base::BaseBand;
use nalgebra::{SMatrix, SVector};
use std::collections::VecDeque;
use views::Views;

/// Frames of a block. Measured on the sample, the autocorrelation of residuals is 0.35 from frame to frame and below
/// 0.15 after ten.
const BLOCK: u32 = 10;
/// Blocks to look back at, most and fewest: 3 s and 1 s at 60 Hz.
const BLOCKS: (usize, usize) = (18, 6);
/// An alarm ends when its quantity falls below this fraction of what raises one.
const ALARM_RELEASE: f64 = 0.5;

/// Watches a run for drift.
#[derive(Debug, Clone, Default)]
pub struct Drift {
    frames: u64,
    /// Number and camera time of the last frame.
    last: Option<(u64, Timestamp)>,
    views: Views,
    base: Option<BaseBand>,
    /// The active alarm of the views, and of the base band.
    lasting: [Option<usize>; 2],
    /// What would have raised an alarm about them, at its largest, pixels and metres; `None` where they were not
    /// judged.
    limits: [Option<f64>; 2],
    alarms: Vec<DriftAlarm>,
}

/// Drift has begun, and may be over since.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DriftAlarm {
    /// Number of the frame at which it was noticed.
    pub seq: u64,
    /// Camera time of that frame.
    pub stamp: Timestamp,
    /// What is wrong, with its numbers at their largest.
    pub what: Drifted,
    /// Its size in space at the bands, metres, at its largest. A lower bound when rays do not meet.
    pub size_m: f64,
    /// Camera time of the frame at which it was over; `None` while it lasts.
    pub over: Option<Timestamp>,
}

/// What is wrong.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Drifted {
    /// The views disagree.
    Views {
        /// The view with the largest mean residual. With only two views, the other may equally be the wrong one.
        view: usize,
        /// Their mean disagreement, pixels.
        size_px: f64,
        /// Its standard deviation.
        sd_px: f64,
    },
    /// The views disagree so much that their rays do not meet in one band: there are no residuals.
    Apart,
    /// The base band is not at the origin of the base frame.
    Base {
        /// Standard deviation of the distance, metres.
        sd_m: f64,
    },
}

impl DriftAlarm {
    /// What has happened, as a phrase: `views direct and mirror disagree by 0.45 px (0.27 mm, σ 0.01 px)`; `views` are
    /// the rig's view names.
    pub fn words(&self, views: &[&str]) -> String {
        let mm = self.size_m * 1e3;
        match self.what {
            Drifted::Views { view, size_px, sd_px } => {
                let who = match views.get(view) {
                    Some(view) if views.len() > 2 => format!("view {view} disagrees with the others"),
                    _ => format!("views {} disagree", views.join(" and ")),
                };
                format!("{who} by {size_px:.2} px ({mm:.2} mm, σ {sd_px:.2} px)")
            }
            Drifted::Apart => {
                format!("views {} disagree by {mm:.1} mm and more, rays do not meet", views.join(" and "))
            }
            Drifted::Base { sd_m } => format!(
                "the base band stands {mm:.2} mm (σ {:.2} mm) from where `catoptra calibrate base` found it",
                sd_m * 1e3
            ),
        }
    }

    /// What it means and what to do.
    pub fn advice(&self) -> &'static str {
        match self.what {
            Drifted::Apart => {
                "the rig is that of another recording, mirror, camera or tank have moved since the calibration, or the \
                 pictures are mirrored, turned or scaled. If it was the mirror, put the rig right with \
                 `catoptra calibrate mirror --from-markers VIDEO --rig RIG.toml`, and track again"
            }
            Drifted::Views { .. } => {
                "mirror, camera or tank have moved since the calibration. Put the rig right with \
                 `catoptra calibrate mirror --from-markers VIDEO --rig RIG.toml`, and track again"
            }
            Drifted::Base { .. } => {
                "camera, mirror, tank or the catheter's clamp have moved since. If it was a mirror, put it right with \
                 `catoptra calibrate mirror --from-markers VIDEO --rig RIG.toml`; then, or if the clamp was, run \
                 `catoptra calibrate base` again"
            }
        }
    }

    /// Its kind as a word: `views_disagree`, `rays_apart`, `base_moved`.
    pub fn word(&self) -> &'static str {
        match self.what {
            Drifted::Views { .. } => "views_disagree",
            Drifted::Apart => "rays_apart",
            Drifted::Base { .. } => "base_moved",
        }
    }
}

/// What the last blocks tell about one of the watched quantities.
struct Finding {
    what: Drifted,
    size_m: f64,
    /// Whether it is significant, and large enough for an alarm.
    raises: bool,
    /// Whether an active alarm ends.
    ends: bool,
    /// The size from which on it raises an alarm, pixels for the views and metres for the base band; `None` where there
    /// is no such size.
    limit: Option<f64>,
}

impl Drift {
    /// The watch over a run with this rig, before its first frame.
    pub fn new(rig: &Rig) -> Self {
        Self { views: Views::new(rig), base: BaseBand::new(rig), ..Self::default() }
    }

    /// All alarms so far, in order.
    pub fn alarms(&self) -> &[DriftAlarm] {
        &self.alarms
    }

    /// A mean disagreement of the views beyond this would have raised an alarm, pixels; `None` where it was not judged.
    pub(crate) fn views_limit_px(&self) -> Option<f64> {
        self.limits[0]
    }

    /// A mean distance of the base band from its origin beyond this would have raised an alarm, metres; `None` where it
    /// was not judged.
    pub(crate) fn base_limit_m(&self) -> Option<f64> {
        self.limits[1]
    }

    /// Adds a frame; returns the alarms that it raises: one when drift begins, and no other until it is over.
    pub fn add(&mut self, estimate: &Estimate) -> &[DriftAlarm] {
        let before = self.alarms.len();
        self.frames += 1;
        self.last = Some((estimate.seq, estimate.stamp));
        self.views.add(estimate);
        if let Some(base) = &mut self.base {
            base.add(estimate);
        }
        if self.frames.is_multiple_of(u64::from(BLOCK)) {
            let found = [self.views.found(), self.base.as_mut().and_then(BaseBand::found)];
            self.follow(found);
        }
        self.alarms.get(before..).unwrap_or_default()
    }

    /// The run is over: judges what was not judged in it, from the frames that there are.
    pub fn end(&mut self) {
        let [views, base] = self.limits.map(|limit| limit.is_none());
        let found_base = || self.base.as_ref()?.found_at_end();
        let found = [views.then(|| self.views.found_at_end()).flatten(), base.then(found_base).flatten()];
        self.follow(found);
    }

    fn follow(&mut self, found: [Option<Finding>; 2]) {
        let Some(frame) = self.last else { return };
        for ((lasting, limit), found) in self.lasting.iter_mut().zip(&mut self.limits).zip(found) {
            // What cannot be judged, as with hidden bands, neither begins nor ends.
            let Some(found) = found else { continue };
            *limit = [*limit, found.limit].into_iter().flatten().reduce(f64::max);
            follow(lasting, &mut self.alarms, found, frame);
        }
    }
}

/// Raises, keeps or ends the alarm about one thing.
fn follow(lasting: &mut Option<usize>, alarms: &mut Vec<DriftAlarm>, found: Finding, (seq, stamp): (u64, Timestamp)) {
    let Finding { what, size_m, raises, ends, .. } = found;
    if let Some(alarm) = lasting.and_then(|index| alarms.get_mut(index)) {
        if size_m > alarm.size_m {
            (alarm.what, alarm.size_m) = (what, size_m);
        }
        if ends {
            alarm.over = Some(stamp);
            *lasting = None;
        }
    } else if raises {
        *lasting = Some(alarms.len());
        alarms.push(DriftAlarm { seq, stamp, what, size_m, over: None });
    }
}

/// The last blocks and the one being filled.
#[derive(Debug, Clone, Default)]
struct Window<B> {
    open: B,
    blocks: VecDeque<B>,
}

impl<B: Default> Window<B> {
    /// Ends the open block; the oldest of those to look back at is dropped.
    fn close(&mut self) {
        self.blocks.push_back(std::mem::take(&mut self.open));
        if self.blocks.len() > BLOCKS.0 {
            self.blocks.pop_front();
        }
    }

    /// The blocks, and what there is of the open one.
    fn all(&self) -> impl Iterator<Item = &B> + Clone {
        self.blocks.iter().chain([&self.open])
    }
}

/// A weighted mean of a block: Σ C⁻¹ and Σ C⁻¹ x of values x with covariance C, and in how many frames they were seen.
#[derive(Debug, Clone)]
struct Sum<const D: usize> {
    weight: SMatrix<f64, D, D>,
    pull: SVector<f64, D>,
    frames: u32,
}

impl<const D: usize> Default for Sum<D> {
    fn default() -> Self {
        Self { weight: SMatrix::zeros(), pull: SVector::zeros(), frames: 0 }
    }
}

impl<const D: usize> Sum<D> {
    /// Adds the values of a frame, with their covariances. Values without a finite weight have no part.
    fn add(&mut self, values: impl IntoIterator<Item = (SVector<f64, D>, SMatrix<f64, D, D>)>) {
        let mut seen = false;
        for (value, covariance) in values {
            let Some(weight) = covariance.try_inverse() else { continue };
            let pull = weight * value;
            if weight.iter().chain(&pull).all(|v| v.is_finite()) {
                self.weight += weight;
                self.pull += pull;
                seen = true;
            }
        }
        self.frames += u32::from(seen);
    }

    fn mean(&self) -> Option<SVector<f64, D>> {
        Some(self.weight.try_inverse()? * self.pull)
    }
}

/// The mean of blocks' means, and the standard deviation of its length from their scatter; `None` when there are too
/// few.
fn mean<'a, const D: usize>(blocks: impl Iterator<Item = &'a Sum<D>>) -> Option<(SVector<f64, D>, f64)> {
    let means: Vec<SVector<f64, D>> = blocks.filter_map(Sum::mean).collect();
    if means.len() < BLOCKS.1 {
        return None;
    }
    let mean = means.iter().sum::<SVector<f64, D>>() / means.len() as f64;
    Some((mean, scatter_along(mean, &means)))
}

/// The mean of too few blocks for [`mean`], and the standard deviation of its length: that of a single frame, because
/// errors may be the same in all of them, and the scatter of the blocks where there are several. `None` when nothing
/// was seen.
fn mean_of_few<'a, const D: usize>(blocks: impl Iterator<Item = &'a Sum<D>> + Clone) -> Option<(SVector<f64, D>, f64)> {
    let mut total = Sum::default();
    for block in blocks.clone() {
        total.weight += block.weight;
        total.pull += block.pull;
        total.frames += block.frames;
    }
    let covariance = total.weight.try_inverse()?;
    let mean = covariance * total.pull;
    let along = direction(mean);
    let of_frame = (f64::from(total.frames) * along.dot(&(covariance * along))).sqrt();
    let means: Vec<SVector<f64, D>> = blocks.filter_map(Sum::mean).collect();
    let scatter = if means.len() > 1 { scatter_along(mean, &means) } else { 0.0 };
    Some((mean, of_frame.hypot(scatter)))
}

/// Standard deviation of a mean of blocks along its direction, from the scatter of the blocks about it.
fn scatter_along<const D: usize>(mean: SVector<f64, D>, means: &[SVector<f64, D>]) -> f64 {
    let along = direction(mean);
    let squares: f64 = means.iter().map(|m| (m - mean).dot(&along).powi(2)).sum();
    let count = means.len() as f64;
    (squares / (count - 1.0) / count).sqrt()
}

fn direction<const D: usize>(mean: SVector<f64, D>) -> SVector<f64, D> {
    mean.try_normalize(0.0).unwrap_or_else(|| SVector::<f64, D>::repeat(1.0).normalize())
}

#[cfg(test)]
mod tests;
