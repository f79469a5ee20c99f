//! What a model is: B/A with its simulation, states, H(s), response and bandwidths; the covariance of each; and how
//! well it reproduces a record.

pub(crate) mod bandwidth;
pub(crate) mod continuous;
pub(crate) mod covariance;
pub(crate) mod modelled;
pub(crate) mod polynomials;
pub(crate) mod reproduction;
pub(crate) mod state_space;
