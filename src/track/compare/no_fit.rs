//! Why a stretch of the tube is not fitted.

/// Why there is no fit.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::track) enum NoFit {
    /// The stretch is not, or not sufficiently, inside a view's picture.
    OutOfPicture,
    /// The equations are singular, or the iteration does not converge.
    NotConverged,
    /// A needed part of the picture was not recorded.
    NotRecorded,
    /// The coder quantised the picture there too coarsely.
    TooCoarse,
}
