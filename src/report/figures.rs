//! The plots of a tracking report.

use super::chart::{self, CURVE, PALETTE, Points, css, css_faint, rounded};
use super::course::{Channel, Course};
use super::html::escape;
use nalgebra::Point3;
use plotly::common::{Fill, HoverInfo, Line, Marker, Mode, Visible};
use plotly::layout::{Axis, HoverMode, Margin};
use plotly::{Plot, Scatter, Scatter3D};

/// Number of moments at which the 3D plot joins the markers by a line.
const MOMENTS: usize = 9;

/// θ with its σ band above, σ itself below.
pub(super) fn deflection(course: &Course, time: &str) -> Plot {
    let bins = course.timeline.bins();
    let layout = chart::layout()
        .x_axis(chart::time_axis(time, bins).anchor("y2"))
        .y_axis(chart::value_axis("θ (°)").domain(&[0.36, 1.0]))
        .y_axis2(chart::value_axis("σ of θ (°)").domain(&[0.0, 0.26]).range_mode(plotly::layout::RangeMode::ToZero));
    let mut plot = chart::plot(layout);
    let (low, high) = (course.extremes(Channel::ThetaLow), course.extremes(Channel::ThetaHigh));
    let (t, v) = chart::band(bins, low, high, 4);
    plot.add_trace(
        Scatter::new(t, v)
            .name("θ ± σ")
            .mode(Mode::Lines)
            .line(Line::new().width(0.0).color(css(CURVE)))
            .fill(Fill::ToSelf)
            .fill_color(css_faint(CURVE, 0.28))
            .hover_info(HoverInfo::Skip),
    );
    let theta = chart::curve(bins, course.extremes(Channel::Theta), 4);
    plot.add_trace(chart::line(theta, "θ", CURVE, 1.4, "%{y:+.3f}°"));
    let sd = chart::curve(bins, course.extremes(Channel::ThetaSd), 5);
    plot.add_trace(chart::line(sd, "σ", [90, 110, 130], 1.1, "%{y:.3f}°").y_axis("y2").show_legend(false));
    plot
}

/// Polar angle above, azimuth as dots below: near rest it jumps, and lines would look like bars.
pub(super) fn polar(course: &Course, time: &str) -> Plot {
    let bins = course.timeline.bins();
    let layout = chart::layout()
        .x_axis(chart::time_axis(time, bins).anchor("y2"))
        .y_axis(chart::value_axis("polar (°)").domain(&[0.54, 1.0]).range_mode(plotly::layout::RangeMode::ToZero))
        .y_axis2(chart::value_axis("azimuth (°)").domain(&[0.0, 0.44]).range(vec![-100.0, 280.0]).dtick(90.0))
        .show_legend(false);
    let mut plot = chart::plot(layout);
    let polar = chart::curve(bins, course.extremes(Channel::Polar), 4);
    plot.add_trace(chart::line(polar, "polar", CURVE, 1.4, "%{y:.3f}°"));
    let (t, v) = chart::curve(bins, course.extremes(Channel::Azimuth), 3);
    plot.add_trace(
        Scatter::new(t, v)
            .name("azimuth")
            .mode(Mode::Markers)
            .marker(Marker::new().size(3).color(css([90, 110, 130])))
            .y_axis("y2")
            .hover_template("%{y:.2f}°"),
    );
    plot
}

/// The paths of the markers in space.
pub(super) fn paths(course: &Course) -> Plot {
    // The viewpoint lets the catheter hang as in the picture.
    let (titles, up, eye) = if course.in_base_frame() {
        (["x, along B0 (mm)", "y (mm)", "z, base to tip (mm)"], (0.0, 0.0, -1.0), (0.43, 1.72, -0.43))
    } else {
        (["x, right (mm)", "y, down (mm)", "z, forward (mm)"], (0.0, -1.0, 0.0), (-0.59, -0.43, -1.67))
    };
    let places = &course.path.places_mm;
    let scene = chart::scene([0, 1, 2].map(|k| span_mm(places, k)), titles).camera(chart::eye(up, eye));
    let layout = chart::layout()
        .scene(scene)
        .hover_mode(HoverMode::Closest)
        .margin(Margin::new().left(0).right(0).top(28).bottom(0));
    let mut plot = chart::plot(layout);
    let coordinates = |points: Vec<Option<Point3<f64>>>| {
        [0, 1, 2].map(|k| {
            points.iter().map(|p| rounded(p.as_ref()?.coords.as_slice().get(k).copied()?, 4)).collect::<Vec<_>>()
        })
    };
    let whole: Vec<_> = places.iter().filter(|p| p.iter().all(Option::is_some)).collect();
    let step = whole.len().div_ceil(MOMENTS).max(1);
    let joined = whole.iter().step_by(step).flat_map(|p| p.iter().copied().chain([None])).collect();
    let [x, y, z] = coordinates(joined);
    plot.add_trace(
        Scatter3D::new(x, y, z)
            .name("markers joined at some moments")
            .mode(Mode::Lines)
            .line(Line::new().width(1.5).color("#b6bbc2"))
            .connect_gaps(false)
            .hover_info(HoverInfo::Skip),
    );
    for (i, name) in course.marker_names.iter().enumerate() {
        let [x, y, z] = coordinates(places.iter().map(|p| p.get(i).copied().flatten()).collect());
        let colour = css(PALETTE.marker(i));
        plot.add_trace(
            Scatter3D::new(x, y, z)
                .name(escape(name))
                .mode(Mode::LinesMarkers)
                .line(Line::new().width(3.0).color(colour.clone()))
                .marker(Marker::new().size(2).color(colour))
                .connect_gaps(false)
                .hover_template("(%{x:.3f}, %{y:.3f}, %{z:.3f}) mm"),
        );
    }
    plot
}

/// Smallest and largest coordinate `k` of all positions, mm.
fn span_mm(places: &[Vec<Option<Point3<f64>>>], k: usize) -> (f64, f64) {
    let values = places.iter().flatten().flatten().filter_map(|p| p.coords.as_slice().get(k).copied());
    let (low, high) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
    if low <= high { (low, high) } else { (0.0, 0.0) }
}

/// Residuals of one view.
pub(super) fn residuals(course: &Course, view: usize, time: &str) -> Plot {
    let axis = chart::value_axis("residual (px)").range_mode(plotly::layout::RangeMode::ToZero);
    by_marker(course, time, axis, Mode::Markers, "%{y:.3f} px", |marker| Channel::Residual { marker, view })
}

/// Colour separation in one view.
pub(super) fn separation(course: &Course, view: usize, time: &str) -> Plot {
    let axis = chart::value_axis("separation").range_mode(plotly::layout::RangeMode::ToZero).dtick(0.25);
    by_marker(course, time, axis, Mode::Lines, "%{y:.2f}", |marker| Channel::Separation { marker, view })
}

/// One curve per marker; noise is easier to read as dots than as crossing lines.
fn by_marker(
    course: &Course,
    time: &str,
    axis: Axis,
    mode: Mode,
    hover: &str,
    channel: impl Fn(usize) -> Channel,
) -> Plot {
    let bins = course.timeline.bins();
    let mut plot = chart::plot(chart::layout().x_axis(chart::time_axis(time, bins)).y_axis(axis));
    for (marker, name) in course.marker_names.iter().enumerate() {
        let points: Points = chart::curve(bins, course.extremes(channel(marker)), 4);
        let seen = if points.0.is_empty() { Visible::LegendOnly } else { Visible::True };
        let trace = chart::line(points, name, PALETTE.marker(marker), 1.2, hover).visible(seen);
        plot.add_trace(if let Mode::Markers = mode { trace.mode(Mode::Markers) } else { trace });
    }
    plot
}
