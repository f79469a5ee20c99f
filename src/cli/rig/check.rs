//! `catoptra rig check`: describes a rig file in words and numbers.

use super::super::progress::Progress;
use super::super::run::two_views;
use super::super::{Exit, Failure, fitting, output};
use crate::calibrate::rig::share::{CatheterPose, of_coordinate, share};
use crate::optics::{Surface, Wall};
use crate::plural::plural;
use crate::rig::check::{Check, ROUND_TRIP_LIMIT_PX, ViewCheck, check};
use crate::rig::{Base, Camera, Draft, View, blur_in_words};
use crate::source::{FrameSource as _, SourceOptions};
use crate::track::{TrackOptions, Tracker};
use nalgebra::Vector3;
use std::fmt::{self, Write as _};
use std::path::Path;

/// Most moments of a recording evaluated.
const MAX_MOMENTS: usize = 200;

pub(super) fn run(file: &Path, recording: Option<&Path>, quiet: bool) -> Result<(), Failure> {
    let rig = Draft::load(file)?;
    let checked = check(&rig).map_err(|e| Failure::new(Exit::Unusable, format!("{}: {e}", file.display())))?;
    let mut text = String::new();
    describe(&mut text, file, &rig, &checked)
        .map_err(|e| Failure::new(Exit::Failed, format!("cannot describe {}: {e}", file.display())))?;
    output::print(&text)?;
    if let Some(recording) = recording {
        output::print(&at_the_catheter(file, &rig, recording, quiet)?)?;
    }
    if let Err(one_view) = two_views(file, &rig.views) {
        return Err(Failure::new(Exit::Unusable, one_view.message()));
    }
    if checked.usable() {
        return Ok(());
    }
    Err(Failure::new(
        Exit::Unusable,
        format!(
            "{}: projection and ray tracing of a view disagree by more than {ROUND_TRIP_LIMIT_PX} px",
            file.display()
        ),
    ))
}

/// Quality of the calibration at the catheter's positions in a recording.
fn at_the_catheter(file: &Path, draft: &Draft, recording: &Path, quiet: bool) -> Result<String, Failure> {
    let unusable = |e: &dyn fmt::Display| Failure::new(Exit::Unusable, format!("{}: {e}", recording.display()));
    let rig = draft.clone().complete(file)?;
    let mut source = fitting::open_to_track((recording, SourceOptions::default()), (file, &rig))?;
    let mut progress = Progress::of_frames(source.frame_count_hint(), quiet);
    let mut tracker = Tracker::new(&rig, TrackOptions::default()).map_err(Failure::usage)?;
    let mut poses = Vec::new();
    let mut frames = 0;
    while let Some(frame) = source.next_of_readable(frames > 0).map_err(|e| Failure::new(Exit::Failed, e))? {
        let estimate = tracker.step(&frame).map_err(Failure::usage)?;
        while let Some(warning) = tracker.warning() {
            tracing::warn!("{}: {warning}", recording.display());
        }
        let tip = rig.tip();
        let place = |marker: usize| estimate.markers.get(marker)?.position.as_ref().ok().map(|p| p.point);
        if let (Some(coil), Some(tip), Ok(tangent)) = (place(rig.catheter.coil), place(tip), &estimate.tangent) {
            poses.push(CatheterPose { coil, tangent: tangent.direction, tip });
        }
        frames += 1;
        progress.at(frames);
    }
    drop(progress);
    let every = poses.len().div_ceil(MAX_MOMENTS).max(1);
    let some: Vec<CatheterPose> = poses.iter().copied().step_by(every).collect();
    let share = share(draft, &some).map_err(|e| unusable(&e))?;
    let mut text = format!("\nthe calibration's share of errors at the catheter in {} (1σ)", recording.display());
    text += &format!(
        "\n  θ                  {:.4}°, at the worst moment {:.4}°\n  tip, a coordinate  {:.4} mm, at the worst \
         moment {:.4} mm\n",
        share.theta_rad.0.to_degrees(),
        share.theta_rad.1.to_degrees(),
        of_coordinate(share.tip_m.0) * 1e3,
        of_coordinate(share.tip_m.1) * 1e3
    );
    if draft.lens_is_adjusted() == Some(false) {
        text += "  the lens is taken as exact: its errors are not among these (it came without σ)\n";
    }
    text += &match share.outside_m {
        None => "  the rig file does not say which places the boards filled\n".to_owned(),
        Some(0.0) => "  within the boards' volume\n".to_owned(),
        Some(m) => format!(
            "  warning: up to {:.0} mm outside the boards' volume, where errors are larger than this says: calibrate \
             with boards where the catheter is\n",
            m * 1e3
        ),
    };
    Ok(text)
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
    // Doubts are among the warnings.
    let told = table.iter().filter(|(key, _)| *key != "doubts");
    told.map(|(key, value)| (key.clone(), shorter(value))).collect()
}

fn describe(out: &mut String, file: &Path, rig: &Draft, checked: &Check) -> fmt::Result {
    writeln!(out, "{}\n", file.display())?;
    camera(out, rig, checked)?;
    if !rig.views.is_empty() {
        surfaces(out, rig)?;
    }
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
    if let Some([low, high]) = rig.boards_volume_m() {
        let side = |axis: usize| format!("{:.0} to {:.0}", low[axis] * 1e3, high[axis] * 1e3);
        writeln!(
            out,
            "\nboards filled x {}, y {}, z {} mm of the camera frame: there the calibration is as good as it says",
            side(0),
            side(1),
            side(2)
        )?;
    }
    catheter(out, rig)?;
    match &rig.base {
        Some(base) => self::base(out, base)?,
        None => writeln!(out, "\nbase frame\n  not known")?,
    }
    if !rig.views.is_empty() {
        writeln!(out, "\ntest grid, pixel -> ray -> point -> pixel")?;
    }
    for (view, seen) in rig.views.iter().zip(&checked.views) {
        let trip = &seen.round_trip;
        let distances: Vec<_> = trip.distances_m.iter().map(|d| format!("{:.0}", d * 1e3)).collect();
        writeln!(
            out,
            "  {:<10} {} of {} pixels have a ray; at {} mm: largest error {:.1e} px, {} lost",
            view.name,
            trip.with_ray,
            trip.pixels,
            distances.join(", "),
            trip.max_error_px,
            plural(trip.lost, "point")
        )?;
    }
    if !rig.provenance.is_empty() {
        writeln!(out, "\nprovenance")?;
        for line in brief(&rig.provenance).to_string().lines().filter(|line| !line.is_empty()) {
            writeln!(out, "  {line}")?;
        }
    }
    let missing = rig.missing();
    if !missing.is_empty() {
        writeln!(out, "\nstill missing, before anything can be tracked")?;
        missing.iter().try_for_each(|(what, command)| writeln!(out, "  {what:<25} {command}"))?;
    }
    match checked.warnings.len() {
        0 => writeln!(out, "\nno warnings"),
        n => {
            writeln!(out, "\n{}", plural(n, "warning"))?;
            checked.warnings.iter().try_for_each(|warning| writeln!(out, "  - {warning}"))
        }
    }
}

/// The blur of views that have their own.
fn own_blurs(rig: &Draft) -> String {
    let of_view = |view: &View| Some(format!(", {} px in view `{}`", blur_in_words(&view.blur_px?), view.name));
    rig.views.iter().filter_map(of_view).collect()
}

fn camera(out: &mut String, rig: &Draft, checked: &Check) -> fmt::Result {
    let camera: &Camera = &rig.camera;
    let lens = &camera.lens;
    let sd = |names: [&str; 2]| match names.map(|name| rig.noted_sd(name)) {
        [Some(a), Some(b)] => format!("   σ {a:.2}, {b:.2}"),
        _ => String::new(),
    };
    let of_focal = sd(["focal_x_px", "focal_y_px"]);
    let of_centre = sd(["principal_point_x_px", "principal_point_y_px"]);
    let angle = |a: Option<f64>| a.map_or("unknown".to_owned(), |a| format!("{:.1}°", a.to_degrees()));
    let [horizontal, vertical] = checked.field_of_view_rad.map(angle);
    writeln!(out, "camera")?;
    writeln!(out, "  picture          {} x {} px", camera.size_px[0], camera.size_px[1])?;
    writeln!(out, "  field of view    {horizontal} x {vertical}")?;
    writeln!(out, "  focal length     {:.2}, {:.2} px{of_focal}", lens.focal_px.x, lens.focal_px.y)?;
    let centre = lens.principal_point_px;
    writeln!(out, "  principal point  {:.2}, {:.2} px{of_centre}", centre.x, centre.y)?;
    writeln!(out, "  distortion       k1, k2, p1, p2, k3 = {:?}", lens.distortion)?;
    if lens.is_rational() {
        writeln!(out, "                   k4, k5, k6 = {:?}", lens.denominator)?;
    }
    match camera.blur_px {
        Some(blur) => writeln!(out, "  blur             {blur:.2} px{}", own_blurs(rig))?,
        None => writeln!(out, "  blur             not known")?,
    }
    match camera.gamma {
        Some(gamma) => writeln!(out, "  gamma            {gamma:.3}")?,
        None => writeln!(out, "  gamma            as recordings declare")?,
    }
    match camera.exposure_s {
        Some(exposure_s) => writeln!(out, "  exposure         {:.2} ms", exposure_s * 1e3)?,
        None => writeln!(out, "  exposure         not known: motion blur is not modelled")?,
    }
    if let Some(readout_s) = camera.readout_s {
        writeln!(out, "  rolling shutter  {:.2} ms from the first row to the last", readout_s * 1e3)?;
    }
    let [right, down] = camera.chroma_offset_px;
    writeln!(out, "  chroma samples   {right:+.2}, {down:+.2} px from where recordings say")?;
    let [right, down] = camera.chroma_reach;
    if [right, down] != [1.0; 2] {
        writeln!(out, "                   they reach {right:.2}, {down:.2} of the distance to the next ones")?;
    }
    let [right, down] = camera.colour_offset_px;
    match [right, down] == [0.0; 2] {
        true => Ok(()),
        false => writeln!(out, "  pixels' colours  {right:+.2}, {down:+.2} px from their luma"),
    }
}

fn surfaces(out: &mut String, rig: &Draft) -> fmt::Result {
    writeln!(out, "\nsurfaces")?;
    if rig.surfaces.is_empty() {
        writeln!(out, "  none (air, no refraction)")?;
    }
    for (name, surface) in &rig.surfaces {
        let plane = surface.plane();
        let tilt = plane.normal().z.abs().min(1.0).acos().to_degrees();
        // A plane along the optical axis crosses it far away or never; then its distance is more useful.
        let on_axis_m = plane.offset_m() / plane.normal().z;
        let crossing = match on_axis_m {
            z if z > 0.0 && tilt < 80.0 => format!(", met {:.1} mm along it", z * 1e3),
            _ => String::new(),
        };
        let distance_mm = plane.offset_m().abs() * 1e3;
        let sd =
            rig.noted_sd(&format!("{name}_offset_m")).map_or(String::new(), |sd_m| format!(" ± {:.2}", sd_m * 1e3));
        write!(out, "  {name:<16} ")?;
        match surface {
            Surface::Mirror(_) => writeln!(out, "mirror")?,
            Surface::Wall(wall) => writeln!(out, "wall, {}, {:.2} mm thick", media(wall), wall.thickness_m * 1e3)?,
        }
        writeln!(
            out,
            "                   {distance_mm:.1}{sd} mm from the camera, normal {tilt:.1}° to the optical \
             axis{crossing}"
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

fn catheter(out: &mut String, rig: &Draft) -> fmt::Result {
    let Some(catheter) = &rig.catheter else { return writeln!(out, "\ncatheter\n  not known") };
    writeln!(out, "\ncatheter, {:.2} mm thick; bands from the clamp on", catheter.diameter_m * 1e3)?;
    for (index, marker) in rig.markers.iter().enumerate() {
        let place = match marker.centre_m {
            Some(centre_m) => format!("middle at {:.1} mm along the tube", centre_m * 1e3),
            None => "place not known".to_owned(),
        };
        let colour = match marker.colour(0) {
            Some(c) => format!("colour ({:.0}, {:.0}, {:.0})", c.rgb.x, c.rgb.y, c.rgb.z),
            None => "colour not learned".to_owned(),
        };
        let coil = if index == catheter.coil { "; its direction is the coil's tangent" } else { "" };
        let rounding = catheter.end_rounding_m.map_or(String::new(), |m| format!(", rounded over {:.2} mm", m * 1e3));
        let end = if Some(index) == catheter.end { format!("; ends the tube{rounding}") } else { String::new() };
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
