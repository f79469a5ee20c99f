//! Parameters of the image model, and its errors. The blur of each view is beside it, because it may change (focus.rs).

use crate::source::{Picture, Quantisation};
use crate::track::model::functions::Encoding;
use crate::track::model::mosaic::Mosaic;

/// Parameters of the image model, the same for all views.
#[derive(Debug, Clone)]
pub(in crate::track) struct ImageModel {
    pub encoding: Encoding,
    /// Offset of the chroma samples from where the stream puts them, pixels.
    pub chroma_offset_px: [f64; 2],
    /// How far a subsampled one reaches, in distances between samples ([`crate::rig::Camera::chroma_reach`]).
    pub chroma_reach: [f64; 2],
    /// Of the sensor, if its pixels saw one colour each.
    pub mosaic: Option<Mosaic>,
    /// At the blur at which it was measured.
    pub error: ModelError,
    /// Assumed of the video that the pictures are a copy of, if they are (copied.rs), unless they are known to be
    /// converted from one (paired_chroma.rs).
    pub first_coded: Option<Quantisation>,
}

impl ImageModel {
    /// How coarsely a picture was quantised, by its own coder or by that of the video it is a copy of, whichever lost
    /// more; `None` when that is unknown, and without losses.
    pub(in crate::track) fn quantisation<'a>(&'a self, picture: &'a Picture) -> Option<&'a Quantisation> {
        let own = picture.quantisation();
        self.first_coded.as_ref().filter(|first| own.is_none_or(|own| first.is_coarser_than(own))).or(own)
    }

    /// Its errors in a picture. `converted` tells that it was made from one with subsampled chroma (paired_chroma.rs),
    /// `noisy` that it still has the noise of its sensor (sensor_noise.rs).
    pub(in crate::track) fn error_in(&self, picture: &Picture, converted: bool, noisy: bool) -> ModelError {
        match self.quantisation(picture) {
            Some(_) => ModelError::QUANTISED,
            None if converted || (may_be_coded(picture) && !noisy) => ModelError::CODED,
            None => ModelError::FULL,
        }
    }

    /// Whether a picture was predicted from others.
    pub(in crate::track) fn is_predicted(&self, picture: &Picture) -> bool {
        self.quantisation(picture).is_some_and(|quantisation| quantisation.predicted)
    }
}

/// Errors of the image model that no residual shows, pixels: shifts of the band across and along the tube, and turns
/// (by this much at half the stretch's length). They enter the covariance for each view separately.
///
/// Measured: on drawn RGB pictures without noise the fit is off by 0.01 to 0.03 px (directional light, blur); on H.264
/// with subsampled chroma by 0.03 px more than its residuals explain, and beside a clamp, where light and colour change
/// within a few pixels of the band's edge, by 0.12 px along the tube. Quantisation causes both a coder's shifts and its
/// residuals, so beyond the RMS residual of that measurement the error is assumed to grow with them. All were measured
/// at a blur of half a pixel. They are errors of how blurred edges are modelled, so with more blur they are larger:
/// squared errors in lossless pictures enlarged to 1.5, 2 and 3 times their size are 0.8 to 1.5 times what σ predicts.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct ModelError {
    pub across_px: f64,
    pub along_px: f64,
    pub turn_px: f64,
    pub along_at_clamp_px: f64,
    /// RMS residual beyond which all errors grow in proportion, stored units.
    pub coding_rms: f64,
    /// Of errors beyond all this that vary from frame to frame, the fraction of the variance that persists: a coder
    /// leaves an error until correcting it is worth the bits. Measured at crf 24: autocorrelations of 0.1 to 0.5 from
    /// one frame to the next.
    pub persisting: f64,
}

/// Blur of the pictures in which the errors were measured, pixels.
const MEASURED_BLUR_PX: f64 = 0.55;

impl ModelError {
    /// For pictures as the sensor gave them.
    pub(in crate::track) const FULL: Self = Self {
        across_px: 0.015,
        along_px: 0.015,
        turn_px: 0.02,
        along_at_clamp_px: 0.06,
        coding_rms: f64::INFINITY,
        persisting: 0.0,
    };
    /// For pictures whose coder says how coarsely it quantised ([`coder_variance`] has the rest).
    const QUANTISED: Self = Self {
        across_px: 0.027,
        along_px: 0.027,
        turn_px: 0.035,
        along_at_clamp_px: 0.08,
        coding_rms: f64::INFINITY,
        persisting: 0.0,
    };
    /// For pictures with subsampled chroma of unknown origin, without the noise of a sensor: a recorder may have
    /// quantised them.
    pub(in crate::track) const CODED: Self = Self {
        across_px: 0.029,
        along_px: 0.029,
        turn_px: 0.06,
        along_at_clamp_px: 0.12,
        coding_rms: 2.7,
        persisting: 0.5,
    };

    /// Errors common to all frames of a recording, including a coder's errors that stay while the tube does not move.
    pub(in crate::track) fn lasting(self) -> Self {
        if self == Self::FULL { self } else { Self::CODED }
    }

    /// The same in pictures of this blur.
    pub(in crate::track) fn blurred(self, blur_px: f64) -> Self {
        let by = (blur_px / MEASURED_BLUR_PX).max(1.0);
        let Self { across_px, along_px, turn_px, along_at_clamp_px, .. } = self;
        let [across_px, along_px, turn_px, along_at_clamp_px] =
            [across_px, along_px, turn_px, along_at_clamp_px].map(|error| by * error);
        Self { across_px, along_px, turn_px, along_at_clamp_px, ..self }
    }

    /// Factor by which it grows for residuals of this RMS.
    pub(in crate::track) fn growth(&self, rms: f64) -> f64 {
        (rms / self.coding_rms).max(1.0)
    }
}

/// Whether nothing but its noise tells whether a coder changed a picture.
pub(in crate::track) fn may_be_coded(picture: &Picture) -> bool {
    picture.quantisation().is_none() && picture.format().is_subsampled()
}

/// Variance of the samples equivalent to a coder's quantiser of this step, in squared stored units.
///
/// A coder that weighs bits against errors leaves a block where it was, or moves it by a wrong vector, as long as that
/// costs less than the bits to correct it: squared errors of up to λ R, where λ ≈ 0.14 step² (H.264's reference model:
/// 0.85 · 2^((q − 12) / 3)) and R is some eight bits. All samples of the block then give the same wrong position, and
/// no residual shows it. Spread evenly up to that limit and over two directions, it is a shift of variance κ step² / Σ
/// g² for gradients g of the block, κ ≈ 0.14 · 8 / 4: that of independent noise of variance κ step². Over recordings
/// coded from crf 10 to 23 squared errors are mostly 0.6 to 1.7 times what σ predicts (docs/formats.md).
///
/// An intra-coded picture has only the rounding of each coefficient: κ = 1/12.
pub(in crate::track) const fn coder_variance(step: f64, predicted: bool) -> f64 {
    let kappa = if predicted { PREDICTED } else { ROUNDED };
    kappa * step * step
}

const PREDICTED: f64 = 0.28;
const ROUNDED: f64 = 1.0 / 12.0;

/// What remains of the variance of predicted pictures where a tube rests, across it and along it. A block left in its
/// place is right there, so across, where luma shows the outline, only the rounding remains. Along the base band only
/// chroma shows its ends, which a coder smears also at rest: in two recordings of two scenes each the variance was 0.2
/// step² (0.09 to 0.28). Where the contrast of an end or an outline is not above the step it is several times that
/// (docs/formats.md): the coder need not code it at all.
pub(in crate::track) const AT_REST: [f64; 2] = [ROUNDED / PREDICTED, 0.2 / PREDICTED];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_coder_that_leaves_more_moves_more_and_noise_moves_nothing() {
        assert!((ModelError::CODED.growth(1.0) - 1.0).abs() < 1e-12);
        assert!((ModelError::CODED.growth(2.0 * ModelError::CODED.coding_rms) - 2.0).abs() < 1e-12);
        assert!((ModelError::FULL.growth(20.0) - 1.0).abs() < 1e-12);
    }

    #[test]
    fn twice_the_blur_has_twice_the_errors_and_less_blur_the_same() {
        let twice = ModelError::QUANTISED.blurred(2.0 * MEASURED_BLUR_PX);
        assert!((twice.across_px - 2.0 * ModelError::QUANTISED.across_px).abs() < 1e-12);
        assert!((twice.along_at_clamp_px - 2.0 * ModelError::QUANTISED.along_at_clamp_px).abs() < 1e-12);
        assert_eq!(ModelError::FULL.blurred(0.3), ModelError::FULL);
    }
}
