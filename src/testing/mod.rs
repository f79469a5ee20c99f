//! Helpers for tests: a made-up run, pictures with known details, and random numbers.
//!
//! Compiled only for tests: for those of the library, and again for those in `tests/`, which include this folder. So it
//! names the library from outside and uses only its public items.

pub(crate) mod bands;
pub(crate) mod board;
pub(crate) mod fixture;
pub(crate) mod random;
pub(crate) mod two_views;
