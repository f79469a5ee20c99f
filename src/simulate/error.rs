//! Why there is nothing to render.

use crate::optics::NoRay;

/// Why a scene cannot be rendered.
#[derive(Debug, thiserror::Error)]
pub enum SceneError {
    /// The rig has no base frame.
    #[error(
        "the rig has no [base]: nobody knows where the catheter is; measure it with `catoptra calibrate base`, or \
             write base_from_camera and b0 as you plan them"
    )]
    NoBase,
    /// A band without a place along the tube.
    #[error("marker `{marker}` has no centre_mm: write how far along the tube the middle of its band is")]
    NoPlace {
        /// Its name.
        marker: String,
    },
    /// Bands that leave no room for a part of the catheter.
    #[error("the bands' places leave {length_mm:.1} mm of tube {what}, expected more than 0")]
    NoRoom {
        /// Which part.
        what: &'static str,
        /// Its length, mm.
        length_mm: f64,
    },
    /// The catheter is too short for the rig's bands.
    #[error(
        "the first band would begin {off_mm:.1} mm inside the clamp: flexible_mm of the catheter, or centre_mm of \
             the rig's markers, is wrong"
    )]
    BehindClamp {
        /// By how much, mm.
        off_mm: f64,
    },
    /// The catheter ends elsewhere than the rig's last band.
    #[error(
        "the catheter is {rod_mm:.1} mm long, the rig's bands end {bands_mm:.1} mm from the clamp: tail_mm of the \
             catheter, or centre_mm of the rig's markers, is wrong"
    )]
    Length {
        /// Of the rod, mm.
        rod_mm: f64,
        /// To the end of the last band, mm.
        bands_mm: f64,
    },
    /// The rig's camera shows row after row.
    #[error(
        "the rig's camera has a rolling shutter (camera.readout_ms), and pictures are drawn at one moment: leave it \
             out of the rig to be simulated"
    )]
    RollingShutter,
    /// The camera is inside a tank.
    #[error(
        "the camera is inside the tank: surface `{surface}` has it {inside_mm:.0} mm behind its outer face; its \
             normal must point to the camera's side, and offset_mm be negative"
    )]
    CameraInside {
        /// The wall.
        surface: String,
        /// How deep, mm.
        inside_mm: f64,
    },
    /// A view that shows nothing of the catheter at rest.
    #[error("view `{view}` shows nothing of the catheter at rest: {why}")]
    NotShown {
        /// Its name.
        view: String,
        /// Why, in words.
        why: String,
    },
    /// A view without a central ray.
    #[error("a view's rays are lost: {0}")]
    NoRay(#[from] NoRay),
    /// Bands of colours that are too much alike.
    #[error("the bands' colours cannot be learned: {0}")]
    Colours(String),
    /// A line without length.
    #[error("the catheter has no centre line")]
    NoLine,
}
