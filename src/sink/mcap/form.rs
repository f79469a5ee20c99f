//! [`Form`]: how messages are put into a log: the project's own, or those of ROS 2.
//!
//! A log of profile `ros2` has ROS's messages, and wrapped, those of the project's own that are read back. It has no
//! `/camera/annotations`: ROS has no message for outlines in pictures.

use crate::estimate::Estimate;
use crate::log::ros2::{self, Qos, RosType};
use crate::log::schema::messages::{Current, Estimate as EstimateMessage, Health, PictureWindows};
use crate::log::schema::{ENCODING, Topic};
use crate::rig::Rig;
use crate::sink::encoder::{Message, MessageEncoder};
use crate::sink::ros2::{RosEncoder, RosMessage};
use crate::sink::{CurrentSample, LoggedImage, SinkError};
use crate::tally::Totals;
use std::collections::BTreeMap;

/// What a log is for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Profile {
    /// Foxglove, and programs that read Protobuf.
    #[default]
    Foxglove,
    /// ROS 2: rosbag2 and programs that read its files.
    Ros2,
}

/// A topic, as announced in a file.
#[derive(Debug, Clone)]
pub(crate) struct FileTopic {
    pub(crate) topic: String,
    /// Name, encoding and data.
    pub(crate) schema: Option<(String, String, Vec<u8>)>,
    pub(crate) encoding: &'static str,
    pub(crate) metadata: BTreeMap<String, String>,
}

/// A message, as written to a file.
#[derive(Debug, Clone)]
pub(crate) struct FileMessage {
    /// Index among the announced topics.
    pub(crate) channel: usize,
    pub(crate) bytes: Vec<u8>,
}

/// How messages are put into a log.
#[derive(Debug)]
pub(super) enum Form {
    Own,
    Ros2(Box<RosLog>),
}

impl Form {
    pub(super) fn new(profile: Profile, rig: &Rig) -> Self {
        match profile {
            Profile::Foxglove => Self::Own,
            Profile::Ros2 => Self::Ros2(Box::new(RosLog::new(rig))),
        }
    }

    /// The profile in the file.
    pub(super) fn profile(&self) -> &'static str {
        match self {
            Self::Own => "",
            Self::Ros2(_) => ros2::PROFILE,
        }
    }

    /// All topics.
    pub(super) fn topics(&self) -> Vec<FileTopic> {
        match self {
            Self::Own => Topic::ALL.into_iter().map(own).collect(),
            Self::Ros2(log) => log.topics(|topic| topic.schema().map(|schema| (schema.name, schema.data.into_owned()))),
        }
    }

    /// The messages written once, with the time of the first frame.
    pub(super) fn rig(&self, encoder: &MessageEncoder, stamp_ns: i64) -> Result<Vec<FileMessage>, SinkError> {
        match self {
            Self::Own => Ok(encoder.rig(stamp_ns)?.into_iter().filter_map(filed).collect()),
            Self::Ros2(log) => log.filed(log.encoder.rig(stamp_ns)?),
        }
    }

    pub(super) fn frame(&self, encoder: &MessageEncoder, estimate: &Estimate) -> Result<Vec<FileMessage>, SinkError> {
        match self {
            Self::Own => Ok(encoder.frame(estimate)?.into_iter().filter_map(filed).collect()),
            Self::Ros2(log) => {
                let message = encoder.estimate(estimate);
                let own = MessageEncoder::encoded(&message)?;
                log.frame(&own.bytes, &message)
            }
        }
    }

    pub(super) fn image(&self, image: &LoggedImage) -> Result<Vec<FileMessage>, SinkError> {
        match self {
            Self::Own => Ok(filed(MessageEncoder::image(image)?).into_iter().collect()),
            Self::Ros2(log) => log.image(image.stamp_ns, image.jpeg.clone()),
        }
    }

    pub(super) fn windows(&self, kept: &PictureWindows) -> Result<Vec<FileMessage>, SinkError> {
        let message = MessageEncoder::windows(kept)?;
        match self {
            Self::Own => Ok(filed(message).into_iter().collect()),
            Self::Ros2(log) => Ok(log.wrapped(Topic::Windows, &message.bytes)?.into_iter().collect()),
        }
    }

    pub(super) fn current(&self, sample: &CurrentSample) -> Result<Vec<FileMessage>, SinkError> {
        let message = MessageEncoder::current(sample)?;
        match self {
            Self::Own => Ok(filed(message).into_iter().collect()),
            Self::Ros2(log) => log.current(&message.bytes, &MessageEncoder::current_message(sample)),
        }
    }

    pub(super) fn totals(&self, encoder: &MessageEncoder, totals: &Totals) -> Result<Vec<FileMessage>, SinkError> {
        let message = encoder.totals(totals)?;
        match self {
            Self::Own => Ok(filed(message).into_iter().collect()),
            Self::Ros2(log) => log.health(&message.bytes, &encoder.health(totals)),
        }
    }
}

fn own(topic: Topic) -> FileTopic {
    FileTopic {
        topic: topic.name().to_owned(),
        schema: topic.schema().map(|schema| (schema.name, schema.encoding, schema.data.into_owned())),
        encoding: ENCODING,
        metadata: BTreeMap::new(),
    }
}

/// All topics are announced, so every topic has an index.
fn filed(message: Message) -> Option<FileMessage> {
    let channel = Topic::ALL.iter().position(|topic| *topic == message.topic)?;
    Some(FileMessage { channel, bytes: message.bytes })
}

/// Those of the project's own that are read back.
const WRAPPED: [Topic; 4] = [Topic::Estimate, Topic::Current, Topic::Windows, Topic::Health];

/// Messages of a log of profile `ros2`: made from the project's own, decoded ones, and the bytes that those were
/// decoded from.
#[derive(Debug)]
pub(crate) struct RosLog {
    encoder: RosEncoder,
}

impl RosLog {
    /// For runs with this rig.
    pub(crate) fn new(rig: &Rig) -> Self {
        Self { encoder: RosEncoder::new(rig) }
    }

    /// Whether messages of this topic are kept, in wrapped form.
    pub(crate) fn keeps(topic: Topic) -> bool {
        WRAPPED.contains(&topic)
    }

    /// All topics; `schema` gives the name and the descriptors of those that are wrapped.
    pub(crate) fn topics(&self, schema: impl Fn(Topic) -> Option<(String, Vec<u8>)>) -> Vec<FileTopic> {
        let announced = |topic: &str, of: RosType, metadata: BTreeMap<String, String>| FileTopic {
            topic: topic.to_owned(),
            schema: Some((of.name(), ros2::SCHEMA_ENCODING.to_owned(), of.definition().into_bytes())),
            encoding: ros2::ENCODING,
            metadata,
        };
        let wrapped = WRAPPED.into_iter().map(|topic| {
            let metadata =
                schema(topic).map_or_else(|| Qos::Sensor.metadata(), |(name, data)| ros2::wrapped(&name, &data));
            announced(topic.name(), RosType::Bytes, metadata)
        });
        let own = self.encoder.topics().iter();
        wrapped.chain(own.map(|topic| announced(&topic.name, topic.of, topic.qos.metadata()))).collect()
    }

    /// The messages written once, with the time of the first frame.
    ///
    /// # Errors
    /// [`SinkError::Encode`], as all here.
    pub(crate) fn rig(&self, stamp_ns: i64) -> Result<Vec<FileMessage>, SinkError> {
        self.filed(self.encoder.rig(stamp_ns)?)
    }

    pub(crate) fn frame(&self, bytes: &[u8], message: &EstimateMessage) -> Result<Vec<FileMessage>, SinkError> {
        self.with(Topic::Estimate, bytes, self.encoder.estimate(message)?)
    }

    pub(crate) fn current(&self, bytes: &[u8], message: &Current) -> Result<Vec<FileMessage>, SinkError> {
        self.with(Topic::Current, bytes, vec![RosEncoder::current(message)?])
    }

    pub(crate) fn health(&self, bytes: &[u8], message: &Health) -> Result<Vec<FileMessage>, SinkError> {
        self.with(Topic::Health, bytes, vec![self.encoder.health(message)?])
    }

    pub(crate) fn image(&self, stamp_ns: i64, jpeg: Vec<u8>) -> Result<Vec<FileMessage>, SinkError> {
        self.filed(self.encoder.image(stamp_ns, jpeg)?)
    }

    /// A wrapped message of the project's own, if its topic is kept.
    pub(crate) fn wrapped(&self, topic: Topic, bytes: &[u8]) -> Result<Option<FileMessage>, SinkError> {
        let Some(channel) = WRAPPED.iter().position(|kept| *kept == topic) else { return Ok(None) };
        let refused = |reason| SinkError::Encode { topic: topic.name(), reason };
        Ok(Some(FileMessage { channel, bytes: ros2::wrap(bytes).map_err(refused)? }))
    }

    fn with(&self, topic: Topic, bytes: &[u8], messages: Vec<RosMessage>) -> Result<Vec<FileMessage>, SinkError> {
        let mut all: Vec<FileMessage> = self.wrapped(topic, bytes)?.into_iter().collect();
        all.extend(self.filed(messages)?);
        Ok(all)
    }

    fn filed(&self, messages: Vec<RosMessage>) -> Result<Vec<FileMessage>, SinkError> {
        let one =
            |message: RosMessage| Ok(FileMessage { channel: WRAPPED.len() + message.topic, bytes: message.cdr()? });
        messages.into_iter().map(one).collect()
    }
}
