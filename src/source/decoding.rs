//! A recording's pictures as libav decodes them: in the order of presentation, with what is known of their damage.
//!
//! In: the packets of a container. Out: decoded frames, the times of packets that gave none, and what their packets
//! state. Which of them are passed on, and when they were taken, `file` decides.

use super::check::{InCheck, PacketCheck, Verdict};
use super::container::{MAX_REORDERED, best_video, count_hint, is_raw, open_decoder, open_input};
use super::damage::DamageLog;
use super::decoded::{is_damaged, is_left_out};
use super::headers::skips_numbers;
use super::messages::{self, Messages, OfContainer, Said};
use super::quantisation::Stated;
use super::times::seconds;
use super::turns::{self, Turns};
use super::{Clock, SourceError, Span};
use crate::plural::plural;
use ffmpeg_the_third as av;
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// Packets of a stream whose arrival times are remembered: more than any encoder reorders.
const MAX_ARRIVALS: usize = 64;
/// Most damaged packets whose pictures are awaited.
const MAX_UNDECODED: usize = 1000;
/// Packets that are read before they are decoded, so that they can be checked meanwhile. Threads may have to wait for a
/// processor as long as some pictures take.
const READ_AHEAD: usize = 4;
/// libav's name of containers whose packets have no times, but are counted.
const AVI: &str = "avi";
/// Frames that the declared length of a recording may have after its last packet's time of decoding: more than coders
/// reorder.
const LAST_FRAMES: f64 = 5.0;
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

/// A packet that was read.
struct Read {
    packet: InCheck,
    /// Whether its time is its place.
    in_turn: bool,
    /// Whether others may be missing before it: the container is damaged there.
    after_damage: bool,
    /// Whether the container is damaged right after it: what was lost mostly begins within it.
    before_damage: bool,
}

/// The pictures of a stream.
pub(super) struct Decoding {
    path: PathBuf,
    clock: Clock,
    input: av::format::context::Input,
    stream: usize,
    pub time_base: av::Rational,
    start_pts: i64,
    /// Frame rates that the container states: of the stream, and on average.
    pub rates: [av::Rational; 2],
    threads: usize,
    decoder: av::decoder::Video,
    damage: DamageLog,
    messages: Messages,
    check: PacketCheck,
    /// Packets read and not decoded yet; the last entry may be why there is none.
    read: VecDeque<Result<Read, av::Error>>,
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
    /// Why the recording is known to end early.
    pub ends_early: Option<String>,
    /// How many packets could not be read or decoded.
    pub damaged_packets: u64,
    /// Camera time of the latest picture, for messages.
    pub reached_ns: Option<i64>,
    /// Live: when the latest packets were read, by presentation time.
    read_at: VecDeque<(Option<i64>, Instant)>,
    /// Pictures of packets without presentation times take their places in turn.
    turns: Turns,
    /// Whether all pictures do: of raw streams, and of an AVI. (Of one with B pictures in MPEG-4, libav knows
    /// presentation times of some, and counts them otherwise.)
    pub takes_turns: bool,
    /// Whether the recording itself trims frames at the end.
    trimmed: bool,
    /// Whether the container was found to be damaged, and that was told.
    damage_told: bool,
    /// The latest time of decoding that a packet states.
    latest_dts: Option<i64>,
    /// Packets read since the beginning; `None` after a jump.
    packets: Option<i64>,
    /// Live, before the first picture: when the first packet was read, if it was.
    awaits_first: Option<Option<Instant>>,
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
        let stream = best_video(&path, &input)?;
        let decoder = open_decoder(&path, &stream, threads, clock == Clock::Stream)?;
        let check = PacketCheck::of(&path, &stream);
        let damage = DamageLog::new(skips_numbers(&stream), stream.parameters().id() == av::codec::Id::HEVC);
        let takes_turns = is_raw(&input);
        Ok(Self {
            stream: stream.index(),
            time_base: stream.time_base(),
            start_pts: stream.start_time(),
            rates: [stream.rate(), stream.avg_frame_rate()],
            path,
            clock,
            input,
            threads,
            decoder,
            damage,
            messages: Messages::default(),
            check,
            read: VecDeque::new(),
            stated: BTreeMap::new(),
            undecoded: BTreeSet::new(),
            before_first: (clock == Clock::Container).then(BTreeSet::new),
            held: VecDeque::new(),
            draining: false,
            stop: Arc::default(),
            ends_early: None,
            damaged_packets: 0,
            reached_ns: None,
            read_at: VecDeque::new(),
            turns: Turns::default(),
            takes_turns,
            trimmed: false,
            damage_told: false,
            latest_dts: None,
            packets: Some(0),
            awaits_first: (clock == Clock::Stream).then_some(None),
        })
    }

    pub(super) fn decoder(&self) -> &av::decoder::Video {
        &self.decoder
    }

    pub(super) fn input(&self) -> &av::format::context::Input {
        &self.input
    }

    /// About how many frames a span has, if the container tells.
    pub(super) fn count_hint(&self, span: Span) -> Option<u64> {
        count_hint(&self.input, &self.input.stream(self.stream)?, span)
    }

    /// Jumps to the last key frame before a time of the container, microseconds; returns whether the input can.
    pub(super) fn seek(&mut self, to_us: i64) -> bool {
        if self.input.seek(to_us, ..=to_us).is_err() {
            return false;
        }
        self.decoder.flush();
        self.forget();
        (self.packets, self.before_first) = (None, None);
        true
    }

    /// Starts again from the beginning.
    ///
    /// # Errors
    /// When the file cannot be opened any more.
    pub(super) fn restart(&mut self) -> Result<(), SourceError> {
        self.input = open_input(&self.path)?;
        let stream = best_video(&self.path, &self.input)?;
        self.decoder = open_decoder(&self.path, &stream, self.threads, self.clock == Clock::Stream)?;
        self.forget();
        (self.packets, self.before_first) = (Some(0), Some(BTreeSet::new()));
        Ok(())
    }

    /// Forgets what was read.
    fn forget(&mut self) {
        self.damage.forget();
        self.messages = Messages::default();
        self.read.clear();
        self.stated.clear();
        self.undecoded.clear();
        self.held.clear();
        self.turns = Turns::default();
        self.draining = false;
        self.trimmed = false;
        self.latest_dts = None;
    }

    /// Gives back a picture of [`Self::next_picture`], to be the next one.
    pub(super) fn put_back(&mut self, picture: Decoded) {
        self.held.push_front(picture);
    }

    /// Whether a picture is sound, as far as known by now.
    pub(super) fn is_sound(&self, picture: &Decoded) -> bool {
        let misplaced = self.damage.has_failed(picture.number + 1..=picture.overtaken_up_to);
        self.damage.is_sound(picture.number, picture.pts()) && !misplaced
    }

    /// The time of a damaged packet that gave no picture, if there is one before `pts`; each is returned once.
    pub(super) fn failed_before(&mut self, pts: Option<i64>) -> Option<i64> {
        // At a cut the last packets are expected to be broken.
        let pts = pts.filter(|pts| *pts != i64::MAX || self.ends_early.is_none())?;
        let first = self.undecoded.first().copied().filter(|first| *first < pts)?;
        self.undecoded.remove(&first);
        Some(first)
    }

    /// What the packet of a picture stated of its quantiser.
    pub(super) fn stated_of(&mut self, picture: &Decoded) -> Option<Stated> {
        self.stated.remove(&time_of(&picture.frame)?)
    }

    /// When the packet of a live picture was read.
    pub(super) fn arrival_of(&self, pts: Option<i64>) -> Option<Instant> {
        self.read_at.iter().rev().find(|(of, _)| *of == pts).map(|(_, at)| *at)
    }

    /// The next frame out of the decoder; `None` when it has no more.
    fn decode(&mut self) -> Option<av::frame::Video> {
        let mut frame = av::frame::Video::empty();
        loop {
            let received = self.decoder.receive_frame(&mut frame);
            self.listen();
            match received {
                Ok(()) => {
                    self.awaits_first = None;
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
        if let Some(place) = frame.pts().filter(|_| self.takes_turns)
            && let Some(turn) = self.turns.picture(place, in_order)
        {
            self.damage.picture_in_turn(turn.number, turn.shown, damaged);
            self.give_no_picture(turn.lost);
            let (number, time, overtaken_up_to) = (turn.number, Some(turn.shown), turn.overtaken_up_to);
            return Decoded { frame, number, time, in_turn: true, overtaken_up_to };
        }
        let in_turn = self.takes_turns || frame.pts().is_none();
        let time = if in_turn { self.turns.next() } else { frame.pts() };
        let pts = time.or(frame.timestamp());
        let number = self.damage.picture(pts, damaged);
        if let Some(pts) = pts {
            self.undecoded.remove(&pts);
            self.note_kept_back(pts);
        }
        Decoded { frame, number, time, in_turn, overtaken_up_to: number }
    }

    /// Packets in turn give no picture any more.
    fn give_no_picture(&mut self, packets: Vec<turns::Packet>) {
        // A stream was joined in its middle.
        let joined = self.clock == Clock::Stream && self.reached_ns.is_none();
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
        if self.clock != Clock::Container {
            return;
        }
        self.undecoded.extend(self.damage.kept_back_before(pts));
        let Some(mut before) = self.before_first.take() else { return };
        before.retain(|at| *at < pts);
        if !before.is_empty() {
            tracing::warn!(
                "{}: it begins between two key frames: {} before its first picture cannot be decoded",
                self.path.display(),
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
                self.ends_early = Some(format!("no key frame in {waited} s: let the sender send them more often"));
                Err(av::Error::Eof)
            } else {
                self.next_packet()
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
                    let Verdict { sound, stated } = self.check.verdict(&next);
                    self.stated.extend(pts.zip(stated));
                    if !sound {
                        self.damaged_packet(av::Error::InvalidData, false);
                    }
                    if let Err(error) = sent {
                        self.damaged_packet(error, true);
                    }
                    return;
                }
                Err(av::Error::InvalidData) if self.ends_early.is_none() && unreadable < UNREADABLE => {
                    unreadable += 1;
                    self.damaged_packet(av::Error::InvalidData, false);
                    continue;
                }
                Err(av::Error::Eof) => self.note_missing(),
                Err(error) => {
                    self.ends_early.get_or_insert_with(|| format!("reading failed: {error}"));
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
        if let (None, Some(place), Clock::Container) = (packet.pts(), packet.dts(), self.clock) {
            self.turns.unmarked(turns::Packet { place, number });
        }
        number
    }

    /// Whether a stream was read for long without a picture.
    fn is_hopeless(&self) -> bool {
        let first = self.awaits_first.flatten();
        // One of few frames per minute is slow, and no more.
        let many = self.packets.is_some_and(|packets| packets > i64::from(MAX_REORDERED));
        many && first.is_some_and(|first| first.elapsed() > KEY_FRAME_TIMEOUT)
    }

    /// The stream's next packet. Of a recording some more are read, and their check begins; live, they have not come
    /// yet.
    fn next_packet(&mut self) -> Result<Read, av::Error> {
        let ahead = match self.clock {
            Clock::Stream => 0,
            _ if self.check.has_thread() => READ_AHEAD,
            // Damage of the container is found behind the packet that it begins in.
            _ => 1,
        };
        while self.read.len() <= ahead && !matches!(self.read.back(), Some(Err(_))) {
            let mut after_damage = false;
            let packet = self.read_packet(&mut after_damage).map(|packet| self.check.begin(packet));
            if let Some(Ok(last)) = self.read.back_mut() {
                last.before_damage = after_damage;
            }
            let in_turn = self.takes_turns;
            self.read.push_back(packet.map(|packet| Read { packet, in_turn, after_damage, before_damage: false }));
        }
        self.read.pop_front().unwrap_or(Err(av::Error::Eof))
    }

    /// `after_damage`: set where packets may be missing before it.
    fn read_packet(&mut self, after_damage: &mut bool) -> Result<av::Packet, av::Error> {
        let mut packet = av::Packet::empty();
        loop {
            let (read, said) = messages::hearing_of_container(|| packet.read(&mut self.input));
            if said == OfContainer::CutOff {
                self.ends_early.get_or_insert_with(|| "its container ends in the middle of an element".to_owned());
            }
            if said == OfContainer::Damaged && self.clock == Clock::Container {
                *after_damage = true;
                self.container_is_damaged(matches!(read, Err(av::Error::Eof)));
            }
            read?;
            if packet.stream() == self.stream {
                break;
            }
        }
        let is_avi = self.clock == Clock::Container && self.input.format().name() == AVI;
        self.takes_turns |= is_avi && packet.pts().is_none();
        if self.takes_turns {
            // The decoder hands it on with the picture.
            packet.set_pts(if is_avi { packet.dts() } else { self.packets });
        }
        self.note_arrival(&packet);
        self.latest_dts = packet.dts().max(self.latest_dts);
        if let Some(first) = &mut self.awaits_first {
            first.get_or_insert_with(Instant::now);
        }
        self.packets = self.packets.map(|packets| packets + 1);
        // An MP4's edit list may leave out frames at the end, and libav then drops them. But where the length of the
        // last frame was unknown, the list ends at its start, and it would be dropped too. Setting the flags that the
        // binding knows clears the discard flag; frames before the recording's start stay out.
        if is_left_out(&packet) && packet.pts().is_some_and(|pts| pts >= self.start_pts) {
            let frames = self.input.stream(self.stream).map_or(0, |stream| stream.frames());
            let more = self.packets.is_some_and(|packets| packets + i64::from(MAX_REORDERED) < frames);
            if packet.duration() <= 1 && !more && !self.trimmed {
                packet.set_flags(packet.flags());
            }
            self.trimmed = true;
        }
        Ok(packet)
    }

    /// libav could not read the container after the latest packet, and found its structure again or reached the end.
    fn container_is_damaged(&mut self, at_end: bool) {
        if at_end && !self.reaches_declared_end() {
            self.ends_early.get_or_insert_with(|| {
                "its container is damaged there, and nothing that follows can be read".to_owned()
            });
        } else if !self.damage_told {
            self.damage_told = true;
            tracing::warn!(
                "{}: the container is damaged after {}: pictures may be missing there",
                self.path.display(),
                self.at()
            );
        }
    }

    /// Whether the latest packet is one of the last of the length that the container declares.
    fn reaches_declared_end(&self) -> bool {
        let length_s = self.input.duration() as f64 / f64::from(av::ffi::AV_TIME_BASE);
        let [_, average] = self.rates.map(f64::from);
        let latest_s = |ticks: i64| (ticks as f64 - self.start_pts.max(0) as f64) * f64::from(self.time_base);
        length_s > 0.0 && self.latest_dts.is_some_and(|ticks| latest_s(ticks) + LAST_FRAMES / average >= length_s)
    }

    /// At the end of an AVI, whose packets have no times but are counted: whether it declares more of them.
    fn note_missing(&mut self) {
        let frames = self.input.stream(self.stream).map_or(0, |stream| stream.frames());
        let (Some(latest), true) = (self.latest_dts, self.input.format().name() == AVI) else { return };
        let missing = frames.saturating_sub(latest.saturating_add(1));
        if self.packets.is_none() || missing < 1 {
            return;
        }
        let found = format!(
            "of the {frames} frames that its header declares {missing} were not found. AVI has no times: if they are \
             missing in the middle, those after that place are too early by as many frames"
        );
        self.ends_early = Some(self.ends_early.take().map_or(found.clone(), |why| format!("{why}; {found}")));
    }

    fn note_arrival(&mut self, packet: &av::Packet) {
        if self.clock == Clock::Stream {
            if self.read_at.len() == MAX_ARRIVALS {
                self.read_at.pop_front();
            }
            self.read_at.push_back((packet.pts(), Instant::now()));
        }
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
        if self.damaged_packets == 1 && self.awaits_first.is_some() {
            let path = self.path.display();
            tracing::warn!("{path}: its first packets cannot be decoded ({error}); waiting for a key frame");
        } else if self.damaged_packets == 1 && self.ends_early.is_none() {
            tracing::warn!(
                "{}: a damaged packet after {} is left out ({error}); more are counted",
                self.path.display(),
                self.at()
            );
        }
    }

    /// Packets that the decoder's threads may still be at work on.
    fn packets_in_work(&self) -> u64 {
        let threading = self.decoder.threading();
        if threading.kind == av::threading::Type::Frame { threading.count.saturating_sub(1) as u64 } else { 0 }
    }

    /// The current position, for messages.
    pub(super) fn at(&self) -> String {
        self.reached_ns.map_or_else(|| "the start".to_owned(), |ns| format!("{} s", seconds(ns)))
    }
}
