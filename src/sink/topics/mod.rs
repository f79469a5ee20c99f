//! What is told of a run, topic by topic: the same Protobuf messages in the log and to live subscribers.
//!
//! In: estimates (and coil currents), the rig. Out: encoded [`Message`]s, each with its [`Topic`]. Times of messages are the
//! caller's: a log has one more than a subscriber. The table of topics is that of [`McapSink`](super::McapSink).

mod camera;
mod convert;
mod health;
pub mod messages;
mod scene;
mod schema;

use super::{CurrentSample, PictureCount, SinkError};
use crate::estimate::Estimate;
use crate::rig::{Camera, Rig};
use convert::Names;
use foxglove::messages::{CameraCalibration, Color, FrameTransform, ImageAnnotations, SceneUpdate};
use foxglove::{Encode, Schema};
use health::Tally;
use messages::{Current, Deflection, Health, PictureWindows};
use scene::Scene;
use schema::Catoptra;
use std::sync::Arc;

pub(super) use convert::file_time_ns;

/// All messages are Protobuf.
pub(super) const ENCODING: &str = "protobuf";

/// Topic of the pictures' parts.
pub(crate) const WINDOWS: &str = "/camera/windows";

/// A topic.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Topic {
    Estimate,
    Deflection,
    Scene,
    Annotations,
    Calibration,
    Transform,
    Health,
    Current,
    Windows,
}

impl Topic {
    pub(super) const ALL: [Self; 9] = [
        Self::Estimate,
        Self::Deflection,
        Self::Scene,
        Self::Annotations,
        Self::Calibration,
        Self::Transform,
        Self::Health,
        Self::Current,
        Self::Windows,
    ];

    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Estimate => "/catheter/estimate",
            Self::Deflection => "/catheter/deflection",
            Self::Scene => "/scene",
            Self::Annotations => "/camera/annotations",
            Self::Calibration => "/camera/calibration",
            Self::Transform => "/tf",
            Self::Health => "/health",
            Self::Current => "/coil/current",
            Self::Windows => WINDOWS,
        }
    }

    pub(super) fn schema(self) -> Option<Schema> {
        match self {
            Self::Estimate => Catoptra::<messages::Estimate>::get_schema(),
            Self::Deflection => Catoptra::<Deflection>::get_schema(),
            Self::Scene => SceneUpdate::get_schema(),
            Self::Annotations => ImageAnnotations::get_schema(),
            Self::Calibration => CameraCalibration::get_schema(),
            Self::Transform => FrameTransform::get_schema(),
            Self::Health => Catoptra::<Health>::get_schema(),
            Self::Current => Catoptra::<Current>::get_schema(),
            Self::Windows => Catoptra::<PictureWindows>::get_schema(),
        }
    }
}

/// An encoded message.
#[derive(Debug, Clone)]
pub(super) struct Message {
    pub(super) topic: Topic,
    pub(super) bytes: Vec<u8>,
}

impl Message {
    fn of<M: Encode>(topic: Topic, message: &M) -> Result<Self, SinkError> {
        let mut bytes = Vec::with_capacity(message.encoded_len().unwrap_or(0));
        let refused = |reason: M::Error| SinkError::Encode { topic: topic.name(), reason: reason.to_string() };
        message.encode(&mut bytes).map_err(refused)?;
        Ok(Self { topic, bytes })
    }
}

/// Makes messages of estimates.
#[derive(Debug)]
pub(super) struct Teller {
    names: Names,
    camera: Camera,
    colours: Vec<Color>,
    scene: Scene,
    tally: Tally,
}

impl Teller {
    /// For runs with this rig.
    pub(super) fn new(rig: &Rig) -> Self {
        Self {
            names: Names::new(rig),
            camera: rig.camera.clone(),
            colours: camera::colours(rig),
            scene: Scene::new(rig),
            tally: Tally::new(rig),
        }
    }

    /// What holds for the whole run, with the time of a frame.
    pub(super) fn rig(&self, stamp_ns: i64) -> Result<Vec<Message>, SinkError> {
        let calibration = Message::of(Topic::Calibration, &camera::calibration(&self.camera, stamp_ns))?;
        let transform = scene::camera_in_base(&self.names, stamp_ns);
        let transform = transform.map(|transform| Message::of(Topic::Transform, &transform)).transpose()?;
        Ok(std::iter::once(calibration).chain(transform).collect())
    }

    /// What is told of a frame; totals once a second.
    pub(super) fn frame(&mut self, estimate: &Estimate) -> Result<Vec<Message>, SinkError> {
        let annotations = camera::annotations(&self.names, &self.colours, estimate);
        let mut messages = vec![
            Message::of(Topic::Estimate, &Catoptra(self.names.estimate(estimate)))?,
            Message::of(Topic::Deflection, &Catoptra(self.names.deflection(estimate)))?,
            Message::of(Topic::Scene, &self.scene.update(estimate))?,
            Message::of(Topic::Annotations, &annotations)?,
        ];
        if let Some(totals) = self.tally.count(&self.names, estimate) {
            messages.push(Message::of(Topic::Health, &Catoptra(totals.clone()))?);
        }
        Ok(messages)
    }

    /// Currents of the coils.
    pub(super) fn current(sample: &CurrentSample) -> Result<Message, SinkError> {
        let current = Current {
            host_ns: sample.host_ns,
            arrival_ns: sample.arrival_ns,
            seq: sample.seq,
            current_a: sample.current_a.clone(),
        };
        Message::of(Topic::Current, &Catoptra(current))
    }

    /// What was kept of a picture.
    pub(super) fn windows(kept: &PictureWindows) -> Result<Message, SinkError> {
        Message::of(Topic::Windows, &Catoptra(kept.clone()))
    }

    /// Tells of pictures in the totals.
    pub(super) fn count_pictures(&mut self, count: Arc<PictureCount>) {
        self.tally.count_pictures(count);
    }

    /// The totals so far.
    pub(super) fn totals(&mut self) -> Result<Message, SinkError> {
        Message::of(Topic::Health, &Catoptra(self.tally.totals().clone()))
    }
}
