//! What is true of a frame, as a table of a tracked run has it: places and direction without error.

use super::centre_line::CentreLine;
use super::timing::Stamp;
use crate::estimate::{Estimate, MarkerEstimate, Miss, Position, Tangent};
use crate::rig::Rig;
use crate::source::{Clock, Timestamp};
use crate::track::deflection;
use nalgebra::Matrix3;

/// The row of a frame. `centres_m`: where the bands are along the tube.
pub fn truth(rig: &Rig, seq: u64, stamp: Stamp, line: &CentreLine, centres_m: &[f64]) -> Estimate {
    let marker = |centre_m: &f64| MarkerEstimate {
        position: Ok(Position { point: line.at(*centre_m).0, covariance: Matrix3::zeros(), bound: Matrix3::zeros() }),
        views: Vec::new(),
    };
    let coil_m = centres_m.get(rig.catheter.coil).copied().unwrap_or_default();
    let tangent =
        Tangent { direction: line.at(coil_m).1.normalize(), covariance: Matrix3::zeros(), bound: Matrix3::zeros() };
    Estimate {
        seq,
        stamp: Timestamp { ns: stamp.ns, clock: Clock::Container },
        gap: stamp.gap,
        host: None,
        markers: centres_m.iter().map(marker).collect(),
        deflection: rig.base.as_ref().map(|base| deflection(&tangent, base)).ok_or(Miss::NoBaseFrame),
        tangent: Ok(tangent),
        tick: None,
    }
}
