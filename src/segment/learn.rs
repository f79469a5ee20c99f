//! Samples of colours -> a colour model for each marker, and how well it separates.
//!
//! A plane is a ridge regression of 1 on the marker's samples and 0 on others: on all other classes, or on a single
//! one. Both halves have equal weight. Among the others each class has a weight that does not depend on its number of
//! samples: 1, or 0.1 for another marker. Other classes may be lit differently from where they were sampled (a shadow,
//! a dark clamp, a glare), so they get an additional spread in brightness: the models separate colours, not light from
//! dark. The regression's scores are then stretched to 1 and 0 on average, as [`ColourPlane`] requires: regression
//! alone shrinks both towards their mean. Source: Hastie, Tibshirani, Friedman, "The Elements of Statistical Learning"
//! (2009), sections 3.4.1 and 4.2.
//!
//! A model is one plane, or the few that together make the fewest mistakes, chosen greedily. Samples that neither was
//! learned from decide between the two; separations are also reported for such samples.

use crate::plural::plural;
use crate::rig::{ColourModel, ColourPlane};
use nalgebra::{Matrix3, Vector3};

/// Samples of one class: a marker, or something that must not be mistaken for one (tube, background).
#[derive(Debug, Clone, PartialEq)]
pub struct ClassSamples {
    /// Its name, for messages.
    pub name: String,
    /// Whether a model is to be learned for it.
    pub is_marker: bool,
    /// R'G'B' 0..255, full range.
    pub rgb: Vec<Vector3<f64>>,
}

/// The learned models.
#[derive(Debug, Clone, PartialEq)]
pub struct Learned {
    /// One model for each marker class, in the order of the classes.
    pub models: Vec<ColourModel>,
    /// For each marker class, its separation from each other class, in the order of the classes.
    pub separations: Vec<Separation>,
}

impl Learned {
    /// The least separated pair: the one with the smallest gap.
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
    /// Fraction of the marker's samples classified as the marker.
    pub hits: f64,
    /// Fraction of the other class' samples classified as the marker.
    pub mistaken: f64,
}

impl Separation {
    /// Distance between the low end of the marker's scores and the high end of the other's; positive when the
    /// two do not overlap.
    pub fn gap(&self) -> f64 {
        self.marker_low - self.other_high
    }
}

/// Why no model can be learned.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum LearnError {
    /// Not enough samples of a class.
    #[error("class `{name}` has {}, expected at least {MIN_SAMPLES}", plural(*found, "sample"))]
    TooFew {
        /// The class.
        name: String,
        /// How many it has.
        found: usize,
    },
    /// A sample that is not a colour.
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
    /// No marker to learn, or nothing to separate it from.
    #[error("{markers} marker classes among {classes}, expected at least one marker and one other class")]
    NoContrast {
        /// Marker classes.
        markers: usize,
        /// All classes.
        classes: usize,
    },
    /// A marker with the same mean score as everything else.
    #[error("the colour of `{0}` (mean of its samples) cannot be told from the other classes")]
    SameColour(String),
}

/// Fewer samples do not represent a class.
const MIN_SAMPLES: usize = 8;

/// Ridge, as a fraction of the mean variance of a channel: enough to keep weights small where colours do not vary, too
/// little to matter where they do.
const RIDGE: f64 = 1e-3;

/// Relative standard deviation of another class' brightness, beyond what its samples show.
const SHADING: f64 = 0.4;

/// Weight of a class that is another marker, where tube and background weigh 1: those border on the marker and must
/// score 0, while other markers need only score below the threshold.
const OTHER_MARKER_WEIGHT: f64 = 0.1;

/// The segmentation threshold.
const THRESHOLD: f64 = super::THRESHOLD as f64;
/// Most planes of a model, and the reduction of mistakes (fraction) that is worth one more.
const MAX_PLANES: usize = 4;
const MIN_PLANE_GAIN: f64 = 0.003;
/// Fraction of a class classified as the marker above which it counts as the same paint.
const SAME_PAINT_FRACTION: f64 = 0.5;
/// Scores this close to the threshold are uncertain.
const UNCERTAIN_SCORE: f64 = 0.25;

/// Contrast of the regression's mean scores (of 1) below which it is rounding.
const MIN_CONTRAST: f64 = 1e-6;

/// Learns a model for each marker class.
///
/// # Errors
/// [`LearnError`] when samples are missing or useless, or a marker has exactly the colour of the rest. Poor separation
/// is not an error: it is reported in [`Learned::separations`].
pub fn learn(classes: &[ClassSamples]) -> Result<Learned, LearnError> {
    check(classes)?;
    let halves = [0, 1].map(|half| classes.iter().map(|class| class.half(half)).collect::<Vec<_>>());
    let mut learned = Learned { models: Vec::new(), separations: Vec::new() };
    for (marker, class) in classes.iter().enumerate().filter(|(_, c)| c.is_marker) {
        let same_colour = || LearnError::SameColour(class.name.clone());
        let against = choose(&halves, marker).ok_or_else(same_colour)?;
        learned.models.push(model(classes, marker, &against).ok_or_else(same_colour)?);
        // Learned from one half and tested on the other.
        let tried = model(&halves[0], marker, &against).ok_or_else(same_colour)?;
        let own = Scores::of(&tried, &halves[1][marker]);
        for (other, class) in halves[1].iter().enumerate().filter(|&(other, _)| other != marker) {
            let theirs = Scores::of(&tried, class);
            let sd = ((own.variance + theirs.variance) / 2.0).sqrt();
            learned.separations.push(Separation {
                marker,
                other,
                d_prime: (own.mean - theirs.mean) / sd,
                marker_low: own.quantile(0.01),
                other_high: theirs.quantile(0.99),
                hits: own.above(THRESHOLD),
                mistaken: theirs.above(THRESHOLD),
            });
        }
    }
    Ok(learned)
}

/// The classes that a plane is learned against.
#[derive(Debug, Clone, PartialEq)]
enum Against {
    /// One class.
    One(usize),
    /// All but these.
    AllBut(Vec<usize>),
}

impl ClassSamples {
    /// Every second block of the samples, eight blocks in each half: similar neighbours stay together.
    fn half(&self, half: usize) -> Self {
        let stretch = self.rgb.len().div_ceil(16).max(1);
        let rgb = self.rgb.chunks(stretch).skip(half).step_by(2).flatten().copied().collect();
        Self { name: self.name.clone(), rgb, ..*self }
    }
}

fn model(classes: &[ClassSamples], marker: usize, against: &[Against]) -> Option<ColourModel> {
    let planes = against.iter().map(|other| plane(classes, marker, other)).collect::<Option<Vec<_>>>()?;
    Some(ColourModel { planes, rgb: statistics(classes.get(marker)?).0 })
}

/// The planes of the model that makes the fewest mistakes on samples it was not learned from: one against everything,
/// or those that make the fewest mistakes on the samples they were learned from. `None` when none separates the marker
/// from everything else.
fn choose([seen, unseen]: &[Vec<ClassSamples>; 2], marker: usize) -> Option<Vec<Against>> {
    let same = same_paint(seen, marker)?;
    let others = (0..seen.len()).filter(|other| *other != marker && !same.contains(other));
    let planes: Vec<(Against, ColourPlane)> = std::iter::once(Against::AllBut(same.clone()))
        .chain(others.map(Against::One))
        .filter_map(|against| Some((against.clone(), plane(seen, marker, &against)?)))
        .collect();
    let (linear, first) = planes.first().filter(|(against, _)| matches!(against, Against::AllBut(_)))?;
    let mistakes = |lowest: &LowestScores| lowest.mistakes(marker, &same);
    let mut chosen: Vec<&(Against, ColourPlane)> = Vec::new();
    let mut lowest = LowestScores::new(seen);
    let mut left = f64::INFINITY;
    while chosen.len() < MAX_PLANES {
        let tried = planes.iter().map(|candidate| (mistakes(&lowest.with(&candidate.1, seen)), candidate));
        let Some((fewest, best)) = tried.min_by(|a, b| a.0.total_cmp(&b.0)) else { break };
        if fewest > left - MIN_PLANE_GAIN {
            break;
        }
        left = fewest;
        lowest = lowest.with(&best.1, seen);
        chosen.push(best);
    }
    let on_unseen = |planes: &mut dyn Iterator<Item = &ColourPlane>| {
        mistakes(&planes.fold(LowestScores::new(unseen), |lowest, plane| lowest.with(plane, unseen)))
    };
    if on_unseen(&mut chosen.iter().map(|c| &c.1)) < on_unseen(&mut std::iter::once(first)) - MIN_PLANE_GAIN {
        Some(chosen.into_iter().map(|c| c.0.clone()).collect())
    } else {
        Some(vec![linear.clone()])
    }
}

/// Classes of the marker's own paint: with any model, most of their samples are classified as the marker. Learned
/// against, they would leave nothing of its colour.
fn same_paint(classes: &[ClassSamples], marker: usize) -> Option<Vec<usize>> {
    let mut same: Vec<usize> = Vec::new();
    loop {
        let plane = plane(classes, marker, &Against::AllBut(same.clone()))?;
        let model = ColourModel { planes: vec![plane], rgb: Vector3::zeros() };
        let mistaken = |other: usize| Scores::of(&model, &classes[other]).above(THRESHOLD);
        let others = (0..classes.len()).filter(|k| *k != marker && !classes[*k].is_marker && !same.contains(k));
        let worst = others.map(|k| (mistaken(k), k)).max_by(|a, b| a.0.total_cmp(&b.0));
        match worst {
            Some((share, class)) if share > SAME_PAINT_FRACTION && same.len() + 2 < classes.len() => same.push(class),
            _ => return Some(same),
        }
    }
}

/// The lowest score over some planes, for each sample of each class.
struct LowestScores(Vec<Vec<f64>>);

impl LowestScores {
    fn new(classes: &[ClassSamples]) -> Self {
        Self(classes.iter().map(|class| vec![f64::INFINITY; class.rgb.len()]).collect())
    }

    fn with(&self, plane: &ColourPlane, classes: &[ClassSamples]) -> Self {
        let lower = |(scores, class): (&Vec<f64>, &ClassSamples)| {
            scores.iter().zip(&class.rgb).map(|(score, rgb)| score.min(plane.score(rgb))).collect()
        };
        Self(self.0.iter().zip(classes).map(lower).collect())
    }

    /// Fraction of the marker's samples that are missed, plus the mean fraction of the others, except `same`, that are
    /// classified as the marker. A score within `UNCERTAIN_SCORE` of the threshold is a partial mistake.
    fn mistakes(&self, marker: usize, same: &[usize]) -> f64 {
        let share = |scores: &Vec<f64>, is_marker: bool| {
            let sign = if is_marker { 1.0 } else { -1.0 };
            let mistake = |score: &f64| (0.5 - sign * (score - THRESHOLD) / (2.0 * UNCERTAIN_SCORE)).clamp(0.0, 1.0);
            scores.iter().map(mistake).sum::<f64>() / scores.len().max(1) as f64
        };
        let others = (self.0.len() - 1 - same.len()).max(1) as f64;
        let of = |(i, scores): (usize, &Vec<f64>)| share(scores, i == marker) / if i == marker { 1.0 } else { others };
        self.0.iter().enumerate().filter(|(i, _)| !same.contains(i)).map(of).sum()
    }
}

fn check(classes: &[ClassSamples]) -> Result<(), LearnError> {
    let markers = classes.iter().filter(|c| c.is_marker).count();
    if markers == 0 || classes.len() < 2 {
        return Err(LearnError::NoContrast { markers, classes: classes.len() });
    }
    for class in classes {
        let name = || class.name.clone();
        if class.rgb.len() < MIN_SAMPLES {
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

fn plane(classes: &[ClassSamples], marker: usize, against: &Against) -> Option<ColourPlane> {
    let statistics: Vec<_> = classes.iter().map(statistics).collect();
    let weight = |i: usize| match (classes.get(i), against) {
        _ if i == marker => 0.0,
        (_, Against::One(other)) => f64::from(u8::from(i == *other)),
        (_, Against::AllBut(same)) if same.contains(&i) => 0.0,
        (Some(class), _) if class.is_marker => OTHER_MARKER_WEIGHT,
        _ => 1.0,
    };
    let total: f64 = (0..classes.len()).map(weight).sum();
    let share = |i: usize| weight(i) / total;
    let (own, _) = *statistics.get(marker)?;
    let others: Vector3<f64> = statistics.iter().enumerate().map(|(i, (mean, _))| mean * share(i)).sum();
    // Least squares over two halves of equal weight: (scatter + ridge)·w = covariance of colour and target.
    let middle = (own + others) / 2.0;
    let scatter: Matrix3<f64> = statistics
        .iter()
        .enumerate()
        .map(|(i, (mean, covariance))| {
            let (weight, shading) = if i == marker { (0.5, 0.0) } else { (0.5 * share(i), SHADING) };
            let lit = mean * shading;
            (covariance + lit * lit.transpose() + (mean - middle) * (mean - middle).transpose()) * weight
        })
        .sum();
    let ridge = Matrix3::identity() * (scatter.trace() / 3.0 * RIDGE);
    let raw = (scatter + ridge).try_inverse()? * (own - others) / 4.0;
    let contrast = raw.dot(&(own - others));
    if contrast.is_nan() || contrast <= MIN_CONTRAST {
        return None;
    }
    let weights = raw / contrast;
    Some(ColourPlane { weights, bias: -weights.dot(&others) })
}

/// The scores of a class, sorted.
struct Scores {
    sorted: Vec<f64>,
    mean: f64,
    variance: f64,
}

impl Scores {
    fn of(model: &ColourModel, class: &ClassSamples) -> Self {
        let mut sorted: Vec<f64> = class.rgb.iter().map(|v| model.score(v)).collect();
        sorted.sort_by(f64::total_cmp);
        let n = sorted.len() as f64;
        let mean = sorted.iter().sum::<f64>() / n;
        let variance = sorted.iter().map(|s| (s - mean).powi(2)).sum::<f64>() / n;
        Self { sorted, mean, variance }
    }

    /// Fraction of the samples above a score.
    fn above(&self, score: f64) -> f64 {
        self.sorted.iter().filter(|s| **s > score).count() as f64 / self.sorted.len().max(1) as f64
    }

    /// The nearest sample to this rank (NaN for an empty class, which [`check`] has rejected).
    fn quantile(&self, q: f64) -> f64 {
        let rank = (q * (self.sorted.len().saturating_sub(1)) as f64).round() as usize;
        self.sorted.get(rank).copied().unwrap_or(f64::NAN)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::bands::samples;

    /// Whether the segmentation threshold, half way from 0 to 1, lies between the two.
    fn is_separate(of: &Separation) -> bool {
        of.marker_low > THRESHOLD && of.other_high < THRESHOLD
    }

    #[test]
    fn scores_are_one_on_the_marker_and_nought_elsewhere_on_average() {
        let classes = samples();
        let learned = learn(&classes).unwrap();
        assert_eq!(learned.models.len(), 3);
        for (marker, model) in learned.models.iter().enumerate() {
            let plane = plane(&classes, marker, &Against::AllBut(Vec::new())).unwrap();
            let all = ColourModel { planes: vec![plane], rgb: model.rgb };
            let mean = |class: &ClassSamples| Scores::of(&all, class).mean;
            assert!((mean(&classes[marker]) - 1.0).abs() < 1e-9);
            let weight = |c: usize| if c < 3 { OTHER_MARKER_WEIGHT } else { 1.0 };
            let others: f64 = (0..5).filter(|&c| c != marker).map(|c| weight(c) * mean(&classes[c])).sum();
            assert!(others.abs() < 1e-9);
            // What borders on it scores about 0 by itself.
            assert!(mean(&classes[3]).abs() < 0.15 && mean(&classes[4]).abs() < 0.15);
            assert_eq!(model.rgb, statistics(&classes[marker]).0);
        }
        assert_eq!(learned.separations.len(), 12);
        assert!(learned.separations.iter().all(|s| is_separate(s) && s.gap() > 0.2 && s.d_prime > 5.0));
        let worst = learned.worst().unwrap().gap();
        assert!(learned.separations.iter().all(|s| s.gap() >= worst));
    }

    #[test]
    fn a_class_counts_the_same_however_many_samples_it_has() {
        let mut classes = samples();
        let once = learn(&classes).unwrap();
        let background = classes[4].rgb.clone();
        classes[4].rgb.extend(background.iter().cycle().take(1800).copied());
        for (a, b) in once.models.iter().zip(learn(&classes).unwrap().models) {
            for (a, b) in a.planes.iter().zip(&b.planes) {
                assert!((a.weights - b.weights).norm() < 1e-9 && (a.bias - b.bias).abs() < 1e-9);
            }
        }
    }

    #[test]
    fn a_shadow_on_the_background_is_no_marker() {
        let learned = learn(&samples()).unwrap();
        for model in &learned.models {
            for shade in [0.1, 0.4, 1.5] {
                let score = model.score(&(Vector3::new(110.0, 110.0, 112.0) * shade));
                assert!(score < 0.4, "{score} at {shade}");
            }
        }
    }

    #[test]
    fn similar_colours_are_learned_but_not_separate() {
        let mut classes = samples();
        let shift = Vector3::new(6.0, -6.0, 0.0);
        classes[2].rgb = classes[1].rgb.iter().map(|v| v + shift).collect();
        let learned = learn(&classes).unwrap();
        let pair = learned.separations.iter().find(|s| s.marker == 1 && s.other == 2).unwrap();
        assert!(!is_separate(pair) && pair.gap() < 0.1, "{pair:?}");
        assert_eq!(
            {
                let w = learned.worst().unwrap();
                w.marker.min(w.other)
            },
            1
        );
    }

    /// A brick of a band's paint must not change the band's model.
    #[test]
    fn a_brick_of_the_same_paint_is_left_out_of_account() {
        let mut classes = samples();
        let without = learn(&classes).unwrap();
        let brick = classes[0].rgb.iter().map(|v| v * 1.05).collect();
        classes.push(ClassSamples { name: "brick".into(), is_marker: false, rgb: brick });
        let with = learn(&classes).unwrap();
        for (a, b) in with.models[0].planes.iter().zip(&without.models[0].planes) {
            assert!((a.weights - b.weights).norm() < 1e-9);
        }
        let brick = with.separations.iter().find(|s| s.marker == 0 && s.other == 5).unwrap();
        assert!(brick.mistaken > 0.9, "and it is told: {brick:?}");
    }

    #[test]
    fn useless_samples_are_refused_by_name() {
        let message = |classes: &[ClassSamples]| learn(classes).unwrap_err().to_string();
        let mut classes = samples();
        classes[3].rgb.truncate(7);
        assert_eq!(message(&classes), "class `tube` has 7 samples, expected at least 8");
        classes[3].rgb = vec![Vector3::new(1.0, f64::NAN, 2.0); 9];
        assert_eq!(message(&classes), "class `tube` has a sample of R'G'B' (1, NaN, 2), expected finite numbers");
        assert_eq!(
            message(&classes[..1]),
            "1 marker classes among 1, expected at least one marker and one other class"
        );
        let same = ClassSamples { name: "tip".into(), is_marker: true, rgb: vec![Vector3::repeat(9.0); 20] };
        let other = ClassSamples { name: "wall".into(), is_marker: false, ..same.clone() };
        assert_eq!(learn(&[same, other]), Err(LearnError::SameColour("tip".into())));
    }
}
