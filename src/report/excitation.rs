//! The page of a signal that excites the catheter: its course and its spectrum.
//!
//! In: the signal as it will be played, within the limits. Out: one HTML file that needs no network.

use super::chart::{self, CURVE, PALETTE, QUIET, css, css_faint, rounded};
use super::html::escape;
use super::page::{self, card, facts_table, figure, table};
use super::timeline::Timeline;
use crate::excite::{Change, Clipped, Signal, Spectrum};
use crate::plural::plural;
use plotly::common::{DashType, Line, Mode};
use plotly::layout::{AxisType, HoverMode, Shape, ShapeLayer, ShapeLine, ShapeType};
use plotly::{Plot, Scatter};

/// Points of a spectrum, evenly spaced on a logarithmic scale.
const POINTS: f64 = 700.0;
/// Range of the spectrum below its maximum, powers of ten.
const DEPTH: f64 = 10.0;

/// Information besides the signal.
#[derive(Debug, Clone, Default)]
pub(crate) struct ExcitationInfo {
    /// The table the signal is in.
    pub table: String,
    /// What it is: `chirp`, `multisine`, `steps`.
    pub kind: String,
    /// The requested band, Hz, if any.
    pub band_hz: Option<(f64, f64)>,
    /// Further lines: name and value.
    pub settings: Vec<(String, String)>,
}

/// Fractions of the energy: a band in words, and the fraction in it.
pub(crate) fn shares(spectrum: &Spectrum, band_hz: Option<(f64, f64)>) -> Vec<(String, f64)> {
    let nyquist_hz = spectrum.step_hz * (spectrum.power_a2.len().saturating_sub(1)) as f64;
    let (from, to) = band_hz.map_or_else(|| spectrum.occupied_hz(), |(a, b)| (a.min(b), a.max(b)));
    let step = spectrum.step_hz;
    let below = if from >= step { spectrum.share(0.0, from - step) } else { 0.0 };
    vec![
        (format!("below {from:.3} Hz"), below),
        (format!("{from:.3} to {to:.3} Hz"), spectrum.share(from, to)),
        (format!("above, up to {nyquist_hz:.2} Hz"), spectrum.share(to + step, nyquist_hz)),
    ]
}

/// The clipping, in words.
pub(crate) fn clipped_words(clipped: &Clipped) -> String {
    let Clipped { what, samples, first_s, last_s, largest_a } = clipped;
    let limit = match what {
        Change::Current => "limit of current",
        Change::Slew => "limit of slew",
    };
    format!(
        "{limit}: {} changed, from {first_s:.3} s to {last_s:.3} s, by up to {:.1} mA",
        plural(*samples, "sample"),
        largest_a * 1e3
    )
}

/// The whole page.
pub(crate) fn page(info: &ExcitationInfo, signal: &Signal, spectrum: &Spectrum, clipped: &[Clipped]) -> String {
    let (slew, slew_s) = signal.largest_slew();
    let mut body = format!(
        "<header>\n<p class=\"kind\">Catoptra excitation: {}</p>\n<h1>{}</h1>\n</header>\n",
        escape(&info.kind),
        escape(&info.table)
    );
    let inside = shares(spectrum, info.band_hz);
    let band = inside.get(1).map_or((String::new(), 0.0), Clone::clone);
    let cards = [
        card("Peak", format!("{:.1} mA", signal.peak_a() * 1e3), format!("RMS {:.1} mA", signal.rms_a() * 1e3), false),
        card("Crest factor", format!("{:.2}", signal.crest_factor()), "peak over RMS", false),
        card("Largest slew", format!("{slew:.2} A/s"), format!("at {slew_s:.2} s"), false),
        card("Energy in the band", format!("{:.1} %", band.1 * 100.0), &band.0, false),
    ];
    body += &format!("<dl class=\"key\">\n{}</dl>\n", cards.concat());
    if !clipped.is_empty() {
        let changes: String = clipped.iter().map(|c| format!("<li>{}</li>\n", escape(&clipped_words(c)))).collect();
        body += &format!(
            "<div class=\"doubts\"><p><strong>Cut off</strong> to keep the limits:</p>\n<ul>\n{changes}</ul></div>\n"
        );
    }
    body += "<h2>Current over time</h2>\n<p>Each value is held until the next. After the last one the current is \
        zero.</p>\n";
    body += &figure("plot-current", &course(signal), 340, false);
    body += "<h2>Spectrum</h2>\n<p>Mean square of the samples, for each hertz of bandwidth. Grey: the band. The dotted \
             line is half of the rate: nothing can be excited beyond it.</p>\n";
    body += &figure("plot-spectrum", &density(info, signal, spectrum), 360, false);
    let rows: Vec<Vec<String>> =
        inside.iter().map(|(band, share)| vec![band.clone(), format!("{:.2} %", share * 100.0)]).collect();
    body += &table(1, &["Frequencies", "Share of the energy"], &rows);
    let mut facts = vec![
        ("Length".to_owned(), format!("{} s, {} samples", signal.duration_s(), signal.values_a.len())),
        ("Rate".to_owned(), format!("{} samples per second", signal.rate)),
    ];
    facts.extend(info.settings.iter().cloned());
    body += &format!("<h2>What was made</h2>\n{}", facts_table(&facts));
    body += &page::footer("");
    page::page(&format!("{}: {}", info.kind, info.table), &body)
}

fn course(signal: &Signal) -> Plot {
    let mut line = Timeline::default();
    for (k, value) in signal.values_a.iter().chain(std::iter::once(&0.0)).enumerate() {
        line.push(signal.time_s(k), 0, &[Some(value * 1e3)], &[]);
    }
    let values = line.bins().iter().map(|bin| bin.channels.first().copied().flatten());
    let layout = chart::layout()
        .x_axis(chart::time_axis("Time (s)", line.bins()))
        .y_axis(chart::value_axis("Current (mA)"))
        .show_legend(false);
    let mut plot = chart::plot(layout);
    plot.add_trace(chart::line(chart::curve(line.bins(), values, 3), "current", CURVE, 1.2, "%{y:.2f} mA"));
    plot
}

/// Frequency and power of each line, A².
fn each_line(spectrum: &Spectrum) -> Vec<(f64, f64)> {
    spectrum.power_a2.iter().enumerate().skip(1).map(|(k, power)| (k as f64 * spectrum.step_hz, *power)).collect()
}

/// Frequency and spectral density, A²/Hz; lines that coincide on a logarithmic axis are averaged.
fn averaged(spectrum: &Spectrum, nyquist_hz: f64) -> Vec<(f64, f64)> {
    let decades = (nyquist_hz / spectrum.step_hz).log10().max(1.0);
    let bin = |hz: f64| (hz.log10() * POINTS / decades).floor();
    let mut points: Vec<(f64, f64, f64, f64)> = Vec::new();
    for (hz, power) in each_line(spectrum) {
        match points.last_mut() {
            Some((sum_hz, sum, count, number)) if *number == bin(hz) => {
                (*sum_hz, *sum, *count) = (*sum_hz + hz, *sum + power, *count + 1.0);
            }
            _ => points.push((hz, power, 1.0, bin(hz))),
        }
    }
    points.into_iter().map(|(hz, sum, count, _)| (hz / count, sum / count / spectrum.step_hz)).collect()
}

/// Power over frequency on logarithmic axes.
fn density(info: &ExcitationInfo, signal: &Signal, spectrum: &Spectrum) -> Plot {
    let nyquist_hz = signal.rate.hz() / 2.0;
    // Lines of a multisine are isolated: between them is only rounding, and averages of several are meaningless.
    let lines = info.kind == "multisine";
    let means = if lines { each_line(spectrum) } else { averaged(spectrum, nyquist_hz) };
    let top = means.iter().fold(f64::MIN_POSITIVE, |top, (_, power)| power.max(top)).log10();
    let floor = 10_f64.powf(top - DEPTH);
    let shown: Vec<(f64, f64)> = means.into_iter().filter(|(_, power)| *power > floor).collect();
    let (mode, unit) = if lines { (Mode::Markers, "power of each sine, mA²") } else { (Mode::Lines, "mA²/Hz") };
    // A tenth of a percent is visible.
    let short = |value: f64| format!("{value:.4e}").parse::<f64>().ok();
    let (low, high) = (spectrum.step_hz.max(nyquist_hz / 2000.0).log10(), (nyquist_hz * 1.08).log10());
    let mut layout = chart::layout()
        .hover_mode(HoverMode::Closest)
        .x_axis(chart::value_axis("Frequency (Hz)").type_(AxisType::Log).range(vec![rounded(low, 3), rounded(high, 3)]))
        .y_axis(
            chart::log_axis(unit).range(vec![rounded(top + 6.0 - DEPTH * 0.7, 2), rounded(top + 6.5, 2)]).dtick(1.0),
        )
        .show_legend(false);
    let vertical =
        |from: f64, to: f64| Shape::new().y_ref("paper").y0(0.0).y1(1.0).x0(from).x1(to).layer(ShapeLayer::Below);
    if let Some((a, b)) = info.band_hz {
        let shade = vertical(a.min(b), a.max(b)).shape_type(ShapeType::Rect).fill_color(css_faint(PALETTE.gap, 0.12));
        layout.add_shape(shade.line(ShapeLine::new().width(0.0)));
    }
    let nyquist = vertical(nyquist_hz, nyquist_hz).shape_type(ShapeType::Line);
    layout.add_shape(nyquist.line(ShapeLine::new().color(QUIET).width(1.2).dash(DashType::Dot)));
    let mut plot = chart::plot(layout);
    plot.add_trace(
        Scatter::new(
            shown.iter().map(|(hz, _)| rounded(*hz, 5)).collect::<Vec<_>>(),
            shown.iter().map(|(_, density)| short(density * 1e6)).collect::<Vec<_>>(),
        )
        .mode(mode)
        .line(Line::new().color(css(CURVE)).width(1.4))
        .marker(plotly::common::Marker::new().color(css(CURVE)).size(4))
        .hover_template(format!("%{{x:.3f}} Hz: %{{y:.3g}} {unit}<extra></extra>")),
    );
    plot
}
