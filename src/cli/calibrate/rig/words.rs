//! How good a rig is, in words.

use super::super::pictures;
use super::Seen;
use crate::calibrate::bundle::prior::Prior;
use crate::calibrate::bundle::{NoSolution, Solution, surface_sd};
use crate::calibrate::geometry::Parameter;
use crate::calibrate::rig::diagnostics::{CONTRADICTION_SD, Compared, compared};
use crate::calibrate::rig::expected_error::Verdict;
use crate::calibrate::rig::held_out::{HeldOut, LengthErrors};
use crate::calibrate::rig::{RigCalibration, RigOptions};
use std::fmt::Write as _;

/// What was given is not checked if everything else would know it this many times worse.
const UNCHECKED: f64 = 3.0;

pub(super) fn describe(seen: &Seen, done: &RigCalibration, judged: Option<&Verdict>, options: &RigOptions) -> String {
    let mut text = pictures::table(seen.searched(), done.used.iter().map(|(_, picture)| picture), &done.left_out);
    let solution = &done.solution;
    let _ = writeln!(
        text,
        "\n{} of {} pictures used, corners good to {}\n\nsurface      normal                          σ  of noise      \
         offset mm       σ  of noise",
        done.used.len(),
        seen.pictures(),
        pictures::rms(solution.corner_sd_px)
    );
    for (surface, (name, optics)) in solution.geometry.surfaces.iter().enumerate() {
        let plane = optics.plane();
        let n = plane.normal();
        let (tilt, offset) = surface_sd(surface, |parameter| solution.sd(parameter));
        let (tilt_by_noise, offset_by_noise) = surface_sd(surface, |parameter| {
            Some(solution.sd_in(&solution.noise_covariance, parameter)?.min(solution.sd(parameter)?))
        });
        let degrees = |sd: Option<f64>| sd.map_or("fixed".to_owned(), |sd| format!("{:.3}°", sd.to_degrees()));
        let mm = |sd: Option<f64>| sd.map_or("fixed".to_owned(), |sd| format!("{:.2}", sd * 1e3));
        let _ = writeln!(
            text,
            "{name:<12} {:+.5} {:+.5} {:+.5}   {:>7}   {:>7}   {:>12.2}  {:>6}  {:>8}",
            n.x,
            n.y,
            n.z,
            degrees(tilt),
            degrees(tilt_by_noise),
            plane.offset_m() * 1e3,
            mm(offset),
            mm(offset_by_noise)
        );
    }
    if options.index_sd.is_some() {
        let _ = writeln!(
            text,
            "\nindex of the water {:.4} ± {}: it trades off against distances, a thermometer knows it better",
            solution.geometry.value(Parameter::IndexInside),
            solution.sd(Parameter::IndexInside).map_or("fixed".to_owned(), |sd| format!("{sd:.4}"))
        );
    }
    text += &describe_unchecked(solution);
    match judged {
        Some(judged) => text += &describe_verdict(judged),
        None => text += "\nno verdict: the boards fill no volume that two views see\n",
    }
    text
}

/// What was given and is believed, because everything else would hardly contradict it.
fn describe_unchecked(solution: &Solution) -> String {
    let what = |known: &Prior| {
        let times_worse = match compared(solution, known) {
            None => "hardly at all".to_owned(),
            Some(Compared { off, .. }) if off > CONTRADICTION_SD => return None,
            Some(Compared { rest_sd, .. }) => format!("{:.0} times worse", rest_sd.filter(|sd| *sd > UNCHECKED)?),
        };
        Some(format!("{} (all else knows it {times_worse})", known.what(&solution.geometry)))
    };
    let all: Vec<String> = solution.known.iter().filter_map(what).collect();
    if all.is_empty() {
        String::new()
    } else {
        format!("\ntaken as given, a mistake would hardly show: {}\n", all.join(", "))
    }
}

fn describe_verdict(judged: &Verdict) -> String {
    let line = |what: &str, (median_m, worst_m): (f64, f64)| {
        format!("{what:<34} {:>8.3}   {:>8.3}\n", median_m * 1e3, worst_m * 1e3)
    };
    let [low, high] = judged.filled;
    let side = |axis: usize| format!("{:.0} to {:.0}", low[axis] * 1e3, high[axis] * 1e3);
    let mut text = format!(
        "\nin the boards' volume, x {}, y {}, z {} mm of the camera frame (outside of it, errors grow quickly):\n\
         expected error in space, mm (1σ)     median      worst place\n",
        side(0),
        side(1),
        side(2)
    );
    text += &line("of the camera frame (all together)", judged.median_and_worst(|e| e.absolute_m));
    text += &line("of the base frame, displacements", judged.median_and_worst(|e| e.relative_m));
    let (median_rad, worst_rad) = judged.angle_rad;
    let _ = writeln!(text, "{:<34} {:>8.4}°  {:>8.4}°", "of angles", median_rad.to_degrees(), worst_rad.to_degrees());
    text += &line("of a single corner, random", judged.median_and_worst(|e| e.random_m));
    let (direction, sd_m) = judged.weakest;
    let _ = writeln!(
        text,
        "weakest: everything together along ({:+.2}, {:+.2}, {:+.2}), by {:.2} mm; positions in the base frame and \
         angles do not see it",
        direction.x,
        direction.y,
        direction.z,
        sd_m * 1e3
    );
    for (frame, best) in [("base", judged.helpful_relative()), ("camera", judged.helpful_absolute())] {
        if let Some(best) = best.first() {
            let (what, relative_mm, absolute_mm) = (&best.what, best.relative_m * 1e3, best.absolute_m * 1e3);
            let _ = writeln!(
                text,
                "what would help most in the {frame} frame: {what} (base frame {relative_mm:.4} mm, camera frame \
                 {absolute_mm:.2} mm)"
            );
        }
    }
    text
}

/// Lines about the check on held-out pictures.
pub(super) fn describe_held_out(held: &[Result<HeldOut, NoSolution>]) -> String {
    let mut text = String::new();
    let edges = LengthErrors::of(held.iter().flatten().flat_map(|h| &h.edges));
    let diagonals = LengthErrors::of(held.iter().flatten().flat_map(|h| &h.diagonals));
    if let (Some(edges), Some(diagonals)) = (edges, diagonals) {
        let _ = writeln!(
            text,
            "held out in turn, {} edges of {:.1} mm are off by {:.3} mm RMS (corner noise explains {:.3}), {} \
             diagonals of {:.1} mm by {:.3} mm ({:.3})",
            edges.count,
            edges.nominal_m * 1e3,
            edges.rms_m * 1e3,
            edges.noise_m * 1e3,
            diagonals.count,
            diagonals.nominal_m * 1e3,
            diagonals.rms_m * 1e3,
            diagonals.noise_m * 1e3
        );
    }
    let failed = held.iter().filter(|held| held.is_err()).count();
    if failed > 0 {
        let _ = writeln!(
            text,
            "{failed} of {} pictures could not be held out: without each of them the rig is open",
            held.len()
        );
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pictures_that_cannot_be_held_out_are_counted() {
        let held = HeldOut { edges: Vec::new(), diagonals: Vec::new(), scale: None, rays_m: Vec::new() };
        assert_eq!(describe_held_out(&[Ok(held.clone())]), "");
        let told = describe_held_out(&[Ok(held), Err(NoSolution::Singular), Err(NoSolution::NotConverged)]);
        assert!(told.starts_with("2 of 3 pictures could not be held out"), "{told}");
    }
}
