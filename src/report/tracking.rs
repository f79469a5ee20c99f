//! Text, numbers and plots of a tracking report.

use super::RunInfo;
use super::absences::absences;
use super::course::{Channel, Course};
use super::figures;
use super::html::{Html, escape};
use super::page::{self, facts_table, figure, signed, table, trouble};
use crate::estimate::plain_words;
use crate::plural::{are, plural};
use crate::tally::budget::{Contribution, together, together_name};
use crate::tally::{AlarmInWords, Drifted, MISSING_OF_LOG, MissCount, Tally};
use std::collections::BTreeSet;

/// The title of the page, and what is on it; `pictures` is a section of it.
pub(super) fn render(info: &RunInfo, course: &Course, tally: &Tally, pictures: &str) -> (String, String) {
    let any = tally.frames > 0;
    // The result comes first, then what is missing, then its reliability, then its origin.
    let mut body = header(info, tally);
    body += &key_figures(info, course, tally);
    if any && course.has_base() {
        body += &deflection(course);
    }
    body += &missing(info, course, tally);
    body += pictures;
    if any {
        body += &motion(course);
    }
    body += &accuracy(course, tally);
    if any {
        body += &views(course, tally);
    }
    body += &facts(info, course, tally);
    body += &page::footer("Lengths in mm, angles in degrees, times in seconds of the camera's clock.");
    (format!("Tracking of {}", info.source), body)
}

fn header(info: &RunInfo, tally: &Tally) -> String {
    let verdict = if tally.frames == 0 {
        "The source gave no frame.".to_owned()
    } else {
        let answered = match tally.complete {
            1 if tally.frames == 1 => "The only frame is answered".to_owned(),
            all if all == tally.frames => format!("All {} are answered", plural(all, "frame")),
            0 => format!("None of {} is answered completely", plural(tally.frames, "frame")),
            some => format!("{some} of {} are answered completely", plural(tally.frames, "frame")),
        };
        let lost = match tally.lost {
            0 => "none was lost".to_owned(),
            n if info.of_log => {
                format!("{} missing in {}: {MISSING_OF_LOG}", are(n, "frame"), plural(tally.gaps, "gap"))
            }
            1 => "1 more frame was lost".to_owned(),
            n => format!("{n} more frames were lost in {}", plural(tally.gaps, "gap")),
        };
        let angle = match (tally.theta.range_deg, tally.theta.median_sd_deg()) {
            (Some((low, high)), Some(sd)) => {
                format!(
                    " The deflection θ goes from {} to {}, with a median σ of {sd:.2}°.",
                    degrees(low),
                    degrees(high)
                )
            }
            _ => String::new(),
        };
        let mut moved = String::new();
        for (base, now, before) in [
            (false, "The views do not fit together", "The views did not fit together for some time"),
            (true, "The base band is not where it was", "The base band was not where it was for some time"),
        ] {
            let mut newest_first = tally.drift.alarms().iter().rev();
            if let Some(last) = newest_first.find(|alarm| matches!(alarm.what, Drifted::Base { .. }) == base) {
                let words = if last.over.is_none() { now } else { before };
                moved += &format!(" <strong>{words}: see Residuals.</strong>");
            }
        }
        format!("{answered}; {lost}.{angle}{moved}")
    };
    format!(
        "<header>\n<p class=\"kind\">Catoptra tracking report</p>\n<h1>{}</h1>\n<p \
         class=\"verdict\">{verdict}</p>\n</header>\n",
        escape(&info.source)
    )
}

fn key_figures(info: &RunInfo, course: &Course, tally: &Tally) -> String {
    let mut cards = String::new();
    let mut card = |name: &str, value: String, unit: &str, warn: bool| cards += &page::card(name, value, unit, warn);
    card("Frames", tally.frames.to_string(), "", false);
    card(
        "Answered completely",
        tally.complete.to_string(),
        &share(tally.complete, tally.frames),
        tally.complete < tally.frames,
    );
    let gaps = if tally.lost > 0 { format!("in {}", plural(tally.gaps, "gap")) } else { String::new() };
    let lost = if info.of_log { "Missing" } else { "Lost" };
    card(lost, tally.lost.to_string(), &gaps, tally.lost > 0);
    if course.has_base() {
        let sd = tally.theta.median_sd_deg().map_or("–".to_owned(), |sd| format!("{sd:.3}°"));
        card("Median σ of θ", sd, "", false);
    }
    format!("<dl class=\"key\">\n{cards}</dl>\n")
}

fn facts(info: &RunInfo, course: &Course, tally: &Tally) -> String {
    let mut rows = vec![("Source".to_owned(), info.source.clone()), ("Rig".to_owned(), info.rig.clone())];
    if tally.frames > 0 {
        let counted = if tally.lost > 0 { " with those lost counted" } else { "" };
        let rate = tally.rate_hz().map_or(String::new(), |hz| format!(", {hz:.2} frames per second{counted}"));
        rows.push(("Duration".to_owned(), format!("{:.3} s{rate}", tally.duration_s())));
        let origin = course.origin().filter(|o| o.ns != 0);
        let zero = origin.map_or(String::new(), |o| format!("; 0 s on this page is {} ns of it", o.ns));
        rows.push(("Clock".to_owned(), format!("{}{zero}", tally.clock)));
    }
    rows.push(("Positions in".to_owned(), format!("the {} frame", frame_name(course))));
    rows.extend(info.settings.iter().cloned());
    rows.push(("Version".to_owned(), format!("Catoptra {}", env!("CARGO_PKG_VERSION"))));
    format!("<h2>What was tracked</h2>\n{}", facts_table(&rows))
}

fn accuracy(course: &Course, tally: &Tally) -> String {
    let markers = course.marker_names.iter().zip(&tally.markers);
    let mut quantities: Vec<Vec<String>> =
        markers.map(|(name, m)| row(name, " mm", m.answered, tally, m.median_sd_mm())).collect();
    quantities.push(row("coil tangent", "°", tally.tangent.answered, tally, tally.tangent.median_sd_deg()));
    if course.has_base() {
        quantities.push(row("θ", "°", tally.theta.answered, tally, tally.theta.median_sd_deg()));
    }
    let mut views = Vec::new();
    for (name, marker) in course.marker_names.iter().zip(&tally.markers) {
        for (view_name, view) in course.view_names.iter().zip(&marker.views) {
            let mean = view.mean_px().map_or("–".to_owned(), |[u, v]| format!("{}, {}", signed(u, 3), signed(v, 3)));
            views.push(vec![
                format!("{name} in {view_name}"),
                view.seen.to_string(),
                share(view.seen, tally.frames),
                number(view.rms_px(), 3),
                mean,
                number(view.mean_separation(), 2),
                number(view.least_separation, 2),
                number(view.mean_width(), 2),
            ]);
        }
    }
    let budget = tally.budget().map_or(String::new(), |sources| error_budget(&sources));
    format!(
        "<h2>How well</h2>\n{budget}\
         <p>σ is the standard deviation that the tracker predicts for its own answer: of one coordinate for a marker, \
         of one direction across for the tangent.</p>\n{}\
         <p>Each view on its own: the residual is where the band is seen minus where the common answer of all views \
         projects to. The RMS is of one pixel coordinate. Bands that stand close together are fitted as one piece of \
         tube and have one residual between them. The width is over that of a tube of the rig's diameter.</p>\n{}{}",
        table(1, &["Quantity", "Frames answered", "Share", "Median σ"], &quantities),
        table(
            1,
            &[
                "Marker in view",
                "Frames seen",
                "Share",
                "Residual RMS (px)",
                "Mean u, v (px)",
                "Separation, mean",
                "smallest",
                "Width"
            ],
            &views
        ),
        trouble(
            "a mean far from zero beside a small RMS: then the views contradict each other, and the rig or the \
             refraction is off, not the noise."
        ),
    )
}

/// The contribution of each source of error.
fn error_budget(sources: &[Contribution]) -> String {
    let line = |name: &str, (theta_rad, tip_m): (f64, f64)| {
        vec![name.to_owned(), format!("{:.4}", theta_rad.to_degrees()), format!("{:.4}", tip_m * 1e3)]
    };
    let unknown = |name: &str, why: &str| vec![format!("{name}: not known, {}", escape(why)), "–".into(), "–".into()];
    let row = |source: &Contribution| match &source.share {
        Ok(share) => line(source.name, *share),
        Err(why) => unknown(source.name, why),
    };
    let mut rows: Vec<Vec<String>> = sources.iter().map(row).collect();
    rows.push(line(together_name(sources), together(sources)));
    format!(
        "<p>The error budget, 1σ, typical of this run. Noise averages out over frames, the rest is there in all of \
         them alike; what time stamps add matters to dynamics only.</p>\n{}",
        table(1, &["Source of error", "θ (°)", "Tip, a coordinate in the base frame (mm)"], &rows)
    )
}

fn row(name: &str, unit: &str, answered: u64, tally: &Tally, sd: Option<f64>) -> Vec<String> {
    let sd = sd.map_or("–".to_owned(), |sd| format!("{sd:.4}{unit}"));
    vec![name.to_owned(), answered.to_string(), share(answered, tally.frames), sd]
}

fn missing(info: &RunInfo, course: &Course, tally: &Tally) -> String {
    let mut text = "<h2>What is missing</h2>\n".to_owned();
    if !course.has_base() {
        text += "<p>The rig has no base frame yet, so there is no deflection angle in this run: positions and the \
                 tangent are in the camera frame.</p>\n";
    }
    let misses = tally.misses();
    if misses.is_empty() && tally.lost == 0 {
        return match tally.frames {
            0 => text + "<p>No frame arrived: nothing to answer.</p>\n",
            _ => text + "<p>Nothing: every frame of the camera arrived and every one is answered.</p>\n",
        };
    }
    let row = |miss: &&MissCount| {
        let MissCount { what, reason, frames } = miss;
        vec![what.clone(), plain_words(reason), frames.to_string(), share(*frames, tally.frames)]
    };
    let mut rows: Vec<Vec<String>> = misses.iter().map(row).collect();
    if tally.lost > 0 {
        let share = share(tally.lost, tally.frames + tally.lost);
        let why = if info.of_log { MISSING_OF_LOG } else { "lost" };
        rows.push(vec!["whole frames".into(), why.into(), tally.lost.to_string(), share]);
    }
    text += &table(2, &["What", "Why", "Frames", "Share"], &rows);
    if tally.frames == 0 {
        return text;
    }
    let height = 90 + 30 * (course.reasons.len() as u32 + 1);
    let (lost, grey) = match info.of_log {
        true => ("missing", MISSING_OF_LOG),
        false => ("lost", "that never arrived"),
    };
    text += &format!(
        "<p>When: one row for each reason. Grey bars are frames {grey}, from the last frame before to the first \
         after.</p>\n"
    );
    text += &figure("plot-misses", &absences(course, time_title(course), lost), height, true);
    text + &trouble(
        "misses in rows one below the other at the same angle of every swing: the catheter then leaves a view or is \
         covered there. Grey bars at regular intervals: the recording computer cannot keep up.",
    )
}

/// θ over time.
fn deflection(course: &Course) -> String {
    let words = format!(
        "θ is the angle of the coil's tangent from rest, in the plane of B0, positive towards B0. The shaded band is θ \
         ± σ; where it is thinner than the line, read σ below. Drag to zoom, double-click to go back: all plots over \
         time follow. {}",
        drawing_note(course)
    );
    let plot = drawn(course, Channel::Theta, "plot-theta", 430, figures::deflection);
    section(
        "Deflection",
        &words,
        &plot,
        "steps between neighbouring frames much larger than σ; σ that grows with the angle more than a little; breaks \
         in the line.",
    )
}

/// Motion of the markers and the tangent.
fn motion(course: &Course) -> String {
    let plot = match course.path.places_mm.iter().any(|p| p.iter().any(Option::is_some)) {
        true => figure("plot-paths", &figures::paths(course), 620, false),
        false => nothing(),
    };
    let kept = match course.path.every {
        0 | 1 => "Every frame is drawn.".to_owned(),
        n => format!("One frame in {n} is drawn."),
    };
    let words = format!(
        "Where the markers went, in the {} frame, all axes to the same scale. Drag to turn, scroll to come nearer; a \
         click on a name hides it. Thin grey lines join the markers at some moments; they are chords, the tube itself \
         is curved. {kept}",
        frame_name(course)
    );
    let mut out = section(
        "Paths in space",
        &words,
        &plot,
        "single points far from the path; a base marker that moves with the others by more than its σ: the clamp is \
         loose, or the rig is off.",
    );
    if course.has_base() {
        let plot = drawn(course, Channel::Polar, "plot-polar", 400, figures::polar);
        out += &section(
            "Polar and azimuth",
            "The same tangent as a direction in space: polar is its angle from rest, azimuth the direction it leans \
             to, 0° along B0 and 90° along y. Near rest the azimuth has no meaning and jumps. It is drawn from −90° to \
             270°: there 180° has no seam.",
            &plot,
            "in a planar motion, an azimuth that strays from 0° and 180° while the polar angle is large: the catheter \
             leaves the plane, or B0 is not where the rig says.",
        );
    }
    out
}

/// Results of each view over time.
fn views(course: &Course, tally: &Tally) -> String {
    let time = time_title(course);
    let each =
        |kind: &str, of: fn(usize, usize) -> Channel, draw: fn(&Course, usize, &str) -> plotly::Plot| -> String {
            let views = course.view_names.iter().enumerate();
            views
                .map(|(view, name)| {
                    let mut markers = 0..course.marker_names.len();
                    let plot = match markers.any(|marker| course.extremes(of(marker, view)).any(|e| e.is_some())) {
                        true => figure(&format!("plot-{kind}-{view}"), &draw(course, view, time), 250, true),
                        false => nothing(),
                    };
                    format!("<h3>{} view</h3>\n{plot}", escape(name))
                })
                .collect()
        };
    section(
        "Residuals",
        "By how many pixels each view disagrees with the common answer of all views (length of the residual). Bands \
         that are fitted together, as coil and tip, have one residual: their points coincide.",
        &(alarms(course, tally)
            + &each("residual", |marker, view| Channel::Residual { marker, view }, figures::residuals)),
        "one marker standing above the others in one view, or residuals that follow the motion: an error of the rig, \
         of the tube's measures or of the refraction. A few high frames are noise or a reflection.",
    ) + &section(
        "Colour separation",
        "How well a band's colour stands out from what surrounds it: 1 as when its colour was learned, 0 \
         indistinguishable.",
        &each("separation", |marker, view| Channel::Separation { marker, view }, figures::separation),
        "a slow fall: the light changes or the water clouds. Dips at some angles: shadow or glare. Below about 0.5 \
         misses begin.",
    )
}

/// Drift alarms: when the rig was no longer as calibrated, and what to do.
fn alarms(course: &Course, tally: &Tally) -> String {
    let alarms: Vec<AlarmInWords> = tally.alarms().collect();
    if alarms.is_empty() {
        let views = match tally.drift.views_limit_px() {
            Some(px) => format!("The views fit together: no mean disagreement of more than {px:.1} px at any time."),
            None => "Whether the views fit together was not judged: no frame shows bands in two of them.".to_owned(),
        };
        let base = match (course.has_base(), tally.drift.base_limit_m()) {
            (_, Some(limit_m)) => format!(
                "The base band rests where the base frame has its origin, within {:.1} mm in the mean.",
                limit_m * 1e3
            ),
            (true, None) => "Whether the base band rests where the base frame has its origin was not judged: no frame \
                             shows it, or the first band is not one that rests."
                .to_owned(),
            (false, None) => {
                "(A mirror that was shifted along its normal can go unnoticed here: it moves the answer, not \
                 the residual. With a base frame in the rig the place of the base band shows it.)"
                    .to_owned()
            }
        };
        return format!("<p>{views} {base}</p>\n");
    }
    let row = |alarm: &AlarmInWords| {
        let at = |ns: i64| format!("{:.3} s", course.origin().map_or(0.0, |origin| origin.elapsed_s(ns)));
        let until = alarm.over_ns.map_or("the end".to_owned(), at);
        vec![Html::from(at(alarm.ns)), Html::with_code(&alarm.what), Html::from(until)]
    };
    let rows: Vec<Vec<Html>> = alarms.iter().map(row).collect();
    let advice: BTreeSet<&str> = alarms.iter().map(|alarm| alarm.advice).collect();
    let advice = advice.into_iter().map(|advice| {
        let words = Html::with_code(advice);
        format!("<p class=\"advice\">Places are off by more than their σ: {words}.</p>\n")
    });
    table(3, &["From", "What", "Until"], &rows) + &advice.collect::<String>()
}

fn section(title: &str, words: &str, plots: &str, signs: &str) -> String {
    format!("<h2>{title}</h2>\n<p>{words}</p>\n{plots}{}", trouble(signs))
}

/// A plot over time, if its channel has data.
fn drawn(
    course: &Course,
    channel: Channel,
    id: &str,
    height: u32,
    draw: impl Fn(&Course, &str) -> plotly::Plot,
) -> String {
    match course.extremes(channel).any(|e| e.is_some()) {
        true => figure(id, &draw(course, time_title(course)), height, true),
        false => nothing(),
    }
}

/// The name of the time axis.
fn time_title(course: &Course) -> &'static str {
    if course.origin().is_some_and(|o| o.ns != 0) { "time since the first frame (s)" } else { "camera time (s)" }
}

/// A note on how much of the data the curves show.
fn drawing_note(course: &Course) -> String {
    match course.timeline.frames_per_bin() {
        1 => "Every frame is drawn.".to_owned(),
        n => format!(
            "The run is long: curves pass through the smallest and the largest value of every {n} frames, so that no \
             peak is lost. Every single frame is in the log and the table."
        ),
    }
}

fn nothing() -> String {
    "<p class=\"note\">Nothing to draw: no frame has this answer.</p>\n".to_owned()
}

fn frame_name(course: &Course) -> &'static str {
    if course.in_base_frame() { "base" } else { "camera" }
}

fn share(part: u64, whole: u64) -> String {
    if whole == 0 { "–".to_owned() } else { format!("{:.1} %", 100.0 * part as f64 / whole as f64) }
}

fn number(value: Option<f64>, digits: usize) -> String {
    value.filter(|v| v.is_finite()).map_or("–".to_owned(), |v| format!("{v:.digits$}"))
}

fn degrees(value: f64) -> String {
    format!("{}°", signed(value, 1))
}
