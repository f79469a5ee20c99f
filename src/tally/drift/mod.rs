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
//! What neither can detect: camera, mirror, tank and clamp that moved together.

mod base;
mod views;

use crate::estimate::Estimate;
use crate::rig::Rig;
use crate::source::Timestamp;
use base::BaseBand;
use nalgebra::SVector;
use std::collections::VecDeque;
use views::Views;

/// Frames of a block. Measured on the sample, the autocorrelation of residuals is 0.35 from frame to frame and below
/// 0.15 after ten.
const BLOCK: u32 = 10;
/// Blocks to look back at, most and fewest: 3 s and 1 s at 60 Hz.
const BLOCKS: (usize, usize) = (18, 6);
/// Frames that are averaged to judge, most and fewest.
pub(crate) const FRAMES_JUDGED: (usize, usize) = (BLOCKS.0 * BLOCK as usize, BLOCKS.1 * BLOCK as usize);
/// An alarm ends when its quantity falls below this fraction of what raises one.
const ALARM_RELEASE: f64 = 0.5;

/// Watches a run for drift.
#[derive(Debug, Clone, Default)]
pub struct Drift {
    frames: u64,
    views: Views,
    base: Option<BaseBand>,
    /// The active alarm of the views, and of the base band.
    lasting: [Option<usize>; 2],
    /// Whether enough was seen of them to judge.
    judged: [bool; 2],
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
                "mirror, camera or tank have moved since the calibration, or the pictures are mirrored, turned or \
                 scaled. If it was the mirror, put the rig right with \
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

    /// Whether enough was seen to judge whether the views agree.
    pub(crate) fn views_are_judged(&self) -> bool {
        self.judged[0]
    }

    /// How far the base band may be from its origin without an alarm, metres, if enough was seen to judge that.
    pub(crate) fn base_limit_m(&self) -> Option<f64> {
        self.base.as_ref().filter(|_| self.judged[1]).map(BaseBand::limit_m)
    }

    /// Adds a frame; returns the alarms that it raises: one when drift begins, and no other until it is over.
    pub fn add(&mut self, estimate: &Estimate) -> &[DriftAlarm] {
        let before = self.alarms.len();
        self.frames += 1;
        self.views.add(estimate);
        if let Some(base) = &mut self.base {
            base.add(estimate);
        }
        if self.frames.is_multiple_of(u64::from(BLOCK)) {
            let found = [self.views.found(), self.base.as_mut().and_then(BaseBand::found)];
            for (judged, found) in self.judged.iter_mut().zip(&found) {
                *judged |= found.is_some();
            }
            for (lasting, found) in self.lasting.iter_mut().zip(found) {
                follow(lasting, &mut self.alarms, found, estimate);
            }
        }
        self.alarms.get(before..).unwrap_or_default()
    }
}

/// Raises, keeps or ends the alarm about one thing.
fn follow(lasting: &mut Option<usize>, alarms: &mut Vec<DriftAlarm>, found: Option<Finding>, estimate: &Estimate) {
    // What cannot be judged, as with hidden bands, neither begins nor ends.
    let Some(Finding { what, size_m, raises, ends }) = found else { return };
    if let Some(alarm) = lasting.and_then(|index| alarms.get_mut(index)) {
        if size_m > alarm.size_m {
            (alarm.what, alarm.size_m) = (what, size_m);
        }
        if ends {
            alarm.over = Some(estimate.stamp);
            *lasting = None;
        }
    } else if raises {
        *lasting = Some(alarms.len());
        alarms.push(DriftAlarm { seq: estimate.seq, stamp: estimate.stamp, what, size_m, over: None });
    }
}

/// The last blocks and the one being filled.
#[derive(Debug, Clone, Default)]
struct Window<B> {
    open: B,
    blocks: VecDeque<B>,
}

impl<B: Default> Window<B> {
    /// Ends the open block; returns the blocks to look back at.
    fn close(&mut self) -> &VecDeque<B> {
        self.blocks.push_back(std::mem::take(&mut self.open));
        if self.blocks.len() > BLOCKS.0 {
            self.blocks.pop_front();
        }
        &self.blocks
    }
}

/// The mean of blocks' means, and the standard deviation of its length from their scatter; `None` when there are too
/// few.
fn mean<const D: usize>(means: &[SVector<f64, D>]) -> Option<(SVector<f64, D>, f64)> {
    if means.len() < BLOCKS.1 {
        return None;
    }
    let count = means.len() as f64;
    let mean = means.iter().sum::<SVector<f64, D>>() / count;
    let along = mean.try_normalize(0.0).unwrap_or_else(|| SVector::<f64, D>::repeat(1.0).normalize());
    let squares: f64 = means.iter().map(|m| (m - mean).dot(&along).powi(2)).sum();
    Some((mean, (squares / (count - 1.0) / count).sqrt()))
}

#[cfg(test)]
mod tests;
