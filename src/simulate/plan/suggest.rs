//! What would make a rig better: other rigs, each with one thing changed, compared by how well the views' rays fix the
//! tip, σ(tip) ∝ √tr (Σ JᵀJ)⁻¹, J the derivatives of a view's pixel by the place.

use super::super::mount::Mount;
use super::super::scene::in_picture;
use super::Planned;
use crate::median::upper_median;
use crate::optics::{Mirror, OpticalPath, Plane, Surface};
use crate::rig::Rig;
use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, Unit, Vector3};

/// Only what helps by this much is told.
const HELPFUL_BELOW: f64 = 0.95;

/// A change, and what it does.
#[derive(Debug, Clone, PartialEq)]
pub struct Suggestion {
    /// What to do, in words.
    pub what: String,
    /// σ of the tip by noise afterwards, by what it is now.
    pub part: f64,
    /// Shapes of which all views show the tip, and all shapes.
    pub seen: (usize, usize),
}

/// Surfaces, lens and picture of a rig, views without their regions: these would move.
struct Other {
    rig: Rig,
    /// What the catheter moves by, camera frame.
    moved: Isometry3<f64>,
}

pub(super) fn suggestions(rig: &Rig, mount: &Mount, poses: &[Planned]) -> Vec<Suggestion> {
    let tip_m = mount.centres_m.last().copied().unwrap_or(mount.length_m);
    let tips: Vec<Point3<f64>> = poses.iter().map(|pose| pose.line.at(tip_m).0).collect();
    let now = Other { rig: rig.clone(), moved: Isometry3::identity() };
    let Some((own, seen_now)) = now.judged(&tips) else { return Vec::new() };
    let mut all: Vec<(String, Other)> = Vec::new();
    for factor in [1.25, 1.5, 2.0] {
        let mut other = rig.clone();
        other.camera.lens.focal_px *= factor;
        refit(&mut other);
        all.push((format!("a lens {factor} times as long, or pixels smaller by that factor"), still(other)));
    }
    let middle = tips.iter().map(|tip| tip.coords).sum::<Vector3<f64>>() / tips.len().max(1) as f64;
    for part in [0.15, 0.3] {
        let way = middle * -part;
        if let Some(other) = nearer(rig, way) {
            let what = format!("the camera {:.0} mm closer to the catheter", way.norm() * 1e3);
            all.push((what, Other { rig: other, moved: Isometry3::translation(way.x, way.y, way.z) }));
        }
    }
    for (name, surface) in &rig.surfaces {
        let Surface::Mirror(mirror) = surface else { continue };
        for degrees in [-10.0_f64, -5.0, 5.0, 10.0] {
            if let Some(other) = turned(rig, name, mirror, &middle.into(), degrees.to_radians()) {
                let to = if degrees > 0.0 { "clockwise" } else { "anticlockwise" };
                all.push((format!("{name} turned by {:.0}° {to}, seen from above", degrees.abs()), still(other)));
            }
        }
    }
    let mut helpful: Vec<Suggestion> = all
        .into_iter()
        .filter_map(|(what, other)| {
            let (then, seen) = other.judged(&tips)?;
            Some(Suggestion { what, part: then / own, seen: (seen, tips.len()) })
        })
        .filter(|suggestion| suggestion.part < HELPFUL_BELOW && suggestion.seen.0 >= seen_now)
        .collect();
    helpful.sort_by(|a, b| a.part.total_cmp(&b.part));
    helpful
}

fn still(rig: Rig) -> Other {
    Other { rig, moved: Isometry3::identity() }
}

/// Views made anew from the rig's lens and surfaces.
fn refit(rig: &mut Rig) {
    let (lens, surfaces) = (rig.camera.lens, rig.surfaces.clone());
    for view in &mut rig.views {
        let path = view.path.iter().filter_map(|name| surfaces.get(name).copied()).collect();
        view.optics = OpticalPath { lens, surfaces: path };
        view.region_px.clear();
    }
}

/// Everything but the camera moved.
fn nearer(rig: &Rig, way: Vector3<f64>) -> Option<Rig> {
    let mut other = rig.clone();
    for surface in other.surfaces.values_mut() {
        let moved = |plane: &Plane| plane.moved(plane.normal().dot(&way));
        match surface {
            Surface::Mirror(mirror) => mirror.plane = moved(&mirror.plane),
            Surface::Wall(wall) => wall.outer = moved(&wall.outer),
        }
    }
    refit(&mut other);
    // The camera stays outside of the walls that it looks through directly.
    let outside = |surface: Option<&Surface>| match surface {
        Some(Surface::Wall(wall)) => wall.outer.signed_distance(&Point3::origin()) >= 0.0,
        _ => true,
    };
    other.views.iter().all(|view| outside(view.optics.surfaces.first())).then_some(other)
}

/// A mirror turned about the vertical through where it shows the catheter.
fn turned(rig: &Rig, name: &str, mirror: &Mirror, shown: &Point3<f64>, angle_rad: f64) -> Option<Rig> {
    let down = rig.base.as_ref().and_then(|base| base.gravity).unwrap_or_else(|| {
        rig.base.as_ref().map_or_else(Vector3::y, |base| base.base_from_camera.rotation.inverse() * Vector3::z())
    });
    let image = mirror.plane.reflect(shown);
    // Where the straight line from the camera to the image meets the mirror.
    let along = mirror.plane.normal().dot(&image.coords);
    let at = image * (mirror.plane.offset_m() / along);
    let normal = Rotation3::from_axis_angle(&Unit::new_normalize(down), angle_rad) * mirror.plane.normal();
    let plane = Plane::new(normal, normal.dot(&at.coords)).ok()?;
    let mut other = rig.clone();
    other.surfaces.insert(name.to_owned(), Surface::Mirror(Mirror { plane }));
    refit(&mut other);
    Some(other)
}

impl Other {
    /// Median of σ of the tip over the shapes of which all views show it, for noise of one pixel, metres; and how many.
    fn judged(&self, tips: &[Point3<f64>]) -> Option<(f64, usize)> {
        let found: Vec<f64> = tips.iter().filter_map(|tip| self.spread_m(&(self.moved * tip))).collect();
        let count = found.len();
        Some((upper_median(found)?, count))
    }

    fn spread_m(&self, tip: &Point3<f64>) -> Option<f64> {
        let mut information = Matrix3::zeros();
        for view in &self.rig.views {
            let seen = view.optics.project_with_jacobian(tip).ok()?;
            if !in_picture(&self.rig, &seen.pixel) {
                return None;
            }
            information += seen.d_pixel.transpose() * seen.d_pixel;
        }
        Some(information.try_inverse()?.trace().sqrt())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A tank before the camera reaches across the optical axis: its side wall has the camera on the inner side.
    #[test]
    fn the_camera_may_come_nearer_to_any_wall_but_that_before_it() {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/calibration/dev_tank/rig.toml");
        let mut rig = Rig::load(path.as_ref()).unwrap();
        let Some(Surface::Wall(side)) = rig.surfaces.get_mut("side_wall") else { panic!("no side wall") };
        side.outer = side.outer.moved(0.1);
        assert!(side.outer.signed_distance(&Point3::origin()) < 0.0);
        assert!(nearer(&rig, Vector3::new(0.0, 0.0, -0.3)).is_some());
        assert!(nearer(&rig, Vector3::new(0.0, 0.0, -1.4)).is_none());
    }
}
