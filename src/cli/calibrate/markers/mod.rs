//! `catoptra calibrate markers`: a recording and a click near each band to colours and places of the bands.

mod clicks;
mod picked;
mod words;

pub(super) use picked::rig_with_picks;

use super::super::{Exit, Failure, fitting};
use super::{Length, can_be_written, page_beside, save, save_page};
use crate::calibrate::markers::{MarkersError, MarkersOptions, Teaching, calibrate_markers};
use crate::report::teaching::{self, TeachingInfo};
use crate::rig::Rig;
use crate::source::{FrameRate, SourceOptions};
use clicks::{PickArg, RegionArg, exposure_s};
use picked::{is_noted, note_places, picks, stiff_enough_to_bend};
use std::path::{Path, PathBuf};
use std::str::FromStr;

#[derive(Debug, clap::Args)]
pub(super) struct MarkersArgs {
    /// A recording, or a folder of pictures
    #[arg(value_name = "VIDEO|DIR")]
    source: PathBuf,
    /// The rig file with camera, surfaces and views
    #[arg(long, value_name = "RIG.toml")]
    rig: PathBuf,
    /// Outer diameter of the tube
    #[arg(long, value_name = "3.2mm", allow_hyphen_values = true, value_parser = Length::from_str)]
    tube: Length,
    /// A band: name, view (if not the first), a pixel on it or up to 5 beside it, its length; from the base to the tip
    #[arg(long = "pick", value_name = "NAME@[VIEW:]X,Y:LENGTH", required = true, value_parser = PickArg::from_str)]
    picks: Vec<PickArg>,
    /// Frame of the picks: the first one this many seconds after the recording's start, or later
    #[arg(long, value_name = "S", default_value_t = 0.0, allow_hyphen_values = true)]
    at: f64,
    /// View of the picks that name none [default: the first one]
    #[arg(long, value_name = "NAME")]
    view: Option<String>,
    /// Where in the picture a view is: two corners of a rectangle, or those of a polygon
    #[arg(long = "region", value_name = "VIEW:X,Y-X,Y[-X,Y...]", value_parser = RegionArg::from_str)]
    regions: Vec<RegionArg>,
    /// Band whose direction is wanted [default: that of the rig, `coil`, or the second one]
    #[arg(long, value_name = "NAME")]
    coil: Option<String>,
    /// Band that ends the tube, or `none` [default: that of the rig, or the last one]
    #[arg(long, value_name = "NAME")]
    end: Option<String>,
    /// Length of the stiff part around the coil's middle, if longer than its band [default: that of the rig]
    #[arg(long, value_name = "14mm", allow_hyphen_values = true, value_parser = Length::from_str)]
    rigid: Option<Length>,
    /// How long each picture was exposed, to model motion blur [default: learned from it, where it shows]
    #[arg(long, value_name = "10ms", allow_hyphen_values = true, value_parser = exposure_s)]
    exposure: Option<f64>,
    /// Frames per second of a folder of pictures without times.csv
    #[arg(long, value_name = "F", allow_hyphen_values = true)]
    fps: Option<FrameRate>,
    /// Rig file to write [default: the one given by --rig]
    #[arg(long, short, value_name = "RIG.toml")]
    out: Option<PathBuf>,
}

impl MarkersArgs {
    /// The rig file to write.
    pub(super) fn out(&self) -> &PathBuf {
        self.out.as_ref().unwrap_or(&self.rig)
    }
}

pub(super) fn run(args: &MarkersArgs, print: impl Fn(&str) -> Result<(), Failure>) -> Result<(), Failure> {
    let out = args.out();
    let rig = rig_with_picks(args)?;
    can_be_written(out)?;
    let page_path = page_beside(out, "markers")?;
    if !(args.at.is_finite() && args.at >= 0.0) {
        return Err(Failure::usage(format!(
            "--at {}: expected seconds from the recording's start, 0 or more",
            args.at
        )));
    }
    let picks = picks(args, &rig)?;
    let options = SourceOptions { stated_rate: args.fps, decoder_threads: 0, ..SourceOptions::default() };
    let mut frames = fitting::open((&args.source, options), (&args.rig, &rig))?;
    let exposure_s = args.exposure.or_else(|| stated_exposure_s(&rig));
    let options = MarkersOptions { after_ns: (args.at * 1e9) as i64, exposure_s };
    let mut done = calibrate_markers(&rig, &picks, &options, &mut frames);
    // Without a frame there is nothing to show.
    let page = done.frame.is_some().then(|| teaching::page(&info(args, out), &done));
    if let Err(error) = done.outcome {
        let note = match &page {
            Some(page) => {
                save_page(page, &page_path)?;
                format!("\nno rig was written; see {} for what was found", page_path.display())
            }
            None => String::new(),
        };
        return Err(failure(args, error, &note));
    }
    stiff_enough_to_bend(args, &done.rig.markers, done.rig.catheter.coil)?;
    let provenance = provenance(args, &done, &rig, exposure_s.is_some());
    done.rig.provenance.insert("markers".into(), provenance.into());
    print(&words::describe(&done))?;
    for warning in words::warnings(&done) {
        tracing::warn!("{warning}");
    }
    let written = save(&done.rig.into(), out)?;
    print(&format!("\n{written}\n"))?;
    if let Some(page) = page {
        save_page(&page, &page_path)?;
        print(&format!("         {} (what was learned, for a browser)\n", page_path.display()))?;
    }
    Ok(())
}

/// Information about the run for the page.
fn info(args: &MarkersArgs, out: &Path) -> TeachingInfo {
    let mm = |length_m: f64| format!("{} mm", length_m * 1e3);
    let mut settings = vec![
        ("Recording".to_owned(), args.source.display().to_string()),
        ("Frame of the picks".to_owned(), format!("from {} s on", args.at)),
        ("Tube".to_owned(), mm(args.tube.0)),
    ];
    settings.extend(args.rigid.map(|rigid| ("Stiff part".to_owned(), mm(rigid.0))));
    settings.extend(super::super::provenance::of_this_run());
    TeachingInfo { rig: out.display().to_string(), settings }
}

fn failure(args: &MarkersArgs, error: MarkersError, note: &str) -> Failure {
    let exit = match error {
        MarkersError::NoPick(_)
        | MarkersError::BeyondEnd { .. }
        | MarkersError::Outside { .. }
        | MarkersError::OutsideView { .. }
        | MarkersError::Track(_) => Exit::Usage,
        // It already names its file.
        MarkersError::Source(_) => return Failure::new(Exit::Failed, error),
        MarkersError::NoFrame => Exit::Failed,
        _ => Exit::Unusable,
    };
    Failure::new(exit, format!("{}: {error}{note}", args.source.display()))
}

/// Where the exposure is from, as noted: stated by hand or by --exposure, or learned from motion blur.
const EXPOSURE_FROM: &str = "exposure_from";
const STATED: &str = "stated";
const LEARNED: &str = "learned";
const NOT_KNOWN: &str = "not known";
/// The one that was learned.
const LEARNED_EXPOSURE_MS: &str = "learned_exposure_ms";

/// The exposure of the rig, if it was stated. Files of older versions do not say where it is from once bands were
/// learned: then it is learned again.
fn stated_exposure_s(rig: &Rig) -> Option<f64> {
    let learned = rig.provenance.get("markers");
    let from = learned.and_then(|noted| noted.get(EXPOSURE_FROM)?.as_str());
    let exposure_s = rig.camera.exposure_s?;
    // One that was not known then, or was another, was stated since.
    let is_stated = match (learned, from) {
        (None, _) | (_, Some(STATED | NOT_KNOWN)) => true,
        (Some(learned), _) => {
            let noted = learned.get(LEARNED_EXPOSURE_MS);
            noted.is_some() && !is_noted(noted, exposure_s * 1e3)
        }
    };
    if !is_stated && from.is_none() {
        tracing::warn!(
            "the rig's exposure of {} ms may have been stated or learned: it is learned again, unless \
             --exposure states it",
            exposure_s * 1e3
        );
    }
    is_stated.then_some(exposure_s)
}

fn provenance(args: &MarkersArgs, done: &Teaching, before: &Rig, exposure_is_stated: bool) -> toml::Table {
    let mut table = toml::Table::new();
    let file = args.source.file_name().unwrap_or_default().to_string_lossy().into_owned();
    table.insert("made_by".into(), format!("catoptra {} calibrate markers", env!("CARGO_PKG_VERSION")).into());
    table.insert("recording".into(), file.into());
    note_places(&mut table, before, &done.rig);
    let exposure_from = match done.rig.camera.exposure_s {
        Some(_) if exposure_is_stated => STATED,
        Some(exposure_s) => {
            table.insert(LEARNED_EXPOSURE_MS.into(), (exposure_s * 1e3).into());
            LEARNED
        }
        None => NOT_KNOWN,
    };
    table.insert(EXPOSURE_FROM.into(), exposure_from.into());
    if let Ok(learned) = &done.outcome {
        table.insert("frames".into(), (learned.frames as i64).into());
        let round = |v: f64| (v * 1e3).round() / 1e3;
        let sd_mm: Vec<toml::Value> =
            learned.centre_sd_m.iter().flatten().map(|sd| toml::Value::from(round(sd * 1e3))).collect();
        if !sd_mm.is_empty() {
            table.insert("spacing_sd_mm".into(), sd_mm.into());
        }
        let known: Option<Vec<f64>> = learned.blur_sd_px.iter().copied().collect();
        if let Some(sd_px) = known {
            table.insert("blur_sd_px".into(), sd_px.into_iter().map(round).collect::<Vec<_>>().into());
        }
    }
    table
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_exposure_that_was_stated_is_kept_and_a_learned_one_is_learned_again() {
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("calibration/dev_tank/rig.toml");
        let mut rig = Rig::load(&file).unwrap();
        rig.camera.exposure_s = Some(0.01);
        let mut kept = |from: Option<&str>| {
            let noted = from.map(|from| toml::Table::from_iter([(EXPOSURE_FROM.to_owned(), from.into())]));
            rig.provenance.insert("markers".into(), noted.unwrap_or_default().into());
            stated_exposure_s(&rig)
        };
        let found = [Some(STATED), Some(LEARNED), Some(NOT_KNOWN), None].map(&mut kept);
        assert_eq!(found, [Some(0.01), None, Some(0.01), None]);
        // The one that was learned, and one that was written since.
        for (learned_ms, stated) in [(10.000_000_3, None), (9.5, Some(0.01))] {
            let mut noted = toml::Table::from_iter([(EXPOSURE_FROM.to_owned(), LEARNED.into())]);
            noted.insert(LEARNED_EXPOSURE_MS.into(), toml::Value::Float(learned_ms));
            rig.provenance.insert("markers".into(), noted.into());
            assert_eq!(stated_exposure_s(&rig), stated);
        }
        rig.provenance.remove("markers");
        assert_eq!(stated_exposure_s(&rig), Some(0.01));
    }
}
