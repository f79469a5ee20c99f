//! Arguments of `catoptra identify`, and the settings they give.

use crate::cli::Failure;
use crate::cli::outcome::HiddenJson;
use crate::cli::output::REPORT;
use crate::cli::results::Results;
use crate::cli::units::{duration_s, signed_short_s};
use crate::identify::Repeats;
use crate::identify::chain::settings::{Choice, Estimator, Settings};
use crate::identify::data::prepare::Detrend;
use crate::identify::estimate::search::Criterion;
use crate::identify::model::polynomials::Orders;
use crate::identify::model::reproduction::InitialState;
use crate::identify::reduce::truncation::{Removal, Target};
use crate::identify::results::export;
use clap::ValueEnum;
use clap::builder::RangedU64ValueParser;
use std::ops::RangeInclusive;
use std::path::PathBuf;

/// The input of a log without Eq. 6.
pub(super) const CURRENT: &str = "current";

/// Orders searched when none are given, as far as the data allow.
const ORDERS: RangeInclusive<usize> = 1..=20;
/// Fewest samples per coefficient of a searched model.
const SAMPLES_PER_COEFFICIENT: usize = 10;

/// Options of the models of one plane.
const NOT_WITH_PLANES: [&str; 21] = [
    "plant",
    "coil",
    "input",
    "period",
    "train",
    "test",
    "detrend",
    "decimate",
    "resample",
    "bridge",
    "zero",
    "na",
    "nb",
    "select",
    "estimator",
    "start",
    "match_dc",
    "all_frequencies",
    "bootstrap",
    "repeats",
    "model",
];

/// Options of a fit.
const NOT_WITH_MODEL: [&str; 13] = [
    "validate",
    "train",
    "order",
    "na",
    "nb",
    "nk",
    "select",
    "estimator",
    "reduce",
    "match_dc",
    "all_frequencies",
    "bootstrap",
    "repeats",
];

/// Arguments of `catoptra identify`. There are many: each has one line of help.
#[derive(Debug, clap::Args)]
#[command(hide_possible_values = true)]
pub(crate) struct Args {
    /// Logs or tables of `track` and `live`, or with --input and --output any tables of numbers
    #[arg(value_name = "RECORD", required = true, hide = true)]
    pub(super) records: Vec<PathBuf>,
    /// Coil, field and pendulum, for the net torque of Eq. 6
    #[arg(long, value_name = "PLANT.toml", conflicts_with_all = ["input", "output"])]
    pub(super) plant: Option<PathBuf>,
    /// Coil currents of each record, where its log has none
    #[arg(long, value_name = "C.csv", value_delimiter = ',', conflicts_with = "output")]
    pub(super) currents: Vec<PathBuf>,
    /// The coil that moved it, counted from 0
    #[arg(long, value_name = "N", default_value_t = 0, conflicts_with = "output")]
    pub(super) coil: usize,
    /// Both angles from all coils: motion that leaves the plane of B0
    #[arg(long, conflicts_with_all = NOT_WITH_PLANES)]
    pub(super) planes: bool,
    /// Commands act this much later; `auto`: as estimated
    #[arg(long, value_name = "T|auto", default_value = "0", allow_hyphen_values = true, conflicts_with = "output")]
    pub(super) delay: DelayArg,
    /// Column of the input, name or number; `current` of a log: no Eq. 6
    #[arg(long, value_name = "COLUMN")]
    pub(super) input: Option<String>,
    /// Column of the output
    #[arg(long, value_name = "COLUMN", requires = "input")]
    pub(super) output: Option<String>,
    /// Column of the time in seconds (or as its name says: t_ms, stamp_ns)
    #[arg(long, value_name = "COLUMN", requires = "output")]
    pub(super) time: Option<String>,
    /// Seconds from row to row; with --resample, from sample to sample
    #[arg(long, value_name = "S", value_parser = positive)]
    pub(super) period: Option<f64>,
    /// Records to judge by; theirs are the last of --currents
    #[arg(long, value_name = "RECORD", num_args = 1..)]
    pub(super) validate: Vec<PathBuf>,
    /// Fit samples A to B−1 of the record, from 0
    #[arg(long, value_name = "A:B")]
    pub(super) train: Option<Range>,
    /// Judge by samples C to D−1 of the record
    #[arg(long, value_name = "C:D")]
    pub(super) test: Option<Range>,
    /// Remove mean or trend: none, mean, linear
    #[arg(long, value_name = "WHAT", value_enum, default_value_t = DetrendArg::None)]
    pub(super) detrend: DetrendArg,
    /// Keep every N-th sample after a low-pass filter
    #[arg(long, value_name = "N", value_parser = count(1, 10_000))]
    pub(super) decimate: Option<usize>,
    /// Allow uneven times: outputs are interpolated
    #[arg(long)]
    pub(super) resample: bool,
    /// Angles in a row that Eq. 6 may interpolate
    #[arg(long, value_name = "N", default_value_t = 6, value_parser = count(0, 100_000), hide = true)]
    pub(super) bridge: usize,
    /// Zero of θ: fitted, exact
    #[arg(long, value_name = "HOW", value_enum, default_value_t = ZeroArg::Fitted)]
    #[arg(conflicts_with = "output", hide = true)]
    pub(super) zero: ZeroArg,
    /// Order, or orders to search, na = nb [default: 1:20 or less]
    #[arg(long, value_name = "N|A:B")]
    pub(super) order: Option<Span>,
    /// With --nb: past outputs and inputs, in place of --order
    #[arg(long, value_name = "N|A:B", conflicts_with = "order")]
    pub(super) na: Option<Span>,
    /// Inputs, in place of --order
    #[arg(long, value_name = "N|A:B", conflicts_with = "order", hide = true)]
    pub(super) nb: Option<Span>,
    /// Delay in samples, at least 1 with Eq. 6 [default: 1:5]
    #[arg(long, value_name = "N|A:B")]
    pub(super) nk: Option<Span>,
    /// By aic, mdl, prediction, simulation [default: the last possible]
    #[arg(long, value_name = "WHAT", value_enum)]
    pub(super) select: Option<Select>,
    /// Full order by arx, oe (output error), iv (instruments)
    #[arg(long, value_name = "WHICH", value_enum, default_value_t = EstimatorArg::Arx)]
    pub(super) estimator: EstimatorArg,
    /// State simulations begin in: rest, estimated
    #[arg(long, value_name = "STATE", value_enum, default_value_t = StartArg::Rest)]
    pub(super) start: StartArg,
    /// Order to reduce to [default: 2; with --planes auto, per angle]
    #[arg(long, value_name = "N|auto")]
    pub(super) reduce: Option<TargetArg>,
    /// Reduce so that the gain at zero frequency is kept
    #[arg(long)]
    pub(super) match_dc: bool,
    /// Reduce for all frequencies, as the paper does, not for those excited
    #[arg(long)]
    pub(super) all_frequencies: bool,
    /// Repetitions of the bootstrap
    #[arg(long, value_name = "N", default_value_t = 100, value_parser = count(0, 100_000))]
    pub(super) bootstrap: usize,
    /// The input repeats every T: average, leave SKIP out [default: 1]
    #[arg(long, value_name = "T[:SKIP]")]
    pub(super) repeats: Option<RepeatsArg>,
    /// Fit nothing: apply a model.json, H(s), or eq7 of the paper
    #[arg(long, value_name = "FILE|eq7", conflicts_with_all = NOT_WITH_MODEL)]
    pub(super) model: Option<PathBuf>,
    /// Folder for the results
    #[arg(short, long, value_name = "DIR")]
    pub(super) out: PathBuf,
    #[command(flatten)]
    pub(super) json: HiddenJson,
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum DelayArg {
    Given(f64),
    Auto,
}

impl std::str::FromStr for DelayArg {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if text == "auto" {
            return Ok(Self::Auto);
        }
        signed_short_s(text).map(Self::Given).map_err(|why| format!("{why}, or auto"))
    }
}

/// A:B, B excluded.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Range {
    pub(super) from: usize,
    pub(super) to: usize,
}

impl std::str::FromStr for Range {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let parts = text.split_once(':').and_then(|(a, b)| Some((a.parse().ok()?, b.parse().ok()?)));
        match parts {
            Some((from, to)) if from < to => Ok(Self { from, to }),
            _ => Err(format!("`{text}` is not a range of samples: write 0:500 for the first 500")),
        }
    }
}

/// N, or A:B with both.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Span {
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
pub(super) struct TargetArg(Target);

impl std::str::FromStr for TargetArg {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "auto" => Ok(Self(Target::Auto)),
            _ => match text.parse() {
                Ok(order) if order > 0 => Ok(Self(Target::Order(order))),
                _ => Err(format!("`{text}` is not an order: write a number from 1, or auto")),
            },
        }
    }
}

/// T or T:SKIP.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct RepeatsArg(Repeats);

impl RepeatsArg {
    pub(super) fn words(self) -> String {
        format!("every {} s, {} left out", self.0.every_s, self.0.skip)
    }
}

impl std::str::FromStr for RepeatsArg {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (every, skip) = text.split_once(':').unwrap_or((text, "1"));
        let skip =
            skip.parse().map_err(|_| format!("`{text}`: after the colon comes a number of periods, as in 20s:2"))?;
        Ok(Self(Repeats { every_s: duration_s(every)?, skip }))
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(super) enum DetrendArg {
    None,
    Mean,
    Linear,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(super) enum Select {
    Aic,
    Mdl,
    Prediction,
    Simulation,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(super) enum EstimatorArg {
    Arx,
    Oe,
    Iv,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(super) enum StartArg {
    Rest,
    Estimated,
}

/// What is known of the output's zero.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(super) enum ZeroArg {
    Fitted,
    Exact,
}

/// A whole number from `least` to `most`.
fn count(least: u64, most: u64) -> RangedU64ValueParser<usize> {
    RangedU64ValueParser::new().range(least..=most)
}

fn positive(text: &str) -> Result<f64, String> {
    let value = text.parse::<f64>().ok().filter(|v| v.is_finite() && *v > 0.0);
    value.ok_or_else(|| format!("`{text}` is not a number of seconds above 0, such as 0.01"))
}

impl Args {
    /// With Eq. 6: the input contains the angle of the same time, so the delay is at least one sample.
    fn fed_back(&self) -> bool {
        self.plant.is_some()
    }

    /// Whether the zero of the output is fitted: that of θ is known to the base frame's σ only.
    pub(super) fn fits_zero(&self) -> bool {
        self.output.is_none() && self.zero == ZeroArg::Fitted
    }

    /// The output folder, which must be empty or have earlier results of the same records.
    pub(super) fn results(&self) -> Results<'_> {
        let tables = self.validate.iter().chain(&self.plant).chain(&self.currents).chain(&self.model);
        Results {
            folder: &self.out,
            command: "identify",
            recordings: &self.records,
            inputs: self.records.iter().chain(tables).map(PathBuf::as_path).collect(),
            files: export::FILES.into_iter().chain(["response.csv", REPORT]).map(str::to_owned).collect(),
        }
    }

    pub(super) fn settings(&self, samples: usize, judged: bool) -> Result<Settings, Failure> {
        let delays = self.nk.map_or(1..=5, Span::all);
        if self.fed_back() && *delays.start() == 0 {
            let text = "--nk 0: with Eq. 6 the torque holds the angle of the same sample, which would explain itself; \
                the least is 1";
            return Err(Failure::usage(text));
        }
        let select = self.select;
        if !judged && matches!(select, Some(Select::Prediction | Select::Simulation)) {
            let text = "--select: there are no data to judge by; give --validate or --test with --train, or select by \
                mdl or aic";
            return Err(Failure::usage(text));
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
            initial_state: self.initial_state(),
            target: self.reduce.map_or(Target::Order(2), |target| target.0),
            removal: if self.match_dc { Removal::MatchDc } else { Removal::Truncate },
            all_frequencies: self.all_frequencies,
            bootstrap: self.bootstrap,
            repeats: self.repeats.map(|r| r.0),
            // A current is what was commanded; of other columns nothing is known.
            commanded: self.plant.is_none() && self.output.is_none(),
            doubtful: false,
        })
    }

    /// Lowest and highest order with `--planes`.
    pub(super) fn planes_orders(&self) -> (usize, usize) {
        self.order.map_or((*ORDERS.start(), *ORDERS.end()), |span| (span.from, span.to))
    }

    /// Delay with `--planes`, samples.
    pub(super) fn planes_delay(&self) -> Result<usize, Failure> {
        match self.nk {
            None => Ok(1),
            Some(Span { from, to }) if from == to => Ok(from),
            Some(Span { from, to }) => {
                let text = format!("--nk {from}:{to}: with --planes the delay is not searched; give one number");
                Err(Failure::usage(text))
            }
        }
    }

    /// States for each angle with `--planes`; `None` for as few as do.
    pub(super) fn planes_keep(&self) -> Option<usize> {
        match self.reduce?.0 {
            Target::Order(order) => Some(order),
            Target::Auto => None,
        }
    }

    pub(super) fn initial_state(&self) -> InitialState {
        match self.start {
            StartArg::Rest => InitialState::Rest,
            StartArg::Estimated => InitialState::Estimated,
        }
    }

    pub(super) fn detrend(&self) -> Detrend {
        match self.detrend {
            DetrendArg::None => Detrend::None,
            DetrendArg::Mean => Detrend::Mean,
            DetrendArg::Linear => Detrend::Linear,
        }
    }

    /// All requested orders and delays.
    fn candidates(&self, samples: usize, delays: RangeInclusive<usize>) -> Result<Vec<Orders>, Failure> {
        let none = |what: &str| Failure::usage(format!("{what} 0: a model needs one coefficient at least"));
        let with_delays = |na: usize, nb: usize| delays.clone().map(move |nk| Orders { na, nb, nk });
        if self.na.is_some() || self.nb.is_some() {
            let (Some(na), Some(nb)) = (self.na, self.nb) else {
                return Err(Failure::usage("--na and --nb go together"));
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
                let most = (samples / (2 * SAMPLES_PER_COEFFICIENT)).clamp(1, *ORDERS.end());
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
        assert!("2m".parse::<DelayArg>().is_err() && "nan".parse::<DelayArg>().is_err());
        assert!("soon".parse::<DelayArg>().unwrap_err().ends_with("20ms or -0.02, or auto"));
        assert!("0".parse::<TargetArg>().is_err());
        assert_eq!("20s".parse(), Ok(RepeatsArg(Repeats { every_s: 20.0, skip: 1 })));
        assert_eq!("500ms:3".parse(), Ok(RepeatsArg(Repeats { every_s: 0.5, skip: 3 })));
        assert!("20s:x".parse::<RepeatsArg>().is_err() && "0s".parse::<RepeatsArg>().is_err());
    }
}
