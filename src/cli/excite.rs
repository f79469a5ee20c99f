//! `catoptra excite`: a table of coil currents, and its spectrum.

use super::output::{is_free, is_free_for_page, save};
use super::results::whole_path;
use super::units::{current_a, duration_s, frequency_hz, positive_current_a, slew_a_s};
use super::{Failure, interrupt, output, provenance, writing};
use crate::digits::fixed;
use crate::excite::{
    Chirp, Clipped, ExciteError, Limits, Multisine, Order, Phases, Resolution, Signal, Spectrum, Steps, Sweep,
    is_own_table,
};
use crate::report::excitation::{self, ExcitationInfo};
use crate::series::play;
use crate::source::FrameRate;
use crate::source::current_columns::{CurrentColumns, is_time};
use clap::{Subcommand, ValueEnum};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

/// More rows per second than this have delays of 1 ms or less.
const MAX_PLAYED_HZ: f64 = 500.0;
/// Part of the energy in the band asked for, below which a signal that was cut off is warned of.
const LEAST_IN_BAND: f64 = 0.9;

/// Arguments of `catoptra excite`.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// A sine that sweeps over a band
    #[command(after_help = "\
Without options: the chirp of the paper. Each row holds until the next; the last is zero current.
Exit code 2: the limits do not allow it; the message says what would fit.
Example:
  catoptra excite chirp -o currents.csv --report")]
    Chirp(ChirpArgs),
    /// A sum of sines all over a band, with random phases, repeated
    #[command(after_help = "\
All sines are equally strong; the sum is scaled so that its peak is --amplitude.
Example:
  catoptra excite multisine --from 0.5Hz --to 8Hz --period 30s -o multisine.csv --report")]
    Multisine(MultisineArgs),
    /// Levels that are held, in order or at random
    #[command(after_help = "\
With --slew the current goes from level to level on ramps; the summary counts the samples that this
changes.
Example:
  catoptra excite steps --levels 0mA,50mA,100mA,50mA --hold 5s --duration 60s -o steps.csv")]
    Steps(StepsArgs),
}

#[derive(Debug, clap::Args)]
struct Common {
    /// Table to write: t_s and one column per coil; .play: a list for the laboratory's amplifier
    #[arg(short, long, value_name = "CURRENTS.csv|X.play")]
    out: PathBuf,
    /// Length of the signal
    #[arg(long, value_name = "T", default_value = "300s", value_parser = duration_s)]
    duration: f64,
    /// Rows per second
    #[arg(long, value_name = "F", default_value = "60", value_parser = rate)]
    rate: FrameRate,
    /// Largest current that amplifier and coils allow
    #[arg(long, value_name = "I", default_value = "100mA", value_parser = positive_current_a)]
    limit: f64,
    /// Largest change of current that they allow [default: any]
    #[arg(long, value_name = "A/s", value_parser = slew_a_s)]
    slew: Option<f64>,
    /// Cut off what is beyond the limits instead of refusing it, and say what and where
    #[arg(long)]
    clip: bool,
    /// Columns of the coils, the one to excite first; the others stay at 0
    #[arg(long, value_name = "NAMES", default_value = "current_a", value_delimiter = ',')]
    coils: Vec<String>,
    /// Also write a page with signal and spectrum, beside the table or as FILE.html
    #[arg(long, value_name = "FILE.html", num_args = 0..=1, require_equals = true)]
    report: Option<Option<PathBuf>>,
}

#[derive(Debug, clap::Args)]
struct ChirpArgs {
    /// Frequency at the beginning
    #[arg(long, value_name = "F", default_value = "0.5Hz", value_parser = frequency_hz)]
    from: f64,
    /// Frequency at the end
    #[arg(long, value_name = "F", default_value = "8Hz", value_parser = frequency_hz)]
    to: f64,
    /// How the frequency changes
    #[arg(long, value_enum, default_value_t = SweepArg::Linear)]
    sweep: SweepArg,
    /// Amplitude of the sine
    #[arg(long, value_name = "I", default_value = "100mA", value_parser = positive_current_a)]
    amplitude: f64,
    #[command(flatten)]
    common: Common,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum SweepArg {
    Linear,
    Log,
}

#[derive(Debug, clap::Args)]
struct MultisineArgs {
    /// Lowest frequency
    #[arg(long, value_name = "F", default_value = "0.5Hz", value_parser = frequency_hz)]
    from: f64,
    /// Highest frequency
    #[arg(long, value_name = "F", default_value = "8Hz", value_parser = frequency_hz)]
    to: f64,
    /// Length of a period; there is a sine at each multiple of 1/T
    #[arg(long, value_name = "T", default_value = "30s", value_parser = duration_s)]
    period: f64,
    /// How phases are chosen
    #[arg(long, value_enum, default_value_t = PhasesArg::Random)]
    phases: PhasesArg,
    /// Seed of random phases
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
    /// Draws of random phases; the one with the smallest peak is taken
    #[arg(long, value_name = "N", default_value_t = 100, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    tries: u32,
    /// Peak of the sum
    #[arg(long, value_name = "I", default_value = "100mA", value_parser = positive_current_a)]
    amplitude: f64,
    #[command(flatten)]
    common: Common,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum PhasesArg {
    Random,
    Schroeder,
}

#[derive(Debug, clap::Args)]
struct StepsArgs {
    /// The levels
    #[arg(
        long,
        value_name = "I,I,…",
        default_value = "0mA,50mA,100mA,50mA,0mA,-50mA,-100mA,-50mA",
        value_delimiter = ',',
        value_parser = current_a,
        allow_hyphen_values = true
    )]
    levels: Vec<f64>,
    /// How long each is held
    #[arg(long, value_name = "T", default_value = "5s", value_parser = duration_s)]
    hold: f64,
    /// In which order they come
    #[arg(long, value_enum, default_value_t = OrderArg::Staircase)]
    order: OrderArg,
    /// Seed of a random order
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
    #[command(flatten)]
    common: Common,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum OrderArg {
    Staircase,
    Random,
}

fn rate(text: &str) -> Result<FrameRate, String> {
    text.trim()
        .trim_end_matches("Hz")
        .trim_end()
        .parse()
        .map_err(|error: crate::source::times::FrameRateError| error.to_string())
}

/// A signal with its description.
struct DescribedSignal {
    signal: Signal,
    clipped: Vec<Clipped>,
    info: ExcitationInfo,
}

pub(crate) fn run(args: &Args, quiet: bool) -> Result<(), Failure> {
    interrupt::end_at_once()?;
    let common = match &args.command {
        Command::Chirp(args) => &args.common,
        Command::Multisine(args) => &args.common,
        Command::Steps(args) => &args.common,
    };
    check_coils(&common.coils)?;
    let channels = common.channels()?;
    let made = match &args.command {
        Command::Chirp(args) => args.made(),
        Command::Multisine(args) => args.made(),
        Command::Steps(args) => args.made(),
    };
    let made = made.map_err(Failure::usage)?;
    if made.signal.peak_a() == 0.0 {
        return Err(Failure::usage(ExciteError::Nothing { step_a: made.signal.resolution.current_a }));
    }
    let page = common.report.as_ref().map(|file| file.clone().unwrap_or_else(|| common.out.with_extension("html")));
    let text = match &channels {
        Some(channels) => list(&made.signal, channels),
        None => made.signal.table(&common.coils),
    };
    match channels {
        // Lists do not say who wrote them.
        Some(_) => is_free(&common.out, |there| there == text, "this very list")?,
        None => is_free(&common.out, is_own_table, "a table of this command")?,
    }
    if let Some(page) = &page {
        if whole_path(page) == whole_path(&common.out) {
            let text = format!("{}: table and page have the same name; give --report=FILE.html", page.display());
            return Err(Failure::usage(text));
        }
        is_free_for_page(page)?;
    }
    let spectrum = Spectrum::of(&made.signal);
    warn_of_little_in_band(&made, &spectrum);
    let whole = writing::wait();
    save(&common.out, &text)?;
    if let Some(page) = &page {
        let settings = [made.info.settings.as_slice(), &provenance::of_this_run()].concat();
        let info = ExcitationInfo { settings, ..made.info.clone() };
        let text = excitation::page(&info, &made.signal, &spectrum, &made.clipped);
        save(page, &text)?;
    }
    drop(whole);
    if quiet { Ok(()) } else { output::print(&summary(&made, &spectrum, &common.out, page.as_deref())) }
}

/// Cutting a signal off moves energy to other frequencies, where no plant is asked for it.
fn warn_of_little_in_band(made: &DescribedSignal, spectrum: &Spectrum) {
    let Some((a, b)) = made.info.band_hz.filter(|_| !made.clipped.is_empty()) else { return };
    let (from_hz, to_hz) = (a.min(b), a.max(b));
    let share = spectrum.share(from_hz, to_hz);
    if share < LEAST_IN_BAND {
        tracing::warn!(
            "cut off at the limits, {:.0} % of the signal's energy is between {from_hz} Hz and {to_hz} Hz: a smaller \
             --amplitude, or a lower highest frequency, keeps it there",
            share * 100.0
        );
    }
}

impl Common {
    fn limits(&self) -> Limits {
        Limits { current_a: self.limit, slew_a_s: self.slew }
    }

    /// The signal as the file that it is for has it.
    fn as_written(&self, signal: Signal) -> Signal {
        signal.written_as(if play::is_play(&self.out) { Resolution::LIST } else { Resolution::TABLE })
    }

    /// Enforces the limits as requested: by clipping or refusing.
    fn keep(&self, signal: &mut Signal) -> Result<Vec<Clipped>, ExciteError> {
        if self.clip {
            return Ok(self.limits().clip(signal));
        }
        self.limits().check(signal).map(|()| Vec::new())
    }

    /// For a list of the amplifier: the channel of each coil, `channel_3` by its number, others by their place.
    fn channels(&self) -> Result<Option<Vec<usize>>, Failure> {
        if !play::is_play(&self.out) {
            return Ok(None);
        }
        let usage = |text: String| Failure::usage(format!("{}: {text}", self.out.display()));
        let rate_hz = self.rate.hz();
        if rate_hz > MAX_PLAYED_HZ {
            let text = format!("its delays are whole milliseconds, {rate_hz} rows per second are too many: --rate 500");
            return Err(usage(text));
        }
        let numbered = |name: &String| name.strip_prefix("channel_").and_then(|number| number.parse().ok());
        let channels = self.coils.iter().zip(1..).map(|(name, place)| numbered(name).unwrap_or(place));
        let channels: Vec<usize> = channels.collect();
        let mut sorted = channels.clone();
        sorted.sort_unstable();
        sorted.dedup();
        if sorted.len() < channels.len() || sorted.iter().any(|n| !(1..=play::MAX_CHANNELS).contains(n)) {
            let most = play::MAX_CHANNELS;
            return Err(usage(format!("--coils: expected channels from 1 to {most}, all different, as channel_3")));
        }
        Ok(Some(channels))
    }

    fn settings(&self) -> Vec<(String, String)> {
        let slew = self.slew.map_or("any change".to_owned(), |slew| format!("{slew} A/s"));
        vec![
            ("Limits".to_owned(), format!("{:.1} mA, {slew}", self.limit * 1e3)),
            ("Coils".to_owned(), self.coils.join(", ")),
        ]
    }

    fn info(&self, kind: &str, band_hz: Option<(f64, f64)>, settings: Vec<(String, String)>) -> ExcitationInfo {
        let settings = settings.into_iter().chain(self.settings()).collect();
        ExcitationInfo { table: self.out.display().to_string(), kind: kind.to_owned(), band_hz, settings }
    }
}

/// Refuses names of coils that are no names of columns, or that would not be read back as coils from a table with t_s.
pub(super) fn check_coils(coils: &[String]) -> Result<(), Failure> {
    let names: Vec<&str> = ["t_s"].into_iter().chain(coils.iter().map(String::as_str)).collect();
    let mut sorted = names.clone();
    sorted.sort_unstable();
    let twice = sorted.windows(2).any(|pair| matches!(pair, [a, b] if a == b));
    let odd = |name: &&str| name.is_empty() || name.contains([',', '"', '\n', '\r']) || *name != name.trim();
    if twice || names.iter().any(odd) {
        let text = "--coils: names of columns, all different and not t_s, such as axial_a,side_a";
        return Err(Failure::usage(text));
    }
    if let Some(time) = coils.iter().find(|name| is_time(name)) {
        let text = format!("--coils: {time} is read as a time; give another name, such as axial_a");
        return Err(Failure::usage(text));
    }
    CurrentColumns::of(&names).map_err(|problem| Failure::usage(format!("--coils: {problem}")))?;
    Ok(())
}

/// The signal as a list of the amplifier, in the first of `channels`.
fn list(signal: &Signal, channels: &[usize]) -> String {
    let channel = channels.first().copied().unwrap_or(1);
    let row = |(k, value): (u64, &f64)| {
        let mut values_a = vec![0.0; channels.iter().copied().max().unwrap_or(channel)];
        values_a.iter_mut().skip(channel - 1).take(1).for_each(|own| *own = *value);
        (signal.rate.stamp_ns(k).unwrap_or(i64::MAX), values_a)
    };
    let rows: Vec<(i64, Vec<f64>)> = (0..).zip(signal.values_a.iter().chain(std::iter::once(&0.0))).map(row).collect();
    play::write(rows.iter().map(|(time_ns, values_a)| (*time_ns, values_a.as_slice())))
}

fn line(name: &str, value: impl ToString) -> (String, String) {
    (name.to_owned(), value.to_string())
}

impl ChirpArgs {
    fn made(&self) -> Result<DescribedSignal, ExciteError> {
        let sweep = match self.sweep {
            SweepArg::Linear => Sweep::Linear,
            SweepArg::Log => Sweep::Logarithmic,
        };
        let common = &self.common;
        let chirp = Chirp {
            from_hz: self.from,
            to_hz: self.to,
            duration_s: common.duration,
            amplitude_a: self.amplitude,
            sweep,
        };
        let mut signal = common.as_written(chirp.signal(common.rate)?);
        let clipped = common.keep(&mut signal)?;
        let words = if sweep == Sweep::Linear { "linear" } else { "logarithmic" };
        let settings = vec![line("Sweep", format!("{words}, {} Hz to {} Hz", self.from, self.to))];
        Ok(DescribedSignal { signal, clipped, info: common.info("chirp", Some((self.from, self.to)), settings) })
    }
}

impl MultisineArgs {
    fn made(&self) -> Result<DescribedSignal, ExciteError> {
        let phases = match self.phases {
            PhasesArg::Random => Phases::Random { seed: self.seed, tries: self.tries },
            PhasesArg::Schroeder => Phases::Schroeder,
        };
        let common = &self.common;
        let multisine = Multisine {
            from_hz: self.from,
            to_hz: self.to,
            period_s: self.period,
            duration_s: common.duration,
            amplitude_a: self.amplitude,
            phases,
        };
        let (signal, lines) = multisine.signal(common.rate)?;
        let mut signal = common.as_written(signal);
        let clipped = common.keep(&mut signal)?;
        let words = match phases {
            Phases::Schroeder => "Schroeder's".to_owned(),
            Phases::Random { seed, tries } => format!("random, the best of {tries} from seed {seed}"),
        };
        let sines = format!("{lines}, {:.6} Hz apart", 1.0 / self.period);
        let period = format!("{} s{}", self.period, periods_words(common.duration / self.period));
        let settings = vec![line("Sines", sines), line("Phases", words), line("Period", period)];
        Ok(DescribedSignal { signal, clipped, info: common.info("multisine", Some((self.from, self.to)), settings) })
    }
}

impl StepsArgs {
    fn made(&self) -> Result<DescribedSignal, ExciteError> {
        let order = match self.order {
            OrderArg::Staircase => Order::Staircase,
            OrderArg::Random => Order::Random { seed: self.seed },
        };
        let common = &self.common;
        let steps = Steps { levels_a: self.levels.clone(), hold_s: self.hold, duration_s: common.duration, order };
        let mut signal = common.as_written(steps.signal(common.rate)?);
        let clipped = if common.clip {
            common.limits().clip(&mut signal)
        } else {
            // For steps a slew limit means ramps; levels beyond the current limit are refused.
            Limits { slew_a_s: None, ..common.limits() }.check(&signal)?;
            common.limits().check_steps(&signal, steps.held_s(common.rate))?;
            common.limits().ramp(&mut signal).into_iter().collect()
        };
        let levels: Vec<String> = self.levels.iter().map(|level| fixed(level * 1e3, 1)).collect();
        let words = match order {
            Order::Staircase => "as given".to_owned(),
            Order::Random { seed } => format!("random, seed {seed}"),
        };
        let settings = vec![
            line("Levels", format!("{} mA", levels.join(", "))),
            line("Held", held_words(steps.held_s(common.rate), self.hold)),
            line("Order", words),
        ];
        Ok(DescribedSignal { signal, clipped, info: common.info("steps", None, settings) })
    }
}

/// How long each level is held: whole rows, which the time asked for need not be.
fn held_words(held_s: f64, asked_s: f64) -> String {
    if (held_s - asked_s).abs() < 1e-6 * asked_s {
        return format!("{asked_s} s each");
    }
    format!("{held_s:.6} s each, the whole rows nearest to the {asked_s} s asked for")
}

/// What is worth knowing of the number of periods.
fn periods_words(periods: f64) -> String {
    if (periods - periods.round()).abs() < 1e-6 * periods.max(1.0) {
        return String::new();
    }
    format!("; {periods:.3} of them, the last is cut off and cannot be averaged: --duration in whole periods")
}

fn summary(made: &DescribedSignal, spectrum: &Spectrum, table: &Path, page: Option<&Path>) -> String {
    let DescribedSignal { signal, clipped, info } = made;
    let (slew, slew_s) = signal.largest_slew();
    let mut text = format!(
        "{}: {} s, {} rows at {} per second\n",
        info.kind,
        signal.duration_s(),
        signal.values_a.len(),
        signal.rate
    );
    // Writing into text cannot fail.
    for (name, value) in &info.settings {
        let _ = writeln!(text, "  {:<14} {value}", name.to_lowercase());
    }
    let _ = writeln!(text, "\n  peak           {:.1} mA", signal.peak_a() * 1e3);
    let _ = writeln!(text, "  RMS            {:.1} mA", signal.rms_a() * 1e3);
    let _ = writeln!(text, "  crest factor   {:.2}", signal.crest_factor());
    let _ = writeln!(text, "  largest slew   {slew:.2} A/s, at {slew_s:.3} s");
    if let Some((a, b)) = info.band_hz {
        let _ = writeln!(text, "  rows/period    {:.1}, at {} Hz", signal.rate.hz() / a.max(b), a.max(b));
    }
    let _ = writeln!(text, "\n  frequencies                     energy");
    for (band, share) in excitation::shares(spectrum, info.band_hz) {
        let _ = writeln!(text, "  {band:<30} {:>6.2} %", share * 100.0);
    }
    for clipped in clipped {
        let _ = writeln!(text, "\n  {}", excitation::clipped_words(clipped));
    }
    let _ = writeln!(text, "\nwritten: {}", table.display());
    if let Some(page) = page {
        let _ = writeln!(text, "         {} (signal and spectrum, for a browser)", page.display());
    }
    text
}
