//! `catoptra identify`: a log, or any two columns of a table, to a dynamic model.

mod apply;
mod args;
mod columns_in_doubt;
mod currents;
mod on_grid;
mod planes;
mod reading;
mod recorded;
mod records;
mod words;

pub(crate) use args::Args;

use super::{Exit, Failure, interrupt, output};
use crate::cli::outcome::{self, Outcome};
use crate::cli::progress::Stages;
use crate::identify::IdentifyError;
use crate::identify::chain::settings::Settings;
use crate::identify::chain::steps::identify_with_progress;
use crate::identify::data::segments::Data;
use crate::identify::model::modelled::Role;
use crate::identify::results::export;
use crate::report::identification;
use std::path::PathBuf;

pub(crate) fn run(args: &Args, quiet: bool) -> Result<(), Failure> {
    interrupt::end_at_once()?;
    outcome::of("identify", args.json.into(), quiet, |outcome| identify(args, quiet, outcome))
}

fn identify(args: &Args, quiet: bool, outcome: &Outcome) -> Result<(), Failure> {
    let results = args.results();
    results.check()?;
    if args.planes {
        return planes::run(args, outcome);
    }
    // 1. signals
    let stages = Stages::new(quiet);
    stages.begin("reading the records");
    let (data, provenance) = reading::read(args)?;
    if let Some(model) = &args.model {
        return apply::run(args, model, &data, &provenance, outcome);
    }
    let samples: usize = data.training.iter().map(crate::identify::data::segments::Record::observed).sum();
    let doubtful = provenance.records.iter().any(|record| record.training && record.doubtful);
    let settings = Settings { doubtful, ..args.settings(samples, !data.validation.is_empty())? };
    // 2. models
    let done =
        identify_with_progress(&data, &settings, &|what| stages.begin(what)).map_err(|error| failure(&data, error))?;
    let data = done.held.as_ref().unwrap_or(&data);
    stages.begin("writing the results");
    for diagnostic in done.diagnostics.iter().filter(|diagnostic| done.matters(diagnostic)) {
        tracing::warn!("{diagnostic}");
    }
    // 3. files
    let written = {
        let _writing = results.take()?;
        let mut written =
            export::write(&args.out, data, &done, &provenance).map_err(|e| Failure::new(Exit::Failed, e))?;
        let page = args.out.join(output::REPORT);
        output::save(&page, &identification::page(data, &done, &provenance))?;
        written.push(page);
        written
    };
    drop(stages);
    // 4. text
    report_files(outcome, &written)?;
    outcome.print(&words::summary(data, &done, &provenance, &written))?;
    if done.models.iter().any(|m| m.role == Role::Full && !m.is_stable()) {
        let text = "the model of full order is unstable: what was written describes it and is not to be relied on";
        return Err(Failure::new(Exit::Unusable, text));
    }
    Ok(())
}

/// Reports files and model, for programs.
fn report_files(outcome: &Outcome, written: &[PathBuf]) -> Result<(), Failure> {
    written.iter().for_each(|path| outcome::wrote(path));
    let Some(model) = written.iter().find(|path| path.ends_with("model.json")) else { return Ok(()) };
    outcome.found_in(model, |text| Ok(serde_json::from_str(text)?))
}

/// A failure that names its records.
fn failure(data: &Data, error: IdentifyError) -> Failure {
    let exit = match error {
        IdentifyError::Nothing { .. } | IdentifyError::Still { .. } | IdentifyError::OutOfRange { .. } => {
            return Failure::usage(error);
        }
        IdentifyError::NotPeriodic { .. } => return Failure::usage(error),
        IdentifyError::NotRepeated { .. } => return Failure::new(Exit::Unusable, error),
        IdentifyError::TooShort { .. } | IdentifyError::TooShortToJudge { .. } => Exit::Usage,
        IdentifyError::Dependent { .. }
        | IdentifyError::Unstable { .. }
        | IdentifyError::NotReduced { .. }
        | IdentifyError::NoneDetermined
        | IdentifyError::NoneStable { .. } => Exit::Unusable,
    };
    let judged = matches!(error, IdentifyError::TooShortToJudge { .. });
    let records = if judged { &data.validation } else { &data.training };
    let names: Vec<&str> = records.iter().map(|r| r.name.as_str()).collect();
    Failure::new(exit, format!("{}: {error}", names.join(", ")))
}
