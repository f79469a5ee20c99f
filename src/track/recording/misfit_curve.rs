//! How the misfit of pictures changes with the logarithm of a blur, and how far the best blur is.

use nalgebra::Vector2;

/// Ways in which a blur may differ: the logarithms along x and y change by this much each. Its size, and its shape:
/// more in one direction and less in the other, with the same product.
pub(crate) const SIZE: Vector2<f64> = Vector2::new(1.0, 1.0);
pub(crate) const SHAPE: Vector2<f64> = Vector2::new(0.5, -0.5);
/// Change of the misfit per logarithm beyond which it is not that of an image model without errors, of the ratio of
/// directions. (Of seven recordings it was up to 0.05 where nothing was wrong, of pictures blurred by 0.6 pixels along
/// their rows 0.1 and more.)
const LEAST_SHAPE_SLOPE: f64 = 0.08;
/// How much less and more blur is tried: difference of its logarithm.
pub(crate) const STEP: f64 = 0.2;
/// Longest move at a time, difference of the logarithm: where the minimum is further away, or none is nearby.
const LONGEST_MOVE: f64 = 0.4;
/// Standard deviations beyond which a distance is no chance.
const SIGNIFICANT_SD: f64 = 4.0;

/// A blur, pixels along x and y, that is further along a way.
pub(crate) fn changed(blur_px: &Vector2<f64>, way: Vector2<f64>, log: f64) -> Vector2<f64> {
    blur_px.component_mul(&(way * log).map(f64::exp))
}

/// From three misfits of each of some frames.
#[derive(Debug, Clone, Default)]
pub(crate) struct Curve {
    /// Of each frame.
    pub slopes: Vec<f64>,
    pub curvatures: Vec<f64>,
}

/// How far the best blur is from the present one, as difference of the logarithm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Distance {
    pub log: f64,
    pub sd: f64,
    /// σ from the slope alone: a distance of none has this.
    pub chance_sd: f64,
}

impl Curve {
    /// Adds the misfits of a frame with less, the present, and more blur.
    pub(crate) fn add(&mut self, [less, own, more]: [f64; 3]) {
        self.slopes.push((more - less) / (2.0 * STEP));
        self.curvatures.push((more - 2.0 * own + less) / STEP.powi(2));
    }

    /// Whether the misfit changes by more than errors of the image model make it, as a curve over the shape.
    pub(crate) fn tells_shape(&self) -> bool {
        mean_with_sd(&self.slopes).0.abs() > LEAST_SHAPE_SLOPE
    }

    /// `None` where the frames do not tell: they have no minimum nearby, and their slope may be chance.
    pub(crate) fn distance(&self) -> Option<Distance> {
        let (slope, slope_sd) = mean_with_sd(&self.slopes);
        let (curvature, curvature_sd) = mean_with_sd(&self.curvatures);
        let log = -slope / curvature;
        if curvature > 0.0 && log.abs() < LONGEST_MOVE {
            let sd = slope_sd.hypot(log * curvature_sd) / curvature;
            return Some(Distance { log, sd, chance_sd: slope_sd / curvature });
        }
        let far = slope.abs() > SIGNIFICANT_SD * slope_sd;
        far.then(|| Distance { log: -slope.signum() * LONGEST_MOVE, sd: 0.0, chance_sd: 0.0 })
    }
}

/// The mean of independent values, and its σ from their scatter.
pub(crate) fn mean_with_sd(values: &[f64]) -> (f64, f64) {
    let count = values.len() as f64;
    let mean = values.iter().sum::<f64>() / count;
    let variance = values.iter().map(|one| (one - mean).powi(2)).sum::<f64>() / (count - 1.0) / count;
    (mean, variance.sqrt())
}

impl Distance {
    /// Whether it is more than this, and no chance.
    pub(crate) fn exceeds(&self, least: f64) -> bool {
        self.log.abs() > least && self.log.abs() > SIGNIFICANT_SD * self.chance_sd
    }

    /// Whether another is further than this away, and that is no chance.
    pub(super) fn differs(&self, other: &Self, least: f64) -> bool {
        let off = (self.log - other.log).abs();
        off > least && off > SIGNIFICANT_SD * self.sd.hypot(other.sd)
    }
}

/// Whether any two of some views' distances differ by more than this, and not by chance.
pub(crate) fn are_apart(distances: &[Option<Distance>], least: f64) -> bool {
    let known = || distances.iter().flatten();
    known().any(|one| known().any(|other| one.differs(other, least)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::random::Random;

    /// Of misfits with a minimum this far away and a noise of this much, the same in all three or not.
    fn curve(seed: u64, off: f64, noise: f64) -> Curve {
        let (mut curve, mut random) = (Curve::default(), Random::new(seed));
        for _ in 0..12 {
            curve.add([-STEP, 0.0, STEP].map(|log| 2.0 * (log - off).powi(2) + noise * random.normal()));
        }
        curve
    }

    #[test]
    fn distances_scatter_as_their_sigma_says() {
        let squares = (0..400).map(|seed| {
            let distance = curve(seed, 0.1, 0.01).distance().unwrap();
            ((distance.log - 0.1) / distance.sd).powi(2)
        });
        let mean = squares.sum::<f64>() / 400.0;
        // Of Student's t with 11 degrees of freedom: 11/9.
        assert!((0.9..1.6).contains(&mean), "{mean}");
    }

    #[test]
    fn views_are_apart_only_by_more_than_chance_and_more_than_the_least() {
        let distance = |log, sd| Some(Distance { log, sd, chance_sd: sd });
        assert!(are_apart(&[distance(0.0, 0.01), distance(0.3, 0.02)], 0.2));
        assert!(!are_apart(&[distance(0.0, 0.01), distance(0.3, 0.1)], 0.2));
        assert!(!are_apart(&[distance(0.0, 0.01), distance(0.15, 0.02)], 0.2));
        assert!(!are_apart(&[None, distance(0.5, 0.01)], 0.2));
    }

    #[test]
    fn without_a_minimum_nearby_it_is_far_or_unknown() {
        let falling = Curve { slopes: vec![-1.0, -1.1, -0.9], curvatures: vec![-0.1; 3] };
        assert_eq!(falling.distance(), Some(Distance { log: LONGEST_MOVE, sd: 0.0, chance_sd: 0.0 }));
        let flat = Curve { slopes: vec![-1.0, 1.1, 0.3], curvatures: vec![-0.1; 3] };
        assert_eq!(flat.distance(), None);
        assert_eq!(Curve::default().distance(), None);
    }
}
