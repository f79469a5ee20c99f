//! `catoptra identify --model`: a saved model on other records.

use super::args::Args;
use super::report_files;
use crate::cli::outcome::Outcome;
use crate::cli::output::REPORT;
use crate::cli::{Exit, Failure, output};
use crate::identify::data::segments::Data;
use crate::identify::model::reproduction::Kind;
use crate::identify::results::applied::{Applied, apply};
use crate::identify::results::export;
use crate::identify::results::provenance::Provenance;
use crate::identify::results::saved::Saved;
use crate::report::identification;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

pub(super) fn run(
    args: &Args,
    model: &Path,
    data: &Data,
    provenance: &Provenance,
    outcome: &Outcome,
) -> Result<(), Failure> {
    let saved = Saved::read(model).map_err(Failure::usage)?;
    let with_unit = |name: &str, unit: &str| if unit.is_empty() { name.to_owned() } else { format!("{name} ({unit})") };
    let input = with_unit(&provenance.input, &provenance.input_unit);
    let of_output = with_unit(&provenance.output, &provenance.output_unit);
    let done = apply(data, &saved, args.initial_state(), (&input, &of_output))
        .map_err(|why| Failure::new(Exit::Unusable, why))?;
    let data = done.held.as_ref().unwrap_or(data);
    for note in &done.notes {
        tracing::warn!("{note}");
    }
    let written = {
        let _writing = args.results().take()?;
        let mut written = export::write_applied(&args.out, data, &done, &saved, provenance)
            .map_err(|e| Failure::new(Exit::Failed, e))?;
        let page = args.out.join(REPORT);
        output::save(&page, &identification::applied_page(data, &done, &saved, provenance))?;
        written.push(page);
        written
    };
    report_files(outcome, &written)?;
    outcome.print(&summary(&done, &saved, provenance, &written))
}

fn summary(done: &Applied, saved: &Saved, provenance: &Provenance, written: &[PathBuf]) -> String {
    let mut text = String::new();
    // Formatting into memory cannot fail.
    let _ = describe(&mut text, done, saved, provenance);
    for path in written {
        let _ = writeln!(text, "written: {}", path.display());
    }
    text
}

fn describe(text: &mut String, done: &Applied, saved: &Saved, provenance: &Provenance) -> std::fmt::Result {
    writeln!(text, "{}: {} -> {}\n", saved.name, provenance.input, provenance.output)?;
    writeln!(text, "{:<40} {:>14} {:>10} {:>14}", "simulated from the input", "error, %", "fit, %", "RMS")?;
    for record in &provenance.records {
        for model in &done.models {
            let kind = Kind::Simulation(record.initial_state);
            let of = |f: &&crate::identify::chain::identification::Fit| {
                f.record == record.name && f.role == model.role && f.kind == kind
            };
            let Some(fit) = done.fits.iter().find(of) else { continue };
            let shown = |value: f64| if value.is_finite() { format!("{value:.4}") } else { "diverges".to_owned() };
            let rms = if fit.error.rms.is_finite() { format!("{:.4e}", fit.error.rms) } else { String::new() };
            writeln!(
                text,
                "{:<40} {:>14} {:>10} {:>14}",
                model.title,
                shown(fit.error.error_percent),
                shown(fit.error.fit_percent),
                rms
            )?;
        }
        writeln!(text, "  of {}, {} samples, {:.1} s", record.name, record.samples, record.duration_s)?;
    }
    for (record, gain) in &done.gains {
        writeln!(text, "gain that would fit {record} best: {gain:.4}")?;
    }
    writeln!(text)
}
