//! The page of a rig's calibration: the expected accuracy of positions, the reasons, and what would improve it.
//!
//! In: the calibration, its verdict, the check on held-out pictures. Out: one HTML file that needs no network.

mod boards;
mod figures;
mod set_up;
mod tables;
mod words;

pub(crate) use boards::shown;

use super::html::{Html, escape};
use super::page::{self, card, facts_table, figure, signed, table, trouble};
use crate::calibrate::board::Grey;
use crate::calibrate::bundle::NoSolution;
use crate::calibrate::geometry::bounds;
use crate::calibrate::rig::RigCalibration;
use crate::calibrate::rig::diagnostics::{self, Diagnostic};
use crate::calibrate::rig::expected_error::{Expected, Suggestion, Verdict};
use crate::calibrate::rig::held_out::{HeldOut, LengthErrors};
use crate::digits::fixed;
use crate::plural::plural;
use nalgebra::Point3;
use words::{along, degrees, exact_mm, in_words, mm};

/// Suggestions shown of each kind.
const SUGGESTIONS: usize = 5;
/// Correlations described in words: least strength, and most of them.
const STRONG: (f64, usize) = (0.9, 6);

/// Information about the run besides its result.
#[derive(Debug, Clone, Default)]
pub(crate) struct CalibrationInfo {
    /// The rig file.
    pub rig: String,
    /// Further lines: name and value, e.g. the board and options of the command.
    pub settings: Vec<(String, String)>,
    /// Pictures in which no board was found, and why.
    pub not_found: Vec<(String, String)>,
    /// The pictures of [`shown`] by name, or why one cannot be read.
    pub boards: Vec<(String, Result<Grey, String>)>,
}

/// The whole page. `held`: for each picture used, in the order of `done.used`.
pub(crate) fn page(
    info: &CalibrationInfo,
    done: &RigCalibration,
    verdict: Option<&Verdict>,
    held: &[Result<HeldOut, NoSolution>],
    doubts: &[Diagnostic],
) -> String {
    // The result comes first, then its basis, then what would improve it, then its origin.
    let mut body = header(info, verdict, doubts);
    body += &cards(verdict, held);
    if let Some(verdict) = verdict {
        body += &which_matters(verdict);
        body += &over_the_volume(done, verdict);
    }
    body += &held_out(done, held);
    if let Some(verdict) = verdict {
        body += &better(verdict);
    }
    body += &set_up(done);
    body += &residuals(done);
    body += &boards::section(done, &info.boards);
    body += &parameters(done);
    body += &left_out(info, done);
    body += &facts(info, done);
    body += &page::footer(
        "Errors are 1σ: of places, the root mean square of the distance in space. Camera frame: x right, y down, z \
         forward.",
    );
    page::page(&format!("Calibration of {}", info.rig), &body)
}

fn absolute(e: &Expected) -> f64 {
    e.absolute_m
}

fn relative(e: &Expected) -> f64 {
    e.relative_m
}

fn random(e: &Expected) -> f64 {
    e.random_m
}

fn header(info: &CalibrationInfo, verdict: Option<&Verdict>, diagnostics: &[Diagnostic]) -> String {
    let answer = verdict.map_or_else(
        || "The boards fill no volume that two views see: how well positions will be known cannot be said.".to_owned(),
        |v| {
            let ((relative, relative_worst), (absolute, _)) =
                (v.median_and_worst(relative), v.median_and_worst(absolute));
            let [low, high] = v.filled;
            let side = |axis: usize| {
                let [low, high] = [low, high].map(|corner| page::minus(fixed(corner[axis] * 1e3, 0)));
                format!("{low} to {high}")
            };
            format!(
                "The calibration adds {} to positions and displacements in the base frame ({} at the worst place), {} \
                 to angles, and {} to places counted from the camera, inside the volume that the boards filled: x {}, \
                 y {}, z {} mm of the camera frame. Further out errors grow quickly.",
                mm(relative),
                mm(relative_worst),
                degrees(v.angle_rad.0),
                mm(absolute),
                side(0),
                side(1),
                side(2)
            )
        },
    );
    let findings: String =
        diagnostics.iter().map(|diagnostic| format!("<li>{}</li>\n", escape(&diagnostic.to_string()))).collect();
    let findings = if diagnostics.is_empty() {
        String::new()
    } else {
        format!(
            "<div class=\"doubts\"><p><strong>Do not rely on these numbers yet.</strong> They suppose that nothing but \
             noise is wrong, and more is:</p>\n<ul>\n{findings}</ul></div>\n"
        )
    };
    format!(
        "<header>\n<p class=\"kind\">Catoptra calibration of a rig</p>\n<h1>{}</h1>\n<p \
         class=\"verdict\">{answer}</p>\n{findings}</header>\n",
        escape(&info.rig)
    )
}

fn cards(verdict: Option<&Verdict>, held: &[Result<HeldOut, NoSolution>]) -> String {
    let mut cards = String::new();
    if let Some(verdict) = verdict {
        let worst = |(_, worst): (f64, f64)| format!("worst {}", mm(worst));
        let mut of = |name: &str, both: (f64, f64)| cards += &card(name, mm(both.0), worst(both), false);
        of("Base frame (relative)", verdict.median_and_worst(relative));
        of("Camera frame (absolute)", verdict.median_and_worst(absolute));
        let (median, worst) = verdict.angle_rad;
        cards += &card("Angles", degrees(median), format!("worst {}", degrees(worst)), false);
    }
    if let Some(edges) = LengthErrors::of(held.iter().flatten().flat_map(|h| &h.edges)) {
        cards += &card(
            format!("Held-out {:.1} mm lengths", edges.nominal_m * 1e3),
            mm(edges.rms_m),
            format!("noise {}", mm(edges.noise_m)),
            edges.beyond_noise(),
        );
    }
    format!("<dl class=\"key\">\n{cards}</dl>\n")
}

fn which_matters(verdict: &Verdict) -> String {
    let [(relative, _), (absolute, _), (random, _)] =
        [verdict.median_and_worst(relative), verdict.median_and_worst(absolute), verdict.median_and_worst(random)];
    let (direction, weakest_m) = verdict.weakest;
    let why = if absolute > 5.0 * relative {
        format!(
            " It is so much larger because the pictures tell least where the volume as a whole is {}: that direction \
             alone is open by {}. All places shift by it together; no displacement and no angle sees it.",
            in_words(&direction).map_or_else(|| along(&direction), str::to_owned),
            mm(weakest_m)
        )
    } else {
        String::new()
    };
    let limit = if 2.0 * relative < random {
        "That is more than the calibration adds in the base frame: there, better pictures would hardly make single \
         frames better."
    } else if relative < 2.0 * random {
        "That is about as much as the calibration adds in the base frame."
    } else {
        "That is less than the calibration adds in the base frame: better pictures would pay, see below."
    };
    format!(
        "<h2>Which number matters</h2>\n\
         <p><strong>Base frame, {} and {}.</strong> Where a band is, counted from the base band at rest; how far it \
         moved; the coil’s tangent and θ. All of them compare places measured with one rig, and what the rig gets \
         wrong for all places alike drops out. This is the number for experiments with a catheter, and for comparing \
         runs that used this rig file. How well the base frame itself was found comes on top.</p>\n\
         <p><strong>Camera frame, {}.</strong> Where a place is, counted from the lens. It matters only if positions \
         are to be joined with something this camera did not measure: the scanner’s isocentre, a drawing of the tank, \
         another camera.{why}</p>\n<p><strong>Noise, {}.</strong> What the noise of a corner, {:.3} px here, adds to \
         its place in a single frame. {limit} Noise averages out over frames, what the calibration adds does not. \
         Bands are not corners: their own σ is in the report of each tracking.</p>\n\
         <p class=\"note\">All are 1σ: twice as much is no surprise. And all suppose that mirrors and walls are flat, \
         that squares, glass and refractive indices are what was given, and that camera, mirror and tank stay where \
         they were: calibrate again after moving one of them.</p>\n",
        mm(relative),
        degrees(verdict.angle_rad.0),
        mm(absolute),
        mm(random),
        verdict.pixel_sd_px
    )
}

fn over_the_volume(done: &RigCalibration, verdict: &Verdict) -> String {
    let boards = outlines(done);
    let errors = |of: fn(&Expected) -> f64| verdict.expected.iter().map(|e| (e.place, of(e))).collect::<Vec<_>>();
    let row = |name: &str, of: fn(&Expected) -> f64| {
        let (median, worst) = verdict.median_and_worst(of);
        let place = verdict.expected.iter().max_by(|a, b| of(a).total_cmp(&of(b))).map(|e| e.place);
        let place = place.map_or("–".to_owned(), |p| {
            let [x, y, z] = [p.x, p.y, p.z].map(|c| signed(c * 1e3, 0));
            format!("({x}, {y}, {z})")
        });
        vec![name.to_owned(), exact_mm(median), exact_mm(worst), place]
    };
    let rows = [
        row("Base frame: after the motion common to all places is taken out", relative),
        row("Camera frame: everything together", absolute),
        row("Noise of a corner in one frame", random),
    ];
    let plot = |id: &str, title: &str, of: fn(&Expected) -> f64| {
        format!("<div><h3>{title}</h3>\n{}</div>\n", figure(id, &figures::errors(&errors(of), &boards), 430, false))
    };
    format!(
        "<h2>Over the working volume</h2>\n\
         <p>Expected error at {} all over the volume that the boards filled; grey outlines are the boards. Colours \
         begin at 0 in both plots, and each has its own scale. Drag to turn.</p>\n<div \
         class=\"pair\">\n{}{}</div>\n{}{}",
        plural(verdict.expected.len(), "place"),
        plot("plot-relative", "Base frame (relative)", relative),
        plot("plot-absolute", "Camera frame (absolute)", absolute),
        table(1, &["Expected error (1σ)", "Median (mm)", "Worst (mm)", "Worst place (mm)"], &rows),
        trouble(
            "in the base frame, an end of the volume where the catheter will be much worse than the middle: no board \
             was there. The volume reaches as far as the boards; outside it nothing is promised."
        ),
    )
}

/// The corners of each board, camera frame.
fn outlines(done: &RigCalibration) -> Vec<Vec<Point3<f64>>> {
    let [low, high] = bounds(done.corners.iter().map(|corner| corner.place.coords));
    let corners = [(low.x, low.y), (high.x, low.y), (high.x, high.y), (low.x, high.y)];
    let outline = |pose: &nalgebra::Isometry3<f64>| corners.map(|(x, y)| pose * Point3::new(x, y, 0.0)).to_vec();
    done.solution.poses.iter().map(outline).collect()
}

/// The set-up of camera, mirrors, walls and boards, to scale.
fn set_up(done: &RigCalibration) -> String {
    let boards = outlines(done);
    let drawn = |id: &str, title: &str, axes, titles| {
        format!(
            "<div><h3>{title}</h3>\n{}</div>\n",
            figure(id, &set_up::drawing(done, &boards, axes, titles), 430, false)
        )
    };
    format!(
        "<h2>The set-up to scale</h2>\n<p>As it was found: the lens in the origin, each mirror and wall as far as \
         light of the boards meets it, and the way of light to the middle of each board.</p>\n<div \
         class=\"pair\">\n{}{}</div>\n{}",
        drawn("plot-above", "From above", (0, 2, 1.0), ["x, right (mm)", "z, forward (mm)"]),
        drawn("plot-side", "From the side", (2, 1, -1.0), ["z, forward (mm)", "up (mm)"]),
        trouble("anything that does not stand as it does in the laboratory.")
    )
}

fn held_out(done: &RigCalibration, held: &[Result<HeldOut, NoSolution>]) -> String {
    let good = || held.iter().flatten();
    let edges = LengthErrors::of(good().flat_map(|h| &h.edges));
    let diagonals = LengthErrors::of(good().flat_map(|h| &h.diagonals));
    let mut text = "<h2>Checked on held-out pictures</h2>\n\
         <p>Each picture was left out in turn, the rig solved from the others, and the board in the picture left out \
         measured with that rig as the tracker would. The lengths on the board are known: this check needs no model of \
         the errors.</p>\n"
        .to_owned();
    let (Some(edges), Some(diagonals)) = (edges, diagonals) else {
        return text
            + "<p class=\"note\">Without any one of its pictures the rig is open: there is nothing to check it \
                with.</p>\n";
    };
    let judged = if edges.beyond_noise() || diagonals.beyond_noise() {
        "That is more than the noise of the corners explains."
    } else if edges.below_noise() {
        "Neighbouring corners are off together: what is wrong with them is not noise."
    } else {
        "Nothing but the noise of the corners shows in them."
    };
    let scales: Vec<f64> = good().filter_map(|h| h.scale).collect();
    let scale = scales.iter().sum::<f64>() / scales.len().max(1) as f64;
    text += &format!(
        "<p>{} of {:.1} mm are off by {} RMS, {} of {:.1} mm by {}; noise alone explains {} and {}. {judged} All \
         boards together come out {} in 100 mm.</p>\n",
        plural(edges.count, "edge"),
        edges.nominal_m * 1e3,
        mm(edges.rms_m),
        plural(diagonals.count, "diagonal"),
        diagonals.nominal_m * 1e3,
        mm(diagonals.rms_m),
        mm(edges.noise_m),
        mm(diagonals.noise_m),
        match format!("{:.3} mm", scale.abs() * 100.0) {
            nothing if nothing == "0.000 mm" => "true to 0.001 mm".to_owned(),
            off => format!("{off} too {}", if scale < 0.0 { "short" } else { "long" }),
        }
    );
    text += &tables::held_out(done, held);
    text + &trouble(
        "one picture far worse than the others: its board was moved during the exposure, or bent. One sign of the \
         scale in all near pictures and the other in all far ones. <strong>Not seen here:</strong> what shifts \
         everything together, a wrong size of the squares (all boards have it), and hardly a wrong index or thickness \
         of the glass: walls give way to it.",
    )
}

fn better(verdict: &Verdict) -> String {
    let (direction, sd_m) = verdict.weakest;
    let (now_absolute, now_relative) = (verdict.median_and_worst(absolute).0, verdict.median_and_worst(relative).0);
    let rows = |list: Vec<&Suggestion>, absolute_first: bool| -> Vec<Vec<Html>> {
        let row = |name: Html, absolute_m: f64, relative_m: f64| {
            let (first, second) = if absolute_first { (absolute_m, relative_m) } else { (relative_m, absolute_m) };
            vec![name, exact_mm(first).into(), exact_mm(second).into()]
        };
        let now = row(Html::raw("<em>as it is</em>"), now_absolute, now_relative);
        let then = list.into_iter().take(SUGGESTIONS).map(|s| row(Html::from(&s.what), s.absolute_m, s.relative_m));
        std::iter::once(now).chain(then).collect()
    };
    format!(
        "<h2>What would make it better</h2>\n\
         <p>Least known is where everything together is {}: open by {}. Below, what the median errors \
         would be with one thing more, best first: a measured distance, or one picture more. Of pictures \
         with the board tilted alike, only the best is named.</p>\n\
         <h3>For the base frame</h3>\n{}<h3>For the camera frame</h3>\n{}\
         <p class=\"note\">Distances are those of a surface’s plane from the lens’s centre, along the plane’s normal; \
         give them with <code>--distance NAME=…:…</code>.</p>\n",
        along(&direction),
        mm(sd_m),
        table(1, &["With", "Base frame (mm)", "Camera frame (mm)"], &rows(verdict.helpful_relative(), false)),
        table(1, &["With", "Camera frame (mm)", "Base frame (mm)"], &rows(verdict.helpful_absolute(), true))
    )
}

fn residuals(done: &RigCalibration) -> String {
    let names = done.solution.geometry.views.iter().map(|(name, _)| name.clone());
    let views: Vec<_> = names.enumerate().map(|(view, name)| (name, diagnostics::residuals(done, view))).collect();
    let times = figures::magnification(&views.iter().map(|(_, arrows)| arrows.clone()).collect::<Vec<_>>());
    let plots: String = views
        .iter()
        .enumerate()
        .map(|(view, (name, arrows))| {
            let common = diagnostics::neighbour_correlation(arrows)
                .map_or("too few corners for means".to_owned(), |times| {
                    format!("means {times:.1} times as long as noise makes them")
                });
            let plot = figures::residuals(done, view, arrows, times);
            format!(
                "<div><h3>{}: {common}</h3>\n{}</div>\n",
                escape(name),
                figure(&format!("plot-residuals-{view}"), &plot, 470, false)
            )
        })
        .collect();
    format!(
        "<h2>What the pictures leave</h2>\n\
         <p>Residuals: from each corner, found minus where the rig puts it, all pictures of a view together, drawn \
         <strong>{times} times</strong> too long. Bold: means of neighbouring corners, as many times too long. Hover \
         for the picture.</p>\n<div class=\"pair\">\n{plots}</div>\n{}\
         <h3>Picture by picture</h3>\n{}",
        trouble(
            "bold arrows that follow one another, around the middle or towards an edge: the lens, a mirror or a wall \
             is not what the rig takes it for. Noise has short bold arrows in all directions."
        ),
        figure("plot-pictures", &figures::by_picture(done, &views), 330, false)
    ) + &trouble("one picture or one view standing above the others.")
}

fn parameters(done: &RigCalibration) -> String {
    let solution = &done.solution;
    let names: Vec<String> = solution.free.iter().map(|p| tables::short_name(&solution.geometry, *p)).collect();
    let correlations = tables::correlations(&solution.covariance);
    let mut strong: Vec<(f64, usize, usize)> = (0..names.len())
        .flat_map(|i| (0..i).map(move |j| (j, i)))
        .filter_map(|(j, i)| Some((*correlations.get((j, i))?, j, i)))
        .filter(|(r, ..)| r.abs() >= STRONG.0)
        .collect();
    strong.sort_by(|a, b| b.0.abs().total_cmp(&a.0.abs()));
    let strongest: Vec<String> = strong
        .iter()
        .take(STRONG.1)
        .filter_map(|(r, j, i)| {
            Some(format!("{} and {} ({})", escape(names.get(*j)?), escape(names.get(*i)?), signed(*r, 2)))
        })
        .collect();
    let strongest = if strongest.is_empty() {
        "No two are tied closely.".to_owned()
    } else {
        format!("Tied most closely: {}.", strongest.join(", "))
    };
    let height = 200 + 26 * names.len() as u32;
    format!(
        "<h2>The rig, and how well each part is known</h2>\n{}{}{}\
         <h3>Correlations</h3>\n\
         <p>How errors of two parameters go together: +1 always alike, −1 always opposite, 0 independent. Strong ones \
         are the rule: distances of walls and mirrors change the pictures much alike, and so do the terms of the \
         distortion. Each alone is then known badly, what matters of both together well. {strongest}</p>\n{}",
        tables::surfaces(solution),
        tables::lens(solution),
        tables::known(solution),
        figure("plot-correlations", &figures::correlations(&names, &correlations), height, false)
    )
}

fn left_out(info: &CalibrationInfo, done: &RigCalibration) -> String {
    let rows: Vec<Vec<Html>> = info
        .not_found
        .iter()
        .chain(&done.left_out)
        .map(|(name, why)| vec![Html::from(name), Html::wrapped(why)])
        .collect();
    let used = done.used.len();
    let text = if rows.is_empty() {
        format!("<p>None: all {} count.</p>\n", plural(used, "picture"))
    } else {
        format!("<p>{used} of {} count.</p>\n{}", used + rows.len(), table(2, &["Picture", "Why it does not"], &rows))
    };
    format!("<h2>Pictures left out</h2>\n{text}")
}

fn facts(info: &CalibrationInfo, done: &RigCalibration) -> String {
    let mut rows = vec![("Rig".to_owned(), info.rig.clone())];
    rows.extend(info.settings.iter().cloned());
    rows.push(("Corners".to_owned(), done.corners.len().to_string()));
    rows.push(("Version".to_owned(), format!("Catoptra {}", env!("CARGO_PKG_VERSION"))));
    format!("<h2>What was calibrated</h2>\n{}", facts_table(&rows))
}
