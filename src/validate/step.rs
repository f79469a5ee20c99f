//! One command and its observation.

use nalgebra::Point3;

/// One command and its observation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Step {
    /// Its number, from 0.
    pub k: usize,
    /// When it was given, seconds since the first.
    pub t_s: f64,
    /// Where the marker should be, metres.
    pub desired: Point3<f64>,
    /// Where it was.
    pub observed: Option<Point3<f64>>,
    /// The same after the alignment.
    pub aligned: Option<Point3<f64>>,
    /// Camera frames averaged; 0 if interpolated.
    pub frames: usize,
}
