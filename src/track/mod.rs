//! From pictures to places: assignment of blobs, triangulation, the fit of the tube to all views, the coil's tangent.

mod appearance;
mod assign;
#[cfg(test)]
mod assign_tests;
mod coil;
#[cfg(test)]
mod drawn;
mod drift;
mod fit;
mod light;
mod normal;
mod patch;
mod stretch;
mod tracker;
mod triangulate;
mod tube;

pub use coil::deflection;
pub use drift::{Drift, DriftAlarm, Drifted};
pub(crate) use fit::ModelError;
pub use tracker::{TrackError, TrackOptions, Tracker};
pub use triangulate::{Sighting, Triangulated, triangulate};
