//! `catoptra log`: inspecting, repairing and converting logs.

use super::failure::is_wrong_name;
use super::{Exit, Failure, convert, output};
use crate::estimate::plain_words;
use crate::log::{Condition, Info, LogError, Repaired, repair};
use crate::plural::plural;
use crate::source::times::seconds;
use clap::Subcommand;
use std::fmt::{self, Write as _};
use std::path::PathBuf;
use std::time::{Duration, SystemTime};

/// Arguments of `catoptra log`.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Describe a log: frames, gaps, clocks, what was missed and why
    #[command(after_help = "Example:\n  catoptra log info out/log.mcap")]
    Info {
        /// The log
        #[arg(value_name = "LOG.mcap")]
        file: PathBuf,
    },
    /// Restore a log that was cut off or damaged
    #[command(after_help = "\
Keeps everything that is intact, and lists where something is lost. The damaged file stays beside
the new one as LOG.mcap.bak.
Example:
  catoptra log repair out/log.mcap")]
    Repair {
        /// The log
        #[arg(value_name = "LOG.mcap")]
        file: PathBuf,
    },
    /// Convert a log to a table, a MAT file or a log for ROS 2
    #[command(after_help = "\
Lists what of the log is not in the new file. Currents get a table of their own beside it,
OUT-currents; a MAT file has both (docs/log.md).
Example:
  catoptra log convert out/log.mcap --profile parquet -o frames.parquet")]
    Convert(convert::Args),
}

pub(crate) fn run(args: &Args) -> Result<(), Failure> {
    match &args.command {
        Command::Info { file } => {
            let info = Info::read(file).map_err(failure)?;
            let mut text = String::new();
            describe(&mut text, &file.display().to_string(), &info)
                .map_err(|e| Failure::new(Exit::Failed, format!("cannot describe the log: {e}")))?;
            output::print(&text)
        }
        Command::Convert(args) => convert::run(args),
        Command::Repair { file } => match repair(file).map_err(failure)? {
            Repaired::WasWhole => output::print(&format!("{}: is complete, nothing to repair\n", file.display())),
            Repaired::Mended { messages, unknown, condition, kept_as } => {
                let mut text = format!("{}: repaired, {} recovered\n", file.display(), plural(messages, "message"));
                damage(&mut text, &condition, &Info::read(file).unwrap_or_default())
                    .map_err(|e| Failure::new(Exit::Failed, format!("cannot describe the log: {e}")))?;
                match unknown {
                    0 => {}
                    1 => text += "  1 message is left out: its topic is unknown\n",
                    n => text += &format!("  {n} messages are left out: their topic is unknown\n"),
                }
                text += &format!("  the broken file is kept as {}\n", kept_as.display());
                output::print(&text)
            }
        },
    }
}

fn failure(error: LogError) -> Failure {
    let exit = match error {
        LogError::NotMcap { .. } | LogError::NotOurs { .. } => Exit::Usage,
        LogError::Io { ref source, .. } if is_wrong_name(source) => Exit::Usage,
        LogError::Io { .. } | LogError::Repair { .. } | LogError::BeingWritten { .. } => Exit::Failed,
    };
    Failure::new(exit, error)
}

/// Damage of a log, one line each, with times of the camera.
fn damage(out: &mut String, condition: &Condition, info: &Info) -> fmt::Result {
    const LINES: usize = 10;
    // Messages of a live log have the host's.
    let shift_ns =
        info.span_ns.zip(info.host_span_ns).map_or(0, |((camera, _), (host, _))| camera.saturating_sub(host));
    for damage in condition.damage.iter().take(LINES) {
        write!(out, "  damaged at byte {}: {}", damage.at, without_control_characters(&damage.what))?;
        let s = |ns: u64| seconds(i64::try_from(ns).unwrap_or(i64::MAX).saturating_add(shift_ns));
        match damage.between_ns {
            (Some(before), Some(after)) => writeln!(out, " (between {:.3} s and {:.3} s)", s(before), s(after))?,
            (Some(before), None) => writeln!(out, " (after {:.3} s)", s(before))?,
            (None, Some(after)) => writeln!(out, " (before {:.3} s)", s(after))?,
            (None, None) => writeln!(out)?,
        }
    }
    let more = condition.damage.len().saturating_sub(LINES) as u64 + condition.more_damage;
    if more > 0 {
        writeln!(out, "  and {more} more damaged places")?;
    }
    if let Some(why) = &condition.cut {
        writeln!(out, "  cut off: {}", without_control_characters(why))?;
    }
    Ok(())
}

/// Text from a file, without terminal control characters.
fn without_control_characters(text: &str) -> String {
    text.chars().flat_map(|c| if c.is_control() { c.escape_debug().collect::<Vec<_>>() } else { vec![c] }).collect()
}

/// A time of the host's clock, to the millisecond, UTC.
fn date(ns: i64) -> String {
    let since_1970 = Duration::from_nanos(u64::try_from(ns).unwrap_or(0));
    let text = humantime::format_rfc3339_millis(SystemTime::UNIX_EPOCH + since_1970).to_string();
    text.replace('T', " ").replace('Z', " UTC")
}

fn describe(out: &mut String, name: &str, info: &Info) -> fmt::Result {
    writeln!(out, "{name}: written by {}", without_control_characters(&info.library))?;
    if info.being_written {
        writeln!(out, "  is still being written")?;
    } else if info.condition.is_whole() {
        let lost = info.condition.summary();
        writeln!(out, "  {}with index", if lost.is_none() { "complete, " } else { "" })?;
        if let Some(lost) = lost {
            writeln!(out, "  {}", without_control_characters(&lost))?;
        }
    } else {
        damage(out, &info.condition, info)?;
        let can_be_read = info.topics.iter().any(|topic| topic.messages > 0);
        writeln!(
            out,
            "  {}",
            if can_be_read { "`catoptra log repair` restores it" } else { "nothing in it can be restored" }
        )?;
    }
    if let Some((first, last)) = info.span_ns {
        let clock = without_control_characters(info.clock.as_deref().unwrap_or("unknown"));
        let frames = plural(info.frames, "frame");
        writeln!(out, "\n  {frames}, {:.3} s to {:.3} s, clock {clock}", seconds(first), seconds(last))?;
    } else {
        writeln!(out, "\n  no frame")?;
    }
    if let Some((first, last)) = info.host_span_ns {
        writeln!(out, "  by the host's clock {:.3} s, from {} on", seconds(last.saturating_sub(first)), date(first))?;
    }
    let (gaps, lost) = info.gaps;
    writeln!(out, "  {} lost in {}", plural(lost, "camera frame"), plural(gaps, "gap"))?;
    for (count, what) in
        [(info.rows_missing, "rows are missing"), (info.not_later, "stamps are not later than the one before")]
    {
        if count > 0 {
            writeln!(out, "  {count} {what}")?;
        }
    }
    for ((what, word), frames) in &info.misses {
        writeln!(
            out,
            "  {}: {frames} {}",
            without_control_characters(what),
            without_control_characters(&plain_words(word))
        )?;
    }
    writeln!(out)?;
    for topic in &info.topics {
        writeln!(
            out,
            "  {:<22} {:>8}  {}",
            without_control_characters(&topic.name),
            topic.messages,
            without_control_characters(&topic.schema)
        )?;
    }
    for (name, bytes) in &info.attachments {
        writeln!(out, "  attached: {}, {bytes} bytes", without_control_characters(name))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_hosts_clock_is_told_as_a_date() {
        assert_eq!(date(1_795_188_826_788_000_000), "2026-11-20 15:33:46.788 UTC");
    }
}
