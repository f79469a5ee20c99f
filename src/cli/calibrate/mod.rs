//! `catoptra calibrate`: from pictures and recordings to a rig file, with one file for each step.

mod base;
mod camera;
mod markers;
mod mirror;
mod pictures;
mod rig;

use super::lock::Lock;
use super::outcome::{self, HiddenJson, Outcome};
use super::results::may_write_in;
use super::{Exit, Failure, interrupt, output, writing};
use crate::calibrate::length_m;
use crate::calibrate::rig::RigOptions;
use crate::rig::{Draft, Rig};
use clap::Subcommand;
use std::path::{Path, PathBuf};
use std::str::FromStr;

/// What another process may be doing with a rig file. What it finds would be lost: all of the file is written anew.
const CALIBRATES: &str = "calibrates this rig; wait until it is done";

/// Arguments of `catoptra calibrate`.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    #[command(flatten)]
    json: HiddenJson,
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Find the lens from pictures of a chessboard or ChArUco board in air
    #[command(after_help = "\
Ten to twenty pictures, the board tilted to all sides and all over the picture. Prints each lens
parameter with its σ, and why a picture was left out. Exit code 3: the pictures leave the lens open.
Example:
  catoptra calibrate camera calibration/dev_tank/intrinsics --board 9x6:12mm --out my_rig.toml")]
    Camera(camera::CameraArgs),
    /// Find mirrors and walls of the tank from pictures that show a chessboard or ChArUco board twice
    #[command(after_help = "\
Ten to twenty pictures of the board where the catheter will be, tilted to all sides, each whole in
all views; a ChArUco board may be hidden in part. The old rig file is kept as RIG.toml.bak, .bak2, …
Exit code 3: the pictures leave the rig open.
Example:
  catoptra calibrate rig calibration/dev_tank/mirror --board 9x6:12mm --rig my_rig.toml \\
    --tank 254x254x267mm --glass 5mm")]
    Rig(rig::RigArgs),
    /// Learn the marker bands from a recording and a click near each band
    #[command(after_help = "\
A click may be 5 pixels beside the band, in any view and frame; its size and place find it
in the others. Measures colours in each view, places on the tube, blur of the lens, offset of the
colour samples, and writes them into the rig file; the old one is kept as RIG.toml.bak, .bak2, …
RIG.markers.html shows what was seen, after a failure too. Exit code 3: a band is not found, or its
colour cannot be told from another's.
Example:
  catoptra calibrate markers sample_frames/planar.mkv --rig calibration/dev_tank/rig.toml \\
    --tube 3.2mm --pick base@431,408:6mm --pick coil@431,565:12mm --pick tip@430,607:6mm \\
    --out my.toml")]
    Markers(markers::MarkersArgs),
    /// Find the frame of the catheter at rest, in which positions and θ are given, and the direction of B0
    #[command(after_help = "\
VIDEO shows the catheter hanging still, without current; the one of --planar a swing in the plane of
B0, begun towards B0. Writes [base] with its σ into the rig file; the old file is kept as
RIG.toml.bak, .bak2, … Exit code 3: it was not at rest, not planar, hardly moved, or too little of
it could be measured.
Example:
  catoptra calibrate base sample_frames/rest.mkv --rig calibration/dev_tank/rig.toml \\
    --planar sample_frames/planar.mkv --out my.toml")]
    Base(base::BaseArgs),
    /// Find where a bumped mirror stands now, from a recording of the moving catheter
    #[command(after_help = "\
No board is needed: the rays of both views must meet on the bands, and one length is known. Lens and
walls are those of the rig file, and must not have moved. Prints by how much the mirror moved, with
σ; within it, nothing is changed. The old rig file is kept as RIG.toml.bak, .bak2, … Exit code 3:
the recording leaves the mirror open.
Example:
  catoptra calibrate mirror --from-markers sample_frames/planar.mkv \\
    --rig calibration/dev_tank/rig.toml --out my_rig.toml")]
    Mirror(mirror::MirrorArgs),
}

pub(crate) fn run(args: &Args, quiet: bool) -> Result<(), Failure> {
    interrupt::end_at_once()?;
    let verb = match &args.command {
        Command::Camera(_) => "camera",
        Command::Rig(_) => "rig",
        Command::Markers(_) => "markers",
        Command::Base(_) => "base",
        Command::Mirror(_) => "mirror",
    };
    outcome::of(&format!("calibrate {verb}"), args.json.into(), quiet, |outcome| calibrate(args, quiet, outcome))
}

fn calibrate(args: &Args, quiet: bool, outcome: &Outcome) -> Result<(), Failure> {
    let print = |text: &str| outcome.print(text);
    let _held = Lock::take(out(&args.command), CALIBRATES)?;
    let ended = match &args.command {
        Command::Camera(args) => camera::run(args, quiet, print),
        Command::Rig(args) => rig::run(args, quiet, print),
        Command::Markers(args) => markers::run(args, print),
        Command::Base(args) => base::run(args, quiet, print),
        Command::Mirror(args) => mirror::run(args, print),
    };
    if ended.is_ok() {
        // As it is now, with the provenance of every number.
        outcome.found_in(out(&args.command), |text| Ok(serde_json::to_value(text.parse::<toml::Table>()?)?))?;
    }
    ended
}

/// The rig file that is written.
fn out(command: &Command) -> &Path {
    match command {
        Command::Camera(args) => &args.out,
        Command::Rig(args) => args.out(),
        Command::Markers(args) => args.out(),
        Command::Base(args) => args.out(),
        Command::Mirror(args) => args.out(),
    }
}

/// `catoptra calibrate markers` with these arguments; its output goes to `print`.
pub(in crate::cli) fn teach(arguments: &[String], print: impl Fn(&str) -> Result<(), Failure>) -> Result<(), Failure> {
    let args: markers::MarkersArgs = parsed(arguments)?;
    let _held = Lock::take(args.out(), CALIBRATES)?;
    markers::run(&args, print)
}

/// The rig with the bands of these arguments, before anything is learned.
pub(in crate::cli) fn rig_to_teach(arguments: &[String]) -> Result<Rig, Failure> {
    markers::rig_with_picks(&parsed(arguments)?)
}

/// `catoptra calibrate rig` with these arguments; its output goes to `print`.
pub(in crate::cli) fn rig(arguments: &[String], print: impl Fn(&str) -> Result<(), Failure>) -> Result<(), Failure> {
    let args: rig::RigArgs = parsed(arguments)?;
    let _held = Lock::take(args.out(), CALIBRATES)?;
    rig::run(&args, true, print)
}

/// The initial rig file of these arguments, and the options that they set.
pub(in crate::cli) fn rig_to_calibrate(arguments: &[String]) -> Result<(Draft, RigOptions), Failure> {
    let args: rig::RigArgs = parsed(arguments)?;
    let draft = Draft::load(&args.rig)?.with_own_lens(&args.rig)?;
    let options = rig::options(&args, &draft)?;
    Ok((draft, options))
}

/// Parses arguments of a verb as if typed.
fn parsed<T: clap::Args>(arguments: &[String]) -> Result<T, Failure> {
    let command = T::augment_args(clap::Command::new("catoptra"));
    let arguments = ["catoptra"].into_iter().chain(arguments.iter().map(String::as_str));
    let parsed = command.try_get_matches_from(arguments).and_then(|matches| T::from_arg_matches(&matches));
    parsed.map_err(|error| {
        let said = error.to_string();
        // Usage and hints are only for the terminal.
        let first = said.split("\n\n").next().unwrap_or_default();
        Failure::usage(first.strip_prefix("error: ").unwrap_or(first).to_owned())
    })
}

/// A length with unit, in metres.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Length(f64);

impl FromStr for Length {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        length_m(text)
            .map(Self)
            .ok_or_else(|| format!("`{text}` is not a length: write for example 3.2mm, 0.32cm or 0.0032m"))
    }
}

/// Checks before any work that the file can be written and would replace only a rig.
pub(super) fn can_be_written(out: &Path) -> Result<(), Failure> {
    let is_rig = |text: &str| text.parse::<toml::Table>().is_ok_and(|t| t.is_empty() || t.contains_key("camera"));
    output::is_free(out, is_rig, "a rig file")?;
    let folder = out.parent().filter(|folder| *folder != Path::new("")).unwrap_or(Path::new("."));
    may_write_in(folder)
        .map_err(|e| Failure::because(Exit::Failed, format!("{}: cannot be written: {e}", out.display()), e))
}

/// Writes the rig, keeping a different one that was there as a backup; returns what was written, in words.
pub(super) fn save(rig: &Draft, path: &Path) -> Result<String, Failure> {
    let _whole = writing::wait();
    let kept_as = rig.save_with_backup(path)?;
    outcome::wrote(path);
    let kept = kept_as.map_or(String::new(), |name| format!("\n         {} (the rig as it was)", name.display()));
    Ok(format!("written: {}{kept}", path.display()))
}

/// Where a page of this kind goes beside the rig: RIG.KIND.html for RIG.toml. Checks that it replaces only a page.
fn page_beside(rig: &Path, kind: &str) -> Result<PathBuf, Failure> {
    let stem = match rig.extension() {
        Some(extension) if extension == "toml" => rig.with_extension(""),
        _ => rig.to_path_buf(),
    };
    let mut name = stem.into_os_string();
    name.push(format!(".{kind}.html"));
    let page = PathBuf::from(name);
    output::is_free_for_page(&page)?;
    Ok(page)
}

/// Writes a page beside the rig.
fn save_page(page: &str, path: &Path) -> Result<(), Failure> {
    output::save(path, page)?;
    outcome::wrote(path);
    Ok(())
}

/// What a new lens, for pictures of this size, removes from a rig, in words.
pub(super) fn left_out(old: &Draft, size_px: [u32; 2]) -> Option<String> {
    let found = !old.surfaces.is_empty() || !old.views.is_empty() || old.base.is_some();
    let found = found
        .then_some("mirror, walls, views and base frame of the old file were found with the old lens and are left out");
    let measured = old.measured_on_pictures().then_some(if size_px == old.camera.size_px {
        "what was measured of the camera's blur, colours and exposure, and the bands' usual residuals, are kept: if \
         this is another camera or lens, teach the bands again (catoptra calibrate markers)"
    } else {
        "blur, colour offsets, gamma, exposure, readout and the bands' usual residuals were those of pictures of \
         another size and are left out: teach the bands again (catoptra calibrate markers) when the mirrors are \
         calibrated"
    });
    let said: Vec<&str> = found.into_iter().chain(measured).collect();
    (!said.is_empty()).then(|| said.join("; "))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_rig_has_its_own_page() {
        for (rig, page) in [
            ("src/rig.toml", "src/rig.markers.html"),
            ("site.a", "site.a.markers.html"),
            ("site.b", "site.b.markers.html"),
            ("rig.v2.toml", "rig.v2.markers.html"),
        ] {
            assert_eq!(page_beside(Path::new(rig), "markers").unwrap(), Path::new(page));
        }
    }

    #[test]
    fn lengths_as_people_write_them() {
        assert!((("3.2mm".parse::<Length>().unwrap().0) - 0.0032).abs() < 1e-15);
        assert!((("0.32 cm".parse::<Length>().unwrap().0) - 0.0032).abs() < 1e-15);
        for text in ["3.2", "mm", "-1mm", "NaNmm", "3.2in"] {
            assert!(text.parse::<Length>().unwrap_err().contains("3.2mm"), "{text}");
        }
    }
}
