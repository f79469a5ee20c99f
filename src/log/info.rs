//! What is in a log: frames, gaps, clocks, what is missing and why.

use super::LogError;
use super::condition::Condition;
use super::decoder::MessageDecoder;
use super::fields::{list, number, text, whole, word};
use super::is_being_written;
use super::records;
use super::schema::Topic;
use mcap::records::Record;
use prost_reflect::DynamicMessage;
use std::collections::BTreeMap;
use std::path::Path;

/// A topic of a log.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct TopicInfo {
    /// Its name.
    pub name: String,
    /// Name of its schema.
    pub schema: String,
    /// Messages on it.
    pub messages: u64,
}

/// What is in a log.
#[derive(Debug, Clone, Default)]
pub struct Info {
    /// Program and version that wrote it.
    pub library: String,
    /// How much of it can be trusted.
    pub condition: Condition,
    /// Whether a run is still writing it.
    pub being_written: bool,
    /// Its topics, sorted by name.
    pub topics: Vec<TopicInfo>,
    /// Names and sizes in bytes of the files attached to it.
    pub attachments: Vec<(String, u64)>,
    /// Name of the camera's clock.
    pub clock: Option<String>,
    /// Camera frames with a row.
    pub frames: u64,
    /// Camera time of the first and the last frame, nanoseconds of that clock.
    pub span_ns: Option<(i64, i64)>,
    /// Live: the host's time of the first and the last frame, nanoseconds since 1970.
    pub host_span_ns: Option<(i64, i64)>,
    /// Places where camera frames were lost, and how many in all.
    pub gaps: (u64, u64),
    /// Frames whose number does not follow that of the frame before: rows missing in the log.
    pub rows_missing: u64,
    /// Frames whose stamp is not later than that of the frame before.
    pub not_later: u64,
    /// Frames by what is missing (a marker, `tangent`, `deflection`) and why.
    pub misses: BTreeMap<(String, String), u64>,
}

impl Info {
    /// Reads the log at `path`, whole.
    ///
    /// # Errors
    /// When it cannot be read, is not an MCAP file, or is a log of another program.
    pub fn read(path: &Path) -> Result<Self, LogError> {
        let mut info = Self::default();
        let mut decoder = MessageDecoder::default();
        let mut messages: BTreeMap<u16, u64> = BTreeMap::new();
        let mut last: Option<(u64, i64)> = None;
        info.condition = records::each(path, |record| {
            decoder.learn(record);
            match record {
                Record::Header(header) => info.library.clone_from(&header.library),
                Record::Message { header, data } => {
                    *messages.entry(header.channel_id).or_default() += 1;
                    if let Some(estimate) = decoder.decoded(header.channel_id, Topic::Estimate, data.as_ref()) {
                        info.add(&estimate, &mut last);
                    }
                }
                Record::Attachment { header, data, .. } => {
                    info.attachments.push((header.name.clone(), data.len() as u64));
                }
                _ => {}
            }
            Ok(())
        })?;
        info.being_written = is_being_written(path);
        let topic = |(id, name, schema): (u16, &str, &str)| TopicInfo {
            name: name.to_owned(),
            schema: schema.to_owned(),
            messages: messages.get(&id).copied().unwrap_or(0),
        };
        info.topics = decoder.channels().map(topic).collect();
        info.topics.sort_by(|a, b| a.name.cmp(&b.name));
        let ours = info.topics.iter().any(|topic| topic.name == Topic::Estimate.name());
        if ours { Ok(info) } else { Err(LogError::NotOurs { path: path.to_owned() }) }
    }

    /// Counts a frame, unless it has no time.
    fn add(&mut self, estimate: &DynamicMessage, last: &mut Option<(u64, i64)>) {
        let Some(stamp_ns) = number(estimate, "stamp_ns") else { return };
        let (seq, gap) = (whole(estimate, "seq"), whole(estimate, "gap"));
        if self.frames == 0 {
            self.clock = text(estimate, "clock");
        }
        self.frames += 1;
        self.span_ns = Some((self.span_ns.map_or(stamp_ns, |(first, _)| first), stamp_ns));
        if let Some(host_ns) = number(estimate, "host_stamp_ns").filter(|ns| *ns != 0) {
            self.host_span_ns = Some((self.host_span_ns.map_or(host_ns, |(first, _)| first), host_ns));
        }
        self.gaps = (self.gaps.0 + u64::from(gap > 0), self.gaps.1.saturating_add(gap));
        if let Some((last_seq, last_ns)) = *last {
            self.rows_missing += seq.saturating_sub(last_seq.saturating_add(1));
            self.not_later += u64::from(stamp_ns <= last_ns);
        }
        *last = Some((seq, stamp_ns));
        for marker in list(estimate, "markers") {
            self.miss(text(&marker, "name").unwrap_or_default(), &marker, "status");
        }
        self.miss("tangent".to_owned(), estimate, "tangent_status");
        self.miss("deflection".to_owned(), estimate, "deflection_status");
    }

    fn miss(&mut self, what: String, message: &DynamicMessage, field: &str) {
        if let Some(word) = word(message, field).filter(|word| word != "ok") {
            *self.misses.entry((what, word)).or_default() += 1;
        }
    }
}
