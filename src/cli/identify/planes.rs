//! `catoptra identify --planes`: from all coils to both angles.

use super::args::{Args, DelayArg};
use super::write_file;
use crate::cli::outcome::Outcome;
use crate::cli::{Exit, Failure, interrupt};
use crate::identify::planes::{Motion, OUTPUTS, Planes, PlanesError, Settings, identify, moving};
use crate::plural::plural;
use crate::report::planes as page;
use crate::series::{CurrentTable, Recording};
use std::fmt::Write as _;
use std::path::Path;

const FILES: [&str; 3] = ["model.json", "response.csv", "signals.csv"];
/// Periods of the records may differ by this part.
const SAME_PERIOD: f64 = 0.01;

fn failure(error: PlanesError) -> Failure {
    let exit = match error {
        PlanesError::Undetermined(_) | PlanesError::Unstable { .. } => Exit::Unusable,
        _ => Exit::Usage,
    };
    Failure::new(exit, error)
}

pub(super) fn run(args: &Args, outcome: &Outcome) -> Result<(), Failure> {
    let (coils, mut records) = read(args)?;
    // Coils that are never used tell nothing.
    let used = moving(&records);
    let coils: Vec<String> = used.iter().filter_map(|k| coils.get(*k).cloned()).collect();
    if coils.is_empty() {
        let name = args.records.first().map(|file| file.display().to_string()).unwrap_or_default();
        return Err(failure(PlanesError::Still { name }));
    }
    for record in &mut records {
        record.input = record.input.select_columns(&used);
    }
    let (training, judging) = records.split_at(args.records.len());
    let found = identify(training, judging, settings(args)?).map_err(failure)?;
    let all: Vec<&Motion> = records.iter().collect();
    let written = {
        let _whole = interrupt::wait();
        args.results().take()?;
        let json = found.json(&coils).map_err(|e| Failure::new(Exit::Failed, e))?;
        let texts = [json, found.response_csv(&coils), found.signals_csv(&all)];
        let mut written = Vec::new();
        for (name, text) in FILES.iter().zip(&texts) {
            written.push(args.out.join(name));
            write_file(&args.out.join(name), text.as_bytes())?;
        }
        written.push(args.out.join(super::args::REPORT));
        write_file(&args.out.join(super::args::REPORT), page::page(&found, &coils, &all).as_bytes())?;
        written
    };
    super::report_files(outcome, &written);
    outcome.print(&words(&found, &coils, &args.out))
}

fn settings(args: &Args) -> Result<Settings, Failure> {
    let orders = args.planes_orders();
    let delay = args.planes_delay();
    if orders.0 == 0 {
        return Err(Failure::usage("--order 0: a model needs one coefficient at least"));
    }
    if delay == 0 {
        return Err(Failure::usage("--nk 0: a current cannot act before it flows; the least is 1"));
    }
    // So many for each angle.
    Ok(Settings { orders, delay, keep: args.planes_keep().map(|states| OUTPUTS.len() * states) })
}

/// Names of the coils, and all records, those to judge by last.
fn read(args: &Args) -> Result<(Vec<String>, Vec<Motion>), Failure> {
    let files: Vec<&Path> = args.records.iter().chain(&args.validate).map(AsRef::as_ref).collect();
    if !args.currents.is_empty() && args.currents.len() != files.len() {
        let (tables, records) = (plural(args.currents.len(), "table"), plural(files.len(), "record"));
        return Err(Failure::usage(format!("--currents: {tables} for {records}; give one for each, in their order")));
    }
    let DelayArg::Given(delay_s) = args.delay else {
        return Err(Failure::usage("--delay auto: with --planes give the delay, or leave it to --nk"));
    };
    let mut names: Option<Vec<String>> = None;
    let mut records: Vec<Motion> = Vec::new();
    for (k, file) in files.iter().enumerate() {
        let recording = Recording::read(file).map_err(Failure::usage)?;
        let (source, coils, currents) = match args.currents.get(k) {
            Some(table) => {
                let read = CurrentTable::read(table).map_err(Failure::usage)?;
                let on_camera = read.on_camera_clock(&recording, None).map_err(Failure::usage)?;
                (table.display().to_string(), read.coils, on_camera)
            }
            None => {
                let coils = recording.currents.iter().map(|c| c.values_a.len()).max().unwrap_or(0);
                let coils = (0..coils).map(|coil| format!("coil_{coil}")).collect();
                (file.display().to_string(), coils, recording.currents.clone())
            }
        };
        if let Some(first) = names.as_ref().filter(|first| **first != coils) {
            let (first, these) = (first.join(", "), coils.join(", "));
            return Err(Failure::usage(format!("{source}: has the coils {these}, the first record has {first}")));
        }
        let all: Vec<usize> = (0..coils.len()).collect();
        let record = Motion::of(&recording, (&source, &currents), &all, delay_s).map_err(failure)?;
        if let Some(first) = records.first().filter(|r| (record.period_s / r.period_s - 1.0).abs() > SAME_PERIOD) {
            return Err(Failure::usage(format!(
                "{}: samples are {:.6} s apart, and {:.6} s in {}: records that belong together have one period",
                record.name, record.period_s, first.period_s, first.name
            )));
        }
        names.get_or_insert(coils);
        records.push(record);
    }
    Ok((names.unwrap_or_default(), records))
}

fn words(found: &Planes, coils: &[String], out: &Path) -> String {
    let mut text = format!("both angles from {}: order {}", coils.join(", "), found.order);
    // Writing into text cannot fail.
    let _ = writeln!(
        text,
        " ({} coefficients each), reduced to {}\n",
        found.coefficients,
        plural(found.reduced.order(), "state")
    );
    let _ = writeln!(
        text,
        "  error energy of the simulation, percent   order {:<3}          {}",
        found.order,
        plural(found.reduced.order(), "state")
    );
    for judged in &found.judged {
        let _ = writeln!(
            text,
            "  {:<42}{:.3}, {:.3}       {:.3}, {:.3}{}",
            judged.name,
            judged.full[0],
            judged.full[1],
            judged.reduced[0],
            judged.reduced[1],
            if judged.fitted { "" } else { "   not fitted" }
        );
    }
    let _ = writeln!(text, "\n  (angle in the plane of B0, angle across it)");
    let _ = writeln!(text, "\nwritten: {}, {} in {}", FILES.join(", "), super::args::REPORT, out.display());
    text
}
