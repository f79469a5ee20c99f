//! `catoptra log convert`: a log as a table, a MAT file, or a log for ROS 2.

use super::failure::is_wrong_name;
use super::run::Reference;
use super::{Exit, Failure, output};
use crate::convert::{ConvertError, Converted, Target, convert};
use crate::log::LogError;
use crate::plural::{are, plural};
use crate::vetoes::{FILE, Vetoes};
use std::path::PathBuf;

/// Arguments of `catoptra log convert`.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// The log
    #[arg(value_name = "LOG.mcap")]
    file: PathBuf,
    /// What to make of it: ros2 (a log that rosbag2 reads), csv (the table of the run), or, not rounded, parquet and
    /// mat (MATLAB)
    #[arg(long, value_enum, value_name = "WHAT", hide_possible_values = true)]
    profile: Profile,
    /// The new file; an existing one is never replaced
    #[arg(short, long, value_name = "OUT")]
    out: PathBuf,
    /// Frame of reference of places and directions in tables [default: that of the run's table]
    #[arg(long, value_enum)]
    frame: Option<Reference>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Profile {
    Ros2,
    Csv,
    Parquet,
    Mat,
}

pub(super) fn run(args: &Args) -> Result<(), Failure> {
    if args.out.as_os_str() == "-" {
        return Err(Failure::usage("-o -: a converted log is not written to standard output; give the name of a file"));
    }
    let target = match args.profile {
        Profile::Ros2 => Target::Ros2,
        Profile::Csv => Target::Csv,
        Profile::Parquet => Target::Parquet,
        Profile::Mat => Target::Mat,
    };
    let vetoed = Vetoes::beside(&args.file).map_err(|e| Failure::because(Exit::Failed, e.to_string(), e))?.len();
    let converted = convert(&args.file, target, args.frame.map(Into::into), &args.out).map_err(failure)?;
    if let Some(cut) = &converted.cut {
        tracing::warn!("{}: {cut}; the rest is converted", args.file.display());
    }
    if vetoed > 0 {
        tracing::warn!(
            "{}: {} vetoed beside it ({FILE}): in the new file they are as they were measured",
            args.file.display(),
            are(vetoed as u64, "frame")
        );
    }
    output::print(&summary(&converted))
}

fn summary(converted: &Converted) -> String {
    let files: Vec<_> = converted.files.iter().map(|file| file.display().to_string()).collect();
    let mut text = format!("{}: {}", files.join(", "), plural(converted.frames, "frame"));
    if converted.currents > 0 {
        text += &format!(", currents at {}", plural(converted.currents, "time"));
    }
    text += "\n";
    if !converted.left_out.is_empty() {
        text += "  left out:\n";
    }
    for line in &converted.left_out {
        text += &format!("    {line}\n");
    }
    text
}

fn failure(error: ConvertError) -> Failure {
    let exit = match &error {
        ConvertError::Log(LogError::NotMcap { .. } | LogError::NotOurs { .. })
        | ConvertError::Content { .. }
        | ConvertError::Occupied { .. } => Exit::Usage,
        ConvertError::Log(LogError::Io { source, .. }) | ConvertError::Write { source, .. }
            if is_wrong_name(source) =>
        {
            Exit::Usage
        }
        ConvertError::Log(_) | ConvertError::Write { .. } | ConvertError::Table(_) | ConvertError::Message(_) => {
            Exit::Failed
        }
    };
    Failure::new(exit, error)
}
