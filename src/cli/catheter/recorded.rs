//! What is fitted to: a tracked run with its currents.

use super::super::Failure;
use super::super::results::unfinished;
use super::bands::{self, Seen};
use super::run::Columns;
use crate::catheter::{Catheter, Commands, Noise, Run, Sighting};
use crate::digits::fixed;
use crate::series::{CurrentTable, Recording};
use crate::source::times::seconds;
use nalgebra::Vector3;
use std::path::{Path, PathBuf};

/// The last command is held for longer than seems meant: over so many times the longest of the others, and seconds.
const HELD_TOO_LONG: (f64, f64) = (5.0, 1.0);

/// How the files of runs are read.
pub(super) struct Reading<'a> {
    pub(super) catheter: &'a Catheter,
    pub(super) columns: &'a Columns,
    /// Camera time at which tables of currents start, nanoseconds.
    pub(super) start_ns: Option<i64>,
}

impl Reading<'_> {
    /// A run, and what its tracker says of the noise.
    pub(super) fn run(
        &self,
        file: &Path,
        table: Option<&PathBuf>,
        seen: Option<&Seen>,
    ) -> Result<(Run, Option<Noise>), Failure> {
        let recording = read(file)?;
        let bands = bands::of(&recording, seen, self.catheter)?;
        let wrong = |problem: &str| Failure::usage(format!("{}: {problem}", file.display()));
        let commands = self.commands(file, table, &recording)?;
        let (Some(first), Some(frame)) = (commands.first().map(|c| c.0), recording.frames.first()) else {
            return Err(wrong("has no frame, or no current"));
        };
        let zero_ns = first.min(frame.stamp_ns);
        let since_zero_s = |ns: i64| seconds(ns - zero_ns);
        let of_currents = table.map_or(file, PathBuf::as_path).display();
        let rows = commands.into_iter().map(|(ns, values)| (since_zero_s(ns), values));
        let commands = Commands::new(self.catheter, rows)
            .map_err(|e| Failure::usage(format!("{of_currents}: {e}; are the currents in amperes?")))?;
        let (coil, tip) = (recording.marker("coil")?, recording.marker("tip")?);
        // The model counts from the clamp.
        let origin = Vector3::z() * bands.map_or(0.0, |bands| bands.base_m);
        let sightings: Vec<Sighting> = recording
            .frames
            .iter()
            .map(|frame| Sighting {
                time_s: since_zero_s(frame.stamp_ns),
                base: None,
                coil: frame.places.get(coil).and_then(|place| place.point).map(|point| point + origin),
                tip: frame.places.get(tip).and_then(|place| place.point).map(|point| point + origin),
                tangent: frame.tangent,
            })
            .collect();
        if sightings.windows(2).any(|pair| matches!(pair, [a, b] if b.time_s <= a.time_s)) {
            return Err(wrong("its frames' times do not rise: the camera's clock restarted"));
        }
        let last_s = sightings.last().map_or(0.0, |s| s.time_s);
        if let Some(warning) = held_too_long(&commands, last_s) {
            tracing::warn!("{of_currents}: {warning}");
        }
        let lacks = |has: fn(&Sighting) -> bool| !sightings.iter().any(has);
        if lacks(|s| s.tip.is_some()) {
            return Err(wrong("no frame has a place of the tip"));
        }
        if lacks(|s| s.coil.is_some()) {
            return Err(wrong("no frame has a place of the coil"));
        }
        if lacks(|s| s.tangent.is_some()) {
            return Err(wrong("no frame has a direction of the coil (tan_x, tan_y, tan_z)"));
        }
        let sd_m = rms(recording.frames.iter().filter_map(|f| f.places.get(tip)?.sd_m));
        let sd_rad = rms(recording.frames.iter().filter_map(|f| f.tangent_sd_rad));
        let stated_noise = sd_m.zip(sd_rad).map(|(point_m, angle_rad)| Noise { point_m, angle_rad, missing: 0.0 });
        Ok((Run { name: file.display().to_string(), commands, sightings, bands }, stated_noise))
    }

    /// Currents of the three coils by their camera times, nanoseconds and amperes.
    fn commands(
        &self,
        file: &Path,
        table: Option<&PathBuf>,
        recording: &Recording,
    ) -> Result<Vec<(i64, Vector3<f64>)>, Failure> {
        let wrong = |file: &Path, why: &str| Failure::usage(format!("{}: {why}", file.display()));
        let mut commands: Vec<(i64, Vec<f64>)> = Vec::new();
        let coils = match table {
            Some(table) => {
                let table = CurrentTable::read(table)?;
                if let Some(assumption) = table.assumption(recording, self.start_ns) {
                    tracing::warn!("{}: {assumption}", table.path.display());
                }
                for current in table.on_camera_clock(recording, self.start_ns)? {
                    commands.extend(current.stamp_ns.map(|ns| (ns, current.values_a)));
                }
                if let Some(assumption) = self.columns.assumption(&table.coils) {
                    tracing::warn!("{}: {assumption}", table.path.display());
                }
                self.columns.of(&table.coils).map_err(|why| wrong(&table.path, &why))?
            }
            None => {
                commands.extend(recording.currents.iter().filter_map(|c| Some((c.stamp_ns?, c.values_a.clone()))));
                let count = commands.iter().map(|(_, values)| values.len()).max().unwrap_or(0);
                let names: Vec<String> = (1..=count).map(|k| format!("channel_{k}")).collect();
                if count == 0 {
                    return Err(wrong(file, "has no coil currents: give a table of them with --currents"));
                }
                self.columns.of(&names).map_err(|why| wrong(file, &why))?
            }
        };
        let value = |row: &[f64], column: Option<usize>| column.and_then(|k| row.get(k)).copied().unwrap_or(0.0);
        let of_coils = |values: Vec<f64>| Vector3::from(coils.map(|column| value(&values, column)));
        Ok(in_order(commands).into_iter().map(|(ns, values)| (ns, of_coils(values))).collect())
    }
}

/// A run that is in the base frame.
fn read(file: &Path) -> Result<Recording, Failure> {
    let recording = Recording::read(file)?;
    if let Some(warning) = unfinished(file) {
        tracing::warn!("{warning}");
    }
    if let Some(why) = &recording.cut {
        tracing::warn!("{}: not all of it can be read: {why}", file.display());
    }
    recording.in_base_frame()?;
    Ok(recording)
}

/// Commands by their times; of several at the same time the last counts.
fn in_order(mut commands: Vec<(i64, Vec<f64>)>) -> Vec<(i64, Vec<f64>)> {
    commands.sort_by_key(|(ns, _)| *ns);
    commands.dedup_by(|later, kept| {
        let same = later.0 == kept.0;
        if same {
            std::mem::swap(later, kept);
        }
        same
    });
    commands
}

/// A warning when the last command is held for much longer than all others: probably the table ends before the run.
/// Without current that is how tables end.
fn held_too_long(commands: &Commands, last_s: f64) -> Option<String> {
    let (from_s, _, held) = commands.pauses().last().filter(|(_, _, held)| *held != Vector3::zeros())?;
    let longest_s =
        commands.pauses().map(|(from_s, to_s, _)| to_s - from_s).filter(|s| s.is_finite()).reduce(f64::max)?;
    let held_s = last_s - from_s;
    (held_s > HELD_TOO_LONG.0 * longest_s && held_s > HELD_TOO_LONG.1).then(|| {
        let [x, y, z] = <[f64; 3]>::from(held * 1e3).map(|ma| fixed(ma, 1));
        format!(
            "its last currents ({x}, {y}, {z} mA) are taken to be held from {from_s:.2} s to the run's end at \
             {last_s:.2} s, no others for longer than {longest_s:.2} s: if they ended before, end the table with a row \
             of zeros"
        )
    })
}

pub(super) fn rms(values: impl Iterator<Item = f64>) -> Option<f64> {
    let values: Vec<f64> = values.filter(|v| *v > 0.0).collect();
    (!values.is_empty()).then(|| (values.iter().map(|v| v * v).sum::<f64>() / values.len() as f64).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn commands_are_in_order_and_the_last_of_a_time_counts() {
        let commands = [(3, 0.3), (1, 0.1), (2, 0.2), (1, 0.4), (3, 0.5), (3, 0.0)].map(|(ns, a)| (ns, vec![a]));
        assert_eq!(in_order(commands.to_vec()), [(1, 0.4), (2, 0.2), (3, 0.0)].map(|(ns, a)| (ns, vec![a])));
    }

    #[test]
    fn a_table_that_ends_before_its_run_is_told() {
        let last = |held: f64, last_s: f64| {
            let rows = [(1.0, 0.05), (1.5, -0.05), (2.1, held)].map(|(t, z)| (t, Vector3::new(0.0, 0.0, z)));
            held_too_long(&Commands::new(&Catheter::prototype(), rows).unwrap(), last_s)
        };
        let warning = last(0.02, 5.3).unwrap();
        assert!(warning.contains("(0.0, 0.0, 20.0 mA)") && warning.contains("from 2.10 s to the run's end at 5.30 s"));
        assert!(warning.contains("longer than 0.60 s"), "{warning}");
        assert_eq!((last(0.02, 5.0), last(0.0, 60.0)), (None, None));
        let one = Commands::new(&Catheter::prototype(), [(0.0, Vector3::new(0.0, 0.0, 0.05))]).unwrap();
        assert_eq!(held_too_long(&one, 60.0), None);
    }
}
