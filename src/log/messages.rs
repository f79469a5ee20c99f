//! Messages of a log, decoded by the schemas that travel with it.

use mcap::records::Record;
use prost_reflect::{DescriptorPool, DynamicMessage, MessageDescriptor, Value};
use std::collections::BTreeMap;

/// Schemas and channels met so far.
#[derive(Default)]
pub(crate) struct Known {
    schemas: BTreeMap<u16, (String, Option<MessageDescriptor>)>,
    channels: BTreeMap<u16, Channel>,
}

struct Channel {
    topic: String,
    schema: String,
    descriptor: Option<MessageDescriptor>,
}

impl Known {
    /// Takes a schema or a channel in; other records say nothing new.
    pub(crate) fn learn(&mut self, record: &Record<'_>) {
        match record {
            Record::Schema { header, data } => {
                self.schemas.entry(header.id).or_insert_with(|| {
                    let pool = DescriptorPool::decode(data.as_ref()).ok();
                    (header.name.clone(), pool.and_then(|pool| pool.get_message_by_name(&header.name)))
                });
            }
            Record::Channel(channel) => {
                let (schema, descriptor) = self.schemas.get(&channel.schema_id).cloned().unwrap_or_default();
                let known = || Channel { topic: channel.topic.clone(), schema, descriptor };
                self.channels.entry(channel.id).or_insert_with(known);
            }
            _ => {}
        }
    }

    /// Number, topic and schema of all channels.
    pub(crate) fn channels(&self) -> impl Iterator<Item = (u16, &str, &str)> {
        self.channels.iter().map(|(id, channel)| (*id, channel.topic.as_str(), channel.schema.as_str()))
    }

    /// A message of a channel, if that is of `topic` and its schema fits.
    pub(crate) fn decoded(&self, channel: u16, topic: &str, data: &[u8]) -> Option<DynamicMessage> {
        let channel = self.channels.get(&channel).filter(|channel| channel.topic == topic)?;
        DynamicMessage::decode(channel.descriptor.clone()?, data).ok()
    }
}

/// A whole number; 0 where it is absent, `None` where there is no such field.
pub(crate) fn number(message: &DynamicMessage, field: &str) -> Option<i64> {
    match message.get_field_by_name(field)?.as_ref() {
        Value::I64(n) => Some(*n),
        Value::U64(n) => i64::try_from(*n).ok(),
        Value::U32(n) => Some(i64::from(*n)),
        Value::I32(n) => Some(i64::from(*n)),
        _ => None,
    }
}

/// A text.
pub(crate) fn text(message: &DynamicMessage, field: &str) -> Option<String> {
    message.get_field_by_name(field)?.as_str().map(str::to_owned)
}
