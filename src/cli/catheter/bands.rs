//! Where on the tube the points are that a run has.
//!
//! A tracker counts from the base band and calls the middle of the tip's band the tip; `catheter run` without `[bands]`
//! counts from the clamp, and its tip is the end of the tube. Which of them, in this order: the rig given, the rig
//! recorded with the run, a table whose base stays exactly in the origin (as no tracker's does; at rest only if the
//! catheter's file has no bands), the catheter's file.

use crate::catheter::{Bands, Catheter};
use crate::cli::Failure;
use crate::cli::results::{Owner, RUN};
use crate::log::schema::{LOG_FILE, RIG_ATTACHMENT, TABLE_FILE};
use crate::log::{attached, is_log};
use crate::rig::Rig;
use crate::series::Recording;
use crate::simulate::Mount;
use nalgebra::Point3;
use std::path::{Path, PathBuf};

/// A rig, and what it is called in messages.
pub(super) struct Seen {
    pub(super) name: String,
    rig: Rig,
}

impl Seen {
    /// The rig with which a run was recorded; `None` if it is not known, or does not say where the bands are.
    pub(super) fn by(run: &Path, given: Option<&Path>) -> Result<Option<Self>, Failure> {
        if let Some(path) = given {
            return Ok(Some(Self { name: path.display().to_string(), rig: Rig::load(path)? }));
        }
        let Some((text, file)) = recorded(run)? else { return Ok(None) };
        let name = format!("the rig in {}", file.display());
        let why = match Rig::from_toml_str(&text, &file) {
            Ok(rig) if rig.base.is_none() || rig.markers.iter().any(|marker| marker.centre_m.is_none()) => {
                "does not say where all bands are (centre_mm)".to_owned()
            }
            Ok(rig) => return Ok(Some(Self { name, rig })),
            Err(error) => format!("cannot be read ({error})"),
        };
        tracing::warn!("{}: {name} {why}", run.display());
        Ok(None)
    }

    /// The bands on `given`, or on the paper's catheter with the rig's lengths; a catheter that has them.
    pub(super) fn on(&self, given: Option<&Catheter>) -> Result<Catheter, Failure> {
        let mount = Mount::of(&self.rig, given).map_err(|e| Failure::usage(format!("{}: {e}", self.name)))?;
        Ok(mount.catheter)
    }
}

/// The text of the rig that is recorded with a run, and where.
fn recorded(run: &Path) -> Result<Option<(String, PathBuf)>, Failure> {
    let in_log = |log: PathBuf| -> Result<_, Failure> {
        let text = attached(&log, RIG_ATTACHMENT).map_err(Failure::usage)?;
        Ok(text.filter(|text| !text.trim().is_empty()).map(|text| (text, log)))
    };
    if is_log(run) {
        return in_log(run.to_owned());
    }
    let origin = std::fs::read_to_string(run.with_file_name(RUN)).ok();
    let Some(owner) = origin.and_then(|text| toml::from_str::<Owner>(&text).ok()) else { return Ok(None) };
    let is_called = |name: &str| run.file_name().is_some_and(|own| own == name);
    match owner.command.as_str() {
        "simulate" if is_called("truth.csv") => {
            let rig = run.with_file_name("rig.toml");
            Ok(std::fs::read_to_string(&rig).ok().map(|text| (text, rig)))
        }
        "track" | "live" if is_called(TABLE_FILE) => {
            let log = run.with_file_name(LOG_FILE);
            if log.exists() { in_log(log) } else { Ok(None) }
        }
        _ => Ok(None),
    }
}

/// The bands of a run; `None` when it counts from the clamp to the end of the tube.
pub(super) fn of(recording: &Recording, seen: Option<&Seen>, catheter: &Catheter) -> Result<Option<Bands>, Failure> {
    if let Some(seen) = seen {
        return Ok(seen.on(Some(catheter))?.bands);
    }
    // At rest and without noise a base band is in the origin, too.
    if counts_from_clamp(recording) && (catheter.bands.is_none() || moves(recording)) {
        return Ok(None);
    }
    if catheter.bands.is_none() {
        tracing::warn!(
            "{}: nothing says where its bands are on the tube: places are taken as counted from the clamp, and the tip \
             as the end of the tube; give --rig, or [bands] in the catheter's file",
            recording.path.display()
        );
    }
    Ok(catheter.bands)
}

/// Whether the base is exactly in the origin wherever it is.
fn counts_from_clamp(recording: &Recording) -> bool {
    let mut places = places(recording, "base").peekable();
    places.peek().is_some() && places.all(|place| place == Point3::origin())
}

/// Whether the tip is not exactly in one place, or has noise.
fn moves(recording: &Recording) -> bool {
    let mut places = places(recording, "tip");
    places.next().is_some_and(|first| places.any(|place| place != first))
}

fn places<'a>(recording: &'a Recording, name: &str) -> impl Iterator<Item = Point3<f64>> + 'a {
    let marker = recording.markers.iter().position(|known| known == name);
    recording.frames.iter().filter_map(move |frame| frame.places.get(marker?)?.point)
}
