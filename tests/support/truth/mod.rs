//! The sample recordings and their truth from the renderer: in the camera frame, in mm there and metres here.

pub(crate) mod score;

use catoptra::estimate::Estimate;
use catoptra::rig::Rig;
use catoptra::source::{self, Frame, SourceOptions};
use catoptra::track::{TrackOptions, Tracker};
use nalgebra::{Point3, UnitVector3, Vector3};
use std::collections::HashMap;
use std::path::{Path, PathBuf};

pub(crate) const MARKERS: [&str; 3] = ["base", "coil", "tip"];

/// What was rendered in one frame.
pub(crate) struct Truth {
    pub(crate) stamp_ns: i64,
    /// Middles of the bands on the centre line, in the order of [`MARKERS`], metres.
    pub(crate) points: [Point3<f64>; 3],
    /// Of the coil, base to tip.
    pub(crate) tangent: UnitVector3<f64>,
    /// Between tangent and gravity; signed in planar.mkv only.
    pub(crate) theta_deg: f64,
}

/// A file of the repository.
pub(crate) fn file(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(name)
}

/// The sample's rig file before its bands are taught: no colours, no places along the tube, no blur.
pub(crate) fn untaught_rig() -> String {
    let mut table: toml::Table =
        std::fs::read_to_string(file("sample_frames/truth/rig.toml")).unwrap().parse().unwrap();
    let camera = table["camera"].as_table_mut().unwrap();
    assert!(camera.remove("blur_px").is_some() && camera.remove("chroma_offset_px").is_some());
    for marker in table["marker"].as_array_mut().unwrap() {
        let marker = marker.as_table_mut().unwrap();
        assert!(marker.remove("colour").is_some() && marker.remove("centre_mm").is_some());
    }
    table.to_string()
}

/// A recording of the sample.
pub(crate) fn recording(run: &str) -> PathBuf {
    file(&format!("sample_frames/{run}.mkv"))
}

/// The rig of the sample: geometry from the renderer, colours and blur learned on planar.mkv.
pub(crate) fn rig() -> Rig {
    Rig::load(&file("sample_frames/truth/rig.toml")).unwrap()
}

pub(crate) fn truth(run: &str) -> Vec<Truth> {
    truth_in(&file(&format!("sample_frames/truth/{run}.csv")))
}

pub(crate) fn truth_in(table: &Path) -> Vec<Truth> {
    let mut reader = csv::Reader::from_path(table).unwrap();
    let rows = reader.deserialize().map(|row: Result<HashMap<String, f64>, _>| row.unwrap());
    rows.map(|row| {
        let vector = |name: &str| Vector3::from(["x", "y", "z"].map(|axis| row[&format!("{name}_{axis}")]));
        Truth {
            // Matroska's whole milliseconds.
            stamp_ns: (row["t_s"] * 1e3).round() as i64 * 1_000_000,
            points: MARKERS.map(|name| Point3::from(vector(name) * 1e-3)),
            tangent: UnitVector3::new_normalize(vector("tan")),
            theta_deg: row["theta_deg"],
        }
    })
    .collect()
}

/// The frames of a recording.
pub(crate) fn frames(run: &str) -> impl Iterator<Item = Frame> {
    let mut source = source::open(recording(run), SourceOptions::default()).unwrap();
    std::iter::from_fn(move || source.next_frame().unwrap())
}

pub(crate) fn track(rig: &Rig, options: TrackOptions, frames: impl Iterator<Item = Frame>) -> Vec<Estimate> {
    let mut tracker = Tracker::new(rig, options).unwrap();
    frames.map(|frame| tracker.step(&frame).unwrap()).collect()
}
