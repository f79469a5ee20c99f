//! Why light does not go from a place to a pixel.

/// Why no ray connects a pixel and a place.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum NoRay {
    /// The lens model folds over there: pixel and direction do not belong to each other one to one.
    #[error("outside the field where the lens model is one-to-one")]
    Lens,
    /// The ray runs parallel to a surface or away from it: the path does not lead this way.
    #[error("the ray does not meet a surface of the path")]
    MissesSurface,
    /// A mirror is met from behind, or the point lies behind the last one.
    #[error("behind the mirror")]
    BehindMirror,
    /// The angle is beyond the critical one.
    #[error("total reflection")]
    TotalReflection,
    /// The point lies in front of the last surface, where the path has not ended yet, or (mirrored back, where there
    /// are mirrors) behind the camera.
    #[error("the point is not in front of the camera and beyond the last surface of the path")]
    BeforeLastSurface,
    /// No ray was found, or the point is not a finite number.
    #[error("no ray found to this point")]
    NotConverged,
}
