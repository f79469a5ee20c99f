//! Samples of colours -> a linear discriminant for each marker, and how well it separates.
//!
//! Ridge regression of 1 on the marker's samples and 0 on all others, with both halves of equal weight and, among the
//! others, all classes of equal weight, whatever the number of their samples. The regression's scores are then
//! stretched so that they are 1 and 0 on average as [`ColourModel`] says: regression alone shrinks both towards their middle.
//! Source: Hastie, Tibshirani, Friedman, "The Elements of Statistical Learning" (2009), sections 3.4.1 and 4.2.

use crate::rig::ColourModel;
use nalgebra::{Matrix3, Vector3};

/// Samples of one class: a marker, or something that must not be taken for one (tube, background).
#[derive(Debug, Clone, PartialEq)]
pub struct ClassSamples {
    /// Its name, for messages.
    pub name: String,
    /// Whether a model is to be learned for it.
    pub is_marker: bool,
    /// R'G'B' 0..255, full range.
    pub rgb: Vec<Vector3<f64>>,
}

/// What was learned.
#[derive(Debug, Clone, PartialEq)]
pub struct Learned {
    /// One model for each marker class, in the order of the classes.
    pub models: Vec<ColourModel>,
    /// For each marker class, how far each other class is from it, in the order of the classes.
    pub separations: Vec<Separation>,
}

impl Learned {
    /// The pair that is separated least: that of the smallest gap.
    pub fn worst(&self) -> Option<&Separation> {
        self.separations.iter().min_by(|a, b| a.gap().total_cmp(&b.gap()))
    }
}

/// How a marker's model scores its own samples and those of another class.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Separation {
    /// Index of the marker's class among the samples.
    pub marker: usize,
    /// Index of the other class.
    pub other: usize,
    /// Difference of the mean scores over the root of the mean variance (infinite when neither varies).
    pub d_prime: f64,
    /// Score that 99 % of the marker's samples exceed.
    pub marker_low: f64,
    /// Score that 99 % of the other class' samples stay below.
    pub other_high: f64,
}

impl Separation {
    /// Distance between the low end of the marker's scores and the high end of the other's; positive when the
    /// two do not overlap.
    pub fn gap(&self) -> f64 {
        self.marker_low - self.other_high
    }

    /// Whether the threshold of the segmentation, half way from 0 to 1, lies between the two.
    pub fn is_separate(&self) -> bool {
        self.marker_low > 0.5 && self.other_high < 0.5
    }
}

/// Why no model can be learned.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum LearnError {
    /// Not enough samples of a class.
    #[error("class `{name}` has {found} samples, expected at least {LEAST_SAMPLES}")]
    TooFew {
        /// The class.
        name: String,
        /// How many it has.
        found: usize,
    },
    /// A sample that is no colour.
    #[error("class `{name}` has a sample of R'G'B' ({r}, {g}, {b}), expected finite numbers")]
    NotFinite {
        /// The class.
        name: String,
        /// R'.
        r: f64,
        /// G'.
        g: f64,
        /// B'.
        b: f64,
    },
    /// Nothing to learn, or nothing to tell it from.
    #[error("{markers} marker classes among {classes}, expected at least one marker and one other class")]
    NoContrast {
        /// Marker classes.
        markers: usize,
        /// All classes.
        classes: usize,
    },
    /// A marker whose mean score is that of everything else.
    #[error("the colour of `{0}` (mean of its samples) cannot be told from the other classes by any linear function")]
    SameColour(String),
}

/// Fewer samples say nothing about a class.
const LEAST_SAMPLES: usize = 8;

/// Ridge, as a share of the mean variance of a channel: enough to keep weights small where colours do not vary, too little
/// to matter where they do.
const RIDGE: f64 = 1e-3;

/// A contrast of the regression's mean scores (of 1) below this is rounding.
const LEAST_CONTRAST: f64 = 1e-6;

/// Learns a model for each marker class.
///
/// # Errors
/// [`LearnError`] when samples are missing or useless, or a marker has the very colour of the rest. Poor separation is no
/// error here: it is reported in [`Learned::separations`].
pub fn learn(classes: &[ClassSamples]) -> Result<Learned, LearnError> {
    check(classes)?;
    let mut learned = Learned { models: Vec::new(), separations: Vec::new() };
    for (marker, class) in classes.iter().enumerate().filter(|(_, c)| c.is_marker) {
        let model = discriminant(classes, marker).ok_or_else(|| LearnError::SameColour(class.name.clone()))?;
        let own = Scores::of(&model, class);
        for (other, class) in classes.iter().enumerate().filter(|&(other, _)| other != marker) {
            let theirs = Scores::of(&model, class);
            let sd = ((own.variance + theirs.variance) / 2.0).sqrt();
            learned.separations.push(Separation {
                marker,
                other,
                d_prime: (own.mean - theirs.mean) / sd,
                marker_low: own.quantile(0.01),
                other_high: theirs.quantile(0.99),
            });
        }
        learned.models.push(model);
    }
    Ok(learned)
}

fn check(classes: &[ClassSamples]) -> Result<(), LearnError> {
    let markers = classes.iter().filter(|c| c.is_marker).count();
    if markers == 0 || classes.len() < 2 {
        return Err(LearnError::NoContrast { markers, classes: classes.len() });
    }
    for class in classes {
        let name = || class.name.clone();
        if class.rgb.len() < LEAST_SAMPLES {
            return Err(LearnError::TooFew { name: name(), found: class.rgb.len() });
        }
        if let Some(v) = class.rgb.iter().find(|v| !v.iter().all(|c| c.is_finite())) {
            return Err(LearnError::NotFinite { name: name(), r: v.x, g: v.y, b: v.z });
        }
    }
    Ok(())
}

/// Mean and covariance of a class.
fn statistics(class: &ClassSamples) -> (Vector3<f64>, Matrix3<f64>) {
    let n = class.rgb.len() as f64;
    let mean = class.rgb.iter().sum::<Vector3<f64>>() / n;
    let covariance = class.rgb.iter().map(|v| (v - mean) * (v - mean).transpose()).sum::<Matrix3<f64>>() / n;
    (mean, covariance)
}

fn discriminant(classes: &[ClassSamples], marker: usize) -> Option<ColourModel> {
    let statistics: Vec<_> = classes.iter().map(statistics).collect();
    let share = 1.0 / (classes.len() - 1) as f64;
    let (own, _) = *statistics.get(marker)?;
    let others: Vector3<f64> =
        statistics.iter().enumerate().filter(|&(i, _)| i != marker).map(|(_, (mean, _))| mean * share).sum();
    // Least squares over two halves of equal weight: (scatter + ridge)·w = covariance of colour and target.
    let middle = (own + others) / 2.0;
    let scatter: Matrix3<f64> = statistics
        .iter()
        .enumerate()
        .map(|(i, (mean, covariance))| {
            let weight = if i == marker { 0.5 } else { 0.5 * share };
            (covariance + (mean - middle) * (mean - middle).transpose()) * weight
        })
        .sum();
    let ridge = Matrix3::identity() * (scatter.trace() / 3.0 * RIDGE);
    let raw = (scatter + ridge).try_inverse()? * (own - others) / 4.0;
    let contrast = raw.dot(&(own - others));
    if !(contrast > LEAST_CONTRAST) {
        return None;
    }
    let weights = raw / contrast;
    Some(ColourModel { weights, bias: -weights.dot(&others), rgb: own })
}

/// The scores of a class, sorted.
struct Scores {
    sorted: Vec<f64>,
    mean: f64,
    variance: f64,
}

impl Scores {
    fn of(model: &ColourModel, class: &ClassSamples) -> Self {
        let mut sorted: Vec<f64> = class.rgb.iter().map(|v| model.weights.dot(v) + model.bias).collect();
        sorted.sort_by(f64::total_cmp);
        let n = sorted.len() as f64;
        let mean = sorted.iter().sum::<f64>() / n;
        let variance = sorted.iter().map(|s| (s - mean).powi(2)).sum::<f64>() / n;
        Self { sorted, mean, variance }
    }

    /// The nearest sample to this rank (NaN of an empty class, which [`check`] has refused).
    fn quantile(&self, q: f64) -> f64 {
        let rank = (q * (self.sorted.len().saturating_sub(1)) as f64).round() as usize;
        self.sorted.get(rank).copied().unwrap_or(f64::NAN)
    }
}
