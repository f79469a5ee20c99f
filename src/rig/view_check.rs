//! What [`check`](super::check::check) finds out about one view, and about how two views relate.

use super::walk::Crossing;
use crate::optics::Ray;
use nalgebra::{Point2, Point3};

/// A larger error from a pixel to a point and back is a fault of the rig, not rounding.
pub const ROUND_TRIP_LIMIT_PX: f64 = 1e-6;

/// One view.
#[derive(Debug, Clone)]
pub struct ViewCheck {
    /// The pixel of its central ray.
    pub centre_px: Point2<f64>,
    /// The central ray's crossings, in the order of the view's path.
    pub crossings: Vec<Crossing>,
    /// The central ray in the marker's medium.
    pub ray: Ray,
    /// Distance along [`ViewCheck::ray`] of the point that the views look at, metres.
    pub working_distance_m: f64,
    /// What the walls do to the image of that point; `None` without a wall.
    pub refraction: Option<Refraction>,
    /// Projection of traced points back to pixels.
    pub round_trip: RoundTrip,
}

/// The error of ignoring the walls, at the centre of a view.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Refraction {
    /// By how much the point appears nearer than it is, metres.
    pub nearer_m: f64,
    /// Distance between the point and the straight ray of the same pixel, metres.
    pub beside_m: f64,
}

/// Where two central rays come closest.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ClosestApproach {
    /// Midpoint between them, camera frame, metres.
    pub point: Point3<f64>,
    /// Distance between them, metres.
    pub apart_m: f64,
    /// Angle between them, radians.
    pub angle_rad: f64,
}

/// A grid of pixels, traced to points at several distances and projected back.
#[derive(Debug, Clone, PartialEq)]
pub struct RoundTrip {
    /// Pixels of the grid that belong to the view.
    pub pixels: usize,
    /// How many of them have a ray.
    pub with_ray: usize,
    /// Distances of the points along the rays, metres.
    pub distances_m: Vec<f64>,
    /// Points that projected to no pixel.
    pub lost: usize,
    /// Largest distance between a pixel and where its points project, pixels.
    pub max_error_px: f64,
}

impl RoundTrip {
    /// Whether every point projects to its pixel.
    pub fn faithful(&self) -> bool {
        self.lost == 0 && self.max_error_px <= ROUND_TRIP_LIMIT_PX
    }
}
