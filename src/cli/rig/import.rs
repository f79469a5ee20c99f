//! `catoptra rig import`: begins a rig file with a camera that was calibrated elsewhere.

use super::super::calibrate::{can_be_written, left_out, save};
use super::Failure;
use crate::archive::hash;
use crate::calibrate::geometry::Parameter;
use crate::rig::formats::Format;
use crate::rig::{Draft, lens_note, of_camera};
use crate::text_file;
use std::path::PathBuf;
use std::str::FromStr;

#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum ImportFormat {
    Opencv,
    Ros,
    Kalibr,
}

#[derive(Debug, clap::Args)]
pub(super) struct ImportArgs {
    /// The camera's file
    #[arg(value_name = "FILE")]
    file: PathBuf,
    /// Its format [default: recognised from its content]
    #[arg(long)]
    format: Option<ImportFormat>,
    /// σ of fx, fy, cx, cy, k1, k2, p1, p2, k3 (k4, k5, k6), as the other program gives them: pixels for the first four
    #[arg(long, value_name = "σ,σ,…", value_parser = Deviations::from_str)]
    sd: Option<Deviations>,
    /// Rig file to write; an existing one keeps its bands
    #[arg(long, short, value_name = "RIG.toml")]
    out: PathBuf,
}

/// σ of the nine parameters of a lens, or of the twelve of a rational one.
#[derive(Debug, Clone, PartialEq)]
struct Deviations(Vec<f64>);

impl FromStr for Deviations {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || {
            "expected nine σ above 0, of fx, fy, cx, cy, k1, k2, p1, p2, k3 (twelve with k4, k5, k6 of a rational \
             lens), for example 1.2,1.2,0.9,0.8,3e-3,0.02,2e-4,2e-4,0.05; of a number that was held, one as small as \
             it is well known"
                .to_owned()
        };
        let numbers =
            text.split([',', ' ']).filter(|part| !part.is_empty()).map(|part| part.trim().parse::<f64>().ok());
        let numbers: Vec<f64> = numbers.collect::<Option<_>>().ok_or_else(wrong)?;
        let sound = matches!(numbers.len(), 9 | 12) && numbers.iter().all(|sd| *sd > 0.0 && sd.is_finite());
        if sound { Ok(Self(numbers)) } else { Err(wrong()) }
    }
}

pub(super) fn run(
    args: &ImportArgs,
    note: impl Fn(&str),
    print: impl Fn(&str) -> Result<(), Failure>,
) -> Result<(), Failure> {
    can_be_written(&args.out)?;
    let old = args.out.exists().then(|| Draft::load(&args.out)).transpose()?;
    let text =
        text_file::read(&args.file).map_err(|e| Failure::usage(format!("cannot read {}: {e}", args.file.display())))?;
    let format = match args.format {
        Some(ImportFormat::Opencv) => Format::OpenCv,
        Some(ImportFormat::Ros) => Format::Ros,
        Some(ImportFormat::Kalibr) => Format::Kalibr,
        None => {
            let format = Format::guess(&text, &args.file)?;
            note(&format!("{}: read as {format}", args.file.display()));
            format
        }
    };
    let camera = format.read(&text, &args.file)?;
    let mut draft = match old {
        Some(old) => {
            if let Some(said) = left_out(&old, camera.size_px) {
                note(&said);
            }
            old.with_lens(camera.size_px, camera.lens)
        }
        None => Draft::of_camera(camera),
    };
    let sha256 = hash::of_bytes(text.as_bytes());
    let file = args.file.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let mut provenance = toml::Table::from_iter([
        ("made_by".to_owned(), format!("catoptra {} rig import", env!("CARGO_PKG_VERSION")).into()),
        ("format".to_owned(), format.to_string().into()),
        ("lens".to_owned(), lens_note(&draft.camera.lens).into()),
        ("inputs_sha256".to_owned(), toml::Table::from_iter([(file, sha256.into())]).into()),
    ]);
    if let Some(Deviations(sd)) = &args.sd {
        let n = Parameter::of_lens(&draft.camera.lens).len();
        if sd.len() != n {
            let text = format!("--sd: {} σ, and this lens has {n} numbers", sd.len());
            return Err(Failure::usage(text));
        }
        let row = |i: usize| (0..n).map(|k| if k == i { sd[i] * sd[i] } else { 0.0 }).collect::<Vec<f64>>();
        provenance.insert("lens_covariance".into(), (0..n).map(|i| row(i).into()).collect::<Vec<toml::Value>>().into());
    }
    draft.provenance.insert("camera".into(), provenance.into());
    if let Some(doubt) =
        fisheye_doubt(format, &draft.camera.lens.distortion).filter(|_| !draft.camera.lens.is_rational())
    {
        tracing::warn!("{}: {doubt}", args.file.display());
    }
    for warning in of_camera(&draft.camera, draft.views.is_empty()) {
        tracing::warn!("{}: {warning}", args.file.display());
    }
    let written = save(&draft, &args.out)?;
    let known = match args.sd {
        Some(_) => "its σ count as independent of each other: `calibrate rig` knows the lens as well as they say",
        None => {
            "the lens came without σ (--sd): `calibrate rig` takes it as exact, and its verdict does not include the \
             lens's errors"
        }
    };
    note(known);
    print(&format!("{written}\n"))
}

/// Four coefficients may also be k1 to k4 of OpenCV's fisheye model, whose files look the same. A lens that is mounted
/// straight has p1 and p2 below this.
const USUAL_TANGENTIAL: f64 = 2e-3;

fn fisheye_doubt(format: Format, [_, _, p1, p2, k3]: &[f64; 5]) -> Option<String> {
    let unusual = p1.abs() > USUAL_TANGENTIAL || p2.abs() > USUAL_TANGENTIAL;
    (format == Format::OpenCv && *k3 == 0.0 && unusual).then(|| {
        format!(
            "the coefficients were read as k1, k2, p1, p2, and p1 = {p1}, p2 = {p2} are large for a lens that is \
             mounted straight: if they are k1 to k4 of a fisheye model, this camera is wrong; calibrate it with \
             `catoptra calibrate camera`"
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn deviations_as_people_write_them() {
        let nine = "1.2,1.3, 0.9,0.8,3e-3,0.02,2e-4,2e-4,0.05";
        assert_eq!(nine.parse::<Deviations>().unwrap().0[..3], [1.2, 1.3, 0.9]);
        for text in ["1,2,3", "1,1,1,1,1,1,1,1,0", "1,1,1,1,1,1,1,1,x", "1,1,1,1,1,1,1,1,1,1", ""] {
            assert!(text.parse::<Deviations>().unwrap_err().contains("nine σ"), "{text}");
        }
    }
}
