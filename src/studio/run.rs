//! The files of a run, read back: from its log, with outlines and residuals, or from its table alone.

use super::Refusal;
use super::places::{changed, opened};
use crate::archive::RunSummary;
use crate::log::LogError;
use crate::log::decoder::MessageDecoder;
use crate::log::fields::{float, floats, inner, list, number, optional_number, text, whole, word, xyz};
use crate::log::schema::{LOG_FILE, RIG_ATTACHMENT, TABLE_FILE, Topic, pictures_file};
use crate::log::{is_being_written, records};
use crate::rig::Rig;
use crate::series::Recording;
use crate::source::{FrameRate, SourceOptions};
use mcap::records::Record;
use nalgebra::Point3;
use parking_lot::Mutex;
use prost_reflect::DynamicMessage;
use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};
use std::time::SystemTime;

/// Runs that stay in memory.
const MAX_RUNS: usize = 2;

/// Runs that were read.
#[derive(Default)]
pub(super) struct Runs(Mutex<Vec<Arc<Run>>>);

impl Runs {
    /// The run in a folder; read again when its files have changed.
    pub(super) fn get(&self, folder: &Path) -> Result<Arc<Run>, Refusal> {
        // Held while it is read: two requests read it once.
        let mut runs = self.0.lock();
        if let Some(at) = runs.iter().position(|run| run.folder() == folder) {
            let run = runs.remove(at);
            if run.is_current() {
                runs.push(Arc::clone(&run));
                return Ok(run);
            }
        }
        let run = Arc::new(Run::read(folder)?);
        if runs.len() >= MAX_RUNS {
            runs.remove(0);
        }
        runs.push(Arc::clone(&run));
        Ok(run)
    }
}

/// A run.
#[derive(Debug, Default)]
pub(super) struct Run {
    folder: PathBuf,
    changed: [Option<(SystemTime, u64)>; 2],
    /// Paths as `run.toml` has them.
    pub(super) recording: Option<String>,
    pub(super) rig_path: Option<String>,
    /// Whether it was tracked while the camera ran.
    pub(super) live: bool,
    /// The rate that was stated for its recording.
    pub(super) stated_rate: Option<FrameRate>,
    /// The videos of its pictures that were recorded with it, with the time of each one's first.
    pictures: OnceLock<Vec<(PathBuf, i64)>>,
    /// The log has outlines of bands.
    outlined: bool,
    /// The rig that it was tracked with, from the log.
    pub(super) rig: Option<Rig>,
    pub(super) markers: Vec<String>,
    pub(super) views: Vec<String>,
    pub(super) rows: Vec<Row>,
    /// From when to when, nanoseconds, and what was wrong.
    pub(super) alarms: Vec<(i64, Option<i64>, String)>,
    /// Why not all is here.
    pub(super) cut: Option<String>,
    /// What this run lacks.
    pub(super) note: Option<String>,
}

/// One frame.
#[derive(Debug, Default)]
pub(super) struct Row {
    pub(super) seq: u64,
    pub(super) stamp_ns: i64,
    pub(super) gap: u64,
    /// θ and its σ, radians.
    pub(super) theta: Option<(f64, f64)>,
    theta_status: String,
    /// Of each marker: `ok`, or why there is no place.
    pub(super) statuses: Vec<String>,
    /// Camera frame, metres.
    pub(super) places: Vec<Option<Point3<f64>>>,
    pub(super) sd_m: Vec<Option<f64>>,
    /// By marker and view.
    pub(super) bands: Vec<Vec<Option<Seen>>>,
}

/// A band in a view.
#[derive(Debug, Default, Clone)]
pub(super) struct Seen {
    pub(super) centre_px: [f32; 2],
    pub(super) sd_px: f32,
    /// Length of the residual.
    pub(super) residual_px: f64,
    pub(super) separation: f32,
    pub(super) outline_px: Vec<[f32; 2]>,
}

impl Run {
    /// Reads the run in a folder.
    pub(super) fn read(folder: &Path) -> Result<Self, Refusal> {
        let about =
            std::fs::read_to_string(folder.join("run.toml")).ok().and_then(|text| text.parse::<toml::Table>().ok());
        let of = |key: &str| about.as_ref()?.get(key)?.as_str().map(str::to_owned);
        let mut run = Self {
            folder: folder.to_owned(),
            changed: files_changed(folder),
            recording: of("recording"),
            rig_path: of("rig"),
            live: of("command").is_some_and(|command| command == "live"),
            stated_rate: of("fps").and_then(|fps| fps.parse().ok()),
            ..Self::default()
        };
        let (log, table) = (folder.join(LOG_FILE), folder.join(TABLE_FILE));
        if log.is_file() {
            run.log(&log)?;
        } else if table.is_file() {
            run.table(&table)?;
        } else {
            let folder = folder.display();
            return Err(Refusal::wrong(format!("{folder}: is not a run: it has no {LOG_FILE} and no {TABLE_FILE}")));
        }
        Ok(run)
    }

    pub(super) fn row(&self, number: usize) -> Result<&Row, Refusal> {
        let beyond = || Refusal::wrong(format!("row {number}: the run has {}", self.rows.len()));
        self.rows.get(number).ok_or_else(beyond)
    }

    /// `ok`, or the word of the reason why a row has no θ: that of the coil if it was not measured, else of the first
    /// marker that was not.
    pub(super) fn word(&self, row: &Row) -> String {
        if row.theta.is_some() {
            return "ok".to_owned();
        }
        let coil = self.rig.as_ref().map(|rig| rig.catheter.coil);
        let all = row.statuses.iter().zip(&self.markers).enumerate();
        let missed = all.filter(|(_, (status, _))| *status != "ok" && !status.is_empty());
        let first = missed.min_by_key(|(m, _)| Some(*m) != coil);
        match (row.theta_status.as_str(), first) {
            ("" | "marker_missing", Some((_, (status, marker)))) => format!("{marker}_{status}"),
            ("", None) => "missing".to_owned(),
            (word, _) => word.to_owned(),
        }
    }

    /// SHA-256 of the recording when it was tracked, if the run is finished.
    pub(super) fn recording_sha256(&self) -> Option<String> {
        RunSummary::read(&self.folder).ok().flatten()?.sha256.recording
    }

    /// The video, of those that were recorded with it, in which the picture of this time must be.
    pub(super) fn pictures_of(&self, stamp_ns: i64) -> Option<&Path> {
        let first_ns = |path: &Path| Some(opened(path, SourceOptions::default()).ok()?.next_frame().ok()??.stamp.ns);
        let all = self.pictures.get_or_init(|| {
            let paths = (1..).map(|n| self.folder.join(pictures_file(n))).take_while(|path| path.is_file());
            paths.filter_map(|path| Some((path.clone(), first_ns(&path)?))).collect()
        });
        all.iter().rfind(|(_, first_ns)| *first_ns <= stamp_ns).map(|(path, _)| path.as_path())
    }

    /// Where it is.
    pub(super) fn folder(&self) -> &Path {
        &self.folder
    }

    /// Whether its files are still those that were read.
    fn is_current(&self) -> bool {
        files_changed(&self.folder) == self.changed
    }

    /// Differs once it is tracked again.
    pub(super) fn version(&self) -> String {
        let since_1970 = |at: SystemTime| at.duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default().as_nanos();
        self.changed.map(|file| file.map_or(0, |(at, _)| since_1970(at)).to_string()).join("-")
    }

    fn table(&mut self, path: &Path) -> Result<(), Refusal> {
        let table = Recording::as_measured(path).map_err(Refusal::wrong)?;
        self.markers = table.markers;
        self.cut = table.cut;
        self.note = Some(format!("there is no {LOG_FILE}: outlines, residuals and the scene are not known"));
        self.rows = table
            .frames
            .into_iter()
            .map(|frame| Row {
                seq: frame.seq,
                stamp_ns: frame.stamp_ns,
                gap: frame.gap,
                theta: frame.theta_rad.map(|theta| (theta, frame.theta_sd_rad.unwrap_or(f64::NAN))),
                sd_m: frame.places.iter().map(|place| place.sd_m).collect(),
                statuses: frame.places.into_iter().map(|place| place.status).collect(),
                ..Row::default()
            })
            .collect();
        Ok(())
    }

    fn log(&mut self, path: &Path) -> Result<(), Refusal> {
        let mut decoder = MessageDecoder::default();
        let condition = records::each::<LogError>(path, |record| {
            match record {
                Record::Message { header, data } => {
                    let decoded = |topic| decoder.decoded(header.channel_id, topic, data.as_ref());
                    if let Some(estimate) = decoded(Topic::Estimate) {
                        self.estimate(&estimate);
                    } else if let Some(annotations) = decoded(Topic::Annotations) {
                        self.outlines(&annotations);
                    } else if let Some(health) = decoded(Topic::Health) {
                        self.health(&health);
                    }
                }
                Record::Attachment { header, data, .. } if header.name == RIG_ATTACHMENT => {
                    let text = std::str::from_utf8(data.as_ref()).ok();
                    self.rig = text.and_then(|text| Rig::from_toml_str(text, Path::new(RIG_ATTACHMENT)).ok());
                }
                other => decoder.learn(other),
            }
            Ok(())
        });
        let cut = condition.map_err(Refusal::wrong)?.summary();
        self.cut = if is_being_written(path) { Some("it is still being written".to_owned()) } else { cut };
        if !self.outlined && !self.rows.is_empty() {
            self.note = Some("its log has no outlines of the bands, as those for ROS 2 have none".to_owned());
        }
        Ok(())
    }

    /// A row, unless it has no time.
    fn estimate(&mut self, message: &DynamicMessage) {
        let Some(stamp_ns) = number(message, "stamp_ns") else { return };
        let markers = list(message, "markers");
        if self.rows.is_empty() {
            self.markers = markers.iter().map(|m| text(m, "name").unwrap_or_default()).collect();
            let views = markers.first().map(|m| list(m, "views")).unwrap_or_default();
            self.views = views.iter().map(|view| text(view, "name").unwrap_or_default()).collect();
        }
        let angles = inner(message, "deflection");
        let position = |m: &DynamicMessage| inner(m, "position");
        self.rows.push(Row {
            seq: whole(message, "seq"),
            stamp_ns,
            gap: whole(message, "gap"),
            theta: angles.and_then(|angles| Some((float(&angles, "theta_rad")?, float(&angles, "theta_sd_rad")?))),
            theta_status: word(message, "deflection_status").unwrap_or_default(),
            statuses: markers.iter().map(|m| word(m, "status").unwrap_or_default()).collect(),
            places: markers.iter().map(|m| Some(Point3::from(xyz(&position(m)?, "in_camera_m")?))).collect(),
            sd_m: markers.iter().map(|m| float(&position(m)?, "sd_m")).collect(),
            bands: markers
                .iter()
                .map(|m| list(m, "views").iter().map(|view| Some(seen(&inner(view, "band")?))).collect())
                .collect(),
        });
    }

    /// Outlines of the bands of the last row, in its order.
    fn outlines(&mut self, message: &DynamicMessage) {
        self.outlined = true;
        let Some(row) = self.rows.last_mut() else { return };
        let outlines = list(message, "points");
        for (seen, outline) in row.bands.iter_mut().flatten().flatten().zip(&outlines) {
            // Annotations count from the corner of the first pixel.
            let corner = |p: &DynamicMessage| Some([float(p, "x")? as f32 - 0.5, float(p, "y")? as f32 - 0.5]);
            seen.outline_px = list(outline, "points").iter().filter_map(corner).collect();
        }
    }

    fn health(&mut self, message: &DynamicMessage) {
        let alarm = |drift: &DynamicMessage| {
            Some((number(drift, "stamp_ns")?, optional_number(drift, "over_ns"), text(drift, "what")?))
        };
        // Each has all before it.
        self.alarms = list(message, "drifts").iter().filter_map(alarm).collect();
    }
}

fn seen(band: &DynamicMessage) -> Seen {
    let pair = |field: &str| {
        inner(band, field).and_then(|p| Some([float(&p, "x")?, float(&p, "y")?])).unwrap_or([f64::NAN; 2])
    };
    let covariance = floats(band, "covariance_px2");
    let entry = |i: usize| covariance.get(i).copied().unwrap_or(f64::NAN);
    let [rx, ry] = pair("residual_px");
    Seen {
        centre_px: pair("centre_px").map(|v| v as f32),
        sd_px: ((entry(0) + entry(3)) / 2.0).sqrt() as f32,
        residual_px: rx.hypot(ry),
        separation: float(band, "separation").unwrap_or(f64::NAN) as f32,
        outline_px: Vec::new(),
    }
}

/// When its files were written.
fn files_changed(folder: &Path) -> [Option<(SystemTime, u64)>; 2] {
    [LOG_FILE, TABLE_FILE].map(|name| changed(&folder.join(name)))
}
