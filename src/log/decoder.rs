//! Decodes messages of a log with the schemas stored in it; in logs of profile `ros2` they are unwrapped first.

use super::ros2;
use super::schema::Topic;
use crate::catch_panic::catch_panic;
use mcap::records::Record;
use prost_reflect::{DescriptorPool, DynamicMessage, MessageDescriptor};
use std::collections::BTreeMap;

/// Schemas and channels read so far.
#[derive(Default)]
pub(crate) struct MessageDecoder {
    schemas: BTreeMap<u16, (String, Option<MessageDescriptor>)>,
    channels: BTreeMap<u16, Channel>,
}

struct Channel {
    topic: String,
    schema: String,
    descriptor: Option<MessageDescriptor>,
    /// Whether messages are wrapped in others.
    wrapped: bool,
}

impl MessageDecoder {
    /// Learns from a schema or channel record; others are ignored.
    pub(crate) fn learn(&mut self, record: &Record<'_>) {
        match record {
            Record::Schema { header, data } => {
                self.schemas.entry(header.id).or_insert_with(|| (header.name.clone(), described(&header.name, data)));
            }
            Record::Channel(channel) => {
                let (schema, descriptor) = self.schemas.get(&channel.schema_id).cloned().unwrap_or_default();
                self.channels.entry(channel.id).or_insert_with(|| match ros2::is_wrapped(&channel.metadata) {
                    Some((name, descriptors)) => Channel {
                        topic: channel.topic.clone(),
                        schema: format!("{name} in {schema}"),
                        descriptor: described(name, &descriptors),
                        wrapped: true,
                    },
                    None => Channel { topic: channel.topic.clone(), schema, descriptor, wrapped: false },
                });
            }
            _ => {}
        }
    }

    /// Number, topic and schema of all channels.
    pub(crate) fn channels(&self) -> impl Iterator<Item = (u16, &str, &str)> {
        self.channels.iter().map(|(id, channel)| (*id, channel.topic.as_str(), channel.schema.as_str()))
    }

    /// Topic of a channel.
    pub(crate) fn name(&self, id: u16) -> Option<&str> {
        self.channels.get(&id).map(|channel| channel.topic.as_str())
    }

    /// Topic of a channel, if its messages' schema can be read.
    pub(crate) fn topic(&self, id: u16) -> Option<&str> {
        let channel = self.channels.get(&id)?;
        channel.descriptor.as_ref().map(|_| channel.topic.as_str())
    }

    /// A message of a channel.
    ///
    /// # Errors
    /// Why it cannot be decoded.
    pub(crate) fn decode(&self, channel: u16, data: &[u8]) -> Result<DynamicMessage, String> {
        let known = self.channels.get(&channel).and_then(|channel| Some((channel, channel.descriptor.as_ref()?)));
        let Some((channel, descriptor)) = known else { return Err("its schema cannot be read".to_owned()) };
        if channel.wrapped {
            decode(descriptor, &ros2::unwrap(data).ok_or_else(|| "it is not wrapped as its channel says".to_owned())?)
        } else {
            decode(descriptor, data)
        }
    }

    /// A message of a channel, if the channel is of `topic` and its schema fits.
    pub(crate) fn decoded(&self, channel: u16, topic: Topic, data: &[u8]) -> Option<DynamicMessage> {
        (self.topic(channel)? == topic.name()).then(|| self.decode(channel, data).ok()).flatten()
    }
}

/// The message `name` of these descriptors.
fn described(name: &str, descriptors: &[u8]) -> Option<MessageDescriptor> {
    // The library panics on some inconsistent descriptors.
    catch_panic(|| DescriptorPool::decode(descriptors).ok()?.get_message_by_name(name)).flatten()
}

fn decode(descriptor: &MessageDescriptor, data: &[u8]) -> Result<DynamicMessage, String> {
    catch_panic(|| DynamicMessage::decode(descriptor.clone(), data).map_err(|error| error.to_string()))
        .unwrap_or_else(|| Err("its schema contradicts itself".to_owned()))
}
