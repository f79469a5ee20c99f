//! From the file's numbers to a [`Draft`]: every value is checked here, with its key, and converted to metres. What a
//! draft must have to be a [`Rig`] is checked here too.

use super::error::nearest;
use super::file::{
    BaseFile, CameraFile, CatheterFile, MarkerFile, RigFile, SurfaceFile, SurfaceKind, ViewColourFile, ViewFile,
};
use super::numbers::{millimetres as written_mm, rotation_of};
use super::walk::{central_pixel, walk};
use super::{
    Base, Camera, Catheter, ColourModel, ColourPlane, Draft, Marker, Rig, RigError, View, covariance, polygon,
};
use crate::optics::{Lens, Mirror, OpticalPath, Plane, Surface, UNIT_TOLERANCE, Wall};
use nalgebra::{Isometry3, Matrix3, Point2, Translation3, Vector2, Vector3};
use std::collections::BTreeMap;
use std::fmt::Display;
use std::path::Path;

/// Checks and converts a whole file; `file` is named in the messages.
pub(super) fn validate(raw: RigFile, file: &Path) -> Result<Draft, RigError> {
    let check = Check { file };
    let camera = check.camera(&raw.camera)?;
    let mut surfaces = BTreeMap::new();
    for (name, surface) in &raw.surfaces {
        surfaces.insert(name.clone(), check.surface(name, surface)?);
    }
    check.count("view", raw.views.len(), MAX_VIEWS)?;
    check.count("marker", raw.markers.len(), MAX_MARKERS)?;
    check.names("view", raw.views.iter().map(|v| v.name.as_str()))?;
    check.names("marker", raw.markers.iter().map(|m| m.name.as_str()))?;
    let views = raw.views.into_iter().map(|v| check.view(v, &camera, &surfaces)).collect::<Result<Vec<_>, _>>()?;
    let markers = raw.markers.into_iter().map(|m| check.marker(m, &views)).collect::<Result<Vec<_>, _>>()?;
    check.bands_apart(&markers)?;
    let catheter = raw.catheter.map(|catheter| check.catheter(&catheter, &markers)).transpose()?;
    let base = raw.base.map(|base| check.base(&base)).transpose()?;
    if let Some(covariance::Wrong { key, value, expected }) = covariance::wrong(&raw.provenance, &camera.lens) {
        return Err(check.value(key, value, expected));
    }
    Ok(Draft { camera, surfaces, views, markers, catheter, base, provenance: raw.provenance })
}

/// A draft that has all parts is a rig; `file` is named in the message about a missing one.
pub(super) fn complete(draft: Draft, file: &Path) -> Result<Rig, RigError> {
    let Draft { camera, surfaces, views, markers, catheter, base, provenance } = draft;
    let check = Check { file };
    if views.is_empty() {
        return Err(check.key("view", "expected at least one [[view]]: `catoptra calibrate rig` adds them"));
    }
    if markers.is_empty() {
        return Err(check.no_marker());
    }
    let Some(catheter) = catheter else {
        return Err(check.key("catheter", "missing: `catoptra calibrate markers` adds it"));
    };
    Ok(Rig { camera, surfaces, views, markers, catheter, base, provenance })
}

/// Checks the values of one file.
struct Check<'a> {
    file: &'a Path,
}

/// A chroma sample displaced by more than this belongs to another luma sample.
const LARGEST_CHROMA_OFFSET_PX: f64 = 2.0;
/// Longer than any video camera exposes a picture.
const LONGEST_EXPOSURE_MS: f64 = 1000.0;
/// Longer than any rolling shutter needs.
const LONGEST_READOUT_MS: f64 = 200.0;
/// Powers of light that cameras store.
const GAMMAS: std::ops::RangeInclusive<f64> = 0.2..=1.5;
/// What its chroma samples can reach: no less than the nearest pixels.
const CHROMA_REACHES: std::ops::RangeInclusive<f64> = 0.5..=2.0;
/// Nothing is further away: 100 m.
const FARTHEST_MM: f64 = 1e5;
/// A wider tube is a slip of the units; pictures of bands of any width cannot be made.
const WIDEST_TUBE_MM: f64 = 1e3;
/// Longer than the stiff part of any catheter that is steered by a coil on it, metres.
const LONGEST_STIFF_M: f64 = 0.1;
/// Largest weight of 8-bit samples that can be computed with; learned ones are below 1.
const LARGEST_WEIGHT: f64 = 1e3;
/// Most corners of a region: more do not help and take long.
const MAX_CORNERS: usize = 256;
/// Most views and markers: the assignment tries every pair of a marker's places in two views.
const MAX_VIEWS: usize = 8;
const MAX_MARKERS: usize = 16;

impl Check<'_> {
    fn value(&self, key: impl Display, value: impl Display, expected: impl Display) -> RigError {
        RigError::Value {
            file: self.file.to_path_buf(),
            key: key.to_string(),
            value: value.to_string(),
            expected: expected.to_string(),
        }
    }

    fn key(&self, key: impl Display, problem: impl Display) -> RigError {
        RigError::Key { file: self.file.to_path_buf(), key: key.to_string(), problem: problem.to_string() }
    }

    fn no_marker(&self) -> RigError {
        self.key("marker", "expected at least one [[marker]]: `catoptra calibrate markers` adds them")
    }

    fn finite(&self, key: impl Display, values: &[f64]) -> Result<(), RigError> {
        match values {
            _ if values.iter().all(|v| v.is_finite()) => Ok(()),
            [value] => Err(self.value(key, value, "a finite number")),
            _ => Err(self.value(key, format!("{values:?}"), "finite numbers")),
        }
    }

    /// Finite numbers from −`most` to `most`.
    fn within(&self, key: impl Display, values: &[f64], most: f64) -> Result<(), RigError> {
        self.finite(&key, values)?;
        match values.iter().find(|v| v.abs() > most) {
            Some(value) => Err(self.value(key, value, format_args!("{most} or less either way"))),
            None => Ok(()),
        }
    }

    fn positive(&self, key: impl Display, value: f64) -> Result<(), RigError> {
        if value.is_finite() && value > 0.0 { Ok(()) } else { Err(self.value(key, value, "a positive number")) }
    }

    /// A unit vector; the rounding of the file is corrected.
    fn unit(&self, key: impl Display, v: [f64; 3]) -> Result<Vector3<f64>, RigError> {
        self.finite(&key, &v)?;
        let length = Vector3::from(v).norm();
        if (length - 1.0).abs() > UNIT_TOLERANCE {
            let unit = v.map(|x| (x / length * 1e6).round() / 1e6);
            let hint = if length > 0.0 { format!(", for this direction {unit:?}") } else { String::new() };
            return Err(self.value(key, format!("{v:?}"), format!("length 1, it is {length:.6}{hint}")));
        }
        Ok(Vector3::from(v) / length)
    }

    fn count(&self, section: &str, found: usize, most: usize) -> Result<(), RigError> {
        if found <= most {
            return Ok(());
        }
        Err(self.value(section, format_args!("{found} of them"), format_args!("{most} at most")))
    }

    /// Names that fit into tables and messages; each used once.
    fn names<'n>(&self, section: &str, names: impl Iterator<Item = &'n str>) -> Result<(), RigError> {
        let mut seen: Vec<&str> = Vec::new();
        for name in names {
            self.name(format_args!("{section}.name"), name)?;
            if seen.contains(&name) {
                return Err(self.value(
                    format_args!("{section}.name"),
                    format_args!("{name:?}"),
                    "a different name for each",
                ));
            }
            seen.push(name);
        }
        Ok(())
    }

    fn name(&self, key: impl Display, name: &str) -> Result<(), RigError> {
        let plain = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '-';
        if !name.is_empty() && name.chars().all(plain) {
            return Ok(());
        }
        Err(self.value(key, format_args!("{name:?}"), "letters, digits, `_` and `-` (it names columns and topics)"))
    }

    fn camera(&self, raw: &CameraFile) -> Result<Camera, RigError> {
        for (key, size) in [("camera.width_px", raw.width_px), ("camera.height_px", raw.height_px)] {
            if !(1..=65_535).contains(&size) {
                return Err(self.value(key, size, "1 to 65535"));
            }
        }
        for f in raw.focal_px {
            self.positive("camera.focal_px", f)?;
        }
        self.finite("camera.principal_point_px", &raw.principal_point_px)?;
        self.finite("camera.distortion", &raw.distortion)?;
        let denominator = raw.denominator.unwrap_or_default();
        self.finite("camera.denominator", &denominator)?;
        if let Some(blur) = raw.blur_px {
            self.positive("camera.blur_px", blur)?;
        }
        let offset_px = |key: &str, offset_px: Option<[f64; 2]>| {
            let offset_px = offset_px.unwrap_or_default();
            self.finite(key, &offset_px)?;
            if let Some(offset) = offset_px.iter().find(|v| v.abs() > LARGEST_CHROMA_OFFSET_PX) {
                let expected = format!("{LARGEST_CHROMA_OFFSET_PX} px or less either way");
                return Err(self.value(key, offset, expected));
            }
            Ok(offset_px)
        };
        let chroma_offset_px = offset_px("camera.chroma_offset_px", raw.chroma_offset_px)?;
        let chroma_reach = raw.chroma_reach.unwrap_or([1.0; 2]);
        if let Some(reach) = chroma_reach.iter().find(|reach| !CHROMA_REACHES.contains(*reach)) {
            let expected = format!("numbers from {} to {}", CHROMA_REACHES.start(), CHROMA_REACHES.end());
            return Err(self.value("camera.chroma_reach", reach, expected));
        }
        let colour_offset_px = offset_px("camera.colour_offset_px", raw.colour_offset_px)?;
        if let Some(exposure) = raw.exposure_ms {
            self.positive("camera.exposure_ms", exposure)?;
            self.within("camera.exposure_ms", &[exposure], LONGEST_EXPOSURE_MS)?;
        }
        let exposure_s = raw.exposure_ms.map(|ms| ms / 1e3);
        if let Some(readout) = raw.readout_ms {
            self.within("camera.readout_ms", &[readout], LONGEST_READOUT_MS)?;
        }
        let readout_s = raw.readout_ms.filter(|ms| *ms != 0.0).map(|ms| ms / 1e3);
        let lens = Lens {
            focal_px: Vector2::from(raw.focal_px),
            principal_point_px: Point2::from(raw.principal_point_px),
            distortion: raw.distortion,
            denominator,
        };
        if let Some(gamma) = raw.gamma.filter(|gamma| !GAMMAS.contains(gamma)) {
            let expected = format!("a number from {} to {}", GAMMAS.start(), GAMMAS.end());
            return Err(self.value("camera.gamma", gamma, expected));
        }
        let size_px = [raw.width_px, raw.height_px];
        Ok(Camera {
            size_px,
            lens,
            blur_px: raw.blur_px,
            chroma_offset_px,
            chroma_reach,
            colour_offset_px,
            exposure_s,
            readout_s,
            gamma: raw.gamma,
        })
    }

    fn surface(&self, name: &str, raw: &SurfaceFile) -> Result<Surface, RigError> {
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

    fn view(&self, raw: ViewFile, camera: &Camera, surfaces: &BTreeMap<String, Surface>) -> Result<View, RigError> {
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
        if let Some(blur) = raw.blur_px {
            self.positive(key("blur_px"), blur)?;
        }
        let region_px = region_px.unwrap_or_default();
        let view = View { path: raw.path, optics, region_px, blur_px: raw.blur_px, name: name.clone() };
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

    fn marker(&self, raw: MarkerFile, views: &[View]) -> Result<Marker, RigError> {
        let key = |field: &str| format!("marker.{}.{field}", raw.name);
        self.positive(key("length_mm"), raw.length_mm)?;
        if let Some(centre) = raw.centre_mm {
            self.within(key("centre_mm"), &[centre], FARTHEST_MM)?;
            if centre < raw.length_mm / 2.0 {
                let expected = format!("at least {}, half the band's length from the clamp", raw.length_mm / 2.0);
                return Err(self.value(key("centre_mm"), centre, expected));
            }
        }
        for residual in &raw.usual_residuals {
            self.positive(key("usual_residuals"), *residual)?;
        }
        // A file whose views were left out, because the lens changed, keeps what its bands had in them.
        if !raw.usual_residuals.is_empty() && !views.is_empty() && raw.usual_residuals.len() != views.len() {
            let expected = format!("{} numbers, one for each view", views.len());
            return Err(self.value(key("usual_residuals"), format_args!("{:?}", raw.usual_residuals), expected));
        }
        if let Some(colour) = &raw.colour {
            self.within(key("colour.discriminant_rgb"), &colour.discriminant_rgb, LARGEST_WEIGHT)?;
            self.within(key("colour.bias"), &[colour.bias], 1e3 * LARGEST_WEIGHT)?;
            self.finite(key("colour.rgb"), &colour.rgb)?;
            if colour.discriminant_rgb == [0.0; 3] {
                return Err(self.value(key("colour.discriminant_rgb"), "[0, 0, 0]", "weights that are not all zero"));
            }
            self.colour_range(key("colour.rgb"), &colour.rgb)?;
        }
        let everywhere =
            raw.colour.map(|c| ColourModel::linear(Vector3::from(c.discriminant_rgb), c.bias, Vector3::from(c.rgb)));
        let colours = match everywhere {
            Some(_) if !raw.colours.is_empty() => {
                return Err(self.key(key("colour"), "here beside `colours`, which says the same: keep one of them"));
            }
            Some(colour) => vec![colour],
            None => self.colours(&key("colours"), &raw.colours, views)?,
        };
        Ok(Marker {
            length_m: raw.length_mm / 1e3,
            centre_m: raw.centre_mm.map(|centre| centre / 1e3),
            colours,
            usual_residuals: raw.usual_residuals,
            name: raw.name,
        })
    }

    /// One colour model for all views, or one for each of them, in their order.
    fn colours(&self, key: &str, raw: &[ViewColourFile], views: &[View]) -> Result<Vec<ColourModel>, RigError> {
        let mut colours = Vec::with_capacity(raw.len());
        for (i, colour) in raw.iter().enumerate() {
            let key = |field: &str| format!("{key}.{i}.{field}");
            if colour.planes.is_empty() {
                return Err(self.value(key("planes"), "[]", "one plane or more"));
            }
            for plane in &colour.planes {
                self.finite(key("planes"), plane)?;
                let &[r, g, b, bias] = plane;
                self.within(key("planes"), &[r, g, b], LARGEST_WEIGHT)?;
                self.within(key("planes"), &[bias], 1e3 * LARGEST_WEIGHT)?;
                if plane[..3] == [0.0; 3] {
                    return Err(self.value(key("planes"), format!("{plane:?}"), "weights that are not all zero"));
                }
            }
            self.finite(key("rgb"), &colour.rgb)?;
            self.colour_range(key("rgb"), &colour.rgb)?;
            let plane = |&[r, g, b, bias]: &[f64; 4]| ColourPlane { weights: Vector3::new(r, g, b), bias };
            colours.push(ColourModel {
                planes: colour.planes.iter().map(plane).collect(),
                rgb: Vector3::from(colour.rgb),
            });
        }
        let named: Vec<&str> = raw.iter().filter_map(|colour| colour.view.as_deref()).collect();
        let all: Vec<&str> = views.iter().map(|view| view.name.as_str()).collect();
        if raw.is_empty() || named == all || (raw.len() == 1 && named.is_empty()) {
            return Ok(colours);
        }
        let expected =
            format!("one entry for each view, in their order ({}), or a single one without `view`", all.join(", "));
        Err(self.value(key, format!("[{}]", named.join(", ")), expected))
    }

    fn colour_range(&self, key: String, rgb: &[f64; 3]) -> Result<(), RigError> {
        match rgb.iter().all(|c| (0.0..=255.0).contains(c)) {
            true => Ok(()),
            false => Err(self.value(key, format!("{rgb:?}"), "0 to 255 each")),
        }
    }

    /// Bands whose place is known are in the file's order along the tube, and do not overlap.
    fn bands_apart(&self, markers: &[Marker]) -> Result<(), RigError> {
        let mut before: Option<(&str, f64)> = None;
        for marker in markers {
            let Some(centre_m) = marker.centre_m else { continue };
            if let Some((other, end_m)) = before
                && centre_m - marker.length_m / 2.0 < end_m - 1e-9
            {
                return Err(self.value(
                    format_args!("marker.{}.centre_mm", marker.name),
                    written_mm(centre_m),
                    format_args!(
                        "bands in their order along the tube: `{other}` reaches to {} mm, so a band of {} mm has its \
                         middle at {} or more",
                        written_mm(end_m),
                        written_mm(marker.length_m),
                        written_mm(end_m + marker.length_m / 2.0)
                    ),
                ));
            }
            before = Some((&marker.name, centre_m + marker.length_m / 2.0));
        }
        Ok(())
    }

    fn catheter(&self, raw: &CatheterFile, markers: &[Marker]) -> Result<Catheter, RigError> {
        if markers.is_empty() {
            return Err(self.no_marker());
        }
        self.positive("catheter.diameter_mm", raw.diameter_mm)?;
        if raw.diameter_mm > WIDEST_TUBE_MM {
            let expected = format!("at most {WIDEST_TUBE_MM}");
            return Err(self.value("catheter.diameter_mm", raw.diameter_mm, expected));
        }
        let index = |key: &str, name: &str| {
            markers.iter().position(|m| m.name == name).ok_or_else(|| {
                let known = markers.iter().map(|m| m.name.as_str());
                self.value(key, format_args!("{name:?}"), unknown_name("a marker", name, known))
            })
        };
        let coil = index("catheter.coil", &raw.coil)?;
        let end = raw.end.as_deref().map(|name| index("catheter.end", name)).transpose()?;
        if let Some(end) = end
            && let Some(last) = markers.last()
            && end + 1 != markers.len()
        {
            let expected = format!("the last marker along the tube, {:?}", last.name);
            return Err(self.value("catheter.end", format_args!("{:?}", raw.end.as_deref().unwrap_or("")), expected));
        }
        if let Some(rigid) = raw.rigid_mm {
            self.positive("catheter.rigid_mm", rigid)?;
            let most_mm = longest_stiff_m(markers, coil) * 1e3;
            if rigid > most_mm {
                let expected = format!("at most {most_mm:.0}: the stiff part around the middle of the coil");
                return Err(self.value("catheter.rigid_mm", rigid, expected));
            }
        }
        Ok(Catheter { diameter_m: raw.diameter_mm / 1e3, coil, end, rigid_m: raw.rigid_mm.map(|v| v / 1e3) })
    }

    fn base(&self, raw: &BaseFile) -> Result<Base, RigError> {
        let key = "base.base_from_camera.rotation";
        let rows = raw.base_from_camera.rotation;
        self.finite(key, rows.as_flattened())?;
        let matrix = Matrix3::from_row_slice(rows.as_flattened());
        let off = (matrix * matrix.transpose() - Matrix3::identity()).amax();
        if off > 2.0 * UNIT_TOLERANCE {
            let expected = format!("a rotation: unit rows at right angles, they are off by {off:.2e}");
            return Err(self.value(key, format!("{rows:?}"), expected));
        }
        if matrix.determinant() < 0.0 {
            return Err(self.value(key, format!("{rows:?}"), "a right-handed rotation, its determinant is -1"));
        }
        self.within("base.base_from_camera.translation_mm", &raw.base_from_camera.translation_mm, FARTHEST_MM)?;
        let rotation = rotation_of(&matrix);
        let translation = Translation3::from(Vector3::from(raw.base_from_camera.translation_mm.map(|x| x / 1e3)));
        Ok(Base {
            base_from_camera: Isometry3::from_parts(translation, rotation),
            b0: self.unit("base.b0", raw.b0)?,
            gravity: raw.gravity.map(|g| self.unit("base.gravity", g)).transpose()?,
        })
    }
}

/// The longest stiff part around the middle of the coil that a tube can have, metres: it does not reach the first band,
/// where the tube is held.
pub(crate) fn longest_stiff_m(markers: &[Marker], coil: usize) -> f64 {
    let centre_m = |marker: usize| markers.get(marker)?.centre_m;
    let held = (coil > 0).then(|| centre_m(0).zip(centre_m(coil))).flatten();
    held.map_or(LONGEST_STIFF_M, |(held_m, coil_m)| LONGEST_STIFF_M.min(2.0 * (coil_m - held_m).abs()))
}

/// "a surface of this file, did you mean ...?"
pub(super) fn unknown_name<'n>(what: &str, name: &str, known: impl Iterator<Item = &'n str> + Clone) -> String {
    match nearest(name, known.clone()) {
        Some(near) => format!("the name of {what}, did you mean {near:?}?"),
        None => format!("the name of {what}: {}", known.collect::<Vec<_>>().join(", ")),
    }
}
