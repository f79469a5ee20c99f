//! `catoptra rig`: explains rig files, and exchanges them with other tools.

mod check;
mod export;
mod import;

use super::{Failure, output};
use std::io::Write as _;
use std::path::PathBuf;

/// Arguments of `catoptra rig`.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, clap::Subcommand)]
enum Command {
    /// Describe a rig file: views and their light paths, tank, mirror, catheter, base frame, warnings
    ///
    /// Traces pixels of every view to points and projects them back. Exit code 3 when this does not lead back to the
    /// same pixels, or when there is only one view; 2 when the file is not valid.
    #[command(after_help = "\
Works after each calibration step; lists what is still missing.
Example:
  catoptra rig check calibration/dev_tank/rig.toml --recording sample_frames/planar.mkv")]
    Check {
        /// The rig file
        #[arg(value_name = "RIG.toml")]
        file: PathBuf,
        /// Track this recording, and say how good the calibration is where the catheter is in it
        #[arg(long, value_name = "VIDEO|DIR")]
        recording: Option<PathBuf>,
    },
    /// Write the camera for OpenCV, ROS or Kalibr, or views as DLT coefficients
    #[command(after_help = "\
opencv, ros and kalibr hold the camera alone: no mirror, no wall. dlt holds views with their
mirrors, in mm, one column per view, but no wall and no distortion. Exit code 2: the rig has
something that the format cannot hold.
Example:
  catoptra rig export calibration/dev_tank/rig.toml --format opencv -o camera.yml")]
    Export(export::ExportArgs),
    /// Start a rig file with a camera calibrated elsewhere
    #[command(after_help = "\
Reads YAML of OpenCV's FileStorage, ROS camera_info, and Kalibr camchains of one camera. An existing
RIG.toml keeps its bands, but loses what was calibrated with its old lens. The old file is kept as
RIG.toml.bak, .bak2, …
Example:
  catoptra rig import tests/data/cameras/ros.yaml --out my_rig.toml")]
    Import(import::ImportArgs),
}

pub(crate) fn run(args: &Args, quiet: bool) -> Result<(), Failure> {
    let note = |text: &str| {
        if !quiet {
            // Without stderr nothing can be printed; the result still counts.
            let _ = writeln!(super::progress::stderr(), "{text}");
        }
    };
    let print = |text: &str| if quiet { Ok(()) } else { output::print(text) };
    match &args.command {
        Command::Check { file, recording } => check::run(file, recording.as_deref(), quiet),
        Command::Export(args) => export::run(args, note, print),
        Command::Import(args) => import::run(args, note, print),
    }
}
