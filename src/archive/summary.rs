//! [`RunSummary`]: `summary.json`, which is written last into the folder of a run and renamed into place. If it exists,
//! the run is over and the other files are complete; if not, the run was not finished.
//!
//! Its format is described for other programs in `docs/summary.schema.json`; a test keeps the two consistent.

use crate::atomic_file;
use crate::pipeline::{End, Summary};
use crate::source::StreamFaults;
use crate::tally::{AngleTally, MarkerTally, Tally};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::io;
use std::path::{Path, PathBuf};

/// Name of the file.
pub(crate) const SUMMARY: &str = "summary.json";

/// Version of the format written here. A larger one is from a later program.
pub(crate) const SCHEMA: u32 = 1;

/// Why a summary cannot be read.
#[derive(Debug, thiserror::Error)]
pub(crate) enum SummaryError {
    /// The file system reports an error.
    #[error("{}: cannot be read: {source}", path.display())]
    Read { path: PathBuf, source: io::Error },
    /// It has another format, or is from another program.
    #[error("{}: is not a summary of a run: {reason}", path.display())]
    Form { path: PathBuf, reason: String },
}

/// How a run ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Outcome {
    /// With results.
    Tracked,
    /// With files, but a band was never found, or the coil's direction was never measured.
    Unusable,
    /// Without results, or with only a part.
    Failed,
}

impl Outcome {
    /// As a word.
    pub(crate) fn word(self) -> &'static str {
        match self {
            Self::Tracked => "tracked",
            Self::Unusable => "unusable",
            Self::Failed => "failed",
        }
    }
}

/// Why a run has no results.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Failed {
    /// In words.
    pub(crate) message: String,
    /// Whether the same run may succeed another time: the disk was full, or a file system unavailable.
    pub(crate) retryable: bool,
}

/// SHA-256 of the inputs of a run, in hexadecimal; `None` for what could not be read.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Hashes {
    /// Of the recording; of the names and hashes of its files, if it is a folder.
    pub(crate) recording: Option<String>,
    /// Of the rig file's text, also when it is attached to a log.
    pub(crate) rig: Option<String>,
    /// Of [`RunSummary::options`] as JSON.
    pub(crate) options: Option<String>,
    /// Of the program's file.
    pub(crate) program: Option<String>,
}

/// A file of the run.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct FileRecord {
    pub(crate) name: String,
    pub(crate) bytes: u64,
    /// Of the table: numbers may be changed without changing its length.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) sha256: Option<String>,
}

/// Everything about a finished run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct RunSummary {
    /// Format version of this file.
    pub(crate) schema: u32,
    /// Name of the run and of its folder.
    pub(crate) name: String,
    pub(crate) outcome: Outcome,
    pub(crate) failure: Option<Failed>,
    /// Why the recording ends early, if it does: the readable part was tracked.
    pub(crate) ends_early: Option<String>,
    /// Whole path of the recording.
    pub(crate) recording: String,
    /// Whole path of the rig.
    pub(crate) rig: String,
    /// Options that results depend on, and their values.
    pub(crate) options: BTreeMap<String, String>,
    /// Further columns of the manifest.
    pub(crate) manifest: BTreeMap<String, String>,
    pub(crate) sha256: Hashes,
    /// Version of the program.
    pub(crate) version: String,
    /// Libraries that results depend on, with their versions.
    pub(crate) libraries: String,
    /// Measurements; `None` when the run failed before its first frame.
    pub(crate) measured: Option<Measured>,
    /// Warnings, the first hundred.
    pub(crate) warnings: Vec<String>,
    /// How many more there were.
    pub(crate) more_warnings: u64,
    /// Files in the folder, besides this one.
    pub(crate) files: Vec<FileRecord>,
    /// Wall-clock time at the end, UTC.
    pub(crate) finished: String,
    /// Wall-clock duration, seconds.
    pub(crate) elapsed_s: f64,
}

/// Measurements. σ are medians over the measured frames.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Measured {
    /// Frames received.
    pub(crate) frames: u64,
    /// Frames in which everything is known.
    pub(crate) complete: u64,
    /// Camera frames lost, and number of gaps.
    pub(crate) lost: u64,
    pub(crate) gaps: u64,
    /// Camera time of the first and the last frame, nanoseconds of `clock`.
    pub(crate) first_ns: i64,
    pub(crate) last_ns: i64,
    pub(crate) clock: String,
    /// Time between them, seconds.
    pub(crate) duration_s: f64,
    pub(crate) theta: Angle,
    pub(crate) tangent: Angle,
    pub(crate) markers: Vec<Marker>,
    pub(crate) misses: Vec<Miss>,
    pub(crate) drift_alarms: Vec<Alarm>,
    pub(crate) faults: Faults,
}

/// An angle, degrees.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Angle {
    /// Frames in which it is known.
    pub(crate) answered: u64,
    pub(crate) sd_deg: Option<f64>,
    pub(crate) min_deg: Option<f64>,
    pub(crate) max_deg: Option<f64>,
}

/// A marker.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Marker {
    pub(crate) name: String,
    /// Frames with a place.
    pub(crate) answered: u64,
    /// σ of a coordinate, mm.
    pub(crate) sd_mm: Option<f64>,
    pub(crate) views: Vec<View>,
}

/// A marker in a view.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct View {
    pub(crate) name: String,
    /// Frames in which it was seen.
    pub(crate) seen: u64,
    /// Mean residual in u and v, and RMS of one coordinate, pixels.
    pub(crate) residual_mean_px: Option<[f64; 2]>,
    pub(crate) residual_rms_px: Option<f64>,
    /// Colour separation, 1 as learned.
    pub(crate) separation_mean: Option<f64>,
    pub(crate) separation_least: Option<f64>,
    /// Width over that of a tube of the rig's diameter; earlier versions have none.
    #[serde(default)]
    pub(crate) width_mean: Option<f64>,
}

/// How often a quantity was missed for one reason.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Miss {
    /// A marker, `tangent` or `deflection`.
    pub(crate) what: String,
    pub(crate) reason: String,
    pub(crate) frames: u64,
}

/// A sign that the rig is no longer as it was calibrated.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Alarm {
    pub(crate) kind: String,
    /// Camera time, nanoseconds.
    pub(crate) at_ns: i64,
    /// When it was over; `None` while it lasts, to the end of the run.
    pub(crate) over_ns: Option<i64>,
    /// Size in space, mm.
    pub(crate) size_mm: f64,
    pub(crate) message: String,
}

/// Faults of the recording that did not end it.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Faults {
    pub(crate) damaged_packets: u64,
    pub(crate) damaged_pictures: u64,
    pub(crate) repeated_stamps: u64,
    pub(crate) backward_stamps: u64,
    pub(crate) guessed_stamps: u64,
}

impl From<StreamFaults> for Faults {
    fn from(faults: StreamFaults) -> Self {
        Self {
            damaged_packets: faults.damaged_packets,
            damaged_pictures: faults.pictures_left_out,
            repeated_stamps: faults.repeated_stamps,
            backward_stamps: faults.backward_stamps,
            guessed_stamps: faults.guessed_stamps,
        }
    }
}

impl Measured {
    /// The measurements of a run with these views.
    pub(crate) fn of(run: &Summary, views: &[String]) -> Self {
        let tally: &Tally = &run.tally;
        let angle = |angle: &AngleTally| Angle {
            answered: angle.answered,
            sd_deg: angle.median_sd_deg(),
            min_deg: angle.range_deg.map(|(low, _)| low),
            max_deg: angle.range_deg.map(|(_, high)| high),
        };
        let marker = |marker: &MarkerTally| Marker {
            name: marker.name.clone(),
            answered: marker.answered,
            sd_mm: marker.median_sd_mm(),
            views: marker
                .views
                .iter()
                .zip(views)
                .map(|(view, name)| View {
                    name: name.clone(),
                    seen: view.seen,
                    residual_mean_px: view.mean_px(),
                    residual_rms_px: view.rms_px(),
                    separation_mean: view.mean_separation(),
                    separation_least: view.least_separation,
                    width_mean: view.mean_width(),
                })
                .collect(),
        };
        let alarms = tally.drift.alarms().iter().zip(tally.alarms());
        Self {
            frames: tally.frames,
            complete: tally.complete,
            lost: tally.lost,
            gaps: tally.gaps,
            first_ns: tally.first_ns,
            last_ns: tally.last_ns,
            clock: tally.clock.to_owned(),
            duration_s: tally.duration_s(),
            theta: angle(&tally.theta),
            tangent: angle(&tally.tangent),
            markers: tally.markers.iter().map(marker).collect(),
            misses: tally
                .misses()
                .into_iter()
                .map(|miss| Miss { what: miss.what.clone(), reason: miss.reason.clone(), frames: miss.frames })
                .collect(),
            drift_alarms: alarms
                .map(|(alarm, words)| Alarm {
                    kind: alarm.word().to_owned(),
                    at_ns: words.ns,
                    over_ns: words.over_ns,
                    size_mm: alarm.size_m * 1e3,
                    message: words.what,
                })
                .collect(),
            faults: run.source.into(),
        }
    }

    /// Drift alarms: those that lasted to the end of the run, and those that were over before.
    pub(crate) fn alarms_lasting_and_over(&self) -> (u64, u64) {
        let over = self.drift_alarms.iter().filter(|alarm| alarm.over_ns.is_some()).count();
        ((self.drift_alarms.len() - over) as u64, over as u64)
    }

    /// Largest RMS residual of a marker in a view, pixels.
    pub(crate) fn largest_rms_px(&self) -> Option<f64> {
        let views = self.markers.iter().flat_map(|marker| &marker.views);
        views.filter_map(|view| view.residual_rms_px).max_by(f64::total_cmp)
    }

    /// Largest mean residual of a marker in a view, pixels: what does not average out.
    pub(crate) fn largest_mean_px(&self) -> Option<f64> {
        let views = self.markers.iter().flat_map(|marker| &marker.views);
        views.filter_map(|view| view.residual_mean_px.map(|[u, v]| u.hypot(v))).max_by(f64::total_cmp)
    }
}

/// Why the recording of a run ends early, if it does.
pub(crate) fn early_end(end: &End) -> Option<String> {
    match end {
        End::Early(error) => Some(error.to_string()),
        _ => None,
    }
}

impl RunSummary {
    /// Reads that of the run in `folder`; `None` when there is none.
    ///
    /// # Errors
    /// [`SummaryError`].
    pub(crate) fn read(folder: &Path) -> Result<Option<Self>, SummaryError> {
        let path = folder.join(SUMMARY);
        let bytes = match std::fs::read(&path) {
            Ok(bytes) => bytes,
            Err(source) if [io::ErrorKind::NotFound, io::ErrorKind::NotADirectory].contains(&source.kind()) => {
                return Ok(None);
            }
            Err(source) => return Err(SummaryError::Read { path, source }),
        };
        /// Fields common to all versions.
        #[derive(Deserialize)]
        struct Form {
            schema: u32,
        }
        let refused = |reason: String| SummaryError::Form { path: path.clone(), reason };
        let wrong = |e: serde_json::Error| match e.is_eof() {
            true => refused("it is cut off".to_owned()),
            false => refused(e.to_string()),
        };
        let form: Form = serde_json::from_slice(&bytes).map_err(wrong)?;
        if form.schema != SCHEMA {
            return Err(refused(format!("its format version is {}; this program reads version {SCHEMA}", form.schema)));
        }
        serde_json::from_slice(&bytes).map(Some).map_err(wrong)
    }

    /// Writes it into `folder` in one step.
    ///
    /// # Errors
    /// The system's.
    pub(crate) fn write(&self, folder: &Path) -> io::Result<()> {
        let text = serde_json::to_string_pretty(self).map_err(io::Error::other)?;
        atomic_file::write(&folder.join(SUMMARY), (text + "\n").as_bytes())
    }
}

#[cfg(test)]
impl RunSummary {
    /// A run of 100 frames, with an entry in every list.
    pub(crate) fn example() -> Self {
        let view = View {
            name: "direct".into(),
            seen: 100,
            residual_mean_px: Some([0.01, -0.02]),
            residual_rms_px: Some(0.05),
            separation_mean: Some(0.97),
            separation_least: Some(0.9),
            width_mean: Some(1.01),
        };
        let marker = Marker { name: "tip".into(), answered: 99, sd_mm: Some(0.03), views: vec![view] };
        let measured = Measured {
            frames: 100,
            complete: 99,
            last_ns: 1_650_000_000,
            clock: "container".into(),
            duration_s: 1.65,
            theta: Angle { answered: 99, sd_deg: Some(0.1), min_deg: Some(-1.0), max_deg: Some(20.0) },
            markers: vec![marker],
            misses: vec![Miss { what: "tip".into(), reason: "not_seen_mirror".into(), frames: 1 }],
            ..Measured::default()
        };
        let hashes = Hashes { rig: Some("ab".repeat(32)), ..Hashes::default() };
        Self {
            schema: SCHEMA,
            name: "swing".into(),
            outcome: Outcome::Tracked,
            failure: None,
            ends_early: None,
            recording: "/data/swing.mkv".into(),
            rig: "/data/rig.toml".into(),
            options: [("frame".to_owned(), "base".to_owned())].into(),
            manifest: [("site".to_owned(), "A".to_owned())].into(),
            sha256: hashes,
            version: "0.1.0".into(),
            libraries: "libavcodec 59.37.100".into(),
            measured: Some(measured),
            warnings: vec!["a warning".into()],
            more_warnings: 0,
            files: vec![FileRecord { name: "track.csv".into(), bytes: 3, sha256: None }],
            finished: "2026-11-21T00:00:00Z".into(),
            elapsed_s: 1.5,
        }
    }
}
