//! How runs are evaluated.

use super::spline::Interpolation;

/// How runs are evaluated.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Options {
    /// Periods left out at the beginning, while the motion settles.
    pub skip: usize,
    /// The marker that follows the path; the tip if none is named.
    pub marker: Option<String>,
    /// Which frames of a pause count.
    pub average: Average,
    /// Interpolation between frames where pauses are shorter than the time between frames.
    pub interpolation: Interpolation,
}

/// Which frames of a pause are averaged, where there is at least one frame per pause.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) enum Average {
    /// All.
    #[default]
    All,
    /// Those of its second half, as in the laboratory: closer to where the catheter comes to rest. Such a point is a
    /// quarter of a pause later, which the phase takes into account.
    SecondHalf,
}

impl Average {
    /// Fraction of a pause left out at its beginning.
    pub(super) fn left_out(self) -> f64 {
        match self {
            Self::All => 0.0,
            Self::SecondHalf => 0.5,
        }
    }
}

impl Default for Options {
    fn default() -> Self {
        Self { skip: 1, marker: None, average: Average::All, interpolation: Interpolation::Spline }
    }
}
