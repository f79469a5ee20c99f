//! The plot of lost frames and of misses by reason, as bars on the time axis.

use super::chart::{self, PALETTE, css, rounded};
use super::course::Course;
use super::html::escape;
use super::timeline::Bin;
use crate::estimate::plain_words;
use crate::plural::plural;
use crate::sink::Rgb;
use plotly::common::{Anchor, Line, Marker, MarkerSymbol, Mode};
use plotly::layout::{Annotation, HoverMode, Margin};
use plotly::{Plot, Scatter};

/// One line of bars.
struct Row {
    name: String,
    colour: Rgb,
    bars: Vec<Bar>,
}

struct Bar {
    from_s: f64,
    to_s: f64,
    text: String,
}

/// One row for the frames that are `lost`, or whatever the word for them is, and one for each reason of a miss.
pub(super) fn absences(course: &Course, time: &str, lost: &str) -> Plot {
    let bins = course.timeline.bins();
    let mut rows = vec![Row { name: format!("frames {lost}"), colour: PALETTE.gap, bars: gaps(bins, lost) }];
    rows.extend(course.reasons.iter().enumerate().map(|(number, (what, why))| Row {
        name: format!("{what}: {}", plain_words(why)),
        colour: PALETTE.miss,
        bars: misses(bins, number),
    }));
    let levels: Vec<f64> = (0..rows.len()).map(|k| -(k as f64)).collect();
    // Names are above their rows, inside the plot, so that the time axis lines up with those of the other plots.
    let names = rows.iter().zip(&levels).map(|(row, level)| {
        Annotation::new()
            .text(escape(&row.name))
            .x_ref("paper")
            .x(0.0)
            .x_anchor(Anchor::Left)
            .y(level + 0.42)
            .show_arrow(false)
            .font(chart::font(12, chart::QUIET))
    });
    let layout = chart::layout()
        .annotations(names.collect())
        .x_axis(chart::time_axis(time, bins))
        .y_axis(
            chart::value_axis("")
                .tick_values(levels.clone())
                .show_tick_labels(false)
                .range(vec![0.6 - rows.len() as f64, 0.75])
                .zero_line(false)
                .fixed_range(true),
        )
        .hover_mode(HoverMode::Closest)
        .margin(Margin::new().left(64).right(16).top(8).bottom(44))
        .show_legend(false);
    let mut plot = chart::plot(layout);
    for (row, level) in rows.into_iter().zip(levels) {
        let (mut t, mut v, mut text) = (Vec::new(), Vec::new(), Vec::new());
        for bar in row.bars {
            t.extend([rounded(bar.from_s, 6), rounded(bar.to_s, 6), None]);
            v.extend([Some(level), Some(level), None]);
            text.extend([bar.text.clone(), bar.text, String::new()]);
        }
        plot.add_trace(
            Scatter::new(t, v)
                .name(row.name)
                .mode(Mode::LinesMarkers)
                .line(Line::new().width(12.0).color(css(row.colour)))
                // The ends make even short bars visible.
                .marker(Marker::new().symbol(MarkerSymbol::LineNSOpen).size(8).color(css(row.colour)))
                .text_array(text)
                .hover_template("%{x:.3f} s: %{text}"),
        );
    }
    plot
}

/// From the last frame before a gap to the first after it; within a bin of many frames, the bin.
fn gaps(bins: &[Bin], word: &str) -> Vec<Bar> {
    let lossy = bins.iter().filter(|b| b.lost > 0);
    lossy
        .map(|b| Bar {
            from_s: if b.lost_before > 0 { b.before_s } else { b.from_s },
            to_s: if b.lost == b.lost_before { b.from_s } else { b.to_s },
            text: format!("{} {word}", b.lost),
        })
        .collect()
}

/// Bins with a miss for this reason; neighbours without a gap between them form one bar.
fn misses(bins: &[Bin], number: usize) -> Vec<Bar> {
    let half_s = chart::half_interval_s(bins);
    let mut bars: Vec<Bar> = Vec::new();
    let mut frames = 0;
    let mut joins = false;
    for bin in bins {
        let count = bin.misses.get(number).copied().unwrap_or(0);
        if count > 0 {
            let (from_s, to_s) = (bin.from_s - half_s, bin.to_s + half_s);
            let text = |n: u32| plural(n, "frame");
            match bars.last_mut() {
                Some(bar) if joins && bin.lost_before == 0 => {
                    frames += count;
                    (bar.to_s, bar.text) = (to_s, text(frames));
                }
                _ => {
                    frames = count;
                    bars.push(Bar { from_s, to_s, text: text(frames) });
                }
            }
        }
        joins = count > 0;
    }
    bars
}
