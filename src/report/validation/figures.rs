//! The plots of a validation's page, after Figs. 9 to 13 of the paper.

use super::super::chart::{self, CURVE, INK, PALETTE, QUIET, css, rounded};
use super::{ModelLine, escape, pause};
use crate::sink::Rgb;
use crate::validate::{Run, Step, Validation};
use nalgebra::{Point2, Point3};
use plotly::common::{DashType, HoverInfo, Line, Marker, MarkerSymbol, Mode, Visible};
use plotly::layout::{
    Annotation, Axis, AxisConstrain, AxisType, HoverMode, Margin, RangeMode, Shape, ShapeLine, ShapeType,
};
use plotly::{Plot, Scatter, Scatter3D};
use std::f64::consts::TAU;

/// Runs shown initially; more would hide each other.
const SHOWN: usize = 3;

/// From dark to light over the runs, fastest first: the hues of viridis, dark enough for white, and light enough for a
/// page that is dark (3 to 1 and more on both).
fn colour(index: usize, count: usize) -> Rgb {
    const STOPS: [[f64; 3]; 5] =
        [[68.0, 1.0, 84.0], [59.0, 82.0, 139.0], [33.0, 145.0, 140.0], [50.0, 160.0, 90.0], [135.0, 155.0, 20.0]];
    let at = index as f64 / count.saturating_sub(1).max(1) as f64 * (STOPS.len() - 1) as f64;
    let (low, part) = (at.floor() as usize, at.fract());
    let [a, b] = [low, (low + 1).min(STOPS.len() - 1)].map(|k| STOPS.get(k).copied().unwrap_or([0.0; 3]));
    [0, 1, 2].map(|c| (a[c] + (b[c] - a[c]) * part).round() as u8)
}

/// The slowest, the fastest and the middle one are shown initially.
fn visible(index: usize, count: usize) -> Visible {
    let first = count <= SHOWN || [0, count / 2, count - 1].contains(&index);
    if first { Visible::True } else { Visible::LegendOnly }
}

fn runs(validation: &Validation) -> impl Iterator<Item = (usize, &Run)> {
    validation.runs.iter().enumerate()
}

/// A logarithmic axis around these values.
fn log_axis(title: &str, values: impl Iterator<Item = f64>) -> Axis {
    let (low, high) = values.fold((f64::INFINITY, 0.0), |(low, high): (f64, f64), v| (low.min(v), high.max(v)));
    let axis = chart::value_axis(title).type_(AxisType::Log).zero_line(false);
    if low > 0.0 && high.is_finite() {
        axis.range(vec![rounded(low.log10() - 0.12, 3), rounded(high.log10() + 0.12, 3)])
    } else {
        axis
    }
}

fn frequency_axis(validation: &Validation, title: &str) -> Axis {
    log_axis(title, validation.runs.iter().map(|run| run.frequency_hz))
}

type Trace = Box<Scatter<Option<f64>, Option<f64>>>;

fn dots(x: Vec<Option<f64>>, y: Vec<Option<f64>>, colour: Rgb) -> Trace {
    Scatter::new(x, y)
        .mode(Mode::LinesMarkers)
        .line(Line::new().color(css(colour)).width(1.4))
        .marker(Marker::new().color(css(colour)).size(7))
        .connect_gaps(false)
}

/// A model's response, behind the runs' dots.
fn model_trace(plot: &mut Plot, model: Option<&ModelLine>, of: impl Fn(&(f64, f64, f64)) -> f64, unit: &str) {
    let Some(model) = model else { return };
    let (x, y) = model.points.iter().map(|p| (rounded(p.0, 5), rounded(of(p), 4))).unzip();
    plot.add_trace(
        Scatter::new(x, y)
            .name(escape(&model.name))
            .mode(Mode::Lines)
            .line(Line::new().color(css(PALETTE.marker(1))).width(1.6).dash(DashType::Dash))
            .hover_template(format!("%{{x}} Hz: %{{y:.2f}}{unit}")),
    );
}

/// Magnitude over frequency, and where it is 3 dB below the slowest run's; also for the model.
pub(super) fn magnitude(validation: &Validation, model: Option<&ModelLine>) -> Plot {
    let x = validation.runs.iter().rev().map(|run| rounded(run.frequency_hz, 5)).collect();
    let y = validation.runs.iter().rev().map(|run| rounded(run.magnitude?.db, 4)).collect();
    let mut layout = chart::layout()
        .x_axis(frequency_axis(validation, "Frequency (Hz)"))
        .y_axis(chart::value_axis("Magnitude (dB)"))
        .show_legend(model.is_some())
        .hover_mode(HoverMode::Closest);
    if let Some(db) = validation.runs.last().and_then(|run| Some(run.magnitude?.db - 3.0)) {
        let line = Shape::new().shape_type(ShapeType::Line).x_ref("paper").x0(0.0).x1(1.0).y0(db).y1(db);
        layout.add_shape(line.line(ShapeLine::new().color(QUIET).width(1.2).dash(DashType::Dot)));
        layout.add_annotation(
            Annotation::new()
                .text("3 dB below the slowest run")
                .x_ref("paper")
                .x(0.0)
                .y(db)
                .x_shift(84.0)
                .y_shift(-9.0)
                .show_arrow(false)
                .font(chart::font(12, QUIET)),
        );
    }
    let mut plot = chart::plot(layout);
    model_trace(&mut plot, model, |p| p.1, " dB");
    plot.add_trace(dots(x, y, CURVE).name("runs").hover_template("%{x} Hz: %{y:.2f} dB<extra></extra>"));
    plot
}

/// Phase over frequency.
pub(super) fn phase(validation: &Validation, model: Option<&ModelLine>) -> Plot {
    let x = validation.runs.iter().rev().map(|run| rounded(run.frequency_hz, 5)).collect();
    let y = validation.runs.iter().rev().map(|run| rounded(run.phase_deg?, 3)).collect();
    let layout = chart::layout()
        .x_axis(frequency_axis(validation, "Frequency (Hz)"))
        .y_axis(chart::value_axis("Phase (°)"))
        .show_legend(model.is_some())
        .hover_mode(HoverMode::Closest);
    let mut plot = chart::plot(layout);
    model_trace(&mut plot, model, |p| p.2, "°");
    plot.add_trace(dots(x, y, CURVE).name("runs").hover_template("%{x} Hz: %{y:.1f}°<extra></extra>"));
    plot
}

/// Errors over pause times (Table II), with and without alignment.
pub(super) fn rms_over_pause(validation: &Validation) -> Plot {
    let x: Vec<_> = validation.runs.iter().map(|run| rounded(run.pause_s * 1e3, 4)).collect();
    let layout = chart::layout()
        .x_axis(log_axis("Pause (ms)", validation.runs.iter().map(|run| run.pause_s * 1e3)))
        .y_axis(chart::value_axis("RMS error (mm)").range_mode(RangeMode::ToZero));
    let mut plot = chart::plot(layout);
    let unaligned = validation.runs.iter().map(|run| rounded(run.rms_unaligned_m * 1e3, 4)).collect();
    plot.add_trace(dots(x.clone(), unaligned, PALETTE.gap).name("as observed").hover_template("%{y:.3f} mm"));
    let aligned = validation.runs.iter().map(|run| rounded(run.alignment.rms_m * 1e3, 4)).collect();
    plot.add_trace(dots(x, aligned, CURVE).name("aligned").hover_template("%{y:.3f} mm"));
    plot
}

/// Aligned errors along the path.
pub(super) fn errors(validation: &Validation) -> Plot {
    let per_period = validation.path.points.len() as f64;
    let layout = chart::layout()
        .x_axis(chart::value_axis("Commanded periods").zero_line(false))
        .y_axis(chart::value_axis("Error (mm)").range_mode(RangeMode::ToZero));
    let mut plot = chart::plot(layout);
    let count = validation.runs.len();
    for (index, run) in runs(validation) {
        let x = run.steps.iter().map(|s| rounded(s.k as f64 / per_period, 4)).collect::<Vec<_>>();
        let y = run.steps.iter().map(|s| rounded((s.aligned? - s.desired).norm() * 1e3, 4)).collect::<Vec<_>>();
        plot.add_trace(
            Scatter::new(x, y)
                .name(pause(run))
                .mode(Mode::Lines)
                .line(Line::new().color(css(colour(index, count))).width(1.4))
                .connect_gaps(false)
                .visible(visible(index, count))
                .hover_template("%{y:.3f} mm"),
        );
    }
    plot
}

/// Paths in space, as observed or aligned.
pub(super) fn space(validation: &Validation, aligned: bool) -> Plot {
    let of = |s: &Step| if aligned { s.aligned } else { s.observed };
    let desired = &validation.path.points;
    let seen = validation.runs.iter().flat_map(|run| run.steps.iter().filter_map(of));
    let all: Vec<Point3<f64>> = desired.iter().copied().chain(seen).collect();
    let spans = [0, 1, 2].map(|k| {
        all.iter()
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), p| (low.min(p[k] * 1e3), high.max(p[k] * 1e3)))
    });
    // The catheter hangs: its z axis points down.
    let scene =
        chart::scene(spans, ["x (mm)", "y (mm)", "z (mm)"]).camera(chart::eye((0.0, 0.0, -1.0), (1.35, 1.35, -1.2)));
    let layout = chart::layout()
        .scene(scene)
        .hover_mode(HoverMode::Closest)
        .margin(Margin::new().left(0).right(0).top(34).bottom(0));
    let mut plot = chart::plot(layout);
    let count = validation.runs.len();
    for (index, run) in runs(validation) {
        let coordinate = |k: usize| run.steps.iter().map(|s| rounded(of(s)?[k] * 1e3, 3)).collect::<Vec<_>>();
        plot.add_trace(
            Scatter3D::new(coordinate(0), coordinate(1), coordinate(2))
                .name(pause(run))
                .mode(Mode::Lines)
                .line(Line::new().color(css(colour(index, count))).width(3.0))
                .connect_gaps(false)
                .visible(visible(index, count))
                .hover_template("(%{x:.2f}, %{y:.2f}, %{z:.2f}) mm"),
        );
    }
    let closed: Vec<&Point3<f64>> = desired.iter().chain(desired.first()).collect();
    let coordinate = |k: usize| closed.iter().map(|p| rounded(p[k] * 1e3, 3)).collect::<Vec<_>>();
    plot.add_trace(
        Scatter3D::new(coordinate(0), coordinate(1), coordinate(2))
            .name("path")
            .mode(Mode::Lines)
            .line(Line::new().color(INK).width(5.0))
            .hover_template("(%{x:.2f}, %{y:.2f}, %{z:.2f}) mm"),
    );
    plot
}

/// One run, aligned, over the path, both projected into the plane of the path (Fig. 12).
pub(super) fn one_run(validation: &Validation, index: usize, run: &Run) -> Plot {
    let axis = |title: &str| chart::value_axis(title).constrain(AxisConstrain::Domain).zero_line(false);
    let layout = chart::layout()
        .x_axis(axis("In the plane (mm)"))
        .y_axis(axis("Across (mm)").scale_anchor("x"))
        .show_legend(false)
        .hover_mode(HoverMode::Closest)
        .margin(Margin::new().left(56).right(10).top(12).bottom(44));
    let mut plot = chart::plot(layout);
    let plane = validation.path.plane;
    let mm = |value: f64| rounded(value * 1e3, 3);
    let points = &validation.path.points;
    let (x, y): (Vec<_>, Vec<_>) =
        points.iter().chain(points.first()).map(|p| plane.flat(p)).map(|p| (mm(p.x), mm(p.y))).unzip();
    plot.add_trace(
        Scatter::new(x, y).mode(Mode::Lines).line(Line::new().color(INK).width(1.4)).hover_info(HoverInfo::Skip),
    );
    let flat = run.steps.iter().filter_map(|s| s.aligned).map(|point| plane.flat(&point));
    let (x, y): (Vec<_>, Vec<_>) = flat.map(|p| (mm(p.x), mm(p.y))).unzip();
    plot.add_trace(
        Scatter::new(x, y)
            .mode(Mode::Markers)
            .marker(Marker::new().color(css(colour(index, validation.runs.len()))).size(4).opacity(0.55))
            .hover_template("(%{x:.2f}, %{y:.2f}) mm<extra></extra>"),
    );
    plot
}

/// Fitted circles in their planes, all with the same centre (Fig. 10).
pub(super) fn circles(validation: &Validation) -> Plot {
    let axis = |title: &str| chart::value_axis(title).constrain(AxisConstrain::Domain);
    let layout = chart::layout()
        .x_axis(axis("In the plane (mm)"))
        .y_axis(axis("Across (mm)").scale_anchor("x"))
        .hover_mode(HoverMode::Closest);
    let mut plot = chart::plot(layout);
    let count = validation.runs.len();
    let ring = |radius_m: f64| -> (Vec<Option<f64>>, Vec<Option<f64>>) {
        let angles = (0..=180).map(|k| TAU * f64::from(k) / 180.0);
        angles.map(|t| (rounded(radius_m * t.cos() * 1e3, 3), rounded(radius_m * t.sin() * 1e3, 3))).unzip()
    };
    for (index, run) in runs(validation) {
        let (Some(plane), Some(circle)) = (run.plane, run.circle) else { continue };
        let around = |point: Point3<f64>| -> Point2<f64> { (plane.flat(&point) - circle.centre).into() };
        let flat: Vec<Point2<f64>> = run.steps.iter().filter_map(|s| s.observed).map(around).collect();
        let (x, y): (Vec<_>, Vec<_>) = flat.iter().map(|p| (rounded(p.x * 1e3, 3), rounded(p.y * 1e3, 3))).unzip();
        let (paint, shown) = (css(colour(index, count)), visible(index, count));
        plot.add_trace(
            Scatter::new(x, y)
                .name(pause(run))
                .legend_group(index.to_string())
                .mode(Mode::Markers)
                .marker(Marker::new().color(paint.clone()).size(4).opacity(0.55))
                .visible(shown.clone())
                .hover_template("(%{x:.2f}, %{y:.2f}) mm"),
        );
        let (x, y) = ring(circle.radius_m);
        plot.add_trace(
            Scatter::new(x, y)
                .legend_group(index.to_string())
                .show_legend(false)
                .mode(Mode::Lines)
                .line(Line::new().color(paint).width(1.6))
                .visible(shown)
                .hover_info(HoverInfo::Skip),
        );
    }
    if let Some(circle) = validation.path.circle {
        let (x, y) = ring(circle.radius_m);
        plot.add_trace(
            Scatter::new(x, y)
                .name("path")
                .mode(Mode::Lines)
                .line(Line::new().color(INK).width(1.6).dash(DashType::Dash))
                .hover_info(HoverInfo::Skip),
        );
        let plane = validation.path.plane;
        if let Some(first) = validation.path.points.first() {
            let at = plane.flat(first) - circle.centre;
            plot.add_trace(
                Scatter::new(vec![rounded(at.x * 1e3, 3)], vec![rounded(at.y * 1e3, 3)])
                    .name("first point")
                    .mode(Mode::Markers)
                    .marker(Marker::new().color(INK).size(10).symbol(MarkerSymbol::Diamond))
                    .hover_info(HoverInfo::Skip),
            );
        }
    }
    plot
}
