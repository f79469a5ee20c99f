//! The page of an identification: the models, how well they reproduce the data, and how reliable they are.
//!
//! In: data, result, and their origin. Out: one HTML file that needs no network.

mod applied;
mod figures;

pub(crate) use applied::applied_page;

use super::html::{Html, escape};
use super::page::{self, card, facts_table, figure, table};
use crate::digits::{digits_behind_first, fixed};
use crate::identify::chain::identification::{Fit, Identification};
use crate::identify::data::segments::Data;
use crate::identify::estimate::search::Candidate;
use crate::identify::estimate::unknown_zero::Zero;
use crate::identify::model::continuous::{Continuous, Conversion};
use crate::identify::model::modelled::{ContinuousEstimate, Modelled, Role};
use crate::identify::model::reproduction::{InitialState, Kind};
use crate::identify::results::provenance::{Provenance, RecordSummary};
use crate::plural::plural;
use figures::Shown;
use std::collections::BTreeMap;

/// The whole page.
pub(crate) fn page(data: &Data, done: &Identification, provenance: &Provenance) -> String {
    // The result comes first, then its quality, then its basis.
    let lines: Vec<_> = done.periodic.iter().flat_map(|p| p.lines().copied()).collect();
    let shown = Shown {
        models: &done.models,
        leading: done.leading().map(|m| m.role),
        spectrum: done.spectrum.as_ref(),
        lines: &lines,
    };
    let mut body = header(done, provenance);
    body += &cards(done, provenance);
    body += &transfer_functions(done);
    body += &table_1(done, provenance);
    body += &time_courses(data, &shown, provenance);
    body += &frequency(data, &shown);
    body += &periods(done);
    body += &orders(done);
    body += &reduction(done);
    body += &residuals(done);
    body += &facts(done, provenance);
    body += &page::footer("");
    page::page(&format!("Dynamics of {}", provenance.title), &body)
}

/// Up to five digits, and powers of ten where shorter.
fn number(value: f64) -> Html {
    number_to(value, 4)
}

/// With so many digits behind its first one.
fn number_to(value: f64, behind: usize) -> Html {
    let size = value.abs();
    if value == 0.0 {
        "0".into()
    } else if (1e-3..1e5).contains(&size) {
        let digits = (behind as i32 - size.log10().floor() as i32).max(0) as usize;
        format!("{value:.digits$}").replace('-', "−").into()
    } else {
        let text = format!("{value:.behind$e}");
        let (mantissa, exponent) = text.split_once('e').unwrap_or((&text, "0"));
        Html::raw(format!("{}·10<sup>{}</sup>", mantissa.replace('-', "−"), exponent.replace('-', "−")))
    }
}

fn percent(value: f64) -> Html {
    if !value.is_finite() {
        "diverges".into()
    } else if value < 1e4 {
        format!("{value:.4}").into()
    } else {
        number(value)
    }
}

fn header(done: &Identification, provenance: &Provenance) -> String {
    let orders = done.orders;
    let chosen = match done.criterion {
        Some(criterion) => format!("of {} models tried: {}", done.candidates.len(), criterion.rule()),
        None => "as asked for".to_owned(),
    };
    let reduced = done.model(Role::Reduced).map_or_else(
        || "It could not be reduced.".to_owned(),
        |m| format!("Reduced to order {}, and that order fitted to the data again.", m.model.memory()),
    );
    let answer = format!(
        "From {} to {}: na {}, nb {}, delay {} ({chosen}). {reduced}",
        escape(&provenance.input),
        escape(&provenance.output),
        orders.na,
        orders.nb,
        plural(orders.nk, "sample")
    );
    format!(
        "<header>\n<p class=\"kind\">Catoptra identification</p>\n<h1>{}</h1>\n<p \
         class=\"verdict\">{answer}</p>\n{}</header>\n",
        escape(&provenance.title),
        page::doubts(&done.diagnostics)
    )
}

/// The fit of a model to a record.
fn fit<'a>(done: &'a Identification, record: &RecordSummary, role: Role, kind: Kind) -> Option<&'a Fit> {
    done.fits
        .iter()
        .find(|f| f.record == record.name && f.training == record.training && f.role == role && f.kind == kind)
}

fn cards(done: &Identification, provenance: &Provenance) -> String {
    let record = provenance.records.iter().find(|r| !r.training).or(provenance.records.first());
    let mut cards = String::new();
    if let Some(record) = record {
        let of = if record.training { "training" } else { "validation" };
        for model in &done.models {
            let error = fit(done, record, model.role, Kind::Simulation(record.initial_state))
                .map_or(f64::NAN, |f| f.error.error_percent);
            let text = match error {
                e if e < 1.0 => format!("{e:.3} %"),
                e if e < 1e3 => format!("{e:.1} %"),
                _ => "diverges".to_owned(),
            };
            let what = format!("of energy, {of}: {}", model.title);
            cards += &card("Simulation error", text, what, !model.is_stable() || error >= 100.0);
        }
    }
    let best = done.leading();
    if let Some(model) = best {
        for estimate in model.bandwidths.iter().take(2) {
            let bandwidth = estimate.bandwidth;
            let text = bandwidth.frequency_hz.map_or("none".to_owned(), |f| format!("{f:.3} Hz"));
            let flag = if bandwidth.extrapolated { "; extrapolated" } else { "" };
            cards += &card("Bandwidth", text, format!("{}{flag}: {}", bandwidth.words(), model.title), false);
        }
    }
    format!("<dl class=\"key\">\n{cards}</dl>\n")
}

/// A polynomial in s, highest power first, with the errors of its coefficients below.
fn polynomial(coefficients: &[f64]) -> String {
    let highest = coefficients.len().saturating_sub(1);
    let mut text = String::new();
    for (k, c) in coefficients.iter().enumerate() {
        let power = match highest - k {
            0 => String::new(),
            1 => " s".to_owned(),
            n => format!(" s<sup>{n}</sup>"),
        };
        let sign = match (text.is_empty(), *c < 0.0) {
            (true, true) => "−",
            (true, false) => "",
            (false, true) => " − ",
            (false, false) => " + ",
        };
        let one = *c == 1.0 && highest > k;
        text +=
            &if one { format!("{sign}{}", power.trim_start()) } else { format!("{sign}{}{power}", number(c.abs())) };
    }
    text
}

fn transfer_functions(done: &Identification) -> String {
    let mut text = "<h2>Transfer function</h2>\n<p>H(s) in the form of the paper's Eq. 7, from the discrete model \
                    whose input is held from sample to sample. The first is the one to use. The refined model is \
                    fitted to the data by its simulation error. The reduced model of the same order is the paper's \
                    way; it inherits the errors of the full one.</p>\n"
        .to_owned();
    let mut rows = Vec::new();
    let mut any = false;
    for model in done.models.iter().rev() {
        let Some(ContinuousEstimate { model: h, standard_errors }) = &model.continuous else { continue };
        any = true;
        let Continuous { num, den, delay_s, conversion } = h;
        let delay = if *delay_s > 0.0 { format!("e<sup>−{} s</sup> ", number(*delay_s)) } else { String::new() };
        text += &format!(
            "<h3>{}</h3>\n<p>H(s) = {delay}({}) / ({})</p>\n",
            escape(&model.title),
            polynomial(num),
            polynomial(den)
        );
        if *conversion == Conversion::Tustin {
            text += "<p class=\"note\">A real pole of the discrete model is not positive: converted by Tustin's rule, \
                     right at low frequencies only.</p>\n";
        }
        let names = |what: &str, of: &[f64], from: usize| -> Vec<Html> {
            (from..of.len()).map(|k| Html::raw(format!("{what}, s<sup>{}</sup>", of.len() - 1 - k))).collect()
        };
        let labels = [names("numerator", num, 0), names("denominator", den, 1)].concat();
        for (k, (label, value)) in labels.iter().zip(h.parameters()).enumerate() {
            let sd = standard_errors.as_ref().and_then(|all| all.get(k)).copied();
            rows.push(vec![
                Html::from(&model.title),
                label.clone(),
                sd.map_or_else(|| number(value), |sd| number_to(value, digits_behind_first(value, sd).unwrap_or(4))),
                sd.map_or_else(Html::default, |sd| number_to(sd, 1)),
                sd.map_or_else(Html::default, |sd| format!("{:.2} %", 100.0 * sd / value.abs()).into()),
            ]);
        }
        let poles: Vec<String> = h.poles().iter().map(|p| complex(p.re, p.im)).collect();
        let zeros: Vec<String> =
            crate::identify::model::polynomials::roots(num).iter().map(|z| complex(z.re, z.im)).collect();
        text += &format!("<p class=\"note\">Poles {} rad/s; zeros {} rad/s.</p>\n", list(&poles), list(&zeros));
    }
    if !any {
        return format!("{text}<p>None: see above.</p>\n");
    }
    text + &table(2, &["Model", "Coefficient", "Value", "Standard error", "of the value"], &rows)
}

fn list(words: &[String]) -> String {
    if words.is_empty() { "none".to_owned() } else { words.join(", ") }
}

fn complex(re: f64, im: f64) -> String {
    match im {
        0.0 => number(re).to_string(),
        im => format!("{} {} {}i", number(re), if im < 0.0 { "−" } else { "+" }, number(im.abs())),
    }
}

fn table_1(done: &Identification, provenance: &Provenance) -> String {
    let mut heads = vec!["Data"];
    heads.extend(done.models.iter().map(|m| m.title.as_str()));
    let ahead =
        done.model(Role::Full).map_or_else(|| "one step ahead".to_owned(), |m| format!("{}, one step ahead", m.title));
    heads.push(&ahead);
    let other =
        if provenance.initial_state == InitialState::Rest { InitialState::Estimated } else { InitialState::Rest };
    let mut rows = Vec::new();
    for start in [provenance.initial_state, other] {
        for record in &provenance.records {
            let role = if record.training { "Training" } else { "Validation" };
            let begins = if start == InitialState::Rest { "from rest" } else { "start estimated" };
            let name = format!("{role} ({:.0} s), {begins}: {}", record.duration_s, record.name);
            let cell = |role, kind| {
                fit(done, record, role, kind).map_or_else(Html::default, |f| {
                    Html::raw(format!(
                        "{} <small>(fit {:.2} %)</small>",
                        percent(f.error.error_percent),
                        f.error.fit_percent.max(-999.0)
                    ))
                })
            };
            let mut row = vec![Html::from(name)];
            row.extend(done.models.iter().map(|m| cell(m.role, Kind::Simulation(start))));
            row.push(if start == provenance.initial_state {
                cell(Role::Full, Kind::Prediction)
            } else {
                Html::default()
            });
            rows.push(row);
        }
    }
    format!(
        "<h2>Fit errors</h2>\n<p>As the paper's Table I: energy of the difference between observed and simulated \
         signal, in percent of the energy of the observed one. In brackets the fit 100 (1 − ‖y − ŷ‖/‖y − ȳ‖). \
         Simulated from the input alone; one step ahead the model also knows what was observed before.</p>\n{}",
        table(1, &heads, &rows)
    )
}

fn time_courses(data: &Data, done: &Shown<'_>, provenance: &Provenance) -> String {
    let mut text = "<h2>Observed and simulated</h2>\n".to_owned();
    for (k, record) in data.training.iter().chain(&data.validation).enumerate() {
        let training = k < data.training.len();
        text += &format!("<h3>{}: {}</h3>\n", if training { "Training" } else { "Validation" }, escape(&record.name));
        let (whole, left, middle) = figures::courses(data, done, provenance, record);
        text += &figure(&format!("plot-course-{k}"), &whole, 300, false);
        text += "<p class=\"note\">What is left, observed minus simulated:</p>\n";
        text += &figure(&format!("plot-left-{k}"), &left, 220, false);
        text += "<p class=\"note\">The middle of the record, each sample:</p>\n";
        text += &figure(&format!("plot-middle-{k}"), &middle, 300, false);
    }
    text
}

fn frequency(data: &Data, done: &Shown<'_>) -> String {
    let mut text = "<h2>Frequency response</h2>\n<p>Lines: the models, with the band of one σ that the coefficients' \
                    errors make. Dots: the data without a model (averaged periods where the input repeats, Welch's \
                    spectra otherwise). All are responses of the samples: their phase has half a sample of delay of \
                    the hold, which H(s) does not. Grey: the band that the input excited; outside of it the models \
                    extrapolate. Dotted: half of the sampling rate.</p>\n"
        .to_owned();
    text += &figure("plot-magnitude", &figures::magnitude(data, done), 360, true);
    text += &figure("plot-phase", &figures::phase(data, done), 300, true);
    if done.spectrum.is_some() {
        text += "<p class=\"note\">Coherence: the part of the output's power that follows the input. Where it falls, \
                 noise, or what is not linear, decides.</p>\n";
        text += &figure("plot-coherence", &figures::coherence(data, done), 200, true);
    }
    let mut rows = Vec::new();
    for model in done.models {
        for estimate in &model.bandwidths {
            let found = estimate.bandwidth;
            rows.push(vec![
                model.title.clone(),
                model.bandwidths_are_of.words().to_owned(),
                found.words(),
                found.frequency_hz.map_or("none".to_owned(), |f| format!("{f:.4}")),
                estimate.interval_hz.map_or("–".to_owned(), |(low, high)| format!("{low:.4} to {high:.4}")),
                if found.extrapolated { "extrapolated" } else { "inside" }.to_owned(),
            ]);
        }
    }
    text += "<h3>Bandwidth</h3>\n<p>It depends on the definition. Of H(s), or of the samples, whose phase holds half a \
             period of the hold too. Extrapolated: the frequency, or zero frequency, which it refers to, lies outside \
             the excited band. The interval is that of a residual bootstrap, or of the scatter of averaged periods; \
             there is none without either, and none where noise biases the model (ARX, and what is reduced from it, \
             with Eq. 6 or with residuals that are not white), because the scatter does not show the bias.</p>\n";
    text + &table(3, &["Model", "Of", "Definition", "Hz", "95 % interval", "Excited band"], &rows)
}

fn orders(done: &Identification) -> String {
    if done.candidates.is_empty() {
        return String::new();
    }
    let judged = done.candidates.iter().any(|c| c.simulation.is_some());
    let what = if judged { "Simulation error of the validation data" } else { "Minimum description length" };
    let unstable = done.candidates.iter().filter(|c| c.largest_pole >= 1.0).count();
    let mut heads = vec!["na", "nb", "delay", "AIC", "MDL"];
    if judged {
        heads.extend(["prediction error (%)", "simulation error (%)"]);
    }
    heads.extend(["largest pole", "note"]);
    let error = |e: Option<crate::identify::model::reproduction::FitError>| {
        e.map_or_else(Html::default, |e| percent(e.error_percent))
    };
    let rows: Vec<Vec<Html>> = of_each_order(done, judged)
        .into_iter()
        .map(|c| {
            let counts = [c.orders.na, c.orders.nb, c.orders.nk].map(|n| n.to_string().into());
            let mark = if c.orders == done.orders { "chosen" } else { "" };
            let criteria = [number(c.aic), number(c.mdl)];
            // Without validation data there are no errors, and no columns for them.
            let errors = judged.then(|| [error(c.prediction), error(c.simulation)]);
            let last = [format!("{:.5}", c.largest_pole).into(), mark.into()];
            counts.into_iter().chain(criteria).chain(errors.into_iter().flatten()).chain(last).collect()
        })
        .collect();
    format!(
        "<h2>Order and delay</h2>\n<p>{what}, each line a delay. {} of {} models are unstable, left out, and never \
         chosen. Below, of each order the delay that does best; all of them: orders.csv.</p>\n{}{}",
        unstable,
        done.candidates.len(),
        figure("plot-orders", &figures::orders(done, judged), 320, false),
        table(0, &heads, &rows)
    )
}

/// For each na and nb the stable candidate with the smallest simulation error, or MDL; and the one chosen.
fn of_each_order(done: &Identification, judged: bool) -> Vec<&Candidate> {
    let value = |c: &Candidate| if judged { c.simulation.map_or(f64::NAN, |e| e.error_percent) } else { c.mdl };
    let mut best: BTreeMap<(usize, usize), &Candidate> = BTreeMap::new();
    for c in done.candidates.iter().filter(|c| c.largest_pole < 1.0) {
        let order = best.entry((c.orders.na, c.orders.nb)).or_insert(c);
        if c.orders == done.orders || (order.orders != done.orders && value(c) < value(order)) {
            *order = c;
        }
    }
    best.into_values().collect()
}

fn reduction(done: &Identification) -> String {
    let Ok(reduced) = &done.reduced else { return String::new() };
    let kept = reduced.model.order();
    let bound = if reduced.error_bound.is_finite() {
        format!("The reduced response differs by at most {}.", number(reduced.error_bound))
    } else {
        "Balanced for the excited band alone: no bound holds outside of it.".to_owned()
    };
    format!(
        "<h2>Reduction</h2>\n<p>Hankel singular values: how much each state of the full model carries from input to \
         output. {} kept. {bound}</p>\n{}",
        plural(kept, "state"),
        figure("plot-hankel", &figures::hankel(reduced, kept), 260, false)
    )
}

fn residuals(done: &Identification) -> String {
    let Some(found) = &done.residuals else { return String::new() };
    let ((a, of_a), (c, of_c), (b, of_b)) = (found.auto_outside(), found.cross_outside(), found.fed_back());
    format!(
        "<h2>Residuals</h2>\n<p>Of the full model, one step ahead: {} RMS. 99 % of the values lie between the lines \
         when nothing is left to explain. Outside: {a} of {of_a} lags of the residuals with themselves, {c} of \
         {of_c} with the input, and {b} of {of_b} below lag 0, where only feedback from the output to the input \
         shows.</p>\n<div class=\"pair\"><div>{}</div><div>{}</div></div>\n",
        number(found.rms),
        figure("plot-auto", &figures::correlation(found, true), 260, false),
        figure("plot-cross", &figures::correlation(found, false), 260, false)
    )
}

/// The records as read.
fn records_table(provenance: &Provenance) -> String {
    let zero = |r: &RecordSummary| {
        let shown = |z: Zero| format!("{:.3} ± {:.3}", z.offset.to_degrees(), z.sd.to_degrees());
        r.zero.map_or_else(String::new, shown)
    };
    let row = |r: &RecordSummary| {
        vec![
            r.name.clone(),
            if r.training { "fitted" } else { "judged by" }.to_owned(),
            r.samples.to_string(),
            r.segments.to_string(),
            r.lost.to_string(),
            r.missed.to_string(),
            r.bridged.to_string(),
            format!("{:.3}", r.period_s * 1e3),
            format!("{:.3}", r.jitter_s * 1e3),
            r.delay.as_ref().map_or_else(String::new, |d| {
                let others = d.others_in_words().map_or_else(String::new, |others| format!(" ({others} as well)"));
                format!("{} ± {:.1}{others}", fixed(d.delay_s * 1e3, 1), d.sd_s * 1e3)
            }),
            zero(r),
        ]
    };
    let rows: Vec<Vec<String>> = provenance.records.iter().map(row).collect();
    let heads = [
        "Record",
        "Use",
        "Samples",
        "Stretches",
        "Lost",
        "Missed",
        "Bridged",
        "Period (ms)",
        "Jitter (ms)",
        "Late (ms)",
        "Zero off (°)",
    ];
    format!(
        "<p>Lost: places on the camera's grid without a frame. Missed: frames without an angle. Late: how much the \
         output is later than the commands say, clocks, amplifier and system together; taken out only when asked \
         for. Zero off: how much too high θ is, by a simple model; taken out where it is off by more than \
         chance explains.</p>\n{}",
        table(2, &heads, &rows)
    )
}

/// Settings and poles.
fn facts_rows(provenance: &Provenance, models: &[Modelled]) -> Vec<(Html, Html)> {
    let settings = provenance.settings.iter().map(|(name, value)| (name.into(), value.into()));
    let stable = |m: &Modelled| if m.is_stable() { "stable" } else { "unstable" };
    let poles =
        models.iter().map(|m| ((&m.title).into(), format!("largest pole {:.6}, {}", m.largest_pole, stable(m)).into()));
    settings.chain(poles).collect()
}

fn facts(done: &Identification, provenance: &Provenance) -> String {
    let mut lines = facts_rows(provenance, &done.models);
    let condition = Html::raw(format!("{} of the regressors of ARX", number(done.arx.condition)));
    lines.push(("Condition".into(), condition));
    format!("<h2>Origin</h2>\n{}{}", records_table(provenance), facts_table(&lines))
}

/// Averaged periods: their data.
fn periods(done: &Identification) -> String {
    let Some(found) = &done.periodic else { return String::new() };
    let rows: Vec<Vec<String>> = found
        .records
        .iter()
        .map(|r| {
            let counts = [r.samples, r.periods, r.skipped, r.left_out, r.lines.len()].map(|n| n.to_string());
            counts.into_iter().chain([format!("{:.2}", r.first_off)]).collect()
        })
        .collect();
    let heads =
        ["Samples of a period", "Periods averaged", "Skipped", "Left out (holes)", "Lines excited", "First period off"];
    format!(
        "<h2>Averaged periods</h2>\n<p>The input repeats, so what differs from period to period is noise, of each line \
         and of both signals. The model of the periods is the one of largest likelihood under this noise. It leaves \
         {:.2} ± {:.2} times what noise explains: clearly more than 1 means that what repeats is not linear, or of a \
         higher order; σ is then widened. First period off: how much the first period differs from the others, over \
         what noise explains: clearly more than 1 means that it had not settled. All lines: lines.csv.</p>\n{}",
        found.left,
        found.left_sd,
        table(0, &heads, &rows)
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_and_polynomials_as_people_read_them() {
        assert_eq!(number(17610.0).to_string(), "17610");
        assert_eq!(number(-4.59).to_string(), "−4.5900");
        assert_eq!(number(1.5e-7).to_string(), "1.5000·10<sup>−7</sup>");
        assert_eq!(polynomial(&[1.0, 4.59, -1.136]), "s<sup>2</sup> + 4.5900 s − 1.1360");
        assert_eq!(polynomial(&[17610.0, 6344.0]), "17610 s + 6344.0");
        assert_eq!(percent(f64::INFINITY).to_string(), "diverges");
    }
}
