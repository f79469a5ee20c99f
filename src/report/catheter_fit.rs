//! The page of a catheter that was fitted to runs.

use super::chart::{self, CURVE, PALETTE, css};
use super::html::escape;
use super::page::{self, card, facts_table, figure, table, trouble};
use super::timeline::Timeline;
use crate::catheter::{Check, Fit, Run};
use plotly::common::{Line, Marker, Mode};
use plotly::layout::HoverMode;
use plotly::{Plot, Scatter};

/// The page. For each run: the observation, the fitted catheter's result, and whether it was used in the fit.
pub(crate) fn page(fit: &Fit, runs: &[(&Run, &Check, bool)], settings: &[(String, String)]) -> String {
    let worst = runs.iter().map(|(_, check, _)| check.tip_rms_m).fold(0.0, f64::max);
    let cards = [
        card("Residuals", format!("{:.2}", fit.misfit), "times the noise", fit.misfit > 1.5),
        card("Tip", format!("{:.3} mm", worst * 1e3), "RMS of the worst run", false),
        card("Not determined", fit.open.len().to_string(), "parameters", !fit.open.is_empty()),
        card(
            "Pauses at rest",
            fit.pauses.len().to_string(),
            format!("{} not settled", fit.unsettled),
            fit.unsettled > 0,
        ),
    ];
    let rows: Vec<Vec<String>> = fit
        .estimated
        .iter()
        .map(|e| {
            let (unit, scale) = e.parameter.unit();
            let words = e.parameter.words().trim_start_matches("the ").to_owned();
            let digits = digits_of(e.sd * scale);
            vec![words, format!("{:.digits$}", e.value * scale), format!("{:.digits$}", e.sd * scale), unit.to_owned()]
        })
        .collect();
    let open: String = fit.open.iter().map(|open| format!("<li>{}</li>\n", escape(&open.sentence()))).collect();
    let open = if open.is_empty() { String::new() } else { format!("<h2>Not determined</h2>\n<ul>\n{open}</ul>\n") };
    let widening = fit.widening().map_or(String::new(), |words| format!(" Here {}.", escape(&words)));
    let names: Vec<&str> = std::iter::once("").chain(fit.estimated.iter().map(|e| e.parameter.name())).collect();
    let correlations: Vec<Vec<String>> = fit
        .estimated
        .iter()
        .enumerate()
        .map(|(k, e)| {
            let cells = fit.correlation.row(k).iter().map(|c| page::signed(*c, 2)).collect::<Vec<_>>();
            std::iter::once(e.parameter.name().to_owned()).chain(cells).collect()
        })
        .collect();
    let of_runs: String = runs.iter().enumerate().map(|(k, run)| of_run(k, run)).collect();
    let noise = format!("{:.3} mm, {:.3}°", fit.noise.point_m * 1e3, fit.noise.angle_rad.to_degrees());
    let mut facts = vec![
        ("Fitted to".to_owned(), if fit.in_motion { "all frames, in motion" } else { "shapes at rest" }.to_owned()),
        ("Noise".to_owned(), noise),
    ];
    facts.extend(settings.iter().cloned());
    let body = format!(
        "<header>\n<p class=\"kind\">Catoptra catheter: fit</p>\n<h1>{}</h1>\n</header>\n<dl class=\"key\">\n{}</dl>\n\
         <h2>Values</h2>\n<p>σ is that of the noise, larger where residuals are larger than the \
         noise.{widening}</p>\n{}{open}\
         <h2>Correlations</h2>\n<p>Near ±1 two values cannot be told apart.</p>\n{}{of_runs}<h2>Settings</h2>\n{}\
         {}",
        escape(&runs.iter().map(|(run, ..)| run.name.as_str()).collect::<Vec<_>>().join(", ")),
        cards.concat(),
        table(1, &["", "value", "σ", "unit"], &rows),
        table(1, &names, &correlations),
        facts_table(&facts),
        page::footer(""),
    );
    page::page("Fitted catheter", &body)
}

fn of_run(index: usize, (run, check, fitted): &(&Run, &Check, bool)) -> String {
    let word = if *fitted { "fitted" } else { "not fitted: it judges the values" };
    let signs = trouble(
        "residuals that follow the motion (the model is wrong), or that drift (the rig moved, or the catheter creeps).",
    );
    format!(
        "<h2>{}</h2>\n<p>{word}. RMS: tip {:.3} mm, coil set {:.3} mm, θ {:.3}°.</p>\n{}{}{signs}",
        escape(&run.name),
        check.tip_rms_m * 1e3,
        check.coil_rms_m * 1e3,
        check.theta_rms_rad.to_degrees(),
        figure(&format!("plot-theta-{index}"), &theta(run, check), 320, false),
        figure(&format!("plot-residual-{index}"), &residuals(run, check), 320, false),
    )
}

/// Digits after the point that show three digits of σ, and no fewer than four.
fn digits_of(sd: f64) -> usize {
    let digits = 2.0 - sd.abs().log10().floor();
    if digits.is_finite() { digits.clamp(4.0, 12.0) as usize } else { 4 }
}

fn plot(title: &str) -> Plot {
    let layout = chart::layout()
        .x_axis(chart::value_axis("Time (s)"))
        .y_axis(chart::value_axis(title))
        .hover_mode(HoverMode::XUnified);
    chart::plot(layout)
}

/// What was seen and what the model says, over time: θ of both, degrees, then the tip's differences, mm.
fn timeline(run: &Run, check: &Check) -> Timeline {
    let mut line = Timeline::default();
    for (seen, model) in run.sightings.iter().zip(&check.moments) {
        let theta = seen.tangent.map(|t| t.x.atan2(t.z).to_degrees());
        let off = |axis: usize| seen.tip.map(|tip| (tip - model.tip)[axis] * 1e3);
        let values = [theta, Some(model.theta_rad().to_degrees()), off(0), off(1), off(2)];
        line.push(seen.time_s, 0, &values, &[]);
    }
    line
}

/// A curve of [`timeline`].
fn points(line: &Timeline, channel: usize) -> chart::Points {
    let values = line.bins().iter().map(|bin| bin.channels.get(channel).copied().flatten());
    chart::curve(line.bins(), values, 4)
}

fn theta(run: &Run, check: &Check) -> Plot {
    let mut plot = plot("θ (°)");
    let line = timeline(run, check);
    let ((seen_s, seen), (model_s, model)) = (points(&line, 0), points(&line, 1));
    plot.add_trace(
        Scatter::new(seen_s, seen)
            .name("seen")
            .mode(Mode::Markers)
            .marker(Marker::new().size(3).color(css(PALETTE.marker(1)))),
    );
    plot.add_trace(
        Scatter::new(model_s, model).name("model").mode(Mode::Lines).line(Line::new().width(1.4).color(css(CURVE))),
    );
    plot
}

fn residuals(run: &Run, check: &Check) -> Plot {
    let mut plot = plot("Tip, seen − model (mm)");
    let line = timeline(run, check);
    for (axis, name) in ["x", "y", "z"].into_iter().enumerate() {
        let (time, off) = points(&line, axis + 2);
        let marker = Marker::new().size(3).color(css(PALETTE.marker(axis)));
        plot.add_trace(Scatter::new(time, off).name(name).mode(Mode::Markers).marker(marker));
    }
    plot
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::catheter::{Catheter, Noise};
    use nalgebra::DMatrix;

    #[test]
    fn sigma_that_was_widened_is_told() {
        let fit = |widened| Fit {
            catheter: Catheter::prototype(),
            delay_s: 0.0,
            estimated: Vec::new(),
            correlation: DMatrix::zeros(0, 0),
            open: Vec::new(),
            pauses: Vec::new(),
            unsettled: 0,
            noise: Noise { point_m: 1e-5, angle_rad: 1e-3, missing: 0.0 },
            misfit: 1.0,
            wiring: None,
            widened,
            in_motion: true,
        };
        let told = |widened| page(&fit(widened), &[], &[]).contains("σ are up to 2.5 times as large");
        assert!(told(2.5) && !told(1.0));
    }

    #[test]
    fn small_values_keep_digits_of_their_sigma() {
        assert_eq!([0.0, 1.0, 3.4e-4, 2e-7, f64::NAN].map(digits_of), [4, 4, 6, 9, 4]);
    }
}
