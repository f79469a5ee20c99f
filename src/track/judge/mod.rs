//! Whether fits show the bands: residuals, sizes and widths are compared with the usual ones, positions with what the
//! earlier motion allows.

mod fits;
mod light_change;
mod motion;

pub(super) use fits::Judge;
pub(super) use motion::{Motion, Place};
