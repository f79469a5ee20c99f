//! `catoptra identify --planes`: from all coils to both angles.

use super::super::copies;
use super::args::{Args, DelayArg};
use super::currents;
use super::records::{self, Driven};
use crate::cli::outcome::Outcome;
use crate::cli::{Exit, Failure, output};
use crate::identify::data::from_recording::Observed;
use crate::identify::planes::{Motion, OUTPUTS, Planes, PlanesError, Settings, identify, moving};
use crate::plural::plural;
use crate::report::planes as page;
use std::fmt::Write as _;
use std::path::Path;

const FILES: [&str; 3] = ["model.json", "response.csv", "signals.csv"];

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
    let found = identify(training, judging, &coils, settings(args)?).map_err(failure)?;
    for diagnostic in &found.diagnostics {
        tracing::warn!("{diagnostic}");
    }
    let all: Vec<&Motion> = records.iter().collect();
    let written = {
        let _writing = args.results().take()?;
        let json = found.json(&coils).map_err(|e| Failure::new(Exit::Failed, e))?;
        let tables = [found.response_csv(&coils), found.signals_csv(&all)];
        let [response, signals] = tables.map(|table| table.map_err(|e| Failure::new(Exit::Failed, e)));
        let texts = [json.into_bytes(), response?, signals?];
        let mut written = Vec::new();
        for (name, text) in FILES.iter().zip(&texts) {
            written.push(args.out.join(name));
            output::save(&args.out.join(name), text)?;
        }
        written.push(args.out.join(output::REPORT));
        output::save(&args.out.join(output::REPORT), &page::page(&found, &coils, &all))?;
        written
    };
    super::report_files(outcome, &written)?;
    outcome.print(&words(&found, &coils, &args.out))
}

fn settings(args: &Args) -> Result<Settings, Failure> {
    let orders = args.planes_orders();
    let delay = args.planes_delay()?;
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
    let DelayArg::Given(delay_s) = args.delay else {
        return Err(Failure::usage("--delay auto: with --planes give the delay, or leave it to --nk"));
    };
    let mut names: Option<Vec<String>> = None;
    let mut motions: Vec<Motion> = Vec::new();
    for (file, table) in records::files(args)? {
        let Driven { recording, source, coils, currents, .. } = Driven::read(file, table)?;
        if let Some(first) = names.as_ref().filter(|first| **first != coils) {
            let (first, these) = (first.join(", "), coils.join(", "));
            return Err(Failure::usage(format!("{source}: has the coils {these}, the first record has {first}")));
        }
        let all: Vec<usize> = (0..coils.len()).collect();
        let motion = Motion::of(&recording, (&source, &currents), &all, delay_s).map_err(failure)?;
        let observed = Observed::of_angle(&recording, |frame| frame.tangent.map(|t| t.x)).map_err(Failure::usage)?;
        let held = all.iter().map(|coil| observed.commands(&source, &currents, *coil));
        let held = held.collect::<Result<Vec<_>, _>>().map_err(Failure::usage)?;
        let end_s = observed.time_s.last().copied().unwrap_or_default();
        currents::warn_of_values(&source, &held, end_s, false);
        currents::warn_of_changes(&source, &held, &observed, delay_s);
        if let Some(one) = held.first() {
            currents::warn_of_slow_log(&source, one, motion.period_s);
        }
        motions.push(motion);
        names.get_or_insert(coils);
    }
    let fitted = args.records.len();
    let numbered: Vec<(usize, &Motion)> = motions.iter().enumerate().collect();
    let is_copy = |(_, one): &(usize, &Motion), (_, other): &(usize, &Motion)| one.is_copy_of(other);
    copies::check(&numbered, is_copy, |(k, motion)| (&motion.name, *k < fitted))?;
    records::one_period(motions.iter().map(|motion| (motion.name.as_str(), motion.period_s)), "")?;
    Ok((names.unwrap_or_default(), motions))
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
    let _ = writeln!(text, "\nwritten: {}, {} in {}", FILES.join(", "), output::REPORT, out.display());
    text
}
