//! A model with fewer states: balanced truncation, over all frequencies or in a band.

pub(super) mod balance;
pub(super) mod gramian;
pub(crate) mod truncation;
