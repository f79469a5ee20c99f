//! Checks of packets whose decoders conceal damage.

use super::container::configuration;
use super::{ffv1, jpeg};
use ffmpeg_the_third as av;
use std::panic::resume_unwind;
use std::path::Path;
use std::thread;

/// How the packets of a stream can be checked.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum How {
    Not,
    Ffv1,
    Jpeg,
}

/// The check of a stream's packets.
#[derive(Debug, Clone, Copy)]
pub(super) struct PacketCheck {
    how: How,
    /// Whether it has a thread of its own, beside the decoder's.
    beside: bool,
}

/// A packet that was checked, and given to the decoder.
pub(super) struct Checked {
    pub sound: bool,
    /// The quantiser step that it states.
    pub step: Option<f64>,
    /// What the decoder says.
    pub sent: Result<(), av::Error>,
}

impl PacketCheck {
    /// That of a stream whose decoder may have this many threads, 0 for one per core.
    pub(super) fn of(path: &Path, stream: &av::format::stream::Stream<'_>, threads: usize) -> Self {
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
        Self { how, beside: threads != 1 && how != How::Not }
    }

    /// Checks a packet, and gives it to its decoder.
    pub(super) fn send(self, packet: &av::Packet, decoder: &mut av::decoder::Video) -> Checked {
        let data = packet.data().unwrap_or_default();
        let examine = || self.examine(data);
        if !self.beside {
            let (sound, step) = examine();
            return Checked { sound, step, sent: decoder.send_packet(packet) };
        }
        thread::scope(|scope| {
            let own = thread::Builder::new().spawn_scoped(scope, examine);
            let sent = decoder.send_packet(packet);
            let (sound, step) = match own {
                Ok(own) => own.join().unwrap_or_else(|panic| resume_unwind(panic)),
                Err(_) => examine(),
            };
            Checked { sound, step, sent }
        })
    }

    /// Whether the packet is sound, and the quantiser step that it states.
    fn examine(self, packet: &[u8]) -> (bool, Option<f64>) {
        match self.how {
            How::Not => (true, None),
            How::Ffv1 => (ffv1::is_sound(packet), None),
            How::Jpeg => {
                let jpeg::Examined { damage, step } = jpeg::examine(packet);
                (damage.is_none(), step)
            }
        }
    }
}
