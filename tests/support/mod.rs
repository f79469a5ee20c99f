//! What tests share: samples and their truth, pictures and runs that are made up, the command as a user runs it.

pub(crate) mod charuco;
pub(crate) mod command;
pub(crate) mod encode;
pub(crate) mod moved_mirror;
pub(crate) mod optics;
pub(crate) mod python;
pub(crate) mod studio;
pub(crate) mod synthetic;
pub(crate) mod truth;

#[path = "../../src/testing/mod.rs"]
mod testing;
pub(crate) use testing::{board, fixture, random, scene};
