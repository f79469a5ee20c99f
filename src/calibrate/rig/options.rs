//! Options and prior knowledge for calibrating a rig.

use crate::calibrate::board::BoardPicture;
use nalgebra::DMatrix;

/// A tank with flat walls.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tank {
    /// Thickness of its glass, metres.
    pub glass_m: f64,
    /// Refractive index of the glass.
    pub index_glass: f64,
    /// Refractive index of its content.
    pub index_inside: f64,
    /// Outer width, depth and height as seen from the camera, metres, if it is a box.
    pub size_m: Option<[f64; 3]>,
    /// Whether the mirrors are in the water, behind the front wall, instead of beside the tank.
    pub mirrors_inside: bool,
}

/// A board taped flat to the outer face of a wall.
#[derive(Debug, Clone)]
pub struct TapedBoard {
    /// The wall's name.
    pub wall: String,
    /// Its picture.
    pub picture: BoardPicture,
    /// Distance of its print from the wall, metres: the thickness of what it is glued to.
    pub thickness_m: f64,
}

/// How to calibrate.
#[derive(Debug, Clone, Default)]
pub struct RigOptions {
    /// Number of mirrors.
    pub mirrors: usize,
    /// The tank, if the board was in one.
    pub tank: Option<Tank>,
    /// Covariance of the lens (fx, fy, cx, cy, k1, k2, p1, p2, k3; of a rational one also k4, k5, k6); without it the
    /// lens is assumed exact.
    pub lens_covariance: Option<DMatrix<f64>>,
    /// Measured distances of surfaces from the camera: name, distance, standard deviation, metres.
    pub distances_m: Vec<(String, f64, f64)>,
    /// Boards taped to walls.
    pub taped: Vec<TapedBoard>,
    /// Standard deviation of the index inside, to fit it; `None` fixes it.
    pub index_sd: Option<f64>,
}
