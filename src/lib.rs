//! # Catoptra
pub mod estimate;
pub mod optics;
pub mod report;
pub mod rig;
pub mod sink;
pub mod source;
pub mod track;
