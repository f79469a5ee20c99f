//! The 3D view: tube, bands and coil direction as `foxglove.SceneUpdate`, and the transform between the frames.

use super::convert::{Names, point3, timestamp, vector3};
use crate::estimate::Estimate;
use crate::rig::{Marker, Rig};
use foxglove::messages::{
    ArrowPrimitive, Color, CylinderPrimitive, FrameTransform, LinePrimitive, Pose, Quaternion, SceneEntity,
    SceneUpdate, SpherePrimitive, Vector3 as Size, line_primitive,
};
use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector3};

pub(super) const CAMERA_FRAME: &str = "camera";
const BASE_FRAME: &str = "base";

/// Bands are drawn this much thicker than the tube, to be visible on it.
const BAND_OVER_TUBE: f64 = 1.3;
/// Length of the arrow along the coil's direction, metres.
const ARROW_M: f64 = 0.015;
const TUBE: Color = Color { r: 0.92, g: 0.92, b: 0.92, a: 1.0 };
const ARROW: Color = Color { r: 0.95, g: 0.35, b: 0.1, a: 1.0 };
const COLOUR_NOT_LEARNED: Color = Color { r: 0.5, g: 0.5, b: 0.5, a: 1.0 };

/// What drawing an estimate needs from the rig.
#[derive(Debug)]
pub(super) struct Scene {
    frame_id: &'static str,
    frame_from_camera: Isometry3<f64>,
    diameter_m: f64,
    coil: usize,
    bands: Vec<(Color, f64)>,
}

impl Scene {
    /// The scene is drawn in the base frame when there is one, else in the camera frame.
    pub(super) fn new(rig: &Rig) -> Self {
        let (frame_id, frame_from_camera) = match &rig.base {
            Some(base) => (BASE_FRAME, base.base_from_camera),
            None => (CAMERA_FRAME, Isometry3::identity()),
        };
        Self {
            frame_id,
            frame_from_camera,
            diameter_m: rig.catheter.diameter_m,
            coil: rig.catheter.coil,
            bands: rig.markers.iter().map(|m| (colour(m), m.length_m)).collect(),
        }
    }

    /// One entity per frame, which replaces that of the previous frame: what was not measured is not drawn.
    pub(super) fn update(&self, estimate: &Estimate) -> SceneUpdate {
        let places: Vec<Option<Point3<f64>>> = estimate
            .markers
            .iter()
            .map(|m| m.position.as_ref().ok().map(|p| self.frame_from_camera * p.point))
            .collect();
        let tangent = estimate.tangent.as_ref().ok().map(|t| self.frame_from_camera * t.direction);
        let along_coil = tangent.and_then(|t| UnitQuaternion::rotation_between(&Vector3::z(), &t));
        let coil = places.get(self.coil).copied().flatten();

        let mut entity = SceneEntity {
            timestamp: Some(timestamp(estimate.stamp.ns)),
            frame_id: self.frame_id.to_owned(),
            id: "catheter".to_owned(),
            ..SceneEntity::default()
        };
        for (index, (place, &(color, length_m))) in places.iter().zip(&self.bands).enumerate() {
            let Some(place) = place else { continue };
            let width = self.diameter_m * BAND_OVER_TUBE;
            match along_coil.filter(|_| index == self.coil) {
                Some(rotation) => entity.cylinders.push(CylinderPrimitive {
                    pose: Some(pose(place, &rotation)),
                    size: Some(Size { x: width, y: width, z: length_m }),
                    bottom_scale: 1.0,
                    top_scale: 1.0,
                    color: Some(color),
                }),
                // The direction of the other bands is not measured: no cylinder, which would claim one.
                None => entity.spheres.push(SpherePrimitive {
                    pose: Some(pose(place, &UnitQuaternion::identity())),
                    size: Some(Size { x: width, y: width, z: width }),
                    color: Some(color),
                }),
            }
        }
        entity.lines.push(LinePrimitive {
            r#type: line_primitive::Type::LineStrip.into(),
            pose: Some(pose(&Point3::origin(), &UnitQuaternion::identity())),
            thickness: self.diameter_m,
            points: places.iter().flatten().map(point3).collect(),
            color: Some(TUBE),
            ..LinePrimitive::default()
        });
        if let (Some(place), Some(direction)) = (coil, tangent) {
            entity.arrows.push(self.arrow(&place, &direction));
        }
        SceneUpdate { deletions: Vec::new(), entities: vec![entity] }
    }

    fn arrow(&self, from: &Point3<f64>, direction: &Vector3<f64>) -> ArrowPrimitive {
        // An arrow lies along its pose's x axis; for the exact opposite, any half turn will do.
        let rotation = UnitQuaternion::rotation_between(&Vector3::x(), direction)
            .unwrap_or_else(|| UnitQuaternion::from_axis_angle(&Vector3::z_axis(), std::f64::consts::PI));
        ArrowPrimitive {
            pose: Some(pose(from, &rotation)),
            shaft_length: ARROW_M * 0.75,
            shaft_diameter: self.diameter_m * 0.4,
            head_length: ARROW_M * 0.25,
            head_diameter: self.diameter_m,
            color: Some(ARROW),
        }
    }
}

/// Where the camera is in the base frame; `None` without a base frame.
pub(super) fn camera_in_base(names: &Names, stamp_ns: i64) -> Option<FrameTransform> {
    let base_from_camera = names.base_from_camera()?;
    Some(FrameTransform {
        timestamp: Some(timestamp(stamp_ns)),
        parent_frame_id: BASE_FRAME.to_owned(),
        child_frame_id: CAMERA_FRAME.to_owned(),
        translation: Some(vector3(&base_from_camera.translation.vector)),
        rotation: Some(quaternion(&base_from_camera.rotation)),
    })
}

/// The band's own colour, once learned.
pub(super) fn colour(marker: &Marker) -> Color {
    marker.colour(0).map_or(COLOUR_NOT_LEARNED, |model| {
        let [r, g, b] = [model.rgb.x, model.rgb.y, model.rgb.z].map(|v| (v / 255.0).clamp(0.0, 1.0));
        Color { r, g, b, a: 1.0 }
    })
}

fn pose(place: &Point3<f64>, rotation: &UnitQuaternion<f64>) -> Pose {
    Pose { position: Some(vector3(&place.coords)), orientation: Some(quaternion(rotation)) }
}

fn quaternion(rotation: &UnitQuaternion<f64>) -> Quaternion {
    Quaternion { x: rotation.i, y: rotation.j, z: rotation.k, w: rotation.w }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimate::Miss;
    use crate::testing::fixture;

    fn turn(q: &Quaternion) -> UnitQuaternion<f64> {
        UnitQuaternion::from_quaternion(nalgebra::Quaternion::new(q.w, q.x, q.y, q.z))
    }

    #[test]
    fn the_coil_lies_along_its_tangent_and_the_arrow_too() {
        let update = Scene::new(&fixture::rig()).update(&fixture::complete(12, 99));
        let entity = &update.entities[0];
        assert_eq!((entity.frame_id.as_str(), entity.id.as_str()), ("base", "catheter"));
        assert_eq!((entity.spheres.len(), entity.cylinders.len(), entity.lines[0].points.len()), (2, 1, 3));
        let direction =
            fixture::rig().base.unwrap().base_from_camera * fixture::complete(12, 99).tangent.unwrap().direction;
        let coil = entity.cylinders[0].pose.unwrap().orientation.unwrap();
        assert!((turn(&coil) * Vector3::z() - direction).norm() < 1e-12);
        let arrow = entity.arrows[0].pose.unwrap().orientation.unwrap();
        assert!((turn(&arrow) * Vector3::x() - direction).norm() < 1e-12);
        assert_eq!(entity.cylinders[0].size.unwrap().z, 0.012);
        // Marker base is at the origin of frame base, and yellow.
        assert!(vector_norm(entity.spheres[0].pose.unwrap().position.unwrap()) < 1e-12);
        assert_eq!(entity.spheres[0].color, Some(Color { r: 1.0, g: 0.8, b: 0.0, a: 1.0 }));
        assert_eq!(entity.cylinders[0].color, Some(COLOUR_NOT_LEARNED));
    }

    fn vector_norm(v: Size) -> f64 {
        v.x.hypot(v.y).hypot(v.z)
    }

    #[test]
    fn what_was_not_measured_is_not_drawn() {
        let mut estimate = fixture::complete(12, 99);
        estimate.markers[2].position = Err(Miss::NotSeen { view: 0 });
        estimate.tangent = Err(Miss::MarkerMissing);
        let update = Scene::new(&fixture::rig()).update(&estimate);
        let entity = &update.entities[0];
        assert_eq!((entity.spheres.len(), entity.cylinders.len(), entity.arrows.len()), (2, 0, 0));
        assert_eq!(entity.lines[0].points.len(), 2);
    }

    #[test]
    fn without_a_base_the_scene_is_the_camera_s() {
        let mut rig = fixture::rig();
        rig.base = None;
        let estimate = fixture::complete(0, 0);
        let entity = Scene::new(&rig).update(&estimate).entities.remove(0);
        assert_eq!(entity.frame_id, "camera");
        assert_eq!(entity.lines[0].points[0], point3(&estimate.markers[0].position.as_ref().unwrap().point));
        assert!(camera_in_base(&Names::new(&rig), 0).is_none());
    }

    #[test]
    fn an_arrow_against_x_still_has_a_direction() {
        let arrow = Scene::new(&fixture::rig()).arrow(&Point3::origin(), &-Vector3::x());
        assert!((turn(&arrow.pose.unwrap().orientation.unwrap()) * Vector3::x() + Vector3::x()).norm() < 1e-12);
    }
}
