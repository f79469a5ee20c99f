//! The page of a saved model on other records.

use super::figures::{self, Shown};
use super::{escape, facts_rows, figure, percent, records_table};
use crate::identify::data::segments::Data;
use crate::identify::model::reproduction::{InitialState, Kind};
use crate::identify::results::applied::Applied;
use crate::identify::results::provenance::Provenance;
use crate::identify::results::saved::Saved;
use crate::report::html::Html;
use crate::report::page::{self, card, facts_table, table};

/// The whole page.
pub(crate) fn applied_page(data: &Data, done: &Applied, saved: &Saved, provenance: &Provenance) -> String {
    let shown = Shown {
        models: &done.models,
        leading: done.leading().map(|m| m.role),
        spectrum: done.spectrum.as_ref(),
        lines: &[],
    };
    let mut body = format!(
        "<header>\n<p class=\"kind\">Catoptra: a model on other records</p>\n<h1>{}</h1>\n<p class=\"verdict\">From {} \
         to {}, simulated with {}. Nothing was fitted.</p>\n{}</header>\n",
        escape(&provenance.title),
        escape(&provenance.input),
        escape(&provenance.output),
        escape(&saved.name),
        page::doubts(&done.notes)
    );
    body += &cards(done, provenance);
    body += &errors(done, provenance);
    body += "<h2>Observed and simulated</h2>\n";
    for (k, record) in data.validation.iter().enumerate() {
        body += &format!("<h3>{}</h3>\n", escape(&record.name));
        let (whole, left, middle) = figures::courses(data, &shown, provenance, record);
        body += &figure(&format!("plot-course-{k}"), &whole, 300, false);
        body += "<p class=\"note\">The error over time, observed minus simulated:</p>\n";
        body += &figure(&format!("plot-left-{k}"), &left, 220, false);
        body += "<p class=\"note\">The middle of the record, each sample:</p>\n";
        body += &figure(&format!("plot-middle-{k}"), &middle, 300, false);
    }
    body += "<h2>Frequency response</h2>\n<p>Lines: the models. Dots: the data without a model (Welch's spectra). \
             Grey: the band that the input excited. Dotted: half of the sampling rate.</p>\n";
    body += &figure("plot-magnitude", &figures::magnitude(data, &shown), 360, true);
    body += &figure("plot-phase", &figures::phase(data, &shown), 300, true);
    body += "<h2>Origin</h2>\n";
    body += &records_table(provenance);
    body += &facts_table(&facts_rows(provenance, &done.models));
    body += &page::footer("");
    page::page(&format!("{} on {}", saved.name, provenance.title), &body)
}

fn cards(done: &Applied, provenance: &Provenance) -> String {
    let mut cards = String::new();
    let leading = done.leading();
    for record in &provenance.records {
        let kind = Kind::Simulation(record.initial_state);
        let role = leading.map(|m| m.role);
        let Some(fit) = done.fits.iter().find(|f| f.record == record.name && Some(f.role) == role && f.kind == kind)
        else {
            continue;
        };
        let error = fit.error.error_percent;
        let text = match error {
            e if e < 1.0 => format!("{e:.3} %"),
            e if e < 1e3 => format!("{e:.1} %"),
            _ => "diverges".to_owned(),
        };
        let title = leading.map_or("", |m| m.title.as_str());
        cards += &card("Simulation error", text, format!("of energy, {}: {title}", record.name), error >= 100.0);
    }
    format!("<dl class=\"key\">\n{cards}</dl>\n")
}

fn errors(done: &Applied, provenance: &Provenance) -> String {
    let mut rows: Vec<Vec<Html>> = Vec::new();
    for record in &provenance.records {
        for model in &done.models {
            let of = |start: InitialState| {
                let kind = Kind::Simulation(start);
                done.fits.iter().find(|f| f.record == record.name && f.role == model.role && f.kind == kind)
            };
            let cell = |start: InitialState| {
                of(start).map_or_else(Html::default, |f| {
                    let fit = f.error.fit_percent.max(-999.0);
                    Html::raw(format!("{} <small>(fit {fit:.2} %)</small>", percent(f.error.error_percent)))
                })
            };
            let gain = done.gains.iter().find(|(name, _)| *name == record.name);
            let leads = done.leading().is_some_and(|m| m.role == model.role);
            let gain = gain.filter(|_| leads).map_or_else(Html::default, |(_, gain)| format!("{gain:.4}").into());
            rows.push(vec![
                (&record.name).into(),
                (&model.title).into(),
                cell(InitialState::Rest),
                cell(InitialState::Estimated),
                gain,
            ]);
        }
    }
    let heads = ["Record", "Model", "Error from rest (%)", "Error, start estimated (%)", "Best gain"];
    format!(
        "<h2>Errors</h2>\n<p>Energy of the difference between observed and simulated signal, in percent of the energy \
         of the observed one, as the paper's Table I; in brackets the fit 100 (1 − ‖y − ŷ‖/‖y − ȳ‖). Best gain: the \
         factor that would bring the leading model's output nearest to what was observed.</p>\n{}",
        table(2, &heads, &rows)
    )
}
