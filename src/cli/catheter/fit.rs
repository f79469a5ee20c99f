//! `catoptra catheter fit`: the catheter's parameters from tracked runs.

use super::super::copies;
use super::super::output::{PAGE, save};
use super::super::results::unfinished;
use super::super::units::{duration_s, seconds_ns};
use super::super::{Exit, Failure, output, provenance};
use super::bands::{self, Seen};
use super::run::Columns;
use super::{Common, failure, prepare};
use crate::catheter::{
    Accuracy, Catheter, CatheterError, Check, Commands, Fit, FitOptions, Noise, Parameter, Run, Sighting, check, fit,
};
use crate::digits::fixed;
use crate::plural::plural;
use crate::report::catheter_fit;
use crate::series::{CurrentClock, CurrentTable, Recording};
use crate::source::times::seconds;
use nalgebra::Vector3;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

/// The last command is held for longer than seems meant: over so many times the longest of the others, and seconds.
const HELD_TOO_LONG: (f64, f64) = (5.0, 1.0);
/// What is written, and how it begins: a catheter's file that somebody wrote is not replaced.
const FILES: [(&str, &str); 3] =
    [("catheter.toml", "# Fitted to "), ("fit.csv", "parameter,unit,value,sd,"), ("fit.html", PAGE)];

#[derive(Debug, clap::Args)]
pub(super) struct FitArgs {
    #[command(flatten)]
    common: Common,
    /// Tracked runs in the base frame
    #[arg(value_name = "LOG.mcap|TABLE.csv", required = true)]
    runs: Vec<PathBuf>,
    /// Currents of each run: a table or a .play list; logs may have them
    #[arg(long, value_name = "FILE", num_args = 1..)]
    currents: Vec<PathBuf>,
    /// Runs that are not fitted, to judge the result by
    #[arg(long, value_name = "RUN", num_args = 1..)]
    validate: Vec<PathBuf>,
    /// Currents of these
    #[arg(long, value_name = "FILE", num_args = 1..)]
    validate_currents: Vec<PathBuf>,
    /// The rig of the runs, for where the bands are on the tube [default: the one recorded with each]
    #[arg(long, value_name = "RIG.toml")]
    rig: Option<PathBuf>,
    #[command(flatten)]
    columns: Columns,
    /// Camera time at which the currents' table starts, seconds
    #[arg(long, value_name = "T", value_parser = seconds_ns, allow_hyphen_values = true)]
    start: Option<i64>,
    /// What to fit; what the data do not determine is then an error
    #[arg(long, value_name = "NAMES", value_delimiter = ',', value_parser = parameter)]
    parameters: Vec<Parameter>,
    /// Time from a change of currents until the catheter is at rest
    #[arg(long, value_name = "T", default_value = "3s", value_parser = duration_s)]
    settle: f64,
    /// Use shapes at rest only
    #[arg(long)]
    only_still: bool,
    /// Longest step of the computed motion
    #[arg(long, value_name = "T", default_value = "2ms", value_parser = duration_s)]
    step: f64,
    /// Folder for the results
    #[arg(short, long, value_name = "DIR")]
    out: PathBuf,
}

fn parameter(text: &str) -> Result<Parameter, String> {
    Parameter::ALL.into_iter().find(|p| p.name() == text.trim()).ok_or_else(|| {
        format!("`{text}` is not a parameter; parameters are {}", Parameter::ALL.map(Parameter::name).join(", "))
    })
}

impl FitArgs {
    pub(super) fn run(&self, quiet: bool) -> Result<(), Failure> {
        for (flag, tables, runs) in [
            ("--currents", &self.currents, &self.runs),
            ("--validate-currents", &self.validate_currents, &self.validate),
        ] {
            if !tables.is_empty() && tables.len() != runs.len() {
                let (tables, runs) = (plural(tables.len(), "table"), plural(runs.len(), "run"));
                return Err(Failure::usage(format!("{flag}: {tables} for {runs}; give one for each, in their order")));
            }
        }
        let inputs = [&self.runs, &self.currents, &self.validate, &self.validate_currents].into_iter().flatten();
        let files = [&self.rig, &self.common.catheter].into_iter().flatten();
        let inputs: Vec<&Path> = inputs.chain(files).map(PathBuf::as_path).collect();
        prepare(&self.out, &FILES, &inputs)?;
        self.check_start()?;
        let seen = |files: &[PathBuf]| -> Result<Vec<Option<Seen>>, Failure> {
            files.iter().map(|file| Seen::by(file, self.rig.as_deref())).collect()
        };
        let (seen_fitted, seen_judged) = (seen(&self.runs)?, seen(&self.validate)?);
        let (name, mut catheter) = match (&self.common.catheter, seen_fitted.iter().flatten().next()) {
            (None, Some(seen)) => (format!("the paper's prototype with the lengths of {}", seen.name), seen.on(None)?),
            _ => self.common.load()?,
        };
        let read = |files: &[PathBuf], tables: &[PathBuf], seen: &[Option<Seen>]| {
            let runs = files.iter().zip(seen).enumerate();
            let runs = runs.map(|(k, (file, seen))| self.read(&catheter, file, tables.get(k), seen.as_ref()));
            runs.collect::<Result<Vec<(Run, Option<Noise>)>, Failure>>()
        };
        let fitted = read(&self.runs, &self.currents, &seen_fitted)?;
        let judged = read(&self.validate, &self.validate_currents, &seen_judged)?;
        let judged: Vec<Run> = judged.into_iter().map(|(run, _)| run).collect();
        let all: Vec<(&Run, bool)> =
            fitted.iter().map(|(run, _)| (run, true)).chain(judged.iter().map(|run| (run, false))).collect();
        copies::check(&all, |a, b| a.0.sightings == b.0.sightings, |(run, is_fitted)| (&run.name, *is_fitted))?;
        // The file that is written says where the bands of its runs are.
        catheter.bands = fitted.iter().find_map(|(run, _)| run.bands).or(catheter.bands);
        let stated_noise = fitted.iter().find_map(|(_, stated_noise)| *stated_noise);
        let runs: Vec<Run> = fitted.into_iter().map(|(run, _)| run).collect();
        let accuracy = Accuracy { step_s: self.step, ..Accuracy::default() };
        let default = || Parameter::DEFAULT.into_iter().filter(|p| p.is_static() || !self.only_still).collect();
        let parameters = if self.parameters.is_empty() { default() } else { self.parameters.clone() };
        let options =
            FitOptions { parameters, settle_s: self.settle, only_still: self.only_still, accuracy, stated_noise };
        let result = fit(&catheter, 0.0, &runs, &options).map_err(unusable)?;
        let open: Vec<String> = result.open.iter().map(|open| open.sentence()).collect();
        if !self.parameters.is_empty() && !open.is_empty() {
            return Err(Failure::new(Exit::Unusable, open.join("\n")));
        }
        for open in &open {
            tracing::warn!("{open}");
        }
        for doubt in result.doubts() {
            tracing::warn!("doubt: {doubt}");
        }
        let checks = |runs: &[Run]| -> Result<Vec<Check>, Failure> {
            runs.iter().map(|run| check(&result.catheter, result.delay_s, run, accuracy).map_err(failure)).collect()
        };
        let (own, other) = (checks(&runs)?, checks(&judged)?);
        for doubt in own.iter().chain(&other).filter_map(Check::doubt) {
            tracing::warn!("doubt: {doubt}");
        }
        save(&self.out.join("catheter.toml"), &result.catheter.to_toml(&self.heading(&name)))?;
        save(&self.out.join("fit.csv"), &values(&result))?;
        let settings =
            [("Start".to_owned(), name.clone())].into_iter().chain(provenance::of_this_run()).collect::<Vec<_>>();
        let all = runs
            .iter()
            .zip(&own)
            .map(|(r, c)| (r, c, true))
            .chain(judged.iter().zip(&other).map(|(r, c)| (r, c, false)));
        let page = catheter_fit::page(&result, &all.collect::<Vec<_>>(), &settings);
        save(&self.out.join("fit.html"), &page)?;
        if quiet { Ok(()) } else { output::print(&self.summary(&result, &own, &other)) }
    }

    /// Refuses a start where no times are counted from one.
    fn check_start(&self) -> Result<(), Failure> {
        let mut unused = self.start.is_some();
        for file in self.currents.iter().chain(&self.validate_currents) {
            unused = unused && CurrentTable::read(file)?.clock != CurrentClock::Start;
        }
        if unused {
            let text = "--start: is for tables whose times count from a start (t_s) and for lists; the currents here \
                        have times of a clock: leave it out";
            return Err(Failure::usage(text));
        }
        Ok(())
    }

    fn heading(&self, name: &str) -> String {
        let runs: Vec<String> = self.runs.iter().map(|run| run.display().to_string()).collect();
        format!("Fitted to {}; what is not fitted is that of {name}.", runs.join(", "))
    }

    /// A run, and what its tracker says of the noise.
    fn read(
        &self,
        catheter: &Catheter,
        file: &Path,
        table: Option<&PathBuf>,
        seen: Option<&Seen>,
    ) -> Result<(Run, Option<Noise>), Failure> {
        let wrong = |problem: &str| Failure::usage(format!("{}: {problem}", file.display()));
        let recording = Recording::read(file)?;
        if let Some(warning) = unfinished(file) {
            tracing::warn!("{warning}");
        }
        if let Some(why) = &recording.cut {
            tracing::warn!("{}: not all of it can be read: {why}", file.display());
        }
        recording.in_base_frame()?;
        let bands = bands::of(&recording, seen, catheter)?;
        // The model counts from the clamp.
        let origin = Vector3::z() * bands.map_or(0.0, |bands| bands.base_m);
        let (coil, tip) = (recording.marker("coil")?, recording.marker("tip")?);
        let mut commands: Vec<(i64, Vec<f64>)> = Vec::new();
        let coils = match table {
            Some(table) => {
                let table = CurrentTable::read(table)?;
                if let Some(assumption) = table.assumption(&recording, self.start) {
                    tracing::warn!("{}: {assumption}", table.path.display());
                }
                for current in table.on_camera_clock(&recording, self.start)? {
                    commands.extend(current.stamp_ns.map(|ns| (ns, current.values_a)));
                }
                self.columns
                    .of(&table.coils)
                    .map_err(|why| Failure::usage(format!("{}: {why}", table.path.display())))?
            }
            None => {
                commands.extend(recording.currents.iter().filter_map(|c| Some((c.stamp_ns?, c.values_a.clone()))));
                let count = commands.iter().map(|(_, values)| values.len()).max().unwrap_or(0);
                let names: Vec<String> = (1..=count).map(|k| format!("channel_{k}")).collect();
                if count == 0 {
                    return Err(wrong("has no coil currents: give a table of them with --currents"));
                }
                self.columns.of(&names).map_err(|why| wrong(&why))?
            }
        };
        let commands = in_order(commands);
        let (Some(first), Some(frame)) = (commands.first().map(|c| c.0), recording.frames.first()) else {
            return Err(wrong("has no frame, or no current"));
        };
        let zero_ns = first.min(frame.stamp_ns);
        let since_zero_s = |ns: i64| seconds(ns - zero_ns);
        let value = |row: &[f64], column: Option<usize>| column.and_then(|k| row.get(k)).copied().unwrap_or(0.0);
        let rows = commands
            .iter()
            .map(|(ns, values)| (since_zero_s(*ns), Vector3::from(coils.map(|column| value(values, column)))));
        let of_currents = table.map_or(file, PathBuf::as_path).display();
        let commands = Commands::new(catheter, rows)
            .map_err(|e| Failure::usage(format!("{of_currents}: {e}; are the currents in amperes?")))?;
        let sightings: Vec<Sighting> = recording
            .frames
            .iter()
            .map(|frame| Sighting {
                time_s: since_zero_s(frame.stamp_ns),
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
            tracing::warn!("{}: {warning}", table.unwrap_or(&file.to_owned()).display());
        }
        if !sightings.iter().any(|s| s.tip.is_some()) {
            return Err(wrong("no frame has a place of the tip"));
        }
        let sd_m = rms(recording.frames.iter().filter_map(|f| f.places.get(tip)?.sd_m));
        let sd_rad = rms(recording.frames.iter().filter_map(|f| f.tangent_sd_rad));
        let stated_noise = sd_m.zip(sd_rad).map(|(point_m, angle_rad)| Noise { point_m, angle_rad, missing: 0.0 });
        Ok((Run { name: file.display().to_string(), commands, sightings, bands }, stated_noise))
    }

    fn summary(&self, fit: &Fit, own: &[Check], other: &[Check]) -> String {
        let frames = if fit.in_motion { "all frames" } else { "shapes at rest" };
        let mut text = format!("fitted to {frames}, {} at rest\n\n", plural(fit.pauses.len(), "pause"));
        // Writing into text cannot fail.
        for estimated in &fit.estimated {
            let (unit, scale) = estimated.parameter.unit();
            let (value, sd) = (estimated.value * scale, estimated.sd * scale);
            let value = fixed(value, 4);
            let _ = writeln!(text, "  {:<12} {value:>10} ± {sd:.4} {unit}", estimated.parameter.name());
        }
        for open in &fit.open {
            let _ = writeln!(text, "  {:<12} not determined", open.parameter.name());
        }
        let noise = fit.noise;
        let _ = writeln!(
            text,
            "\n  residuals are {:.2} times the noise of {:.3} mm and {:.3}°",
            fit.misfit,
            noise.point_m * 1e3,
            noise.angle_rad.to_degrees()
        );
        if let Some(widening) = fit.widening() {
            let _ = writeln!(text, "  {widening}");
        }
        if fit.unsettled > 0 {
            let _ = writeln!(text, "  {} had not come to rest: lengthen --settle", plural(fit.unsettled, "pause"));
        }
        let _ = writeln!(text, "\n  RMS            tip      coil       θ");
        // Also of frames between the pauses, to which nothing was fitted then.
        let word_own = if fit.in_motion { "fitted" } else { "all frames" };
        for (check, word) in own.iter().map(|c| (c, word_own)).chain(other.iter().map(|c| (c, "not fitted"))) {
            let (tip, coil, theta) = (check.tip_rms_m * 1e3, check.coil_rms_m * 1e3, check.theta_rms_rad.to_degrees());
            let _ = writeln!(text, "  {word:<10} {tip:.3} mm  {coil:.3} mm  {theta:.3}°  {}", check.name);
        }
        let _ = writeln!(text, "\nwritten: {} in {}", FILES.map(|(name, _)| name).join(", "), self.out.display());
        text
    }
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

fn rms(values: impl Iterator<Item = f64>) -> Option<f64> {
    let values: Vec<f64> = values.filter(|v| *v > 0.0).collect();
    (!values.is_empty()).then(|| (values.iter().map(|v| v * v).sum::<f64>() / values.len() as f64).sqrt())
}

fn unusable(error: CatheterError) -> Failure {
    let exit = if matches!(error, CatheterError::Fit(_)) { Exit::Unusable } else { Exit::Usage };
    Failure::new(exit, error)
}

/// Values, σ and correlations as a table.
fn values(fit: &Fit) -> String {
    let names: Vec<&str> = fit.estimated.iter().map(|e| e.parameter.name()).collect();
    let mut text = format!("parameter,unit,value,sd,{}\r\n", names.join(","));
    for (k, estimated) in fit.estimated.iter().enumerate() {
        let (unit, scale) = estimated.parameter.unit();
        let (value, sd) = (estimated.value * scale, estimated.sd * scale);
        let correlations: Vec<String> = fit.correlation.row(k).iter().map(|c| format!("{c:.4}")).collect();
        let _ =
            write!(text, "{},{unit},{value:.9e},{sd:.3e},{}\r\n", estimated.parameter.name(), correlations.join(","));
    }
    text
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
