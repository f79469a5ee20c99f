//! What calibration asks of a [`Tracker`]: how well a rig explains pictures, and what is usual in them.

use super::{COMPARED_PX, Tracker};
use crate::source::{Frame, Picture};
use crate::track::assign::Found;
use crate::track::compare::chroma_slip::Seen;
use crate::track::compare::sensor_noise::Grain;
use crate::track::fit::group_fit::Fitted;
use crate::track::fit::tube_fit::ViewFit;
use crate::track::model::image_model::ModelError;
use nalgebra::Vector2;

impl Tracker {
    /// Errors of the image model common to all frames so far, of which `picture` is one. Noise tells nothing of what
    /// stays.
    pub(crate) fn lasting_error(&self, picture: &Picture) -> ModelError {
        self.model.error_in(picture, self.pairs.are_alike(), false).lasting().blurred(self.focus.most_px())
    }

    /// The residual that is usual for a band in each view, RMS in grey values; empty while too few frames were
    /// measured, and for a band that is fitted together with another.
    pub(crate) fn usual_residuals(&self, marker: usize) -> Vec<f64> {
        self.judge.usual.values(marker).unwrap_or_default()
    }

    /// How badly the tube's model fits the picture around the bands (mean ln σ² of the residuals, all groups of equal
    /// weight); `None` when not all could be fitted. Neither uses nor changes the memory.
    pub(crate) fn misfit(&mut self, frame: &Frame) -> Option<f64> {
        let (found, fitted) = self.fit_alone(frame)?;
        let misfits =
            fitted.iter().map(|f| f.result.as_ref().map(|fit| fit.misfit).ok()).collect::<Option<Vec<_>>>()?;
        (!misfits.is_empty() && found.is_complete()).then(|| misfits.iter().sum::<f64>() / misfits.len() as f64)
    }

    /// The same for a frame that closely follows another: the motion between them blurs it.
    pub(crate) fn misfit_after(&mut self, before: &Frame, frame: &Frame) -> Option<f64> {
        self.before.fill(None);
        let (_, fitted) = self.fit_alone(before)?;
        self.keep_shapes(before.stamp, &fitted);
        let misfit = self.misfit(frame);
        self.before.fill(None);
        misfit
    }

    /// How far the chroma of pictures of one format lies from where the rig says, pixels (right, down): the mean over
    /// those frames, each without any memory.
    pub(crate) fn mean_slip_px(&mut self, frames: &[&Frame]) -> Vector2<f64> {
        let mut slip = Seen::default();
        for frame in frames {
            self.views_alone(frame).for_each(|view| slip.add(&view.slip));
        }
        frames.first().map_or_else(Vector2::zeros, |frame| slip.mean_px_in(frame.picture.format()))
    }

    /// Whether those frames have the noise of their sensor, each without any memory; of subsampled pictures whose coder
    /// is not known.
    pub(crate) fn have_sensor_noise(&mut self, frames: &[&Frame]) -> bool {
        let mut noise = Grain::default();
        for frame in frames {
            self.views_alone(frame).filter_map(|view| view.grain).for_each(|view| noise.add(&view));
        }
        noise.is_sensor()
    }

    /// All views of a frame's bands, fitted without any memory.
    fn views_alone(&mut self, frame: &Frame) -> impl Iterator<Item = ViewFit> + use<> {
        let fitted = self.fit_alone(frame).map_or(Vec::new(), |(_, fitted)| fitted);
        fitted.into_iter().flat_map(|fitted| fitted.result).flat_map(|fit| fit.views)
    }

    /// Finds and fits the bands of a frame without any memory.
    fn fit_alone(&mut self, frame: &Frame) -> Option<(Found, Vec<Fitted>)> {
        let found = self.finder.find_alone(&self.rig, frame)?;
        self.follow_chroma(frame.picture.format());
        self.look_for_mosaic(&frame.picture, &found);
        let fitted = self.fit(frame, &found, COMPARED_PX);
        Some((found, fitted))
    }
}
