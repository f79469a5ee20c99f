//! The format of a log of profile `ros2`: an MCAP file whose messages are all CDR, with their definitions, as in
//! rosbag2.
//!
//! Its topics are ROS's own ([`RosType`], made by `sink::ros2`), and those of [`super::schema`] that are read back,
//! each message [wrapped](wrap) into a `std_msgs/UInt8MultiArray`: rosbag2 refuses files in which some messages are not
//! CDR. The metadata of the channel say what the bytes are.

mod definitions;
pub(crate) mod messages;

use crate::catch_panic::catch_panic;
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD as BASE64;
use cdr_encoding::{from_bytes, to_writer};
use messages::{Octets, UInt8MultiArray};
use serde::Serialize;
use std::collections::BTreeMap;

/// The file's profile.
pub(crate) const PROFILE: &str = "ros2";
/// Encoding of messages.
pub(crate) const ENCODING: &str = "cdr";
/// Encoding of schemas.
pub(crate) const SCHEMA_ENCODING: &str = "ros2msg";

/// Before every message: CDR, little endian, no options.
const LITTLE_ENDIAN: [u8; 4] = [0, 1, 0, 0];

/// In the metadata of a channel: the quality of service offered.
const QOS_KEY: &str = "offered_qos_profiles";
/// In the metadata of a channel whose messages are wrapped: the Protobuf message in them,
const WRAPPED_KEY: &str = "catoptra.protobuf.message";
/// and its descriptors, in base64.
const DESCRIPTORS_KEY: &str = "catoptra.protobuf.descriptors";

/// A type of message.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum RosType {
    Bytes,
    CameraInfo,
    Diagnostics,
    Image,
    Joints,
    Markers,
    Pose,
    Time,
    Transforms,
}

impl RosType {
    /// Package and name.
    pub(crate) fn parts(self) -> (&'static str, &'static str) {
        match self {
            Self::Bytes => ("std_msgs", "UInt8MultiArray"),
            Self::CameraInfo => ("sensor_msgs", "CameraInfo"),
            Self::Diagnostics => ("diagnostic_msgs", "DiagnosticArray"),
            Self::Image => ("sensor_msgs", "CompressedImage"),
            Self::Joints => ("sensor_msgs", "JointState"),
            Self::Markers => ("visualization_msgs", "MarkerArray"),
            Self::Pose => ("geometry_msgs", "PoseWithCovarianceStamped"),
            Self::Time => ("sensor_msgs", "TimeReference"),
            Self::Transforms => ("tf2_msgs", "TFMessage"),
        }
    }

    /// Name of its schema.
    pub(crate) fn name(self) -> String {
        let (package, name) = self.parts();
        format!("{package}/msg/{name}")
    }

    /// Its whole definition.
    pub(crate) fn definition(self) -> String {
        let (package, name) = self.parts();
        definitions::whole(&format!("{package}/{name}"))
    }
}

/// Quality of service of a topic.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Qos {
    /// For sensors: lost messages are not sent again.
    Sensor,
    /// Lost messages are sent again: transform listeners, RViz and the diagnostics require it.
    Reliable,
    /// As [`Qos::Reliable`], and the last message is kept for late subscribers.
    Kept,
}

impl Qos {
    /// How many messages are kept until they are sent.
    pub(crate) fn depth(self) -> usize {
        match self {
            Self::Sensor => 10,
            Self::Reliable => 100,
            Self::Kept => 1,
        }
    }

    /// In the form of a channel's metadata.
    pub(crate) fn metadata(self) -> BTreeMap<String, String> {
        // As numbers, which all versions can read: 1 is keep last, reliable, transient local, automatic; 2 is best
        // effort, volatile.
        let (reliability, durability) = match self {
            Self::Sensor => (2, 2),
            Self::Reliable => (1, 2),
            Self::Kept => (1, 1),
        };
        let depth = self.depth();
        let forever = "\n    sec: 9223372036\n    nsec: 854775807";
        let text = format!(
            "- history: 1\n  depth: {depth}\n  reliability: {reliability}\n  durability: {durability}\n  \
             deadline:{forever}\n  lifespan:{forever}\n  liveliness: 1\n  liveliness_lease_duration:{forever}\n  \
             avoid_ros_namespace_conventions: false\n"
        );
        BTreeMap::from([(QOS_KEY.to_owned(), text)])
    }
}

/// A message in CDR.
///
/// # Errors
/// Why it cannot be written.
pub(crate) fn cdr<M: Serialize>(message: &M) -> Result<Vec<u8>, String> {
    let mut bytes = LITTLE_ENDIAN.to_vec();
    to_writer::<_, byteorder::LittleEndian, _>(&mut bytes, message).map_err(|error| error.to_string())?;
    Ok(bytes)
}

/// A Protobuf message in a `std_msgs/UInt8MultiArray`.
///
/// # Errors
/// As [`cdr`].
pub(crate) fn wrap(protobuf: &[u8]) -> Result<Vec<u8>, String> {
    cdr(&UInt8MultiArray { data: Octets(protobuf.to_vec()), ..UInt8MultiArray::default() })
}

/// The Protobuf message in one that was [wrapped](wrap); `None` if it was not.
pub(crate) fn unwrap(message: &[u8]) -> Option<Vec<u8>> {
    let (head, body) = message.split_first_chunk::<4>()?;
    let little = match head {
        [0, 1, _, _] => true,
        [0, 0, _, _] => false,
        _ => return None,
    };
    let array = catch_panic(|| match little {
        true => from_bytes::<UInt8MultiArray, byteorder::LittleEndian>(body),
        false => from_bytes::<UInt8MultiArray, byteorder::BigEndian>(body),
    });
    let (array, _) = array?.ok()?;
    let offset = usize::try_from(array.data_offset).ok()?;
    if offset == 0 { Some(array.data.0) } else { array.data.0.get(offset..).map(<[u8]>::to_vec) }
}

/// Metadata of a channel of wrapped messages: their type and its descriptors.
pub(crate) fn wrapped(message: &str, descriptors: &[u8]) -> BTreeMap<String, String> {
    let mut metadata = Qos::Sensor.metadata();
    metadata.insert(WRAPPED_KEY.to_owned(), message.to_owned());
    metadata.insert(DESCRIPTORS_KEY.to_owned(), BASE64.encode(descriptors));
    metadata
}

/// The type and descriptors that [`wrapped`] recorded for a channel, if its messages are wrapped.
pub(crate) fn is_wrapped(metadata: &BTreeMap<String, String>) -> Option<(&str, Vec<u8>)> {
    Some((metadata.get(WRAPPED_KEY)?, BASE64.decode(metadata.get(DESCRIPTORS_KEY)?).ok()?))
}

#[cfg(test)]
mod tests {
    use super::*;
    use messages::{Header, JointState, Time};

    #[test]
    fn times_before_zero_are_exact() {
        let time = |ns| Time::of_ns(ns).unwrap();
        assert_eq!(time(-5), Time { sec: -1, nanosec: 999_999_995 });
        assert_eq!(time(1_795_188_826_788_000_001), Time { sec: 1_795_188_826, nanosec: 788_000_001 });
        for ns in [-1_000_000_000, -5, 0, 16_666_667, 2_147_483_647_999_999_999] {
            assert_eq!(time(ns).ns(), ns);
        }
        assert_eq!(Time::of_ns(2_147_483_648_000_000_000), None);
    }

    #[test]
    fn what_is_wrapped_comes_out_again() {
        for bytes in [vec![], vec![7], (0..=255).collect::<Vec<u8>>()] {
            assert_eq!(unwrap(&wrap(&bytes).unwrap()).unwrap(), bytes);
        }
        let metadata = wrapped("catoptra.Estimate", &[1, 2, 250]);
        assert_eq!(is_wrapped(&metadata), Some(("catoptra.Estimate", vec![1, 2, 250])));
        assert_eq!(is_wrapped(&Qos::Kept.metadata()), None);
    }

    #[test]
    fn what_was_not_wrapped_is_refused() {
        let mut whole = wrap(&[1, 2, 3]).unwrap();
        assert_eq!(unwrap(&whole[..whole.len() - 1]), None);
        assert_eq!(unwrap(&[]), None);
        assert_eq!(unwrap(&[9, 9, 9, 9, 0, 0]), None);
        // A length beyond the end.
        whole[12] = 0xff;
        assert_eq!(unwrap(&whole), None);
    }

    /// By hand, from the specification: alignment counts from after the first four bytes.
    #[test]
    fn a_message_has_the_bytes_that_the_specification_has() {
        let message = JointState {
            header: Header { stamp: Time { sec: 1, nanosec: 2 }, frame_id: "ab".to_owned() },
            name: vec!["θ".to_owned()],
            position: vec![1.0],
            ..JointState::default()
        };
        let expected = [
            &[0, 1, 0, 0][..],
            &[1, 0, 0, 0, 2, 0, 0, 0],
            &[3, 0, 0, 0, b'a', b'b', 0, 0],
            &[1, 0, 0, 0, 3, 0, 0, 0, 0xce, 0xb8, 0, 0],
            // One number, at a multiple of eight.
            &[1, 0, 0, 0],
            &[0, 0, 0, 0, 0, 0, 0xf0, 0x3f],
            &[0, 0, 0, 0, 0, 0, 0, 0],
        ]
        .concat();
        assert_eq!(cdr(&message).unwrap(), expected);
    }
}
