//! From blobs to an estimate: assignment, the fit of the tube to all views, the coil's tangent.

mod answer;
mod appearance;
mod assign;
#[cfg(test)]
mod assign_tests;
mod blending;
mod chunk;
mod coil;
mod compare;
mod covariance;
mod equations;
mod fields;
mod find;
mod fit;
mod focus;
mod fringes;
mod grain;
mod group_fit;
mod image_model;
mod judge;
mod lamp;
mod last;
mod light;
mod motion;
mod no_fit;
mod normal;
mod padded;
mod pairs;
mod patch;
mod places;
mod repeats;
mod round;
mod scatter;
mod separation;
mod shake;
mod slip;
mod stretch;
mod tracker;
mod trials;
mod tube;
mod tube_image;
mod usual;
mod view;

pub use coil::deflection;
pub(crate) use image_model::ModelError;
pub use tracker::{TrackError, TrackOptions, Tracker};
