//! Shapes at rest: pauses that are long enough, and what the model has for them.

use super::Run;
use super::parameter::Parameter;
use super::search::{Found, Residuals, minimise};
use crate::catheter::equilibrium::equilibrium;
use crate::catheter::load::Load;
use crate::catheter::model::Catheter;
use crate::catheter::record::{Noise, Sighting};
use crate::catheter::shape::Shape;
use crate::median::median;
use crate::plural::plural;
use nalgebra::{DVector, Point3, Vector3};

/// Fewer frames than this say nothing of their scatter.
const MIN_FRAMES: usize = 5;
/// Halves of fewer pauses than this say nothing of slow noise.
const MIN_PAUSES: usize = 3;
/// A pause whose halves differ by more than so many σ of the difference, and by more than this part of the scatter, has
/// not settled.
const UNSETTLED: (f64, f64) = (5.0, 0.5);
/// What settles goes on in the same direction: median cosine between the way within the first half of a pause and that
/// within the second, above which slow noise is not the reason why halves differ.
const SETTLES: f64 = 0.5;
/// Median length of a vector of three normal numbers.
const MEDIAN_OF_THREE: f64 = 1.538;

/// That pauses have too few frames, or that in none of them, so many, the catheter had come to rest.
pub(super) fn no_pause(settle_s: f64, unsettled: usize) -> String {
    if unsettled > 0 {
        return format!(
            "in none of {} the catheter had come to rest after the first {settle_s} s (--settle): hold the currents \
             longer, and let it settle for longer",
            plural(unsettled as u64, "pause")
        );
    }
    format!(
        "no pause has {} frames with coil, tip and direction after the first {settle_s} s (--settle): hold the \
         currents longer, at more frames per second, or let them settle for less time",
        2 * MIN_FRAMES
    )
}

/// A pause in which the catheter had come to rest.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pause {
    /// Which run it is from.
    pub run: usize,
    /// From when on frames count, seconds of the run.
    pub from_s: f64,
    /// Frames that count.
    pub frames: usize,
    /// Amperes.
    pub currents_a: Vector3<f64>,
    /// Mean place of the middle of the coil set, metres.
    pub coil: Point3<f64>,
    /// Mean place of the tip, metres.
    pub tip: Point3<f64>,
    /// Mean direction.
    pub tangent: Vector3<f64>,
}

/// A frame in which all is seen.
struct Seen {
    time_s: f64,
    /// Coil, tip and direction.
    all: [Vector3<f64>; 3],
}

impl Seen {
    fn of(s: &Sighting) -> Option<Self> {
        Some(Self { time_s: s.time_s, all: [s.coil?.coords, s.tip?.coords, s.tangent?] })
    }
}

fn mean(seen: &[Seen]) -> [Vector3<f64>; 3] {
    [0, 1, 2].map(|k| seen.iter().map(|seen| seen.all[k]).sum::<Vector3<f64>>() / seen.len() as f64)
}

/// What pauses show.
pub(super) struct AtRest {
    pub(super) pauses: Vec<Pause>,
    /// Pauses that are long enough, but had not come to rest.
    pub(super) unsettled: usize,
    /// Noise of a frame, by the differences of successive ones.
    pub(super) of_frames: Option<Noise>,
    /// Noise of a frame that would be as large in a pause's mean if it were white, by the differences of halves; `None`
    /// for too few pauses.
    pub(super) of_means: Option<Noise>,
}

/// Squares of differences that noise alone makes, and how many.
#[derive(Default)]
struct Squares {
    points: (f64, f64),
    angles: (f64, f64),
}

impl Squares {
    /// `pairs` of coil, tip and direction whose differences are `times` as large in their squares as those of noise.
    fn add<'a>(&mut self, pairs: impl Iterator<Item = [&'a [Vector3<f64>; 3]; 2]>, times: f64) {
        for [a, b] in pairs {
            let square = |k: usize| (b[k] - a[k]).norm_squared() / times;
            self.points = (self.points.0 + square(0) + square(1), self.points.1 + 6.0);
            self.angles = (self.angles.0 + square(2), self.angles.1 + 2.0);
        }
    }

    fn add_all(&mut self, other: &Self) {
        self.points = (self.points.0 + other.points.0, self.points.1 + other.points.1);
        self.angles = (self.angles.0 + other.angles.0, self.angles.1 + other.angles.1);
    }

    fn noise(&self) -> Option<Noise> {
        let sd = |(squares, count): (f64, f64)| (count > 0.0).then(|| (squares / count).sqrt());
        Some(Noise { point_m: sd(self.points)?, angle_rad: sd(self.angles)?, missing: 0.0 })
    }
}

/// A pause that is long enough.
struct Long {
    pause: Pause,
    /// Squares of the differences of successive frames.
    own: Squares,
    /// Means of its halves: coil, tip and direction.
    halves: [[Vector3<f64>; 3]; 2],
    /// Way of the tip from the first half of each half to its second, metres.
    ways_m: [Vector3<f64>; 2],
    /// Noise of the tip in a frame, metres.
    sd_m: f64,
}

impl Long {
    /// `stated_m`: noise that the tracker states, metres.
    fn of(run: usize, currents_a: Vector3<f64>, seen: &[Seen], stated_m: f64) -> Self {
        // Noise by differences from frame to frame: what still creeps is none.
        let mut own = Squares::default();
        own.add(seen.iter().zip(seen.iter().skip(1)).map(|(a, b)| [&a.all, &b.all]), 2.0);
        let sd_m = own.noise().map_or(0.0, |noise| noise.point_m).max(stated_m);
        let (early, late) = seen.split_at(seen.len() / 2);
        let way_m = |half: &[Seen]| {
            let (first, second) = half.split_at(half.len() / 2);
            mean(second)[1] - mean(first)[1]
        };
        let [coil, tip, tangent] = mean(seen);
        let pause = Pause {
            run,
            from_s: seen.first().map_or(0.0, |s| s.time_s),
            frames: seen.len(),
            currents_a,
            coil: coil.into(),
            tip: tip.into(),
            tangent: tangent.normalize(),
        };
        Self { pause, own, halves: [mean(early), mean(late)], ways_m: [early, late].map(way_m), sd_m }
    }

    fn apart_m(&self) -> f64 {
        (self.halves[0][1] - self.halves[1][1]).norm()
    }

    /// Distance of the halves in σ of white noise.
    fn apart_sds(&self) -> f64 {
        self.apart_m() / (self.sd_m * 2.0 / (self.pause.frames as f64).sqrt())
    }
}

/// Pauses of all runs that last longer than `settle_s`, and the noise in them. What differs by no more than the noise
/// that the tracker states has settled. Slow noise makes halves differ by more than that of frames: by how much, all
/// pauses tell, unless most of them go on in one direction.
pub(super) fn pauses(runs: &[Run], settle_s: f64, delay_s: f64, stated: &Noise) -> AtRest {
    let long = long_pauses(runs, settle_s, delay_s, stated);
    let slow = slow_noise(&long);
    let is_settled =
        |long: &Long| long.apart_sds() <= UNSETTLED.0 * slow || long.apart_m() <= UNSETTLED.1 * slow * long.sd_m;
    let (settled, unsettled): (Vec<Long>, Vec<Long>) = long.into_iter().partition(is_settled);
    let (mut of_frames, mut of_means) = (Squares::default(), Squares::default());
    for Long { pause, own, halves: [early, late], .. } in &settled {
        of_frames.add_all(own);
        of_means.add(std::iter::once([early, late]), 4.0 / pause.frames as f64);
    }
    let of_means = of_means.noise().filter(|_| settled.len() >= MIN_PAUSES);
    AtRest {
        pauses: settled.into_iter().map(|long| long.pause).collect(),
        unsettled: unsettled.len(),
        of_frames: of_frames.noise(),
        of_means,
    }
}

/// By what factor halves of pauses differ more than white noise explains, where that is noise.
fn slow_noise(long: &[Long]) -> f64 {
    let cosine = median(long.iter().map(|long| {
        let [first, second] = long.ways_m;
        first.dot(&second) / (first.norm() * second.norm()).max(f64::MIN_POSITIVE)
    }));
    let is_noise = long.len() >= MIN_PAUSES && cosine.is_some_and(|cosine| cosine < SETTLES);
    let usual = median(long.iter().map(Long::apart_sds)).filter(|_| is_noise);
    usual.map_or(1.0, |usual| (usual / MEDIAN_OF_THREE).max(1.0))
}

fn long_pauses(runs: &[Run], settle_s: f64, delay_s: f64, stated: &Noise) -> Vec<Long> {
    let mut long = Vec::new();
    for (index, run) in runs.iter().enumerate() {
        let last_s = run.sightings.last().map_or(0.0, |s| s.time_s);
        let (first_s, _) = run.commands.span_s();
        let before = [(f64::NEG_INFINITY, first_s, Vector3::zeros())];
        for (from_s, to_s, currents_a) in before.into_iter().chain(run.commands.pauses()) {
            // At rest from the beginning; else after a while.
            let from_s = if from_s.is_finite() { from_s + delay_s + settle_s } else { f64::NEG_INFINITY };
            let to_s = f64::min(to_s + delay_s, last_s + 1e-9);
            let inside = run.sightings.iter().filter(|s| s.time_s >= from_s && s.time_s < to_s);
            let seen: Vec<Seen> = inside.filter_map(Seen::of).collect();
            if seen.len() < 2 * MIN_FRAMES {
                continue;
            }
            long.push(Long::of(index, currents_a, &seen, stated.point_m));
        }
    }
    long
}

/// The shapes of pauses as a model has them.
pub(super) struct Still<'a> {
    pub(super) start: &'a Catheter,
    pub(super) parameters: &'a [Parameter],
    pub(super) runs: &'a [Run],
    pub(super) pauses: &'a [Pause],
    /// Shapes at the start, from which others are found fast.
    pub(super) shapes: Vec<Option<Shape>>,
    pub(super) noise: Noise,
}

impl<'a> Still<'a> {
    pub(super) fn new(
        start: &'a Catheter,
        parameters: &'a [Parameter],
        (runs, pauses): (&'a [Run], &'a [Pause]),
        noise: Noise,
    ) -> Self {
        let shapes = pauses.iter().map(|pause| equilibrium(start, &Load::currents(pause.currents_a)).ok()).collect();
        Self { start, parameters, runs, pauses, shapes, noise }
    }
}

/// Fits parameters to the shapes of pauses.
pub(super) fn fitted(
    start: &Catheter,
    parameters: &[Parameter],
    of: (&[Run], &[Pause]),
    noise: Noise,
) -> Option<Found> {
    // Shapes at rest do not depend on the delay.
    minimise(parameters, &Still::new(start, parameters, of, noise), super::start_of(start, 0.0, parameters))
}

impl Residuals for Still<'_> {
    fn at(&self, coordinates: &DVector<f64>) -> Option<DVector<f64>> {
        let (catheter, _) = super::with(self.start, 0.0, self.parameters, coordinates);
        let mut left = Vec::with_capacity(9 * self.pauses.len());
        for (pause, shape) in self.pauses.iter().zip(&self.shapes) {
            let load = Load::currents(pause.currents_a);
            let catheter = self.runs.get(pause.run)?.on(&catheter);
            let near = shape.as_ref().and_then(|shape| shape.moved_to(&catheter, &load).ok());
            let shape = near.or_else(|| equilibrium(&catheter, &load).ok())?;
            let mean = (pause.frames as f64).sqrt();
            let seen = Sighting {
                time_s: 0.0,
                base: None,
                coil: Some(pause.coil),
                tip: Some(pause.tip),
                tangent: Some(pause.tangent),
            };
            push(&mut left, &seen, (&shape.coil, &shape.tip, &shape.tangent), self.noise, mean);
        }
        Some(DVector::from_vec(left))
    }
}

/// Seen less modelled, in standard deviations; nothing for what was not seen. A direction has its two components
/// across.
pub(super) fn push(
    left: &mut Vec<f64>,
    seen: &Sighting,
    (coil, tip, tangent): (&Point3<f64>, &Point3<f64>, &Vector3<f64>),
    noise: Noise,
    weight: f64,
) {
    for (seen, modelled) in [(seen.coil, coil), (seen.tip, tip)] {
        if let Some(seen) = seen {
            left.extend(((seen - modelled) * (weight / noise.point_m)).iter());
        }
    }
    if let Some(seen) = seen.tangent {
        // Across y, which a catheter that bends towards B0 does not point along.
        let aside = Vector3::y().cross(tangent).try_normalize(1e-6).unwrap_or_else(Vector3::x);
        // The whole angle: a direction that is reversed is far off, too.
        let along = seen.dot(tangent);
        let across = seen - tangent * along;
        let angle = across.norm().atan2(along);
        let off = across.try_normalize(1e-12).unwrap_or(aside) * (angle * weight / noise.angle_rad);
        left.extend([off.dot(&aside), off.dot(&tangent.cross(&aside))]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::normal::normal;

    const SD_M: f64 = 4e-5;

    /// The factor for 12 pauses of 140 frames, with noise of which a part persists from frame to frame, at the end of a
    /// settling of 5 mm of which only the last `rest_m` are left, with a time constant of 200 frames.
    fn factor(persists: f64, rest_m: f64, seed: u64) -> f64 {
        let mut random = fastrand::Rng::with_seed(seed);
        let mut noise = || Vector3::from_fn(|_, _| normal(&mut random));
        let pauses: Vec<Long> = (0..12)
            .map(|k| {
                let mut state = noise() * SD_M;
                let way = Vector3::new(f64::from(k % 3) - 1.0, 1.0, 0.0).normalize() * rest_m;
                let frame = |i: i32| {
                    state = state * persists + noise() * SD_M * (1.0 - persists * persists).sqrt();
                    let tip = state + way * (-f64::from(i) / 200.0).exp();
                    Seen { time_s: f64::from(i) / 60.0, all: [tip, tip, Vector3::z()] }
                };
                Long::of(0, Vector3::zeros(), &(0..140).map(frame).collect::<Vec<_>>(), 0.0)
            })
            .collect();
        slow_noise(&pauses)
    }

    #[test]
    fn slow_noise_is_told_from_what_settles() {
        for seed in 0..10 {
            assert!(factor(0.0, 0.0, seed) < 1.6, "white");
            let slow = factor(0.9, 0.0, seed);
            assert!((6.0..25.0).contains(&slow), "{slow}: halves are 14 times as far apart as frames say");
            // More than half of a time constant, and the noise is small beside it.
            assert!(factor(0.0, 2e-3, seed) < 1.0 + 1e-9 && factor(0.9, 2e-3, seed) < 1.0 + 1e-9, "settling");
        }
    }
}
