//! The table: one row per camera frame, RFC 4180 (comma, CRLF, quotes only where needed), with a fixed header.
//!
//! | column | meaning |
//! |---|---|
//! | `seq` | number of the frame among those received, from 0 |
//! | `t_s` | camera time, seconds: `stamp_ns` as an exact decimal |
//! | `stamp_ns` | camera time, nanoseconds since the clock's zero |
//! | `theta_deg`, `theta_sd_deg` | deflection θ and its standard deviation |
//! | `polar_deg`, `azimuth_deg` | angle between tangent and the base frame's z; direction of the deflection around z |
//! | `NAME_x_mm`, `NAME_y_mm`, `NAME_z_mm` | position of marker NAME: middle of the band on the tube's centre line |
//! | `NAME_sd_mm` | standard deviation of one coordinate, on average over the three |
//! | `NAME_status` | `ok`, or why there is no position: [`Miss::word`](crate::estimate::Miss::word) |
//! | `tan_x`, `tan_y`, `tan_z` | unit direction of the coil, base to tip |
//! | `tan_sd_deg` | its standard deviation, on average over the two directions across |
//! | `gap` | camera frames lost before this one |
//! | `tick` | only where a lamp is watched: its count of commands, modulo 2 |
//!
//! The five columns of a marker are repeated for every marker of the rig, in its order. Positions and the tangent are
//! in the requested [`OutputFrame`]; θ, polar and azimuth are always in the base frame. An unknown value is an empty
//! cell. mm are given to 1e-6, degrees to 1e-6, the unit vector to 1e-7: finer than the measurement, so nothing is
//! lost.
//!
//! Every row is passed to the system before the next frame is processed: a killed run keeps all rows written. When the
//! disk is full the table ends with its last complete row.

use super::{OutputFrame, Sink, SinkError, same_error, settle};
use crate::digits::fixed;
use crate::estimate::{Estimate, MarkerEstimate};
use crate::log::schema::table;
use crate::rig::Rig;
use crate::source::Picture;
use crate::source::times::decimal_seconds;
use crate::tally::Tally;
use csv::{ErrorKind, Terminator, Writer, WriterBuilder};
use nalgebra::Isometry3;
use std::fs::File;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

const MM_PER_M: f64 = 1e3;

/// Writes the table.
#[derive(Debug)]
pub struct CsvSink {
    path: PathBuf,
    writer: Writer<WholeRows>,
    output_from_camera: Isometry3<f64>,
    views: Vec<String>,
    ticks: bool,
}

impl CsvSink {
    /// Creates the file (an existing one is replaced) and writes its header.
    ///
    /// # Errors
    /// [`SinkError::NoBaseFrame`] when `frame` is the base frame and the rig has none; [`SinkError::Io`] when the file
    /// cannot be created or written.
    pub fn create(path: &Path, rig: &Rig, frame: OutputFrame) -> Result<Self, SinkError> {
        Self::onto(path, rig, frame, false, || File::create(path).map(Place::File))
    }

    /// As [`CsvSink::create`], with a column for the tick.
    ///
    /// # Errors
    /// As [`CsvSink::create`].
    pub fn with_ticks(path: &Path, rig: &Rig, frame: OutputFrame) -> Result<Self, SinkError> {
        Self::onto(path, rig, frame, true, || File::create(path).map(Place::File))
    }

    /// The table on standard output, with a column for the tick or without.
    ///
    /// # Errors
    /// As [`CsvSink::create`].
    pub fn on_stdout(rig: &Rig, frame: OutputFrame, ticks: bool) -> Result<Self, SinkError> {
        Self::onto(Path::new("standard output"), rig, frame, ticks, || Ok(Place::Stdout(io::stdout())))
    }

    fn onto(
        path: &Path,
        rig: &Rig,
        frame: OutputFrame,
        ticks: bool,
        open: impl FnOnce() -> io::Result<Place>,
    ) -> Result<Self, SinkError> {
        let output_from_camera =
            frame.output_from_camera(rig).ok_or_else(|| SinkError::NoBaseFrame { path: path.to_owned() })?;
        let place = open().map_err(|source| SinkError::io(path, source))?;
        let mut sink = Self {
            path: path.to_owned(),
            writer: WriterBuilder::new().terminator(Terminator::CRLF).from_writer(WholeRows::new(place)),
            output_from_camera,
            views: rig.views.iter().map(|view| view.name.clone()).collect(),
            ticks,
        };
        sink.record(&table::header(rig.markers.iter().map(|marker| marker.name.as_str()), ticks))?;
        Ok(sink)
    }

    fn record(&mut self, cells: &[String]) -> Result<(), SinkError> {
        let written = self.writer.write_record(cells).map_err(system_error).and_then(|()| self.writer.flush());
        written.map_err(|source| SinkError::io(&self.path, source))
    }
}

impl Sink for CsvSink {
    fn write(&mut self, estimate: &Estimate, _: Option<&Picture>) -> Result<(), SinkError> {
        let views: Vec<&str> = self.views.iter().map(String::as_str).collect();
        let mut cells = row(estimate, &self.output_from_camera, &views);
        if self.ticks {
            cells.push(estimate.tick.map_or_else(String::new, |tick| tick.count.to_string()));
        }
        self.record(&cells)
    }

    fn finish(&mut self, _: &Tally) -> Result<(), SinkError> {
        let settled = self.writer.flush().and_then(|()| match &self.writer.get_ref().place {
            Place::File(file) => settle(file),
            Place::Stdout(_) => Ok(()),
        });
        settled.map_err(|source| SinkError::io(&self.path, source))
    }
}

/// A file of rows, flushed after each: none is left half written, and none is retried after a failure.
#[derive(Debug)]
struct WholeRows {
    place: Place,
    written: u64,
    complete: u64,
    failure: Option<io::Error>,
}

impl WholeRows {
    fn new(place: Place) -> Self {
        Self { place, written: 0, complete: 0, failure: None }
    }
}

/// Where rows go.
#[derive(Debug)]
enum Place {
    File(File),
    Stdout(io::Stdout),
}

impl Place {
    fn writer(&mut self) -> &mut dyn Write {
        match self {
            Self::File(file) => file,
            Self::Stdout(stdout) => stdout,
        }
    }
}

impl Write for WholeRows {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        if let Some(failure) = &self.failure {
            return Err(same_error(failure));
        }
        match self.place.writer().write_all(bytes) {
            Ok(()) => {
                self.written += bytes.len() as u64;
                Ok(bytes.len())
            }
            Err(error) => {
                // If this also fails (a pipe, a lost disk) there is nothing to clean up.
                if let Place::File(file) = &self.place {
                    let _ = file.set_len(self.complete);
                }
                self.failure = Some(same_error(&error));
                Err(error)
            }
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        self.complete = self.written;
        self.place.writer().flush()
    }
}

/// The system's error, without the wrapper that hides it.
fn system_error(error: csv::Error) -> io::Error {
    match error.into_kind() {
        ErrorKind::Io(source) => source,
        ErrorKind::UnequalLengths { expected_len, len, .. } => {
            io::Error::other(format!("the frame has {len} cells, the rig's markers need {expected_len}"))
        }
        other => io::Error::other(format!("{other:?}")),
    }
}

fn row(estimate: &Estimate, output_from_camera: &Isometry3<f64>, views: &[&str]) -> Vec<String> {
    let mut cells = vec![estimate.seq.to_string(), decimal_seconds(estimate.stamp.ns), estimate.stamp.ns.to_string()];
    match &estimate.deflection {
        Ok(d) => {
            let angles = [d.theta_rad, d.theta_sd_rad, d.polar_rad, d.azimuth_rad];
            cells.extend(angles.map(|angle| fixed(angle.to_degrees(), 6)));
        }
        Err(_) => cells.extend(empty::<4>()),
    }
    for marker in &estimate.markers {
        cells.extend(marker_cells(marker, output_from_camera, views));
    }
    match &estimate.tangent {
        Ok(tangent) => {
            let direction = output_from_camera * tangent.direction;
            cells.extend([direction.x, direction.y, direction.z].map(|v| fixed(v, 7)));
            cells.push(fixed(tangent.sd_rad().to_degrees(), 6));
        }
        Err(_) => cells.extend(empty::<4>()),
    }
    cells.push(estimate.gap.to_string());
    cells
}

fn marker_cells(marker: &MarkerEstimate, output_from_camera: &Isometry3<f64>, views: &[&str]) -> [String; 5] {
    match &marker.position {
        Ok(position) => {
            let point = output_from_camera * position.point;
            let [x, y, z, sd] = [point.x, point.y, point.z, position.sd_m()].map(|m| fixed(m * MM_PER_M, 6));
            [x, y, z, sd, "ok".to_owned()]
        }
        Err(miss) => {
            let [x, y, z, sd] = empty();
            [x, y, z, sd, miss.word(views)]
        }
    }
}

fn empty<const N: usize>() -> [String; N] {
    std::array::from_fn(|_| String::new())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimate::{Deflection, Miss, Position, Tangent};
    use crate::testing::fixture;
    use nalgebra::{Matrix3, Point3, UnitQuaternion, Vector3};

    const FIRST_LINE: &str = "seq,t_s,stamp_ns,theta_deg,theta_sd_deg,polar_deg,azimuth_deg,\
        base_x_mm,base_y_mm,base_z_mm,base_sd_mm,base_status,coil_x_mm,coil_y_mm,coil_z_mm,coil_sd_mm,coil_status,\
        tip_x_mm,tip_y_mm,tip_z_mm,tip_sd_mm,tip_status,tan_x,tan_y,tan_z,tan_sd_deg,gap\r\n";

    /// A rig whose base frame is turned by 90° around z: x in the base frame is y in the camera frame.
    fn turned() -> Rig {
        let mut rig = fixture::rig();
        let quarter = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), -std::f64::consts::FRAC_PI_2);
        rig.base.as_mut().unwrap().base_from_camera = Isometry3::from_parts([0.0, 0.0, -1.0].into(), quarter);
        rig
    }

    fn plain(seq: u64, stamp_ns: i64) -> Estimate {
        let mut estimate = fixture::complete(seq, stamp_ns);
        for (k, marker) in estimate.markers.iter_mut().enumerate() {
            let covariance = Matrix3::from_diagonal(&Vector3::new(1e-10, 4e-10, 25e-10)); // mean 1e-9 m²
            marker.position = Ok(Position {
                point: Point3::new(0.001, 0.0025 * k as f64, 1.0 + 0.01 * k as f64),
                covariance,
                bound: covariance,
            });
        }
        let across = Matrix3::from_diagonal(&Vector3::new(4e-6, 0.0, 4e-6)); // sd 2 mrad
        estimate.tangent = Ok(Tangent { direction: Vector3::y(), covariance: across, bound: across });
        estimate.deflection =
            Ok(Deflection { theta_rad: 0.5, theta_sd_rad: 0.002, polar_rad: 1.0, azimuth_rad: -0.25 });
        estimate
    }

    fn table(rig: &Rig, frame: OutputFrame, estimates: &[Estimate]) -> String {
        let file = tempfile::NamedTempFile::new().unwrap();
        let mut sink = CsvSink::create(file.path(), rig, frame).unwrap();
        for estimate in estimates {
            sink.write(estimate, None).unwrap();
        }
        sink.finish(&Tally::default()).unwrap();
        std::fs::read_to_string(file.path()).unwrap()
    }

    #[test]
    fn a_complete_frame_in_the_base_frame_to_the_letter() {
        let found = table(&turned(), OutputFrame::Base, &[plain(0, 1_016_666_667)]);
        let expected = "0,1.016666667,1016666667,28.647890,0.114592,57.295780,-14.323945,\
            0.000000,-1.000000,0.000000,0.031623,ok,2.500000,-1.000000,10.000000,0.031623,ok,\
            5.000000,-1.000000,20.000000,0.031623,ok,1.0000000,0.0000000,0.0000000,0.114592,0\r\n";
        assert_eq!(found, format!("{FIRST_LINE}{expected}"));
    }

    #[test]
    fn the_same_in_the_camera_frame() {
        let found = table(&turned(), OutputFrame::Camera, &[plain(0, 0)]);
        let expected = "0,0.000000000,0,28.647890,0.114592,57.295780,-14.323945,\
            1.000000,0.000000,1000.000000,0.031623,ok,1.000000,2.500000,1010.000000,0.031623,ok,\
            1.000000,5.000000,1020.000000,0.031623,ok,0.0000000,1.0000000,0.0000000,0.114592,0\r\n";
        assert_eq!(found, format!("{FIRST_LINE}{expected}"));
    }

    #[test]
    fn what_is_missing_is_empty_and_says_why() {
        let mut estimate = plain(7, -33_000_001);
        estimate.gap = 2;
        estimate.markers[0].position = Err(Miss::RaysDiverge { distance_m: 0.01 });
        estimate.markers[1].position = Err(Miss::Ambiguous { candidates: 2 });
        estimate.markers[2].position = Err(Miss::NotSeen { view: 1 });
        estimate.tangent = Err(Miss::MarkerMissing);
        estimate.deflection = Err(Miss::MarkerMissing);
        let found = table(&turned(), OutputFrame::Base, &[estimate]);
        let expected = "7,-0.033000001,-33000001,,,,,,,,,rays_diverge,,,,,ambiguous,,,,,not_seen_mirror,,,,,2\r\n";
        assert_eq!(found, format!("{FIRST_LINE}{expected}"));
    }

    #[test]
    fn a_deflection_missed_with_the_tangent_known() {
        let mut estimate = plain(7, 5);
        estimate.deflection = Err(Miss::NoBaseFrame);
        let found = table(&turned(), OutputFrame::Camera, &[estimate]);
        assert!(found.contains("\r\n7,0.000000005,5,,,,,1.000000,"), "{found}");
        assert!(found.ends_with(",0.0000000,1.0000000,0.0000000,0.114592,0\r\n"), "{found}");
    }

    #[test]
    fn any_list_of_markers_and_names_that_need_quotes() {
        let mut rig = turned();
        rig.markers.truncate(1);
        rig.markers[0].name = "band \"1\", red".to_owned();
        let mut estimate = plain(0, 0);
        estimate.markers.truncate(1);
        let found = table(&rig, OutputFrame::Base, &[estimate]);
        let lines: Vec<&str> = found.split("\r\n").collect();
        assert!(lines[0].contains(",\"band \"\"1\"\", red_x_mm\","), "{}", lines[0]);
        assert!(
            lines[1].ends_with(",0.000000,-1.000000,0.000000,0.031623,ok,1.0000000,0.0000000,0.0000000,0.114592,0")
        );
    }

    #[test]
    fn time_stamps_are_exact_where_floats_are_not() {
        for (ns, text) in [
            (0, "0.000000000"),
            (1, "0.000000001"),
            (-1, "-0.000000001"),
            (1_700_000_000_123_456_789, "1700000000.123456789"),
            (i64::MAX, "9223372036.854775807"),
            (i64::MIN, "-9223372036.854775808"),
        ] {
            assert_eq!(decimal_seconds(ns), text);
        }
    }

    #[test]
    fn zero_has_no_sign() {
        assert_eq!(fixed(-1e-9, 6), "0.000000");
        assert_eq!(fixed(-0.0, 6), "0.000000");
        assert_eq!(fixed(-6e-7, 6), "-0.000001");
    }

    #[test]
    fn a_frame_with_other_markers_than_the_rig_is_refused() {
        let file = tempfile::NamedTempFile::new().unwrap();
        let mut sink = CsvSink::create(file.path(), &turned(), OutputFrame::Base).unwrap();
        let mut estimate = plain(0, 0);
        estimate.markers.truncate(2);
        let error = sink.write(&estimate, None).unwrap_err().to_string();
        assert!(error.contains("the frame has 22 cells, the rig's markers need 27"), "{error}");
    }

    #[test]
    fn the_base_frame_of_a_rig_without_one_is_refused_and_no_file_made() {
        let mut rig = turned();
        rig.base = None;
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("table.csv");
        let error = CsvSink::create(&path, &rig, OutputFrame::Base).unwrap_err();
        assert!(matches!(&error, SinkError::NoBaseFrame { path: named } if *named == path), "{error}");
        assert!(error.to_string().contains("--frame camera"));
        assert!(!path.exists());
    }

    #[test]
    fn every_row_is_in_the_file_at_once() {
        let file = tempfile::NamedTempFile::new().unwrap();
        let mut sink = CsvSink::create(file.path(), &turned(), OutputFrame::Base).unwrap();
        for seq in 0..3 {
            sink.write(&plain(seq, 0), None).unwrap();
            let text = std::fs::read_to_string(file.path()).unwrap();
            assert_eq!(text.matches("\r\n").count() as u64, seq + 2);
            assert!(text.ends_with("\r\n"));
        }
    }

    #[test]
    fn a_full_disk_is_an_error_that_names_the_file() {
        let error = CsvSink::create(Path::new("/dev/full"), &turned(), OutputFrame::Base).unwrap_err();
        assert!(error.to_string().starts_with("cannot write /dev/full: No space left on device"), "{error}");
    }
}
