//! From pictures to places: assignment of blobs, triangulation, the fit of the tube to all views, the coil's tangent.

mod appearance;
mod assign;
#[cfg(test)]
mod assign_tests;
mod coil;
mod compare;
mod covariance;
#[cfg(test)]
mod drawn;
mod drift;
mod equations;
mod fit;
mod image_model;
mod light;
mod normal;
mod patch;
mod round;
mod stretch;
mod tracker;
mod triangulate;
mod tube;
mod tube_image;
mod view;

pub use coil::deflection;
pub use drift::{Drift, DriftAlarm, Drifted};
pub(crate) use image_model::ModelError;
pub use tracker::{TrackError, TrackOptions, Tracker};
pub use triangulate::{Sighting, Triangulated, triangulate};
