//! Helpers for tests: samples and their truth, made-up pictures and runs, the command as a user runs it.

pub(crate) mod boards;
pub(crate) mod browser;
pub(crate) mod charuco;
pub(crate) mod command;
pub(crate) mod encode;
pub(crate) mod looped;
pub(crate) mod made_up;
pub(crate) mod moved_mirror;
pub(crate) mod optics;
pub(crate) mod python;
pub(crate) mod studio;
pub(crate) mod synthetic;
pub(crate) mod truth;

#[path = "../../src/testing/mod.rs"]
mod testing;
pub(crate) use testing::{board, fixture, random};

/// Says why a test is left out: past the test harness, which keeps what a passing test prints to itself.
pub(crate) fn skipped(why: &str) {
    use std::io::Write as _;
    std::io::stderr().write_all(format!("SKIPPED: {why}\n").as_bytes()).unwrap();
}
