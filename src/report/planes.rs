//! The page of a model of both planes: measured and simulated angles, responses from each coil to each angle.

use super::chart::{self, CURVE, PALETTE, QUIET, css, rounded};
use super::html::escape;
use super::page::{self, card, figure, table};
use super::timeline::Timeline;
use crate::identify::planes::{Motion, OUTPUTS, Planes, RecordFit, System, Tried};
use plotly::common::{Line, Marker, Mode};
use plotly::layout::AxisType;
use plotly::{Plot, Scatter};
use std::f64::consts::TAU;

/// The whole page.
pub(crate) fn page(found: &Planes, coils: &[String], records: &[&Motion]) -> String {
    let name = records.first().map(|record| record.name.clone()).unwrap_or_default();
    let last = found.judged.last();
    let errors = |of: fn(&RecordFit) -> [f64; 2]| {
        last.map_or_else(String::new, |judged| of(judged).map(|p| format!("{p:.2}")).join(" and "))
    };
    let cards = [
        card("Order", found.order.to_string(), format!("{} coefficients per angle", found.coefficients), false),
        card("States kept", found.reduced.order().to_string(), format!("of {}", found.full.order()), false),
        card("Error energy", errors(|j| j.full), "%, last record", false),
        card("Reduced", errors(|j| j.reduced), "%, last record", false),
    ];
    let mut body = format!(
        "<h1>Both planes</h1>\n<p class=\"sub\">{}, from {}</p>\n{}<dl class=\"key\">\n{}</dl>\n",
        escape(&name),
        escape(&coils.join(", ")),
        page::doubts(&found.diagnostics),
        cards.concat()
    );
    body += "<h2>Error energy of the simulation, percent</h2>\n";
    body += &judged(found);
    for (k, (record, own)) in records.iter().zip(&found.judged).enumerate() {
        let what = if own.fitted { "fitted" } else { "not fitted" };
        body += &format!("<h2>{} ({what})</h2>\n", escape(&record.name));
        for (j, angle) in OUTPUTS.iter().enumerate() {
            body += &figure(&format!("plot-{k}-{angle}"), &course(record, own, j), 260, false);
        }
    }
    body += "<h2>Response</h2>\n<p>From each coil to each angle, about the point around which the catheter moved. \
             Thin: full order; thick: reduced.</p>\n";
    for (j, angle) in OUTPUTS.iter().enumerate() {
        body += &figure(&format!("plot-response-{angle}"), &response(found, coils, j), 320, false);
    }
    body += "<h2>Hankel singular values</h2>\n<p>Of both planes together; those kept are filled.</p>\n";
    body += &figure("plot-hankel", &hankel(found), 260, false);
    body += "<h2>Orders tried</h2>\n";
    let of = if found.by_simulation { "error of the judging records, %" } else { "error of the fitted records, %" };
    let row = |tried: &Tried| {
        let taken = if tried.order == found.order { " (taken)" } else { "" };
        vec![
            format!("{}{taken}", tried.order),
            format!("{:.4}", tried.description_length),
            format!("{:.4}", tried.error_percent),
        ]
    };
    let rows: Vec<Vec<String>> = found.tried.iter().map(row).collect();
    body += &table(0, &["order", "description length", of], &rows);
    body += &page::footer("");
    page::page(&format!("Both planes of {name}"), &body)
}

fn judged(found: &Planes) -> String {
    let heads = ["record", "fitted", "x, full", "y, full", "x, reduced", "y, reduced"];
    let row = |judged: &RecordFit| {
        let fitted = if judged.fitted { "yes" } else { "no" };
        let mut row = vec![judged.name.clone(), fitted.to_owned()];
        row.extend(judged.full.iter().chain(&judged.reduced).map(|p| format!("{p:.4}")));
        row
    };
    table(2, &heads, &found.judged.iter().map(row).collect::<Vec<_>>())
}

fn course(record: &Motion, own: &RecordFit, output: usize) -> Plot {
    let name = if output == 0 { "angle in the plane of B0 (°)" } else { "angle across it (°)" };
    let layout = chart::layout().x_axis(chart::value_axis("time (s)")).y_axis(chart::value_axis(name));
    let mut plot = chart::plot(layout);
    let matrices = [&record.output, &own.full_rad, &own.reduced_rad];
    let mut line = Timeline::default();
    for k in 0..record.output.nrows() {
        let values = matrices.map(|matrix| matrix.get((k, output)).map(|rad| rad.to_degrees()));
        line.push(record.start_s + k as f64 * record.period_s, 0, &values, &[]);
    }
    let styles = [
        ("measured", Line::new().color(QUIET).width(1.0)),
        ("full", Line::new().color(css(PALETTE.gap)).width(1.0)),
        ("reduced", Line::new().color(css(CURVE)).width(1.6)),
    ];
    for (channel, (name, style)) in styles.into_iter().enumerate() {
        let values = line.bins().iter().map(|bin| bin.channels.get(channel).copied().flatten());
        let (time, values) = chart::curve(line.bins(), values, 4);
        plot.add_trace(Scatter::new(time, values).name(name).mode(Mode::Lines).line(style).connect_gaps(false));
    }
    plot
}

fn response(found: &Planes, coils: &[String], output: usize) -> Plot {
    let frequency = chart::value_axis("frequency (Hz)").type_(AxisType::Log);
    let title = format!("{} (° / A)", OUTPUTS.get(output).copied().unwrap_or_default());
    let mut plot = chart::plot(chart::layout().x_axis(frequency).y_axis(chart::log_axis(&title)));
    let frequencies = found.frequencies_hz();
    for (k, coil) in coils.iter().enumerate() {
        for (system, width) in [(&found.full, 0.8), (&found.reduced, 2.2)] {
            let at = |system: &System, f: f64| {
                Some(system.response(TAU * f * found.period_s)?[(output, k)].norm().to_degrees())
            };
            let values: Vec<_> = frequencies.iter().map(|f| at(system, *f).and_then(|v| rounded(v, 5))).collect();
            let line = Line::new().color(css(PALETTE.marker(k))).width(width);
            let x: Vec<_> = frequencies.iter().map(|f| rounded(*f, 5)).collect();
            plot.add_trace(
                Scatter::new(x, values).name(escape(coil)).mode(Mode::Lines).line(line).show_legend(width > 1.0),
            );
        }
    }
    plot
}

fn hankel(found: &Planes) -> Plot {
    let layout =
        chart::layout().x_axis(chart::value_axis("state")).y_axis(chart::log_axis("singular value")).show_legend(false);
    let mut plot = chart::plot(layout);
    let kept = found.reduced.order();
    let shown = found.hankel.iter().take(40).enumerate();
    let colours: Vec<String> =
        shown.clone().map(|(k, _)| if k < kept { css(CURVE) } else { "#d0d4da".to_owned() }).collect();
    let (x, y): (Vec<usize>, Vec<f64>) = shown.map(|(k, v)| (k + 1, *v)).unzip();
    plot.add_trace(Scatter::new(x, y).mode(Mode::Markers).marker(Marker::new().size(9).color_array(colours)));
    plot
}
