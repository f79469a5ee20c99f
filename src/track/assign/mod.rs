//! Which blob is which band in which view, from the blobs of a frame and where the bands were before.

mod assigner;
mod finder;
#[cfg(test)]
mod tests;

pub(super) use assigner::{Assigned, direction_of_axes};
pub(super) use finder::{Finder, Found};
