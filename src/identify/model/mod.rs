//! What a model is: B/A with its simulation, states, H(s), response and bandwidths; the covariance of each; and how
//! well it reproduces a record.

pub(super) mod bandwidth;
pub(crate) mod continuous;
pub(super) mod covariance;
pub(crate) mod modelled;
pub(crate) mod polynomials;
pub(crate) mod reproduction;
pub(super) mod state_space;
