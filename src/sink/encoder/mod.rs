//! [`MessageEncoder`]: the messages of a run, topic by topic, the same in the log and to live subscribers.
//!
//! In: estimates, totals and coil currents, and the rig. Out: encoded [`Message`]s, each with its [`Topic`]. The caller
//! sets the times of messages: a log has one more than a subscriber.

mod camera;
mod convert;
mod health;
mod scene;

use super::{CurrentSample, LoggedImage, PictureCount, SinkError};
use crate::estimate::Estimate;
use crate::log::schema::messages::{Current, Estimate as EstimateMessage, Health, PictureWindows};
use crate::log::schema::{Catoptra, Topic};
use crate::rig::{Camera, Rig};
use crate::tally::Totals;
use convert::Names;
use foxglove::Encode;
use foxglove::messages::Color;
use scene::Scene;
use std::sync::Arc;

pub(super) use convert::file_time_ns;

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

/// Makes messages from estimates.
#[derive(Debug)]
pub(super) struct MessageEncoder {
    names: Names,
    camera: Camera,
    colours: Vec<Color>,
    scene: Scene,
    pictures: Option<Arc<PictureCount>>,
}

impl MessageEncoder {
    /// For runs with this rig.
    pub(super) fn new(rig: &Rig) -> Self {
        Self {
            names: Names::new(rig),
            camera: rig.camera.clone(),
            colours: camera::colours(rig),
            scene: Scene::new(rig),
            pictures: None,
        }
    }

    /// Adds this count to the totals.
    pub(super) fn set_picture_count(&mut self, count: Arc<PictureCount>) {
        self.pictures = Some(count);
    }

    /// The messages that hold for the whole run, with the time of a frame.
    pub(super) fn rig(&self, stamp_ns: i64) -> Result<Vec<Message>, SinkError> {
        let calibration = Message::of(Topic::Calibration, &camera::calibration(&self.camera, stamp_ns))?;
        let transform = scene::camera_in_base(&self.names, stamp_ns);
        let transform = transform.map(|transform| Message::of(Topic::Transform, &transform)).transpose()?;
        Ok(std::iter::once(calibration).chain(transform).collect())
    }

    /// The messages of a frame.
    pub(super) fn frame(&self, estimate: &Estimate) -> Result<[Message; 4], SinkError> {
        let annotations = camera::annotations(&self.names, &self.colours, estimate);
        Ok([
            Message::of(Topic::Estimate, &Catoptra(self.names.estimate(estimate)))?,
            Message::of(Topic::Deflection, &Catoptra(self.names.deflection(estimate)))?,
            Message::of(Topic::Scene, &self.scene.update(estimate))?,
            Message::of(Topic::Annotations, &annotations)?,
        ])
    }

    /// All that was measured in a frame, not yet encoded.
    pub(super) fn estimate(&self, estimate: &Estimate) -> EstimateMessage {
        self.names.estimate(estimate)
    }

    /// The same, encoded.
    pub(super) fn encoded(estimate: &EstimateMessage) -> Result<Message, SinkError> {
        Message::of(Topic::Estimate, &Catoptra(estimate.clone()))
    }

    /// The totals of a run, not yet encoded.
    pub(super) fn health(&self, totals: &Totals) -> Health {
        health::health(&self.names, totals, self.pictures.as_deref())
    }

    /// The totals of a run.
    pub(super) fn totals(&self, totals: &Totals) -> Result<Message, SinkError> {
        Message::of(Topic::Health, &Catoptra(self.health(totals)))
    }

    /// Currents of the coils, not yet encoded.
    pub(super) fn current_message(sample: &CurrentSample) -> Current {
        Current {
            host_ns: sample.host_ns,
            arrival_ns: sample.arrival_ns,
            seq: sample.seq,
            current_a: sample.current_a.clone(),
        }
    }

    /// Currents of the coils.
    pub(super) fn current(sample: &CurrentSample) -> Result<Message, SinkError> {
        Message::of(Topic::Current, &Catoptra(Self::current_message(sample)))
    }

    /// A picture for people.
    pub(super) fn image(image: &LoggedImage) -> Result<Message, SinkError> {
        Message::of(Topic::Image, &camera::image(image))
    }

    /// The recorded windows of a picture.
    pub(super) fn windows(kept: &PictureWindows) -> Result<Message, SinkError> {
        Message::of(Topic::Windows, &Catoptra(kept.clone()))
    }
}
