//! The page of a catheter that was fitted to runs.

use super::chart::{self, CURVE, PALETTE, css, rounded};
use super::html::escape;
use super::page::{self, card, facts_table, figure, table, trouble};
use crate::catheter::{Check, Fit, Run};
use plotly::common::{Line, Marker, Mode};
use plotly::layout::HoverMode;
use plotly::{Plot, Scatter};

/// Most points of a curve.
const MAX_POINTS: usize = 3000;

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
            vec![words, format!("{:.4}", e.value * scale), format!("{:.4}", e.sd * scale), unit.to_owned()]
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
         <footer>Catoptra {}. This file needs no network.</footer>\n",
        escape(&runs.iter().map(|(run, ..)| run.name.as_str()).collect::<Vec<_>>().join(", ")),
        cards.concat(),
        table(1, &["", "value", "σ", "unit"], &rows),
        table(1, &names, &correlations),
        facts_table(&facts),
        env!("CARGO_PKG_VERSION"),
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

fn plot(title: &str) -> Plot {
    let layout = chart::layout()
        .x_axis(chart::value_axis("Time (s)"))
        .y_axis(chart::value_axis(title))
        .hover_mode(HoverMode::XUnified);
    chart::plot(layout)
}

/// Stride of frames, so that a curve stays within the most points.
fn stride(run: &Run) -> usize {
    run.sightings.len().div_ceil(MAX_POINTS).max(1)
}

fn theta(run: &Run, check: &Check) -> Plot {
    let mut plot = plot("θ (°)");
    let both = || run.sightings.iter().zip(&check.moments).step_by(stride(run));
    let time = || both().map(|(s, _)| rounded(s.time_s, 4)).collect::<Vec<_>>();
    let seen = both().map(|(s, _)| s.tangent.and_then(|t| rounded(t.x.atan2(t.z).to_degrees(), 4)));
    let modelled = both().map(|(_, m)| rounded(m.theta_rad().to_degrees(), 4));
    plot.add_trace(
        Scatter::new(time(), seen.collect::<Vec<_>>())
            .name("seen")
            .mode(Mode::Markers)
            .marker(Marker::new().size(3).color(css(PALETTE.marker(1)))),
    );
    plot.add_trace(
        Scatter::new(time(), modelled.collect::<Vec<_>>())
            .name("model")
            .mode(Mode::Lines)
            .line(Line::new().width(1.4).color(css(CURVE))),
    );
    plot
}

fn residuals(run: &Run, check: &Check) -> Plot {
    let mut plot = plot("Tip, seen − model (mm)");
    for (axis, name) in ["x", "y", "z"].into_iter().enumerate() {
        let both = run.sightings.iter().zip(&check.moments).step_by(stride(run));
        let (time, off): (Vec<_>, Vec<_>) = both
            .map(|(s, m)| (rounded(s.time_s, 4), s.tip.and_then(|tip| rounded((tip - m.tip)[axis] * 1e3, 4))))
            .unzip();
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
            widened,
            in_motion: true,
        };
        let told = |widened| page(&fit(widened), &[], &[]).contains("σ are up to 2.5 times as large");
        assert!(told(2.5) && !told(1.0));
    }
}
