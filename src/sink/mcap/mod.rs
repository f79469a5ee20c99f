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
//! | `/coil/current` | `catoptra.Current` ([`messages::Current`]) | live, when given | currents of the coils, on the host's clock |
//! | `/camera/windows` | `catoptra.PictureWindows` ([`messages::PictureWindows`]) | every frame that was tracked, with `--record windows`, and some frames after its estimate | the parts of the picture that the tracker looked at |
//! | `/health` | `catoptra.Health` ([`messages::Health`]) | every second of camera time, and at the end | frames, losses, misses by reason, drift alarms (and when one is raised) |
//!
//! Attached are `rig.toml` and `options.toml`, the rig and the options of the run. The metadata record `catoptra` has the
//! program's `version`, the `clock` of the time stamps, and as `pictures` the name of the video beside the log, or `windows`.
//!
//! # Time
//! The publish time of a message is the camera's time stamp of its frame, in nanoseconds since that clock's zero. Its log
//! time is the same, and in a live run the host's time of the frame's arrival, nanoseconds since 1970. The container cannot hold negative times, and 0 is taken for "no time" by some programs: frames stamped at or before 0 are
//! filed at 1 ns, in their order. `stamp_ns` in the project's own messages is exact always; `timestamp` in Foxglove's is
//! exact from 0 up and 0 before. The sequence number of a message is that of its frame.
//!
//! # After a crash
//! Whatever ends the run, all messages older than a second can be read: see `file.rs` for how. A log without its end has no
//! index; `mcap recover` makes one.

mod file;

use super::messages::PictureWindows;
use super::topics::{Teller, file_time_ns};
use super::{CurrentSample, Keeper, PictureCount, Sink, SinkError};
use crate::estimate::Estimate;
use crate::rig::Rig;
use crate::source::Picture;
use file::{FLUSH_AFTER, LogFile, Times};
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

/// Writes the log.
#[derive(Debug)]
pub struct McapSink {
    file: LogFile,
    teller: Teller,
    /// Sequence and times of the last frame.
    last: Option<(u32, Times)>,
    /// Camera time of the last flush, nanoseconds.
    flushed_ns: i64,
    /// What is told of the pictures in the metadata.
    pictures: Option<String>,
    keeper: Option<Keeper>,
    count: Option<Arc<PictureCount>>,
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
        file.announce()?;
        file.flush()?;
        Ok(Self {
            file,
            teller: Teller::new(rig),
            last: None,
            flushed_ns: 0,
            pictures: None,
            keeper: None,
            count: None,
        })
    }

    /// The run records pictures: `what` goes into the metadata (`windows`, or the name of the video), their count into `/health`.
    #[must_use]
    pub fn telling_of_pictures(mut self, what: &str, count: Arc<PictureCount>) -> Self {
        self.pictures = Some(what.to_owned());
        self.teller.count_pictures(Arc::clone(&count));
        self.count = Some(count);
        self
    }

    /// Keeps the windows of the pictures that [`Sink::write`] is given.
    #[must_use]
    pub fn keeping_windows(mut self) -> Self {
        self.keeper = Some(Keeper::default());
        self
    }

    /// The metadata of a log; a run without a frame has no clock.
    fn about(&self, clock: Option<&str>) -> BTreeMap<String, String> {
        let said =
            [("version", Some(env!("CARGO_PKG_VERSION"))), ("clock", clock), ("pictures", self.pictures.as_deref())];
        said.into_iter().filter_map(|(key, value)| Some((key.to_owned(), value?.to_owned()))).collect()
    }

    /// What is said once, before the first frame.
    fn begin(&mut self, estimate: &Estimate, seq: u32, times: Times) -> Result<(), SinkError> {
        self.file.metadata("catoptra", self.about(Some(estimate.stamp.clock.name())))?;
        for message in self.teller.rig(estimate.stamp.ns)? {
            self.file.message(&message, seq, times)?;
        }
        self.flushed_ns = estimate.stamp.ns;
        Ok(())
    }
}

impl Sink for McapSink {
    fn write(&mut self, estimate: &Estimate, picture: Option<&Picture>) -> Result<(), SinkError> {
        let stamp_ns = estimate.stamp.ns;
        let publish_ns = file_time_ns(stamp_ns);
        let log_ns = estimate.host.map_or(publish_ns, |host| file_time_ns(host.arrival_ns));
        let times = Times { log_ns, publish_ns };
        // The format counts messages in 32 bits: two years of frames at 60 Hz, then from 0 again.
        let seq = (estimate.seq & u64::from(u32::MAX)) as u32;
        if self.last.is_none() {
            self.begin(estimate, seq, times)?;
        }
        self.last = Some((seq, times));
        for message in self.teller.frame(estimate)? {
            self.file.message(&message, seq, times)?;
        }
        if let (Some(keeper), Some(picture)) = (&mut self.keeper, picture) {
            let kept = keeper.keep(estimate, picture)?;
            self.file.message(&Teller::windows(&kept)?, seq, times)?;
            if let Some(count) = &self.count {
                count.add_recorded();
            }
        }
        if u128::from(stamp_ns.abs_diff(self.flushed_ns)) >= FLUSH_AFTER.as_nanos() {
            self.flushed_ns = stamp_ns;
            self.file.flush()?;
        }
        Ok(())
    }

    fn write_current(&mut self, sample: &CurrentSample) -> Result<(), SinkError> {
        let times = Times { log_ns: file_time_ns(sample.arrival_ns), publish_ns: file_time_ns(sample.host_ns) };
        let seq = sample.seq.map_or(0, |seq| (seq & u64::from(u32::MAX)) as u32);
        self.file.message(&Teller::current(sample)?, seq, times)
    }

    fn write_windows(&mut self, kept: &PictureWindows) -> Result<bool, SinkError> {
        let publish_ns = file_time_ns(kept.stamp_ns);
        let times = Times { log_ns: kept.arrival_ns.map_or(publish_ns, file_time_ns), publish_ns };
        self.file.message(&Teller::windows(kept)?, (kept.seq & u64::from(u32::MAX)) as u32, times)?;
        Ok(true)
    }

    fn finish(&mut self) -> Result<(), SinkError> {
        match self.last {
            Some((seq, times)) => self.file.message(&self.teller.totals()?, seq, times)?,
            None => self.file.metadata("catoptra", self.about(None))?,
        }
        self.file.finish()
    }
}
