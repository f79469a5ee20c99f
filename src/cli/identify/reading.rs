//! From files to signals: reads, grids, cuts, decimates and detrends them; and a summary of each record.

use super::super::{copies, provenance};
use super::args::{Args, DelayArg, Range};
use super::records::{self, Driven};
use super::{columns_in_doubt, currents};
use crate::cli::Failure;
use crate::identify::data::from_recording::Observed;
use crate::identify::data::grid::{Grid, GridError, Series, coarser, cut, resample, rounded_to};
use crate::identify::data::hold::Held;
use crate::identify::data::plant::Plant;
use crate::identify::data::prepare::{Detrend, Trend, decimate};
use crate::identify::data::segments::Data;
use crate::identify::data::segments::Record;
use crate::identify::estimate::clock_delay::{self, Delay, Drift, Timing};
use crate::identify::estimate::unknown_zero::Zero;
use crate::identify::model::reproduction::InitialState;
use crate::identify::results::provenance::{Provenance, RecordSummary};
use crate::series::{Recording, columns, unit_s};
use std::path::Path;

/// Fewest samples after decimation.
const DECIMATION_NEEDS: usize = 11;
/// Angle below which all of a record is hardly a deflection in degrees.
const LEAST_DEGREES: f64 = 1.0;
/// A model that leaves more than this many times σ of θ lacks something.
const MISFIT: f64 = 3.0;
/// The input of a log without Eq. 6.
const CURRENT: &str = "current";

/// A record on its grid.
struct Read {
    record: Record,
    summary: RecordSummary,
}

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
            columns_in_doubt::warn_of_lost_rows(&name, &drive);
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
    columns_in_doubt::warn_of_repeated_rows(&name, &output);
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
        bridged,
        ..RecordSummary::default()
    };
    Ok(Read { record, summary })
}

fn on_grid(args: &Args, series: &Series) -> Result<(Record, Grid, usize), Failure> {
    if !args.resample {
        let grid = Grid::of(&series.name, &series.time_s).map_err(Failure::usage)?;
        let (record, bridged) = cut(series, &grid, args.bridge);
        return Ok((record, grid, bridged));
    }
    if let Some(step_s) = rounded_to(series) {
        tracing::warn!(
            "{}: its times are whole multiples of {step_s} s, a large part of the time from row to row, and uneven: if \
             they were rounded, they are wrong by up to half of that, and H(s) by many times its σ: export them with \
             more digits",
            series.name
        );
    }
    // Fewer samples than there are: the input is not held for a whole new period, which decimation accounts for.
    let factor = args.period.map_or(Ok(1), |period| coarser(series, period)).map_err(Failure::usage)?;
    let resampled = resample(series, args.period.map(|period| period / factor as f64)).map_err(Failure::usage)?;
    let grid = Grid::of(&resampled.name, &resampled.time_s).map_err(Failure::usage)?;
    let (record, bridged) = cut(&resampled, &grid, args.bridge);
    if factor == 1 {
        return Ok((record, grid, bridged));
    }
    let thin = decimate(&record, factor, grid.period_s);
    if thin.observed() == 0 && record.observed() > 0 {
        return Err(Failure::usage(format!(
            "{}: --period {} leaves nothing: its filter needs {DECIMATION_NEEDS} such periods without a hole",
            series.name,
            args.period.unwrap_or(grid.period_s)
        )));
    }
    Ok((thin, Grid { period_s: grid.period_s * factor as f64, ..grid }, bridged))
}

/// A record from θ and currents of a run.
fn recorded(args: &Args, file: &Path, table: Option<&Path>, plant: Option<Plant>) -> Result<Read, Failure> {
    let name = file.display().to_string();
    if plant.is_none() && args.input.as_deref() != Some(CURRENT) {
        return Err(Failure::usage(format!(
            "{name}: what moves it? Give --plant PLANT.toml (Eq. 6, for logs), --input current (the current itself), \
             or the columns of a table with --input, --output and --period"
        )));
    }
    if args.period.is_some() && !args.resample {
        return Err(Failure::usage(format!(
            "{name}: has the camera's times: leave --period out, or add --resample, for which it is the new one"
        )));
    }
    let Driven { recording, source, own_clock, currents, .. } = Driven::read(file, table)?;
    let mut observed = Observed::of(&recording).map_err(Failure::usage)?;
    let held = observed.commands(&source, &currents, args.coil).map_err(Failure::usage)?;
    let end_s = observed.time_s.last().copied().unwrap_or_default();
    currents::warn_of_values(&source, std::slice::from_ref(&held), end_s, plant.is_some());
    match observed.grid() {
        Ok(grid) => currents::warn_of_slow_log(&source, &held, grid.period_s),
        Err(GridError::Uneven { period_s, .. } | GridError::RateChanges { period_s, .. }) if args.resample => {
            currents::warn_of_slow_log(&source, &held, period_s);
            // Between interpolated angles a delay would be off by milliseconds, many times its σ.
            tracing::warn!(
                "{name}: frames are not evenly spaced, from which neither the delay between commands and output, nor a \
                 drift of the currents' clock, nor the zero of θ is estimated: that they are right is not checked"
            );
        }
        Err(_) => {}
    }
    let largest_rad = observed.theta_rad.iter().flatten().fold(0.0, |largest: f64, theta| largest.max(theta.abs()));
    if largest_rad < LEAST_DEGREES.to_radians() {
        let largest = largest_rad.to_degrees();
        tracing::warn!("{name}: θ is never beyond {largest:.3}°: is the table's column in radians?");
    }
    let middle_s = observed.time_s.last().map_or(0.0, |end| 0.5 * end);
    let apparent = apparent_delay(args, &observed, &held, plant, own_clock.then_some(middle_s));
    let delay_s = match (args.delay, &apparent) {
        (DelayArg::Given(seconds), _) => seconds,
        (DelayArg::Auto, Some(delay)) => match delay.others_in_words() {
            None => delay.delay_s,
            Some(others) => {
                return Err(Failure::usage(format!(
                    "{name}: the delay between commands and output cannot be told: besides {:.1} ms, {others} explain \
                     the record about as well; commands over a wider band of frequencies would tell, or give it with \
                     --delay",
                    delay.delay_s * 1e3
                )));
            }
        },
        (DelayArg::Auto, None) => {
            return Err(Failure::usage(format!(
                "{name}: no delay between commands and output could be estimated; give it with --delay"
            )));
        }
    };
    if let Some(others) = apparent.as_ref().and_then(Delay::others_in_words) {
        tracing::warn!(
            "{name}: delays of the output by {others} would explain the record about as well, and the right one may \
             lie in between: whether the times of the commands are right cannot be told (does the output move only in \
             a narrow band of frequencies, or are commands missing?)"
        );
    }
    let told = apparent.as_ref().filter(|delay| delay.others_s.is_empty());
    let matters = |delay: &Delay| args.delay == DelayArg::Auto || delay.is_before(delay_s);
    let bent = told.filter(|delay| matters(delay)).and_then(|delay| Some((delay, misfit(&recording, delay)?)));
    if let Some((delay, times)) = bent {
        tracing::warn!(
            "{name}: the delay between commands and output, {:.1} ± {:.1} ms, is that of a model of second order, \
             which leaves {times:.0} times σ of θ: it makes up for what the model lacks, and may be off by many times \
             its σ",
            delay.delay_s * 1e3,
            delay.sd_s * 1e3
        );
    } else if let Some(delay) = told.filter(|delay| delay.is_before(delay_s)) {
        tracing::warn!(
            "{name}: θ seems to move {:.1} ± {:.1} ms before the commands: with wrong times H(s) is wrong; \
             --delay auto corrects them",
            (delay_s - delay.delay_s) * 1e3,
            delay.sd_s * 1e3
        );
    }
    // Delays that explain the record about as well agree about the drift.
    let held = match apparent.as_ref().and_then(|delay| delay.drift).filter(Drift::is_significant) {
        Some(drift) => without_drift(args, &source, held, (drift, told.is_some()), middle_s),
        None => held,
    };
    let zero = apparent.as_ref().and_then(|delay| delay.zero).filter(|_| args.detrend() == Detrend::None);
    if let Some(zero) = zero.filter(Zero::is_off) {
        tracing::warn!(
            "{name}: the zero of θ is off by {:.3} ± {:.3}°, by a model of second order: a wrong base frame, a \
             catheter that does not hang straight, or an offset of the currents? It is taken off, which does not help \
             against an offset of the currents; --zero exact leaves θ as it is",
            zero.offset.to_degrees(),
            zero.sd.to_degrees()
        );
        observed.theta_rad.iter_mut().flatten().for_each(|theta| *theta -= zero.offset);
    }
    let series = observed.series(&held, plant, delay_s).map_err(Failure::usage)?;
    let series = Series { fit_zero: args.fits_zero(), ..series };
    let lost = series.output.len() - observed.theta_rad.len();
    let missed = observed.theta_rad.iter().filter(|theta| theta.is_none()).count();
    let (record, grid, bridged) = on_grid(args, &series)?;
    let summary = RecordSummary {
        name,
        period_s: if args.resample { args.period.unwrap_or(grid.period_s) } else { grid.period_s },
        jitter_s: grid.jitter_s,
        lost,
        missed,
        vetoed: recording.vetoed,
        bridged,
        delay: apparent,
        zero,
        ..RecordSummary::default()
    };
    Ok(Read { record, summary })
}

/// Tells that the clock of the currents drifts; with `--delay auto` the commands are moved to the camera's clock.
/// `told`: whether there is one delay, without which `--delay auto` refuses.
fn without_drift(args: &Args, source: &str, held: Held, (drift, told): (Drift, bool), middle_s: f64) -> Held {
    let (ppm, sd) = (-1e6 * drift.rate, 1e6 * drift.sd);
    let fitted = args.delay == DelayArg::Auto;
    let remedy = match (fitted, told) {
        (true, _) => "they are moved by it",
        (false, true) => "--delay auto moves them by it",
        (false, false) => "--delay auto would move them by it, if the delay could be told",
    };
    tracing::warn!(
        "{source}: by a model of second order the clock of the currents seems to run {ppm:.1} ± {sd:.1} ppm fast \
         against the camera's, which spoils H(s); {remedy}. Better are currents with the camera's times"
    );
    if fitted { held.drifted(drift.rate, middle_s) } else { held }
}

/// How many times σ of θ the model of a delay leaves, if that is more than noise.
fn misfit(recording: &Recording, delay: &Delay) -> Option<f64> {
    let squares: Vec<f64> = recording.frames.iter().filter_map(|frame| Some(frame.theta_sd_rad?.powi(2))).collect();
    let noise = (squares.iter().sum::<f64>() / squares.len() as f64).sqrt();
    Some(delay.residual_rms / noise).filter(|times| times.is_finite() && *times > MISFIT)
}

/// The apparent delay of the output, searched around the given one. `own_clock`: see [`clock_delay::estimate`].
fn apparent_delay(
    args: &Args,
    observed: &Observed,
    held: &Held,
    plant: Option<Plant>,
    own_clock: Option<f64>,
) -> Option<Delay> {
    let period_s = observed.grid().ok()?.period_s;
    let given_s = if let DelayArg::Given(seconds) = args.delay { seconds } else { 0.0 };
    // All delays are judged by the same samples: those whose commands are known for every delay.
    let known_s = held.zero_before().span_s()?.0 + given_s + (clock_delay::MAX_DELAY + 2.0) * period_s;
    let cut_off = known_s > *observed.time_s.first()?;
    let observed = if cut_off { observed.from(known_s) } else { observed.clone() };
    let found = clock_delay::estimate(period_s, own_clock, |Timing { delay_s, drift }| {
        let held = held.drifted(drift, own_clock.unwrap_or_default()).zero_before();
        let series = observed.series(&held, plant, given_s + delay_s).ok()?;
        let series = Series { fit_zero: args.fits_zero(), ..series };
        let grid = Grid::of(&series.name, &series.time_s).ok()?;
        let (record, _) = cut(&series, &grid, args.bridge);
        let mut segments = record.segments;
        // What is taken for rest and is none would look like a delay.
        segments.iter_mut().for_each(|s| s.from_rest = false);
        if args.detrend() != Detrend::None {
            let trend = Trend::of(&segments, period_s, false);
            segments.iter_mut().for_each(|s| trend.remove(s, period_s));
        }
        Some(segments)
    })?;
    let others_s = found.others_s.iter().map(|other_s| given_s + other_s).collect();
    Some(Delay { delay_s: given_s + found.delay_s, others_s, ..found })
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
