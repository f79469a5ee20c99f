//! Whether a model of another order explains the data as well, or clearly better.
//!
//! In: the data and the refined model. Out: the lowest order that explains them about as well, and whether two states
//! more do clearly better: a weak mode that the model lacks bends its coefficients by more than σ, and what it leaves
//! may still pass for noise. Compared by likelihood, with the colour of what the nearest of the models leaves.

use crate::identify::checks::follows_input;
use crate::identify::checks::whitened_simulation::Whitened;
use crate::identify::data::segments::Segment;
use crate::identify::estimate::estimated::Refined;
use crate::identify::estimate::initial_models::initial_models;
use crate::identify::estimate::output_error;
use crate::identify::estimate::shortest_delay::Delayed;
use crate::identify::model::polynomials::Orders;

/// Difference of deviances that noise explains in all but one of a thousand records, for two coefficients more.
const BY_NOISE_LOWER: f64 = 13.8;
/// The same for four, in all but one of 10⁵, where a resonance may be placed at any frequency.
const BY_NOISE_HIGHER: f64 = 40.0;

/// The lowest order with which a model explains the data about as well.
pub(in crate::identify) fn lowest(training: &[Segment], refined: &Refined) -> Option<usize> {
    let order = refined.estimated.model.na();
    let as_well = |fewer: &usize| by_more(training, refined, order - fewer).is_some_and(|m| m > -BY_NOISE_LOWER);
    (1..order).take_while(as_well).last().map(|fewer| order - fewer)
}

/// The order of two states more, if that explains the data clearly better.
pub(in crate::identify) fn higher(training: &[Segment], refined: &Refined) -> Option<usize> {
    let order = refined.estimated.model.na() + 2;
    by_more(training, refined, order).is_some_and(|more| more > BY_NOISE_HIGHER).then_some(order)
}

/// By how much the deviance of a model of `order` is less than that of the refined one.
fn by_more(training: &[Segment], refined: &Refined, order: usize) -> Option<f64> {
    // Rounding is no noise to compare by.
    follows_input::colour(training, &refined.estimated.model)?;
    let initial = initial_models(training, Orders { na: order, nb: order, nk: refined.estimated.model.nk });
    let other = output_error::refine_from_any(training, &initial).ok()?;
    let both = compared(training, &[refined.clone(), other]);
    Some(both.first()?.deviance() - both.last()?.deviance())
}

/// A refined model, and its deviance with the colour of noise that it is compared by.
#[derive(Debug, Clone)]
pub(in crate::identify) struct Tried {
    pub(in crate::identify) refined: Refined,
    deviance: f64,
}

impl Delayed for Tried {
    fn nk(&self) -> usize {
        self.refined.estimated.model.nk
    }

    fn deviance(&self) -> f64 {
        self.deviance
    }
}

/// Deviances of models of the same data. Taken for white, noise that is alike from sample to sample would make much of
/// differences that are none: all are judged by the colour of what the nearest model leaves.
pub(in crate::identify) fn compared(training: &[Segment], found: &[Refined]) -> Vec<Tried> {
    let variance = |refined: &&Refined| refined.estimated.noise_variance;
    let nearest = found.iter().min_by(|a, b| variance(a).total_cmp(&variance(b)));
    let colour = nearest.and_then(|refined| follows_input::colour(training, &refined.estimated.model));
    let whitened = |refined: &Refined| Whitened::of(training, &refined.estimated.model, &[], colour.as_ref()?);
    let of_colour: Option<Vec<f64>> = found.iter().map(|found| Some(whitened(found)?.deviance())).collect();
    // Deviances of both kinds cannot be compared.
    let deviances = of_colour.unwrap_or_else(|| {
        let as_white = |found: &Refined| found.estimated.samples as f64 * found.estimated.noise_variance.ln();
        found.iter().map(as_white).collect()
    });
    found.iter().cloned().zip(deviances).map(|(refined, deviance)| Tried { refined, deviance }).collect()
}
