//! `catoptra identify`: a log, or a table of any two columns, to the dynamics of what moved.

mod reading;
mod words;

use super::{Exit, Failure, interrupt, output};
use crate::identify::arx::Orders;
use crate::identify::chain::{Choice, Data, Estimator, Settings, identify};
use crate::identify::fit::Start;
use crate::identify::prepare::Detrend;
use crate::identify::reduce::{Removal, Target};
use crate::identify::search::Criterion;
use crate::identify::{IdentifyError, export};
use crate::report::identification;
use crate::whole_file;
use clap::ValueEnum;
use std::num::NonZeroUsize;
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};

/// Orders searched when none are given, as far as the data allow.
const ORDERS: RangeInclusive<usize> = 1..=20;
/// Samples that each coefficient of a searched model must have.
const SAMPLES_A_COEFFICIENT: usize = 10;

/// Arguments of `catoptra identify`. There are many: each has one line of help.
#[derive(Debug, clap::Args)]
#[command(hide_possible_values = true)]
pub(crate) struct Args {
    /// Logs or tables of `track` and `live`, or with --input and --output any tables of numbers
    #[arg(value_name = "RECORD", required = true, hide = true)]
    records: Vec<PathBuf>,
    /// Coil, field and pendulum: Eq. 6 makes a torque of current and θ
    #[arg(long, value_name = "PLANT.toml", conflicts_with_all = ["input", "output"])]
    plant: Option<PathBuf>,
    /// Coil currents of each record, where its log has none
    #[arg(long, value_name = "C.csv", conflicts_with = "output")]
    currents: Vec<PathBuf>,
    /// The coil that moved it, counted from 0
    #[arg(long, value_name = "N", default_value_t = 0, conflicts_with = "output")]
    coil: usize,
    /// Commands act so much later; `auto`: as estimated
    #[arg(long, value_name = "T|auto", default_value = "0", allow_hyphen_values = true, conflicts_with = "output")]
    delay: DelayArg,
    /// Column of the input, name or number; `current` of a log: no Eq. 6
    #[arg(long, value_name = "COLUMN")]
    input: Option<String>,
    /// Column of the output
    #[arg(long, value_name = "COLUMN", requires = "input")]
    output: Option<String>,
    /// Column of the time in seconds
    #[arg(long, value_name = "COLUMN", requires = "output", conflicts_with = "period")]
    time: Option<String>,
    /// Seconds from row to row; with --resample, from sample to sample
    #[arg(long, value_name = "S", value_parser = positive)]
    period: Option<f64>,
    /// Records to judge by; theirs are the last of --currents
    #[arg(long, value_name = "RECORD", num_args = 1..)]
    validate: Vec<PathBuf>,
    /// Fit samples A to B−1 of the record, from 0
    #[arg(long, value_name = "A:B")]
    train: Option<Range>,
    /// Judge by samples C to D−1 of the record
    #[arg(long, value_name = "C:D")]
    test: Option<Range>,
    /// Take off, as fitted data have it: none, mean, linear
    #[arg(long, value_name = "WHAT", value_enum, default_value_t = DetrendArg::None)]
    detrend: DetrendArg,
    /// Keep every N-th sample behind a low-pass filter
    #[arg(long, value_name = "N")]
    decimate: Option<NonZeroUsize>,
    /// Allow uneven times: outputs are interpolated
    #[arg(long)]
    resample: bool,
    /// Angles in a row that Eq. 6 may interpolate
    #[arg(long, value_name = "N", default_value_t = 6)]
    bridge: usize,
    /// Order, or orders to search, na = nb [default: 1:20 or less]
    #[arg(long, value_name = "N|A:B")]
    order: Option<Span>,
    /// Past outputs, in place of --order
    #[arg(long, value_name = "N|A:B", conflicts_with = "order")]
    na: Option<Span>,
    /// Inputs, in place of --order
    #[arg(long, value_name = "N|A:B", conflicts_with = "order")]
    nb: Option<Span>,
    /// Delay in samples, at least 1 with Eq. 6 [default: 1:5]
    #[arg(long, value_name = "N|A:B")]
    nk: Option<Span>,
    /// By aic, mdl, prediction, simulation [default: the last it can]
    #[arg(long, value_name = "WHAT", value_enum)]
    select: Option<Select>,
    /// Full order by arx, oe (output error), iv (instruments)
    #[arg(long, value_name = "WHICH", value_enum, default_value_t = EstimatorArg::Arx)]
    estimator: EstimatorArg,
    /// State simulations begin in: rest, estimated
    #[arg(long, value_name = "STATE", value_enum, default_value_t = StartArg::Rest)]
    start: StartArg,
    /// Order to reduce to
    #[arg(long, value_name = "N|auto", default_value = "2")]
    reduce: TargetArg,
    /// Reduce so that the gain at zero frequency is kept
    #[arg(long)]
    match_dc: bool,
    /// Reduce for the excited band alone
    #[arg(long)]
    weighted: bool,
    /// Repetitions of the bootstrap
    #[arg(long, value_name = "N", default_value_t = 100)]
    bootstrap: usize,
    /// Folder for the results
    #[arg(short, long, value_name = "DIR")]
    out: PathBuf,
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum DelayArg {
    Given(f64),
    Auto,
}

impl std::str::FromStr for DelayArg {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if text == "auto" {
            return Ok(Self::Auto);
        }
        let seconds = text.strip_suffix('s').unwrap_or(text);
        let (number, scale) = seconds.strip_suffix('m').map_or((seconds, 1.0), |ms| (ms, 1e-3));
        let value = number.parse::<f64>().ok().filter(|v| v.is_finite());
        value.map(|v| Self::Given(v * scale)).ok_or_else(|| format!("`{text}` is no time: write 20ms, 0.02 or auto"))
    }
}

/// A:B, B excluded.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Range {
    from: usize,
    to: usize,
}

impl std::str::FromStr for Range {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let parts = text.split_once(':').and_then(|(a, b)| Some((a.parse().ok()?, b.parse().ok()?)));
        match parts {
            Some((from, to)) if from < to => Ok(Self { from, to }),
            _ => Err(format!("`{text}` is no range of samples: write 0:500 for the first 500")),
        }
    }
}

/// N, or A:B with both.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Span {
    from: usize,
    to: usize,
}

impl Span {
    fn all(self) -> RangeInclusive<usize> {
        self.from..=self.to
    }
}

impl std::str::FromStr for Span {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (from, to) = text.split_once(':').unwrap_or((text, text));
        match (from.parse(), to.parse()) {
            (Ok(from), Ok(to)) if from <= to && to <= 200 => Ok(Self { from, to }),
            _ => Err(format!("`{text}` is neither a number up to 200 nor a range of them: write 15 or 1:30")),
        }
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct TargetArg(Target);

impl std::str::FromStr for TargetArg {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "auto" => Ok(Self(Target::Auto)),
            _ => match text.parse() {
                Ok(order) if order > 0 => Ok(Self(Target::Order(order))),
                _ => Err(format!("`{text}` is no order: write a number from 1, or auto")),
            },
        }
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum DetrendArg {
    None,
    Mean,
    Linear,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Select {
    Aic,
    Mdl,
    Prediction,
    Simulation,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum EstimatorArg {
    Arx,
    Oe,
    Iv,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum StartArg {
    Rest,
    Estimated,
}

fn positive(text: &str) -> Result<f64, String> {
    let value = text.parse::<f64>().ok().filter(|v| v.is_finite() && *v > 0.0);
    value.ok_or_else(|| format!("`{text}` is no number of seconds above 0, such as 0.01"))
}

pub(crate) fn run(args: &Args, quiet: bool) -> Result<(), Failure> {
    interrupt::end_at_once()?;
    // 1. signals
    let (data, told) = reading::read(args)?;
    let samples: usize = data.training.iter().map(crate::identify::data::Record::observed).sum();
    let settings = args.settings(samples, !data.validation.is_empty())?;
    // 2. models
    let done = identify(&data, &settings).map_err(|error| failure(&data, error))?;
    for doubt in &done.doubts {
        tracing::warn!("{doubt}");
    }
    // 3. files
    let written = {
        let _whole = interrupt::wait();
        std::fs::create_dir_all(&args.out).map_err(|e| {
            let why = if args.out.is_file() { "there is a file of this name".to_owned() } else { e.to_string() };
            Failure::new(Exit::Failed, format!("cannot make the folder {}: {why}", args.out.display()))
        })?;
        let mut written = export::write(&args.out, &data, &done, &told).map_err(|e| Failure::new(Exit::Failed, e))?;
        let page = args.out.join("report.html");
        put(&page, identification::page(&data, &done, &told).as_bytes())?;
        written.push(page);
        written
    };
    // 4. words
    if !quiet {
        output::print(&words::summary(&data, &done, &told, &written))?;
    }
    if done.models.iter().any(|m| m.role == crate::identify::modelled::Role::Full && !m.is_stable()) {
        let text = "the model of full order is unstable: what was written describes it and is not to be relied on";
        return Err(Failure::new(Exit::Unusable, text));
    }
    Ok(())
}

fn put(path: &Path, bytes: &[u8]) -> Result<(), Failure> {
    whole_file::write(path, bytes)
        .map_err(|e| Failure::new(Exit::Failed, format!("cannot write {}: {e}", path.display())))
}

/// With the records it is about.
fn failure(data: &Data, error: IdentifyError) -> Failure {
    let exit = match error {
        IdentifyError::Nothing { .. } | IdentifyError::Still { .. } => return Failure::new(Exit::Usage, error),
        IdentifyError::TooShort { .. } | IdentifyError::TooShortToJudge { .. } => Exit::Usage,
        IdentifyError::Dependent { .. }
        | IdentifyError::Unstable { .. }
        | IdentifyError::NotReduced { .. }
        | IdentifyError::NoneDetermined
        | IdentifyError::NoneStable { .. } => Exit::Unusable,
    };
    let judged = matches!(error, IdentifyError::TooShortToJudge { .. });
    let records = if judged { &data.validation } else { &data.training };
    let names: Vec<&str> = records.iter().map(|r| r.name.as_str()).collect();
    Failure::new(exit, format!("{}: {error}", names.join(", ")))
}

impl Args {
    /// With Eq. 6: the input holds the angle of the same time, so the delay is one sample at least.
    fn fed_back(&self) -> bool {
        self.plant.is_some()
    }

    fn settings(&self, samples: usize, judged: bool) -> Result<Settings, Failure> {
        let delays = self.nk.map_or(1..=5, Span::all);
        if self.fed_back() && *delays.start() == 0 {
            let text = "--nk 0: with Eq. 6 the torque holds the angle of the same sample, which would explain itself; the least is 1";
            return Err(Failure::new(Exit::Usage, text));
        }
        let select = self.select;
        if !judged && matches!(select, Some(Select::Prediction | Select::Simulation)) {
            let text = "--select: there are no data to judge by; give --validate or --test, or select by mdl or aic";
            return Err(Failure::new(Exit::Usage, text));
        }
        let candidates = self.candidates(samples, delays)?;
        let choice = match *candidates {
            [only] => Choice::Fixed(only),
            _ => Choice::Search { candidates, criterion: select.map(Select::criterion) },
        };
        Ok(Settings {
            choice,
            estimator: match self.estimator {
                EstimatorArg::Arx => Estimator::Arx,
                EstimatorArg::Oe => Estimator::OutputError,
                EstimatorArg::Iv => Estimator::Instrumental,
            },
            start: self.start(),
            target: self.reduce.0,
            removal: if self.match_dc { Removal::MatchDc } else { Removal::Truncate },
            weighted: self.weighted,
            bootstrap: self.bootstrap,
        })
    }

    fn start(&self) -> Start {
        match self.start {
            StartArg::Rest => Start::Rest,
            StartArg::Estimated => Start::Estimated,
        }
    }

    fn detrend(&self) -> Detrend {
        match self.detrend {
            DetrendArg::None => Detrend::None,
            DetrendArg::Mean => Detrend::Mean,
            DetrendArg::Linear => Detrend::Linear,
        }
    }

    /// All orders and delays asked for.
    fn candidates(&self, samples: usize, delays: RangeInclusive<usize>) -> Result<Vec<Orders>, Failure> {
        let none = |what: &str| Failure::new(Exit::Usage, format!("{what} 0: a model needs one coefficient at least"));
        let with_delays = |na: usize, nb: usize| delays.clone().map(move |nk| Orders { na, nb, nk });
        if self.na.is_some() || self.nb.is_some() {
            let (Some(na), Some(nb)) = (self.na, self.nb) else {
                return Err(Failure::new(Exit::Usage, "--na and --nb go together"));
            };
            if nb.from == 0 {
                return Err(none("--nb"));
            }
            return Ok(na
                .all()
                .flat_map(|na| nb.all().map(move |nb| (na, nb)))
                .flat_map(|(na, nb)| with_delays(na, nb))
                .collect());
        }
        let orders = match self.order {
            Some(span) if span.from == 0 => return Err(none("--order")),
            Some(span) => span.all(),
            None => {
                let most = (samples / (2 * SAMPLES_A_COEFFICIENT)).clamp(1, *ORDERS.end());
                *ORDERS.start()..=most
            }
        };
        Ok(orders.flat_map(|n| with_delays(n, n)).collect())
    }
}

impl Select {
    fn criterion(self) -> Criterion {
        match self {
            Self::Aic => Criterion::Aic,
            Self::Mdl => Criterion::Mdl,
            Self::Prediction => Criterion::Prediction,
            Self::Simulation => Criterion::Simulation,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_and_delays_as_people_write_them() {
        assert_eq!("0:500".parse(), Ok(Range { from: 0, to: 500 }));
        assert!("5:5".parse::<Range>().is_err() && "5".parse::<Range>().is_err());
        assert_eq!("15".parse(), Ok(Span { from: 15, to: 15 }));
        assert_eq!("1:30".parse(), Ok(Span { from: 1, to: 30 }));
        assert!("30:1".parse::<Span>().is_err() && "-1".parse::<Span>().is_err());
        assert_eq!("20ms".parse(), Ok(DelayArg::Given(0.02)));
        assert_eq!("-0.5".parse(), Ok(DelayArg::Given(-0.5)));
        assert!("soon".parse::<DelayArg>().is_err() && "nan".parse::<DelayArg>().is_err());
        assert!("0".parse::<TargetArg>().is_err());
    }
}
