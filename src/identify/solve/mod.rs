//! Linear algebra of the estimators: least squares on lagged signals by QR, descent to a minimum, and decompositions
//! that terminate.

pub(crate) mod decompositions;
pub(crate) mod descent;
pub(crate) mod regression;
