//! Calibration of a rig file from pictures of a board or a recording: one module for each verb of `catoptra calibrate`.
//! Each reads a rig file and adds its part.
//!
//! - [`camera`]: the lens, from pictures of a board in air.
//! - [`rig`]: mirrors, walls and views, from pictures of a board seen directly and in mirrors.
//! - [`mirror`]: a mirror that was bumped, from the bands in an ordinary recording, without a board.
//! - [`markers`]: colour models, places along the tube and how the camera images a band, from one click per marker.
//! - [`base`]: the frame of the catheter at rest and B0, from a recording at rest and one of a planar swing.
//!
//! `camera` and `rig` build on [`board`] (corners in a picture), [`geometry`] (lens and surfaces as parameters) and
//! `bundle` (the adjustment, with prior knowledge). `rig` and `mirror` share `least_squares` with it.

// What the verbs build on.
pub mod board;
pub(crate) mod bundle;
mod frames;
pub mod geometry;
mod least_squares;

// The verbs.
pub mod base;
pub mod camera;
pub mod markers;
pub mod mirror;
pub mod rig;

#[cfg(test)]
mod tests;

/// A positive length with unit, `12mm`, `1.2 cm` or `0.012m`, in metres; `None` when it is not a length, or has no
/// unit.
pub fn length_m(text: &str) -> Option<f64> {
    any_length_m(text).filter(|length_m| *length_m > 0.0)
}

/// The same, of any sign and 0 as well.
fn any_length_m(text: &str) -> Option<f64> {
    let (number, unit_m) = [("mm", 1e-3), ("cm", 1e-2), ("m", 1.0)]
        .into_iter()
        .find_map(|(unit, unit_m)| Some((text.trim().strip_suffix(unit)?, unit_m)))?;
    let length_m = number.trim_end().parse::<f64>().ok()? * unit_m;
    length_m.is_finite().then_some(length_m)
}
