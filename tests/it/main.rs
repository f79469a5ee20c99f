//! End-to-end tests of the library and the command: one program, because each one links OpenCV and FFmpeg again.
//!
//! To run a single file: `cargo test --test it calibrate_base::`. Timing-dependent tests are in `tests/realtime`.

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

mod accuracy;
mod allocations;
mod architecture;
mod batch;
mod calibrate_base;
mod calibrate_board;
mod calibrate_charuco;
mod calibrate_charuco_rig;
mod calibrate_markers;
mod calibrate_mirror;
mod calibrate_page;
mod calibrate_phone;
mod calibrate_points;
mod calibrate_rig;
mod calibrate_sets;
mod catheter;
mod changed_pictures;
mod collect;
mod diameter;
mod drift;
mod excite;
mod first_run;
mod help_examples;
mod hostile_input;
mod identify;
mod identify_applied;
mod identify_bad_input;
mod identify_commands;
mod identify_planes;
mod identify_python;
mod instructions;
mod log_damage;
mod log_doctor;
mod log_python;
mod log_ros2;
mod log_tables;
mod manifest;
mod media_damage;
mod mutations;
mod optics_dev_tank;
mod optics_properties;
mod outcomes;
mod overlay;
mod paper;
mod record_video;
mod record_windows;
mod report;
mod rig_file;
mod rig_formats;
mod sample_rig;
mod simulate;
mod source_images;
mod source_recordings;
mod source_warnings;
mod studio;
mod time_stamps;
mod track_bad_input;
mod track_motion;
mod track_python;
mod track_recordings;
mod track_run;
mod validate;
mod vetoes;
mod workflow;
