//! What packets tell before they are decoded: damage that their decoders conceal, and their quantisers.

use super::container::configuration;
use super::headers::Headers;
use super::quantisation::Stated;
use super::{ffv1, jpeg};
use ffmpeg_the_third as av;
use std::path::Path;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread;

/// What examines a stream's packets.
pub(super) enum Examiner {
    Ffv1,
    Jpeg(jpeg::Examiner),
    Headers(Headers),
}

/// The check of a stream's packets, which has a thread of its own: packets are checked while others are decoded.
pub(super) enum PacketCheck {
    /// There is nothing to check.
    Nothing,
    Thread(Sender<Job>),
    /// The system gives no thread: each is checked when its verdict is needed.
    Here(Examiner),
}

/// A packet, and where the verdict goes.
type Job = (Arc<av::Packet>, Sender<Verdict>);

/// A packet that is being checked.
pub(super) struct InCheck {
    pub packet: Arc<av::Packet>,
    verdict: Option<Receiver<Verdict>>,
}

/// What is known of a packet before it is decoded.
#[derive(Clone, Copy)]
pub(super) struct Verdict {
    pub sound: bool,
    pub stated: Option<Stated>,
}

impl Default for Verdict {
    fn default() -> Self {
        Self { sound: true, stated: None }
    }
}

impl PacketCheck {
    pub(super) fn of(path: &Path, stream: &av::format::stream::Stream<'_>) -> Self {
        let Some(mut examiner) = Examiner::of(path, stream) else { return Self::Nothing };
        let (jobs, taken) = channel::<Job>();
        let check = move || {
            for (packet, answer) in taken {
                // Nobody waits for it after a jump.
                let _ = answer.send(examiner.examine(&packet));
            }
        };
        match thread::Builder::new().name("check".to_owned()).spawn(check) {
            Ok(_) => Self::Thread(jobs),
            Err(_) => Examiner::of(path, stream).map_or(Self::Nothing, Self::Here),
        }
    }

    /// Whether it has a thread, so that packets are best given to it some time before their verdicts are needed.
    pub(super) fn has_thread(&self) -> bool {
        matches!(self, Self::Thread(_))
    }

    /// Begins to check a packet.
    pub(super) fn begin(&self, packet: av::Packet) -> InCheck {
        let packet = Arc::new(packet);
        let Self::Thread(jobs) = self else { return InCheck { packet, verdict: None } };
        let (answer, verdict) = channel();
        let sent = jobs.send((Arc::clone(&packet), answer)).is_ok();
        InCheck { packet, verdict: sent.then_some(verdict) }
    }

    /// The verdict on a packet, as soon as there is one.
    pub(super) fn verdict(&mut self, InCheck { packet, verdict }: &InCheck) -> Verdict {
        match (self, verdict) {
            (Self::Here(examiner), _) => examiner.examine(packet),
            (_, Some(verdict)) => verdict.recv().unwrap_or_default(),
            (_, None) => Verdict::default(),
        }
    }
}

/// Whether a coder predicts pictures from others, and its decoder takes nearly any data for a picture.
fn is_trusting(codec: av::codec::Id) -> bool {
    matches!(
        codec,
        av::codec::Id::HEVC | av::codec::Id::VP8 | av::codec::Id::VP9 | av::codec::Id::AV1 | av::codec::Id::THEORA
    )
}

impl Examiner {
    fn of(path: &Path, stream: &av::format::stream::Stream<'_>) -> Option<Self> {
        let codec = stream.parameters().id();
        if is_trusting(codec) {
            tracing::info!(
                "{}: most damage in pictures of its coder ({}) cannot be noticed, and spreads up to the next key frame",
                path.display(),
                codec.name()
            );
        }
        match codec {
            av::codec::Id::FFV1 if ffv1::has_checksums(&configuration(stream)) == Some(true) => Some(Self::Ffv1),
            av::codec::Id::FFV1 => {
                tracing::warn!(
                    "{}: its pictures (FFV1) have no checksums: damage in them cannot be noticed",
                    path.display()
                );
                None
            }
            av::codec::Id::MJPEG => Some(Self::Jpeg(jpeg::Examiner::default())),
            _ => Headers::of(stream).map(Self::Headers),
        }
    }

    fn examine(&mut self, packet: &av::Packet) -> Verdict {
        let data = packet.data().unwrap_or_default();
        match self {
            Self::Ffv1 => Verdict { sound: ffv1::is_sound(data), stated: None },
            Self::Jpeg(examiner) => {
                let jpeg::Examined { damage, steps } = examiner.examine(data);
                Verdict { sound: damage.is_none(), stated: steps.map(Stated::Jpeg) }
            }
            Self::Headers(headers) => Verdict { sound: true, stated: headers.level(packet).map(Stated::Level) },
        }
    }
}
