//! A run's record: θ over time and the currents that moved it, with what is wrong between their clocks.

use super::args::{Args, CURRENT, DelayArg};
use super::currents;
use super::on_grid::{Read, on_grid};
use super::records::Driven;
use crate::cli::Failure;
use crate::identify::data::from_recording::Observed;
use crate::identify::data::grid::{Grid, GridError, Series, cut};
use crate::identify::data::hold::{FEW_LACKING, Held};
use crate::identify::data::plant::Plant;
use crate::identify::data::prepare::{Detrend, Trend};
use crate::identify::data::segments::Record;
use crate::identify::estimate::clock_delay::{self, Delay, Drift, Inputs, Timing};
use crate::identify::estimate::unknown_zero::Zero;
use crate::identify::results::provenance::RecordSummary;
use crate::median::upper_median;
use crate::series::Recording;
use std::borrow::Cow;
use std::path::Path;

/// Angle below which all of a record is hardly a deflection in degrees.
const LEAST_DEGREES: f64 = 1.0;
/// A model that leaves more than this many times σ of θ lacks something.
const MISFIT: f64 = 3.0;

/// A record from θ and currents of a run.
pub(super) fn recorded(args: &Args, file: &Path, table: Option<&Path>, plant: Option<Plant>) -> Result<Read, Failure> {
    let name = file.display().to_string();
    input_and_times_are_clear(args, &name, plant)?;
    let Driven { recording, source, own_clock, currents, .. } = Driven::read(file, table)?;
    let mut observed = Observed::of(&recording).map_err(Failure::usage)?;
    let held = observed.commands(&source, &currents, args.coil).map_err(Failure::usage)?;
    let end_s = observed.time_s.last().copied().unwrap_or_default();
    let lost_some = table.is_none() && recording.currents_lost as f64 > FEW_LACKING * currents.len() as f64;
    let mut doubtful =
        currents::warn_of_values(&source, std::slice::from_ref(&held), end_s, plant.is_some()) || lost_some;
    warn_of_frames(args, &name, &observed, (&source, &held));
    let middle_s = 0.5 * end_s;
    let apparent = apparent_delay(args, &observed, &held, plant, own_clock.then_some(middle_s));
    let delay_s = delay_taken(args, &name, apparent.as_ref())?;
    match (&apparent, observed.grid()) {
        (Some(delay), _) => warn_of_delay(args, &name, delay, delay_s, &recording),
        (None, Ok(grid)) => tracing::warn!(
            "{name}: simple models told neither the delay between commands and output (searched within {:.0} ms), nor \
             a drift of the currents' clock, nor the zero of θ: that they are right is not checked",
            clock_delay::MAX_DELAY * grid.period_s * 1e3
        ),
        // Told with the uneven frames.
        (None, Err(_)) => {}
    }
    // Delays that explain the record about as well agree about the drift.
    let held = match apparent.as_ref().and_then(|delay| Some((delay, delay.drift.filter(Drift::is_significant)?))) {
        Some((delay, drift)) => without_drift(args, &source, held, (drift, delay.others_s.is_empty()), middle_s),
        None => held,
    };
    let zero = apparent.as_ref().and_then(|delay| delay.zero).filter(|_| args.detrend() == Detrend::None);
    if let Some(zero) = zero.filter(Zero::is_off) {
        let sd_rad = upper_median(recording.frames.iter().filter_map(|frame| frame.theta_sd_rad));
        if sd_rad.is_none_or(|sd_rad| zero.offset.abs() > sd_rad) {
            warn_of_zero(zero, &name);
        }
        observed.theta_rad.iter_mut().flatten().for_each(|theta| *theta -= zero.offset);
    }
    let series = observed.series(&held, plant, delay_s).map_err(Failure::usage)?;
    let mut series = Series { fit_zero: args.fits_zero(), ..series };
    if args.resample || args.decimate.is_some_and(|factor| factor > 1) {
        // What they do within frames is not taken off then.
        doubtful |= currents::warn_of_changes(&source, std::slice::from_ref(&held), &observed, delay_s);
    } else {
        observed.add_within(&mut series, &held, delay_s);
    }
    let lost = series.output.len() - observed.theta_rad.len();
    let missed = observed.theta_rad.iter().filter(|theta| theta.is_none()).count();
    let (mut record, grid, bridged) = on_grid(args, &series)?;
    if let (DelayArg::Auto, Some(delay)) = (args.delay, &apparent) {
        let later = observed.series(&held, plant, delay_s + delay.sd_s).map_err(Failure::usage)?;
        tell_uncertain_delay(&mut record, &on_grid(args, &later)?.0);
    }
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
        doubtful,
        ..RecordSummary::default()
    };
    Ok(Read { record, summary })
}

/// A run says neither what is taken for its input, nor needs a time from row to row.
fn input_and_times_are_clear(args: &Args, name: &str, plant: Option<Plant>) -> Result<(), Failure> {
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
    Ok(())
}

/// Warns of uneven frames, of currents that are a slow log, and of angles that are hardly degrees.
fn warn_of_frames(args: &Args, name: &str, observed: &Observed, (source, held): (&str, &Held)) {
    match observed.grid() {
        Ok(grid) => currents::warn_of_slow_log(source, held, grid.period_s),
        Err(GridError::Uneven { period_s, .. } | GridError::RateChanges { period_s, .. }) if args.resample => {
            currents::warn_of_slow_log(source, held, period_s);
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
}

/// The delay of the output to use, seconds: the given one, or with `--delay auto` the apparent one.
fn delay_taken(args: &Args, name: &str, apparent: Option<&Delay>) -> Result<f64, Failure> {
    match (args.delay, apparent) {
        (DelayArg::Given(seconds), _) => Ok(seconds),
        (DelayArg::Auto, Some(delay)) => match delay.others_in_words() {
            None => Ok(delay.delay_s),
            Some(others) => Err(Failure::usage(format!(
                "{name}: the delay between commands and output cannot be told: besides {:.1} ms, {others} explain \
                 the record about as well; commands over a wider band of frequencies would tell, or give it with \
                 --delay",
                delay.delay_s * 1e3
            ))),
        },
        (DelayArg::Auto, None) => Err(Failure::usage(format!(
            "{name}: no delay between commands and output could be estimated; give it with --delay"
        ))),
    }
}

/// Tells a record what one σ of the delay does to its input. `later`: the same with commands that much later.
fn tell_uncertain_delay(record: &mut Record, later: &Record) {
    let later_at = |place: usize| {
        let later = later.segments.iter().find(|s| (s.first..s.first + s.len()).contains(&place))?;
        later.input.get(place - later.first).copied()
    };
    for segment in &mut record.segments {
        let places = segment.input.iter().enumerate().map(|(k, input)| (segment.first + k, input));
        segment.by_delay = Some(places.map(|(place, input)| later_at(place).unwrap_or(*input) - input).collect());
    }
}

/// Warns of an apparent delay that is not the one taken, or is doubtful.
fn warn_of_delay(args: &Args, name: &str, apparent: &Delay, taken_s: f64, recording: &Recording) {
    if let Some(others) = apparent.others_in_words() {
        tracing::warn!(
            "{name}: delays of the output by {others} would explain the record about as well, and the right one may \
             lie in between: whether the times of the commands are right cannot be told (does the output move only in \
             a narrow band of frequencies, or are commands missing?)"
        );
        return;
    }
    let is_before = apparent.is_before(taken_s);
    let matters = args.delay == DelayArg::Auto || is_before;
    let Delay { delay_s, sd_s, .. } = apparent;
    if let Some(times) = misfit(recording, apparent).filter(|_| matters) {
        tracing::warn!(
            "{name}: the delay between commands and output, {:.1} ± {:.1} ms, is that of a simple model, \
             which leaves {times:.0} times σ of θ: it makes up for what the model lacks, and may be off by many \
             times its σ",
            delay_s * 1e3,
            sd_s * 1e3
        );
    } else if is_before {
        tracing::warn!(
            "{name}: θ seems to move {:.1} ± {:.1} ms before the commands: with wrong times H(s) is wrong; \
             --delay auto corrects them",
            (taken_s - delay_s) * 1e3,
            sd_s * 1e3
        );
    }
}

/// Tells an error of the zero that σ of θ does not explain.
fn warn_of_zero(zero: Zero, name: &str) {
    tracing::warn!(
        "{name}: the zero of θ is off by {:.3} ± {:.3}°, by a simple model: a wrong base frame, a \
         catheter that does not hang straight, or an offset of the currents? It is taken off, which does not help \
         against an offset of the currents; --zero exact leaves θ as it is",
        zero.offset.to_degrees(),
        zero.sd.to_degrees()
    );
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
        "{source}: by a simple model the clock of the currents seems to run {ppm:.1} ± {sd:.1} ppm fast \
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
    let held = held.zero_before();
    // All delays are judged by the same samples: those whose commands are known for every delay.
    let known_s = held.span_s()?.0 + given_s + (clock_delay::MAX_DELAY + 2.0) * period_s;
    let cut_off = known_s > *observed.time_s.first()?;
    let observed = if cut_off { observed.from(known_s) } else { observed.clone() };
    // Its times are those of each delay.
    let series = observed.series(&held, plant, given_s).ok()?;
    let grid = Grid::of(&series.name, &series.time_s).ok()?;
    let found = clock_delay::estimate(period_s, own_clock, |Timing { delay_s, drift }, inputs| {
        let held = own_clock.map_or(Cow::Borrowed(&held), |middle_s| Cow::Owned(held.drifted(drift, middle_s)));
        let series = observed.series(&held, plant, given_s + delay_s).ok()?;
        let mut series = Series { fit_zero: args.fits_zero(), ..series };
        if inputs == Inputs::Changing {
            observed.add_within(&mut series, &held, given_s + delay_s);
        }
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
