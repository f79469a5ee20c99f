//! The log: MCAP with Protobuf messages, readable by Foxglove and in every language with an `mcap` package; or with ROS
//! 2 messages ([`Profile::Ros2`]).
//!
//! Its topics and messages are those of [`log::schema`](crate::log::schema), or those of
//! [`log::ros2`](crate::log::ros2).
//!
//! Attached are `rig.toml` and `options.toml`, the rig and the options of the run. The metadata record `catoptra` has
//! the program's `version`, the `clock` of the time stamps, and as `pictures` the name of the video beside the log, or
//! `windows`.
//!
//! # Time
//! The publish time of a message is the camera's time stamp of its frame, in nanoseconds since that clock's zero. Its
//! log time is the same, and in a live run the host's time of the frame's arrival, nanoseconds since 1970. The
//! container cannot hold negative times, and 0 is taken for "no time" by some programs: frames stamped at or before 0
//! are filed at 1 ns, in their order. `stamp_ns` in the project's own messages is always exact; `timestamp` in
//! Foxglove's is exact from 0 up and 0 before that. The sequence number of a message is that of its frame.
//!
//! # After a crash
//! However the run ends, all messages older than a second can be read (see `file.rs`). A log without its end has no
//! index; `mcap recover` makes one.

mod file;
mod form;

pub(crate) use file::add_all;
pub use form::Profile;
pub(crate) use form::{FileMessage, FileTopic, RosLog};

use super::encoder::{MessageEncoder, file_time_ns};
use super::{CurrentSample, ImageTaker, PictureCount, Sink, SinkError, WindowRecorder};
use crate::estimate::Estimate;
use crate::log::CHUNK_SPAN;
use crate::log::schema::messages::PictureWindows;
use crate::log::schema::{METADATA, OPTIONS_ATTACHMENT, RIG_ATTACHMENT};
use crate::rig::Rig;
use crate::source::Picture;
use crate::tally::{Tally, Totals};
use file::{LogFile, Times};
use form::Form;
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

/// Writes the log.
#[derive(Debug)]
pub struct McapSink {
    file: LogFile,
    form: Form,
    encoder: MessageEncoder,
    /// Sequence and times of the last frame.
    last: Option<(u32, Times)>,
    /// Camera time of the last frame and of the last flush, nanoseconds.
    last_ns: i64,
    flushed_ns: i64,
    /// Where the pictures are, for the metadata.
    pictures: Option<String>,
    windows: Option<WindowRecorder>,
    images: ImageTaker,
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
        Self::of_profile(Profile::default(), path, rig, rig_toml, options_toml)
    }

    /// As [`McapSink::create`], for any profile.
    ///
    /// # Errors
    /// [`SinkError::Io`] when the file cannot be created or written.
    pub fn of_profile(
        profile: Profile,
        path: &Path,
        rig: &Rig,
        rig_toml: &str,
        options_toml: &str,
    ) -> Result<Self, SinkError> {
        let form = Form::new(profile, rig);
        let mut file = LogFile::create(path, form.profile())?;
        let topics = form.topics();
        file.attach_copy(&topics)?;
        file.attach(RIG_ATTACHMENT, "application/toml", rig_toml.as_bytes())?;
        file.attach(OPTIONS_ATTACHMENT, "application/toml", options_toml.as_bytes())?;
        file.announce(&topics)?;
        file.flush()?;
        Ok(Self {
            file,
            form,
            encoder: MessageEncoder::new(rig),
            last: None,
            last_ns: 0,
            flushed_ns: 0,
            pictures: None,
            windows: None,
            images: ImageTaker::default(),
            count: None,
        })
    }

    /// For a run that records pictures: `what` goes into the metadata (`windows`, or the name of the video), their
    /// count into `/health`.
    #[must_use]
    pub fn with_pictures(mut self, what: &str, count: Arc<PictureCount>) -> Self {
        self.pictures = Some(what.to_owned());
        self.with_picture_count(count)
    }

    /// Their count goes into `/health`: recording may begin later.
    #[must_use]
    pub fn with_picture_count(mut self, count: Arc<PictureCount>) -> Self {
        self.encoder.set_picture_count(Arc::clone(&count));
        self.count = Some(count);
        self
    }

    /// Flushes by camera time only, not also by wall-clock time: the same frames give the same bytes, however long they
    /// take. A killed run may then lose more than its last second.
    #[must_use]
    pub fn by_camera_time(mut self) -> Self {
        self.file.stop_flusher();
        self
    }

    /// Keeps the windows of the pictures passed to [`Sink::write`].
    #[must_use]
    pub fn with_windows(mut self) -> Self {
        self.windows = Some(WindowRecorder::default());
        self
    }

    /// The metadata of a log; a run without a frame has no clock.
    fn about(&self, clock: Option<&str>) -> BTreeMap<String, String> {
        let said =
            [("version", Some(env!("CARGO_PKG_VERSION"))), ("clock", clock), ("pictures", self.pictures.as_deref())];
        said.into_iter().filter_map(|(key, value)| Some((key.to_owned(), value?.to_owned()))).collect()
    }

    /// Writes the messages that come once, before the first frame.
    fn begin(&mut self, estimate: &Estimate, seq: u32, times: Times) -> Result<(), SinkError> {
        self.file.metadata(METADATA, self.about(Some(estimate.stamp.clock.name())))?;
        self.put(&self.form.rig(&self.encoder, estimate.stamp.ns)?, seq, times)?;
        (self.last_ns, self.flushed_ns) = (estimate.stamp.ns, estimate.stamp.ns);
        Ok(())
    }

    fn put(&mut self, messages: &[FileMessage], seq: u32, times: Times) -> Result<(), SinkError> {
        messages.iter().try_for_each(|message| self.file.message(message, seq, times))
    }

    /// Passes the frames so far to the system when they span enough camera time.
    fn flush_if_due(&mut self) -> Result<(), SinkError> {
        if u128::from(self.last_ns.abs_diff(self.flushed_ns)) < CHUNK_SPAN.as_nanos() {
            return Ok(());
        }
        self.flushed_ns = self.last_ns;
        self.file.flush()
    }
}

impl Sink for McapSink {
    fn write(&mut self, estimate: &Estimate, picture: Option<&Picture>) -> Result<(), SinkError> {
        self.flush_if_due()?;
        let publish_ns = file_time_ns(estimate.stamp.ns);
        let log_ns = estimate.host.map_or(publish_ns, |host| file_time_ns(host.arrival_ns));
        let times = Times { log_ns, publish_ns };
        // The format counts messages in 32 bits: two years of frames at 60 Hz, then it restarts at 0.
        let seq = (estimate.seq & u64::from(u32::MAX)) as u32;
        if self.last.is_none() {
            self.begin(estimate, seq, times)?;
        }
        self.last = Some((seq, times));
        self.put(&self.form.frame(&self.encoder, estimate)?, seq, times)?;
        if let Some(picture) = picture
            && let Some(image) = self.images.take(estimate, picture)?
        {
            self.put(&self.form.image(&image)?, seq, times)?;
        }
        if let (Some(windows), Some(picture)) = (&mut self.windows, picture) {
            let kept = windows.keep(estimate, picture)?;
            self.put(&self.form.windows(&kept)?, seq, times)?;
            if let Some(count) = &self.count {
                count.add_recorded();
            }
        }
        self.last_ns = estimate.stamp.ns;
        Ok(())
    }

    fn write_current(&mut self, sample: &CurrentSample) -> Result<(), SinkError> {
        let times = Times { log_ns: file_time_ns(sample.arrival_ns), publish_ns: file_time_ns(sample.host_ns) };
        let seq = sample.seq.map_or(0, |seq| (seq & u64::from(u32::MAX)) as u32);
        self.put(&self.form.current(sample)?, seq, times)
    }

    fn write_windows(&mut self, kept: &PictureWindows) -> Result<bool, SinkError> {
        let publish_ns = file_time_ns(kept.stamp_ns);
        let times = Times { log_ns: kept.arrival_ns.map_or(publish_ns, file_time_ns), publish_ns };
        self.put(&self.form.windows(kept)?, (kept.seq & u64::from(u32::MAX)) as u32, times)?;
        Ok(true)
    }

    fn write_totals(&mut self, totals: &Totals) -> Result<(), SinkError> {
        let Some((seq, times)) = self.last else { return Ok(()) };
        self.put(&self.form.totals(&self.encoder, totals)?, seq, times)
    }

    fn finish(&mut self, tally: &Tally) -> Result<(), SinkError> {
        self.flush_if_due()?;
        match self.last {
            Some(_) => self.write_totals(&tally.totals())?,
            None => self.file.metadata(METADATA, self.about(None))?,
        }
        self.file.finish()
    }
}
