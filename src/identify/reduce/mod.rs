//! A model with fewer states: balanced truncation, over all frequencies or in a band.

pub(crate) mod balance;
pub(crate) mod gramian;
pub(crate) mod truncation;
