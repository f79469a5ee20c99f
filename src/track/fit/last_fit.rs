//! Where a stretch of tube was last, how it looked and how it moved: where the fit of the next frame starts.

use crate::source::Timestamp;
use crate::track::fit::tube_fit::{Look, NEAR_PX, TubeFit};
use crate::track::model::stretch::Stretch;
use crate::track::model::tube_shape::{ShapeStep, TubeShape};
use std::ops::Range;

/// Oldest shape that still tells something of the present one, seconds.
const MAX_AGE_S: f64 = 0.06;

/// The last fit of a group.
#[derive(Debug, Clone)]
pub(in crate::track) struct Last {
    stamp: Timestamp,
    pub shape: TubeShape,
    /// Whether it was known which way along the tube the tip is.
    pub directed: bool,
    /// How it looked, if its start was so good that samples selected there served. Those of the next will, too.
    looks: Option<Looks>,
    /// If it was fitted shortly before as well.
    motion: Option<Motion>,
}

/// Motion of the centre and tangent from one fit to the next.
#[derive(Debug, Clone)]
struct Motion {
    since_s: f64,
    /// Mean, per second.
    rate: ShapeStep,
    /// Change of the rate per second, if a third fit tells.
    change: Option<ShapeStep>,
    /// Rate and change at the end, as far as they go on: what earlier fits do not confirm is taken for noise.
    kept: Option<[ShapeStep; 2]>,
}

/// How a stretch looks in some views.
#[derive(Debug, Clone)]
struct Looks {
    stretch: Stretch,
    views: Vec<usize>,
    /// In each of them.
    list: Vec<Look>,
}

impl Last {
    /// A fitted shape, and the fit before it, perhaps together with other bands.
    fn new(stamp: Timestamp, shape: &TubeShape, before: Option<&Self>) -> Self {
        let motion = before.and_then(|before| {
            let since_s = before.age_s(stamp)?;
            Some(Motion::new(before.shape.step_to(shape) / since_s, since_s, before.motion.as_ref()))
        });
        Self { stamp, shape: shape.clone(), directed: true, looks: None, motion }
    }

    /// A stretch fitted in some views, and the fit before it, perhaps together with other bands.
    pub(in crate::track) fn fitted(
        stamp: Timestamp,
        stretch: &Stretch,
        views: &[usize],
        (fit, directed): (&TubeFit, bool),
        before: Option<&Self>,
    ) -> Self {
        let looks = || Looks { stretch: stretch.clone(), views: views.to_vec(), list: fit.looks() };
        // The way from a shape that may lie the other way round is no motion.
        let before = before.filter(|before| before.directed == directed);
        Self { directed, looks: (fit.way_px < NEAR_PX).then(looks), ..Self::new(stamp, &fit.shape, before) }
    }

    /// The looks of a stretch in some views, if it was seen so and is expected close to where it continues.
    pub(super) fn looks(&self, stretch: &Stretch, views: &[usize]) -> Option<&[Look]> {
        let looks = self.looks.as_ref()?;
        (looks.stretch == *stretch && looks.views == views).then_some(&looks.list)
    }

    /// How long ago it was, seconds, if recent enough.
    pub(super) fn age_s(&self, now: Timestamp) -> Option<f64> {
        self.age_within_s(MAX_AGE_S, now)
    }

    /// The same with another limit.
    pub(in crate::track) fn age_within_s(&self, limit_s: f64, now: Timestamp) -> Option<f64> {
        let age_s = now.seconds_since(self.stamp);
        (age_s > 0.0 && age_s < limit_s).then_some(age_s)
    }

    /// Where it is now if it moves on as it did; `None` when too little is known.
    pub(super) fn continued(&self, now: Timestamp) -> Option<TubeShape> {
        let [rate, change] = self.motion.as_ref()?.kept?;
        let age_s = self.age_s(now)?;
        Some(self.shape.moved(&(rate * age_s + change * (age_s * age_s / 2.0))))
    }
}

impl Motion {
    fn new(rate: ShapeStep, since_s: f64, before: Option<&Self>) -> Self {
        let change = before.map(|before| (rate - before.rate) / ((since_s + before.since_s) / 2.0));
        let kept = before.zip(change).map(|(before, change)| {
            let mut kept = [ShapeStep::zeros(); 2];
            // Centre and tangent.
            for part in [0..3, 3..5] {
                let steady = confirmed(&rate, &before.rate, &part);
                let changing = before.change.map_or(0.0, |before| confirmed(&change, &before, &part));
                for i in part {
                    let at_end = rate[i] + change[i] * since_s / 2.0;
                    kept[0][i] = rate[i] * steady * (1.0 - changing) + at_end * changing;
                    kept[1][i] = change[i] * changing;
                }
            }
            kept
        });
        Self { since_s, rate, change, kept }
    }
}

/// The fraction of some elements of a quantity that goes on: as much as was kept of their last value. For a smooth
/// motion that is all, for the noise of something at rest nothing.
fn confirmed(now: &ShapeStep, then: &ShapeStep, elements: &Range<usize>) -> f64 {
    let [now, then] = [now, then].map(|step| step.rows_range(elements.clone()));
    let fraction = now.dot(&then) / then.norm_squared();
    if fraction.is_finite() { fraction.clamp(0.0, 1.0) } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::source::Clock;
    use crate::testing::random::Random;
    use nalgebra::{Point3, Vector3};
    use std::f64::consts::TAU;

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
        assert!((x(&[1e-3, 2e-3, 4e-3, 7e-3]) - 11e-3).abs() < 1e-9, "faster and faster");
        assert!((x(&[1e-3, 2e-3, 4e-3, 5e-3]) - 5.5e-3).abs() < 1e-9, "slower again");
    }

    /// A swing at 2 Hz by 2 cm, with the noise of a tracker.
    #[test]
    fn the_turns_of_a_swing_are_expected() {
        let mut dice = Random::new(7);
        let x: Vec<f64> = (0..60).map(|i| 20e-3 * (f64::from(i) * TAU * 2.0 / 60.0).sin()).collect();
        let seen: Vec<f64> = x.iter().map(|x| x + 10e-6 * dice.normal()).collect();
        let off = |i: usize| (expected(&seen[i - 5..i]).unwrap().centre.x - x[i]).abs();
        let mut off: Vec<f64> = (5..60).map(off).collect();
        off.sort_by(f64::total_cmp);
        // By the rate alone it is off by up to 0.9 mm.
        let (median, most) = (off[off.len() / 2], off[off.len() - 1]);
        assert!(median < 0.2e-3 && most < 0.5e-3, "off by {median} m, up to {most} m");
    }
}
