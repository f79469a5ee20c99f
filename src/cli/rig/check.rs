//! `catoptra rig check`: a rig file in words and numbers.

use super::super::run::two_views;
use super::super::{Exit, Failure, output};
use crate::optics::{Surface, Wall};
use crate::rig::check::{Check, ROUND_TRIP_LIMIT_PX, ViewCheck, check};
use crate::rig::{Base, Camera, Rig, View};
use nalgebra::Vector3;
use std::fmt::{self, Write as _};
use std::path::Path;

pub(super) fn run(file: &Path) -> Result<(), Failure> {
    let rig = Rig::load(file)?;
    let checked = check(&rig).map_err(|e| Failure::new(Exit::Unusable, format!("{}: {e}", file.display())))?;
    let mut text = String::new();
    describe(&mut text, file, &rig, &checked)
        .map_err(|e| Failure::new(Exit::Failed, format!("cannot describe {}: {e}", file.display())))?;
    output::print(&text)?;
    if let Err(one_view) = two_views(file, &rig) {
        return Err(Failure::new(Exit::Unusable, one_view.to_string()));
    }
    if checked.usable() {
        return Ok(());
    }
    Err(Failure::new(
        Exit::Unusable,
        format!("{}: a view does not lead to points and back within {ROUND_TRIP_LIMIT_PX} px", file.display()),
    ))
}

/// Provenance without its long lists: matrices and hashes are for programs.
fn brief(table: &toml::Table) -> toml::Table {
    const SHORT: usize = 9;
    let shorter = |value: &toml::Value| match value {
        toml::Value::Table(inner) if inner.len() > SHORT => format!("{} entries", inner.len()).into(),
        toml::Value::Table(inner) => brief(inner).into(),
        toml::Value::Array(list) if list.iter().any(toml::Value::is_array) => format!("{} rows", list.len()).into(),
        toml::Value::Array(list) if list.len() > SHORT => format!("{} values", list.len()).into(),
        other => other.clone(),
    };
    table.iter().map(|(key, value)| (key.clone(), shorter(value))).collect()
}

fn describe(out: &mut String, file: &Path, rig: &Rig, checked: &Check) -> fmt::Result {
    writeln!(out, "{}\n", file.display())?;
    camera(out, &rig.camera, checked)?;
    surfaces(out, rig)?;
    for (view, seen) in rig.views.iter().zip(&checked.views) {
        self::view(out, view, seen)?;
    }
    if let Some(meeting) = &checked.closest_approach {
        writeln!(
            out,
            "\nthe first two views look at ({}) mm, camera frame: central rays pass {:.1} mm apart at {:.1}°",
            vector_mm(&meeting.point.coords),
            meeting.apart_m * 1e3,
            meeting.angle_rad.to_degrees()
        )?;
    }
    catheter(out, rig)?;
    match &rig.base {
        Some(base) => self::base(out, base)?,
        None => writeln!(out, "\nbase frame\n  not known")?,
    }
    writeln!(out, "\ntest grid, pixel -> ray -> point -> pixel")?;
    for (view, seen) in rig.views.iter().zip(&checked.views) {
        let trip = &seen.round_trip;
        let distances: Vec<_> = trip.distances_m.iter().map(|d| format!("{:.0}", d * 1e3)).collect();
        writeln!(
            out,
            "  {:<10} {} of {} pixels have a ray; at {} mm: largest error {:.1e} px, {} points lost",
            view.name,
            trip.with_ray,
            trip.pixels,
            distances.join(", "),
            trip.max_error_px,
            trip.lost
        )?;
    }
    if !rig.provenance.is_empty() {
        writeln!(out, "\nprovenance")?;
        for line in brief(&rig.provenance).to_string().lines().filter(|line| !line.is_empty()) {
            writeln!(out, "  {line}")?;
        }
    }
    match checked.warnings.len() {
        0 => writeln!(out, "\nno warnings"),
        n => {
            writeln!(out, "\n{n} warning{}", if n == 1 { "" } else { "s" })?;
            checked.warnings.iter().try_for_each(|warning| writeln!(out, "  - {warning}"))
        }
    }
}

fn camera(out: &mut String, camera: &Camera, checked: &Check) -> fmt::Result {
    let lens = &camera.lens;
    let angle = |a: Option<f64>| a.map_or("unknown".to_owned(), |a| format!("{:.1}°", a.to_degrees()));
    let [horizontal, vertical] = checked.field_of_view_rad.map(angle);
    writeln!(out, "camera")?;
    writeln!(out, "  picture          {} x {} px", camera.size_px[0], camera.size_px[1])?;
    writeln!(out, "  field of view    {horizontal} x {vertical}")?;
    writeln!(out, "  focal length     {:.2}, {:.2} px", lens.focal_px.x, lens.focal_px.y)?;
    writeln!(out, "  principal point  {:.2}, {:.2} px", lens.principal_point_px.x, lens.principal_point_px.y)?;
    writeln!(out, "  distortion       k1, k2, p1, p2, k3 = {:?}", lens.distortion)?;
    match camera.blur_px {
        Some(blur) => writeln!(out, "  blur             {blur:.2} px")?,
        None => writeln!(out, "  blur             not known")?,
    }
    let [right, down] = camera.chroma_offset_px;
    writeln!(out, "  chroma samples   {right:+.2}, {down:+.2} px beside where recordings say")
}

fn surfaces(out: &mut String, rig: &Rig) -> fmt::Result {
    writeln!(out, "\nsurfaces")?;
    if rig.surfaces.is_empty() {
        writeln!(out, "  none: in air, seen directly")?;
    }
    for (name, surface) in &rig.surfaces {
        let plane = surface.plane();
        let tilt = plane.normal().z.abs().min(1.0).acos().to_degrees();
        // A plane along the optical axis crosses it far away or never: then its distance says more.
        let on_axis_m = plane.offset_m() / plane.normal().z;
        let crossing = match on_axis_m {
            z if z > 0.0 && tilt < 80.0 => format!(", met {:.1} mm along it", z * 1e3),
            _ => String::new(),
        };
        let distance_mm = plane.offset_m().abs() * 1e3;
        write!(out, "  {name:<16} ")?;
        match surface {
            Surface::Mirror(_) => writeln!(out, "mirror")?,
            Surface::Wall(wall) => writeln!(out, "wall, {}, {:.2} mm thick", media(wall), wall.thickness_m * 1e3)?,
        }
        writeln!(
            out,
            "                   {distance_mm:.1} mm from the camera, normal {tilt:.1}° to the optical axis{crossing}"
        )?;
    }
    Ok(())
}

fn view(out: &mut String, view: &View, seen: &ViewCheck) -> fmt::Result {
    writeln!(out, "\nview {}", view.name)?;
    let mut way = String::from("camera");
    let mut shown: Option<f64> = None;
    for ((name, surface), crossing) in view.path.iter().zip(&view.optics.surfaces).zip(&seen.crossings) {
        if let Some((before, _)) = crossing.media
            && shown.is_none()
        {
            way = way.replacen("camera", &format!("camera in {}", medium(before)), 1);
        }
        shown = crossing.media.map(|(_, after)| after).or(shown);
        match (surface, crossing.media) {
            (Surface::Wall(wall), Some((_, after))) => {
                write!(way, " -> through {name} ({}) into {}", medium(wall.index_wall), medium(after))?;
            }
            _ => write!(way, " -> reflected by {name}")?,
        }
    }
    writeln!(out, "  light path       {way} -> marker")?;
    match view.region_px.len() {
        0 => writeln!(out, "  region           none: anywhere in the picture")?,
        n => writeln!(
            out,
            "  region           {n} corners around ({:.0}, {:.0}) px",
            seen.centre_px.x, seen.centre_px.y
        )?,
    }
    for (name, crossing) in view.path.iter().zip(&seen.crossings) {
        writeln!(
            out,
            "  central ray      {:.1}° from the normal of {name}, at ({}) mm",
            crossing.incidence_rad.to_degrees(),
            vector_mm(&crossing.point.coords)
        )?;
    }
    if let Some(refraction) = &seen.refraction {
        writeln!(
            out,
            "  refraction       {:.0} mm behind the last surface things appear {:.1} mm nearer and {:.1} mm aside",
            seen.working_distance_m * 1e3,
            refraction.nearer_m * 1e3,
            refraction.beside_m * 1e3
        )?;
    }
    Ok(())
}

fn catheter(out: &mut String, rig: &Rig) -> fmt::Result {
    writeln!(out, "\ncatheter, {:.2} mm thick; bands from the clamp on", rig.catheter.diameter_m * 1e3)?;
    for (index, marker) in rig.markers.iter().enumerate() {
        let place = match marker.centre_m {
            Some(centre_m) => format!("middle at {:.1} mm along the tube", centre_m * 1e3),
            None => "place not known".to_owned(),
        };
        let colour = match marker.colour(0) {
            Some(c) => format!("colour ({:.0}, {:.0}, {:.0})", c.rgb.x, c.rgb.y, c.rgb.z),
            None => "colour not learned".to_owned(),
        };
        let coil = if index == rig.catheter.coil { "; its direction is the coil's tangent" } else { "" };
        let end = if Some(index) == rig.catheter.end { "; ends the tube" } else { "" };
        writeln!(out, "  {:<10} {:.1} mm long, {place}, {colour}{coil}{end}", marker.name, marker.length_m * 1e3)?;
    }
    Ok(())
}

fn base(out: &mut String, base: &Base) -> fmt::Result {
    let camera_from_base = base.base_from_camera.inverse();
    writeln!(out, "\nbase frame, in the camera frame")?;
    writeln!(out, "  origin           ({}) mm", vector_mm(&camera_from_base.translation.vector))?;
    for (name, axis) in [("x", Vector3::x()), ("y", Vector3::y()), ("z", Vector3::z())] {
        writeln!(out, "  {name}                ({})", vector(&(camera_from_base.rotation * axis)))?;
    }
    writeln!(out, "  b0               ({})", vector(&base.b0))?;
    match &base.gravity {
        Some(gravity) => {
            let hang = gravity.angle(&(camera_from_base.rotation * Vector3::z())).to_degrees();
            writeln!(out, "  gravity          ({}), {hang:.1}° from z", vector(gravity))
        }
        None => writeln!(out, "  gravity          not given"),
    }
}

fn media(wall: &Wall) -> String {
    format!("{} | {} | {}", medium(wall.index_outside), medium(wall.index_wall), medium(wall.index_inside))
}

/// A medium by its index of refraction.
fn medium(index: f64) -> String {
    let name = match index {
        i if i < 1.001 => "air",
        i if (1.32..1.36).contains(&i) => "water",
        i if (1.47..1.495).contains(&i) => "acrylic",
        i if (1.495..1.53).contains(&i) => "glass",
        _ => return format!("index {index:.4}"),
    };
    format!("{name} {index}")
}

fn vector_mm(v: &Vector3<f64>) -> String {
    format!("{:.1}, {:.1}, {:.1}", v.x * 1e3, v.y * 1e3, v.z * 1e3)
}

fn vector(v: &Vector3<f64>) -> String {
    format!("{:.4}, {:.4}, {:.4}", v.x, v.y, v.z)
}
