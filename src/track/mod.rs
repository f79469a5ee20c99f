//! From pictures to places.
mod appearance;
mod fit;
mod light;
mod patch;
mod tube;
pub mod dev;
