//! What packets tell before they are decoded: damage that their decoders conceal, pictures that are missing before
//! them, and their quantisers.

use super::container::configuration;
use super::headers::{Header, Headers};
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

/// What the check's thread is to do.
pub(super) enum Job {
    /// Examine a packet; where the verdict goes.
    Examine(Arc<av::Packet>, Sender<Verdict>),
    /// The next packet is read from elsewhere in the stream.
    Jump,
}

/// A packet that is being checked.
pub(super) struct InCheck {
    pub packet: Arc<av::Packet>,
    verdict: Option<Receiver<Verdict>>,
}

/// What is known of a packet before it is decoded.
#[derive(Clone, Copy)]
pub(super) struct Verdict {
    pub sound: bool,
    /// A picture is missing before it that others are predicted from.
    pub skips_numbers: bool,
    pub stated: Option<Stated>,
}

impl Default for Verdict {
    fn default() -> Self {
        Self { sound: true, skips_numbers: false, stated: None }
    }
}

impl PacketCheck {
    pub(super) fn of(path: &Path, stream: &av::format::stream::Stream<'_>) -> Self {
        let Some(mut examiner) = Examiner::of(path, stream) else { return Self::Nothing };
        let (jobs, taken) = channel::<Job>();
        let check = move || {
            for job in taken {
                match job {
                    // Nobody waits for it after a jump.
                    Job::Examine(packet, answer) => _ = answer.send(examiner.examine(&packet)),
                    Job::Jump => examiner.jump(),
                }
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
        let sent = jobs.send(Job::Examine(Arc::clone(&packet), answer)).is_ok();
        InCheck { packet, verdict: sent.then_some(verdict) }
    }

    /// The next packet is read from elsewhere in the stream.
    pub(super) fn jump(&mut self) {
        match self {
            Self::Nothing => {}
            // A thread that has ended checks nothing any more.
            Self::Thread(jobs) => _ = jobs.send(Job::Jump),
            Self::Here(examiner) => examiner.jump(),
        }
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

/// Whether a coder keeps pictures nearly as they are, and its decoder takes any data for a picture: a changed bit
/// spoils a block, a row or all that follows it. (One in raw pictures changes one sample.)
fn has_no_check(codec: av::codec::Id) -> bool {
    use av::codec::Id;
    matches!(codec, Id::HUFFYUV | Id::FFVHUFF | Id::UTVIDEO | Id::MAGICYUV | Id::LJPEG | Id::QTRLE | Id::CFHD)
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
            _ if codec == av::codec::Id::FFV1 || has_no_check(codec) => {
                let name = codec.name().to_ascii_uppercase();
                tracing::warn!(
                    "{}: its pictures ({name}) have no checksums: damage in them cannot be noticed",
                    path.display()
                );
                None
            }
            av::codec::Id::MJPEG => Some(Self::Jpeg(jpeg::Examiner::default())),
            _ => Headers::of(stream).map(Self::Headers),
        }
    }

    fn jump(&mut self) {
        if let Self::Headers(headers) = self {
            headers.jump();
        }
    }

    fn examine(&mut self, packet: &av::Packet) -> Verdict {
        let data = packet.data().unwrap_or_default();
        match self {
            Self::Ffv1 => Verdict { sound: ffv1::is_sound(data), ..Verdict::default() },
            Self::Jpeg(examiner) => {
                let jpeg::Examined { damage, steps } = examiner.examine(data);
                Verdict { sound: damage.is_none(), stated: steps.map(Stated::Jpeg), ..Verdict::default() }
            }
            Self::Headers(headers) => {
                let Header { level, skips_numbers } = headers.of_packet(packet);
                Verdict { sound: true, skips_numbers, stated: level.map(Stated::Level) }
            }
        }
    }
}
