//! `catoptra validate`: tracked runs along a desired path, to errors and response at each speed.

use super::outcome::{self, Json, Outcome};
use super::output::REPORT;
use super::results::{Results, unfinished};
use super::units::{seconds_ns, short_s};
use super::{Exit, Failure, interrupt, output, provenance};
use crate::identify::Plant;
use crate::identify::results::saved::Saved;
use crate::plural::plural;
use crate::report::validation::{self, ModelLine};
use crate::series::Recording;
use crate::validate::{Average, DesiredPath, Interpolation, Observed, Options, ValidateError, Validation, validate};
use clap::ValueEnum;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Arguments of `catoptra validate`.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Tracked runs, one for each pause time
    #[arg(value_name = "LOG.mcap|TABLE.csv", required = true)]
    observed: Vec<PathBuf>,
    /// The desired path of the marker, base frame: columns x_mm, y_mm, z_mm, one row per point
    #[arg(long, value_name = "PATH.csv")]
    desired: PathBuf,
    /// How long each point was commanded, one for each run, in their order
    #[arg(long, value_name = "T", required = true, value_delimiter = ',', value_parser = short_s)]
    pause: Vec<f64>,
    /// Camera time of the first command, s [default: by ticks, else currents, else searched]
    #[arg(long, value_name = "T", value_delimiter = ',', value_parser = seconds_ns, allow_hyphen_values = true)]
    start: Vec<i64>,
    /// How many times the path was commanded [default: 4, or as often as it is in the file]
    #[arg(long, value_name = "N")]
    periods: Option<usize>,
    /// Points per period [default: the rows of the file]
    #[arg(long, value_name = "N")]
    points_per_period: Option<usize>,
    /// Periods to leave out at the beginning, while the motion settles
    #[arg(long, value_name = "N", default_value_t = 1)]
    skip: usize,
    /// The marker that follows the path [default: tip]
    #[arg(long, value_name = "NAME")]
    marker: Option<String>,
    /// Frames of a pause that make its point: all, or the laboratory's second half
    #[arg(long, value_enum, default_value_t = Frames::All)]
    average: Frames,
    /// From frame to frame, where pauses are shorter than the time between frames
    #[arg(long, value_enum, default_value_t = InterpolationArg::Spline)]
    interpolate: InterpolationArg,
    /// Draw a model beside the runs: model.json, H(s) in a file, or eq7 of the paper
    #[arg(long, value_name = "FILE|eq7")]
    model: Option<PathBuf>,
    /// The model is from net torque to θ: close gravity over it
    #[arg(long, value_name = "PLANT.toml", requires = "model")]
    plant: Option<PathBuf>,
    /// Folder for the results
    #[arg(short, long, value_name = "DIR")]
    out: PathBuf,
    #[command(flatten)]
    json: Json,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Frames {
    All,
    SecondHalf,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum InterpolationArg {
    Spline,
    Linear,
}

const TABLE: &str = "validation.csv";
const TABLE_2: &str = "table.md";
const RESULT: &str = "validation.json";

/// Of a pause, without the digits of rounding: 19.9 ms, not 19.900000000000002.
fn ms(pause_s: f64) -> f64 {
    (pause_s * 1e9).round() / 1e6
}

pub(crate) fn run(args: &Args, quiet: bool) -> Result<(), Failure> {
    interrupt::end_at_once()?;
    outcome::of("validate", args.json, quiet, |outcome| evaluate(args, outcome))
}

fn evaluate(args: &Args, outcome: &Outcome) -> Result<(), Failure> {
    // 1. everything is checked before anything is written
    let runs = args.observed.len();
    if args.pause.len() != runs {
        let (runs, times) = (plural(runs, "run"), plural(args.pause.len(), "pause time"));
        let text = format!("{runs} and {times}: give --pause once for each run, in their order");
        return Err(Failure::usage(text));
    }
    if args.start.len() > 1 && args.start.len() != runs {
        let (runs, starts) = (plural(runs, "run"), plural(args.start.len(), "start"));
        let text = format!("{runs} and {starts}: give --start once for all runs, or once for each");
        return Err(Failure::usage(text));
    }
    args.results().check()?;
    let saved = args.model.as_deref().map(Saved::read).transpose().map_err(Failure::usage)?;
    let plant = args.plant.as_deref().map(Plant::load).transpose().map_err(Failure::usage)?;
    let path = DesiredPath::read(&args.desired, args.points_per_period, args.periods).map_err(failure)?;
    args.observed.iter().filter_map(|file| unfinished(file)).for_each(|warning| tracing::warn!("{warning}"));
    let recordings = args
        .observed
        .iter()
        .map(|file| Recording::read(file))
        .collect::<Result<Vec<_>, _>>()
        .map_err(|e| failure(e.into()))?;
    for (k, (one, file)) in recordings.iter().zip(&args.observed).enumerate() {
        let same = recordings.iter().take(k).position(|before| before.frames == one.frames);
        if let Some(before) = same.and_then(|before| args.observed.get(before)) {
            tracing::warn!(
                "{} and {} have the same frames: is one of them another run?",
                before.display(),
                file.display()
            );
        }
    }
    let starts = (0..runs).map(|k| args.start.get(k).or(args.start.first()).copied());
    let observed: Vec<Observed<'_>> = recordings
        .iter()
        .zip(&args.pause)
        .zip(starts)
        .map(|((recording, pause_s), start_ns)| Observed { recording, pause_s: *pause_s, start_ns })
        .collect();
    // 2. the evaluation
    let validation = validate(path, &observed, args.options()).map_err(failure)?;
    if let Some(note) = validation.path.note() {
        tracing::warn!("{}: {note}", args.desired.display());
    }
    for run in &validation.runs {
        for note in &run.notes {
            tracing::warn!("{} ms: {note}", ms(run.pause_s));
        }
    }
    // 3. the files
    let line = saved.as_ref().and_then(|saved| model_line(saved, plant, &validation));
    let json = validation.json().map_err(|e| cannot_be_written(&args.out, e))?;
    args.write(&validation, &json, line.as_ref())?;
    outcome.found(|| serde_json::from_str(&json).map_err(|e| cannot_be_written(&args.out.join(RESULT), e)))?;
    outcome.print(&summary(&validation, &args.out))
}

impl Args {
    fn options(&self) -> Options {
        let interpolation = match self.interpolate {
            InterpolationArg::Spline => Interpolation::Spline,
            InterpolationArg::Linear => Interpolation::Linear,
        };
        let average = match self.average {
            Frames::All => Average::All,
            Frames::SecondHalf => Average::SecondHalf,
        };
        Options { skip: self.skip, marker: self.marker.clone(), average, interpolation }
    }

    /// Names of the tables of points, one per run in the order in which they are given: two runs of one pause time have
    /// a number each.
    fn tables_of_points(&self) -> Vec<String> {
        let mut seen: BTreeMap<String, u32> = BTreeMap::new();
        let name = |pause_s: &f64| {
            let name = format!("points_{}ms", ms(*pause_s));
            let times = seen.entry(name.clone()).or_default();
            *times += 1;
            if *times == 1 { format!("{name}.csv") } else { format!("{name}_{times}.csv") }
        };
        self.pause.iter().map(name).collect()
    }

    /// The folder, whose files are those of earlier results of the same runs or none.
    fn results(&self) -> Results<'_> {
        let tables = [TABLE, RESULT, TABLE_2, REPORT].into_iter().map(str::to_owned);
        Results {
            folder: &self.out,
            command: "validate",
            recordings: &self.observed,
            inputs: self
                .observed
                .iter()
                .chain([&self.desired])
                .chain(&self.model)
                .chain(&self.plant)
                .map(PathBuf::as_path)
                .collect(),
            files: tables.chain(self.tables_of_points()).collect(),
        }
    }

    fn write(&self, validation: &Validation, json: &str, line: Option<&ModelLine>) -> Result<(), Failure> {
        let folder = &self.out;
        let _writing = self.results().take()?;
        let save = |name: &str, text: &str| -> Result<(), Failure> {
            let place = folder.join(name);
            output::save(&place, text)?;
            outcome::wrote(&place);
            Ok(())
        };
        let table = validation.csv().map_err(|e| cannot_be_written(folder, e))?;
        save(TABLE, &table)?;
        save(RESULT, json)?;
        save(TABLE_2, &validation.table())?;
        save(REPORT, &validation::page(validation, &self.settings(), line))?;
        let names = self.tables_of_points();
        for run in &validation.runs {
            if let Some(name) = names.get(run.given) {
                save(name, &run.points_csv())?;
            }
        }
        Ok(())
    }

    fn settings(&self) -> Vec<(String, String)> {
        let between = if self.interpolate == InterpolationArg::Spline { "cubic spline" } else { "straight lines" };
        let averaged = if self.average == Frames::All { "all frames of a pause" } else { "the second half of a pause" };
        [
            ("Left out".to_owned(), format!("{} of them, at the beginning", self.skip)),
            ("Averaged".to_owned(), averaged.to_owned()),
            ("Between frames".to_owned(), between.to_owned()),
        ]
        .into_iter()
        .chain(provenance::of_this_run())
        .collect()
    }
}

/// The model to use, over the frequencies of the runs. With `plant` it is from net torque to θ, and the torque of
/// gravity, −m g L θ near rest, is closed over it: H/(1 + m g L H), what a current moves.
fn model_line(saved: &Saved, plant: Option<Plant>, validation: &Validation) -> Option<ModelLine> {
    let model = saved.leading()?;
    let weight = plant.map_or(0.0, |plant| plant.weight_torque_nm);
    let response = |f: f64| model.response(f).map(|h| h / (h * weight + 1.0));
    Some(ModelLine::of(format!("{}, {}", saved.name, model.title), validation, response))
}

fn cannot_be_written(place: &Path, error: impl std::error::Error + Send + Sync + 'static) -> Failure {
    Failure::because(Exit::Failed, format!("{}: cannot be written: {error}", place.display()), error)
}

fn failure(error: ValidateError) -> Failure {
    let exit = match &error {
        ValidateError::Unusable { .. } => Exit::Unusable,
        ValidateError::Series(series) if series.is_io() && !series.is_missing() => Exit::Failed,
        _ => Exit::Usage,
    };
    Failure::new(exit, error)
}

fn summary(validation: &Validation, folder: &Path) -> String {
    let mut text = validation.table();
    match validation::bandwidth_hz(validation) {
        Some(hz) => text += &format!("\n3 dB below the slowest run at {hz:.3} Hz\n"),
        None if validation.path.circle.is_none() => {
            text += "\nno bandwidth: the path is not a circle, so its motion has several frequencies\n"
        }
        None if validation.runs.len() > 1 => {
            text += "\nthe magnitude does not fall 3 dB below that of the slowest run\n"
        }
        None => {}
    }
    text + &format!("\nwritten: {}\n", folder.join(REPORT).display())
}
