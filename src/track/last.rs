//! Where a stretch of tube was last and how it moved: where the fit of the next frame starts.

use crate::source::Timestamp;
use crate::track::tube::{ShapeStep, TubeShape};

/// Oldest shape that still tells something of the present one, seconds.
const MAX_AGE_S: f64 = 0.06;

/// The last fit of a group.
#[derive(Debug, Clone)]
pub(crate) struct Last {
    stamp: Timestamp,
    pub shape: TubeShape,
    /// Motion of its centre and tangent per second, if it was fitted shortly before as well.
    rate: Option<ShapeStep>,
    /// The part of it that is no noise, if two earlier fits tell.
    kept: Option<ShapeStep>,
}

impl Last {
    /// A fitted shape, and the fit before it, perhaps together with other bands.
    pub(crate) fn new(stamp: Timestamp, shape: &TubeShape, before: Option<&Self>) -> Self {
        let rate = before.and_then(|before| Some(before.shape.step_to(shape) / before.age_s(stamp)?));
        let kept = rate.zip(before.and_then(|before| before.rate)).map(|(rate, before)| kept(&rate, &before));
        Self { stamp, shape: shape.clone(), rate, kept }
    }

    /// How long ago it was, seconds, if recent enough.
    pub(crate) fn age_s(&self, now: Timestamp) -> Option<f64> {
        self.age_within_s(MAX_AGE_S, now)
    }

    /// The same with another limit.
    pub(crate) fn age_within_s(&self, limit_s: f64, now: Timestamp) -> Option<f64> {
        let age_s = now.seconds_since(self.stamp);
        (age_s > 0.0 && age_s < limit_s).then_some(age_s)
    }

    /// Where it is now if it moves on as it did; `None` when too little is known.
    pub(crate) fn continued(&self, now: Timestamp) -> Option<TubeShape> {
        let step = self.kept? * self.age_s(now)?;
        Some(self.shape.moved(&step))
    }
}

/// A rate as it goes on: as much of it as was kept of the rate before. For a smooth motion that is all, for the noise
/// of something at rest nothing.
fn kept(rate: &ShapeStep, before: &ShapeStep) -> ShapeStep {
    let mut kept = *rate;
    // Centre and tangent.
    for (first, count) in [(0, 3), (3, 2)] {
        let (now, then) = (rate.rows(first, count), before.rows(first, count));
        let part = now.dot(&then) / then.norm_squared();
        kept.rows_mut(first, count).scale_mut(if part.is_finite() { part.clamp(0.0, 1.0) } else { 0.0 });
    }
    kept
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::source::Clock;
    use nalgebra::{Point3, Vector3};

    /// Where a tube is expected after being at some places, 60 times per second.
    fn expected(x_m: &[f64]) -> Option<TubeShape> {
        let stamp = |i: usize| Timestamp { ns: i as i64 * 16_666_667, clock: Clock::Device };
        let shape = |x: f64| TubeShape::straight(Point3::new(x, 0.0, 1.3), &Vector3::y(), 6e-3);
        let last = x_m
            .iter()
            .enumerate()
            .fold(None, |before: Option<Last>, (i, x)| Some(Last::new(stamp(i), &shape(*x), before.as_ref())));
        last?.continued(stamp(x_m.len()))
    }

    #[test]
    fn a_motion_goes_on_and_noise_does_not() {
        assert!(expected(&[1e-3, 2e-3]).is_none(), "too short");
        let x = |places: &[f64]| expected(places).unwrap().centre.x;
        assert!((x(&[1e-3, 2e-3, 3e-3]) - 4e-3).abs() < 1e-9);
        assert!((x(&[1e-3, 2e-3, 1e-3]) - 1e-3).abs() < 1e-9, "back again");
        assert!((x(&[1e-3, 2e-3, 2.5e-3]) - 2.75e-3).abs() < 1e-9, "slower");
    }
}
