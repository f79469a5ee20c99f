//! The 3D view for RViz: `visualization_msgs/MarkerArray`, one per frame. What was not measured is removed.

use super::geometry::{quaternion, turn_to};
use crate::log::ros2::messages::{ColorRGBA, CompressedImage, Header, Marker, MarkerArray, MeshFile, Pose, Time, Xyz};
use crate::log::schema::messages::Estimate;
use crate::rig::{self, Rig};
use nalgebra::{UnitQuaternion, Vector3};

const ARROW: i32 = 0;
const SPHERE: i32 = 2;
const CYLINDER: i32 = 3;
const LINE_STRIP: i32 = 4;
const ADD: i32 = 0;
const DELETE: i32 = 2;

/// Bands are drawn this much thicker than the tube, to be visible on it.
const BAND_OVER_TUBE: f64 = 1.3;
/// Length of the arrow along the coil's direction, metres.
const ARROW_M: f64 = 0.015;
const TUBE: ColorRGBA = ColorRGBA { r: 0.92, g: 0.92, b: 0.92, a: 1.0 };
const DIRECTION: ColorRGBA = ColorRGBA { r: 0.95, g: 0.35, b: 0.1, a: 1.0 };
const NOT_LEARNED: ColorRGBA = ColorRGBA { r: 0.5, g: 0.5, b: 0.5, a: 1.0 };

/// What drawing an estimate needs from the rig.
#[derive(Debug)]
pub(super) struct Scene {
    /// Names of the markers, as in the rig.
    pub(super) names: Vec<String>,
    diameter_m: f64,
    coil: usize,
    bands: Vec<(ColorRGBA, f64)>,
}

impl Scene {
    pub(super) fn new(rig: &Rig) -> Self {
        Self {
            names: rig.markers.iter().map(|marker| marker.name.clone()).collect(),
            diameter_m: rig.catheter.diameter_m,
            coil: rig.catheter.coil,
            bands: rig.markers.iter().map(|marker| (colour(marker), marker.length_m)).collect(),
        }
    }

    /// Tube, bands and direction of the coil, in the base frame if `based`. The tube is number 0, the bands come next
    /// in the rig's order, the arrow is last.
    pub(super) fn markers(&self, estimate: &Estimate, header: &Header, based: bool) -> MarkerArray {
        let place = |position: &crate::log::schema::messages::Position| match (based, &position.in_base_m) {
            (true, Some(p)) => Some(Xyz { x: p.x, y: p.y, z: p.z }),
            (true, None) => None,
            (false, _) => Some(position.in_camera_m).map(|p| Xyz { x: p.x, y: p.y, z: p.z }),
        };
        let places: Vec<Option<Xyz>> =
            estimate.markers.iter().map(|marker| marker.position.as_ref().and_then(place)).collect();
        let direction = estimate.tangent.as_ref().and_then(|t| if based { t.in_base } else { Some(t.in_camera) });
        let direction = direction.map(|t| Vector3::new(t.x, t.y, t.z));
        let cube = |side: f64, length: f64| Xyz { x: side, y: side, z: length };
        let empty = |id: usize| empty(header, i32::try_from(id).unwrap_or(i32::MAX));

        let tube: Vec<Xyz> = places.iter().flatten().copied().collect();
        let mut markers = vec![match tube.len() {
            0 | 1 => empty(0),
            _ => Marker {
                r#type: LINE_STRIP,
                action: ADD,
                scale: Xyz { x: self.diameter_m, ..Xyz::default() },
                color: TUBE,
                points: tube,
                ..empty(0)
            },
        }];
        let width = self.diameter_m * BAND_OVER_TUBE;
        for (index, (place, &(color, length_m))) in places.iter().zip(&self.bands).enumerate() {
            let gone = empty(index + 1);
            let turn = direction.filter(|_| index == self.coil).map(|t| turn_to(&t));
            markers.push(match (place, turn) {
                (None, _) => gone,
                (Some(place), Some(turn)) => Marker {
                    r#type: CYLINDER,
                    action: ADD,
                    pose: Pose { position: *place, orientation: quaternion(&turn) },
                    scale: cube(width, length_m),
                    color,
                    ..gone
                },
                // The direction of the other bands is not measured: no cylinder, which would claim one.
                (Some(place), None) => Marker {
                    r#type: SPHERE,
                    action: ADD,
                    pose: Pose { position: *place, ..gone.pose },
                    scale: cube(width, width),
                    color,
                    ..gone
                },
            });
        }
        let gone = empty(self.bands.len() + 1);
        markers.push(match (places.get(self.coil).copied().flatten(), direction) {
            (Some(from), Some(t)) => Marker {
                r#type: ARROW,
                action: ADD,
                scale: Xyz { x: self.diameter_m * 0.4, y: self.diameter_m, z: ARROW_M * 0.25 },
                color: DIRECTION,
                points: vec![
                    from,
                    Xyz { x: from.x + ARROW_M * t.x, y: from.y + ARROW_M * t.y, z: from.z + ARROW_M * t.z },
                ],
                ..gone
            },
            _ => gone,
        });
        MarkerArray { markers }
    }
}

/// A message that removes a marker.
fn empty(header: &Header, id: i32) -> Marker {
    Marker {
        header: header.clone(),
        ns: "catheter".to_owned(),
        id,
        r#type: SPHERE,
        action: DELETE,
        pose: Pose { position: Xyz::default(), orientation: quaternion(&UnitQuaternion::identity()) },
        scale: Xyz::default(),
        color: ColorRGBA::default(),
        lifetime: Time::default(),
        frame_locked: false,
        points: Vec::new(),
        colors: Vec::new(),
        texture_resource: String::new(),
        texture: CompressedImage::default(),
        uv_coordinates: Vec::new(),
        text: String::new(),
        mesh_resource: String::new(),
        mesh_file: MeshFile::default(),
        mesh_use_embedded_materials: false,
    }
}

/// The band's own colour, once learned.
fn colour(marker: &rig::Marker) -> ColorRGBA {
    marker.colour(0).map_or(NOT_LEARNED, |model| {
        let [r, g, b] = [model.rgb.x, model.rgb.y, model.rgb.z].map(|v| (v / 255.0).clamp(0.0, 1.0) as f32);
        ColorRGBA { r, g, b, a: 1.0 }
    })
}
