//! The steerable catheter itself: currents in, shape out.
//!
//! - [`Catheter`]: what it is made of, its coil set, the field and the fluid around it; read from `catheter.toml`.
//! - [`equilibrium`]: the shape at rest under coil currents, weight and a force at the tip.
//! - [`reach`]: where the tip can get to within the current limit.
//! - [`follow`]: the currents that lead the tip along a path.
//! - [`harmonics()`]: what the linearised catheter makes of it at speed.
//! - [`Simulation`]: the catheter in motion, in a fluid, under [`Commands`].
//! - [`fit()`]: parameters from tracked runs.
//! - [`Shape`]: the centre line with its frames, the coil's tangent, θ, and how they follow the currents.
//!
//! # Conventions
//! Everything is in the `base` frame with its origin at the clamp: z along the straight tube from base to tip, B0 in
//! the x-z plane, metres, newtons, amperes. A cross-section's frame has its z along the tube. θ = atan2(t·x, t·z) of
//! the coil set's tangent t.
//!
//! # Source
//! Eqs. 1 to 5 of Tuna et al., "Analysis of dynamic response of an MRI-guided magnetically-actuated steerable catheter
//! system" (2018); rod theory: Antman, "Nonlinear Problems of Elasticity" (2005), chapter 8.

mod commands;
mod dynamics;
#[cfg(test)]
mod dynamics_tests;
mod equilibrium;
mod error;
mod file;
mod fit;
mod follow;
mod harmonic;
mod links;
mod load;
mod model;
mod reach;
mod record;
mod rod;
mod sensitivity;
mod shape;
#[cfg(test)]
mod tests;

pub use commands::Commands;
pub use dynamics::{Accuracy, Moment, Simulation};
pub use equilibrium::equilibrium;
pub use error::CatheterError;
pub(crate) use fit::fit_with_progress;
pub use fit::{Check, Estimated, Fit, FitOptions, Open, Parameter, Pause, Run, Wiring, check, fit};
pub(crate) use follow::follow_with_progress;
pub use follow::{Followed, Target, follow};
pub use harmonic::{Harmonic, harmonics};
pub use links::Energy;
pub use load::Load;
pub use model::{Bands, Catheter, CoilSet, Motion, Surroundings, Tube};
pub use reach::{Reach, Reached, reach};
pub use record::{Noise, Sighting, record, seen};
pub use sensitivity::Sensitivity;
pub use shape::Shape;
