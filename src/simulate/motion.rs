//! What the catheter does: currents through the rod of [`crate::catheter`], or poses that were tracked.

use super::centre_line::{CentreLine, Exposed};
use super::error::SceneError;
use super::mount::Mount;
use crate::catheter::{Accuracy, Catheter, CatheterError, Commands, Load, Simulation, Target, follow};
use nalgebra::Vector3;
use std::f64::consts::TAU;

/// Points of a closed path, and how long it takes to go round once, seconds.
const POINTS: u32 = 120;
const ROUND_S: f64 = 4.0;
/// How long the way from rest to its beginning takes.
const BEGIN_S: f64 = 1.0;
/// Centre and radius of the path across the tube, by the tube's length.
const CENTRE: f64 = 0.235;
const RADIUS: f64 = 0.07;
/// The planar swing: frequency, Hz; largest current, by the limit; when it is reached, seconds.
const SWING_HZ: f64 = 0.4;
const SWING: f64 = 0.8;
const GROWS_S: f64 = 4.0;
/// Steps of the swing's current.
const STEP_S: f64 = 5e-3;

/// Motions that need no table.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum StandardMotion {
    /// No current.
    Rest,
    /// A growing swing in the plane of B0 and the tube.
    Planar,
    /// The tip on a circle.
    Circle,
    /// The tip on a lemniscate.
    Lemniscate,
}

impl StandardMotion {
    /// Its currents, for as long as asked for, seconds.
    ///
    /// # Errors
    /// [`CatheterError`] when the catheter does not follow the path.
    pub fn commands(self, catheter: &Catheter, duration_s: f64) -> Result<Commands, CatheterError> {
        match self {
            Self::Rest => Commands::new(catheter, [(0.0, Vector3::zeros())]),
            Self::Planar => {
                let steps = (duration_s / STEP_S).ceil() as u64;
                let at = |k: u64| {
                    let time_s = k as f64 * STEP_S;
                    let size = SWING * catheter.coils.limit_a * (time_s / GROWS_S).min(1.0);
                    (time_s, Vector3::z() * (size * (TAU * SWING_HZ * time_s).sin()))
                };
                Commands::new(catheter, (0..=steps).map(at))
            }
            Self::Circle => along(catheter, duration_s, |t| (t.cos(), t.sin())),
            Self::Lemniscate => along(catheter, duration_s, |t| {
                let scale = 1.0 / (1.0 + t.sin().powi(2));
                (t.cos() * scale, t.sin() * t.cos() * scale)
            }),
        }
    }
}

/// Currents that lead the tip round a path again and again; linear from rest to its beginning.
fn along(catheter: &Catheter, duration_s: f64, path: impl Fn(f64) -> (f64, f64)) -> Result<Commands, CatheterError> {
    let length_m = catheter.length_m();
    let targets: Vec<Target> = (0..POINTS)
        .map(|k| {
            let (x, y) = path(f64::from(k) / f64::from(POINTS) * TAU);
            Target::Across([length_m * (CENTRE + RADIUS * x), length_m * RADIUS * y])
        })
        .collect();
    let followed = follow(catheter, &targets)?;
    let pause_s = ROUND_S / f64::from(POINTS);
    let begin = followed.first().map_or_else(Vector3::zeros, |first| first.currents_a);
    let steps = (BEGIN_S / pause_s).round() as u64;
    let up = (0..steps).map(|k| (k as f64 * pause_s, begin * (k as f64 / steps as f64)));
    let round = followed.iter().cycle().enumerate();
    let round = round.map(|(k, point)| ((steps + k as u64) as f64 * pause_s, point.currents_a));
    Commands::new(catheter, up.chain(round.take_while(|(time_s, _)| *time_s <= duration_s)))
}

/// A catheter under currents, exposure after exposure.
pub struct Rod {
    simulation: Simulation,
    commands: Commands,
    now_s: f64,
    mount: Mount,
}

impl Rod {
    /// At rest without currents at time 0.
    ///
    /// # Errors
    /// [`CatheterError`] when the catheter has no shape at rest.
    pub fn at_rest(mount: &Mount, commands: Commands) -> Result<Self, CatheterError> {
        let simulation = Simulation::at_rest(&mount.catheter, &Load::currents(Vector3::zeros()), Accuracy::default())?;
        Ok(Self { simulation, commands, now_s: 0.0, mount: mount.clone() })
    }

    /// The line now, camera frame.
    ///
    /// # Errors
    /// [`SceneError::NoLine`] for a catheter without length.
    pub fn line(&self) -> Result<CentreLine, SceneError> {
        let line = CentreLine::through(&self.simulation.centre_line()).ok_or(SceneError::NoLine)?;
        Ok(line.moved(&self.mount.camera_from_clamp))
    }

    /// Goes on to a time, seconds; an earlier one is taken for now.
    fn advance_to(&mut self, time_s: f64) -> Result<(), CatheterError> {
        if time_s > self.now_s {
            let commands = &self.commands;
            let load = |from_s: f64, to_s: f64| Load::currents(commands.mean(from_s, to_s));
            self.simulation.advance(time_s - self.now_s, load)?;
            self.now_s = time_s;
        }
        Ok(())
    }

    /// The line during an exposure around a time, seconds; times must rise by the exposure at least.
    ///
    /// # Errors
    /// [`MotionError`] when the motion cannot be computed.
    pub fn exposed(&mut self, time_s: f64, exposure_s: f64) -> Result<Exposed, MotionError> {
        if exposure_s <= 0.0 {
            self.advance_to(time_s)?;
            return Ok(Exposed::still(&self.line()?));
        }
        self.advance_to(time_s - exposure_s / 2.0)?;
        let begin = self.line()?;
        self.advance_to(time_s)?;
        let middle = self.line()?;
        self.advance_to(time_s + exposure_s / 2.0)?;
        Ok(Exposed { begin, middle, end: self.line()? })
    }
}

/// Why a motion cannot be computed.
#[derive(Debug, thiserror::Error)]
pub enum MotionError {
    /// The rod.
    #[error(transparent)]
    Catheter(#[from] CatheterError),
    /// Its line.
    #[error(transparent)]
    Scene(#[from] SceneError),
}
