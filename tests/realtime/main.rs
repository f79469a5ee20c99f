//! Timing-dependent tests: live runs at a camera's pace, timed signals and kills, simulated devices.
//!
//! A separate program from `tests/it`: Cargo runs one after another, so that no calibration takes the processors from a
//! camera that must not lose a frame.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test fails by panicking, its helpers too"
)]
#![allow(clippy::print_stdout, reason = "the figures of many tests are worth a look")]

#[path = "../support/mod.rs"]
#[allow(dead_code, unused_imports, reason = "each of the two programs uses its part")]
mod support;

mod calibrate_interrupt;
mod genicam;
mod gstreamer;
mod live;
mod live_disk_full;
mod live_faults;
mod live_kill;
mod live_load;
mod live_python;
mod live_raw;
mod live_record;
#[cfg(feature = "ros2")]
mod live_ros2;
mod live_simulated;
mod live_stream;
mod log_crash;
mod publish;
mod studio;
mod track_interrupt;
mod v4l2;
