//! The plots of a calibration's page.

use super::super::chart::{self, CURVE, INK, PALETTE, QUIET, css, css_faint, rounded};
use super::super::html::escape;
use crate::calibrate::rig::RigCalibration;
use crate::calibrate::rig::diagnostics::{Neighbourhood, neighbourhoods};
use nalgebra::{DMatrix, Point2, Point3, Vector2};
use plotly::common::{
    ColorBar, ColorScale, ColorScaleElement, ColorScalePalette, HoverInfo, Line, Marker, Mode, Title,
};
use plotly::layout::{Annotation, AxisConstrain, BarMode, HoverMode, Margin, RangeMode};
use plotly::{Bar, HeatMap, Plot, Scatter, Scatter3D};

/// Drawn length of a long residual, as a fraction of the view's longer side.
const DRAWN: f64 = 0.1;

/// Errors at points (metres) in the camera frame, with the outlines of the boards.
pub(super) fn errors(errors_m: &[(Point3<f64>, f64)], boards: &[Vec<Point3<f64>>]) -> Plot {
    let titles = ["x, right (mm)", "y, down (mm)", "z, forward (mm)"];
    let all = || errors_m.iter().map(|(place, _)| place).chain(boards.iter().flatten());
    let spans = [0, 1, 2].map(|k| {
        all().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), p| (low.min(p[k] * 1e3), high.max(p[k] * 1e3)))
    });
    // Seen in the camera's direction, from its upper right.
    let scene = chart::scene(spans, titles).camera(chart::eye((0.0, -1.0, 0.0), (1.35, -1.1, -1.95)));
    let layout = chart::layout()
        .scene(scene)
        .show_legend(false)
        .hover_mode(HoverMode::Closest)
        .margin(Margin::new().left(0).right(0).top(34).bottom(0));
    let mut plot = chart::plot(layout);
    let mut outlines = [const { Vec::<Option<f64>>::new() }; 3];
    for board in boards {
        for (k, coordinate) in outlines.iter_mut().enumerate() {
            coordinate.extend(board.iter().chain(board.first()).map(|p| rounded(p[k] * 1e3, 2)));
            coordinate.push(None);
        }
    }
    let [x, y, z] = outlines;
    plot.add_trace(
        Scatter3D::new(x, y, z)
            .mode(Mode::Lines)
            .line(Line::new().width(1.5).color("#b6bbc2"))
            .connect_gaps(false)
            .hover_info(HoverInfo::Skip),
    );
    let [x, y, z] = [0, 1, 2].map(|k| errors_m.iter().map(|(p, _)| rounded(p[k] * 1e3, 2)).collect::<Vec<_>>());
    let errors_mm: Vec<f64> = errors_m.iter().map(|(_, error)| rounded(error * 1e3, 5).unwrap_or(0.0)).collect();
    let texts = errors_mm.iter().map(|mm| format!("{mm:.4} mm")).collect::<Vec<_>>();
    // From 0, so that a uniform volume has one colour.
    let worst = errors_mm.iter().copied().fold(0.0, f64::max);
    plot.add_trace(
        Scatter3D::new(x, y, z)
            .mode(Mode::Markers)
            .marker(
                Marker::new()
                    .size(5)
                    .color_array(errors_mm)
                    .cmin(0.0)
                    .cmax(worst)
                    .color_scale(ColorScale::Palette(ColorScalePalette::Viridis))
                    .show_scale(true)
                    .color_bar(
                        ColorBar::new()
                            .thickness(12)
                            .outline_width(0)
                            .tick_font(chart::font(12, QUIET))
                            .title(Title::with_text("mm").font(chart::font(12, QUIET))),
                    ),
            )
            .text_array(texts)
            .hover_template("%{text} at (%{x:.0f}, %{y:.0f}, %{z:.0f}) mm<extra></extra>"),
    );
    plot
}

/// A corner and its residual, pixels.
pub(super) type Arrow = (Point2<f64>, Vector2<f64>);

/// Indices of the pictures of a view's corners, in the order of
/// [`residuals`](crate::calibrate::rig::diagnostics::residuals).
fn pictures(done: &RigCalibration, view: usize) -> impl Iterator<Item = usize> {
    done.corners.iter().filter(move |c| c.view == view).map(|c| c.picture)
}

fn bounds(arrows: &[Arrow]) -> (Vector2<f64>, Vector2<f64>) {
    let bound = |pick: fn(f64, f64) -> f64, start: f64| {
        arrows.iter().fold(Vector2::repeat(start), |b, (p, _)| b.zip_map(&p.coords, pick))
    };
    (bound(f64::min, f64::INFINITY), bound(f64::max, f64::NEG_INFINITY))
}

/// Magnification of residuals in all views: 1, 2 or 5 times a power of ten.
pub(super) fn magnification(views: &[Vec<Arrow>]) -> f64 {
    let mut lengths: Vec<f64> = views.iter().flatten().map(|(_, r)| r.norm()).collect();
    lengths.sort_by(f64::total_cmp);
    let long = lengths.get(lengths.len() * 19 / 20).copied().unwrap_or_default().max(1e-9);
    let side = views.iter().map(|arrows| {
        let (low, high) = bounds(arrows);
        (high - low).max()
    });
    round_down(side.fold(f64::INFINITY, f64::min).max(1.0) * DRAWN / long).max(1.0)
}

/// The next 1, 2 or 5 times a power of ten below.
fn round_down(value: f64) -> f64 {
    if !(value.is_finite() && value > 0.0) {
        return 1.0;
    }
    let power = 10_f64.powf(value.log10().floor());
    [5.0, 2.0].into_iter().find(|step| value >= step * power).unwrap_or(1.0) * power
}

/// Residuals of a view at their positions in the picture, magnified by `times`; means of neighbourhoods in bold.
pub(super) fn residuals(done: &RigCalibration, view: usize, arrows: &[Arrow], times: f64) -> Plot {
    let (low, high) = bounds(arrows);
    let margin = (high - low).max() * 0.07;
    let range = |from: f64, to: f64| vec![rounded(from, 1).unwrap_or(0.0), rounded(to, 1).unwrap_or(1.0)];
    // A scale bar of the size of a typical residual, below the corners.
    let sample_px = round_down((high - low).max() * 0.12 / times);
    let (left, below) = (low.x, high.y + margin * 0.9);
    let layout = chart::layout()
        .x_axis(
            chart::value_axis("x in the picture (px)")
                .zero_line(false)
                .constrain(AxisConstrain::Domain)
                .range(range(low.x - margin, high.x + margin)),
        )
        .y_axis(
            chart::value_axis("y (px)")
                .zero_line(false)
                .constrain(AxisConstrain::Domain)
                .scale_anchor("x")
                .range(range(high.y + 2.0 * margin, low.y - margin)),
        )
        .annotations(vec![
            Annotation::new()
                .text(format!("{sample_px} px"))
                .x(left + sample_px * times)
                .y(below)
                .x_shift(22.0)
                .show_arrow(false)
                .font(chart::font(12, INK)),
        ])
        .show_legend(false)
        .hover_mode(HoverMode::Closest)
        .margin(Margin::new().left(56).right(10).top(12).bottom(44));
    let mut plot = chart::plot(layout);
    for (picture, (_, used)) in done.used.iter().enumerate() {
        let (mut x, mut y, mut texts) = (Vec::new(), Vec::new(), Vec::new());
        for (_, (from, residual)) in pictures(done, view).zip(arrows).filter(|(own, _)| *own == picture) {
            let to = from + residual * times;
            x.extend([rounded(from.x, 1), rounded(to.x, 1), None]);
            y.extend([rounded(from.y, 1), rounded(to.y, 1), None]);
            texts.extend([format!("{:.3} px", residual.norm()), format!("{:.3} px", residual.norm()), String::new()]);
        }
        plot.add_trace(
            Scatter::new(x, y)
                .name(escape(&used.name))
                .mode(Mode::Lines)
                .line(Line::new().width(1.1).color(css_faint(CURVE, 0.55)))
                .connect_gaps(false)
                .text_array(texts)
                .hover_template("%{fullData.name}: %{text}<extra></extra>"),
        );
    }
    let coordinate = |k: usize| arrows.iter().map(|(p, _)| rounded(p[k], 1)).collect::<Vec<_>>();
    plot.add_trace(
        Scatter::new(coordinate(0), coordinate(1))
            .mode(Mode::Markers)
            .marker(Marker::new().size(2).color(css(CURVE)))
            .hover_info(HoverInfo::Skip),
    );
    let (mut x, mut y) = (vec![rounded(left, 1), rounded(left + sample_px * times, 1), None], Vec::new());
    y.extend([rounded(below, 1), rounded(below, 1), None]);
    for Neighbourhood { middle, mean_px, .. } in neighbourhoods(arrows) {
        let to = middle + mean_px * times;
        x.extend([rounded(middle.x, 1), rounded(to.x, 1), None]);
        y.extend([rounded(middle.y, 1), rounded(to.y, 1), None]);
    }
    plot.add_trace(
        Scatter::new(x, y)
            .mode(Mode::Lines)
            .line(Line::new().width(3.0).color(css(PALETTE.miss)))
            .connect_gaps(false)
            .hover_info(HoverInfo::Skip),
    );
    plot
}

/// RMS residual of each picture in each view, and the noise of all.
pub(super) fn by_picture(done: &RigCalibration, views: &[(String, Vec<Arrow>)]) -> Plot {
    let names: Vec<String> = done.used.iter().map(|(_, used)| escape(&used.name)).collect();
    let axis = chart::value_axis("RMS of a coordinate (px)").range_mode(RangeMode::ToZero);
    // Names are not numbers, even if they look like it.
    let each = chart::value_axis("").type_(plotly::layout::AxisType::Category).tick_angle(-40.0);
    let layout = chart::layout()
        .bar_mode(BarMode::Group)
        .x_axis(each)
        .y_axis(axis)
        .margin(Margin::new().left(64).right(16).top(28).bottom(80));
    let mut plot = chart::plot(layout);
    for (view, (name, arrows)) in views.iter().enumerate() {
        let rms = |picture: usize| {
            let own: Vec<f64> = pictures(done, view)
                .zip(arrows)
                .filter(|(of, _)| *of == picture)
                .map(|(_, (_, r))| r.norm_squared())
                .collect();
            // A picture not seen in this view has no bar.
            rounded((own.iter().sum::<f64>() / (2 * own.len()) as f64).sqrt(), 4)
        };
        plot.add_trace(
            Bar::new(names.clone(), (0..names.len()).map(rms).collect::<Vec<_>>())
                .name(escape(name))
                .marker(Marker::new().color(css(chart::view_colour(view))))
                .hover_template("%{y:.3f} px"),
        );
    }
    let noise = rounded(done.solution.corner_sd_px, 4);
    plot.add_trace(
        Scatter::new(names.clone(), vec![noise; names.len()])
            .name("noise of a corner")
            .mode(Mode::Lines)
            .line(Line::new().width(1.4).color(INK).dash(plotly::common::DashType::Dot))
            .hover_template("%{y:.3f} px"),
    );
    plot
}

/// Correlations of the parameters.
pub(super) fn correlations(names: &[String], correlations: &DMatrix<f64>) -> Plot {
    let labels: Vec<String> = names.iter().map(|name| escape(name)).collect();
    let rows = correlations.row_iter().map(|row| row.iter().map(|r| rounded(*r, 3)).collect::<Vec<_>>()).collect();
    let element = |at: f64, colour: &str| ColorScaleElement(at, colour.to_owned());
    let axis = || chart::value_axis("").zero_line(false).show_grid(false).type_(plotly::layout::AxisType::Category);
    let layout = chart::layout()
        .x_axis(axis().tick_angle(-50.0).constrain(AxisConstrain::Domain))
        // The first at the top, as in a table.
        .y_axis(axis().range(vec![names.len() as f64 - 0.5, -0.5]).scale_anchor("x").constrain(AxisConstrain::Domain))
        .hover_mode(HoverMode::Closest)
        .margin(Margin::new().left(170).right(10).top(12).bottom(150));
    let mut plot = chart::plot(layout);
    plot.add_trace(
        HeatMap::new(labels.clone(), labels, rows)
            .color_scale(ColorScale::Vector(vec![
                element(0.0, "#b2182b"),
                element(0.25, "#f4a582"),
                element(0.5, "#ffffff"),
                element(0.75, "#92c5de"),
                element(1.0, "#2166ac"),
            ]))
            .zmin(-1.0)
            .zmax(1.0)
            .color_bar(ColorBar::new().thickness(12).outline_width(0).tick_font(chart::font(12, QUIET)))
            .hover_template("%{y}, %{x}: %{z:.2f}<extra></extra>"),
    );
    plot
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn magnifications_are_round() {
        for (value, round) in [(1.0, 1.0), (4.9, 2.0), (5.0, 5.0), (73.0, 50.0), (999.0, 500.0), (0.034, 0.02)] {
            assert!((round_down(value) / round - 1.0).abs() < 1e-12, "{value}: {}", round_down(value));
        }
        assert_eq!((round_down(f64::NAN), round_down(0.0)), (1.0, 1.0));
    }
}
