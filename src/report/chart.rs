//! The look of all plots: one typeface, unobtrusive grids, colours by meaning; and curves from the bins of a timeline.

use super::html::escape;
use super::timeline::{Bin, Extremes};
use crate::sink::{Palette, Rgb};
use plotly::common::{Anchor, ExponentFormat, Font, Line, Mode, Orientation, Title};
use plotly::configuration::{DisplayModeBar, ModeBarButtonName};
use plotly::layout::{
    AspectMode, AspectRatio, Axis, AxisType, Camera, CameraCenter, DragMode3D, Eye, HoverMode, LayoutScene, Legend,
    Margin, Up,
};
use plotly::{Configuration, Layout, Plot, Scatter};

pub(super) const PALETTE: Palette = Palette::ON_WHITE;
pub(super) const INK: &str = "#24292f";
pub(super) const QUIET: &str = "#6b7280";
pub(super) const GRID: &str = "#e8eaed";
pub(super) const CURVE: Rgb = [0, 92, 148];
/// Up to this many points a curve also shows them as dots: a single point makes no line.
const DOTTED_UP_TO: usize = 120;

/// By this much the eye of a 3D plot is farther away than where the box fills the plot.
const FARTHER: f64 = 1.2;

/// A curve: time and value; `None` breaks the line.
pub(super) type Points = (Vec<Option<f64>>, Vec<Option<f64>>);

/// `rgb()` of CSS.
pub(super) fn css([r, g, b]: Rgb) -> String {
    format!("rgb({r},{g},{b})")
}

/// `rgba()` of CSS.
pub(super) fn css_faint([r, g, b]: Rgb, opacity: f64) -> String {
    format!("rgba({r},{g},{b},{opacity})")
}

/// Colour of a view on every page. Leaves out the markers' blue, which is like that of the first view.
pub(super) fn view_colour(view: usize) -> Rgb {
    match view {
        0 => CURVE,
        1 | 2 => PALETTE.marker(view - 1),
        _ => PALETTE.marker(view),
    }
}

/// Rounds to this many digits after the point, and no fewer than four digits in all: the page has tens of thousands of
/// numbers. NaN and infinity become `None`.
pub(super) fn rounded(value: f64, digits: i32) -> Option<f64> {
    let leading = value.abs().log10().floor();
    let digits = if leading.is_finite() { digits.max(3 - leading as i32) } else { digits };
    let scale = 10_f64.powi(digits.min(300));
    let rounded = (value * scale).round() / scale;
    rounded.is_finite().then_some(rounded)
}

/// A channel as a curve through its smallest and largest values in time order, broken where frames are missing or lost.
pub(super) fn curve(bins: &[Bin], values: impl Iterator<Item = Option<Extremes>>, digits: i32) -> Points {
    let mut points: Points = (Vec::new(), Vec::new());
    let mut push = |t: Option<f64>, v: Option<f64>| {
        points.0.push(t.and_then(|t| rounded(t, 6)));
        points.1.push(v.and_then(|v| rounded(v, digits)));
    };
    let mut open = false;
    for (bin, value) in bins.iter().zip(values) {
        if open && (bin.lost_before > 0 || value.is_none()) {
            push(None, None);
            open = false;
        }
        let Some(Extremes { low, high }) = value else { continue };
        let (first, second) = if low.0 <= high.0 { (low, high) } else { (high, low) };
        push(Some(first.0), Some(first.1));
        if second.0 > first.0 {
            push(Some(second.0), Some(second.1));
        }
        open = true;
    }
    points
}

/// A band between two channels as closed outlines, one for every contiguous piece.
pub(super) fn band(
    bins: &[Bin],
    low: impl Iterator<Item = Option<Extremes>>,
    high: impl Iterator<Item = Option<Extremes>>,
    digits: i32,
) -> Points {
    let mut outlines: Points = (Vec::new(), Vec::new());
    let mut piece: Vec<(f64, f64, f64)> = Vec::new();
    let mut close = |piece: &mut Vec<(f64, f64, f64)>| {
        if piece.is_empty() {
            return;
        }
        let upper = piece.iter().map(|(t, _, high)| (*t, *high));
        let lower = piece.iter().rev().map(|(t, low, _)| (*t, *low));
        for (t, v) in upper.chain(lower) {
            outlines.0.push(rounded(t, 6));
            outlines.1.push(rounded(v, digits));
        }
        outlines.0.push(None);
        outlines.1.push(None);
        piece.clear();
    };
    for ((bin, low), high) in bins.iter().zip(low).zip(high) {
        if bin.lost_before > 0 || low.is_none() {
            close(&mut piece);
        }
        if let (Some(low), Some(high)) = (low, high) {
            piece.push((bin.from_s, low.low.1, high.high.1));
            if bin.to_s > bin.from_s {
                piece.push((bin.to_s, low.low.1, high.high.1));
            }
        }
    }
    close(&mut piece);
    outlines
}

/// A line trace in the style of the page.
pub(super) fn line(
    points: Points,
    name: &str,
    colour: Rgb,
    width: f64,
    hover: &str,
) -> Box<Scatter<Option<f64>, Option<f64>>> {
    let mode = if points.0.len() <= DOTTED_UP_TO { Mode::LinesMarkers } else { Mode::Lines };
    Scatter::new(points.0, points.1)
        .name(escape(name))
        .mode(mode)
        .line(Line::new().color(css(colour)).width(width))
        .marker(plotly::common::Marker::new().color(css(colour)).size(4))
        .connect_gaps(false)
        .hover_template(hover)
}

/// The time axis of every plot: from the first frame to the last, so that stacked plots line up.
pub(super) fn time_axis(title: &str, bins: &[Bin]) -> Axis {
    let axis = value_axis(title).zero_line(false);
    let (Some(first), Some(last)) = (bins.first(), bins.last()) else { return axis };
    let margin = half_interval_s(bins);
    match (rounded(first.from_s - margin, 6), rounded(last.to_s + margin, 6)) {
        (Some(from), Some(to)) if to > from => axis.range(vec![from, to]),
        _ => axis,
    }
}

/// Half of the typical time between frames, seconds.
pub(super) fn half_interval_s(bins: &[Bin]) -> f64 {
    let Some((first, last)) = bins.first().zip(bins.last()) else { return 0.0 };
    let frames: u64 = bins.iter().map(|b| u64::from(b.frames) + b.lost).sum();
    if frames > 1 { (last.to_s - first.from_s) / (frames - 1) as f64 / 2.0 } else { 0.0 }
}

/// A value axis with its unit in the title.
pub(super) fn value_axis(title: &str) -> Axis {
    Axis::new()
        .title(Title::with_text(escape(title)).font(font(13, QUIET)))
        .tick_font(font(12, QUIET))
        .grid_color(GRID)
        .zero_line_color("#b6bbc2")
        .zero_line_width(1)
}

/// A logarithmic value axis: powers of ten, not `10k` beside `100µ`.
pub(super) fn log_axis(title: &str) -> Axis {
    value_axis(title).type_(AxisType::Log).exponent_format(ExponentFormat::Power)
}

/// The frame of every plot: white, with the legend on top.
pub(super) fn layout() -> Layout {
    Layout::new()
        .auto_size(true)
        .font(font(13, INK))
        .paper_background_color("#ffffff")
        .plot_background_color("#ffffff")
        .margin(Margin::new().left(64).right(16).top(28).bottom(44))
        .hover_mode(HoverMode::XUnified)
        .legend(Legend::new().orientation(Orientation::Horizontal).x(0.0).y(1.02).y_anchor(Anchor::Bottom))
}

/// The axes of a 3D plot around values from smallest to largest, all to the same scale: the longest side of the box is
/// 1, and a flat one still gets some depth.
pub(super) fn scene(spans: [(f64, f64); 3], titles: [&str; 3]) -> LayoutScene {
    let longest = spans.iter().map(|(low, high)| high - low).fold(1e-3, f64::max);
    let ranges = spans.map(|(low, high)| {
        let (middle, half) = ((low + high) / 2.0, ((high - low) * 0.53).max(longest * 0.15));
        [middle - half, middle + half]
    });
    let [side_x, side_y, side_z] = ranges.map(|[low, high]| (high - low) / longest);
    let axis = |title: &str, [low, high]: [f64; 2]| -> Axis {
        let axis = value_axis(title).show_line(true).line_color(GRID).n_ticks(6);
        match (rounded(low, 4), rounded(high, 4)) {
            (Some(low), Some(high)) => axis.range(vec![low, high]),
            _ => axis,
        }
    };
    let ([title_x, title_y, title_z], [x, y, z]) = (titles, ranges);
    LayoutScene::new()
        .drag_mode(DragMode3D::Orbit) // the turntable mode supports only +z as up
        .aspect_mode(AspectMode::Manual)
        .aspect_ratio(AspectRatio::from((side_x, side_y, side_z)))
        .x_axis(axis(title_x, x))
        .y_axis(axis(title_y, y))
        .z_axis(axis(title_z, z))
}

/// Viewpoint of a 3D plot, from a little farther away: numbers and titles stand outside of the box. `scene.js` goes
/// farther still where the plot is narrow.
pub(super) fn eye(up: (f64, f64, f64), (x, y, z): (f64, f64, f64)) -> Camera {
    let eye = Eye::from((FARTHER * x, FARTHER * y, FARTHER * z));
    Camera::new().up(Up::from(up)).eye(eye).center(CameraCenter::from((0.0, 0.0, 0.0)))
}

/// A plot without logo and with only the useful buttons.
pub(super) fn plot(layout: Layout) -> Plot {
    let superfluous = vec![ModeBarButtonName::Select2d, ModeBarButtonName::Lasso2d, ModeBarButtonName::AutoScale2d];
    let mut plot = Plot::new();
    plot.set_layout(layout);
    plot.set_configuration(
        Configuration::new()
            .responsive(true)
            .display_logo(false)
            .display_mode_bar(DisplayModeBar::Hover)
            .mode_bar_buttons_to_remove(superfluous),
    );
    plot
}

pub(super) fn font(size: usize, colour: &'static str) -> Font {
    Font::new()
        .family("Inter, system-ui, -apple-system, 'Segoe UI', Roboto, 'Helvetica Neue', sans-serif")
        .size(size)
        .color(colour)
}

#[cfg(test)]
mod tests {
    use super::super::timeline::Timeline;
    use super::*;

    fn timeline() -> Timeline {
        let mut line = Timeline::default();
        for (t, lost, v) in
            [(0.0, 0, Some(1.0)), (0.1, 0, Some(2.0)), (0.2, 0, None), (0.3, 0, Some(3.0)), (0.6, 2, Some(4.0))]
        {
            line.push(t, lost, &[v], &[]);
        }
        line
    }

    #[test]
    fn curves_break_where_frames_are_missing_or_lost() {
        let line = timeline();
        let (t, v) = curve(line.bins(), line.bins().iter().map(|b| b.channels[0]), 3);
        assert_eq!(v, [Some(1.0), Some(2.0), None, Some(3.0), None, Some(4.0)]);
        assert_eq!(t, [Some(0.0), Some(0.1), None, Some(0.3), None, Some(0.6)]);
    }

    #[test]
    fn bands_are_closed_outlines_of_the_same_pieces() {
        let line = timeline();
        let channel = || line.bins().iter().map(|b| b.channels[0]);
        let (t, _) = band(line.bins(), channel(), channel(), 3);
        let first = [Some(0.0), Some(0.1), Some(0.1), Some(0.0), None];
        assert_eq!(t[..5], first);
        assert_eq!(t.iter().filter(|t| t.is_none()).count(), 3);
    }

    #[test]
    fn what_is_no_number_is_never_written() {
        assert_eq!([rounded(f64::NAN, 2), rounded(f64::INFINITY, 2), rounded(123.456, 2)], [None, None, Some(123.46)]);
    }

    #[test]
    fn small_values_keep_their_digits() {
        assert_eq!([1.234_56e-7, -0.000_345_678, 0.0].map(|v| rounded(v, 4)), [1.235e-7, -3.457e-4, 0.0].map(Some));
    }

    #[test]
    fn views_have_different_colours() {
        let colours: std::collections::BTreeSet<Rgb> = (0..5).map(view_colour).collect();
        assert_eq!(colours.len(), 5);
        assert!(!colours.contains(&PALETTE.marker(2)));
    }

    #[test]
    fn markup_in_names_stays_text() {
        let name = "<b>&\"tip</script>";
        let points: Points = (vec![Some(0.0)], vec![Some(1.0)]);
        let mut plot = plot(layout().y_axis(value_axis(name)));
        plot.add_trace(line(points, name, CURVE, 1.0, "%{y}"));
        let json = plot.to_json();
        assert!(json.contains("&lt;b&gt;&amp;&quot;tip&lt;/script&gt;") && !json.contains("<b>"), "{json}");
    }
}
