//! Writes a [`Draft`] as the text of `rig.toml`, and that text to the disk in one step.

use super::numbers::{decimal, millimetres, rotation_of, round_stably};
use super::{Base, Camera, Catheter, ColourPlane, Draft, Marker, RigError, View};
use crate::atomic_file::{NewFile, backup_names};
use crate::optics::Surface;
use nalgebra::{Matrix3, UnitQuaternion, Vector3};
use std::fmt::Write as _;
use std::fs::File;
use std::io::{ErrorKind, Write as _};
use std::path::{Path, PathBuf};

/// Decimals of a direction: 1e-12 turns a point at 2 m by 2e-12 m.
pub(super) const DIRECTION_DECIMALS: usize = 12;
/// Decimals of pixels.
pub(super) const PIXEL_DECIMALS: usize = 9;

/// The whole file.
pub(super) fn to_text(rig: &Draft) -> String {
    let mut sections = vec![
        "# A Catoptra rig. Lengths are mm, pixels count from the centre of the top-left one, directions are unit\n\
         # vectors in the camera frame (x right, y down, z forward). Every key: calibration/README.md.\n"
            .to_owned(),
        camera(&rig.camera),
    ];
    sections.extend(rig.surfaces.iter().enumerate().map(|(i, (name, s))| surface(i == 0, name, s)));
    sections.extend(rig.views.iter().enumerate().map(|(i, v)| view(i == 0, v)));
    sections.extend(rig.markers.iter().enumerate().map(|(i, m)| marker(i == 0, m, &rig.views)));
    sections.extend(rig.catheter.iter().map(|c| catheter(c, &rig.markers)));
    sections.extend(rig.base.iter().map(base));
    if !rig.provenance.is_empty() {
        let wrapped = toml::Table::from_iter([("provenance".to_owned(), rig.provenance.clone().into())]);
        sections.push(format!("# Where the numbers come from.\n{wrapped}"));
    }
    sections.join("\n")
}

/// See [`Draft::save`] and [`Draft::save_with_backup`].
pub(super) fn save(rig: &Draft, path: &Path, keep: bool) -> Result<Option<PathBuf>, RigError> {
    let text = rig.to_toml_string();
    Draft::from_toml_str(&text, path)?; // never replace a good file with one that cannot be read
    let fail = |file: &Path| {
        let file = file.to_path_buf();
        move |source| RigError::Write { file, source }
    };
    // Everything that can fill the disk is written before anything is replaced.
    let new = NewFile::write(path, text.as_bytes()).map_err(fail(path))?;
    let mut kept_as = None;
    if keep && path.exists() {
        let old = std::fs::read(path).map_err(|source| RigError::Read { file: path.to_path_buf(), source })?;
        if old != text.as_bytes() {
            kept_as = Some(keep_beside(path, &old)?);
        }
    }
    new.put_in_place().map_err(fail(path))?;
    Ok(kept_as)
}

/// Writes `old` beside `path`, under the first free backup name.
fn keep_beside(path: &Path, old: &[u8]) -> Result<PathBuf, RigError> {
    for backup in backup_names(path) {
        let written = File::create_new(&backup).and_then(|mut file| {
            let written = file.write_all(old).and_then(|()| file.sync_all());
            // Half a backup could be mistaken for a whole one; this file is new and ours to remove.
            written.inspect_err(|_| drop(std::fs::remove_file(&backup)))
        });
        match written {
            Ok(()) => return Ok(backup),
            Err(e) if e.kind() == ErrorKind::AlreadyExists => {}
            Err(source) => return Err(RigError::Write { file: backup, source }),
        }
    }
    Err(RigError::Write { file: path.to_path_buf(), source: ErrorKind::AlreadyExists.into() })
}

fn camera(camera: &Camera) -> String {
    let lens = &camera.lens;
    let mut text = format!(
        "# The camera and its lens: one for all views. distortion = k1, k2, p1, p2, k3 as OpenCV orders them.\n\
         [camera]\nwidth_px = {}\nheight_px = {}\nfocal_px = {}\nprincipal_point_px = {}\ndistortion = {}\n",
        camera.size_px[0],
        camera.size_px[1],
        list(lens.focal_px.iter().map(|v| decimal(*v, PIXEL_DECIMALS))),
        list(lens.principal_point_px.iter().map(|v| decimal(*v, PIXEL_DECIMALS))),
        list(lens.distortion.iter().map(|v| decimal(*v, DIRECTION_DECIMALS))),
    );
    if lens.is_rational() {
        let denominator = list(lens.denominator.iter().map(|v| decimal(*v, DIRECTION_DECIMALS)));
        let _ = writeln!(text, "denominator = {denominator} # k4, k5, k6 of the rational model");
    }
    if let Some(blur) = camera.blur_px {
        let _ = writeln!(text, "blur_px = {}", decimal(blur, 9));
    }
    let unless_usual = [
        ("chroma_offset_px", camera.chroma_offset_px, 0.0),
        ("colour_offset_px", camera.colour_offset_px, 0.0),
        ("chroma_reach", camera.chroma_reach, 1.0),
    ];
    for (key, values, _) in unless_usual.into_iter().filter(|(_, values, usual)| *values != [*usual; 2]) {
        let _ = writeln!(text, "{key} = {}", list(values.iter().map(|v| decimal(*v, 9))));
    }
    if let Some(exposure_s) = camera.exposure_s {
        let _ = writeln!(text, "exposure_ms = {}", decimal(exposure_s * 1e3, 6));
    }
    if let Some(readout_s) = camera.readout_s {
        let _ = writeln!(text, "readout_ms = {}", decimal(readout_s * 1e3, 6));
    }
    if let Some(gamma) = camera.gamma {
        let _ = writeln!(text, "gamma = {}", decimal(gamma, 6));
    }
    text
}

fn surface(first: bool, name: &str, surface: &Surface) -> String {
    let head = "# Planes normal·X = offset_mm. A mirror's normal points to the side it reflects on, a wall's \
                outwards;\n# a wall's plane is its outer face.\n";
    let plane = surface.plane();
    let (kind, wall) = match surface {
        Surface::Mirror(_) => ("mirror", None),
        Surface::Wall(wall) => ("wall", Some(wall)),
    };
    let mut text = format!(
        "{}[surfaces.{name}]\nkind = \"{kind}\"\nnormal = {}\noffset_mm = {}\n",
        if first { head } else { "" },
        direction(&plane.normal()),
        millimetres(plane.offset_m()),
    );
    if let Some(wall) = wall {
        let _ = write!(
            text,
            "thickness_mm = {}\nindex_outside = {}\nindex_wall = {}\nindex_inside = {}\n",
            millimetres(wall.thickness_m),
            decimal(wall.index_outside, 9),
            decimal(wall.index_wall, 9),
            decimal(wall.index_inside, 9),
        );
    }
    text
}

fn view(first: bool, view: &View) -> String {
    let head = "# Views: the surfaces a camera ray meets, in order, and where in the picture.\n";
    let path = list(view.path.iter().map(|name| format!("\"{name}\"")));
    let mut text = format!("{}[[view]]\nname = \"{}\"\npath = {path}\n", if first { head } else { "" }, view.name);
    if !view.region_px.is_empty() {
        let corners = view.region_px.iter().map(|c| list(c.iter().map(|v| decimal(*v, 9))));
        let _ = writeln!(text, "region_px = {}", list(corners));
    }
    if let Some(blur) = view.blur_px {
        let [x, y] = [blur.x, blur.y].map(|px| decimal(px, 9));
        let value = if x == y { x } else { format!("{} # along x and y", list([x, y].into_iter())) };
        let _ = writeln!(text, "blur_px = {value}");
    }
    text
}

fn marker(first: bool, marker: &Marker, views: &[View]) -> String {
    let head = "# Bands, from the clamp to the tip; centre_mm is the middle of the band along the tube, as learned \
                from the edge of\n# the first band that is nearer to the clamp.\n";
    let mut text = format!(
        "{}[[marker]]\nname = \"{}\"\nlength_mm = {}\n",
        if first { head } else { "" },
        marker.name,
        millimetres(marker.length_m)
    );
    if let Some(centre_m) = marker.centre_m {
        let _ = writeln!(text, "centre_mm = {}", millimetres(centre_m));
    }
    let residuals = &marker.usual_residuals;
    if !residuals.is_empty() && (views.is_empty() || views.len() == residuals.len()) {
        let _ = writeln!(text, "usual_residuals = {}", list(residuals.iter().map(|v| decimal(*v, 3))));
    }
    let models = &marker.colours;
    for (i, colour) in models.iter().enumerate() {
        let head = "\n# score = the least of r·R + g·G + b·B + bias over the planes [r, g, b, bias]: about 1 on the \
                    band, below 0.5\n# elsewhere; rgb is its mean colour, 0 to 255.\n";
        let _ = writeln!(text, "{}[[marker.colours]]", if i == 0 { head } else { "\n" });
        if let Some(view) = views.get(i).filter(|_| models.len() > 1) {
            let _ = writeln!(text, "view = \"{}\"", view.name);
        }
        let plane = |plane: &ColourPlane| {
            list(plane.weights.iter().chain([&plane.bias]).map(|v| decimal(*v, DIRECTION_DECIMALS)))
        };
        let _ = write!(
            text,
            "planes = {}\nrgb = {}\n",
            list(colour.planes.iter().map(plane)),
            list(colour.rgb.iter().map(|v| decimal(*v, 9))),
        );
    }
    text
}

fn catheter(catheter: &Catheter, markers: &[Marker]) -> String {
    let name = |index: usize| markers.get(index).map_or("", |m| m.name.as_str());
    let mut text = format!(
        "# The tube: which band is the coil, and which one ends the tube.\n\
         [catheter]\ndiameter_mm = {}\ncoil = \"{}\"\n",
        millimetres(catheter.diameter_m),
        name(catheter.coil)
    );
    if let Some(end) = catheter.end {
        let _ = writeln!(text, "end = \"{}\"", name(end));
    }
    if let Some(rounding_m) = catheter.end_rounding_m {
        let _ = writeln!(text, "end_rounding_mm = {}", millimetres(rounding_m));
    }
    if let Some(rigid_m) = catheter.rigid_m {
        let _ = writeln!(text, "rigid_mm = {}", millimetres(rigid_m));
    }
    text
}

fn base(base: &Base) -> String {
    let rows = rotation_rows(&base.base_from_camera.rotation);
    let mut text = format!(
        "# The base frame: origin at the base marker at rest, z along the tube at rest, x along b0, y = z × x.\n\
         [base]\nb0 = {}\n",
        direction(&base.b0)
    );
    if let Some(gravity) = &base.gravity {
        let _ = writeln!(text, "gravity = {}", direction(gravity));
    }
    let _ = write!(
        text,
        "\n# X_base = rotation · X_camera + translation; the rows are the axes x, y, z of the base in the camera \
         frame.\n[base.base_from_camera]\nrotation = [\n{}]\ntranslation_mm = {}\n",
        rows.chunks(3)
            .map(|row| format!("    {},\n", list(row.iter().map(|v| decimal(*v, DIRECTION_DECIMALS)))))
            .collect::<String>(),
        list(base.base_from_camera.translation.vector.iter().map(|v| millimetres(*v))),
    );
    text
}

fn list(items: impl Iterator<Item = String>) -> String {
    format!("[{}]", items.collect::<Vec<_>>().join(", "))
}

fn direction(v: &Vector3<f64>) -> String {
    let settled = round_stably([v.x, v.y, v.z], |v| Vector3::from(v).normalize().into());
    list(settled.iter().map(|v| decimal(*v, DIRECTION_DECIMALS)))
}

/// The rotation matrix, row-major.
fn rotation_rows(rotation: &UnitQuaternion<f64>) -> [f64; 9] {
    let rows = |q: &UnitQuaternion<f64>| {
        let m = q.to_rotation_matrix().into_inner();
        [m.m11, m.m12, m.m13, m.m21, m.m22, m.m23, m.m31, m.m32, m.m33]
    };
    round_stably(rows(rotation), |read| rows(&rotation_of(&Matrix3::from_row_slice(&read))))
}
