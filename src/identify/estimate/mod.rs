//! Estimators of a model from samples, the search for its orders and delay, and what noise does to σ. Also the unknown
//! zero of the angle, the delay between the clocks, and what inputs do between samples.

pub(super) mod arx;
pub(super) mod between_samples;
pub(crate) mod clock_delay;
pub(super) mod estimated;
pub(super) mod initial_models;
pub(super) mod instrumental;
pub(super) mod noise_colour;
pub(super) mod output_error;
pub(crate) mod search;
pub(super) mod shortest_delay;
mod subspace;
pub(crate) mod unknown_zero;
