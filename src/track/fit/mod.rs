//! The fit of the tube to the pictures of all views: each group of bands from its starts, the minimisation, and the
//! covariance.

pub(super) mod colour_fringes;
mod colours_apart;
mod covariance;
pub(super) mod group_fit;
pub(super) mod last_fit;
mod levenberg_marquardt;
pub(super) mod tube_fit;
mod view;
