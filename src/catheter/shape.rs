//! The catheter's shape at rest.

use super::load::{Load, all_forces};
use super::model::Catheter;
use super::rod::Section;
use nalgebra::{Point3, UnitQuaternion, Vector3};

/// A shape at rest.
#[derive(Debug, Clone)]
pub struct Shape {
    /// The centre line from the clamp to the tip, every millimetre or closer: distance along it and place, metres.
    pub centre_line: Vec<(f64, Point3<f64>)>,
    /// Middle of the coil set.
    pub coil: Point3<f64>,
    /// Direction of the tube at the coil set, towards the tip; length 1.
    pub tangent: Vector3<f64>,
    /// End of the tube.
    pub tip: Point3<f64>,
    /// Moment at the clamp, N·m.
    pub clamp_nm: Vector3<f64>,
    /// What it was found for.
    pub(super) load: Load,
    /// Frame of the section at the tip, from which all else follows.
    pub(super) tip_frame: UnitQuaternion<f64>,
}

impl Shape {
    pub(super) fn new(catheter: &Catheter, load: &Load, tip_frame: UnitQuaternion<f64>) -> Self {
        let mut sections = catheter.integrate(&tip_frame, &all_forces(catheter, load), 1);
        sections.reverse();
        let coil_m = catheter.flexible_m + catheter.coil_m / 2.0;
        let from_coil = |section: &&Section| (section.arc_m - coil_m).abs();
        let coil = sections.iter().min_by(|a, b| from_coil(a).total_cmp(&from_coil(b)));
        Self {
            coil: coil.map_or_else(Point3::origin, |coil| coil.point),
            tangent: coil.map_or_else(Vector3::z, |coil| coil.frame * Vector3::z()),
            tip: sections.last().map_or_else(Point3::origin, |tip| tip.point),
            clamp_nm: sections.first().map_or_else(Vector3::zeros, |clamp| clamp.moment_nm),
            centre_line: sections.iter().map(|section| (section.arc_m, section.point)).collect(),
            load: *load,
            tip_frame,
        }
    }

    /// θ, radians.
    pub fn theta_rad(&self) -> f64 {
        self.tangent.x.atan2(self.tangent.z)
    }

    /// Angle between the tangent and z, radians.
    pub fn polar_rad(&self) -> f64 {
        self.tangent.z.clamp(-1.0, 1.0).acos()
    }
}
