//! Checks of packets whose decoders conceal damage.

use super::container::configuration;
use super::jpeg::Steps;
use super::{ffv1, jpeg};
use ffmpeg_the_third as av;
use std::path::Path;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread;

/// How the packets of a stream can be checked.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum How {
    Not,
    Ffv1,
    Jpeg,
}

/// The check of a stream's packets, which has a thread of its own: packets are checked while others are decoded.
pub(super) struct PacketCheck {
    how: How,
    /// To the thread; `None` when there is nothing to check, or the system gives none.
    jobs: Option<Sender<Job>>,
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
    /// The quantiser steps that it states.
    pub steps: Option<Steps>,
}

impl PacketCheck {
    pub(super) fn of(path: &Path, stream: &av::format::stream::Stream<'_>) -> Self {
        let how = match stream.parameters().id() {
            av::codec::Id::FFV1 if ffv1::has_checksums(&configuration(stream)) == Some(true) => How::Ffv1,
            av::codec::Id::FFV1 => {
                tracing::warn!(
                    "{}: its pictures (FFV1) have no checksums: damage in them cannot be noticed",
                    path.display()
                );
                How::Not
            }
            av::codec::Id::MJPEG => How::Jpeg,
            _ => How::Not,
        };
        if how == How::Not {
            return Self { how, jobs: None };
        }
        let (jobs, taken) = channel::<Job>();
        let check = move || {
            for (packet, answer) in taken {
                // Nobody waits for it after a jump.
                let _ = answer.send(how.examine(&packet));
            }
        };
        let thread = thread::Builder::new().name("check".to_owned()).spawn(check);
        Self { how, jobs: thread.ok().map(|_| jobs) }
    }

    /// Whether it has a thread, so that packets are best given to it some time before their verdicts are needed.
    pub(super) fn has_thread(&self) -> bool {
        self.jobs.is_some()
    }

    /// Begins to check a packet.
    pub(super) fn begin(&self, packet: av::Packet) -> InCheck {
        let packet = Arc::new(packet);
        let (answer, verdict) = channel();
        let sent = self.jobs.as_ref().is_some_and(|jobs| jobs.send((Arc::clone(&packet), answer)).is_ok());
        InCheck { packet, verdict: sent.then_some(verdict) }
    }

    /// The verdict on a packet, as soon as there is one.
    pub(super) fn verdict(&self, InCheck { packet, verdict }: &InCheck) -> Verdict {
        // Without a thread it is checked here.
        let answer = verdict.as_ref().and_then(|verdict| verdict.recv().ok());
        answer.unwrap_or_else(|| self.how.examine(packet))
    }
}

impl How {
    fn examine(self, packet: &av::Packet) -> Verdict {
        let data = packet.data().unwrap_or_default();
        match self {
            Self::Not => Verdict { sound: true, steps: None },
            Self::Ffv1 => Verdict { sound: ffv1::is_sound(data), steps: None },
            Self::Jpeg => {
                let jpeg::Examined { damage, steps } = jpeg::examine(data);
                Verdict { sound: damage.is_none(), steps }
            }
        }
    }
}
