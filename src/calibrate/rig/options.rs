//! What is known of the rig before its calibration.

use crate::calibrate::board::BoardPicture;
use nalgebra::DMatrix;

/// A tank of flat walls.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tank {
    /// Thickness of its glass, metres.
    pub glass_m: f64,
    /// Index of the glass.
    pub index_glass: f64,
    /// Index of what is in it.
    pub index_inside: f64,
    /// Outer width, depth and height as the camera faces it, metres, when it is a box.
    pub size_m: Option<[f64; 3]>,
    /// The mirrors stand in the water, behind the front wall, instead of beside the tank.
    pub mirrors_inside: bool,
}

/// How to calibrate.
#[derive(Debug, Clone, Default)]
pub struct RigOptions {
    /// How many mirrors.
    pub mirrors: usize,
    /// The tank, if the board was in one.
    pub tank: Option<Tank>,
    /// Covariance of the lens (fx, fy, cx, cy, k1, k2, p1, p2, k3); without it the lens is taken for exact.
    pub lens_covariance: Option<DMatrix<f64>>,
    /// Distances of surfaces from the camera that were measured: name, distance, standard deviation, metres.
    pub distances_m: Vec<(String, f64, f64)>,
    /// Pictures of the board taped flat to the outer face of a wall: the wall's name, the board's image.
    pub taped: Vec<(String, BoardPicture)>,
    /// Standard deviation of the index inside, to let it be fitted; `None` holds it.
    pub index_sd: Option<f64>,
}
