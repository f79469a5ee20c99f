//! Messages of a log, decoded by the schemas that travel with it.

use super::schema::Topic;
use crate::contained::contained;
use mcap::records::Record;
use prost_reflect::{DescriptorPool, DynamicMessage, MessageDescriptor};
use std::collections::BTreeMap;

/// Schemas and channels met so far.
#[derive(Default)]
pub(crate) struct MessageDecoder {
    schemas: BTreeMap<u16, (String, Option<MessageDescriptor>)>,
    channels: BTreeMap<u16, Channel>,
}

struct Channel {
    topic: String,
    schema: String,
    descriptor: Option<MessageDescriptor>,
}

impl MessageDecoder {
    /// Takes a schema or a channel in; other records say nothing new.
    pub(crate) fn learn(&mut self, record: &Record<'_>) {
        match record {
            Record::Schema { header, data } => {
                self.schemas.entry(header.id).or_insert_with(|| {
                    // The library panics on some descriptors that contradict themselves.
                    let descriptor = contained(|| {
                        let pool = DescriptorPool::decode(data.as_ref()).ok()?;
                        pool.get_message_by_name(&header.name)
                    });
                    (header.name.clone(), descriptor.flatten())
                });
            }
            Record::Channel(channel) => {
                let (schema, descriptor) = self.schemas.get(&channel.schema_id).cloned().unwrap_or_default();
                let channel_of = || Channel { topic: channel.topic.clone(), schema, descriptor };
                self.channels.entry(channel.id).or_insert_with(channel_of);
            }
            _ => {}
        }
    }

    /// Number, topic and schema of all channels.
    pub(crate) fn channels(&self) -> impl Iterator<Item = (u16, &str, &str)> {
        self.channels.iter().map(|(id, channel)| (*id, channel.topic.as_str(), channel.schema.as_str()))
    }

    /// Topic and type of the messages of a channel, if its schema can be read.
    pub(crate) fn channel(&self, id: u16) -> Option<(&str, &MessageDescriptor)> {
        let channel = self.channels.get(&id)?;
        Some((channel.topic.as_str(), channel.descriptor.as_ref()?))
    }

    /// A message of a channel, if that is of `topic` and its schema fits.
    pub(crate) fn decoded(&self, channel: u16, topic: Topic, data: &[u8]) -> Option<DynamicMessage> {
        let (_, descriptor) = self.channel(channel).filter(|(of, _)| *of == topic.name())?;
        decode(descriptor, data).ok()
    }
}

/// A message of this type.
///
/// # Errors
/// Why it is none.
pub(crate) fn decode(descriptor: &MessageDescriptor, data: &[u8]) -> Result<DynamicMessage, String> {
    contained(|| DynamicMessage::decode(descriptor.clone(), data).map_err(|error| error.to_string()))
        .unwrap_or_else(|| Err("its schema contradicts itself".to_owned()))
}
