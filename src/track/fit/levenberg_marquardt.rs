//! One least-squares minimisation over fixed samples (Levenberg-Marquardt): finds the shape and colours that fit the
//! pictures best.

use crate::optics::OpticalPath;
use crate::source::Picture;
use crate::track::compare::joint_equations::{Equations, Step};
use crate::track::compare::no_fit::NoFit;
use crate::track::compare::prediction::Scene;
use crate::track::fit::view::View;
use crate::track::model::image_model::ImageModel;
use crate::track::model::stretch::Stretch;
use crate::track::model::tube_image::{Sweep, TubeImage};
use crate::track::model::tube_shape::TubeShape;
use nalgebra::{DVector, Vector2};
use rayon::prelude::*;

/// Distance of the knots along the tube, metres.
const KNOT_M: f64 = 3e-3;
/// Over such a short distance the matrix of the equations hardly changes: half the blur, pixels (RMS along the
/// stretch). Further away a step by the old one converges slowly.
const CLOSE_PX: f64 = 0.3;
/// A step this short ends a round: what it leaves is its square over the blur, a thousandth of a pixel.
const SETTLED_PX: f64 = 0.03;
/// Most need three; a wide tube whose start is some pixels off needs thirty.
const MAX_EVALUATIONS: usize = 40;
/// Levenberg's damping: initial, and least: smaller values do not change a step but take long to recover from.
const DAMPING: f64 = 1e-4;
const MIN_DAMPING: f64 = 1e-6;

/// What is compared.
pub(super) struct Round<'a> {
    pub stretch: &'a Stretch,
    pub paths: &'a [&'a OpticalPath],
    pub blurs_px: &'a [Vector2<f64>],
    pub picture: &'a Picture,
    pub model: &'a ImageModel,
    pub sweep: Option<&'a Sweep>,
    /// Whether the stretch is known not to move.
    pub rests: bool,
    /// Whether to look how far red and blue lie apart.
    pub looks_apart: bool,
    pub views: Vec<View>,
}

/// Shape and colours, and what they look like.
pub(super) struct Guess {
    pub shape: TubeShape,
    /// For each view.
    pub colours: Vec<Vec<f64>>,
    pub images: Vec<TubeImage>,
    /// Angles by which the tube has turned at each knot, radians.
    pub turns: Vec<Vector2<f64>>,
}

/// A guess and its comparison with the samples.
pub(super) struct State {
    pub guess: Guess,
    pub equations: Equations,
}

/// Where a round ended: the last guess that was compared with the samples, and the small step from there to the
/// minimum.
pub(super) struct Minimum {
    pub state: State,
    pub step: Step,
    pub end: Guess,
    /// How far that is from the start by way of all steps, pixels.
    pub way_px: f64,
}

impl Guess {
    /// `nearby` are images of the same stretch that may be similar; it may be empty.
    ///
    /// # Errors
    /// When part of it cannot be seen.
    pub(super) fn new(
        stretch: &Stretch,
        paths: &[&OpticalPath],
        shape: TubeShape,
        colours: Vec<Vec<f64>>,
        sweep: Option<&Sweep>,
        nearby: &[TubeImage],
    ) -> Result<Self, NoFit> {
        // Pixels beside the ends need an axis a little longer than the samples' range.
        let range = (stretch.range_m.0 - KNOT_M, stretch.range_m.1 + KNOT_M);
        let image = |(i, path): (usize, &&OpticalPath)| {
            TubeImage::of(&shape, stretch.radius_m, path, range, KNOT_M, sweep, nearby.get(i))
        };
        let images = paths.par_iter().enumerate().map(image).collect::<Result<_, _>>();
        let images: Vec<TubeImage> = images.map_err(|_| NoFit::OutOfPicture)?;
        // All images have the same knots.
        let knots = images.iter().take(1).flat_map(|image| &image.knots);
        let turns = knots.map(|knot| shape.turn(knot.arc_m)).collect();
        Ok(Self { shape, colours, images, turns })
    }

    /// How far it is from another of the same views, pixels: RMS along the stretch, in the view that shows it largest.
    fn moved(&self, other: &Self) -> f64 {
        self.images.iter().zip(&other.images).map(|(a, b)| a.distance(b)).fold(0.0, f64::max)
    }
}

impl Round<'_> {
    /// Iterates until a step is short, or lowers the cost (a χ²) by less than `enough`, as far as can be predicted.
    /// That last step is taken without evaluation.
    pub(super) fn minimise(&mut self, start: Guess, enough: f64) -> Result<Minimum, NoFit> {
        let mut state = self.evaluate(start, None);
        let mut damping = DAMPING;
        // Whether the matrix is that of a state before, and whether the comparisons are those of another guess.
        let (mut is_old, mut rejected) = (false, false);
        let mut way_px = 0.0;
        let mut known = Vec::new();
        for _ in 0..MAX_EVALUATIONS {
            let step = state.equations.step(damping, &mut known).ok_or(NoFit::NotConverged)?;
            let next = self.moved(&state.guess, &step);
            let moved_px = next.as_ref().map_or(f64::INFINITY, |next| next.moved(&state.guess));
            if moved_px < SETTLED_PX || step.predicted_decrease < enough {
                // The comparisons must be those of the state that is returned.
                if rejected {
                    state = self.evaluate(state.guess, None);
                }
                return Ok(Minimum { state, step, end: next?, way_px: way_px + moved_px });
            }
            let is_near = moved_px < CLOSE_PX && !rejected;
            match next.map(|guess| self.evaluate(guess, is_near.then_some(&state))) {
                Ok(next) if next.equations.cost <= state.equations.cost => {
                    state = next;
                    way_px += moved_px;
                    damping = (damping * 0.1).max(MIN_DAMPING);
                    (is_old, rejected) = (is_near, false);
                }
                // May be the fault of the old matrix.
                _ if is_old => {
                    state = self.evaluate(state.guess, None);
                    (is_old, rejected) = (false, false);
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
        Guess::new(self.stretch, self.paths, guess.shape.moved(&step.shape), colours, self.sweep, &guess.images)
    }

    /// Compares all views, and adds the prior of the shape. Near the state `before` only the gradient is new.
    fn evaluate(&mut self, mut guess: Guess, before: Option<&State>) -> State {
        let Self { stretch, picture, model, blurs_px, .. } = *self;
        // Its matrix is that of its turns: they count times a colour.
        if let Some(before) = before {
            guess.turns.clone_from(&before.guess.turns);
        }
        let turns = &guess.turns;
        let seen = self.views.par_iter_mut().zip(blurs_px).zip(&guess.images).zip(&guess.colours).enumerate();
        let views: Vec<_> = seen
            .map(|(i, (((view, blur_px), image), colours))| {
                let before = before.and_then(|before| before.equations.views.get(i));
                let scene = Scene::new(image, turns, colours, stretch, &model.encoding, *blur_px);
                view.compare(&scene, picture, before)
            })
            .collect();
        let prior = guess.shape.prior();
        let offset = guess.shape.parameters_of_bends();
        let prior_gradient = -(prior * offset);
        let cost = views.iter().map(|view| view.cost).sum::<f64>() - offset.dot(&prior_gradient);
        State { guess, equations: Equations { prior, prior_gradient, views, cost } }
    }
}
