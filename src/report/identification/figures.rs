//! The plots of an identification.

use super::super::chart::{self, CURVE, INK, PALETTE, QUIET, css, css_faint, rounded};
use super::super::html::escape;
use super::super::timeline::Timeline;
use crate::identify::chain::identification::Identification;
use crate::identify::checks::residuals::Residuals;
use crate::identify::data::segments::Data;
use crate::identify::data::segments::Record;
use crate::identify::data::spectrum::{Point, Spectrum};
use crate::identify::model::modelled::{BodePoint, Modelled, Role, unwrapped};
use crate::identify::model::reproduction::{Kind, output};
use crate::identify::periodic::Line as SpectralLine;
use crate::identify::reduce::truncation::Reduced;
use crate::identify::results::provenance::Provenance;
use crate::sink::Rgb;
use plotly::common::{DashType, Fill, HoverInfo, Line, Marker, MarkerSymbol, Mode};
use plotly::layout::{AxisType, HoverMode, Shape, ShapeLayer, ShapeLine, ShapeType};
use plotly::{Bar, Layout, Plot, Scatter};
use std::f64::consts::TAU;

/// Samples in a magnified section.
const MAGNIFIED: usize = 300;
/// A model whose largest error is this many times that of the leading one does not widen the axis.
const RUNS_AWAY: f64 = 8.0;
/// Least coherence at which dots of the model-free response are shown.
const COHERENT: f64 = 0.05;

/// Content of the plots over time and frequency.
pub(super) struct Shown<'a> {
    /// The models.
    pub(super) models: &'a [Modelled],
    /// The model to use.
    pub(super) leading: Option<Role>,
    /// The response without a model.
    pub(super) spectrum: Option<&'a Spectrum>,
    /// The lines of averaged periods, if the input repeats: they replace the spectrum's dots.
    pub(super) lines: &'a [SpectralLine],
}

fn colour(role: Role) -> Rgb {
    match role {
        Role::Full => PALETTE.marker(1),
        Role::Reduced => PALETTE.marker(0),
        Role::Refined | Role::Given => CURVE,
        Role::Periodic => PALETTE.marker(2),
    }
}

/// Rounds to six significant digits.
fn short(value: f64) -> Option<f64> {
    let text = format!("{value:.5e}");
    text.parse().ok().filter(|v: &f64| v.is_finite())
}

fn with_unit(name: &str, unit: &str) -> String {
    if unit.is_empty() { name.to_owned() } else { format!("{name} ({unit})") }
}

/// A whole record, the models' residuals, and a magnified section from the middle.
pub(super) fn courses(data: &Data, done: &Shown<'_>, provenance: &Provenance, record: &Record) -> (Plot, Plot, Plot) {
    let kind = Kind::Simulation(provenance.initial_state);
    let (mut whole, mut errors) = (Timeline::default(), Timeline::default());
    // Largest error of each model.
    let mut largest_left: Vec<f64> = vec![0.0; done.models.len()];
    let longest = record.segments.iter().max_by_key(|s| s.len());
    for segment in &record.segments {
        let simulated: Vec<Vec<f64>> = done.models.iter().map(|m| output(&m.model, segment, kind)).collect();
        for k in 0..segment.len() {
            let values = simulated.iter().map(|s| s.get(k).copied().filter(|v| v.is_finite()));
            let all: Vec<Option<f64>> =
                std::iter::once(Some(segment.output[k]).filter(|y| !y.is_nan())).chain(values).collect();
            let lost = u64::from(k == 0 && segment.first > 0);
            let time_s = segment.start_s + k as f64 * data.period_s;
            whole.push(time_s, lost, &all, &[]);
            let error = |value: &Option<f64>| value.zip(all.first().copied().flatten()).map(|(m, y)| y - m);
            let errors_now: Vec<Option<f64>> = all.iter().skip(1).map(error).collect();
            for (largest, error) in largest_left.iter_mut().zip(&errors_now) {
                *largest = largest.max(error.unwrap_or(0.0).abs());
            }
            errors.push(time_s, lost, &errors_now, &[]);
        }
    }
    // The axis covers all models but those that run away beside the leading one.
    let leading = done.models.iter().position(|model| Some(model.role) == done.leading);
    let of_leading = leading.and_then(|k| largest_left.get(k).copied()).unwrap_or(f64::INFINITY);
    let near = largest_left.iter().copied().filter(|largest| *largest <= RUNS_AWAY * of_leading);
    let largest_left = 1.15 * near.fold(0.0, f64::max);
    // A diverging model would flatten all others.
    let largest = record.segments.iter().flat_map(|s| &s.output).fold(0.0_f64, |m, y| m.max(y.abs())) * 1.15;
    let layout = || {
        chart::layout().x_axis(chart::value_axis("Time (s)").zero_line(false)).y_axis(
            chart::value_axis(&with_unit(&provenance.output, &provenance.output_unit)).range(vec![-largest, largest]),
        )
    };
    let mut all = chart::plot(layout());
    let channel = |k: usize| whole.bins().iter().map(move |bin| bin.channels.get(k).copied().flatten());
    all.add_trace(chart::line(chart::curve(whole.bins(), channel(0), 6), "observed", [60, 66, 74], 2.4, "%{y:.4g}"));
    for (k, model) in done.models.iter().enumerate() {
        let points = chart::curve(whole.bins(), channel(k + 1), 6);
        all.add_trace(chart::line(points, &model.title, colour(model.role), 1.1, "%{y:.4g}"));
    }
    let mut left = chart::plot(chart::layout().x_axis(chart::value_axis("Time (s)").zero_line(false)).y_axis(
        chart::value_axis(&with_unit("Error", &provenance.output_unit)).range(vec![-largest_left, largest_left]),
    ));
    for (k, model) in done.models.iter().enumerate() {
        let channel = errors.bins().iter().map(|bin| bin.channels.get(k).copied().flatten());
        let points = chart::curve(errors.bins(), channel, 6);
        left.add_trace(chart::line(points, &model.title, colour(model.role), 1.1, "%{y:.4g}"));
    }
    let mut middle = chart::plot(layout());
    if let Some(segment) = longest {
        let from = segment.len().saturating_sub(MAGNIFIED) / 2;
        let to = (from + MAGNIFIED).min(segment.len());
        let times: Vec<Option<f64>> =
            (from..to).map(|k| rounded(segment.start_s + k as f64 * data.period_s, 5)).collect();
        let part = |signal: &[f64]| signal[from..to].iter().map(|v| short(*v)).collect::<Vec<_>>();
        let trace = |values, name: &str, colour, width, mode| {
            Scatter::new(times.clone(), values)
                .name(escape(name))
                .mode(mode)
                .line(Line::new().color(css(colour)).width(width))
                .marker(Marker::new().color(css(colour)).size(4))
                .hover_template("%{y:.4g}")
        };
        middle.add_trace(trace(part(&segment.output), "observed", [60, 66, 74], 1.0, Mode::Markers));
        for model in done.models {
            let simulated = output(&model.model, segment, kind);
            middle.add_trace(trace(part(&simulated), &model.title, colour(model.role), 1.6, Mode::Lines));
        }
    }
    (all, left, middle)
}

/// A plot over frequency, with the excited band and half the sampling rate.
fn over_frequency(data: &Data, done: &Shown<'_>, title: &str) -> Layout {
    let nyquist = 0.5 / data.period_s;
    let lowest = done.models.first().and_then(|m| m.bode.first()).map_or(nyquist * 1e-3, |p| p.frequency_hz);
    let mut layout = chart::layout()
        .hover_mode(HoverMode::Closest)
        .x_axis(
            chart::value_axis("Frequency (Hz)")
                .type_(AxisType::Log)
                .range(vec![rounded(lowest.log10(), 3), rounded((nyquist * 1.1).log10(), 3)]),
        )
        .y_axis(chart::value_axis(title));
    let vertical =
        |from: f64, to: f64| Shape::new().y_ref("paper").y0(0.0).y1(1.0).x0(from).x1(to).layer(ShapeLayer::Below);
    if let Some(spectrum) = done.spectrum {
        let shade = vertical(spectrum.excited_hz.0, spectrum.excited_hz.1).shape_type(ShapeType::Rect);
        layout.add_shape(shade.fill_color(css_faint(PALETTE.gap, 0.12)).line(ShapeLine::new().width(0.0)));
    }
    let half = vertical(nyquist, nyquist).shape_type(ShapeType::Line);
    layout.add_shape(half.line(ShapeLine::new().color(INK).width(1.2).dash(DashType::Dot)));
    layout
}

/// Lines of all models with their bands, and dots of the data.
fn responses(
    data: &Data,
    done: &Shown<'_>,
    title: &str,
    of: impl Fn(&BodePoint) -> (f64, Option<f64>),
    dots: &[(f64, f64, f64)],
    unit: &str,
) -> Plot {
    let mut plot = chart::plot(over_frequency(data, done, title));
    let hover = format!("%{{x:.4g}} Hz: %{{y:.4g}} {unit}");
    for model in done.models {
        let points: Vec<(f64, f64, Option<f64>)> = model
            .bode
            .iter()
            .map(|p| {
                let (value, sd) = of(p);
                (p.frequency_hz, value, sd)
            })
            .collect();
        if points.iter().all(|(_, _, sd)| sd.is_some()) {
            let outline = |sign: f64| points.iter().map(move |(f, v, sd)| (*f, v + sign * sd.unwrap_or(0.0)));
            let around: Vec<(f64, f64)> =
                outline(1.0).chain(outline(-1.0).collect::<Vec<_>>().into_iter().rev()).collect();
            plot.add_trace(
                Scatter::new(
                    around.iter().map(|(f, _)| short(*f)).collect(),
                    around.iter().map(|(_, v)| short(*v)).collect(),
                )
                .mode(Mode::Lines)
                .line(Line::new().width(0.0))
                .fill(Fill::ToSelf)
                .fill_color(css_faint(colour(model.role), 0.18))
                .hover_info(HoverInfo::Skip)
                .show_legend(false),
            );
        }
        let line = Scatter::new(
            points.iter().map(|(f, _, _)| short(*f)).collect(),
            points.iter().map(|(_, v, _)| short(*v)).collect(),
        );
        plot.add_trace(
            line.name(escape(&model.title))
                .mode(Mode::Lines)
                .line(Line::new().color(css(colour(model.role))).width(1.8))
                .hover_template(&hover),
        );
    }
    if !dots.is_empty() {
        // The error bar of one σ, as a thin line through each dot.
        let mut bars: (Vec<Option<f64>>, Vec<Option<f64>>) = (Vec::new(), Vec::new());
        for (f, v, sd) in dots {
            bars.0.extend([short(*f), short(*f), None]);
            bars.1.extend([short(v - sd), short(v + sd), None]);
        }
        let grey = "rgba(60,66,74,0.35)";
        plot.add_trace(
            Scatter::new(bars.0, bars.1)
                .mode(Mode::Lines)
                .line(Line::new().color(grey).width(1.0))
                .connect_gaps(false)
                .hover_info(HoverInfo::Skip)
                .show_legend(false),
        );
        plot.add_trace(
            Scatter::new(dots.iter().map(|d| short(d.0)).collect(), dots.iter().map(|d| short(d.1)).collect())
                .name("data")
                .mode(Mode::Markers)
                .marker(Marker::new().color("rgb(60,66,74)").size(4))
                .hover_template(&hover),
        );
    }
    plot
}

/// Frequency, ln gain, phase and the σ of both, of the response without a model: from averaged periods if there are
/// any, otherwise from the coherent part of the spectrum.
fn dots(done: &Shown<'_>) -> Vec<(f64, f64, f64, f64)> {
    // Phases are made continuous with the first model's, up to whole turns.
    let turned = |frequency_hz: f64, phase: f64| {
        let near = done.models.last().and_then(|model| {
            let off = |q: &&BodePoint| (q.frequency_hz - frequency_hz).abs();
            model.bode.iter().min_by(|a, b| off(a).total_cmp(&off(b)))
        });
        phase + ((near.map_or(0.0, |q| q.phase_rad) - phase) / TAU).round() * TAU
    };
    if !done.lines.is_empty() {
        let dot = |line: &SpectralLine| {
            let (response, sd) = (line.response(), line.relative_sd()?);
            Some((line.frequency_hz, response.norm().ln(), turned(line.frequency_hz, response.arg()), sd))
        };
        return done.lines.iter().filter_map(dot).collect();
    }
    let points = || done.spectrum.iter().flat_map(|s| s.points.iter().enumerate());
    let followed = unwrapped(points().map(|(_, p)| p.response.arg()));
    // Unwrapped over the excited band, where it is known.
    let first = points().find(|(_, p)| p.coherence > 0.5);
    let turns = first.map_or(0.0, |(k, p)| turned(p.frequency_hz, followed[k]) - followed[k]);
    let coherent = points().filter(|(_, p)| p.coherence > COHERENT);
    // Of too few pieces there are no bars.
    let sd = |p: &Point| p.relative_sd.unwrap_or_default();
    coherent.map(|(k, p)| (p.frequency_hz, p.response.norm().ln(), followed[k] + turns, sd(p))).collect()
}

const DB_OF_LN: f64 = 8.685_889_638_065_037;

/// Gain over frequency.
pub(super) fn magnitude(data: &Data, done: &Shown<'_>) -> Plot {
    let dots: Vec<_> = dots(done).into_iter().map(|(f, gain, _, sd)| (f, DB_OF_LN * gain, DB_OF_LN * sd)).collect();
    let of = |p: &BodePoint| (20.0 * p.magnitude.log10(), p.sd.map(|(gain, _)| DB_OF_LN * gain));
    responses(data, done, "Magnitude (dB)", of, &dots, "dB")
}

/// Phase over frequency.
pub(super) fn phase(data: &Data, done: &Shown<'_>) -> Plot {
    let dots: Vec<_> =
        dots(done).into_iter().map(|(f, _, phase, sd)| (f, phase.to_degrees(), sd.to_degrees())).collect();
    let of = |p: &BodePoint| (p.phase_rad.to_degrees(), p.sd.map(|(_, phase)| phase.to_degrees()));
    responses(data, done, "Phase (°)", of, &dots, "°")
}

/// Coherence over frequency.
pub(super) fn coherence(data: &Data, done: &Shown<'_>) -> Plot {
    let mut layout = over_frequency(data, done, "Coherence").show_legend(false);
    layout = layout.y_axis(chart::value_axis("Coherence").range(vec![0.0, 1.05]));
    let mut plot = chart::plot(layout);
    let points = || done.spectrum.iter().flat_map(|s| &s.points);
    let line = Scatter::new(
        points().map(|p| short(p.frequency_hz)).collect(),
        points().map(|p| rounded(p.coherence, 4)).collect(),
    );
    plot.add_trace(
        line.mode(Mode::Lines)
            .line(Line::new().color(QUIET).width(1.4))
            .hover_template("%{x:.4g} Hz: %{y:.3f}<extra></extra>"),
    );
    plot
}

/// The criterion over the order, with a line for each delay.
pub(super) fn orders(done: &Identification, judged: bool) -> Plot {
    let value = |c: &crate::identify::estimate::search::Candidate| {
        if judged { c.simulation.map(|e| e.error_percent) } else { Some(c.mdl) }
    };
    let title = if judged { "Error (% of energy)" } else { "MDL" };
    let layout = chart::layout()
        .hover_mode(HoverMode::Closest)
        .x_axis(chart::value_axis("Order (na)").dtick(1.0).zero_line(false))
        .y_axis(if judged { chart::log_axis(title) } else { chart::value_axis(title) });
    let mut plot = chart::plot(layout);
    let mut delays: Vec<usize> = done.candidates.iter().map(|c| c.orders.nk).collect();
    delays.sort_unstable();
    delays.dedup();
    for (k, nk) in delays.iter().enumerate() {
        let of: Vec<_> = done.candidates.iter().filter(|c| c.orders.nk == *nk && c.largest_pole < 1.0).collect();
        let texts: Vec<String> =
            of.iter().map(|c| format!("na {}, nb {}, nk {}", c.orders.na, c.orders.nb, c.orders.nk)).collect();
        plot.add_trace(
            Scatter::new(
                of.iter().map(|c| c.orders.na).collect(),
                of.iter().map(|c| value(c).and_then(short)).collect(),
            )
            .name(format!("delay {nk}"))
            .mode(Mode::LinesMarkers)
            .line(Line::new().color(css(PALETTE.marker(k))).width(1.2))
            .marker(Marker::new().color(css(PALETTE.marker(k))).size(4))
            .text_array(texts)
            .hover_template("%{text}: %{y:.5g}<extra></extra>"),
        );
    }
    let chosen = done.candidates.iter().find(|c| c.orders == done.orders);
    if let Some(chosen) = chosen {
        plot.add_trace(
            Scatter::new(vec![chosen.orders.na], vec![value(chosen).and_then(short)])
                .name("chosen")
                .mode(Mode::Markers)
                .marker(
                    Marker::new()
                        .color(css(PALETTE.miss))
                        .size(13)
                        .symbol(MarkerSymbol::CircleOpen)
                        .line(Line::new().width(2.0)),
                )
                .hover_info(HoverInfo::Skip),
        );
    }
    plot
}

/// Hankel singular values; those kept are filled.
pub(super) fn hankel(reduced: &Reduced, kept: usize) -> Plot {
    let layout = chart::layout()
        .show_legend(false)
        .hover_mode(HoverMode::Closest)
        .x_axis(chart::value_axis("State").dtick(1.0).zero_line(false))
        .y_axis(chart::log_axis("Hankel singular value"));
    let mut plot = chart::plot(layout);
    let values = reduced.hankel_in_band.as_ref().unwrap_or(&reduced.hankel);
    let stable_kept = kept - reduced.unstable;
    let colours: Vec<String> =
        (0..values.len()).map(|k| if k < stable_kept { css(CURVE) } else { css_faint(PALETTE.gap, 0.35) }).collect();
    plot.add_trace(
        Bar::new((1..=values.len()).collect(), values.iter().map(|v| short(*v)).collect())
            .marker(Marker::new().color_array(colours))
            .hover_template("%{x}: %{y:.4g}<extra></extra>"),
    );
    plot
}

/// Correlations of the residuals with themselves or with the input.
pub(super) fn correlation(found: &Residuals, auto: bool) -> Plot {
    let (title, values, bound): (&str, Vec<(i64, f64)>, f64) = if auto {
        let lags = found.auto.iter().enumerate().skip(1);
        ("Residuals with themselves", lags.map(|(k, v)| (k as i64, *v)).collect(), found.auto_bound)
    } else {
        let lags = found.cross.iter().enumerate();
        ("Residuals with the input", lags.map(|(k, v)| (Residuals::cross_lag(k), *v)).collect(), found.cross_bound)
    };
    let mut layout = chart::layout()
        .show_legend(false)
        .hover_mode(HoverMode::Closest)
        .x_axis(chart::value_axis("Lag (samples)"))
        .y_axis(chart::value_axis(title));
    for level in [bound, -bound] {
        let line = Shape::new().x_ref("paper").x0(0.0).x1(1.0).y0(level).y1(level).shape_type(ShapeType::Line);
        layout.add_shape(line.line(ShapeLine::new().color(INK).width(1.0).dash(DashType::Dot)));
    }
    let mut plot = chart::plot(layout);
    let colours: Vec<String> =
        values.iter().map(|(_, v)| if v.abs() > bound { css(PALETTE.miss) } else { css(CURVE) }).collect();
    plot.add_trace(
        Bar::new(values.iter().map(|(lag, _)| *lag).collect(), values.iter().map(|(_, v)| short(*v)).collect())
            .marker(Marker::new().color_array(colours))
            .hover_template("lag %{x}: %{y:.3f}<extra></extra>"),
    );
    plot
}
