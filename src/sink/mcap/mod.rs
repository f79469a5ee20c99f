//! The log: MCAP with Protobuf messages, readable by Foxglove and by every language that has an `mcap` package.
//!
//! | topic | schema | when | what |
//! |---|---|---|---|
//! | `/catheter/estimate` | `catoptra.Estimate` ([`messages::Estimate`]) | every frame | all that was measured, in the camera frame and the base frame, with covariances and what each view showed |
//! | `/catheter/deflection` | `catoptra.Deflection` ([`messages::Deflection`]) | every frame | θ and its σ; NaN and the reason when not measured |
//! | `/scene` | `foxglove.SceneUpdate` | every frame | tube, bands and coil direction, in frame `base` (`camera` when the rig has no base) |
//! | `/camera/annotations` | `foxglove.ImageAnnotations` | every frame | outline, centre and label of every band in every view |
//! | `/camera/calibration` | `foxglove.CameraCalibration` | once | intrinsics, `plumb_bob` |
//! | `/tf` | `foxglove.FrameTransform` | once, if the rig has a base | place of frame `camera` in frame `base` |
//! | `/health` | `catoptra.Health` ([`messages::Health`]) | every second of camera time, and at the end | frames, losses, misses by reason, drift alarms (and when one is raised) |
//!
//! Attached are `rig.toml` and `options.toml`, the rig and the options of the run. The metadata record `catoptra` has the
//! program's `version` and the `clock` of the time stamps.
//!
//! # Time
//! Log and publish time of a message are the camera's time stamp of its frame, in nanoseconds since that clock's zero. The
//! container cannot hold negative times, and 0 is taken for "no time" by some programs: frames stamped at or before 0 are
//! filed at 1 ns, in their order. `stamp_ns` in the project's own messages is exact always; `timestamp` in Foxglove's is
//! exact from 0 up and 0 before. The sequence number of a message is that of its frame.
//!
//! # After a crash
//! Whatever ends the run, all messages older than a second can be read: see `file.rs` for how. A log without its end has no
//! index; `mcap recover` makes one.

mod camera;
mod convert;
mod file;
mod health;
pub mod messages;
mod scene;
mod schema;

use super::{Sink, SinkError};
use crate::estimate::Estimate;
use crate::rig::{Camera, Rig};
use crate::source::Picture;
use convert::{Names, file_time_ns};
use file::{FLUSH_AFTER, LogFile, Topic};
use foxglove::messages::{CameraCalibration, Color, FrameTransform, ImageAnnotations, SceneUpdate};
use health::Tally;
use messages::{Deflection, Health};
use scene::Scene;
use schema::Catoptra;
use std::collections::BTreeMap;
use std::path::Path;

/// Writes the log.
#[derive(Debug)]
pub struct McapSink {
    file: LogFile,
    topics: Topics,
    names: Names,
    camera: Camera,
    colours: Vec<Color>,
    scene: Scene,
    tally: Tally,
    /// Sequence and camera time of the last frame.
    last: Option<(u32, i64)>,
    /// Camera time of the last flush, nanoseconds.
    flushed_ns: i64,
}

#[derive(Debug)]
struct Topics {
    estimate: Topic<Catoptra<messages::Estimate>>,
    deflection: Topic<Catoptra<Deflection>>,
    scene: Topic<SceneUpdate>,
    annotations: Topic<ImageAnnotations>,
    calibration: Topic<CameraCalibration>,
    transform: Topic<FrameTransform>,
    health: Topic<Catoptra<Health>>,
}

impl McapSink {
    /// Creates the file (an existing one is replaced), with schemas and attachments.
    ///
    /// `rig_toml` is the text that `rig` was read from, `options_toml` the run's options as TOML.
    ///
    /// # Errors
    /// [`SinkError::Io`] when the file cannot be created or written.
    pub fn create(path: &Path, rig: &Rig, rig_toml: &str, options_toml: &str) -> Result<Self, SinkError> {
        let mut file = LogFile::create(path)?;
        file.attach("rig.toml", "application/toml", rig_toml)?;
        file.attach("options.toml", "application/toml", options_toml)?;
        let topics = Topics {
            estimate: file.topic("/catheter/estimate")?,
            deflection: file.topic("/catheter/deflection")?,
            scene: file.topic("/scene")?,
            annotations: file.topic("/camera/annotations")?,
            calibration: file.topic("/camera/calibration")?,
            transform: file.topic("/tf")?,
            health: file.topic("/health")?,
        };
        file.flush()?;
        Ok(Self {
            file,
            topics,
            names: Names::new(rig),
            camera: rig.camera.clone(),
            colours: camera::colours(rig),
            scene: Scene::new(rig),
            tally: Tally::new(rig),
            last: None,
            flushed_ns: 0,
        })
    }

    /// What is said once, before the first frame.
    fn begin(&mut self, estimate: &Estimate, seq: u32, time_ns: u64) -> Result<(), SinkError> {
        let stamp = estimate.stamp;
        self.file.metadata("catoptra", about(Some(stamp.clock.name())))?;
        let calibration = camera::calibration(&self.camera, stamp.ns);
        self.file.message(&self.topics.calibration, seq, time_ns, &calibration)?;
        if let Some(transform) = scene::camera_in_base(&self.names, stamp.ns) {
            self.file.message(&self.topics.transform, seq, time_ns, &transform)?;
        }
        self.flushed_ns = stamp.ns;
        Ok(())
    }
}

impl Sink for McapSink {
    fn write(&mut self, estimate: &Estimate, _: &Picture) -> Result<(), SinkError> {
        let stamp_ns = estimate.stamp.ns;
        let time_ns = file_time_ns(stamp_ns);
        // The format counts messages in 32 bits: two years of frames at 60 Hz, then from 0 again.
        let seq = (estimate.seq & u64::from(u32::MAX)) as u32;
        if self.last.is_none() {
            self.begin(estimate, seq, time_ns)?;
        }
        self.last = Some((seq, stamp_ns));

        let all = Catoptra(self.names.estimate(estimate));
        self.file.message(&self.topics.estimate, seq, time_ns, &all)?;
        let deflection = Catoptra(self.names.deflection(estimate));
        self.file.message(&self.topics.deflection, seq, time_ns, &deflection)?;
        self.file.message(&self.topics.scene, seq, time_ns, &self.scene.update(estimate))?;
        let annotations = camera::annotations(&self.names, &self.colours, estimate);
        self.file.message(&self.topics.annotations, seq, time_ns, &annotations)?;
        if let Some(totals) = self.tally.count(&self.names, estimate) {
            self.file.message(&self.topics.health, seq, time_ns, &Catoptra(totals.clone()))?;
        }

        if u128::from(stamp_ns.abs_diff(self.flushed_ns)) >= FLUSH_AFTER.as_nanos() {
            self.flushed_ns = stamp_ns;
            self.file.flush()?;
        }
        Ok(())
    }

    fn finish(&mut self) -> Result<(), SinkError> {
        match self.last {
            Some((seq, stamp_ns)) => {
                let totals = Catoptra(self.tally.totals().clone());
                self.file.message(&self.topics.health, seq, file_time_ns(stamp_ns), &totals)?;
            }
            None => self.file.metadata("catoptra", about(None))?,
        }
        self.file.finish()
    }
}

/// The metadata of a log; a run without a frame has no clock.
fn about(clock: Option<&str>) -> BTreeMap<String, String> {
    let version = ("version".to_owned(), env!("CARGO_PKG_VERSION").to_owned());
    let clock = clock.map(|name| ("clock".to_owned(), name.to_owned()));
    std::iter::once(version).chain(clock).collect()
}
