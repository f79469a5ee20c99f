//! # Catoptra
pub mod estimate;
pub mod optics;
pub mod rig;
pub mod segment;
pub mod sink;
pub mod source;
