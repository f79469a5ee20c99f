//! `catoptra rig export`: the camera, or views, for other tools.

use super::{Failure, output};
use crate::plural::plural;
use crate::rig::Draft;
use crate::rig::formats::{Format, dlt};
use std::path::{Path, PathBuf};

#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum ExportFormat {
    Opencv,
    Ros,
    Kalibr,
    Dlt,
}

#[derive(Debug, clap::Args)]
pub(super) struct ExportArgs {
    /// The rig file
    #[arg(value_name = "RIG.toml")]
    rig: PathBuf,
    /// The format to write
    #[arg(long)]
    format: ExportFormat,
    /// dlt: write this view only
    #[arg(long, value_name = "NAME")]
    view: Option<String>,
    /// dlt: number of the picture's first pixel; 0 as here and in OpenCV, 1 as in MATLAB and DLTdv
    #[arg(long, value_name = "0|1", value_parser = clap::value_parser!(u8).range(0..=1))]
    first_pixel: Option<u8>,
    /// File to write instead of stdout
    #[arg(long, short, value_name = "FILE")]
    out: Option<PathBuf>,
}

pub(super) fn run(
    args: &ExportArgs,
    note: impl Fn(&str),
    print: impl Fn(&str) -> Result<(), Failure>,
) -> Result<(), Failure> {
    let rig = Draft::load(&args.rig)?;
    let view = args.view.as_deref();
    let format = match args.format {
        ExportFormat::Opencv => Some(Format::OpenCv),
        ExportFormat::Ros => Some(Format::Ros),
        ExportFormat::Kalibr => Some(Format::Kalibr),
        ExportFormat::Dlt => None,
    };
    let (text, said) = match format {
        Some(format) => {
            if args.first_pixel.is_some() {
                return Err(Failure::usage(format!("--first-pixel is for dlt: {format} counts from 0")));
            }
            let names: Vec<&str> = rig.surfaces.keys().map(String::as_str).collect();
            let missing = format!(
                "{format} holds the camera alone: {} not in it, and rays through them are not what it says",
                if names.len() == 1 { format!("{} is", names.concat()) } else { format!("{} are", names.join(", ")) }
            );
            (format.write(&rig, view, &args.rig)?, (!names.is_empty()).then_some(missing))
        }
        None => {
            let first = args.first_pixel.unwrap_or(0);
            let text = dlt::write(&rig, view, f64::from(first), &args.rig)?;
            (text, Some(frame(&rig, view, first)))
        }
    };
    match &args.out {
        Some(out) => {
            if same(out, &args.rig) {
                return Err(Failure::usage(format!("{} is the rig itself; give another -o", out.display())));
            }
            output::is_free(out, |old| old == text || is_own(old), "an export of this command")?;
            output::save(out, &text)?;
            print(&format!("written: {}, {}\n", out.display(), described(&rig, format, view)))?;
        }
        None => output::print(&text)?,
    }
    if let Some(said) = said {
        note(&said);
    }
    Ok(())
}

/// Whether a text is written as here: what is read from it would be written like this again. The files of OpenCV, ROS
/// and DLTdv are not; of Kalibr's that is not certain.
fn is_own(text: &str) -> bool {
    let name = Path::new("");
    let again = |format: Format| {
        let camera = format.read(text, name)?;
        format.write(&Draft::of_camera(camera), None, name)
    };
    let format = Format::guess(text, name).ok().filter(|format| *format != Format::Kalibr);
    let row = |line: &str| {
        let same = |cell: &str| cell.parse::<f64>().is_ok_and(|number| format!("{number:e}") == cell);
        line.split(',').all(same)
    };
    format.is_some_and(|format| again(format).is_ok_and(|again| again == text))
        || (text.lines().count() == 11 && text.lines().all(row))
}

/// Content of a file, in words.
fn described(rig: &Draft, format: Option<Format>, view: Option<&str>) -> String {
    match format {
        Some(format) => format!("the camera as {format}"),
        None => {
            let count = if view.is_some() { 1 } else { rig.views.len() };
            format!("DLT coefficients of {}", plural(count, "view"))
        }
    }
}

/// Meaning of a DLT's numbers, which the file cannot hold.
fn frame(rig: &Draft, view: Option<&str>, first: u8) -> String {
    let views = match view {
        Some(view) => view.to_owned(),
        None => rig.views.iter().map(|v| v.name.as_str()).collect::<Vec<_>>().join(", "),
    };
    let frame = match rig.base {
        Some(_) => "the base frame".to_owned(),
        None => format!(
            "the camera frame with its origin moved {:.0} mm forward: the rig has no base frame, and in the lens an \
             origin has no DLT",
            dlt::ORIGIN_M * 1e3
        ),
    };
    format!(
        "columns: {views}; mm in {frame}; pixels right and down, ({first}, {first}) in the centre of the top-left one"
    )
}

fn same(a: &Path, b: &Path) -> bool {
    a.canonicalize().ok().zip(b.canonicalize().ok()).is_some_and(|(a, b)| a == b)
}
