//! What a rig file needs and pictures of a board or a recording can tell. Each step reads a rig file and adds its part.
//!
//! - [`camera`]: the lens, from boards in air.
//! - [`mirrors`]: mirrors, walls and views, from boards seen directly and in mirrors.
//! - [`mirror`]: where a mirror is that was bumped, from bands seen in an ordinary recording, without a board.
//! - [`markers`]: colour models, places along the tube and how the camera draws a band, from one click a marker.
//! - [`base`]: the frame of the catheter at rest and B0, from a recording at rest and one of a planar swing.
//!
//! The first two stand on [`board`] (corners in a picture, [`grey`]), [`geometry`] (lens and surfaces as parameters),
//! [`bundle`] (the adjustment, with what is [`known`] beside the pictures) and [`mod@start`] (its first guess);
//! [`mod@verdict`] says how well the result will measure, [`mod@held_out`] checks it on lengths,
//! [`mod@doubts`] says what speaks against it; [`mod@enough`] refuses what no verdict is to be had of.

mod around;
mod arrow;
pub mod base;
pub mod board;
pub mod bundle;
pub mod camera;
mod colours;
pub mod doubts;
pub mod enough;
mod frames;
pub mod geometry;
pub mod grey;
pub mod held_out;
pub mod known;
pub mod markers;
mod meeting;
pub mod mirror;
pub mod mirrors;
mod regions;
pub mod start;
mod taped;
#[cfg(test)]
mod tests;
mod tune;
pub mod verdict;

pub use meeting::KnownLength;

/// A positive length as people write it, `12mm`, `1.2 cm` or `0.012m`, in metres; `None` when it is none, or has no unit.
pub fn length_m(text: &str) -> Option<f64> {
    let (number, unit_m) = [("mm", 1e-3), ("cm", 1e-2), ("m", 1.0)]
        .into_iter()
        .find_map(|(unit, unit_m)| Some((text.trim().strip_suffix(unit)?, unit_m)))?;
    let length_m = number.trim_end().parse::<f64>().ok()? * unit_m;
    (length_m > 0.0 && length_m.is_finite()).then_some(length_m)
}
