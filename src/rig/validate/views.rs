//! The surfaces of a rig file, and the views that see by them.

use super::super::file::{SurfaceFile, SurfaceKind, ViewFile};
use super::super::numbers::millimetres as written_mm;
use super::super::walk::{central_pixel, walk};
use super::super::{Camera, RigError, View, polygon};
use super::{Check, FARTHEST_MM, unknown_name};
use crate::optics::{Mirror, OpticalPath, Plane, Surface, Wall};
use nalgebra::{Point2, Vector2};
use std::collections::BTreeMap;

/// Most corners of a region: more do not help and take long.
const MAX_CORNERS: usize = 256;

impl Check<'_> {
    pub(super) fn surface(&self, name: &str, raw: &SurfaceFile) -> Result<Surface, RigError> {
        self.name("surfaces", name)?;
        let key = |field: &str| format!("surfaces.{name}.{field}");
        let normal = self.unit(key("normal"), raw.normal)?;
        self.within(key("offset_mm"), &[raw.offset_mm], FARTHEST_MM)?;
        let plane = Plane::new(normal, raw.offset_mm / 1e3)
            .map_err(|e| self.value(key("normal"), format!("{:?}", raw.normal), e))?;
        let of_walls = [
            ("thickness_mm", raw.thickness_mm),
            ("index_outside", raw.index_outside),
            ("index_wall", raw.index_wall),
            ("index_inside", raw.index_inside),
        ];
        if raw.kind == SurfaceKind::Mirror {
            return match of_walls.iter().find(|(_, value)| value.is_some()) {
                Some((field, _)) => Err(self.key(key(field), "only a wall has this, and this is a mirror")),
                None => Ok(Surface::Mirror(Mirror { plane })),
            };
        }
        let needed =
            |(field, value): (&str, Option<f64>)| value.ok_or_else(|| self.key(key(field), "missing, a wall needs it"));
        let [thickness_mm, index_outside, index_wall, index_inside] = of_walls.map(needed);
        let wall = Wall {
            outer: plane,
            thickness_m: thickness_mm? / 1e3,
            index_outside: index_outside?,
            index_wall: index_wall?,
            index_inside: index_inside?,
        };
        self.positive(key("thickness_mm"), wall.thickness_m * 1e3)?;
        for (field, index) in [
            ("index_outside", wall.index_outside),
            ("index_wall", wall.index_wall),
            ("index_inside", wall.index_inside),
        ] {
            if !(1.0..=3.0).contains(&index) {
                return Err(self.value(key(field), index, "1 to 3 (air 1, water 1.333, glass 1.52, acrylic 1.49)"));
            }
        }
        Ok(Surface::Wall(wall))
    }

    pub(super) fn view(
        &self,
        raw: ViewFile,
        camera: &Camera,
        surfaces: &BTreeMap<String, Surface>,
    ) -> Result<View, RigError> {
        let name = raw.name;
        let key = |field: &str| format!("view.{name}.{field}");
        let mut optics = OpticalPath { lens: camera.lens, surfaces: Vec::with_capacity(raw.path.len()) };
        for surface in &raw.path {
            let found = surfaces.get(surface).ok_or_else(|| {
                let known = surfaces.keys().map(String::as_str);
                self.value(key("path"), format_args!("{surface:?}"), unknown_name("a surface", surface, known))
            })?;
            optics.surfaces.push(*found);
        }
        // Surfaces before the first mirror only bend the ray, so the camera must be on that mirror's reflecting side.
        let first_mirror = raw.path.iter().zip(&optics.surfaces).find(|(_, s)| matches!(s, Surface::Mirror(_)));
        if let Some((surface, mirror)) = first_mirror
            && mirror.plane().offset_m() >= 0.0
        {
            return Err(self.value(
                format_args!("surfaces.{surface}.offset_mm"),
                written_mm(mirror.plane().offset_m()),
                "a negative number: a mirror's normal points to the side it reflects on, where the camera is \
                 (change the signs of normal and offset_mm)",
            ));
        }
        let region_px = raw.region_px.map(|corners| self.region(key("region_px"), &corners, camera)).transpose()?;
        let blur_px = raw.blur_px.map(Vector2::from);
        blur_px.iter().flatten().try_for_each(|blur| self.positive(key("blur_px"), *blur))?;
        let region_px = region_px.unwrap_or_default();
        let view = View { path: raw.path, optics, region_px, blur_px, name: name.clone() };
        self.path_leads_somewhere(&view, camera)?;
        Ok(view)
    }

    fn region(&self, key: String, corners: &[[f64; 2]], camera: &Camera) -> Result<Vec<Point2<f64>>, RigError> {
        if corners.len() < 3 {
            return Err(self.value(key, format!("{corners:?}"), "at least 3 corners, or no such key"));
        }
        if corners.len() > MAX_CORNERS {
            return Err(self.value(
                key,
                format_args!("{} corners", corners.len()),
                format_args!("{MAX_CORNERS} at most"),
            ));
        }
        let [right, bottom] = camera.size_px.map(|size| f64::from(size) - 0.5);
        for corner in corners {
            self.finite(&key, corner)?;
            if !((-0.5..=right).contains(&corner[0]) && (-0.5..=bottom).contains(&corner[1])) {
                let expected = format!("corners inside the picture, x -0.5 to {right}, y -0.5 to {bottom}");
                return Err(self.value(key, format!("{corner:?}"), expected));
            }
        }
        let region: Vec<_> = corners.iter().map(|c| Point2::from(*c)).collect();
        if polygon::area_and_centre(&region).0 < 1.0 {
            return Err(self.value(key, format!("{corners:?}"), "corners in order around an area"));
        }
        Ok(region)
    }

    /// The view's central ray arrives, and leaves every surface into the medium in which the next one begins.
    fn path_leads_somewhere(&self, view: &View, camera: &Camera) -> Result<(), RigError> {
        let key = format!("view.{}.path", view.name);
        let path = format!("{:?}", view.path);
        let (crossings, _) =
            central_pixel(camera, view).and_then(|pixel| walk(&view.optics, &pixel)).map_err(|no_ray| {
                let whose = if view.region_px.is_empty() {
                    "some ray of the picture"
                } else {
                    "the ray of the region's centre"
                };
                self.value(&key, &path, format_args!("{whose} to pass these surfaces in this order, but: {no_ray}"))
            })?;
        let mut medium: Option<f64> = None;
        for (surface, crossing) in view.path.iter().zip(&crossings) {
            let Some((before, after)) = crossing.media else { continue };
            if let Some(medium) = medium.filter(|medium| (medium - before).abs() > 1e-9) {
                let expected = format!(
                    "one medium between surfaces, but `{surface}` is met from index {before} while the ray is in \
                     {medium}"
                );
                return Err(self.value(&key, &path, expected));
            }
            medium = Some(after);
        }
        Ok(())
    }
}
