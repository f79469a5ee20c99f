//! The ROS 2 messages that are written, as structs: the same fields as in `common_interfaces`, in the same order, which
//! is all that matters in CDR. Their texts are in [`definitions`](super::definitions); `sink::ros2` fills them.

use serde::de::{Error, Visitor};
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::fmt;

/// `builtin_interfaces/Time` and `Duration`: whole seconds, rounded down, and the remaining nanoseconds.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub(crate) struct Time {
    pub sec: i32,
    pub nanosec: u32,
}

impl Time {
    /// Nanoseconds in ROS form: exact, also before zero. `None` beyond 68 years from the clock's zero, which 32 bits
    /// cannot hold.
    pub(crate) fn of_ns(ns: i64) -> Option<Self> {
        const SECOND: i64 = 1_000_000_000;
        let sec = i32::try_from(ns.div_euclid(SECOND)).ok()?;
        Some(Self { sec, nanosec: u32::try_from(ns.rem_euclid(SECOND)).ok()? })
    }

    /// The same in nanoseconds.
    #[cfg(any(test, feature = "ros2"))]
    pub(crate) fn ns(self) -> i64 {
        i64::from(self.sec) * 1_000_000_000 + i64::from(self.nanosec)
    }
}

/// `std_msgs/Header`.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub(crate) struct Header {
    pub stamp: Time,
    pub frame_id: String,
}

/// `std_msgs/ColorRGBA`.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub(crate) struct ColorRGBA {
    pub r: f32,
    pub g: f32,
    pub b: f32,
    pub a: f32,
}

/// `geometry_msgs/Point` and `geometry_msgs/Vector3`, which are the same in CDR.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub(crate) struct Xyz {
    pub x: f64,
    pub y: f64,
    pub z: f64,
}

/// `geometry_msgs/Quaternion`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub(crate) struct Quaternion {
    pub x: f64,
    pub y: f64,
    pub z: f64,
    pub w: f64,
}

/// `geometry_msgs/Pose`, and `geometry_msgs/Transform`, which is the same in CDR.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub(crate) struct Pose {
    pub position: Xyz,
    pub orientation: Quaternion,
}

/// `geometry_msgs/PoseWithCovarianceStamped`; its covariance is row-major: x, y, z, and rotations about the axes of the
/// frame.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct PoseWithCovarianceStamped {
    pub header: Header,
    pub pose: Pose,
    #[serde(serialize_with = "without_length")]
    pub covariance: [f64; 36],
}

/// An array of fixed length; serde supports only up to 32.
fn without_length<S: Serializer>(numbers: &[f64; 36], serializer: S) -> Result<S::Ok, S::Error> {
    use serde::ser::SerializeTuple as _;
    let mut tuple = serializer.serialize_tuple(numbers.len())?;
    numbers.iter().try_for_each(|number| tuple.serialize_element(number))?;
    tuple.end()
}

/// `geometry_msgs/TransformStamped`.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct TransformStamped {
    pub header: Header,
    pub child_frame_id: String,
    pub transform: Pose,
}

/// `tf2_msgs/TFMessage`.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct TFMessage {
    pub transforms: Vec<TransformStamped>,
}

/// `sensor_msgs/RegionOfInterest`.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub(crate) struct RegionOfInterest {
    pub x_offset: u32,
    pub y_offset: u32,
    pub height: u32,
    pub width: u32,
    pub do_rectify: bool,
}

/// `sensor_msgs/CameraInfo`.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct CameraInfo {
    pub header: Header,
    pub height: u32,
    pub width: u32,
    pub distortion_model: String,
    pub d: Vec<f64>,
    pub k: [f64; 9],
    pub r: [f64; 9],
    pub p: [f64; 12],
    pub binning_x: u32,
    pub binning_y: u32,
    pub roi: RegionOfInterest,
}

/// `sensor_msgs/JointState`.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub(crate) struct JointState {
    pub header: Header,
    pub name: Vec<String>,
    pub position: Vec<f64>,
    pub velocity: Vec<f64>,
    pub effort: Vec<f64>,
}

/// `sensor_msgs/CompressedImage`.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub(crate) struct CompressedImage {
    pub header: Header,
    pub format: String,
    pub data: Octets,
}

/// `sensor_msgs/TimeReference`.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct TimeReference {
    pub header: Header,
    pub time_ref: Time,
    pub source: String,
}

/// `visualization_msgs/UVCoordinate`.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct UVCoordinate {
    pub u: f32,
    pub v: f32,
}

/// `visualization_msgs/MeshFile`.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub(crate) struct MeshFile {
    pub filename: String,
    pub data: Octets,
}

/// `visualization_msgs/Marker`.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct Marker {
    pub header: Header,
    pub ns: String,
    pub id: i32,
    pub r#type: i32,
    pub action: i32,
    pub pose: Pose,
    pub scale: Xyz,
    pub color: ColorRGBA,
    pub lifetime: Time,
    pub frame_locked: bool,
    pub points: Vec<Xyz>,
    pub colors: Vec<ColorRGBA>,
    pub texture_resource: String,
    pub texture: CompressedImage,
    pub uv_coordinates: Vec<UVCoordinate>,
    pub text: String,
    pub mesh_resource: String,
    pub mesh_file: MeshFile,
    pub mesh_use_embedded_materials: bool,
}

/// `visualization_msgs/MarkerArray`.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct MarkerArray {
    pub markers: Vec<Marker>,
}

/// `diagnostic_msgs/KeyValue`.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct KeyValue {
    pub key: String,
    pub value: String,
}

/// `diagnostic_msgs/DiagnosticStatus`.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct DiagnosticStatus {
    pub level: u8,
    pub name: String,
    pub message: String,
    pub hardware_id: String,
    pub values: Vec<KeyValue>,
}

/// `diagnostic_msgs/DiagnosticArray`.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct DiagnosticArray {
    pub header: Header,
    pub status: Vec<DiagnosticStatus>,
}

/// `std_msgs/MultiArrayDimension`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct MultiArrayDimension {
    pub label: String,
    pub size: u32,
    pub stride: u32,
}

/// `std_msgs/UInt8MultiArray`.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub(crate) struct UInt8MultiArray {
    pub dim: Vec<MultiArrayDimension>,
    pub data_offset: u32,
    pub data: Octets,
}

/// `uint8[]`, written and read as a whole.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub(crate) struct Octets(pub Vec<u8>);

impl Serialize for Octets {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_bytes(&self.0)
    }
}

impl<'de> Deserialize<'de> for Octets {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Whole;
        impl Visitor<'_> for Whole {
            type Value = Octets;
            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("bytes")
            }
            fn visit_bytes<E: Error>(self, bytes: &[u8]) -> Result<Octets, E> {
                Ok(Octets(bytes.to_vec()))
            }
        }
        deserializer.deserialize_bytes(Whole)
    }
}
