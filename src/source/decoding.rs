//! A recording's pictures as libav decodes them: in the order of presentation, with what is known of their damage.
//!
//! In: the packets of a container (`packets`). Out: decoded frames, the times of packets that gave none, and what their
//! packets state. Which of them are passed on, and when they were taken, `file` decides.

use super::check::Verdict;
use super::container::{MAX_REORDERED, is_raw, open_decoder};
use super::damage::DamageLog;
use super::decoded::{is_damaged, is_left_out};
use super::headers::skips_numbers;
use super::messages::{Messages, Said};
use super::packets::{Packets, Read};
use super::quantisation::Stated;
use super::turns::{self, Turn, Turns};
use super::{Clock, SourceError};
use crate::plural::plural;
use ffmpeg_the_third as av;
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// Most damaged packets whose pictures are awaited.
const MAX_UNDECODED: usize = 1000;
/// Unreadable packets in a row after which the rest is given up.
const UNREADABLE: u32 = 1000;
/// How long a stream may go on without a picture that can be decoded. Key frames are mostly 1 to 10 s apart.
const KEY_FRAME_TIMEOUT: Duration = Duration::from_secs(20);

/// A picture out of the decoder.
pub(super) struct Decoded {
    pub frame: av::frame::Video,
    /// In the damage log.
    number: u64,
    /// Its presentation time: its own, or that of its turn.
    pub time: Option<i64>,
    /// Whether it has none of its own.
    pub in_turn: bool,
    /// The last packet whose loss would give it another turn.
    overtaken_up_to: u64,
    /// Whether none that is shown before it can be missing at the end.
    overtaken_in_full: bool,
}

impl Decoded {
    /// Its presentation time, or libav's guess.
    pub(super) fn pts(&self) -> Option<i64> {
        self.time.or(self.frame.timestamp())
    }
}

fn time_of(frame: &av::frame::Video) -> Option<i64> {
    frame.pts().or(frame.timestamp())
}

/// A decoder of these packets.
fn decoder_for(packets: &Packets, threads: usize) -> Result<av::decoder::Video, SourceError> {
    open_decoder(&packets.path, &packets.stream()?, threads, packets.clock == Clock::Stream)
}

/// The pictures of a stream.
pub(super) struct Decoding {
    pub packets: Packets,
    threads: usize,
    decoder: av::decoder::Video,
    damage: DamageLog,
    messages: Messages,
    /// What packets whose pictures have not been decoded yet state of their quantisers.
    stated: BTreeMap<i64, Stated>,
    /// Times of damaged packets that have given no picture yet.
    undecoded: BTreeSet<i64>,
    /// Times of a recording's packets before the first picture; `None` once that has come, and after a jump.
    before_first: Option<BTreeSet<i64>>,
    /// Decoded pictures not judged yet.
    held: VecDeque<Decoded>,
    /// No more packets: the decoder is being drained.
    draining: bool,
    /// Live: set when no more packets are wanted.
    pub stop: Arc<AtomicBool>,
    /// How many packets could not be read or decoded.
    pub damaged_packets: u64,
    /// Pictures of packets without presentation times take their places in turn.
    turns: Turns,
    /// Live: there is no picture yet.
    awaits_first: bool,
}

impl Decoding {
    /// Of the best video stream of `input`. That of a [`Clock::Stream`] is live: frames leave the decoder at once.
    ///
    /// # Errors
    /// When there is none, or it cannot be decoded.
    pub(super) fn new(
        path: PathBuf,
        input: av::format::context::Input,
        threads: usize,
        clock: Clock,
    ) -> Result<Self, SourceError> {
        let packets = Packets::new(path, input, clock)?;
        let stream = packets.stream()?;
        let damage = DamageLog::new(skips_numbers(&stream), stream.parameters().id() == av::codec::Id::HEVC);
        Ok(Self {
            decoder: decoder_for(&packets, threads)?,
            packets,
            threads,
            damage,
            messages: Messages::default(),
            stated: BTreeMap::new(),
            undecoded: BTreeSet::new(),
            before_first: (clock == Clock::Container).then(BTreeSet::new),
            held: VecDeque::new(),
            draining: false,
            stop: Arc::default(),
            damaged_packets: 0,
            turns: Turns::default(),
            awaits_first: clock == Clock::Stream,
        })
    }

    pub(super) fn decoder(&self) -> &av::decoder::Video {
        &self.decoder
    }

    /// Jumps to the last key frame before a time of the container, microseconds; returns whether the input can.
    pub(super) fn seek(&mut self, to_us: i64) -> bool {
        if !self.packets.seek(to_us) {
            return false;
        }
        self.decoder.flush();
        self.forget();
        self.before_first = None;
        true
    }

    /// Starts again from the beginning.
    ///
    /// # Errors
    /// When the file cannot be opened any more.
    pub(super) fn restart(&mut self) -> Result<(), SourceError> {
        self.packets.restart()?;
        self.decoder = decoder_for(&self.packets, self.threads)?;
        self.forget();
        self.before_first = Some(BTreeSet::new());
        Ok(())
    }

    /// Forgets what was read.
    fn forget(&mut self) {
        self.damage.forget();
        self.messages = Messages::default();
        self.stated.clear();
        self.undecoded.clear();
        self.held.clear();
        self.turns = Turns::default();
        self.draining = false;
    }

    /// Gives back a picture of [`Self::next_picture`], to be the next one.
    pub(super) fn put_back(&mut self, picture: Decoded) {
        self.held.push_front(picture);
    }

    /// Whether a picture is sound, as far as known by now.
    pub(super) fn is_sound(&self, picture: &Decoded) -> bool {
        let misplaced = self.damage.has_failed(picture.number + 1..=picture.overtaken_up_to);
        self.damage.is_sound(picture.number, picture.pts()) && !misplaced && !self.may_lack_before(picture)
    }

    /// Whether packets that are missing at the end may have given pictures that are shown before this one. No raw
    /// stream tells that it ends early.
    pub(super) fn may_lack_before(&self, picture: &Decoded) -> bool {
        let is_recording = self.packets.clock == Clock::Container;
        let may_end_early = is_raw(self.packets.input()) || self.packets.ends_early.is_some();
        // What is shown before this one is shown before those after it, too.
        let is_complete = picture.overtaken_in_full || self.held.iter().any(|after| after.overtaken_in_full);
        let last = self.damage.number_before(0);
        self.draining && is_recording && may_end_early && picture.overtaken_up_to > last && !is_complete
    }

    /// The time of a damaged packet that gave no picture, if there is one before `pts`; each is returned once.
    pub(super) fn failed_before(&mut self, pts: Option<i64>) -> Option<i64> {
        // At a cut the last packets are expected to be broken.
        let pts = pts.filter(|pts| *pts != i64::MAX || self.packets.ends_early.is_none())?;
        let first = self.undecoded.first().copied().filter(|first| *first < pts)?;
        self.undecoded.remove(&first);
        Some(first)
    }

    /// What the packet of a picture stated of its quantiser.
    pub(super) fn stated_of(&mut self, picture: &Decoded) -> Option<Stated> {
        self.stated.remove(&time_of(&picture.frame)?)
    }

    /// The next frame out of the decoder; `None` when it has no more.
    fn decode(&mut self) -> Option<av::frame::Video> {
        let mut frame = av::frame::Video::empty();
        loop {
            let received = self.decoder.receive_frame(&mut frame);
            self.listen();
            match received {
                Ok(()) => {
                    self.awaits_first = false;
                    return Some(frame);
                }
                Err(av::Error::Eof) => return None,
                Err(av::Error::Other { .. }) if !self.draining => self.feed(),
                // While draining, a decoder that wants more input has no more frames.
                Err(av::Error::Other { .. }) => return None,
                Err(error) => self.damaged_packet(error, true),
            }
        }
    }

    /// Notes what the decoder said of its packets.
    fn listen(&mut self) {
        for (number, said) in self.messages.take() {
            self.damage.heard(number, said);
        }
    }

    /// The next frame in presentation order. The last ones wait for each other: a decoder that is drained may be late
    /// to say that a packet failed. Any waits for those that may change its turn.
    pub(super) fn next_picture(&mut self) -> Option<Decoded> {
        let waits = |of: &Self| {
            let decoded = of.damage.number_before(of.packets_in_work());
            of.held.front().is_none_or(|first| first.overtaken_up_to > decoded.max(first.number))
        };
        while self.draining || waits(self) {
            let next = self.decode();
            if self.draining {
                let until = next.as_ref().and_then(time_of);
                self.undecoded.extend(self.damage.failed_before(until));
            }
            let Some(frame) = next else {
                let rest = self.turns.rest();
                self.give_no_picture(rest);
                break;
            };
            let decoded = self.in_its_turn(frame);
            self.held.push_back(decoded);
        }
        self.held.pop_front()
    }

    /// When a frame is shown, and the damage that is known of it.
    fn in_its_turn(&mut self, frame: av::frame::Video) -> Decoded {
        let damaged = is_damaged(&frame);
        // In MPEG-4 only B pictures are shown before one that is decoded earlier.
        let is_anchor = self.decoder.id() == av::codec::Id::MPEG4 && frame.kind() != av::picture::Type::B;
        let in_order = frame.is_key() || !self.decoder.has_b_frames() || is_anchor;
        if let Some(place) = frame.pts().filter(|_| self.packets.takes_turns)
            && let Some(turn) = self.turns.picture(place, in_order)
        {
            self.damage.picture_in_turn(turn.number, turn.shown, damaged);
            self.give_no_picture(turn.lost);
            let Turn { shown, number, overtaken_up_to, overtaken_in_full, .. } = turn;
            return Decoded { frame, number, time: Some(shown), in_turn: true, overtaken_up_to, overtaken_in_full };
        }
        let in_turn = self.packets.takes_turns || frame.pts().is_none();
        let time = if in_turn { self.turns.next() } else { frame.pts() };
        let pts = time.or(frame.timestamp());
        let number = self.damage.picture(pts, damaged);
        if let Some(pts) = pts {
            self.undecoded.remove(&pts);
            self.note_kept_back(pts);
        }
        Decoded { frame, number, time, in_turn, overtaken_up_to: number, overtaken_in_full: true }
    }

    /// Packets in turn give no picture any more.
    fn give_no_picture(&mut self, packets: Vec<turns::Packet>) {
        // A stream was joined in its middle.
        let joined = self.packets.clock == Clock::Stream && self.packets.reached_ns.is_none();
        for packet in packets {
            self.damage.gives_no_picture(packet.number);
            if !joined {
                self.undecoded.insert(packet.place);
            }
        }
    }

    /// Of a recording: the packets before a picture that will give none are damaged, or cannot be decoded as they are
    /// predicted from what is not there.
    fn note_kept_back(&mut self, pts: i64) {
        if self.packets.clock != Clock::Container {
            return;
        }
        self.undecoded.extend(self.damage.kept_back_before(pts));
        let Some(mut before) = self.before_first.take() else { return };
        before.retain(|at| *at < pts);
        if !before.is_empty() {
            tracing::warn!(
                "{}: it begins between two key frames: {} before its first picture cannot be decoded",
                self.packets.path.display(),
                plural(before.len() as u64, "packet")
            );
            self.undecoded.append(&mut before);
        }
    }

    /// Gives the decoder the stream's next packet.
    fn feed(&mut self) {
        let mut unreadable = 0;
        loop {
            let next = if self.stop.load(Ordering::Relaxed) {
                Err(av::Error::Eof)
            } else if self.is_hopeless() {
                let waited = KEY_FRAME_TIMEOUT.as_secs();
                self.packets.ends_early =
                    Some(format!("no key frame in {waited} s: let the sender send them more often"));
                Err(av::Error::Eof)
            } else {
                self.packets.next()
            };
            match next {
                Ok(Read { packet: next, in_turn, after_damage, before_damage }) => {
                    let packet = &*next.packet;
                    let number = self.number(packet, in_turn);
                    let pts = packet.pts().or(packet.dts());
                    if before_damage || after_damage && !packet.is_key() {
                        self.damage.heard(number, Said::Concealed);
                    }
                    if let (Some(before), Some(pts)) = (&mut self.before_first, packet.pts())
                        && !in_turn
                        && !is_left_out(packet)
                        && before.len() < MAX_UNDECODED
                    {
                        before.insert(pts);
                    }
                    self.messages.packet(&mut self.decoder, number);
                    if packet.is_corrupt() {
                        self.turns.forget(number);
                        self.damaged_packet(av::Error::InvalidData, false);
                        continue;
                    }
                    let sent = self.decoder.send_packet(packet);
                    // The decoder conceals the damage.
                    let Verdict { sound, skips_numbers, stated } = self.packets.check.verdict(&next);
                    self.stated.extend(pts.zip(stated));
                    if skips_numbers {
                        self.damage.heard(number, Said::SkipsNumbers);
                    }
                    if !sound {
                        self.damaged_packet(av::Error::InvalidData, false);
                    }
                    if let Err(error) = sent {
                        self.damaged_packet(error, true);
                    }
                    return;
                }
                Err(av::Error::InvalidData) if self.packets.ends_early.is_none() && unreadable < UNREADABLE => {
                    unreadable += 1;
                    self.damaged_packet(av::Error::InvalidData, false);
                    continue;
                }
                Err(av::Error::Eof) => self.packets.note_missing(),
                Err(error) => {
                    self.packets.ends_early.get_or_insert_with(|| format!("reading failed: {error}"));
                }
            }
            // A failure here shows as a decoder without frames.
            let _ = self.decoder.send_eof();
            self.draining = true;
            self.damage.suspect_last(self.packets_in_work());
            return;
        }
    }

    /// The number of a packet in the damage log, where its time or its place is noted.
    fn number(&mut self, packet: &av::Packet, in_turn: bool) -> u64 {
        if let Some(place) = packet.pts().filter(|_| in_turn) {
            let number = self.damage.packet_in_turn(packet.is_key());
            self.turns.packet(turns::Packet { place, number });
            return number;
        }
        let number = self.damage.packet(packet.pts().or(packet.dts()), packet.is_key());
        if let (None, Some(place), Clock::Container) = (packet.pts(), packet.dts(), self.packets.clock) {
            self.turns.unmarked(turns::Packet { place, number });
        }
        number
    }

    /// Whether a stream was read for long without a picture.
    fn is_hopeless(&self) -> bool {
        let first = self.packets.first_read.filter(|_| self.awaits_first);
        // One of few frames per minute is slow, and no more.
        let many = self.packets.count.is_some_and(|count| count > i64::from(MAX_REORDERED));
        many && first.is_some_and(|first| first.elapsed() > KEY_FRAME_TIMEOUT)
    }

    /// A packet is lost: the latest, or with `by_decoder` one that a decoder thread was still working on.
    fn damaged_packet(&mut self, error: av::Error, by_decoder: bool) {
        // A decoder of several threads returns a packet's error when it is given a later one; when it is drained, only
        // its messages tell whose it is.
        let later = if by_decoder { self.packets_in_work() } else { 0 };
        self.listen();
        if !self.draining || !self.damage.has_suspects() {
            self.undecoded.extend(self.damage.packet_is_damaged(later));
        }
        if by_decoder {
            self.turns.forget(self.damage.number_before(later));
        }
        self.damaged_packets += 1;
        // Nonsensical times are never reached.
        if self.undecoded.len() > MAX_UNDECODED {
            self.undecoded.pop_last();
        }
        // At a cut the last packet is expected to be broken, and the end is reported.
        if self.damaged_packets == 1 && self.awaits_first {
            let path = self.packets.path.display();
            tracing::warn!("{path}: its first packets cannot be decoded ({error}); waiting for a key frame");
        } else if self.damaged_packets == 1 && self.packets.ends_early.is_none() {
            tracing::warn!(
                "{}: a damaged packet after {} is left out ({error}); more are counted",
                self.packets.path.display(),
                self.packets.at()
            );
        }
    }

    /// Packets that the decoder's threads may still be at work on.
    fn packets_in_work(&self) -> u64 {
        let threading = self.decoder.threading();
        if threading.kind == av::threading::Type::Frame { threading.count.saturating_sub(1) as u64 } else { 0 }
    }
}
