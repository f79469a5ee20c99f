//! Converts a log to a table of its frames: CSV, byte for byte as written by the run, Parquet, or MAT 5. Currents are a
//! separate table beside it; MAT has both in one file.

use super::columns::{Cell, FileKind, Finished, Rows, names, row, write_mat};
use super::{ConvertError, Converted, Message, Target, each_message, left_out};
use crate::log::ros2::PROFILE;
use crate::log::schema::messages::{Current, Estimate};
use crate::log::schema::{OPTIONS_ATTACHMENT, Topic};
use crate::log::{attached, profile, restarted, typed};
use crate::plural::plural;
use crate::sink::{OutputFrame, RosLog};
use std::cmp::Reverse;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// What is left out of each topic, and why; empty for those in the table.
const NOT_IN_A_TABLE: [(Topic, &str); 8] = [
    (Topic::Scene, "is drawn from the places"),
    (Topic::Annotations, "outlines of bands in the picture"),
    (Topic::Calibration, "is in rig.toml, attached to the log"),
    (Topic::Transform, "is in rig.toml, attached to the log"),
    (Topic::Health, "totals, and drift alarms"),
    (Topic::Windows, "pictures"),
    (Topic::Image, "pictures"),
    (Topic::Current, "cannot be understood"),
];
/// What is left out of a frame.
const NOT_OF_A_FRAME: &str =
    "of each frame: covariances, what each view saw, how often each band was missed, the host's times";

/// Of a log of profile `ros2`.
const OF_ROS: &str = "topics of ROS 2: copies of what is in the table, besides pictures and the camera";

/// The table of currents beside `out`.
fn beside(out: &Path) -> PathBuf {
    let stem = out.file_stem().unwrap_or_default().to_string_lossy();
    let ending = out.extension().map_or(String::new(), |ending| format!(".{}", ending.to_string_lossy()));
    out.with_file_name(format!("{stem}-currents{ending}"))
}

/// What the columns of the tables are, as far as the first rows do not tell.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
struct Layout {
    /// Whether there is a column for the tick.
    ticks: bool,
    /// Coils of the table of currents; those of the first sample if `None`.
    coils: Option<usize>,
}

pub(super) fn convert(
    path: &Path,
    target: Target,
    frame: Option<OutputFrame>,
    out: &Path,
) -> Result<Converted, ConvertError> {
    let options = attached(path, OPTIONS_ATTACHMENT)?.and_then(|text| text.parse::<toml::Table>().ok());
    let options = options.unwrap_or_default();
    let of_run = match options.get("frame").and_then(toml::Value::as_str) {
        Some("camera") => OutputFrame::Camera,
        _ => OutputFrame::Base,
    };
    let mut layout = Layout { ticks: options.contains_key("tick_led"), coils: None };
    // The whole log may show another layout than its beginning: then once more.
    loop {
        match attempt(path, target, frame.unwrap_or(of_run), out, layout)? {
            Attempt::Done(converted) => return Ok(converted),
            Attempt::Again(found) => layout = found,
        }
    }
}

/// Result of a conversion with some layout.
enum Attempt {
    Done(Converted),
    /// The log has this layout.
    Again(Layout),
}

/// Converts with this layout, unless the log has another.
fn attempt(
    path: &Path,
    target: Target,
    frame: OutputFrame,
    out: &Path,
    layout: Layout,
) -> Result<Attempt, ConvertError> {
    let mut tables = Tables::new(path, target, frame, out, layout);
    let take = |message: &Message<'_>| {
        let Some(decoded) = &message.decoded else { return Ok(false) };
        if message.topic == Topic::Estimate.name() {
            typed::estimate(decoded).map_or(Ok(false), |estimate| tables.add_frame(&estimate).map(|()| true))
        } else if message.topic == Topic::Current.name() {
            typed::current(decoded).map_or(Ok(false), |current| tables.add_current(&current))
        } else {
            // The table has θ.
            Ok(message.topic == Topic::Deflection.name())
        }
    };
    let (left, cut) = each_message(path, take, |_| Ok(()))?;
    let found = tables.layout_found();
    if found != layout {
        return Ok(Attempt::Again(found));
    }
    let odd_samples = found.coils;
    let converted = tables.finish()?;
    let mut reasons = vec![NOT_OF_A_FRAME.to_owned()];
    let of_ros = profile(path)? == PROFILE;
    if of_ros {
        reasons.push(OF_ROS.to_owned());
    }
    let listed = |topic: &str| !of_ros || Topic::ALL.iter().any(|of| of.name() == topic && RosLog::keeps(*of));
    for (topic, messages) in left.into_iter().filter(|(topic, _)| listed(topic)) {
        let known = NOT_IN_A_TABLE.iter().find(|(of, _)| of.name() == topic).map(|(_, why)| *why);
        let estimate = (topic == Topic::Estimate.name()).then_some("cannot be understood");
        let unusual = odd_samples.filter(|_| topic == Topic::Current.name());
        let unusual = unusual.map(|coils| format!("not of {}, as most are", plural(coils as u64, "coil")));
        let why = unusual.as_deref().or(known).or(estimate).unwrap_or("is not a table of frames");
        reasons.push(left_out(&topic, messages, why));
    }
    Ok(Attempt::Done(Converted { cut, left_out: reasons, ..converted }))
}

/// The tables of a log while they are written, with what they are found to need.
struct Tables<'a> {
    path: &'a Path,
    out: &'a Path,
    kind: FileKind,
    frame: OutputFrame,
    layout: Layout,
    frames: Option<Rows>,
    currents: Option<Rows>,
    converted: Converted,
    has_ticks: bool,
    /// Samples of currents by their number of coils.
    samples: BTreeMap<usize, u64>,
    /// Names of the markers, in the order of their columns.
    markers: Vec<String>,
    /// Number of the last frame.
    last: Option<u64>,
    /// The first frame whose number does not rise, and the number before.
    restart: Option<(u64, u64)>,
}

impl<'a> Tables<'a> {
    fn new(path: &'a Path, target: Target, frame: OutputFrame, out: &'a Path, layout: Layout) -> Self {
        let kind = match target {
            Target::Parquet => FileKind::Parquet,
            Target::Mat => FileKind::Mat,
            Target::Csv | Target::Ros2 => FileKind::Csv,
        };
        Self {
            path,
            out,
            kind,
            frame,
            layout,
            frames: None,
            currents: None,
            converted: Converted::default(),
            has_ticks: layout.ticks,
            samples: BTreeMap::new(),
            markers: Vec::new(),
            last: None,
            restart: None,
        }
    }

    fn wrong(&self, reason: String) -> ConvertError {
        ConvertError::Content { path: self.path.to_owned(), reason }
    }

    fn add_frame(&mut self, estimate: &Estimate) -> Result<(), ConvertError> {
        self.has_ticks |= estimate.tick.is_some();
        let before = self.last.replace(estimate.seq).filter(|before| estimate.seq <= *before);
        self.restart = self.restart.or(before.map(|before| (estimate.seq, before)));
        let Some(row) = row(estimate, self.frame, self.layout.ticks) else {
            let why = "has no places in the base frame: its rig has none; convert with --frame camera";
            return Err(self.wrong(why.to_owned()));
        };
        let rows = match &mut self.frames {
            Some(rows) => rows,
            none => none.insert(Rows::begin(self.kind, self.out, names(estimate, self.layout.ticks), &row)?),
        };
        let names = estimate.markers.iter().map(|marker| &marker.name);
        if self.markers.is_empty() {
            self.markers = names.clone().cloned().collect();
        }
        if row.len() != rows.width() || !names.eq(&self.markers) {
            return Err(self.wrong(format!("frame {} has other markers than those before", estimate.seq)));
        }
        self.converted.frames += 1;
        rows.add(row)
    }

    /// Returns whether the sample has as many coils as the table.
    fn add_current(&mut self, current: &Current) -> Result<bool, ConvertError> {
        *self.samples.entry(current.current_a.len()).or_default() += 1;
        let row = current_row(current);
        let coils = self.layout.coils.unwrap_or(row.len() - 1);
        let rows = match &mut self.currents {
            Some(rows) => rows,
            None if coils != row.len() - 1 => return Ok(false),
            none => none.insert(Rows::begin(self.kind, &beside(self.out), current_names(self.kind, coils), &row)?),
        };
        if row.len() != rows.width() {
            return Ok(false);
        }
        self.converted.currents += 1;
        rows.add(row).map(|()| true)
    }

    /// The layout that the log read so far needs.
    fn layout_found(&self) -> Layout {
        // Of several, the number of coils that most samples have; the smaller of two.
        let usual = self.samples.iter().max_by_key(|(coils, count)| (**count, Reverse(**coils)));
        let several = self.samples.len() > 1;
        Layout { ticks: self.has_ticks, coils: usual.map(|(coils, _)| *coils).filter(|_| several) }
    }

    /// Completes the files.
    fn finish(self) -> Result<Converted, ConvertError> {
        let no_frame = self.wrong("has no frame".to_owned());
        let Self { path, out, frames, currents, mut converted, restart, .. } = self;
        let frames = frames.ok_or(no_frame)?;
        if let Some((seq, before)) = restart {
            tracing::warn!("{}: {}", path.display(), restarted(seq, before));
        }
        let tables = [(out.to_owned(), Some(frames)), (beside(out), currents)];
        let finished = tables.into_iter().filter_map(|(place, rows)| Some(rows?.finish().map(|rows| (place, rows))));
        let mut columns = Vec::new();
        // None is put in its place before all are complete.
        for (place, rows) in finished.collect::<Result<Vec<_>, _>>()? {
            match rows {
                Finished::Beside(new) => {
                    new.put_in_place().map_err(|source| ConvertError::Write { path: place.clone(), source })?;
                    converted.files.push(place);
                }
                Finished::Columns(more) => columns.extend(more),
            }
        }
        if !columns.is_empty() {
            write_mat(out, &columns)?;
            converted.files.push(out.to_owned());
        }
        Ok(converted)
    }
}

/// `host_ns` and one column per coil, as read by `catoptra live --currents` and `catoptra identify`.
fn current_names(kind: FileKind, coils: usize) -> Vec<String> {
    // If one file has them beside the frames, the names say what they belong to.
    let before = if matches!(kind, FileKind::Mat) { "current_" } else { "" };
    let coil = |n| format!("{before}coil_{n}");
    std::iter::once(format!("{before}host_ns")).chain((1..=coils).map(coil)).collect()
}

fn current_row(current: &Current) -> Vec<Cell> {
    let amperes = current.current_a.iter().map(|ampere| Cell::Real(Some(*ampere), None));
    std::iter::once(Cell::Whole(current.host_ns)).chain(amperes).collect()
}
