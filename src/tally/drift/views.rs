//! Do the views agree on where the bands are?
//!
//! Method: the residuals of all bands (a view alone minus the common result) are averaged over blocks of frames,
//! weighted by their covariance, and the blocks over the last few seconds. Views disagree when that mean is both
//! significant, many σ by the scatter of the blocks (which are longer than the correlation of a recording's errors),
//! and larger than the errors of the image and tube models. When they are so far apart that the tracker takes their
//! bands for different objects, there are no residuals: then the frames in which rays do not meet count.
//!
//! What it cannot detect: two views can contradict each other in only one direction, across the plane of camera,
//! mirrored camera and band (up and down for a mirror beside the tank). Whatever moves the image within that plane,
//! such as a mirror shifted along its normal or turned about an axis across that plane, changes the result but not the
//! residual; a camera and mirror that moved together change neither. Nor can it tell which of two views is wrong.

use crate::estimate::{Estimate, Miss};
use crate::optics::OpticalPath;
use crate::rig::Rig;
use crate::tally::drift::{ALARM_RELEASE, BLOCKS, Drifted, Finding, Sum, Window, mean, mean_of_few};
use nalgebra::{Point3, Vector2};

/// A mean is significant beyond this many standard deviations.
const SIGNIFICANT_SD: f64 = 6.0;
/// The views of a correct rig disagree by up to 0.09 px in the mean (the sample at rest), image models by 0.1 px.
const MIN_PX: f64 = 0.3;

/// Watches the residuals.
#[derive(Debug, Clone, Default)]
pub(crate) struct Views {
    optics: Vec<OpticalPath>,
    window: Window<Block>,
    /// Last position of a band, camera frame, metres: for the image scale.
    place: Option<Point3<f64>>,
}

#[derive(Debug, Clone, Default)]
struct Block {
    frames: u32,
    /// Frames in which at least half of the markers were refused because rays do not meet, and the sum of the
    /// distances.
    apart: u32,
    apart_sum_m: f64,
    /// The residuals in each view, pixels.
    residuals: Vec<Sum<2>>,
}

impl Views {
    pub(crate) fn new(rig: &Rig) -> Self {
        Self { optics: rig.views.iter().map(|view| view.optics.clone()).collect(), ..Self::default() }
    }

    pub(crate) fn add(&mut self, estimate: &Estimate) {
        self.window.open.add(estimate, self.optics.len());
        let place = estimate.markers.iter().find_map(|marker| marker.position.as_ref().ok());
        self.place = place.map(|position| position.point).or(self.place);
    }

    /// Ends a block; returns the finding of the last ones.
    pub(crate) fn found(&mut self) -> Option<Finding> {
        self.window.close();
        let blocks = &self.window.blocks;
        let enough = blocks.len() >= BLOCKS.1;
        let apart = enough.then(|| apart(blocks.iter())).flatten();
        apart.or_else(|| self.disagreement(|view| mean(blocks_of(blocks.iter(), view))))
    }

    /// The finding of a run that had too few frames for [`Self::found`].
    pub(crate) fn found_at_end(&self) -> Option<Finding> {
        let blocks = self.window.all();
        apart(blocks.clone()).or_else(|| self.disagreement(|view| mean_of_few(blocks_of(blocks.clone(), view))))
    }

    /// By how much views disagree, from each one's mean residual and its standard deviation.
    fn disagreement(&self, mean: impl Fn(usize) -> Option<(Vector2<f64>, f64)>) -> Option<Finding> {
        let mut means: Vec<(usize, f64, f64)> = (0..self.optics.len())
            .filter_map(|view| {
                let (mean, sd) = mean(view)?;
                Some((view, mean.norm(), sd))
            })
            .collect();
        means.sort_by(|a, b| b.1.total_cmp(&a.1));
        // A disagreement is split between two views in opposite directions, with more for the less certain one: it is
        // the sum of both, and so is its standard deviation.
        let [(view, first, first_sd), (_, second, second_sd), ..] = means[..] else { return None };
        let seen = self.optics.get(view)?.project_with_jacobian(&self.place?).ok()?;
        let px_per_m = seen.d_pixel.norm() / std::f64::consts::SQRT_2;
        let (size_px, sd_px) = (first + second, first_sd + second_sd);
        let limit_px = MIN_PX.max(SIGNIFICANT_SD * sd_px);
        Some(Finding {
            what: Drifted::Views { view, size_px, sd_px },
            size_m: size_px / px_per_m,
            raises: size_px > limit_px,
            ends: size_px <= ALARM_RELEASE * MIN_PX,
            limit: Some(limit_px),
        })
    }
}

fn blocks_of<'a>(
    blocks: impl Iterator<Item = &'a Block> + Clone,
    view: usize,
) -> impl Iterator<Item = &'a Sum<2>> + Clone {
    blocks.filter_map(move |block| block.residuals.get(view))
}

/// That rays do not meet in most of the frames, with their mean distance.
fn apart<'a>(blocks: impl Iterator<Item = &'a Block> + Clone) -> Option<Finding> {
    let frames: u32 = blocks.clone().map(|block| block.frames).sum();
    let apart: u32 = blocks.clone().map(|block| block.apart).sum();
    let sum_m: f64 = blocks.map(|block| block.apart_sum_m).sum();
    let size_m = sum_m / f64::from(apart);
    (2 * apart > frames).then_some(Finding { what: Drifted::Apart, size_m, raises: true, ends: false, limit: None })
}

impl Block {
    fn add(&mut self, estimate: &Estimate, views: usize) {
        self.frames += 1;
        self.residuals.resize(views, Sum::default());
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
        for (view, sum) in self.residuals.iter_mut().enumerate() {
            let located = estimate.markers.iter().filter(|marker| marker.position.is_ok());
            let bands = located.filter_map(|marker| marker.views.get(view)?.as_ref().ok());
            sum.add(bands.map(|band| (band.residual_px, band.covariance_px2)));
        }
    }
}
