//! What tests are made of: a made-up run, pictures of which every detail is known, and numbers drawn at random.
//!
//! Compiled for tests only: for those of the library, and once more for those in `tests/`, which include this folder.
//! So it names the library from outside, and uses what is public.

pub(crate) mod bands;
pub(crate) mod board;
pub(crate) mod fixture;
pub(crate) mod random;
pub(crate) mod scene;
pub(crate) mod tube;
