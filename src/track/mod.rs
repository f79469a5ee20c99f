//! From blobs to an estimate: assignment, the fit of the tube to all views, the coil's tangent.
//!
//! A frame goes through these folders, and [`Tracker::step`] composes them (`tracker/`):
//!
//! 1. `assign/`: which blob is which band in which view;
//! 2. `fit/`: the tube around the bands, fitted to the pictures of all views. `model/` says how a picture shows a tube,
//!    `compare/` compares pixels with that;
//! 3. `judge/`: whether a fit shows its band, or something in front of it;
//! 4. `answer/`: positions, tangent and θ, with all that their covariances have to hold.
//!
//! `memory/` has what is usual for a band, from the frames before; `recording/` what is asked of the recording as a
//! whole, and `tracker/warnings.rs` what is then said of it.
//!
//! Imports go one way: from `memory`, `model` and `assign` up through `compare`, `fit` and `judge` to `recording`; and
//! from `fit` to `answer`.

mod answer;
mod assign;
mod compare;
mod fit;
mod judge;
mod memory;
mod model;
mod recording;
mod tracker;

pub use answer::deflection::deflection;
pub(crate) use answer::deflection::{theta_derivative, theta_derivative_by_turn};
pub(crate) use model::image_model::ModelError;
pub(crate) use recording::long_exposure::LONGEST_EXPOSURE;
pub(crate) use recording::misfit_curve;
pub use tracker::{TrackError, TrackOptions, Tracker};
