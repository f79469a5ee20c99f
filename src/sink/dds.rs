//! [`RosSink`]: the topics of a log of profile `ros2`, live over DDS, to ROS 2 nodes and to other programs. Pure Rust:
//! no ROS installation is needed.
//!
//! Stamps are on the host's clock; `/camera/time_reference` has the camera's own for every frame. `/tf_static` is kept
//! for late subscribers; `/camera/camera_info` is repeated about once a second. Nothing here waits for a subscriber: a
//! slow one loses messages.
//!
//! Discovery and data use only the loopback interface unless the whole network is requested. What this cannot do: keep
//! out or hide from others on this computer; DDS has no passwords here.

use super::encoder::MessageEncoder;
use super::ros2::{Body, RosEncoder, RosMessage, RosTopic};
use super::{CurrentSample, PictureCount, Sink, SinkError};
use crate::estimate::Estimate;
use crate::log::ros2::messages::{
    CameraInfo, DiagnosticArray, JointState, MarkerArray, PoseWithCovarianceStamped, TFMessage, TimeReference,
};
use crate::log::ros2::{Qos, RosType};
use crate::plural::plural;
use crate::rig::Rig;
use crate::source::Picture;
use crate::tally::{Tally, Totals};
use ros2_client::dds::rustdds::DomainParticipantBuilder;
use ros2_client::dds::{Context, Node, Publisher};
use ros2_client::qos::{Durability, History, WhenFull};
use ros2_client::{MessageTypeName, Name, NodeName, NodeOptions, QosProfile};
use serde::Serialize;
use std::net::{IpAddr, Ipv4Addr};
use std::sync::Arc;

/// Publishes to ROS 2.
pub struct RosSink {
    messages: MessageEncoder,
    encoder: RosEncoder,
    /// In the order of the encoder's topics; `None` for those never published live.
    publishers: Vec<Option<Line>>,
    /// Keep the participant alive.
    _node: Node,
    _context: Context,
    /// Stamp of the last frame, nanoseconds.
    last_ns: Option<i64>,
    /// Messages that could not be sent.
    unsent: u64,
}

enum Line {
    CameraInfo(Publisher<CameraInfo>),
    Diagnostics(Publisher<DiagnosticArray>),
    Joints(Publisher<JointState>),
    Markers(Publisher<MarkerArray>),
    Pose(Publisher<PoseWithCovarianceStamped>),
    Time(Publisher<TimeReference>),
    Transforms(Publisher<TFMessage>),
}

impl Qos {
    fn profile(self) -> QosProfile {
        let profile = QosProfile::publisher_default().history(History::KeepLast { depth: self.depth() });
        match self {
            Self::Sensor => profile.reliability_best_effort().durability(Durability::Volatile),
            // A subscriber that does not acknowledge delays nobody.
            Self::Reliable => profile.reliability_reliable(WhenFull::Fail).durability(Durability::Volatile),
            Self::Kept => profile.reliability_reliable(WhenFull::Fail).durability(Durability::TransientLocal),
        }
    }
}

/// A participant of `domain`: on the loopback interface only, or on all networks.
pub(crate) fn context(domain: u16, everywhere: bool) -> Result<Context, String> {
    let builder = DomainParticipantBuilder::new(domain);
    let builder = if everywhere { builder } else { builder.with_only_networks([IpAddr::V4(Ipv4Addr::LOCALHOST)]) };
    let participant = builder.build().map_err(|error| error.to_string())?;
    Context::from_domain_participant(participant).map_err(|error| error.to_string())
}

/// A node in it.
pub(crate) fn node(context: &Context, name: &str) -> Result<Node, String> {
    let name = NodeName::new("/", name).map_err(|error| format!("{error:?}"))?;
    context.new_node(name, NodeOptions::new().enable_rosout(false)).map_err(|error| format!("{error:?}"))
}

impl RosSink {
    /// Begins to publish in `domain`: to this computer only, or to all networks.
    ///
    /// # Errors
    /// [`SinkError::Ros`] when the system provides no socket.
    pub fn open(domain: u16, everywhere: bool, rig: &Rig) -> Result<Self, SinkError> {
        let encoder = RosEncoder::new(rig).on_host_clock();
        let open = || -> Result<_, String> {
            let context = context(domain, everywhere)?;
            let mut node = node(&context, "catoptra")?;
            let publishers =
                encoder.topics().iter().map(|topic| publisher(&mut node, topic)).collect::<Result<Vec<_>, _>>()?;
            Ok((context, node, publishers))
        };
        let (context, node, publishers) = open().map_err(|reason| SinkError::Ros { domain, reason })?;
        Ok(Self {
            messages: MessageEncoder::new(rig),
            encoder,
            publishers,
            _node: node,
            _context: context,
            last_ns: None,
            unsent: 0,
        })
    }

    /// The count of pictures goes into `/diagnostics`, as in the log's.
    #[must_use]
    pub fn with_picture_count(mut self, count: Arc<PictureCount>) -> Self {
        self.messages.set_picture_count(count);
        self
    }

    fn publish(&mut self, messages: Vec<RosMessage>) {
        for message in messages {
            let Some(Some(line)) = self.publishers.get(message.topic) else { continue };
            let sent = match (line, message.body) {
                (Line::CameraInfo(line), Body::CameraInfo(body)) => sent(line, *body),
                (Line::Diagnostics(line), Body::Diagnostics(body)) => sent(line, body),
                (Line::Joints(line), Body::Joints(body)) => sent(line, body),
                (Line::Markers(line), Body::Markers(body)) => sent(line, body),
                (Line::Pose(line), Body::Pose(body)) => sent(line, *body),
                (Line::Time(line), Body::Time(body)) => sent(line, body),
                (Line::Transforms(line), Body::Transforms(body)) => sent(line, body),
                _ => Ok(()),
            };
            if let Err(reason) = sent {
                self.unsent += 1;
                if self.unsent == 1 {
                    tracing::warn!("a message cannot be sent to ROS 2 ({reason}); more are counted");
                }
            }
        }
    }
}

fn sent<M: Serialize>(line: &Publisher<M>, message: M) -> Result<(), String> {
    line.publish(message).map_err(|error| match error {
        ros2_client::WriteError::WouldBlock { .. } => "a subscriber does not confirm what it gets".to_owned(),
        ros2_client::WriteError::Io(error) => error.to_string(),
        ros2_client::WriteError::Serialization { reason, .. }
        | ros2_client::WriteError::Poisoned { reason, .. }
        | ros2_client::WriteError::Internal { reason }
        | ros2_client::WriteError::Middleware { reason, .. } => reason,
    })
}

fn publisher(node: &mut Node, topic: &RosTopic) -> Result<Option<Line>, String> {
    Ok(Some(match topic.of {
        RosType::CameraInfo => Line::CameraInfo(publisher_of(node, topic)?),
        RosType::Diagnostics => Line::Diagnostics(publisher_of(node, topic)?),
        RosType::Joints => Line::Joints(publisher_of(node, topic)?),
        RosType::Markers => Line::Markers(publisher_of(node, topic)?),
        RosType::Pose => Line::Pose(publisher_of(node, topic)?),
        RosType::Time => Line::Time(publisher_of(node, topic)?),
        RosType::Transforms => Line::Transforms(publisher_of(node, topic)?),
        // Live runs have no pictures and no wrapped messages.
        RosType::Image | RosType::Bytes => return Ok(None),
    }))
}

fn publisher_of<M: Serialize>(node: &mut Node, topic: &RosTopic) -> Result<Publisher<M>, String> {
    let said = |error: &dyn std::fmt::Display| format!("{}: {error}", topic.name);
    let name = Name::parse(&topic.name).map_err(|error| format!("{}: {error:?}", topic.name))?;
    let (package, kind) = topic.of.parts();
    let profile = topic.qos.profile();
    let topic = node.create_topic(&name, MessageTypeName::new(package, kind), &profile).map_err(|e| said(&e))?;
    node.create_publisher(&topic, Some(profile)).map_err(|e| said(&e))
}

impl Sink for RosSink {
    fn write(&mut self, estimate: &Estimate, _: Option<&Picture>) -> Result<(), SinkError> {
        let message = self.messages.estimate(estimate);
        let stamp_ns = self.encoder.stamp_ns(&message);
        let mut messages = if self.last_ns.is_none() { self.encoder.rig(stamp_ns)? } else { Vec::new() };
        self.last_ns = Some(stamp_ns);
        messages.extend(self.encoder.estimate(&message)?);
        self.publish(messages);
        Ok(())
    }

    fn write_current(&mut self, sample: &CurrentSample) -> Result<(), SinkError> {
        let message = RosEncoder::current(&MessageEncoder::current_message(sample))?;
        self.publish(vec![message]);
        Ok(())
    }

    fn write_totals(&mut self, totals: &Totals) -> Result<(), SinkError> {
        let Some(stamp_ns) = self.last_ns else { return Ok(()) };
        let mut health = self.messages.health(totals);
        health.stamp_ns = stamp_ns;
        let messages = vec![self.encoder.health(&health)?, self.encoder.camera_info(stamp_ns)?];
        self.publish(messages);
        Ok(())
    }

    fn finish(&mut self, tally: &Tally) -> Result<(), SinkError> {
        self.write_totals(&tally.totals())?;
        if self.unsent > 0 {
            tracing::warn!("{} could not be sent to ROS 2", plural(self.unsent, "message"));
        }
        Ok(())
    }
}
