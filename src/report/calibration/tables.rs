//! The tables of a calibration's page, in mm, degrees and pixels.

use super::super::html::Html;
use super::super::page::{signed, table};
use crate::calibrate::bundle::prior::Prior;
use crate::calibrate::bundle::{NoSolution, Solution};
use crate::calibrate::geometry::{Geometry, Parameter};
use crate::calibrate::rig::RigCalibration;
use crate::calibrate::rig::diagnostics::{CONTRADICTION_SD, Compared, compared};
use crate::calibrate::rig::held_out::{HeldOut, Length, LengthErrors};
use crate::median::upper_median;
use nalgebra::DMatrix;

fn surface_name(geometry: &Geometry, surface: usize) -> &str {
    geometry.surfaces.get(surface).map_or("", |(name, _)| name.as_str())
}

/// A name that fits beside a plot.
pub(super) fn short_name(geometry: &Geometry, parameter: Parameter) -> String {
    let of = |names: &[&str], i: usize| names.get(i).copied().unwrap_or("").to_owned();
    match parameter {
        Parameter::Focal(axis) => of(&["fx", "fy"], axis),
        Parameter::Principal(axis) => of(&["cx", "cy"], axis),
        Parameter::Distortion(i) => of(&["k1", "k2", "p1", "p2", "k3"], i),
        Parameter::Denominator(i) => of(&["k4", "k5", "k6"], i),
        Parameter::Tilt { surface, axis } => {
            format!("{} {}", surface_name(geometry, surface), of(&["up-down", "left-right"], axis))
        }
        Parameter::Offset { surface } => format!("{} distance", surface_name(geometry, surface)),
        Parameter::IndexInside => "index of the water".to_owned(),
    }
}

fn number(value: Option<f64>, digits: usize) -> String {
    value.filter(|v| v.is_finite()).map_or("held".to_owned(), |v| format!("{v:.digits$}"))
}

/// Mirrors and walls.
pub(super) fn surfaces(solution: &Solution) -> String {
    let geometry = &solution.geometry;
    let rows: Vec<Vec<String>> = geometry
        .surfaces
        .iter()
        .enumerate()
        .map(|(surface, (name, optics))| {
            let plane = optics.plane();
            let [x, y, z] = [plane.normal().x, plane.normal().y, plane.normal().z].map(|c| signed(c, 5));
            let tilt = |axis| number(solution.sd(Parameter::Tilt { surface, axis }).map(f64::to_degrees), 3);
            vec![
                name.clone(),
                format!("({x}, {y}, {z})"),
                tilt(0),
                tilt(1),
                format!("{:.2}", plane.offset_m().abs() * 1e3),
                number(solution.sd(Parameter::Offset { surface }).map(|sd| sd * 1e3), 2),
            ]
        })
        .collect();
    let index = solution.sd(Parameter::IndexInside).map_or(String::new(), |sd| {
        let value = geometry.value(Parameter::IndexInside);
        format!("<p>The index of the water was fitted: {value:.4}, σ {sd:.4}. It trades off against distances.</p>\n")
    });
    let heads = ["Surface", "Normal", "σ up-down (°)", "σ left-right (°)", "Distance (mm)", "σ (mm)"];
    format!("<h3>Mirrors and walls</h3>\n{}{index}", table(1, &heads, &rows))
}

/// The lens now, and before the mirrors' pictures.
pub(super) fn lens(solution: &Solution) -> String {
    const ROWS: [(&str, usize); 12] = [
        ("focal length x, fx (px)", 2),
        ("focal length y, fy (px)", 2),
        ("principal point x, cx (px)", 2),
        ("principal point y, cy (px)", 2),
        ("k1", 4),
        ("k2", 4),
        ("p1", 5),
        ("p2", 5),
        ("k3", 3),
        ("k4", 3),
        ("k5", 3),
        ("k6", 3),
    ];
    let before = solution.known.iter().find_map(|known| match known {
        Prior::Lens { values, whitening } => Some((values, (whitening.tr_mul(whitening)).try_inverse()?)),
        _ => None,
    });
    let rows: Vec<Vec<String>> = ROWS
        .iter()
        .zip(Parameter::of_lens(&solution.geometry.lens).iter().copied())
        .enumerate()
        .map(|(i, ((name, digits), parameter))| {
            let was = before
                .as_ref()
                .and_then(|(values, covariance)| Some((*values.get(i)?, covariance.get((i, i))?.sqrt())));
            let cell = |value: Option<f64>| value.map_or("–".to_owned(), |v| signless(v, *digits));
            vec![
                (*name).to_owned(),
                signless(solution.geometry.value(parameter), *digits),
                number(solution.sd(parameter), *digits),
                cell(was.map(|w| w.0)),
                cell(was.map(|w| w.1)),
            ]
        })
        .collect();
    let heads = ["Parameter", "Value", "σ", "Before", "σ before"];
    format!(
        "<h3>Lens</h3>\n<p>Before: as <code>catoptra calibrate camera</code> found it, without mirror and \
         water.</p>\n{}",
        table(1, &heads, &rows)
    )
}

/// Without a plus sign, and with a typographic minus.
fn signless(value: f64, digits: usize) -> String {
    signed(value, digits).trim_start_matches('+').to_owned()
}

/// The priors, and whether the pictures agree.
pub(super) fn known(solution: &Solution) -> String {
    let geometry = &solution.geometry;
    let offset_m = |surface: usize| geometry.value(Parameter::Offset { surface });
    let normal = |surface: usize| geometry.surfaces.get(surface).map(|(_, s)| s.plane().normal());
    let in_mm = |sd_m: f64| Some((sd_m * 1e3, 2, " mm"));
    let mm = |value_m: f64, sd_m: f64| format!("{:.2} ± {:.2} mm", value_m * 1e3, sd_m * 1e3);
    let rows: Vec<Vec<Html>> = solution
        .known
        .iter()
        .map(|known| {
            // Last, σ of what was given, its digits and its unit.
            let (given, found, sd) = match known {
                Prior::Lens { .. } => ("see above".to_owned(), "see above".to_owned(), None),
                Prior::Distance { surface, distance_m, sd_m } => {
                    (mm(*distance_m, *sd_m), format!("{:.2} mm", offset_m(*surface).abs() * 1e3), in_mm(*sd_m))
                }
                Prior::Square { surfaces: [a, b], sd_rad } => {
                    let angle = normal(*a).zip(normal(*b)).map(|(a, b)| a.angle(&b).to_degrees());
                    let found = angle.map_or("–".to_owned(), |angle| format!("{angle:.3}°"));
                    let sd_deg = sd_rad.to_degrees();
                    (format!("90 ± {sd_deg:.2}°"), found, Some((sd_deg, 2, "°")))
                }
                Prior::Apart { surfaces: [a, b], distance_m, sd_m } => {
                    (mm(*distance_m, *sd_m), format!("{:.2} mm", (offset_m(*a) + offset_m(*b)) * 1e3), in_mm(*sd_m))
                }
                Prior::IndexInside { index, sd } => {
                    let found = format!("{:.4}", geometry.value(Parameter::IndexInside));
                    (format!("{index:.4} ± {sd:.4}"), found, Some((*sd, 4, "")))
                }
                Prior::Taped { thickness_m, sd_m, .. } => (mm(*thickness_m, *sd_m), "–".to_owned(), None),
            };
            let rest = compared(solution, known);
            let off = rest.map_or(Html::from("–"), |Compared { off, .. }| {
                let class = if off > CONTRADICTION_SD { " class=\"miss\"" } else { "" };
                Html::raw(format!("<span{class}>{off:.1}</span>"))
            });
            let known_to = rest.and_then(|rest| rest.rest_sd).zip(sd);
            let known_to = known_to
                .map_or("–".to_owned(), |(rest, (sd, digits, unit))| format!("± {:.digits$}{unit}", rest * sd));
            vec![known.what(geometry).into(), given.into(), found.into(), known_to.into(), off]
        })
        .collect();
    if rows.is_empty() {
        return String::new();
    }
    format!(
        "<h3>What else was known</h3>\n<p>Off: how far what was given is from what everything else says, in σ of the \
         two together. Above {CONTRADICTION_SD} the pictures contradict it: measure again. Where everything else would \
         know it worse by far, or hardly at all (–), a mistake in what was given is not noticed.</p>\n{}",
        table(1, &["What", "Given", "Came out", "All else knows it to", "Off (σ)"], &rows)
    )
}

/// Correlations from a covariance.
pub(super) fn correlations(covariance: &DMatrix<f64>) -> DMatrix<f64> {
    let sd = covariance.diagonal().map(f64::sqrt);
    covariance.component_div(&(&sd * sd.transpose()))
}

/// The check on held-out pictures, one row per picture.
pub(super) fn held_out(done: &RigCalibration, held: &[Result<HeldOut, NoSolution>]) -> String {
    let mut rows: Vec<Vec<Html>> = done
        .used
        .iter()
        .zip(held)
        .map(|((_, used), held)| match held {
            Ok(held) => row(&used.name, &held.edges, &held.diagonals, held.scale, &held.rays_m),
            Err(why) => {
                let mut row = vec![Html::from(&used.name), format!("without it, {why}").into()];
                row.resize(9, Html::default());
                row
            }
        })
        .collect();
    let (mut edges, mut diagonals, mut rays_m, mut scales) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    for held in held.iter().flatten() {
        edges.extend(held.edges.iter().copied());
        diagonals.extend(held.diagonals.iter().copied());
        rays_m.extend(held.rays_m.iter().copied());
        scales.extend(held.scale);
    }
    let scale = (!scales.is_empty()).then(|| scales.iter().sum::<f64>() / scales.len() as f64);
    let all = row("all", &edges, &diagonals, scale, &rays_m);
    rows.push(all.into_iter().map(|cell| Html::raw(format!("<strong>{cell}</strong>"))).collect());
    let heads = [
        "Picture<br>left out",
        "Edges: RMS<br>off (mm)",
        "noise<br>explains",
        "largest",
        "Diagonals: RMS<br>off (mm)",
        "noise<br>explains",
        "Scale: off in<br>100 mm (mm)",
        "Rays pass by<br>(median, mm)",
        "largest",
    ]
    .map(Html::raw);
    format!(
        "{}<p class=\"note\">Rays pass by: how far the rays of the views pass the place nearest to them all, the \
         number by which the tracker tells that two views show the same band.</p>\n",
        table(1, &heads, &rows)
    )
}

fn row(name: &str, edges: &[Length], diagonals: &[Length], scale: Option<f64>, rays_m: &[f64]) -> Vec<Html> {
    let mm = |value_m: Option<f64>| {
        value_m.filter(|v| v.is_finite()).map_or(Html::from("–"), |v| format!("{:.3}", v * 1e3).into())
    };
    let (edges, diagonals) = (LengthErrors::of(edges), LengthErrors::of(diagonals));
    vec![
        Html::from(name),
        mm(edges.map(|o| o.rms_m)),
        mm(edges.map(|o| o.noise_m)),
        mm(edges.map(|o| o.largest_m)),
        mm(diagonals.map(|o| o.rms_m)),
        mm(diagonals.map(|o| o.noise_m)),
        scale.map_or("–".into(), |scale| signed(scale * 100.0, 3).into()),
        mm(upper_median(rays_m.iter().copied())),
        mm(rays_m.iter().copied().max_by(f64::total_cmp)),
    ]
}
