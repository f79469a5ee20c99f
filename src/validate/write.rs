//! Results as files: a table and a JSON with one entry a run, Table II, and the points of a run.

use super::{Run, Validation};
use crate::source::times::seconds;
use serde::Serialize;
use std::fmt::Write as _;
use std::path::Path;

const MM_PER_M: f64 = 1e3;
/// The name of every path that `catheter follow` writes.
const FOLLOWED: &str = "desired.csv";

/// One run, in the units of the table: mm, degrees, ms. Unknown values are absent.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct Row {
    /// The run's file.
    pub file: String,
    /// The marker that followed the path.
    pub marker: String,
    /// How long each command is held.
    pub pause_ms: f64,
    /// 1 over the period.
    pub frequency_hz: f64,
    /// Camera time of the first command.
    pub start_s: f64,
    /// `given`, `ticks`, `currents` or `search`.
    pub start_from: &'static str,
    /// `averaged` or `interpolated`.
    pub points_are: &'static str,
    /// Camera frames while the commands were given.
    pub frames: usize,
    /// Of these, without the marker.
    pub frames_missed: usize,
    /// Of these, vetoed by a person.
    pub frames_vetoed: usize,
    /// Lost before they were tracked.
    pub frames_lost: u64,
    /// Commands that count.
    pub points: usize,
    /// Of these, without a point.
    pub points_left_out: usize,
    /// Error after rigid alignment (Table II).
    pub rms_aligned_mm: f64,
    /// Error as observed.
    pub rms_unaligned_mm: f64,
    /// The alignment's rotation, about this axis.
    pub rotation_deg: f64,
    /// Its axis, x.
    pub axis_x: Option<f64>,
    /// Its axis, y.
    pub axis_y: Option<f64>,
    /// Its axis, z.
    pub axis_z: Option<f64>,
    /// Mean of the desired points minus mean of the observed ones.
    pub offset_x_mm: f64,
    /// The same, y.
    pub offset_y_mm: f64,
    /// The same, z.
    pub offset_z_mm: f64,
    /// Spread of x, observed over desired.
    pub gain_x: Option<f64>,
    /// Spread of y.
    pub gain_y: Option<f64>,
    /// Spread of z.
    pub gain_z: Option<f64>,
    /// Eq. 8, or the ratio of sizes.
    pub magnitude_db: Option<f64>,
    /// Its σ: the larger of what the tracker's noise gives and of what does not repeat.
    pub magnitude_sd_db: Option<f64>,
    /// `circle_radius` or `rms_size`.
    pub magnitude_of: Option<&'static str>,
    /// Size observed.
    pub observed_size_mm: Option<f64>,
    /// Size desired.
    pub desired_size_mm: Option<f64>,
    /// Distances of the observed points from their circle.
    pub circle_rms_mm: Option<f64>,
    /// Distances of the observed points from their plane.
    pub plane_rms_mm: Option<f64>,
    /// Eq. 9: positive when late.
    pub lag_ms: Option<f64>,
    /// Eq. 10, negative when late, unwrapped.
    pub phase_deg: Option<f64>,
    /// Its σ: the larger of what the tracker's noise gives and of what does not repeat.
    pub phase_sd_deg: Option<f64>,
    /// Correlation at that lag, or at the start that was searched for.
    pub correlation: Option<f64>,
    /// Difference of the last period from the one before, relative to its size.
    pub period_change: Option<f64>,
    /// Magnitude of the last period alone, where the path is a circle.
    pub last_period_db: Option<f64>,
    /// Change of the phase over a period, by a line through all periods.
    pub phase_drift_deg: Option<f64>,
    /// Its σ, by the tracker's noise or by slow errors.
    pub phase_drift_sd_deg: Option<f64>,
    /// Largest change of the phase from one period to the next.
    pub phase_step_deg: Option<f64>,
    /// Largest distance between the middles of the motion in two periods.
    pub shift_mm: Option<f64>,
    /// Angle between observed and desired direction of the coil.
    pub tangent_rms_deg: Option<f64>,
    /// Distance of frames from the mean of their pause.
    pub scatter_mm: Option<f64>,
    /// The tracker's σ of a coordinate.
    pub sd_mm: Option<f64>,
    /// Notes for the reader.
    pub notes: String,
}

impl Row {
    /// Of a run.
    pub(crate) fn of(run: &Run) -> Self {
        let (angle, axis) = run.alignment.angle_axis();
        let pairs: Vec<_> = run.steps.iter().filter_map(|s| Some(s.desired - s.observed?)).collect();
        let offset = pairs.iter().sum::<nalgebra::Vector3<f64>>() / pairs.len().max(1) as f64;
        let mm = |m: f64| m * MM_PER_M;
        let changes = run.periods.as_ref().and_then(|periods| periods.changes);
        Self {
            file: run.file.display().to_string(),
            marker: run.marker.clone(),
            pause_ms: run.pause_s * 1e3,
            frequency_hz: run.frequency_hz,
            start_s: seconds(run.start_ns),
            start_from: run.start_from.word(),
            points_are: if run.interpolated { "interpolated" } else { "averaged" },
            frames: run.frames,
            frames_missed: run.frames_missed,
            frames_vetoed: run.frames_vetoed,
            frames_lost: run.frames_lost,
            points: run.steps.len(),
            points_left_out: run.left_out,
            rms_aligned_mm: mm(run.alignment.rms_m),
            rms_unaligned_mm: mm(run.rms_unaligned_m),
            rotation_deg: angle.to_degrees(),
            axis_x: axis.map(|axis| axis.x),
            axis_y: axis.map(|axis| axis.y),
            axis_z: axis.map(|axis| axis.z),
            offset_x_mm: mm(offset.x),
            offset_y_mm: mm(offset.y),
            offset_z_mm: mm(offset.z),
            gain_x: run.gain[0],
            gain_y: run.gain[1],
            gain_z: run.gain[2],
            magnitude_db: run.magnitude.map(|m| m.db),
            magnitude_sd_db: run.magnitude_sd().map(|sd| 20.0 * (1.0 + sd).log10()),
            magnitude_of: run.magnitude.map(|m| m.of.word()),
            observed_size_mm: run.magnitude.map(|m| mm(m.observed_m)),
            desired_size_mm: run.magnitude.map(|m| mm(m.desired_m)),
            circle_rms_mm: run.circle.map(|circle| mm(circle.rms_m)),
            plane_rms_mm: run.plane.map(|plane| mm(plane.rms_m)),
            lag_ms: run.lag.map(|lag| lag.points * run.pause_s * 1e3),
            phase_deg: run.phase_deg,
            phase_sd_deg: run.phase_sd().map(f64::to_degrees),
            correlation: run.lag.map(|lag| lag.correlation).or(run.start_correlation),
            period_change: run.settling.map(|settling| settling.change_m / settling.size_m),
            last_period_db: run.settling.and_then(|settling| settling.last_db),
            phase_drift_deg: changes.map(|changes| changes.drift_deg),
            phase_drift_sd_deg: changes.and_then(|changes| changes.drift_sd_deg),
            phase_step_deg: changes.map(|changes| changes.step.by),
            shift_mm: changes.map(|changes| mm(changes.shift.by)),
            tangent_rms_deg: run.tangent_rms_rad.map(f64::to_degrees),
            scatter_mm: run.scatter_m.map(mm),
            sd_mm: run.sd_m.map(mm),
            notes: run.notes.join("; "),
        }
    }
}

/// Content of `validation.json`.
#[derive(Debug, Serialize)]
struct Document {
    version: &'static str,
    path: PathPart,
    skipped_periods: usize,
    runs: Vec<Row>,
}

#[derive(Debug, Serialize)]
struct PathPart {
    file: String,
    points_per_period: usize,
    periods: usize,
    circle_radius_mm: Option<f64>,
    note: Option<String>,
    plane_normal: [f64; 3],
    plane_rms_mm: f64,
}

impl Validation {
    /// Name of the path for tables: its file name without extension.
    pub(crate) fn name(&self) -> String {
        let file = &self.path.file;
        // `catheter follow` calls all its paths so; their folders tell them apart.
        let named = if file.ends_with(FOLLOWED) { file.parent().and_then(Path::file_name) } else { None };
        named.or(file.file_stem()).map_or_else(|| "path".to_owned(), |name| name.to_string_lossy().into_owned())
    }

    /// `validation.json`.
    ///
    /// # Errors
    /// When a number cannot be represented in JSON.
    pub(crate) fn json(&self) -> serde_json::Result<String> {
        let path = &self.path;
        let document = Document {
            version: env!("CARGO_PKG_VERSION"),
            path: PathPart {
                file: path.file.display().to_string(),
                points_per_period: path.points.len(),
                periods: path.periods,
                circle_radius_mm: path.circle.map(|circle| circle.radius_m * MM_PER_M),
                note: path.note(),
                plane_normal: path.plane.normal.into(),
                plane_rms_mm: path.plane.rms_m * MM_PER_M,
            },
            skipped_periods: self.options.skip,
            runs: self.runs.iter().map(Row::of).collect(),
        };
        serde_json::to_string_pretty(&document).map(|text| text + "\n")
    }

    /// `validation.csv`: one row per run.
    ///
    /// # Errors
    /// None are known: it is written to memory.
    pub(crate) fn csv(&self) -> Result<String, csv::Error> {
        let mut writer = csv::WriterBuilder::new().terminator(csv::Terminator::CRLF).from_writer(Vec::new());
        for run in &self.runs {
            writer.serialize(Row::of(run))?;
        }
        let bytes = writer.into_inner().map_err(|error| csv::Error::from(error.into_error()))?;
        Ok(String::from_utf8_lossy(&bytes).into_owned())
    }

    /// Errors over pause times in the layout of Table II of the paper, as Markdown; further rows show what that table
    /// hides.
    pub(crate) fn table(&self) -> String {
        let rows: Vec<Row> = self.runs.iter().map(Row::of).collect();
        let line = |name: &str, cell: &dyn Fn(&Row) -> String| {
            let cells: Vec<String> = rows.iter().map(cell).collect();
            format!("| {name} | {} |\n", cells.join(" | "))
        };
        let or_empty =
            |value: Option<f64>, digits: usize| value.map_or(String::new(), |value| format!("{value:.digits$}"));
        let name = self.name();
        let mut text = line("Pause time (ms)", &|row| format!("{}", (row.pause_ms * 1e3).round() / 1e3));
        let _ = writeln!(text, "|---|{}", "---|".repeat(rows.len()));
        text += &line(&format!("{name} RMSE (mm)"), &|row| format!("{:.2}", row.rms_aligned_mm));
        text += &line("not aligned (mm)", &|row| format!("{:.2}", row.rms_unaligned_mm));
        text += &line("rotation (°)", &|row| format!("{:.1}", row.rotation_deg));
        text += &line("frequency (Hz)", &|row| format!("{:.4}", row.frequency_hz));
        text += &line("magnitude (dB)", &|row| or_empty(row.magnitude_db, 2));
        text += &line("phase (°)", &|row| or_empty(row.phase_deg, 1));
        text += &line("points are", &|row| row.points_are.to_owned());
        text += &line("points left out", &|row| format!("{} of {}", row.points_left_out, row.points));
        text
    }
}

impl Run {
    /// The run's points: one row per command, mm; unknown values are empty.
    pub(crate) fn points_csv(&self) -> String {
        let axes = ["x", "y", "z"];
        let names = ["desired", "observed", "aligned"].map(|of| axes.map(|axis| format!("{of}_{axis}_mm")).join(","));
        let mut text = format!("k,t_s,{},error_mm,error_unaligned_mm,frames\r\n", names.join(","));
        let point = |point: Option<nalgebra::Point3<f64>>| match point {
            Some(p) => format!("{:.6},{:.6},{:.6}", p.x * MM_PER_M, p.y * MM_PER_M, p.z * MM_PER_M),
            None => ",,".to_owned(),
        };
        let error = |to: Option<nalgebra::Point3<f64>>, from| match to {
            Some(to) => format!("{:.6}", (to - from as nalgebra::Point3<f64>).norm() * MM_PER_M),
            None => String::new(),
        };
        for s in &self.steps {
            // Writing into text cannot fail.
            let _ = write!(
                text,
                "{},{:.9},{},{},{},{},{},{}\r\n",
                s.k,
                s.t_s,
                point(Some(s.desired)),
                point(s.observed),
                point(s.aligned),
                error(s.aligned, s.desired),
                error(s.observed, s.desired),
                s.frames
            );
        }
        text
    }
}
