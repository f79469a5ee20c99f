//! What is remembered of the bands from frame to frame: what is usual for each of them, whether they rest, and when
//! frames were last fitted in other ways too.

pub(super) mod at_rest;
pub(super) mod by_band;
pub(super) mod trials;
pub(super) mod usual;
