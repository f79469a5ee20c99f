//! Linear algebra of the estimators: least squares on lagged signals by QR, descent to a minimum, and decompositions
//! that terminate.

pub(super) mod decompositions;
pub(super) mod descent;
pub(super) mod regression;
