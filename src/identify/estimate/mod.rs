//! Estimators of a model from samples, the search for its orders and delay, and what noise does to σ. Also the unknown
//! zero of the angle, and the delay between the clocks.

pub(crate) mod arx;
pub(crate) mod clock_delay;
pub(crate) mod estimated;
pub(crate) mod initial_models;
pub(crate) mod instrumental;
pub(crate) mod noise_colour;
pub(crate) mod output_error;
pub(crate) mod search;
pub(crate) mod shortest_delay;
pub(crate) mod subspace;
pub(crate) mod unknown_zero;
pub(crate) mod varying_noise;
