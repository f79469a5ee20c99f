//! `catoptra rig import`: a camera calibrated elsewhere begins a rig file.

use super::super::calibrate::{can_be_written, left_out, save};
use super::{Exit, Failure};
use crate::rig::Draft;
use crate::rig::formats::Format;
use sha2::{Digest as _, Sha256};
use std::path::PathBuf;

#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum From {
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
    format: Option<From>,
    /// Rig file to write; an existing one keeps its bands
    #[arg(long, short, value_name = "RIG.toml")]
    out: PathBuf,
}

pub(super) fn run(args: &ImportArgs, note: impl Fn(&str)) -> Result<(), Failure> {
    can_be_written(&args.out)?;
    let old = args.out.exists().then(|| Draft::load(&args.out)).transpose()?;
    let text = std::fs::read_to_string(&args.file)
        .map_err(|e| Failure::new(Exit::Usage, format!("cannot read {}: {e}", args.file.display())))?;
    let format = match args.format {
        Some(From::Opencv) => Format::OpenCv,
        Some(From::Ros) => Format::Ros,
        Some(From::Kalibr) => Format::Kalibr,
        None => {
            let format = Format::guess(&text, &args.file)?;
            note(&format!("{}: read as {format}", args.file.display()));
            format
        }
    };
    let camera = format.read(&text, &args.file)?;
    let mut draft = match old {
        Some(old) => {
            if let Some(said) = left_out(&old) {
                note(said);
            }
            old.with_lens(camera.size_px, camera.lens)
        }
        None => Draft::of_camera(camera),
    };
    let hash: String = Sha256::digest(text.as_bytes()).iter().map(|byte| format!("{byte:02x}")).collect();
    let file = args.file.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let provenance = toml::Table::from_iter([
        ("made_by".to_owned(), format!("catoptra {} rig import", env!("CARGO_PKG_VERSION")).into()),
        ("format".to_owned(), format.to_string().into()),
        ("inputs_sha256".to_owned(), toml::Table::from_iter([(file, hash.into())]).into()),
    ]);
    draft.provenance.insert("camera".into(), provenance.into());
    let written = save(&draft, &args.out)?;
    note(&format!(
        "{written}\nthe lens came without uncertainties: `calibrate rig` takes it for exact, and its verdict knows \
         nothing of the lens's errors"
    ));
    Ok(())
}
