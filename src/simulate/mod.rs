//! Pictures of a rig, with their truth: what a camera would record, rendered through the rig's optical paths.
//!
//! In: a rig with a base frame, and what the catheter does. Out: pictures, and where everything is in each of them.
//!
//! - [`Mount`]: the rig's bands on a catheter, and where its clamp is; [`Rod`]: what it does under currents.
//! - [`Scene`]: what there is to see; [`Renderer`]: its pictures, one exposure after the other.
//! - [`LiveScene`]: the same at the pace of a camera.
//! - [`Timing`]: when they are exposed; [`truth()`]: the row of the table that belongs to each.
//! - [`Boards`]: pictures of a chessboard for the calibrations, where [`BoardPoses`] puts it.
//! - [`plan`]: how well a rig will measure.
//!
//! Every pixel's ray goes through the view's mirrors and walls and is intersected with the tube (`tube.rs`). Nothing of
//! the tracker's image model is used: what agrees with it agrees not by construction.
//!
//! # What it does not show
//! Depth of field, dispersion, dirt, waves; light that is reflected by panes; shadows; the tube's own reflection in
//! what is not a view. Surfaces have no edges but those of the views' regions.

mod board_poses;
mod boards;
mod centre_line;
mod error;
mod light;
mod live;
mod look;
mod motion;
mod mount;
mod picture;
pub mod plan;
mod poses;
mod rays;
mod scene;
mod sensor;
mod taught;
mod timing;
mod truth;
mod tube;
mod video;

pub use board_poses::{BoardPoses, BoardSet, BoardsError};
pub use boards::Boards;
pub use centre_line::{CentreLine, Exposed};
pub use error::SceneError;
pub use live::{LiveScene, MAX_AHEAD, Motion, noise_seed};
pub use motion::{MotionError, Rod, StandardMotion};
pub use mount::Mount;
pub use picture::{Renderer, Stored};
pub use poses::line_through;
pub use scene::{Clamp, Scene};
pub use sensor::Sensor;
pub use taught::taught;
pub use timing::{Stamp, Timing};
pub use truth::truth;
