//! The page of a validation: errors and response of runs along a desired path, as in Section IV of the paper.
//!
//! In: the evaluated runs. Out: one HTML file that needs no network.

mod figures;

use super::html::{Html, escape};
use super::page::{self, card, facts_table, figure, signed, table, trouble};
use crate::plural::plural;
use crate::source::times::seconds;
use crate::validate::{Row, Run, Size, Validation};

/// Information besides the runs: name and value, for example options of the command.
pub(crate) type Settings = Vec<(String, String)>;

/// The response of a model, to compare with the runs.
pub(crate) struct ModelLine {
    /// For the legend.
    pub(crate) name: String,
    /// Frequency in Hz, magnitude in dB, phase in degrees, rising frequencies.
    pub(crate) points: Vec<(f64, f64, f64)>,
}

impl ModelLine {
    /// Points of the line.
    const POINTS: usize = 120;
    /// Factor by which it extends beyond the runs.
    const BEYOND: f64 = 1.5;

    /// `response` over the frequencies of the runs and a little beyond, its magnitude shifted to match the slowest run:
    /// the runs' magnitude is relative to the path and does not have the model's unit.
    pub(crate) fn of(
        name: String,
        validation: &Validation,
        response: impl Fn(f64) -> Option<nalgebra::Complex<f64>>,
    ) -> Self {
        let of_runs = || validation.runs.iter().map(|run| run.frequency_hz);
        let (low, high) = (of_runs().fold(f64::INFINITY, f64::min), of_runs().fold(0.0, f64::max));
        let (low, high) = (low / Self::BEYOND, high * Self::BEYOND);
        let db = |f: f64| response(f).map(|r| 20.0 * r.norm().log10());
        let slowest = validation.runs.last();
        let moved = slowest.and_then(|run| Some(run.magnitude?.db - db(run.frequency_hz)?)).unwrap_or(0.0);
        let mut last = 0.0_f64;
        let at = |k: usize| {
            let f = low * (high / low).powf(k as f64 / (Self::POINTS - 1) as f64);
            // Unwrapped from the lowest frequency.
            let phase = response(f)?.arg().to_degrees();
            last = phase + 360.0 * ((last - phase) / 360.0).round();
            Some((f, db(f)? + moved, last))
        };
        Self { name, points: (0..Self::POINTS).map_while(at).collect() }
    }
}

/// Drop that defines the bandwidth, dB.
const DROP_DB: f64 = -3.0;

/// The whole page.
pub(crate) fn page(validation: &Validation, settings: &Settings, model: Option<&ModelLine>) -> String {
    let mut body = header(validation);
    body += &cards(validation);
    body += &errors(validation);
    body += &response(validation, model);
    body += &paths(validation);
    body += &frames(validation);
    body += &facts(validation, settings);
    body += &page::footer(
        "Errors are root mean squares of distances in space, base frame. Phase is negative for a response that is \
         late.",
    );
    page::page(&format!("Validation along {}", validation.name()), &body)
}

/// Where the magnitude is 3 dB below that of the slowest run, Hz: interpolated between two runs over the logarithm of
/// frequency. `None` when it does not fall that far.
pub(crate) fn bandwidth_hz(validation: &Validation) -> Option<f64> {
    // The motion along any other path has several frequencies, and no response at a single one.
    validation.path.circle?;
    let points: Vec<(f64, f64)> =
        validation.runs.iter().rev().filter_map(|run| Some((run.frequency_hz.ln(), run.magnitude?.db))).collect();
    let limit = points.first()?.1 + DROP_DB;
    points.iter().zip(points.iter().skip(1)).find(|(a, b)| a.1 >= limit && b.1 < limit).map(|(a, b)| {
        let part = (a.1 - limit) / (a.1 - b.1);
        (a.0 + part * (b.0 - a.0)).exp()
    })
}

fn mm(m: f64) -> String {
    format!("{:.2} mm", m * 1e3)
}

/// A value with this many digits, a dash without one.
fn number_or_dash(value: Option<f64>, digits: usize) -> String {
    value.map_or_else(|| "–".to_owned(), |value| format!("{value:.digits$}"))
}

/// The same with a sign.
fn with_sign(value: Option<f64>, digits: usize) -> String {
    value.map_or_else(|| "–".to_owned(), |value| signed(value, digits))
}

fn pause(run: &Run) -> String {
    format!("{} ms", short(run.pause_s * 1e3))
}

/// As many digits as needed, at most three decimals.
fn short(value: f64) -> String {
    ((value * 1e3).round() / 1e3).to_string()
}

fn header(validation: &Validation) -> String {
    let aligned = validation.runs.iter().map(|run| run.alignment.rms_m);
    let (low, high) = aligned.fold((f64::INFINITY, 0.0), |(low, high): (f64, f64), m| (low.min(m), high.max(m)));
    let unaligned = validation.runs.iter().fold(0.0, |high: f64, run| high.max(run.rms_unaligned_m));
    let spread = if validation.runs.len() == 1 { mm(low) } else { format!("{} to {}", mm(low), mm(high)) };
    let response = match bandwidth_hz(validation) {
        Some(hz) => format!(" The response falls 3 dB below that of the slowest run at {hz:.2} Hz."),
        None if validation.path.circle.is_none() => {
            " There is no bandwidth: the path is not a circle, so its motion has several frequencies.".to_owned()
        }
        None if validation.runs.len() > 1 => {
            " The response does not fall 3 dB below that of the slowest run.".to_owned()
        }
        None => String::new(),
    };
    format!(
        "<header>\n<p class=\"kind\">Catoptra validation</p>\n<h1>{}</h1>\n<p class=\"verdict\">{} along the path: \
         {spread} from it after rigid alignment, up to {} without.{response}</p>\n</header>\n",
        escape(&validation.name()),
        plural(validation.runs.len(), "run"),
        mm(unaligned)
    )
}

fn cards(validation: &Validation) -> String {
    let mut cards = String::new();
    if let (Some(fastest), Some(slowest)) = (validation.runs.first(), validation.runs.last()) {
        let mut of = |name: &str, run: &Run| {
            let magnitude = with_sign(run.magnitude.map(|m| m.db), 2);
            let phase = with_sign(run.phase_deg, 1);
            let words = format!("{magnitude} dB, {phase}° at {} Hz", short(run.frequency_hz));
            cards += &card(format!("{name}, {}", pause(run)), mm(run.alignment.rms_m), words, false);
        };
        of("Slowest", slowest);
        if validation.runs.len() > 1 {
            of("Fastest", fastest);
            let (value, words) = match bandwidth_hz(validation) {
                Some(hz) => (format!("{hz:.2} Hz"), "3 dB below the slowest run"),
                None if validation.path.circle.is_none() => ("–".to_owned(), "the path is not a circle"),
                None => ("–".to_owned(), "does not fall by 3 dB"),
            };
            cards += &card("Bandwidth", value, words, false);
        }
    }
    let (points, left_out) = validation.runs.iter().fold((0, 0), |(p, l), run| (p + run.steps.len(), l + run.left_out));
    cards += &card("Points left out", left_out.to_string(), format!("of {points}"), 10 * left_out > points);
    format!("<dl class=\"key\">\n{cards}</dl>\n")
}

fn errors(validation: &Validation) -> String {
    let rows: Vec<Vec<String>> = validation
        .runs
        .iter()
        .map(|run| {
            let row = Row::of(run);
            vec![
                pause(run),
                format!("{:.3}", row.rms_aligned_mm),
                format!("{:.3}", row.rms_unaligned_mm),
                format!("{:.1}", row.rotation_deg),
                format!("{:.2}", row.offset_x_mm.hypot(row.offset_y_mm).hypot(row.offset_z_mm)),
                [row.gain_x, row.gain_y, row.gain_z].map(|g| number_or_dash(g, 3)).join(", "),
                number_or_dash(row.tangent_rms_deg, 2),
            ]
        })
        .collect();
    let heads = [
        "Pause",
        "RMS aligned (mm)",
        "RMS as observed (mm)",
        "Rotation (°)",
        "Offset (mm)",
        "Gain x, y, z",
        "Tangent RMS (°)",
    ];
    let of = validation.path.periods;
    let left_out = match validation.options.skip {
        0 if of == 1 => "The only period counts.".to_owned(),
        0 => format!("All {of} periods count."),
        1 => format!("The first of {of} periods is left out, while the motion settles."),
        n => format!("The first {n} of {of} periods are left out, while the motion settles."),
    };
    format!(
        "<h2>Errors</h2>\n<p>Distance of the marker from the path. Aligned: the observed path may be moved and turned \
         as a whole, but not scaled, until it fits best. Rotation and offset are those of this alignment. \
         {left_out}</p>\n{}{}{}<h3>Error over the path, aligned</h3>\n{}",
        table(1, &heads, &rows),
        figure("plot-rms", &figures::rms_over_pause(validation), 340, false),
        trouble(
            "an aligned error that stays small while the other one and the rotation grow with speed: on a circle, a \
             lag looks like a turn, and alignment takes it out. The phase below has it."
        ),
        figure("plot-errors", &figures::errors(validation), 340, false)
    )
}

fn response(validation: &Validation, model: Option<&ModelLine>) -> String {
    let what = match validation.path.circle {
        Some(circle) => format!(
            "radius of the circle fitted to the observed points over {:.3} mm, that of the path (Eq. 8)",
            circle.radius_m * 1e3
        ),
        None => {
            "the path is not a circle: root mean square distance of the observed points from their mean, over that of \
            the path"
                .to_owned()
        }
    };
    let rows: Vec<Vec<String>> = validation
        .runs
        .iter()
        .map(|run| {
            let row = Row::of(run);
            vec![
                pause(run),
                short(row.frequency_hz),
                with_sign(row.magnitude_db, 3),
                with_sign(row.phase_deg, 2),
                with_sign(row.lag_ms, 1),
                number_or_dash(row.correlation, 4),
                number_or_dash(row.observed_size_mm, 3),
                number_or_dash(row.circle_rms_mm, 3),
                number_or_dash(row.plane_rms_mm, 3),
            ]
        })
        .collect();
    let size = if validation.runs.iter().any(|run| run.magnitude.is_some_and(|m| m.of == Size::CircleRadius)) {
        "Radius (mm)"
    } else {
        "Size (mm)"
    };
    let beside = model.map_or_else(String::new, |model| {
        format!(
            " Dashed: {}, its magnitude moved to that of the slowest run; its phase is its own.",
            escape(&model.name)
        )
    });
    let heads = [
        "Pause",
        "Freq. (Hz)",
        "Magnitude (dB)",
        "Phase (°)",
        "Lag (ms)",
        "Correlation",
        size,
        "Off circle (mm)",
        "Off plane (mm)",
    ];
    format!(
        "<h2>Response</h2>\n<p>Magnitude: {what}. Phase: from the lag at which the observed motion, not aligned, \
         correlates best with the path; negative is late (Eqs. 9 and 10). Frequency is 1 over the period of {} \
         points.{}</p>\n{}{}{}",
        validation.path.points.len(),
        beside,
        figure("plot-magnitude", &figures::magnitude(validation, model), 300, true),
        figure("plot-phase", &figures::phase(validation, model), 300, true),
        table(1, &heads, &rows)
    )
}

fn paths(validation: &Validation) -> String {
    let mut text = format!(
        "<h2>Paths</h2>\n<p>The thick line is the path. Choose runs by a click on their names.</p>\n<div \
         class=\"pair\">\n<div><h3>As observed</h3>\n{}</div>\n<div><h3>Aligned</h3>\n{}</div>\n</div>\n",
        figure("plot-observed", &figures::space(validation, false), 480, false),
        figure("plot-aligned", &figures::space(validation, true), 480, false)
    );
    if validation.path.circle.is_some() {
        text += &format!(
            "<h3>Circles, each in its own plane and around its own centre</h3>\n{}",
            figure("plot-circles", &figures::circles(validation), 620, false)
        );
    }
    text += "<h3>Run by run, aligned, in the plane of the path</h3>\n<div class=\"pair\">\n";
    for (index, run) in validation.runs.iter().enumerate() {
        let plot = figures::one_run(validation, index, run);
        text += &format!(
            "<div><h3>{}, {} Hz: {}</h3>\n{}</div>\n",
            pause(run),
            short(run.frequency_hz),
            mm(run.alignment.rms_m),
            figure(&format!("plot-run-{index}"), &plot, 330, false)
        );
    }
    text + "</div>\n"
}

fn frames(validation: &Validation) -> String {
    let rows: Vec<Vec<Html>> = validation
        .runs
        .iter()
        .map(|run| {
            let row = Row::of(run);
            let start = match row.start_from {
                "given" => "given",
                "currents" => "by currents",
                "ticks" => "by ticks",
                _ => "by correlation",
            };
            vec![
                Html::from(pause(run)),
                Html::wrapped(&row.file),
                format!("{:.3} s, {start}", seconds(run.start_ns)).into(),
                row.points_are.into(),
                row.frames.to_string().into(),
                format!("{} + {}", row.frames_missed, row.frames_lost).into(),
                format!("{} of {}", row.points_left_out, row.points).into(),
                number_or_dash(row.scatter_mm, 3).into(),
                number_or_dash(row.sd_mm, 3).into(),
            ]
        })
        .collect();
    let heads = [
        "Pause",
        "File",
        "First command",
        "Points are",
        "Frames",
        "Missed + lost",
        "Left out",
        "Scatter (mm)",
        "σ (mm)",
    ];
    let of_path = validation.path.note().map(|note| format!("<li>path: {}</li>\n", escape(&note)));
    let of_runs = validation
        .runs
        .iter()
        .flat_map(|run| run.notes.iter().map(move |note| format!("<li>{}: {}</li>\n", pause(run), escape(note))));
    let notes: String = of_path.into_iter().chain(of_runs).collect();
    let notes = if notes.is_empty() { notes } else { format!("<ul class=\"note\">\n{notes}</ul>\n") };
    format!(
        "<h2>Frames</h2>\n<p>Missed: frames without the marker's place; lost: by the camera. Scatter: distance of \
         frames from the mean of their pause, noise and motion together; σ: the tracker's own. Points are the mean of \
         the frames within a pause; where the pause is shorter than the time between frames, they are interpolated to \
         its middle. A command without a frame is left out, nothing is made up.</p>\n{}{notes}",
        table(4, &heads, &rows)
    )
}

fn facts(validation: &Validation, settings: &Settings) -> String {
    let path = &validation.path;
    let mut rows = vec![
        ("Path".to_owned(), path.file.display().to_string()),
        ("Marker".to_owned(), validation.runs.first().map_or_else(String::new, |run| run.marker.clone())),
        ("Points".to_owned(), format!("{} per period, {}", path.points.len(), plural(path.periods, "period"))),
    ];
    rows.extend(settings.iter().cloned());
    rows.push(("Version".to_owned(), format!("Catoptra {}", env!("CARGO_PKG_VERSION"))));
    format!("<h2>What was compared</h2>\n{}", facts_table(&rows))
}
