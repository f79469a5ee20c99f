//! `catoptra catheter fit`: the catheter's parameters from tracked runs.

use super::super::copies;
use super::super::output::{PAGE, save};
use super::super::progress::Stages;
use super::super::units::{duration_s, seconds_ns};
use super::super::{Exit, Failure, output, provenance, writing};
use super::bands::Seen;
use super::recorded::{Reading, rms};
use super::run::Columns;
use super::{Common, Own, failure, prepare};
use crate::catheter::{
    Accuracy, CatheterError, Check, Fit, FitOptions, Noise, Parameter, Run, check, fit_with_progress,
};
use crate::digits::fixed;
use crate::plural::plural;
use crate::report::catheter_fit;
use crate::series::{CurrentClock, CurrentTable};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

/// What is written, and how it begins: a catheter's file that somebody wrote is not replaced.
const FILES: [(&str, Own); 3] = [
    ("catheter.toml", Own::Begins("# Fitted to ")),
    ("fit.csv", Own::Begins("parameter,unit,value,sd,")),
    ("fit.html", Own::Begins(PAGE)),
];

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
        if let Some(twice) = self.parameters.iter().enumerate().find(|(k, p)| self.parameters[..*k].contains(p)) {
            return Err(Failure::usage(format!("--parameters: {} is given twice", twice.1.name())));
        }
        let stages = Stages::new(quiet);
        stages.begin("reading the runs");
        let seen = |files: &[PathBuf]| -> Result<Vec<Option<Seen>>, Failure> {
            files.iter().map(|file| Seen::by(file, self.rig.as_deref())).collect()
        };
        let (seen_fitted, seen_judged) = (seen(&self.runs)?, seen(&self.validate)?);
        let (name, mut catheter) = match (&self.common.catheter, seen_fitted.iter().flatten().next()) {
            (None, Some(seen)) => (format!("the paper's prototype with the lengths of {}", seen.name), seen.on(None)?),
            _ => self.common.load()?,
        };
        let read = |files: &[PathBuf], tables: &[PathBuf], seen: &[Option<Seen>]| {
            let reading = Reading { catheter: &catheter, columns: &self.columns, start_ns: self.start };
            let runs = files.iter().zip(seen).enumerate();
            let runs = runs.map(|(k, (file, seen))| reading.run(file, tables.get(k), seen.as_ref()));
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
        let stated_noise = mean_noise(fitted.iter().filter_map(|(_, stated_noise)| *stated_noise));
        let runs: Vec<Run> = fitted.into_iter().map(|(run, _)| run).collect();
        let accuracy = Accuracy { step_s: self.step, ..Accuracy::default() };
        let default = || Parameter::DEFAULT.into_iter().filter(|p| p.is_static() || !self.only_still).collect();
        let parameters = if self.parameters.is_empty() { default() } else { self.parameters.clone() };
        let options =
            FitOptions { parameters, settle_s: self.settle, only_still: self.only_still, accuracy, stated_noise };
        let progress = |what: &str| stages.begin(what);
        let result = fit_with_progress(&catheter, 0.0, &runs, &options, &progress).map_err(unusable)?;
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
        stages.begin("comparing the motion with the runs");
        let (own, other) = (checks(&runs)?, checks(&judged)?);
        drop(stages);
        for doubt in own.iter().chain(&other).filter_map(Check::doubt) {
            tracing::warn!("doubt: {doubt}");
        }
        let whole = writing::wait();
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
        drop(whole);
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

/// The noise of runs together: the RMS of theirs.
fn mean_noise(of_runs: impl Iterator<Item = Noise> + Clone) -> Option<Noise> {
    let point_m = rms(of_runs.clone().map(|noise| noise.point_m))?;
    Some(Noise { point_m, angle_rad: rms(of_runs.map(|noise| noise.angle_rad))?, missing: 0.0 })
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
