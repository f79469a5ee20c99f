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
    /// The tip: end of the tube, or middle of the tip's band ([`Catheter::tip_m`]).
    pub tip: Point3<f64>,
    /// Moment at the clamp, N·m.
    pub clamp_nm: Vector3<f64>,
    /// What it was found for.
    pub(super) load: Load,
    /// Curvature and twist less those at rest, 1/m, along the rod.
    curvatures: Vec<(f64, Vector3<f64>)>,
    /// Frame of the section at the tip, from which all else follows.
    pub(super) tip_frame: UnitQuaternion<f64>,
}

impl Shape {
    pub(super) fn new(catheter: &Catheter, load: &Load, tip_frame: UnitQuaternion<f64>) -> Self {
        let mut sections = catheter.integrate(&tip_frame, &all_forces(catheter, load), 1);
        sections.reverse();
        let coil_m = catheter.flexible_m + catheter.coil_m / 2.0;
        let tube = &catheter.tube;
        let stiffness = Vector3::new(tube.bending_nm2(), tube.bending_nm2(), tube.torsion_nm2());
        let nearest = |arc_m: f64| {
            let off = move |section: &Section| (section.arc_m - arc_m).abs();
            sections.iter().min_by(move |a, b| off(a).total_cmp(&off(b)))
        };
        let coil = nearest(coil_m);
        let tip_m = catheter.tip_m();
        // Half a millimetre away at most: it bends by less than a micrometre there.
        let at_tip = |section: &Section| section.point + section.frame * Vector3::z() * (tip_m - section.arc_m);
        Self {
            coil: coil.map_or_else(Point3::origin, |coil| coil.point),
            tangent: coil.map_or_else(Vector3::z, |coil| coil.frame * Vector3::z()),
            tip: nearest(tip_m).map_or_else(Point3::origin, at_tip),
            clamp_nm: sections.first().map_or_else(Vector3::zeros, |clamp| clamp.moment_nm),
            centre_line: sections.iter().map(|section| (section.arc_m, section.point)).collect(),
            curvatures: sections
                .iter()
                .map(|section| {
                    let moment = section.frame.inverse_transform_vector(&section.moment_nm);
                    (section.arc_m, moment.component_div(&stiffness))
                })
                .collect(),
            load: *load,
            tip_frame,
        }
    }

    /// Curvature and twist beyond those at rest, in the section's frame, at this distance along the rod, 1/m.
    pub(super) fn curvature(&self, arc_m: f64) -> Vector3<f64> {
        let nearest = self.curvatures.partition_point(|(at_m, _)| *at_m < arc_m);
        let pair = self.curvatures.get(nearest.max(1) - 1).zip(self.curvatures.get(nearest.max(1)));
        pair.map_or_else(Vector3::zeros, |((from_m, from), (to_m, to))| {
            let part = if to_m > from_m { ((arc_m - from_m) / (to_m - from_m)).clamp(0.0, 1.0) } else { 0.0 };
            from + (to - from) * part
        })
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
