//! What a rig file needs and a recording can tell: so far, the markers.
//!
//! - [`markers`]: colour models, places along the tube and how the camera draws a band, from one click a marker.

mod around;
pub mod bundle;
mod colours;
pub mod geometry;
pub mod known;
pub mod markers;
mod tune;
