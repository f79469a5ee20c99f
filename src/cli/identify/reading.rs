//! From files to signals: reads, grids, cuts, decimates and detrends them; and a summary of each record.

use super::super::{copies, provenance};
use super::args::{Args, CURRENT, DelayArg, Range};
use super::on_grid::{DECIMATION_NEEDS, Read, on_grid};
use super::recorded::recorded;
use super::{columns_in_doubt, records};
use crate::cli::Failure;
use crate::identify::data::grid::Series;
use crate::identify::data::plant::Plant;
use crate::identify::data::prepare::{Detrend, Trend, decimate};
use crate::identify::data::segments::{Data, Record};
use crate::identify::model::reproduction::InitialState;
use crate::identify::results::provenance::{Provenance, RecordSummary};
use crate::series::{columns, unit_s};
use std::path::Path;

/// Decimation that loses this part of the outputs more than were missing before is told.
const MANY_LOST: f64 = 0.1;

/// Prepared data for identification and validation.
pub(super) fn read(args: &Args) -> Result<(Data, Provenance), Failure> {
    let files = records::files(args)?;
    let ranges = args.train.is_some() || args.test.is_some();
    let applied = args.model.is_some();
    if ranges && args.records.len() > 1 {
        return Err(Failure::usage("--train and --test take parts of one record; there are several"));
    }
    if let (Some(Range { from, to }), None, false) = (args.test, args.train, applied) {
        return Err(Failure::usage(format!(
            "--test {from}:{to}: without --train all of the record is fitted, this part too, and fitted data cannot \
             judge the model: add --train A:B"
        )));
    }
    let plant = args.plant.as_deref().map(Plant::load).transpose().map_err(Failure::usage)?;
    let mut all = Vec::new();
    for (k, (file, table)) in files.into_iter().enumerate() {
        let mut read =
            if args.output.is_some() { from_table(args, file)? } else { recorded(args, file, table, plant)? };
        // An applied model is judged by all records.
        read.summary.training = args.model.is_none() && k < args.records.len();
        all.push(read);
    }
    let periods = all.iter().map(|read| (read.summary.name.as_str(), read.summary.period_s));
    records::one_period(periods, " (--resample --period gives them one)")?;
    warn_of_shared_ranges(args);
    let is_copy = |one: &Read, other: &Read| one.record.is_copy_of(&other.record);
    copies::check(&all, is_copy, |read| (&read.summary.name, read.summary.training))?;
    let mut period_s = all.first().map_or(0.0, |read| read.summary.period_s);
    let mut data = Data::default();
    let mut summaries = Vec::new();
    for Read { record, summary } in all {
        let parts = match (summary.training, args.train, args.test) {
            (true, train, test) if ranges => {
                let part = |range: Range, training: bool| -> Result<_, Failure> {
                    within(&record, range)?;
                    Ok((record.range(range.from, range.to, period_s), training))
                };
                let fitted = train.map(|train| part(train, true)).transpose()?;
                let judged = test.map(|test| part(test, false)).transpose()?;
                [fitted, judged].into_iter().flatten().collect()
            }
            (false, _, Some(test)) if applied => {
                within(&record, test)?;
                vec![(record.range(test.from, test.to, period_s), false)]
            }
            (training, _, _) => vec![(record, training)],
        };
        for (part, training) in parts {
            let whole = part;
            let part = args.decimate.map_or_else(|| whole.clone(), |n| decimate(&whole, n, period_s));
            if part.observed() == 0 {
                return Err(Failure::usage(format!("{}: {}", part.name, empty_reason(&whole, args))));
            }
            warn_of_holes(&whole, &part);
            summaries.push(RecordSummary { training, ..described(&part, &summary, period_s, args) });
            if training { data.training.push(part) } else { data.validation.push(part) }
        }
    }
    period_s *= args.decimate.unwrap_or(1) as f64;
    data.period_s = period_s;
    detrend(&mut data, args.detrend(), ranges);
    summaries.sort_by_key(|summary| !summary.training);
    Ok((data, provenance(args, summaries)))
}

/// Warns if fitted data are also used for validation.
fn warn_of_shared_ranges(args: &Args) {
    if let (Some(train), Some(test)) = (args.train, args.test) {
        let (from, to) = (train.from.max(test.from), train.to.min(test.to));
        if from < to {
            tracing::warn!("--train and --test share samples {from} to {}: fitted data cannot judge the model", to - 1);
        }
    }
}

/// Warns of outputs that decimation lost because frames beside them are missing. `whole`: before it.
fn warn_of_holes(whole: &Record, part: &Record) {
    let samples = |record: &Record| record.segments.iter().map(|s| s.len()).sum::<usize>();
    let missing = |record: &Record| 1.0 - record.observed() as f64 / samples(record).max(1) as f64;
    if missing(part) > missing(whole) + MANY_LOST {
        tracing::warn!(
            "{}: --decimate leaves {} of {} samples: its filter needs {DECIMATION_NEEDS} in a row, and frames are \
             missing for longer than it can interpolate",
            part.name,
            part.observed(),
            samples(part)
        );
    }
}

/// Why nothing is left of a record, or of a part of one.
fn empty_reason(part: &Record, args: &Args) -> String {
    match (part.segments.iter().map(|s| s.len()).max(), args.decimate) {
        (Some(longest), Some(n)) if part.observed() > 0 => format!(
            "--decimate {n} leaves nothing: its filter needs {} samples without a hole, and the longest stretch has \
             {longest}",
            DECIMATION_NEEDS * n
        ),
        _ => "no sample has both input and output".to_owned(),
    }
}

fn described(part: &Record, read: &RecordSummary, period_s: f64, args: &Args) -> RecordSummary {
    let factor = args.decimate.unwrap_or(1);
    RecordSummary {
        name: part.name.clone(),
        samples: part.observed(),
        segments: part.segments.len(),
        initial_state: if part.is_from_rest() { args.initial_state() } else { InitialState::Estimated },
        duration_s: part.segments.iter().map(|s| s.len()).sum::<usize>() as f64 * period_s * factor as f64,
        ..read.clone()
    }
}

fn within(record: &Record, range: Range) -> Result<(), Failure> {
    let has = record.span();
    if range.to > has {
        let Range { from, to } = range;
        return Err(Failure::usage(format!("{}: has {has} samples, and {from}:{to} were asked for", record.name)));
    }
    Ok(())
}

/// A record from columns of any table.
fn from_table(args: &Args, file: &Path) -> Result<Read, Failure> {
    let (Some(input), Some(output)) = (&args.input, &args.output) else {
        return Err(Failure::usage("--input and --output go together"));
    };
    let name = file.display().to_string();
    let names: Vec<&str> = [input.as_str(), output.as_str()].into_iter().chain(args.time.as_deref()).collect();
    let mut values = columns(file, &names)?.into_iter();
    let (drive, output) = (values.next().unwrap_or_default(), values.next().unwrap_or_default());
    let mut doubtful = false;
    let time_s = match (values.next(), args.period) {
        (Some(_), Some(_)) if !args.resample => {
            return Err(Failure::usage(
                "--time has the time from row to row: leave --period out, or add --resample, for which it is the new \
                 one",
            ));
        }
        (Some(times), _) => {
            let unit_s = args.time.as_deref().map_or(1.0, unit_s);
            let missing = |row: usize| Failure::usage(format!("{name}: the time of row {} is missing", row + 1));
            let in_seconds = |(row, t): (usize, Option<f64>)| t.map(|t| t * unit_s).ok_or_else(|| missing(row));
            times.into_iter().enumerate().map(in_seconds).collect::<Result<Vec<_>, _>>()?
        }
        (None, Some(period)) => {
            columns_in_doubt::warn_of_another_time(file, period);
            doubtful |= columns_in_doubt::warn_of_lost_rows(&name, &drive);
            (0..drive.len()).map(|k| k as f64 * period).collect()
        }
        (None, None) => {
            return Err(Failure::usage("the time from row to row is not known: give --period S, or --time COLUMN"));
        }
    };
    columns_in_doubt::warn_of_stairs(&name, &drive, &output);
    if drive == output && !drive.is_empty() {
        let (input, output) = (args.input.as_deref().unwrap_or_default(), args.output.as_deref().unwrap_or_default());
        return Err(Failure::usage(format!(
            "{name}: --input {input} and --output {output} have the same values in all rows: give two columns"
        )));
    }
    // With times of their own they shift nothing.
    doubtful |= columns_in_doubt::warn_of_repeated_rows(&name, &output) && args.time.is_none();
    let missed = output.iter().filter(|y| y.is_none()).count();
    let series = Series { name: name.clone(), time_s, drive, output, ..Series::default() };
    let (record, grid, bridged) = on_grid(args, &series)?;
    // A stated period is exact and need not be estimated.
    let period_s = args.period.unwrap_or(grid.period_s);
    let summary = RecordSummary {
        name,
        period_s,
        jitter_s: grid.jitter_s,
        lost: grid.lost,
        missed,
        doubtful,
        bridged,
        ..RecordSummary::default()
    };
    Ok(Read { record, summary })
}

/// Removes trends. `one_record`: all parts belong to one record with a common line.
fn detrend(data: &mut Data, what: Detrend, one_record: bool) {
    let period_s = data.period_s;
    if what == Detrend::None {
        return;
    }
    // If nothing is fitted, each record has its own trend.
    if data.training.is_empty() {
        for record in &mut data.validation {
            let trend = Trend::of(&record.segments, period_s, what == Detrend::Linear);
            record.segments.iter_mut().for_each(|s| trend.remove(s, period_s));
        }
        return;
    }
    let all: Vec<_> = data.training.iter().flat_map(|r| r.segments.clone()).collect();
    let of_all = Trend::of(&all, period_s, false);
    let mut of_validation = of_all;
    for record in &mut data.training {
        let trend = if what == Detrend::Linear { Trend::of(&record.segments, period_s, true) } else { of_all };
        if what == Detrend::Linear && one_record {
            of_validation = trend;
        }
        record.segments.iter_mut().for_each(|s| trend.remove(s, period_s));
    }
    for record in &mut data.validation {
        record.segments.iter_mut().for_each(|s| of_validation.remove(s, period_s));
    }
}

fn provenance(args: &Args, records: Vec<RecordSummary>) -> Provenance {
    let file = |path: &Path| path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let title = args.records.iter().map(|p| file(p)).collect::<Vec<_>>().join(", ");
    let unknown = String::new;
    let (input, input_unit, output, output_unit) = match (&args.output, &args.input) {
        (Some(output), Some(input)) => (input.clone(), unknown(), output.clone(), unknown()),
        (None, Some(_)) => (CURRENT.to_owned(), "A".to_owned(), "θ".to_owned(), "rad".to_owned()),
        (_, None) => ("net torque".to_owned(), "N·m".to_owned(), "θ".to_owned(), "rad".to_owned()),
    };
    let mut settings = Vec::new();
    let mut set = |name: &str, value: String| settings.push((name.to_owned(), value));
    if let Some(plant) = &args.plant {
        set("plant", plant.display().to_string());
    }
    for table in &args.currents {
        set("currents", table.display().to_string());
    }
    set("detrend", format!("{:?}", args.detrend).to_lowercase());
    set("decimate", args.decimate.unwrap_or(1).to_string());
    set("resample", args.resample.to_string());
    set("bridge", args.bridge.to_string());
    if let Some(model) = &args.model {
        set("model", model.display().to_string());
    }
    if let Some(repeats) = &args.repeats {
        set("repeats", repeats.words());
    }
    // An applied model is not fitted.
    let fitted = args.model.is_none();
    if fitted {
        set("estimator", format!("{:?}", args.estimator).to_lowercase());
    }
    set("zero", if args.fits_zero() { "fitted" } else { "exact" }.to_owned());
    set("start", format!("{:?}", args.start).to_lowercase());
    if fitted {
        set("reduction", if args.match_dc { "match DC" } else { "truncation" }.to_owned());
        set("reduced for", if args.all_frequencies { "all frequencies" } else { "the excited band" }.to_owned());
        set("bootstrap", args.bootstrap.to_string());
    }
    set(
        "delay",
        match args.delay {
            DelayArg::Auto => "auto".to_owned(),
            DelayArg::Given(seconds) => format!("{seconds} s"),
        },
    );
    settings.extend(provenance::of_this_run());
    Provenance { title, input, input_unit, output, output_unit, initial_state: args.initial_state(), records, settings }
}
