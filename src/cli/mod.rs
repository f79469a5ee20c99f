//! The command line: one file per verb, which turns raw arguments into a library call and its result into text.
//!
//! Results go to stdout, everything else to stderr. Exit codes: 0 good, 1 failed, 2 wrong usage or invalid input file,
//! 3 the calibration or measurement is not usable, 130 interrupted.

mod calibrate;
mod camera;
mod catheter;
mod collect;
mod convert;
mod copies;
mod docs;
mod excite;
mod failure;
mod fitting;
mod flood;
mod identify;
mod interrupt;
mod live;
mod lock;
mod log;
mod outcome;
mod output;
mod plan;
mod progress;
mod provenance;
mod results;
mod rig;
mod run;
mod simulate;
mod studio;
mod track;
mod units;
mod validate;
mod warned;
mod writing;

pub(crate) use failure::{Exit, Failure};

use clap::{ArgAction, Parser, Subcommand};
use flood::Flood;
use std::ffi::OsStr;
use std::io::{IsTerminal as _, Write as _};
use std::process::ExitCode;
use tracing_subscriber::Layer as _;
use tracing_subscriber::filter::{LevelFilter, Targets};
use tracing_subscriber::layer::SubscriberExt as _;
use tracing_subscriber::util::SubscriberInitExt as _;
use warned::{Both, Collector};

/// Track a steerable catheter in 3D with one camera and a mirror, through glass and water
#[derive(Debug, Parser)]
#[command(
    name = "catoptra",
    version,
    max_term_width = 100,
    after_help = "\
Exit codes: 0 good, 1 failed, 2 wrong usage or invalid input file, 3 no usable result,
130 interrupted.
Example:
  catoptra track sample_frames/planar.mkv --rig calibration/dev_tank/rig.toml -o out"
)]
struct Cli {
    /// Say more on stderr; -vv describes every frame
    #[arg(short, long, global = true, action = ArgAction::Count, display_order = 900)]
    verbose: u8,
    /// Print errors only
    #[arg(short, long, global = true, conflicts_with = "verbose", display_order = 901)]
    quiet: bool,
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Make a rig file from pictures and recordings
    #[command(after_help = "\
With --json each prints one outcome for programs: what was written, the rig, warnings, the error.
Example:
  catoptra calibrate markers --help")]
    Calibrate(calibrate::Args),
    /// Check rig files, and exchange cameras and views with other tools
    #[command(after_help = "Example:\n  catoptra rig check calibration/dev_tank/rig.toml")]
    Rig(rig::Args),
    /// Track a recording: positions of the bands, direction of the coil, deflection angle
    #[command(after_help = "\
Writes log.mcap, track.csv, report.html, run.toml and, when all is done, summary.json into OUT.
Replaces earlier results of the same recording, never those of another. Ctrl-C keeps what is done.
Of many, one that fails does not stop the others; exit code 1 if any failed.
Example:
  catoptra track sample_frames/planar.mkv --rig calibration/dev_tank/rig.toml -o out")]
    Track(track::Args),
    /// Put many runs into one table of frames, one of runs, and a page of those that stand out
    #[command(after_help = "\
STUDY gets frames.parquet, runs.parquet and report.html. Many recordings: docs/cluster.md
Example:
  catoptra track sample_frames/rest.mkv sample_frames/circle.mkv --to 0.1 -o runs \\
    --rig calibration/dev_tank/rig.toml && catoptra collect runs -o study")]
    Collect(collect::Args),
    /// Describe logs, restore those that were cut off, and convert them
    #[command(after_help = "Example:\n  catoptra log info out/log.mcap")]
    Log(log::Args),
    /// Track a camera live: send θ to controllers within milliseconds, and log every frame
    #[command(after_help = "\
DIR gets log.mcap, track.csv, report.html, run.toml and summary.json; every camera frame has a row.
Ctrl-C completes the files; a run that is killed loses its last second at most.
Example:
  catoptra live sample_frames/planar.mkv --realtime --rig calibration/dev_tank/rig.toml \\
    --udp 127.0.0.1:5005 -o swing-live")]
    Live(live::Args),
    /// Make tables of coil currents that excite the dynamics: chirp, multisine, steps
    #[command(after_help = "Example:\n  catoptra excite chirp -o currents.csv --report")]
    Excite(excite::Args),
    /// What a steerable catheter does for given currents: its shape, its reach, currents for a path
    #[command(after_help = "Example:\n  catoptra catheter shape --currents 0mA,0mA,100mA")]
    Catheter(catheter::Args),
    /// Render what a rig would record of its catheter, with the truth (docs/simulate.md)
    #[command(after_help = "\
DIR gets recording.mkv (or pictures), truth.csv (as track.csv), rig.toml and catheter.toml.
Exit code 2: something cannot be seen; the error says what. The same seed gives the same files.
Example:
  catoptra simulate --rig calibration/dev_tank/rig.toml --motion circle --duration 2s -o sim")]
    Simulate(Box<simulate::Args>),
    /// How well a rig will measure, before it is built: where it sees the catheter, σ, what would help
    #[command(after_help = "\
The planned rig needs camera, surfaces, views, markers with centre_mm, and [base]; colours and
calibration are assumed if it has none. Exit code 2: something cannot be seen; the error says what.
Example:
  catoptra plan --rig calibration/dev_tank/rig.toml -o plan.html")]
    Plan(plan::Args),
    /// In the browser: teach bands, take pictures of a board, look through runs (docs/studio.md)
    #[command(after_help = "\
Serves one page, to this computer only, until Ctrl-C; no network is needed. It reads and writes only
below the folder in which it is started. To watch a live run: `catoptra live … --studio`.
Example:
  catoptra studio sample_frames/planar.mkv --rig calibration/dev_tank/rig.toml --no-open \\
    --duration 2")]
    Studio(studio::Args),
    /// Identify the dynamics from RECORDs: logs, tables, any input and output (docs/identify.md; --json)
    #[command(after_help = "\
Example:
  catoptra identify sample_dynamics/training.csv --currents sample_dynamics/training_currents.csv \\
    --plant sample_dynamics/plant.toml -o dynamics")]
    Identify(Box<identify::Args>),
    /// Compare runs along a desired path with that path: errors, and the response at each speed
    #[command(after_help = "\
DIR gets validation.csv, validation.json, table.md, report.html and points_*.csv. Exit code 3: a
run has too little data. What each number means: docs/validate.md
Example:
  catoptra validate tests/data/validate/20ms.csv tests/data/validate/5ms.csv --pause 20ms,5ms \\
    --desired tests/data/validate/circle.csv --start 1.5 -o validation")]
    Validate(validate::Args),
    /// Print the completions of a shell: bash, zsh, fish, elvish or PowerShell
    #[command(
        after_help = "Where each shell wants them: README.md\nExample:\n  catoptra completions bash > catoptra.bash"
    )]
    Completions(docs::CompletionsArgs),
    /// Write the manual pages, one for each command, into a folder
    #[command(after_help = "Example:\n  catoptra man man1")]
    Man(docs::ManArgs),
}

/// Runs the program.
pub fn run() -> ExitCode {
    let cli = Cli::parse();
    log_to_stderr(cli.verbose, cli.quiet);
    let result = match &cli.command {
        Command::Calibrate(args) => calibrate::run(args, cli.quiet),
        Command::Catheter(args) => catheter::run(args, cli.quiet),
        Command::Collect(args) => collect::run(args, cli.quiet),
        Command::Completions(args) => docs::completions(args),
        Command::Man(args) => docs::man(args),
        Command::Rig(args) => rig::run(args, cli.quiet),
        Command::Excite(args) => excite::run(args, cli.quiet),
        Command::Identify(args) => identify::run(args, cli.quiet),
        Command::Live(args) => live::run(args, cli.quiet),
        Command::Log(args) => log::run(args),
        Command::Plan(args) => plan::run(args, cli.quiet),
        Command::Simulate(args) => simulate::run(args, cli.quiet),
        Command::Studio(args) => studio::run(args),
        Command::Track(args) => track::run(args, cli.quiet),
        Command::Validate(args) => validate::run(args, cli.quiet),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            // Without stderr, the exit code remains.
            let _ = write!(std::io::stderr().lock(), "{failure}");
            failure.exit().into()
        }
    }
}

fn log_to_stderr(verbose: u8, quiet: bool) {
    let level = match (quiet, verbose) {
        (true, _) => LevelFilter::ERROR,
        (false, 0) => LevelFilter::WARN,
        (false, 1) => LevelFilter::INFO,
        (false, _) => LevelFilter::DEBUG,
    };
    let libraries = level.min(LevelFilter::WARN);
    let shown = Targets::new().with_default(libraries).with_target("catoptra", level);
    let shown = shown.with_target(warned::TARGET, LevelFilter::OFF);
    let layer = tracing_subscriber::fmt::layer()
        .with_writer(progress::stderr)
        .with_ansi(std::io::stderr().is_terminal() && wants_colour())
        .with_target(false)
        .without_time()
        .with_filter(Both(shown, Flood::default()));
    tracing_subscriber::registry().with(layer).with(Collector.with_filter(warned::seen())).init();
}

/// As specified by <https://no-color.org>, and not on a terminal without colours.
fn wants_colour() -> bool {
    let is = |name: &str, unwanted: fn(&OsStr) -> bool| std::env::var_os(name).is_some_and(|v| unwanted(&v));
    !is("NO_COLOR", |v| !v.is_empty()) && !is("TERM", |v| v == "dumb")
}

#[cfg(test)]
mod tests {
    use clap::{CommandFactory as _, Parser as _};

    #[test]
    fn every_help_fits_a_screen_and_ends_with_an_example() {
        let mut command = super::Cli::command();
        command.clone().debug_assert();
        command.build();
        let mut pending = vec![(vec!["catoptra".to_owned()], command.clone())];
        while let Some((words, this)) = pending.pop() {
            // As the user sees it: clap has two forms.
            let asked = words.iter().map(String::as_str).chain(["--help"]);
            let help = super::Cli::try_parse_from(asked).unwrap_err().to_string();
            assert!(help.lines().count() <= 40, "{} has {} lines", words.join(" "), help.lines().count());
            let last = help.lines().last().unwrap_or_default();
            let form = last.starts_with("  catoptra ") || last.starts_with("    --");
            assert!(form, "{} ends with {last:?}", words.join(" "));
            // Wider lines would be broken in the middle of a sentence.
            let after = this.get_after_help().map(ToString::to_string).unwrap_or_default();
            let wide = after.lines().find(|line| line.chars().count() > 100);
            assert_eq!(wide, None, "{}", words.join(" "));
            let place = |option: &str| help.lines().position(|line| line.contains(option));
            let last = [place("--verbose"), place("--quiet"), place("--help")];
            let options = help.lines().enumerate().skip_while(|(_, line)| *line != "Options:");
            let own = options.filter(|(_, line)| line.trim_start().starts_with('-')).map(|(at, _)| Some(at));
            assert!(own.take_while(|at| !last.contains(at)).all(|at| at < last[0]), "{}", words.join(" "));
            assert!(last.is_sorted() && last[0].is_some(), "{}: {last:?}", words.join(" "));
            for sub in this.get_subcommands().filter(|c| c.get_name() != "help") {
                pending.push(([words.clone(), vec![sub.get_name().to_owned()]].concat(), sub.clone()));
            }
        }
    }

    /// A negative number is a wrong value, not an unknown option.
    #[test]
    fn a_negative_number_is_told_what_is_expected_instead() {
        for words in [
            "live - --rig r.toml --duration -1",
            "live - --rig r.toml --exposure -3.5",
            "live - --rig r.toml --currents udp:5006 --current-limit -1",
            "live - --rig r.toml --record windows --keep-free -1",
            "studio --duration -1",
        ] {
            let asked = ["catoptra"].into_iter().chain(words.split_whitespace());
            let said = super::Cli::try_parse_from(asked).unwrap_err().to_string();
            assert!(said.contains("invalid value") && said.contains("above 0"), "{words}: {said}");
        }
    }
}
