//! How runs are evaluated.

use super::spline::Interpolation;

/// How runs are evaluated.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Options {
    /// Periods that are left out at the beginning, while the motion settles.
    pub skip: usize,
    /// The marker that follows the path; the tip if none is named.
    pub marker: Option<String>,
    /// How to go from frame to frame where pauses are shorter than the time between frames.
    pub interpolation: Interpolation,
}

impl Default for Options {
    fn default() -> Self {
        Self { skip: 1, marker: None, interpolation: Interpolation::Spline }
    }
}
