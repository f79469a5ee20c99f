//! Why a stretch of the tube is not fitted.

/// Why there is no fit.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum NoFit {
    /// The stretch is not, or not wholly enough, inside a view's picture.
    OutOfPicture,
    /// The equations are singular, or the iteration does not settle.
    NotConverged,
    /// The picture was recorded in parts, and lacks one.
    NotRecorded,
    /// A coder quantised the picture there too coarsely.
    TooCoarse,
}
