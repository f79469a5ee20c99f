//! From fits to the estimate: positions, tangent and θ, all for one moment, and covariances that also hold what no fit
//! knows: scatter between frames, a camera that shakes or was moved, pictures that show motion late.

pub(super) mod carried;
pub(super) mod deflection;
mod from_fits;
pub(super) mod lateness;
pub(super) mod moved;
pub(super) mod rolling_shutter;
pub(super) mod scatter;
pub(super) mod shake;

pub(super) use from_fits::estimate;
