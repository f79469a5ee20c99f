//! [`RosEncoder`]: the ROS 2 messages of a run, for a log of profile `ros2` and for live subscribers.
//!
//! In: the project's own messages ([`crate::log::schema::messages`]) and the rig. Out: [`RosMessage`]s. Metres and
//! radians (REP 103). docs/ros2.md describes the topics, and why each type was chosen.
//!
//! | frame | parent | where |
//! |---|---|---|
//! | `catheter_base_link` | none | the base frame S of the rig |
//! | `camera_link` | `catheter_base_link`, if the rig has a base | the camera: x forward, y to the left, z up |
//! | `camera_optical_frame` | `camera_link` | the camera: x to the right, y down, z forward |
//! | `catheter_NAME_band` | the frame of the poses | marker NAME, when it is located |
//!
//! Poses are in the base frame, or in `camera_optical_frame` if the rig has none. What was not measured has no message,
//! except on `/catheter/deflection`, which has one for every frame, with NaN.

mod diagnostics;
mod geometry;
mod scene;

use super::SinkError;
use crate::log::ros2::messages::{
    CameraInfo, CompressedImage, DiagnosticArray, Header, JointState, MarkerArray, Octets, PoseWithCovarianceStamped,
    RegionOfInterest, TFMessage, Time, TimeReference, TransformStamped,
};
use crate::log::ros2::{Qos, RosType, cdr};
use crate::log::schema::messages::{Current, Estimate, Health};
use crate::rig::{Camera, Rig};
use geometry::{CAMERA_FROM_OPTICAL, oriented, pose_of};
use nalgebra::Isometry3;
use scene::Scene;

/// The base frame.
const BASE_LINK: &str = "catheter_base_link";
/// The camera as a body.
const CAMERA_LINK: &str = "camera_link";
/// The camera with the axes of its pictures.
const OPTICAL_FRAME: &str = "camera_optical_frame";

/// A topic.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct RosTopic {
    /// Its name.
    pub(crate) name: String,
    /// Type of its messages.
    pub(crate) of: RosType,
    /// Its quality of service.
    pub(crate) qos: Qos,
}

/// A message.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct RosMessage {
    /// Index in [`RosEncoder::topics`].
    pub(crate) topic: usize,
    pub(crate) body: Body,
}

/// Content of a message.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Body {
    CameraInfo(Box<CameraInfo>),
    Diagnostics(DiagnosticArray),
    Image(CompressedImage),
    Joints(JointState),
    Markers(MarkerArray),
    Pose(Box<PoseWithCovarianceStamped>),
    Time(TimeReference),
    Transforms(TFMessage),
}

impl RosMessage {
    /// The encoded message, as in a file.
    ///
    /// # Errors
    /// [`SinkError::Encode`].
    pub(crate) fn cdr(&self) -> Result<Vec<u8>, SinkError> {
        let written = match &self.body {
            Body::CameraInfo(body) => cdr(body),
            Body::Diagnostics(body) => cdr(body),
            Body::Image(body) => cdr(body),
            Body::Joints(body) => cdr(body),
            Body::Markers(body) => cdr(body),
            Body::Pose(body) => cdr(body),
            Body::Time(body) => cdr(body),
            Body::Transforms(body) => cdr(body),
        };
        written.map_err(|reason| SinkError::Encode { topic: "ROS 2", reason })
    }
}

// Indices of the topics that every run has; after them comes a pose for each marker.
const TF_STATIC: usize = 0;
const TF: usize = 1;
const CAMERA_INFO: usize = 2;
const IMAGE: usize = 3;
const DEFLECTION: usize = 4;
const MARKERS: usize = 5;
const DIAGNOSTICS: usize = 6;
const CURRENTS: usize = 7;
const CLOCKS: usize = 8;
const FIRST_POSE: usize = 9;

/// Makes the messages.
#[derive(Debug)]
pub(crate) struct RosEncoder {
    topics: Vec<RosTopic>,
    /// Frames of the markers, in the rig's order.
    bands: Vec<String>,
    coil: usize,
    camera: Camera,
    base_from_camera: Option<Isometry3<f64>>,
    scene: Scene,
    /// Whether stamps are the host's, where a frame has them.
    on_host: bool,
}

impl RosEncoder {
    /// For runs with this rig.
    pub(crate) fn new(rig: &Rig) -> Self {
        let names = tokens(rig.markers.iter().map(|marker| marker.name.as_str()));
        let topic = |name: &str, of: RosType, qos: Qos| RosTopic { name: name.to_owned(), of, qos };
        let mut topics = vec![
            topic("/tf_static", RosType::Transforms, Qos::Kept),
            topic("/tf", RosType::Transforms, Qos::Reliable),
            topic("/camera/camera_info", RosType::CameraInfo, Qos::Sensor),
            topic("/camera/image/compressed", RosType::Image, Qos::Sensor),
            topic("/catheter/deflection", RosType::Joints, Qos::Sensor),
            topic("/catheter/markers", RosType::Markers, Qos::Reliable),
            topic("/diagnostics", RosType::Diagnostics, Qos::Reliable),
            topic("/coil/joint_states", RosType::Joints, Qos::Sensor),
            topic("/camera/time_reference", RosType::Time, Qos::Sensor),
        ];
        let pose = |name: &String| topic(&format!("/catheter/{name}/pose"), RosType::Pose, Qos::Sensor);
        topics.extend(names.iter().map(pose));
        Self {
            topics,
            bands: names.iter().map(|name| format!("catheter_{name}_band")).collect(),
            coil: rig.catheter.coil,
            camera: rig.camera.clone(),
            base_from_camera: rig.base.as_ref().map(|base| base.base_from_camera),
            scene: Scene::new(rig),
            on_host: false,
        }
    }

    /// With stamps on the host's clock, as in all live output; in a log they are the camera's.
    #[cfg(feature = "ros2")]
    #[must_use]
    pub(crate) fn on_host_clock(self) -> Self {
        Self { on_host: true, ..self }
    }

    /// The stamp of a frame.
    pub(crate) fn stamp_ns(&self, estimate: &Estimate) -> i64 {
        estimate.host_stamp_ns.filter(|_| self.on_host).unwrap_or(estimate.stamp_ns)
    }

    /// All topics; messages refer to them by index.
    pub(crate) fn topics(&self) -> &[RosTopic] {
        &self.topics
    }

    /// The frame of the poses.
    fn frame(&self) -> &'static str {
        if self.base_from_camera.is_some() { BASE_LINK } else { OPTICAL_FRAME }
    }

    /// The messages that hold for the whole run, with the time of a frame.
    ///
    /// # Errors
    /// [`SinkError::Encode`] when the time is further from the clock's zero than ROS can express.
    pub(crate) fn rig(&self, stamp_ns: i64) -> Result<Vec<RosMessage>, SinkError> {
        let link_from_optical = Isometry3::from_parts(Default::default(), CAMERA_FROM_OPTICAL);
        let transform = |parent: &str, child: &str, place: &Isometry3<f64>| -> Result<TransformStamped, SinkError> {
            Ok(TransformStamped {
                header: header(stamp_ns, parent)?,
                child_frame_id: child.to_owned(),
                transform: pose_of(place),
            })
        };
        let mut transforms = Vec::new();
        if let Some(base_from_optical) = &self.base_from_camera {
            transforms.push(transform(BASE_LINK, CAMERA_LINK, &(base_from_optical * link_from_optical.inverse()))?);
        }
        transforms.push(transform(CAMERA_LINK, OPTICAL_FRAME, &link_from_optical)?);
        let tf = RosMessage { topic: TF_STATIC, body: Body::Transforms(TFMessage { transforms }) };
        Ok(vec![tf, self.camera_info(stamp_ns)?])
    }

    /// The camera, with the time of a frame.
    ///
    /// # Errors
    /// As [`RosEncoder::rig`].
    pub(crate) fn camera_info(&self, stamp_ns: i64) -> Result<RosMessage, SinkError> {
        let lens = &self.camera.lens;
        let [width, height] = self.camera.size_px;
        let info = CameraInfo {
            header: header(stamp_ns, OPTICAL_FRAME)?,
            height,
            width,
            distortion_model: lens.ros_name().to_owned(),
            d: lens.coefficients(),
            k: lens.matrix(),
            r: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
            p: lens.projection_matrix(),
            binning_x: 0,
            binning_y: 0,
            roi: RegionOfInterest::default(),
        };
        Ok(RosMessage { topic: CAMERA_INFO, body: Body::CameraInfo(Box::new(info)) })
    }

    /// The messages of a frame.
    ///
    /// # Errors
    /// As [`RosEncoder::rig`].
    pub(crate) fn estimate(&self, estimate: &Estimate) -> Result<Vec<RosMessage>, SinkError> {
        let header = header(self.stamp_ns(estimate), self.frame())?;
        let angles = deflection(estimate, header.clone());
        let mut messages = vec![RosMessage { topic: DEFLECTION, body: Body::Joints(angles) }];
        let based = self.base_from_camera.is_some();
        let mut transforms = Vec::new();
        for (index, (marker, band)) in estimate.markers.iter().zip(&self.bands).enumerate() {
            let Some(position) = &marker.position else { continue };
            let tangent = estimate.tangent.as_ref().filter(|_| index == self.coil);
            let Some((pose, covariance)) = oriented(position, tangent, based) else { continue };
            let message = PoseWithCovarianceStamped { header: header.clone(), pose, covariance };
            messages.push(RosMessage { topic: FIRST_POSE + index, body: Body::Pose(Box::new(message)) });
            // The coil's frame needs a measured direction.
            if index != self.coil || tangent.is_some() {
                transforms.push(TransformStamped {
                    header: header.clone(),
                    child_frame_id: band.clone(),
                    transform: pose,
                });
            }
        }
        if !transforms.is_empty() {
            messages.push(RosMessage { topic: TF, body: Body::Transforms(TFMessage { transforms }) });
        }
        messages.push(RosMessage { topic: MARKERS, body: Body::Markers(self.scene.markers(estimate, &header, based)) });
        if let Some(host_ns) = estimate.host_stamp_ns {
            messages.push(RosMessage { topic: CLOCKS, body: Body::Time(clocks(estimate, host_ns)?) });
        }
        Ok(messages)
    }

    /// The totals of a run.
    ///
    /// # Errors
    /// As [`RosEncoder::rig`].
    pub(crate) fn health(&self, health: &Health) -> Result<RosMessage, SinkError> {
        let status = diagnostics::status(health, &self.scene.names);
        let header = header(health.stamp_ns, "")?;
        Ok(RosMessage { topic: DIAGNOSTICS, body: Body::Diagnostics(DiagnosticArray { header, status }) })
    }

    /// Currents of the coils: one joint for each, with the current as effort.
    ///
    /// # Errors
    /// As [`RosEncoder::rig`].
    pub(crate) fn current(current: &Current) -> Result<RosMessage, SinkError> {
        let joints = JointState {
            header: header(current.host_ns, "")?,
            name: (1..=current.current_a.len()).map(|n| format!("coil_{n}")).collect(),
            effort: current.current_a.clone(),
            ..JointState::default()
        };
        Ok(RosMessage { topic: CURRENTS, body: Body::Joints(joints) })
    }

    /// A picture for people, with the camera info that viewers expect beside it.
    ///
    /// # Errors
    /// As [`RosEncoder::rig`].
    pub(crate) fn image(&self, stamp_ns: i64, jpeg: Vec<u8>) -> Result<Vec<RosMessage>, SinkError> {
        let header = header(stamp_ns, OPTICAL_FRAME)?;
        let image = CompressedImage { header, format: "jpeg".to_owned(), data: Octets(jpeg) };
        Ok(vec![RosMessage { topic: IMAGE, body: Body::Image(image) }, self.camera_info(stamp_ns)?])
    }
}

fn deflection(estimate: &Estimate, header: Header) -> JointState {
    let angles = estimate.deflection.as_ref();
    let values = angles.map_or([f64::NAN; 4], |a| [a.theta_rad, a.theta_sd_rad, a.polar_rad, a.azimuth_rad]);
    JointState {
        header,
        name: ["theta", "theta_sd", "polar", "azimuth"].map(str::to_owned).to_vec(),
        position: values.to_vec(),
        ..JointState::default()
    }
}

/// Relation of the camera's clock to the host's.
fn clocks(estimate: &Estimate, host_ns: i64) -> Result<TimeReference, SinkError> {
    Ok(TimeReference {
        header: header(host_ns, OPTICAL_FRAME)?,
        time_ref: time(estimate.stamp_ns)?,
        source: estimate.clock.clone(),
    })
}

fn time(ns: i64) -> Result<Time, SinkError> {
    let reason = || {
        let seconds = ns / 1_000_000_000;
        format!(
            "{seconds} s is further from the clock's zero than the 68 years that ROS can say; leave --profile ros2 out"
        )
    };
    Time::of_ns(ns).ok_or_else(|| SinkError::Encode { topic: "ROS 2", reason: reason() })
}

fn header(stamp_ns: i64, frame_id: &str) -> Result<Header, SinkError> {
    Ok(Header { stamp: time(stamp_ns)?, frame_id: frame_id.to_owned() })
}

/// Names made valid for ROS topics: letters, digits and `_`, no digit first; duplicates are numbered.
fn tokens<'a>(names: impl Iterator<Item = &'a str>) -> Vec<String> {
    let mut all: Vec<String> = Vec::new();
    for name in names {
        let mut token: String = name.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '_' }).collect();
        if token.starts_with(|c: char| c.is_ascii_digit()) || token.is_empty() {
            token.insert(0, 'm');
        }
        let token = token.trim_matches('_').to_owned();
        let token = if token.is_empty() { "marker".to_owned() } else { token };
        let numbered = |n: usize| if n == 1 { token.clone() } else { format!("{token}_{n}") };
        let free = (1..=all.len() + 1).map(numbered).find(|name| !all.contains(name));
        all.push(free.unwrap_or(token.clone()));
    }
    all
}

#[cfg(test)]
mod tests;
