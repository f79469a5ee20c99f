//! [`Shape`]: the board's deviation from flatness.
//!
//! A board of paper on wood or card is bent by some tenths of a per cent of its width. All pictures show it, and if the
//! board is assumed flat the lens absorbs it: focal length and principal point are wrong by more than noise explains,
//! in the same way for every half of the pictures. Boards tilted to several sides separate the bend from the lens.
//!
//! z = a u² + b u v + c v², u and v along the board's sides from its centre, in units of its half width.

use nalgebra::{Point3, Vector3};

/// Prior σ of the bend, as a fraction of the board's half width.
const FLAT: f64 = 5e-3;

/// A board's shape.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Shape {
    /// Half of the board's longer side, where `bend_m` applies, metres.
    pub half_m: f64,
    /// a, b, c: how far it rises at its edges, metres.
    pub bend_m: [f64; 3],
}

impl Shape {
    /// A flat board with these corners, its centre at the origin.
    pub fn flat<'a>(places: impl IntoIterator<Item = &'a Point3<f64>>) -> Self {
        let half_m = places.into_iter().fold(0.0, |most: f64, p| most.max(p.x.abs()).max(p.y.abs()));
        Self { half_m, bend_m: [0.0; 3] }
    }

    /// A rigid set of points, without a bend.
    pub(crate) fn rigid() -> Self {
        Self { half_m: f64::INFINITY, bend_m: [0.0; 3] }
    }

    /// Prior σ of the bend, metres; arbitrary for a rigid shape, where it has no effect.
    pub(crate) fn prior_sd_m(&self) -> f64 {
        if self.half_m.is_finite() { FLAT * self.half_m } else { 1.0 }
    }

    /// d z / d bend at a point of the flat board.
    pub(crate) fn rises(&self, place: &Point3<f64>) -> [f64; 3] {
        let (u, v) = (place.x / self.half_m, place.y / self.half_m);
        [u * u, u * v, v * v]
    }

    /// Position of a point of the flat board on this one.
    pub fn place(&self, flat: &Point3<f64>) -> Point3<f64> {
        if self.bend_m == [0.0; 3] {
            return *flat;
        }
        let z: f64 = self.rises(flat).iter().zip(self.bend_m).map(|(rise, bend_m)| rise * bend_m).sum();
        flat + Vector3::z() * z
    }

    /// Changed by a step.
    pub(crate) fn stepped(mut self, step: &[f64]) -> Self {
        self.bend_m.iter_mut().zip(step).for_each(|(bend_m, step)| *bend_m += step);
        self
    }

    /// Deviation from flatness: from the highest to the lowest corner, relative to the best-fit plane, metres.
    pub fn sag_m(&self, places: &[Point3<f64>]) -> f64 {
        let count = places.len().max(1) as f64;
        let rises: Vec<f64> = places.iter().map(|p| self.place(p).z).collect();
        // With the centre at the origin and a full grid there is no slope: uv and squares have none.
        let mean = rises.iter().sum::<f64>() / count;
        let bound = |pick: fn(f64, f64) -> f64| rises.iter().map(|z| z - mean).fold(0.0, pick);
        bound(f64::max) - bound(f64::min)
    }
}
