//! Converts a log to profile `ros2`: as `--profile ros2` writes it, with the same messages.

use super::{ConvertError, Converted, Message, each_message, left_out};
use crate::atomic_file::NewFile;
use crate::log::ros2::PROFILE;
use crate::log::schema::{RIG_ATTACHMENT, Topic};
use crate::log::{LogError, attached, copy_besides, profile, records, system_error, typed, write_options};
use crate::rig::Rig;
use crate::sink::{FileMessage, FileTopic, RosLog, add_all};
use mcap::records::{MessageHeader, Record};
use mcap::{McapError, Writer};
use prost_reflect::Value;
use std::cell::RefCell;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufWriter;
use std::path::Path;

/// Topics replaced by ROS's own messages.
const REPLACED: [Topic; 4] = [Topic::Deflection, Topic::Scene, Topic::Calibration, Topic::Transform];

pub(super) fn convert(path: &Path, out: &Path) -> Result<Converted, ConvertError> {
    let wrong = |reason: String| ConvertError::Content { path: path.to_owned(), reason };
    if profile(path)? == PROFILE {
        return Err(wrong("is of profile ros2 already".to_owned()));
    }
    let Some(text) = attached(path, RIG_ATTACHMENT)?.filter(|text| !text.trim().is_empty()) else {
        return Err(wrong("has no rig.toml attached: frames and camera are not known".to_owned()));
    };
    let rig = Rig::from_toml_str(&text, path).map_err(|error| wrong(format!("the rig attached to it: {error}")))?;
    let log = RosLog::new(&rig);
    // The definitions of wrapped messages are those of the log.
    let descriptors = descriptors(path)?;
    let topics = log.topics(|topic| descriptors.get(topic.name()).cloned());
    let mut converted = Converted { files: vec![out.to_owned()], ..Converted::default() };
    let file = RefCell::new(NewLog::begin(out, &topics)?);
    let mut stamp_ns = None;
    let take = |message: &Message<'_>| {
        let Some(decoded) = &message.decoded else { return Ok(false) };
        let of = Topic::ALL.into_iter().find(|topic| topic.name() == message.topic);
        let mut messages = Vec::new();
        match of {
            Some(Topic::Estimate) => {
                let Some(estimate) = typed::estimate(decoded) else { return Ok(false) };
                if stamp_ns.replace(estimate.stamp_ns).is_none() {
                    messages.extend(log.rig(estimate.stamp_ns)?);
                }
                messages.extend(log.frame(message.data, &estimate)?);
                converted.frames += 1;
            }
            Some(Topic::Current) => {
                let Some(current) = typed::current(decoded) else { return Ok(false) };
                messages.extend(log.current(message.data, &current)?);
                converted.currents += 1;
            }
            Some(Topic::Health) => messages.extend(log.health(message.data, &typed::health(decoded))?),
            Some(Topic::Image) => {
                // It follows its frame and has that frame's time.
                let data = decoded.get_field_by_name("data");
                let jpeg = data.as_deref().and_then(Value::as_bytes).map(|bytes| bytes.to_vec());
                let (Some(stamp_ns), Some(jpeg)) = (stamp_ns, jpeg) else { return Ok(false) };
                messages.extend(log.image(stamp_ns, jpeg)?);
            }
            Some(topic) if RosLog::keeps(topic) => messages.extend(log.wrapped(topic, message.data)?),
            Some(topic) => return Ok(REPLACED.contains(&topic)),
            None => return Ok(false),
        }
        messages.iter().try_for_each(|filed| file.borrow_mut().message(filed, message.header))?;
        Ok(true)
    };
    let (left, cut) = each_message(path, take, |record| file.borrow_mut().other(record))?;
    file.into_inner().finish()?;
    converted.cut = cut;
    for (topic, messages) in left {
        let why = if topic == Topic::Annotations.name() {
            "ROS has no message for outlines in a picture"
        } else {
            "what it is in ROS is not known"
        };
        converted.left_out.push(left_out(&topic, messages, why));
    }
    Ok(converted)
}

/// Name and descriptors of each topic of the log at `path`.
fn descriptors(path: &Path) -> Result<BTreeMap<String, (String, Vec<u8>)>, ConvertError> {
    let mut schemas: BTreeMap<u16, (String, Vec<u8>)> = BTreeMap::new();
    let mut topics = BTreeMap::new();
    records::each::<LogError>(path, |record| {
        match record {
            Record::Schema { header, data } => {
                schemas.entry(header.id).or_insert_with(|| (header.name.clone(), data.to_vec()));
            }
            Record::Channel(channel) => {
                let schema = schemas.get(&channel.schema_id);
                topics.extend(schema.map(|schema| (channel.topic.clone(), schema.clone())));
            }
            _ => {}
        }
        Ok(())
    })?;
    Ok(topics)
}

/// The new log.
struct NewLog<'a> {
    path: &'a Path,
    new: NewFile,
    writer: Writer<BufWriter<File>>,
    channels: Vec<u16>,
}

impl<'a> NewLog<'a> {
    fn begin(path: &'a Path, topics: &[FileTopic]) -> Result<Self, ConvertError> {
        let lost = |error| lost(path, error);
        let (new, file) = NewFile::begin(path).map_err(|error| lost(error.into()))?;
        let mut writer = write_options(PROFILE).create(BufWriter::new(file)).map_err(lost)?;
        let channels = add_all(&mut writer, topics).map_err(lost)?;
        Ok(Self { path, new, writer, channels })
    }

    /// Writes a message with the times of the one it was made from.
    fn message(&mut self, filed: &FileMessage, like: &MessageHeader) -> Result<(), ConvertError> {
        let Some(&channel_id) = self.channels.get(filed.channel) else { return Ok(()) };
        let header = MessageHeader { channel_id, ..*like };
        self.writer.write_to_known_channel(&header, &filed.bytes).map_err(|error| lost(self.path, error))
    }

    fn other(&mut self, record: &Record<'_>) -> Result<(), ConvertError> {
        copy_besides(&mut self.writer, record).map_err(|error| lost(self.path, error))
    }

    fn finish(mut self) -> Result<(), ConvertError> {
        self.writer.finish().map_err(|error| lost(self.path, error))?;
        let file = self.writer.into_inner().into_inner().map_err(|error| lost(self.path, error.into_error().into()))?;
        file.sync_all().and_then(|()| self.new.put_in_place()).map_err(|error| lost(self.path, error.into()))
    }
}

fn lost(path: &Path, error: McapError) -> ConvertError {
    ConvertError::Write { path: path.to_owned(), source: system_error(error) }
}
