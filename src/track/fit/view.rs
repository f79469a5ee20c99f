//! One view in a round of the fit: its samples, their noise, and the prior of its colours.

use crate::source::{Picture, Quantisation};
use crate::track::compare::comparison::{Comparison, Noise};
use crate::track::compare::no_fit::NoFit;
use crate::track::compare::patch::{Patch, Shown};
use crate::track::compare::places::Density;
use crate::track::compare::prediction::Scene;
use crate::track::compare::view_equations::{Normal, Squares};
use crate::track::model::appearance::{CAP, GRADIENT, SHADING, TURNING};
use crate::track::model::image_model::{ImageModel, coder_variance};
use crate::track::model::stretch::Stretch;
use crate::track::model::tube_image::TubeImage;
use std::sync::Arc;

/// Prior σ of colours about their initial values (linear light, 1 = white), of the background's gradient per pixel, of
/// shading, of its change per radian of turn, and of the cap.
const COLOUR_SD: f64 = 0.15;
const GRADIENT_SD: f64 = 0.02;
const SHADING_SD: f64 = 0.2;
const TURNING_SD: f64 = 1.0;
const CAP_SD: f64 = 0.5;
/// Noise assumed initially, stored units; and the least ever assumed (little more than rounding to integers).
const START_NOISE: f64 = 2.5;
pub(super) const MIN_NOISE: f64 = 0.5;

/// Variance of a coder beyond which σ no longer covers its errors: that of predicted pictures with a quantiser step of
/// 58 (level 39, H.265's usual one in B pictures), squared stored units.
const COARSEST: f64 = coder_variance(58.0, true);

/// How the samples are weighted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Weighing {
    /// By an assumed noise.
    Assumed,
    /// By the noise of their residuals in the first comparison.
    Own,
}

/// How the samples are selected and weighted.
#[derive(Clone, Copy)]
pub(super) struct Selection {
    pub density: Density,
    /// Background on either side of the tube, pixels.
    pub margin_px: f64,
    pub weighing: Weighing,
}

/// A view's samples.
pub(super) struct View {
    pub comparison: Comparison,
    /// Initial colours, from the picture.
    pub expected_colours: Vec<f64>,
    noise: Noise,
    weighing: Weighing,
    /// Whether it was compared before.
    compared: bool,
}

impl View {
    /// Selects the samples around an image of the stretch between two arc lengths. The initial colours are looked up in
    /// the picture unless they are known.
    ///
    /// # Errors
    /// When it is outside the picture, or not all of it was recorded.
    pub(super) fn select(
        stretch: &Stretch,
        range_m: (f64, f64),
        image: &TubeImage,
        picture: &Picture,
        model: &ImageModel,
        Selection { density, margin_px, weighing }: Selection,
        known_colours: Option<Vec<f64>>,
    ) -> Result<Self, NoFit> {
        let shown = Shown { image, layout: &stretch.layout, range_m };
        let comparison = Comparison::select(picture, model, &shown, density, margin_px)?;
        let patch = comparison.patch();
        if model.quantisation(picture).is_some_and(|q| coded_variance(q, patch) > COARSEST) {
            return Err(NoFit::TooCoarse);
        }
        let looked_up = || patch.colours(picture, image, &stretch.layout, &model.encoding);
        let expected_colours = known_colours.or_else(looked_up).ok_or(NoFit::OutOfPicture)?;
        let noise = start_noise(picture);
        Ok(Self { comparison, expected_colours, noise, weighing, compared: false })
    }

    /// Renders the view and sums its normal equations, the prior of its colours included. With the equations `before`,
    /// the last ones of a very similar image, only the gradient is new.
    pub(super) fn compare(&mut self, scene: &Scene<'_>, picture: &Picture, before: Option<&Normal>) -> Normal {
        self.comparison.render(scene);
        let is_first = !std::mem::replace(&mut self.compared, true);
        if is_first && self.weighing == Weighing::Own {
            self.noise = noise_of(&self.comparison.squares(&self.noise), picture);
        }
        let colours = scene.colours;
        let mut normal = match before {
            Some(before) => self.comparison.gradient(before, scene, &self.noise),
            None => {
                let mut normal = self.comparison.normal(scene, &self.noise);
                let own = &mut Arc::make_mut(&mut normal.hessian).colours;
                (0..colours.len()).for_each(|i| own[(i, i)] += prior(i).1.powi(-2));
                normal
            }
        };
        for (i, (value, expected)) in colours.iter().zip(&self.expected_colours).enumerate() {
            // This keeps a colour in bounds when hardly any sample shows it.
            let (known, sd) = prior(i);
            let (offset, weight) = (value - known.unwrap_or(*expected), sd.powi(-2));
            normal.colour_gradient[i] -= weight * offset;
            normal.cost += weight * offset * offset;
        }
        normal
    }
}

/// Mean variance of a coder's errors of luma around the tube.
fn coded_variance(quantisation: &Quantisation, patch: &Patch) -> f64 {
    let steps = patch.squares.iter().filter_map(|pixel| quantisation.step_at(*pixel));
    let variances = steps.map(|step| coder_variance(step, quantisation.predicted));
    let (sum, count) = variances.fold((0.0, 0), |(sum, count), variance| (sum + variance, count + 1));
    sum / f64::from(count.max(1))
}

/// Prior of a colour: its value, unless that is the initial one, and σ.
fn prior(colour: usize) -> (Option<f64>, f64) {
    match colour {
        GRADIENT..SHADING => (Some(0.0), GRADIENT_SD),
        SHADING..TURNING => (Some(0.0), SHADING_SD),
        TURNING..CAP => (Some(0.0), TURNING_SD),
        CAP => (Some(1.0), CAP_SD),
        _ => (None, COLOUR_SD),
    }
}

/// By how much chroma is known worse than its noise tells. Errors of a subsampled channel are common to about as many
/// samples as it has pixels per sample: a codec quantises them in the same small blocks. Measured sums of their
/// autocorrelation are 4 to 6 for 4:2:0, 1.5 for luma. Chroma of each pixel has so little noise that errors of the
/// image model exceed it: weighted by its noise it turned the tangent by 0.14°, with this by 0.11°, with all bands as
/// accurate.
fn correlated(picture: &Picture, channel: usize) -> f64 {
    const CHROMA: f64 = 2.0;
    match picture.plane(channel) {
        Some(plane) if channel > 0 && picture.format().is_yuv() => {
            f64::from(plane.scale[0] * plane.scale[1]).sqrt().max(CHROMA)
        }
        _ => 1.0,
    }
}

/// Noise assumed initially.
fn start_noise(picture: &Picture) -> Noise {
    [0, 1, 2].map(|c| [START_NOISE * correlated(picture, c).sqrt(); 2])
}

/// Noise of the residuals; the initial one where there are none.
fn noise_of(squares: &Squares, picture: &Picture) -> Noise {
    let mut noise = start_noise(picture);
    for (c, (sigma, squares)) in noise.iter_mut().zip(squares).enumerate() {
        for (sigma, (sum, count)) in sigma.iter_mut().zip(squares) {
            if *count > 0 {
                *sigma = (sum / *count as f64).sqrt().max(MIN_NOISE) * correlated(picture, c);
            }
        }
    }
    noise
}
