//! One least-squares minimisation over fixed samples (Levenberg-Marquardt): shape and colours that explain the pictures.

use super::appearance::{CAP, GRADIENT, SHADING, Scene};
use super::compare::{Comparison, Noise};
use super::equations::{Equations, Step};
use super::fit::NoFit;
use super::image_model::ImageModel;
use super::normal::Squares;
use super::stretch::Stretch;
use super::tube::{SHAPE, TubeShape};
use super::tube_image::TubeImage;
use crate::optics::OpticalPath;
use crate::source::Picture;
use nalgebra::{DVector, SMatrix};

/// Distance of the knots along the tube, metres.
const KNOT_M: f64 = 3e-3;
/// Prior σ of the shape's parameters: centre and tangent free, curvatures in 1/m, their change in 1/m².
const CURVATURE_SD: f64 = 30.0;
const CURVATURE_RATE_SD: f64 = 200.0;
/// Prior σ of colours about what they look like (linear light, 1 = white), of the background's gradient per pixel, of shading, cap.
const COLOUR_SD: f64 = 0.15;
const GRADIENT_SD: f64 = 0.02;
const SHADING_SD: f64 = 0.2;
const CAP_SD: f64 = 0.5;
/// Noise assumed before any is known, stored units; and the least ever assumed (rounding to integers and little more).
const START_NOISE: f64 = 2.5;
pub(crate) const LEAST_NOISE: f64 = 0.5;
/// Most need three; a wide tube whose start is some pixels off needs thirty.
const MAX_EVALUATIONS: usize = 40;
/// Levenberg's damping: at the start, and the least: lower ones make no difference to a step, but take long to come back from.
const DAMPING: f64 = 1e-4;
const LEAST_DAMPING: f64 = 1e-6;

/// What is compared.
pub(crate) struct Round<'a> {
    pub stretch: &'a Stretch,
    pub paths: &'a [&'a OpticalPath],
    pub picture: &'a Picture,
    pub model: &'a ImageModel,
    /// One a view.
    pub comparisons: Vec<Comparison>,
    /// Of each view, by their looks.
    pub expected_colours: Vec<Vec<f64>>,
    /// Of each view's samples; `None`: as the residuals of the first evaluation have it.
    pub noise: Option<Vec<Noise>>,
}

/// Shape and colours, and what they look like.
pub(crate) struct Guess {
    pub shape: TubeShape,
    /// Of each view.
    pub colours: Vec<Vec<f64>>,
    pub images: Vec<TubeImage>,
}

/// A guess, and what the samples say about it.
pub(crate) struct State {
    pub guess: Guess,
    pub equations: Equations,
}

/// Where a round ended: the last guess that was compared with the samples, and the small step from there to the minimum.
pub(crate) struct Minimum {
    pub state: State,
    pub step: Step,
    pub end: Guess,
}

impl Guess {
    /// # Errors
    /// When a part of it cannot be seen.
    pub(crate) fn new(
        stretch: &Stretch,
        paths: &[&OpticalPath],
        shape: TubeShape,
        colours: Vec<Vec<f64>>,
    ) -> Result<Self, NoFit> {
        // Pixels beside the ends need an axis a little longer than the samples' range.
        let range = (stretch.range_m.0 - KNOT_M, stretch.range_m.1 + KNOT_M);
        let image = |path: &&OpticalPath| TubeImage::of(&shape, stretch.radius_m, path, range, KNOT_M);
        let images = paths.iter().map(image).collect::<Result<_, _>>().map_err(|_| NoFit::OutOfPicture)?;
        Ok(Self { shape, colours, images })
    }
}

/// A subsampled channel's errors are common to about as many samples as it has pixels a sample: a codec quantises them in
/// the same small blocks. Measured sums of their autocorrelation are 4 to 6 for 4:2:0, 1.5 for luma.
fn correlated(picture: &Picture, channel: usize) -> f64 {
    picture.plane(channel).map_or(1.0, |plane| f64::from(plane.scale[0] * plane.scale[1]).sqrt())
}

/// Noise before any is known.
pub(crate) fn start_noise(picture: &Picture) -> Noise {
    [0, 1, 2].map(|c| [START_NOISE * correlated(picture, c).sqrt(); 2])
}

/// Noise that residuals have; where there are none, as at the start.
fn noise_of(squares: &Squares, picture: &Picture) -> Noise {
    let mut noise = start_noise(picture);
    for (c, (sigma, squares)) in noise.iter_mut().zip(squares).enumerate() {
        for (sigma, (sum, count)) in sigma.iter_mut().zip(squares) {
            if *count > 0 {
                *sigma = (sum / *count as f64).sqrt().max(LEAST_NOISE) * correlated(picture, c);
            }
        }
    }
    noise
}

/// Information of the shape's prior.
pub(crate) fn shape_prior() -> SMatrix<f64, SHAPE, SHAPE> {
    let mut information = SMatrix::zeros();
    for i in 5..SHAPE {
        information[(i, i)] = if i < 9 { CURVATURE_SD } else { CURVATURE_RATE_SD }.powi(-2);
    }
    information
}

impl Round<'_> {
    /// Goes on until a step promises to lower the cost (a χ²) by less than `enough`. That one is taken untried.
    pub(crate) fn minimise(&mut self, start: Guess, enough: f64) -> Result<Minimum, NoFit> {
        let mut state = self.evaluate(start);
        let mut damping = DAMPING;
        let mut rejected = false;
        for _ in 0..MAX_EVALUATIONS {
            let step = state.equations.step(damping).ok_or(NoFit::NotConverged)?;
            let next = self.moved(&state.guess, &step);
            if step.promise < enough {
                // The comparisons must be those of the state that is returned.
                if rejected {
                    state = self.evaluate(state.guess);
                }
                return Ok(Minimum { state, step, end: next? });
            }
            match next.map(|guess| self.evaluate(guess)) {
                Ok(next) if next.equations.cost <= state.equations.cost => {
                    state = next;
                    damping = (damping * 0.1).max(LEAST_DAMPING);
                    rejected = false;
                }
                _ => {
                    damping *= 30.0;
                    rejected = true;
                }
            }
        }
        Err(NoFit::NotConverged)
    }

    fn moved(&self, guess: &Guess, step: &Step) -> Result<Guess, NoFit> {
        let add = |(colours, step): (&Vec<f64>, &DVector<f64>)| {
            colours.iter().zip(step.iter()).map(|(colour, step)| colour + step).collect()
        };
        let colours = guess.colours.iter().zip(&step.colours).map(add).collect();
        Guess::new(self.stretch, self.paths, guess.shape.moved(&step.shape), colours)
    }

    /// Renders all views and sums their normal equations, priors included.
    fn evaluate(&mut self, guess: Guess) -> State {
        let Self { stretch, picture, model, .. } = *self;
        let Guess { shape, colours, images } = &guess;
        let layout = &stretch.layout;
        for (comparison, (image, colours)) in self.comparisons.iter_mut().zip(images.iter().zip(colours)) {
            let ImageModel { encoding, blur_px, .. } = model;
            comparison.render(&Scene { image, layout, colours, blur_px: *blur_px, encoding });
        }
        let noise = self.noise.get_or_insert_with(|| {
            let judge = start_noise(picture);
            self.comparisons.iter().map(|comparison| noise_of(&comparison.squares(&judge), picture)).collect()
        });
        let compared = self.comparisons.iter_mut().zip(images).zip(noise.iter());
        let mut views: Vec<_> =
            compared.map(|((comparison, image), noise)| comparison.normal(image, layout, noise)).collect();

        let prior = shape_prior();
        let offset = shape.curvatures();
        let prior_gradient = -(prior * offset);
        let mut cost = -offset.dot(&prior_gradient);
        for ((view, colours), expected) in views.iter_mut().zip(colours).zip(&self.expected_colours) {
            for (i, (value, expected)) in colours.iter().zip(expected).enumerate() {
                // That keeps a colour in bounds when hardly a sample shows it.
                let (expected, sd) = match i {
                    GRADIENT..SHADING => (0.0, GRADIENT_SD),
                    SHADING..CAP => (0.0, SHADING_SD),
                    CAP => (1.0, CAP_SD),
                    _ => (*expected, COLOUR_SD),
                };
                let (offset, weight) = (value - expected, sd.powi(-2));
                view.colours[(i, i)] += weight;
                view.colour_gradient[i] -= weight * offset;
                cost += weight * offset * offset;
            }
            cost += view.cost;
        }
        State { guess, equations: Equations { prior, prior_gradient, views, cost } }
    }
}
