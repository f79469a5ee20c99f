//! [`Listener`]: coil currents from a topic of ROS 2, of type `sensor_msgs/JointState`: the effort of each joint is the
//! current of a coil, and the stamp, unless it is 0, the host's time.
//!
//! Out: lines as senders of datagrams write them, with the coils always in the order of the first message's joints. In
//! builds without the feature `ros2` there is nothing to listen to.

use std::io;

#[cfg(feature = "ros2")]
pub(super) struct Listener {
    subscription: ros2_client::Subscription<crate::log::ros2::messages::JointState>,
    /// Names of the first message's joints.
    names: Vec<String>,
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
        let name = Name::parse(topic).map_err(|error| invalid(format!("is not the name of a topic: {error:?}")))?;
        let context = dds::context(domain, everywhere).map_err(io::Error::other)?;
        let mut node = dds::node(&context, "catoptra_currents").map_err(io::Error::other)?;
        // Best effort is what senders of both kinds serve.
        let profile = QosProfile::subscription_default().history(History::KeepLast { depth: 100 });
        let (package, kind) = RosType::Joints.parts();
        let topic = node.create_topic(&name, MessageTypeName::new(package, kind), &profile);
        let topic = topic.map_err(|error| io::Error::other(error.to_string()))?;
        let subscription = node.create_subscription(&topic, Some(profile));
        let subscription = subscription.map_err(|error| io::Error::other(error.to_string()))?;
        Ok(Self { subscription, names: Vec::new(), _node: node, _context: context })
    }

    /// The next message, if one has come. What cannot be understood gives a line that is no sample.
    pub(super) fn next(&mut self) -> Option<Vec<u8>> {
        match self.subscription.take() {
            Ok(None) => None,
            Ok(Some((joints, _))) => {
                let stamp_ns = joints.header.stamp.ns();
                let host_ns = (stamp_ns != 0).then_some(stamp_ns);
                if self.names.is_empty() {
                    self.names.clone_from(&joints.name);
                }
                let line = match in_order(&self.names, &joints.name, &joints.effort) {
                    Some(current_a) => serde_json::json!({ "current_a": current_a, "host_ns": host_ns }).to_string(),
                    None => format!("a message of the joints {}", joints.name.join(", ")),
                };
                Some(line.into_bytes())
            }
            Err(error) => Some(format!("a message that cannot be read: {error}").into_bytes()),
        }
    }
}

/// The efforts of joints in the order of these names; as they are where there are none. `None` if one is missing.
#[cfg(feature = "ros2")]
fn in_order(names: &[String], joints: &[String], efforts: &[f64]) -> Option<Vec<f64>> {
    if names == joints {
        return Some(efforts.to_vec());
    }
    let effort = |name: &String| efforts.get(joints.iter().position(|joint| joint == name)?).copied();
    if names.len() == joints.len() { names.iter().map(effort).collect() } else { None }
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
    pub(super) fn next(&mut self) -> Option<Vec<u8>> {
        None
    }
}

#[cfg(all(test, feature = "ros2"))]
mod tests {
    use super::*;

    #[test]
    fn coils_keep_their_order_whatever_that_of_the_joints() {
        let names = |text: &str| text.split_whitespace().map(str::to_owned).collect::<Vec<_>>();
        let of = |joints: &str| in_order(&names("x y"), &names(joints), &[0.1, 0.2]);
        assert_eq!((of("x y"), of("y x")), (Some(vec![0.1, 0.2]), Some(vec![0.2, 0.1])));
        assert_eq!((of("x z"), of("x"), of("")), (None, None, None));
        assert_eq!(in_order(&[], &[], &[0.3]), Some(vec![0.3]));
    }
}
