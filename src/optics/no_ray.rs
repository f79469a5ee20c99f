//! Why no light goes from a point to a pixel.

/// Why no ray connects a pixel and a point.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum NoRay {
    /// The lens model folds over there: pixels and directions do not correspond one to one.
    #[error("outside the field where the lens model is one-to-one")]
    Lens,
    /// The ray runs parallel to a surface or away from it.
    #[error("the ray does not meet a surface of the path")]
    MissesSurface,
    /// A mirror is met from behind, or the point lies behind the last one.
    #[error("behind the mirror")]
    BehindMirror,
    /// The angle of incidence is beyond the critical angle.
    #[error("total reflection")]
    TotalReflection,
    /// The point lies in front of the last surface, before the end of the path, or behind the camera (after unfolding
    /// the mirrors).
    #[error("the point is not in front of the camera and beyond the last surface of the path")]
    BeforeLastSurface,
    /// No ray was found, or the point is not a finite number.
    #[error("no ray found to this point")]
    NotConverged,
}
