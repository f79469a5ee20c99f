//! The records that are identified from: runs with their coil currents, and what they must have in common.

use super::args::Args;
use crate::cli::Failure;
use crate::cli::results::unfinished;
use crate::plural::{are, plural};
use crate::series::{Current, CurrentClock, CurrentTable, Recording};
use std::path::Path;

/// Largest relative difference of two periods that are one for a model: with 0.2 % coefficients were off by 3 σ.
const SAME_PERIOD: f64 = 5e-4;
/// Largest relative difference of periods that are meant to be one: 59.94 and 60 Hz.
const MEANT_AS_ONE: f64 = 0.01;

/// All records, those to judge by last, each with its table of currents if there are tables.
pub(super) fn files(args: &Args) -> Result<Vec<(&Path, Option<&Path>)>, Failure> {
    let files: Vec<&Path> = args.records.iter().chain(&args.validate).map(AsRef::as_ref).collect();
    if let Some(folder) = files.iter().find(|file| file.is_dir()) {
        return Err(Failure::usage(format!("{}: is a folder; give the log or table in it", folder.display())));
    }
    if !args.currents.is_empty() && args.currents.len() != files.len() {
        let (tables, records) = (plural(args.currents.len(), "table"), plural(files.len(), "record"));
        return Err(Failure::usage(format!("--currents: {tables} for {records}; give one for each, in their order")));
    }
    let tables = args.currents.iter().map(|table| Some(table.as_path())).chain(std::iter::repeat(None));
    Ok(files.into_iter().zip(tables).collect())
}

/// A run, and the currents of its coils on the camera's clock.
pub(super) struct Driven {
    pub(super) recording: Recording,
    /// File of the currents.
    pub(super) source: String,
    /// Whether their times are those of a clock that nothing relates to the camera's but an assumed start.
    pub(super) own_clock: bool,
    /// Names of the coils.
    pub(super) coils: Vec<String>,
    pub(super) currents: Vec<Current>,
}

impl Driven {
    /// Reads a run, with its currents from the table or else from its own log; warns of what is missing.
    ///
    /// # Errors
    /// When either cannot be read, or the table's clock cannot be related to the camera's.
    pub(super) fn read(file: &Path, table: Option<&Path>) -> Result<Self, Failure> {
        let name = file.display().to_string();
        let mut recording = Recording::read(file)?;
        if let Some(warning) = unfinished(file) {
            tracing::warn!("{warning}");
        }
        if let Some(why) = &recording.cut {
            tracing::warn!("{name}: not all of it can be read: {why}");
        }
        let Some(path) = table else {
            let currents = std::mem::take(&mut recording.currents);
            if recording.currents_lost > 0 {
                let lost = are(recording.currents_lost, "sample");
                tracing::warn!(
                    "{name}: by the numbers of its samples of currents, {lost} lost: what the coils had meanwhile is \
                     not known"
                );
            }
            let count = currents.first().map_or(0, |current| current.values_a.len());
            let coils = (0..count).map(|coil| format!("coil_{coil}")).collect();
            return Ok(Self { recording, source: name, own_clock: false, coils, currents });
        };
        let source = path.display().to_string();
        let table = CurrentTable::read(path)?;
        if let Some(assumed) = table.assumption(&recording, None) {
            tracing::info!("{source}: {assumed}");
        }
        let currents = table.on_camera_clock(&recording, None)?;
        let own_clock = table.clock == CurrentClock::Start;
        Ok(Self { recording, source, own_clock, coils: table.coils, currents })
    }
}

/// Whether two periods are meant to be one.
pub(super) fn is_one_period(one_s: f64, other_s: f64) -> bool {
    (one_s / other_s - 1.0).abs() <= MEANT_AS_ONE
}

/// Refuses records whose periods differ. `records`: names and periods, seconds; `advice`: what else could be done.
pub(super) fn one_period<'a>(mut records: impl Iterator<Item = (&'a str, f64)>, advice: &str) -> Result<(), Failure> {
    let Some((first, first_s)) = records.next() else { return Ok(()) };
    match records.find(|(_, period_s)| (period_s / first_s - 1.0).abs() > SAME_PERIOD) {
        None => Ok(()),
        Some((name, period_s)) => Err(Failure::usage(format!(
            "{name}: samples are {period_s:.6} s apart, and {first_s:.6} s in {first}: records that belong together \
             have one period{advice}"
        ))),
    }
}
