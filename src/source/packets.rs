//! The packets of a recording or a stream as its container gives them, with what is known of damage to the container.
//!
//! In: an open container. Out: the packets of its best video stream, and for each whether others may be missing beside
//! it. The check of each packet's own data begins here.

use super::check::{InCheck, PacketCheck};
use super::container::{MAX_REORDERED, best_video, count_hint, is_raw, open_input};
use super::decoded::is_left_out;
use super::messages::{self, OfContainer};
use super::times::seconds;
use super::{Clock, SourceError, Span};
use crate::plural::plural;
use ffmpeg_the_third as av;
use std::collections::{BTreeMap, VecDeque};
use std::path::PathBuf;
use std::time::Instant;

/// Packets of a stream whose arrival times are remembered: more than any encoder reorders.
const MAX_ARRIVALS: usize = 64;
/// Packets that are read before they are decoded, so that they can be checked meanwhile. Threads may have to wait for a
/// processor as long as some pictures take.
const READ_AHEAD: usize = 4;
/// libav's name of containers whose packets have no times, but are counted.
const AVI: &str = "avi";
/// Frames that the declared length of a recording may have after its last packet's time of decoding: more than coders
/// reorder.
const LAST_FRAMES: f64 = 5.0;

/// A packet that was read.
pub(super) struct Read {
    pub packet: InCheck,
    /// Whether its time is its place.
    pub in_turn: bool,
    /// Whether others may be missing before it: the container is damaged there.
    pub after_damage: bool,
    /// Whether the container is damaged right after it: what was lost mostly begins within it.
    pub before_damage: bool,
}

/// The packets of a stream.
pub(super) struct Packets {
    pub path: PathBuf,
    pub clock: Clock,
    input: av::format::context::Input,
    stream: usize,
    pub time_base: av::Rational,
    start_pts: i64,
    /// Frame rates that the container states: of the stream, and on average.
    pub rates: [av::Rational; 2],
    pub check: PacketCheck,
    /// Packets read and not taken yet; the last entry may be why there is none.
    read: VecDeque<Result<Read, av::Error>>,
    /// Why the recording is known to end early.
    pub ends_early: Option<String>,
    /// Camera time of the latest picture, for messages.
    pub reached_ns: Option<i64>,
    /// Live: when the latest packets were read, by presentation time.
    read_at: VecDeque<(Option<i64>, Instant)>,
    /// Whether all pictures take their places in turn: of raw streams, and of an AVI. (Of one with B pictures in
    /// MPEG-4, libav knows presentation times of some, and counts them otherwise.)
    pub takes_turns: bool,
    /// Whether the recording itself trims frames at the end.
    trimmed: bool,
    /// Whether the container was found to be damaged, and that was told.
    damage_told: bool,
    /// The latest time of decoding that a packet states.
    latest_dts: Option<i64>,
    /// Of an AVI, how often its packets are so far apart, in times of decoding.
    steps: BTreeMap<i64, u64>,
    /// Packets read since the beginning; `None` after a jump.
    pub count: Option<i64>,
    /// When the first packet was read.
    pub first_read: Option<Instant>,
}

impl Packets {
    /// Of the best video stream of `input`.
    ///
    /// # Errors
    /// When there is none.
    pub(super) fn new(path: PathBuf, input: av::format::context::Input, clock: Clock) -> Result<Self, SourceError> {
        let stream = best_video(&path, &input)?;
        Ok(Self {
            stream: stream.index(),
            time_base: stream.time_base(),
            start_pts: stream.start_time(),
            rates: [stream.rate(), stream.avg_frame_rate()],
            check: PacketCheck::of(&path, &stream),
            takes_turns: is_raw(&input),
            path,
            clock,
            input,
            read: VecDeque::new(),
            ends_early: None,
            reached_ns: None,
            read_at: VecDeque::new(),
            trimmed: false,
            damage_told: false,
            latest_dts: None,
            steps: BTreeMap::new(),
            count: Some(0),
            first_read: None,
        })
    }

    pub(super) fn input(&self) -> &av::format::context::Input {
        &self.input
    }

    /// The stream whose packets these are.
    ///
    /// # Errors
    /// When the container has none any more.
    pub(super) fn stream(&self) -> Result<av::format::stream::Stream<'_>, SourceError> {
        let gone = || SourceError::NoVideoStream { path: self.path.clone(), found: "no stream at all".to_owned() };
        self.input.stream(self.stream).ok_or_else(gone)
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
        self.forget();
        self.count = None;
        true
    }

    /// Starts again from the beginning.
    ///
    /// # Errors
    /// When the file cannot be opened any more.
    pub(super) fn restart(&mut self) -> Result<(), SourceError> {
        self.input = open_input(&self.path)?;
        self.forget();
        self.count = Some(0);
        Ok(())
    }

    /// Forgets what was read.
    fn forget(&mut self) {
        self.check.jump();
        self.read.clear();
        self.trimmed = false;
        self.latest_dts = None;
    }

    /// When the packet of a live picture was read.
    pub(super) fn arrival_of(&self, pts: Option<i64>) -> Option<Instant> {
        self.read_at.iter().rev().find(|(of, _)| *of == pts).map(|(_, at)| *at)
    }

    /// The stream's next packet. Of a recording some more are read, and their check begins; live, they have not come
    /// yet.
    pub(super) fn next(&mut self) -> Result<Read, av::Error> {
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
            packet.set_pts(if is_avi { packet.dts() } else { self.count });
        }
        self.note_arrival(&packet);
        if let (true, Some(dts), Some(latest)) = (is_avi, packet.dts(), self.latest_dts) {
            *self.steps.entry(dts.saturating_sub(latest)).or_default() += 1;
        }
        self.latest_dts = packet.dts().max(self.latest_dts);
        self.first_read.get_or_insert_with(Instant::now);
        self.count = self.count.map(|count| count + 1);
        // An MP4's edit list may leave out frames at the end, and libav then drops them. But where the length of the
        // last frame was unknown, the list ends at its start, and it would be dropped too. Setting the flags that the
        // binding knows clears the discard flag; frames before the recording's start stay out.
        if is_left_out(&packet) && packet.pts().is_some_and(|pts| pts >= self.start_pts) {
            let frames = self.input.stream(self.stream).map_or(0, |stream| stream.frames());
            let more = self.count.is_some_and(|count| count + i64::from(MAX_REORDERED) < frames);
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
    pub(super) fn note_missing(&mut self) {
        let frames = self.input.stream(self.stream).map_or(0, |stream| stream.frames());
        let (Some(latest), true) = (self.latest_dts, self.input.format().name() == AVI) else { return };
        // Programs count places between their pictures, too, and leave them empty.
        let usual = self.steps.iter().max_by_key(|(_, often)| **often).map_or(1, |(step, _)| (*step).max(1));
        let missing = frames.saturating_sub(latest.saturating_add(1)) / usual;
        if self.count.is_none() || missing < 1 {
            return;
        }
        let found = format!(
            "of the {} that its header declares {missing} were not found. AVI has no times: if they are missing in the \
             middle, those after that place are too early by as many frames",
            if usual > 1 {
                format!("{} frames (in {frames} places, one in {usual} with a frame)", frames / usual)
            } else {
                plural(frames.unsigned_abs(), "frame")
            }
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

    /// The current position, for messages.
    pub(super) fn at(&self) -> String {
        self.reached_ns.map_or_else(|| "the start".to_owned(), |ns| format!("{} s", seconds(ns)))
    }
}
