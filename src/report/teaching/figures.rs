//! The plots of the page.

use super::super::chart::{self, INK, css};
use super::super::html::escape;
use crate::calibrate::markers::ViewColours;
use crate::rig::Marker as Band;
use crate::sink::Palette;
use plotly::common::{DashType, HoverInfo, Line, Marker, MarkerSymbol, Mode};
use plotly::layout::{Axis, HoverMode, Shape, ShapeLine, ShapeType};
use plotly::{Plot, Scatter};

/// The axis of scores, and where a score beyond it is drawn.
const SCORES: [f64; 2] = [-1.5, 1.3];
const DRAWN: (f64, f64) = (-1.4, 1.25);

/// Limits of the scores of each band's samples, and of those of all other colours.
pub(super) fn separations(view: &ViewColours, markers: &[Band]) -> Plot {
    let threshold = Shape::new()
        .shape_type(ShapeType::Line)
        .y_ref("paper")
        .x0(0.5)
        .x1(0.5)
        .y0(0.0)
        .y1(1.0)
        .line(ShapeLine::new().color(INK).width(1.0).dash(DashType::Dot));
    let layout = chart::layout()
        .show_legend(false)
        .hover_mode(HoverMode::Closest)
        .shapes(vec![threshold])
        .x_axis(Axis::new().title("score").range(SCORES.to_vec()).zero_line(false))
        .y_axis(Axis::new().auto_margin(true));
    let mut plot = chart::plot(layout);
    for (m, marker) in markers.iter().enumerate().rev() {
        let own: Vec<_> = view.learned.separations.iter().filter(|s| s.marker == m).collect();
        let name = |s: &usize| escape(view.classes.get(*s).map_or("", String::as_str));
        let at = |v: f64| v.clamp(DRAWN.0, DRAWN.1);
        plot.add_trace(
            Scatter::new(own.iter().map(|s| at(s.other_high)).collect(), vec![escape(&marker.name); own.len()])
                .mode(Mode::Markers)
                .hover_info(HoverInfo::Text)
                .hover_text_array(
                    own.iter().map(|s| format!("{}: 99 % below {:.2}", name(&s.other), s.other_high)).collect(),
                )
                .marker(Marker::new().symbol(MarkerSymbol::CircleOpen).size(9).color(INK)),
        );
        if let Some(first) = own.first() {
            plot.add_trace(
                Scatter::new(vec![at(first.marker_low), 1.0], vec![escape(&marker.name); 2])
                    .mode(Mode::LinesMarkers)
                    .hover_info(HoverInfo::Text)
                    .line(Line::new().width(5.0).color(css(Palette::ON_WHITE.marker(m))))
                    .marker(Marker::new().size(9).color(css(Palette::ON_WHITE.marker(m))))
                    .hover_text_array(vec![
                        format!("the band: 99 % above {:.2}", first.marker_low),
                        "the band’s mean".to_owned(),
                    ]),
            );
        }
    }
    plot
}
