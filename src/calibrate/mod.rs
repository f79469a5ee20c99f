//! What a rig file needs and a recording or pictures of a board can tell.
//!
//! - [`board`]: calibration boards, found in a picture ([`grey`]).
//! - [`markers`]: colour models, places along the tube and how the camera draws a band, from one click a marker.

mod around;
pub mod board;
pub mod bundle;
pub mod camera;
mod colours;
pub mod geometry;
pub mod grey;
pub mod known;
pub mod markers;
pub mod mirrors;
pub mod start;
mod tune;
pub mod verdict;
