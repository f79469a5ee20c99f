//! [`LogFile`]: an MCAP file in which everything older than [`CHUNK_SPAN`] survives a kill at any instant.
//!
//! Messages are collected in a chunk in memory and reach the file as whole chunks, so an unfinished file is a series of
//! complete records (at worst with one torn at its end). A chunk is closed when it spans [`CHUNK_SPAN`] of camera time
//! (by the caller, see [`LogFile::message`]) and when its first message has waited that long in wall-clock time, which
//! a small thread watches: a stalled camera must not keep its last frames in memory.
//!
//! Chunks are compressed with zstd, in the thread that writes: without compression a log would grow by 25 MB per minute
//! at 60 Hz with three markers in two views.

use super::form::{FileMessage, FileTopic};
use crate::log::records::plain_records;
use crate::log::schema::TOPICS_ATTACHMENT;
use crate::log::{CHUNK_BYTES, CHUNK_SPAN, system_error, write_options};
use crate::sink::{SinkError, same_error, settle};
use mcap::records::{MessageHeader, Metadata, op};
use mcap::write::NoSeek;
use mcap::{Attachment, McapResult, WriteOptions};
use parking_lot::{Condvar, Mutex};
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, BufWriter};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

type Writer = mcap::Writer<NoSeek<BufWriter<File>>>;

/// The two times of a message.
#[derive(Debug, Clone, Copy)]
pub(super) struct Times {
    pub(super) log_ns: u64,
    pub(super) publish_ns: u64,
}

/// An open log.
#[derive(Debug)]
pub(super) struct LogFile {
    path: PathBuf,
    shared: Arc<Shared>,
    flusher: Option<JoinHandle<()>>,
    /// Channels in the order they were announced.
    channels: Vec<u16>,
}

#[derive(Debug)]
struct Shared {
    state: Mutex<OpenFile>,
    changed: Condvar,
}

struct OpenFile {
    /// `None` once the file is finished or lost.
    writer: Option<Writer>,
    /// When the oldest message in memory was written.
    waiting_since: Option<Instant>,
    /// Why the file was lost.
    failure: Option<io::Error>,
    closed: bool,
}

impl std::fmt::Debug for OpenFile {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("OpenFile")
            .field("waiting_since", &self.waiting_since)
            .field("failure", &self.failure)
            .field("closed", &self.closed)
            .finish_non_exhaustive()
    }
}

impl LogFile {
    /// Creates the file (an existing one is replaced), with `profile` in its header.
    ///
    /// # Errors
    /// [`SinkError::Io`] when it cannot be created.
    pub(super) fn create(path: &Path, profile: &str) -> Result<Self, SinkError> {
        let lost = |source| SinkError::io(path, source);
        let file = File::create(path).map_err(lost)?;
        // Held while the file is open, so that nobody repairs a log that is being written.
        #[cfg(unix)]
        if let Err(error) = rustix::fs::flock(&file, rustix::fs::FlockOperation::NonBlockingLockExclusive) {
            tracing::debug!("{}: cannot be locked: {error}", path.display());
        }
        let writer = write_options(profile)
            .chunk_size(Some(CHUNK_BYTES))
            .disable_seeking(true)
            .create(NoSeek::new(BufWriter::new(file)))
            .map_err(|e| lost(system_error(e)))?;
        let state = OpenFile { writer: Some(writer), waiting_since: None, failure: None, closed: false };
        let shared = Arc::new(Shared { state: Mutex::new(state), changed: Condvar::new() });
        let watched = Arc::clone(&shared);
        let flusher = std::thread::Builder::new()
            .name("log flusher".to_owned())
            .spawn(move || watched.flush_what_waits())
            .map_err(lost)?;
        Ok(Self { path: path.to_owned(), shared, flusher: Some(flusher), channels: Vec::new() })
    }

    /// Adds topics; their schemas are stored in the file.
    pub(super) fn announce(&mut self, topics: &[FileTopic]) -> Result<(), SinkError> {
        self.channels = self.with_writer(|writer| add_all(writer, topics))?;
        Ok(())
    }

    /// Attaches a copy of the schemas and channels of topics that will be announced. Before the end of a log they are
    /// only in its first chunk, and without them no message can be read.
    pub(super) fn attach_copy(&mut self, topics: &[FileTopic]) -> Result<(), SinkError> {
        let copy = records_of(topics).map_err(|e| SinkError::io(&self.path, system_error(e)))?;
        self.attach(TOPICS_ATTACHMENT, "application/octet-stream", &copy)
    }

    /// Writes a message. Call [`LogFile::flush`] by camera time.
    pub(super) fn message(&mut self, message: &FileMessage, sequence: u32, times: Times) -> Result<(), SinkError> {
        let Some(&channel_id) = self.channels.get(message.channel) else {
            let unknown = io::Error::other(format!("topic {} was not announced", message.channel));
            return Err(SinkError::io(&self.path, unknown));
        };
        let header = MessageHeader { channel_id, sequence, log_time: times.log_ns, publish_time: times.publish_ns };
        self.with_writer(|writer| writer.write_to_known_channel(&header, &message.bytes))?;
        let mut state = self.shared.state.lock();
        if state.waiting_since.is_none() {
            state.waiting_since = Some(Instant::now());
            self.shared.changed.notify_one();
        }
        Ok(())
    }

    /// Attaches a file.
    pub(super) fn attach(&mut self, name: &str, media_type: &str, content: &[u8]) -> Result<(), SinkError> {
        let attachment = Attachment {
            log_time: 1,    // the beginning of every clock; 0 is never written
            create_time: 0, // "not available", as the format's specification has it: the same run gives the same log
            name: name.to_owned(),
            media_type: media_type.to_owned(),
            data: Cow::Borrowed(content),
        };
        self.with_writer(|writer| writer.attach(&attachment))
    }

    /// Writes a metadata record.
    pub(super) fn metadata(&mut self, name: &str, metadata: BTreeMap<String, String>) -> Result<(), SinkError> {
        self.with_writer(|writer| writer.write_metadata(&Metadata { name: name.to_owned(), metadata }))
    }

    /// Passes everything written so far to the system.
    pub(super) fn flush(&mut self) -> Result<(), SinkError> {
        self.shared.state.lock().waiting_since = None;
        self.with_writer(Writer::flush)
    }

    /// Completes the file: index, summary, end.
    pub(super) fn finish(&mut self) -> Result<(), SinkError> {
        self.stop_flusher();
        self.with_writer(|writer| writer.finish().map(drop))?;
        // A second call would find the writer gone: it is taken so that nothing can be written after the end.
        let Some(writer) = self.shared.state.lock().writer.take() else { return Ok(()) };
        let settled =
            writer.into_inner().into_inner().into_inner().map_err(|e| e.into_error()).and_then(|file| settle(&file));
        settled.map_err(|source| SinkError::io(&self.path, source))
    }

    /// Runs `action` unless the file is lost; after an error it is lost for good, and every later call returns the
    /// error again.
    fn with_writer<T>(&self, action: impl FnOnce(&mut Writer) -> McapResult<T>) -> Result<T, SinkError> {
        self.shared.state.lock().run(action).map_err(|source| SinkError::io(&self.path, source))
    }

    /// From here on nothing is flushed by wall-clock time.
    pub(super) fn stop_flusher(&mut self) {
        self.shared.state.lock().closed = true;
        self.shared.changed.notify_one();
        if let Some(flusher) = self.flusher.take()
            && flusher.join().is_err()
        {
            tracing::warn!("the thread that flushes {} ended early", self.path.display());
        }
    }
}

/// Adds topics; returns their channels.
///
/// # Errors
/// The writer's.
pub(crate) fn add_all<W: io::Write + io::Seek>(
    writer: &mut mcap::Writer<W>,
    topics: &[FileTopic],
) -> McapResult<Vec<u16>> {
    let mut add = |topic: &FileTopic| {
        let schema = match &topic.schema {
            Some((name, encoding, data)) => writer.add_schema(name, encoding, data)?,
            None => 0,
        };
        writer.add_channel(schema, &topic.topic, topic.encoding, &topic.metadata)
    };
    topics.iter().map(&mut add).collect()
}

/// The schemas and channels of topics as records, one after another, as a log has them that announces these.
fn records_of(topics: &[FileTopic]) -> McapResult<Vec<u8>> {
    let mut writer = WriteOptions::new().use_chunks(false).create(io::Cursor::new(Vec::new()))?;
    add_all(&mut writer, topics)?;
    writer.finish()?;
    let log = writer.into_inner().into_inner();
    let data = plain_records(log.get(mcap::MAGIC.len()..).unwrap_or_default());
    let topics = data.take_while(|(code, _)| *code != op::DATA_END).filter(|(code, _)| *code != op::HEADER);
    Ok(topics.flat_map(|(code, body)| [&[code], (body.len() as u64).to_le_bytes().as_slice(), body].concat()).collect())
}

impl Drop for LogFile {
    /// An unfinished file also gets its end (the writer's own `drop` does it); errors can no longer be reported.
    fn drop(&mut self) {
        self.stop_flusher();
    }
}

impl Shared {
    fn flush_what_waits(&self) {
        let mut state = self.state.lock();
        while !state.closed {
            let rest = state.waiting_since.map(|since| CHUNK_SPAN.saturating_sub(since.elapsed()));
            match rest {
                None => self.changed.wait(&mut state),
                Some(Duration::ZERO) => {
                    state.waiting_since = None;
                    // The failure is kept in the state: the caller's next call reports it.
                    let _ = state.run(Writer::flush);
                }
                Some(rest) => drop(self.changed.wait_for(&mut state, rest)),
            }
        }
    }
}

impl OpenFile {
    fn run<T>(&mut self, action: impl FnOnce(&mut Writer) -> McapResult<T>) -> io::Result<T> {
        if let Some(failure) = &self.failure {
            return Err(same_error(failure));
        }
        let Some(writer) = &mut self.writer else {
            return Err(io::Error::other("the log is finished already"));
        };
        action(writer).map_err(|e| {
            let failure = system_error(e);
            let copy = same_error(&failure);
            self.failure = Some(failure);
            self.writer = None;
            copy
        })
    }
}
