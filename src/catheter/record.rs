//! What a camera would record of the catheter in motion.

use super::commands::Commands;
use super::dynamics::{Accuracy, Moment, Simulation};
use super::error::CatheterError;
use super::load::Load;
use super::model::Catheter;
use crate::normal::normal;
use nalgebra::{Point3, Unit, Vector3};

/// What was seen at one time; axes of the base frame, origin at the clamp.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sighting {
    /// When, seconds on the clock of the commands.
    pub time_s: f64,
    /// Middle of the base band, or the clamp, metres. Nothing is fitted to it.
    pub base: Option<Point3<f64>>,
    /// Middle of the coil set, metres.
    pub coil: Option<Point3<f64>>,
    /// The tip, metres: end of the tube, or middle of its band ([`Catheter::tip_m`]).
    pub tip: Option<Point3<f64>>,
    /// Direction of the coil set.
    pub tangent: Option<Vector3<f64>>,
}

/// How well a tracker sees.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Noise {
    /// Standard deviation of a coordinate, metres.
    pub point_m: f64,
    /// Standard deviation of a direction about each axis across it, radians.
    pub angle_rad: f64,
    /// Part of frames in which nothing is seen.
    pub missing: f64,
}

impl Noise {
    /// None at all.
    pub const NONE: Self = Self { point_m: 0.0, angle_rad: 0.0, missing: 0.0 };
}

/// The moments at these times (seconds, rising, the first not before 0), from rest without currents at time 0.
/// `tip_n`: a force at the tip all the while, N.
///
/// # Errors
/// [`CatheterError`] when the catheter has no shape at rest, or a step of the motion does not settle.
pub fn record(
    catheter: &Catheter,
    commands: &Commands,
    tip_n: Vector3<f64>,
    times_s: impl IntoIterator<Item = f64>,
    accuracy: Accuracy,
) -> Result<Vec<Moment>, CatheterError> {
    let load = |currents_a: Vector3<f64>| Load { tip_n, ..Load::currents(currents_a) };
    let mut simulation = Simulation::at_rest(catheter, &load(Vector3::zeros()), accuracy)?;
    let mut moments = Vec::new();
    let mut now_s = 0.0;
    for time_s in times_s {
        if time_s > now_s {
            simulation.advance(time_s - now_s, |from_s, to_s| load(commands.mean(from_s, to_s)))?;
            now_s = time_s;
        }
        moments.push(simulation.moment());
    }
    Ok(moments)
}

/// What a tracker would make of moments.
pub fn seen(moments: &[Moment], noise: Noise, seed: u64) -> Vec<Sighting> {
    // Neighbouring seeds start neighbouring streams, which are alike.
    let mut spread = fastrand::Rng::with_seed(seed);
    let mut random = fastrand::Rng::with_seed(spread.u64(..));
    let mut gone = fastrand::Rng::with_seed(spread.u64(..));
    let mut of_base = fastrand::Rng::with_seed(spread.u64(..));
    let mut look = |moment: &Moment| {
        let mut vector = || Vector3::from_fn(|_, _| normal(&mut random));
        let (coil, tip) = (moment.coil + vector() * noise.point_m, moment.tip + vector() * noise.point_m);
        let aside = vector() * noise.angle_rad;
        let tangent = Unit::new_normalize(moment.tangent + aside - moment.tangent * moment.tangent.dot(&aside));
        let base = match moment.base {
            // Without a band it is the clamp, from which places are counted.
            clamp if clamp == Point3::origin() => clamp,
            band => band + Vector3::from_fn(|_, _| normal(&mut of_base)) * noise.point_m,
        };
        let there = gone.f64() >= noise.missing;
        Sighting {
            time_s: moment.time_s,
            base: there.then_some(base),
            coil: there.then_some(coil),
            tip: there.then_some(tip),
            tangent: there.then_some(tangent.into_inner()),
        }
    };
    moments.iter().map(&mut look).collect()
}
