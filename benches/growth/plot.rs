//! One plot: costs over what grows, both axes logarithmic.

use plotters::prelude::*;
use std::error::Error;
use std::path::Path;

/// Writes lines with their names.
pub(crate) fn write(
    file: &Path,
    what: &str,
    lines: &[(&str, Vec<(f64, f64)>)],
) -> Result<(), Box<dyn Error + Send + Sync>> {
    let all = || lines.iter().flat_map(|(_, line)| line);
    let range = |of: fn(&(f64, f64)) -> f64, room: f64| {
        let (low, high) = all().map(of).fold((f64::INFINITY, 0.0_f64), |(low, high), v| (low.min(v), high.max(v)));
        low / room..high * room
    };
    let area = SVGBackend::new(file, (560, 340)).into_drawing_area();
    area.fill(&WHITE)?;
    let mut chart = ChartBuilder::on(&area)
        .margin(12)
        .x_label_area_size(42)
        .y_label_area_size(56)
        .build_cartesian_2d(range(|p| p.0, 1.05).log_scale(), range(|p| p.1, 1.5).log_scale())?;
    let short = |v: &f64| if *v < 0.95 { format!("{v:.1}") } else { format!("{v:.0}") };
    let mut mesh = chart.configure_mesh();
    mesh.x_desc(what).y_desc("ms per frame, one thread").light_line_style(WHITE);
    mesh.x_label_formatter(&|_| String::new()).y_label_formatter(&short).draw()?;
    for (i, (name, line)) in lines.iter().enumerate() {
        let colour = Palette99::pick(i).to_rgba();
        chart
            .draw_series(LineSeries::new(line.iter().copied(), colour.stroke_width(2)).point_size(3))?
            .label(*name)
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 18, y)], colour.stroke_width(2)));
    }
    // What grows is written below the points of the last line, not at the axis.
    let named =
        |point: &(f64, f64)| EmptyElement::at(*point) + Text::new(point.0.to_string(), (-4, 7), ("sans-serif", 11));
    chart.draw_series(lines.last().iter().flat_map(|(_, line)| line).map(named))?;
    chart.configure_series_labels().position(SeriesLabelPosition::UpperLeft).border_style(BLACK.mix(0.3)).draw()?;
    area.present()?;
    Ok(())
}
