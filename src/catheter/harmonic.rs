//! What the linearised catheter makes of a path: magnitude and phase of its first harmonic at a pause, beside the path
//! at rest.
//!
//! Commands are held, and points are averages over their pause, or places in its middle, as `catoptra validate` takes
//! them: the hold makes no delay then, and hardly any loss. What is not linear (the drag's quadratic part, the shape of
//! large bends) is not in it.

use super::dynamics::{Accuracy, Simulation};
use super::error::CatheterError;
use super::follow::Followed;
use super::load::Load;
use super::model::Catheter;
use nalgebra::{Complex, Vector3};
use std::f64::consts::{PI, TAU};

/// The response to a path at one pause.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Harmonic {
    /// How long each point is held, seconds.
    pub pause_s: f64,
    /// Periods per second.
    pub frequency_hz: f64,
    /// Size of the tip's first harmonic, in parts of what it is at rest.
    pub magnitude: f64,
    /// By how much it is ahead, radians; late is negative.
    pub phase_rad: f64,
}

/// The responses at some pauses, about the path's mean currents.
///
/// # Errors
/// [`CatheterError`] when there is no shape under the mean currents, or a response is singular.
pub fn harmonics(catheter: &Catheter, followed: &[Followed], pauses_s: &[f64]) -> Result<Vec<Harmonic>, CatheterError> {
    let points = followed.len().max(1) as f64;
    let mean = followed.iter().map(|f| f.currents_a).sum::<Vector3<f64>>() / points;
    let wave = |k: usize| Complex::from_polar(2.0 / points, -TAU * k as f64 / points);
    let given = followed.iter().enumerate().map(|(k, f)| (f.currents_a - mean).map(|a| wave(k) * a));
    let given = given.fold(Vector3::zeros(), |sum, part| sum + part);
    let middle = Simulation::at_rest(catheter, &Load::currents(mean), Accuracy::default())?;
    let still = middle.response(0.0)? * given;
    let held = PI / points;
    let loss = (held.sin() / held).powi(2);
    let of = |pause_s: &f64| {
        let frequency_hz = 1.0 / (pause_s * points);
        let moved = middle.response(frequency_hz)? * given * Complex::from(loss);
        let magnitude = moved.norm() / still.norm();
        Ok(Harmonic { pause_s: *pause_s, frequency_hz, magnitude, phase_rad: still.dotc(&moved).arg() })
    };
    pauses_s.iter().map(of).collect()
}
