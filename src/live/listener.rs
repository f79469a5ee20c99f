//! [`Listener`]: coil currents from a topic of ROS 2, of type `sensor_msgs/JointState`: the effort of each joint is the
//! current of a coil, and the stamp, unless it is 0, the host's time.
//!
//! Out: lines as senders of datagrams write them. In builds without the feature `ros2` there is nothing to listen to.

use std::io;

#[cfg(feature = "ros2")]
pub(super) struct Listener {
    subscription: ros2_client::Subscription<crate::log::ros2::messages::JointState>,
    /// Keep the participant alive.
    _node: ros2_client::Node,
    _context: ros2_client::Context,
}

#[cfg(feature = "ros2")]
impl Listener {
    /// Begins to listen.
    ///
    /// # Errors
    /// When the name is none of a topic, or the system gives no socket.
    pub(super) fn open(topic: &str, domain: u16, everywhere: bool) -> io::Result<Self> {
        use crate::log::ros2::RosType;
        use crate::sink::dds;
        use ros2_client::qos::History;
        use ros2_client::{MessageTypeName, Name, QosProfile};
        let invalid = |what: String| io::Error::new(io::ErrorKind::InvalidData, format!("{topic}: {what}"));
        let name = Name::parse(topic).map_err(|error| invalid(format!("is no name of a topic: {error:?}")))?;
        let context = dds::context(domain, everywhere).map_err(io::Error::other)?;
        let mut node = dds::node(&context, "catoptra_currents").map_err(io::Error::other)?;
        // Best effort is what senders of both kinds serve.
        let profile = QosProfile::subscription_default().history(History::KeepLast { depth: 100 });
        let (package, kind) = RosType::Joints.parts();
        let topic = node.create_topic(&name, MessageTypeName::new(package, kind), &profile);
        let topic = topic.map_err(|error| io::Error::other(error.to_string()))?;
        let subscription = node.create_subscription(&topic, Some(profile));
        let subscription = subscription.map_err(|error| io::Error::other(error.to_string()))?;
        Ok(Self { subscription, _node: node, _context: context })
    }

    /// The next message, if one has come. What cannot be understood gives a line that is no sample.
    pub(super) fn next(&self) -> Option<Vec<u8>> {
        match self.subscription.take() {
            Ok(None) => None,
            Ok(Some((joints, _))) => {
                let stamp_ns = joints.header.stamp.ns();
                let host_ns = (stamp_ns != 0).then_some(stamp_ns);
                let line = serde_json::json!({ "current_a": joints.effort, "host_ns": host_ns });
                Some(line.to_string().into_bytes())
            }
            Err(error) => Some(format!("a message that cannot be read: {error}").into_bytes()),
        }
    }
}

#[cfg(not(feature = "ros2"))]
pub(super) struct Listener;

#[cfg(not(feature = "ros2"))]
impl Listener {
    pub(super) fn open(topic: &str, _: u16, _: bool) -> io::Result<Self> {
        let text = format!("{topic}: this build knows no ROS 2; build with `cargo build --release --features ros2`");
        Err(io::Error::new(io::ErrorKind::InvalidData, text))
    }

    #[expect(clippy::unused_self, reason = "as in builds that have it")]
    pub(super) fn next(&self) -> Option<Vec<u8>> {
        None
    }
}
