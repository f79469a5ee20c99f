//! One camera and a mirror as a 3D instrument.
//!
//! A camera looks at a catheter in a water tank; a mirror beside the tank shows its side. Catoptra follows the coloured
//! bands on the catheter through both views and gives, for every camera frame, the positions of the bands, the coil's
//! direction (its tangent) and its deflection (θ), all with their uncertainties. It is made for the experiments of
//! "Analysis of dynamic response of an MRI-guided magnetically-actuated steerable catheter system" (2018).
//!
//! Every camera frame gives exactly one [`Estimate`](estimate::Estimate), with its true camera time, and for each
//! quantity either a measurement with its covariance or a [`Miss`](estimate::Miss), the reason why there is none.
//!
//! # The one idea
//! A *view* is an ordered list of surfaces that a camera ray meets: mirrors, and walls of glass. A direct view, a
//! mirror, a tank, a mirror inside or outside the tank: all are the same code with different lists.
//! [`OpticalPath::trace`](optics::OpticalPath::trace) follows a pixel's ray through the list,
//! [`OpticalPath::project`](optics::OpticalPath::project) is its inverse. Everything else builds on these two.
//!
//! # The pipeline
//! ```text
//!             rig.toml ── Rig: lens, surfaces, views, bands, base frame
//!                          │
//!             ┌────────────┼──────────────┐
//!             ▼            ▼              ▼
//!  source ─▶ segment ─▶ assign ─▶ fit, triangulate ─▶ tangent, θ ─▶ sinks
//!    │        blobs      one blob       one tube          │         table, log,
//!  Frame      per band   per band       for all           ▼         report, overlay
//!             and view   and view       views          Estimate
//!            └─────────────── Tracker::step ──────────────┘
//! ```
//! [`pipeline::run`] drives it, with source, tracker and sinks each in its own thread. Results depend only on the
//! frames, not on the number of threads or on whether the whole picture was searched.
//!
//! # Example
//! ```no_run
//! use catoptra::rig::Rig;
//! use catoptra::source::{self, SourceOptions};
//! use catoptra::track::{TrackOptions, Tracker};
//! use std::path::Path;
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let rig = Rig::load(Path::new("calibration/dev_tank/rig.toml"))?;
//! let views: Vec<&str> = rig.views.iter().map(|view| view.name.as_str()).collect();
//! let mut frames = source::open("sample_frames/planar.mkv", SourceOptions::default())?;
//! let mut tracker = Tracker::new(&rig, TrackOptions::default())?;
//! while let Some(frame) = frames.next_frame()? {
//!     let estimate = tracker.step(&frame)?;
//!     match &estimate.deflection {
//!         Ok(d) => println!(
//!             "{:.3} s: θ = {:.2}° ± {:.2}°",
//!             estimate.stamp.seconds(),
//!             d.theta_rad.to_degrees(),
//!             d.theta_sd_rad.to_degrees()
//!         ),
//!         Err(miss) => println!("{:.3} s: {}", estimate.stamp.seconds(), miss.word(&views)),
//!     }
//! }
//! # Ok(())
//! # }
//! ```
//!
//! # Frames of reference, units, time
//! - `camera`: OpenCV's frame, origin at the lens, x right, y down, z forward. Pixel (0, 0) is the centre of the
//!   top-left pixel.
//! - `base`: origin in the base band at rest, z along the tube at rest from base to tip, x along the field B0 made
//!   orthogonal to z, y = z × x. Transforms are named like `base_from_camera`, points like `tip_in_base`.
//! - θ = atan2(t·x, t·z) of the coil's tangent t in the base frame: signed, in the plane of B0 and the tangent at rest.
//! - Metres and radians inside (suffixes `_m`, `_rad`, `_px`, `_ns`); mm and degrees only in files for people.
//! - Time is the camera's, in whole nanoseconds, with the name of its clock; never frame number ÷ rate.
//!
//! # Errors
//! Each module that can fail has one error `enum`, with the numbers that explain the failure. A frame that cannot be
//! measured is data, not an error. Nothing here panics on bad input.

// In alphabetical order; the order of the data is in ARCHITECTURE.md.
mod archive;
mod atomic_file;
pub mod calibrate;
mod catch_panic;
pub mod catheter;
pub mod cli;
mod convert;
mod csv_lines;
mod digits;
pub mod estimate;
mod excite;
pub mod identify;
pub mod live;
pub mod log;
mod median;
mod normal;
pub mod optics;
pub mod pipeline;
mod plural;
pub mod report;
pub mod rig;
pub mod segment;
pub mod series;
mod shell;
pub mod simulate;
pub mod sink;
pub mod source;
mod studio;
pub mod tally;
mod text_file;
pub mod track;
mod validate;
mod varying_noise;
mod vetoes;
mod whitening;

#[doc(hidden)]
pub mod fuzz;

#[cfg(test)]
extern crate self as catoptra;

#[cfg(test)]
#[allow(dead_code, reason = "the library's own tests use one part, those in `tests/` another")]
mod testing;
