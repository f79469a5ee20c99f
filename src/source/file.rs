//! Recorded video through libav.
//!
//! In: a file in any container that libav reads. Out: every frame that can be decoded, in the order of presentation, as
//! the decoder stored it (no copy, no colour conversion), with the container's own time stamp to the nanosecond: the
//! presentation time stamp times the stream's time base, never frame number ÷ rate, unless the user states the rate of
//! a raw stream, which has no times. A rotation in the container is not applied: calibration refers to the sensor's own
//! rows and columns.
//!
//! A stamp that is not later than those before is passed on unchanged, with a warning. Damaged pictures are left out
//! (see `damage`) with a warning, and counted in the gap of the next frame. A recording that ends early gives all its
//! readable frames, then [`SourceError::Truncated`].

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::path::{Path, PathBuf};
use std::time::Instant;

use ffmpeg_the_third as av;

use super::check::{Checked, PacketCheck};
use super::container::{
    MAX_REORDERED, best_video, count_hint, measure, open_decoder, open_input, open_stream, quiet_libav,
};
use super::damage::DamageLog;
use super::decoded::{PictureMaker, is_damaged, is_left_out};
use super::extent::Extent;
use super::gaps::plausible_period_ns;
use super::messages::Messages;
use super::stamps::StampWatch;
use super::times::{seconds, ticks_to_ns};
use super::{
    Clock, Colour, Frame, FrameRate, FrameSource, Picture, PixelFormat, Quantisation, SourceError, Span, StreamFaults,
    Timestamp,
};

/// How a recording is read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct VideoOptions {
    /// Threads of the decoder; 0 for one per core. Some codecs always have one (`container`).
    pub decoder_threads: usize,
    /// Part of the recording to read.
    pub span: Span,
    /// Frame rate of a raw stream, which has no times: frame i was taken at i / rate ([`Clock::StatedRate`]).
    pub stated_rate: Option<FrameRate>,
    /// Whether damaged pictures, whose times are known, are passed on marked ([`Picture::is_damaged`]) instead of left
    /// out.
    pub keep_damaged: bool,
}

impl Default for VideoOptions {
    fn default() -> Self {
        Self { decoder_threads: 1, span: Span::default(), stated_rate: None, keep_damaged: false }
    }
}

/// A recorded video.
pub struct VideoFile {
    path: PathBuf,
    clock: Clock,
    input: av::format::context::Input,
    stream: usize,
    time_base: av::Rational,
    start_pts: i64,
    /// Stated rate of a raw stream, and how many of its frames were decoded.
    stated: Option<(FrameRate, u64)>,
    /// Camera time at the container's zero, see [`ORIGIN_TAG`].
    origin_ns: i64,
    decoder: av::decoder::Video,
    pictures: PictureMaker,
    damage: DamageLog,
    messages: Messages,
    keep_damaged: bool,
    /// How packets can be checked before decoding.
    check: PacketCheck,
    /// Quantiser steps of packets whose pictures have not been decoded yet.
    steps: BTreeMap<i64, f64>,
    /// Times of damaged packets that have given no picture yet.
    undecoded: BTreeSet<i64>,
    /// Format and colours, for pictures that could not be decoded.
    layout: Option<(PixelFormat, Colour)>,
    /// Decoded frames not judged yet, with their numbers in the damage log.
    held: VecDeque<(av::frame::Video, u64)>,
    stamps: StampWatch,
    /// Camera frames lost or left out since the last frame passed on.
    missing: u32,
    span: Span,
    size_px: [u32; 2],
    frame_count_hint: Option<u64>,
    /// A frame decoded while looking for the start of the span.
    ahead: Option<av::frame::Video>,
    phase: Phase,
    /// Why the recording is known to end early.
    ends_early: Option<String>,
    faults: StreamFaults,
    seq: u64,
    /// Live: when the latest packets were read, by presentation time; and that of the last frame passed on.
    read_at: VecDeque<(i64, Instant)>,
    arrival: Option<Instant>,
    /// Times of packets without a presentation time (AVI), in decoding order: pictures take them in turn.
    in_turn: VecDeque<i64>,
    /// Presentation time of the latest picture.
    latest_pts: Option<i64>,
    /// Whether the recording itself trims frames at the end.
    trimmed: bool,
    /// Packets read since the beginning; `None` after a jump.
    packets: Option<i64>,
    /// Stamps decoded: the latest of all, the latest before the span, and the first after it.
    seen_ns: Option<i64>,
    before_ns: Option<i64>,
    after_ns: Option<i64>,
    last_good_ns: Option<i64>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Phase {
    Reading,
    /// No more packets: the decoder is being drained.
    Draining,
    Ended,
}

/// libav's names of streams without a container.
const RAW_STREAMS: [&str; 11] =
    ["h264", "hevc", "vvc", "obu", "m4v", "mpegvideo", "mjpeg", "mjpeg_2000", "vc1", "dirac", "cavsvideo"];

/// Tag with the camera's clock at the container's zero, nanoseconds. Videos recorded by this program have it when the
/// clock counts from a distant past, which containers resolve to some hundred nanoseconds at best.
pub(crate) const ORIGIN_TAG: &str = "CATOPTRA_ORIGIN_NS";

/// Packets of a stream whose arrival times are remembered: more than any encoder reorders.
const MAX_ARRIVALS: usize = 64;
/// Most damaged packets whose pictures are awaited.
const MAX_UNDECODED: usize = 1000;
/// Unreadable packets in a row after which the rest is given up.
const UNREADABLE: u32 = 1000;

/// Its presentation time, or libav's guess.
fn time_of(frame: &av::frame::Video) -> Option<i64> {
    frame.pts().or(frame.timestamp())
}

impl std::fmt::Debug for VideoFile {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "VideoFile({}, {:?} px, {:?})", self.path.display(), self.size_px, self.phase)
    }
}

impl VideoFile {
    /// Opens the best video stream of the recording at `path`.
    ///
    /// # Errors
    /// When there is no such file, it is not a video or cannot be decoded, or the span ends before it starts.
    pub fn open(path: impl AsRef<Path>, options: VideoOptions) -> Result<Self, SourceError> {
        let path = path.as_ref().to_path_buf();
        options.span.check()?;
        quiet_libav();
        let ends_early = match measure(&path)? {
            Extent::NoIndex => return Err(SourceError::NoIndex { path }),
            Extent::Short { found_bytes, declared_bytes } => {
                Some(format!("the file has {found_bytes} of at least {declared_bytes} bytes"))
            }
            Extent::Whole | Extent::Undeclared => None,
        };
        let input = open_input(&path)?;
        match (RAW_STREAMS.contains(&input.format().name()), options.stated_rate) {
            // libav would invent times from a rate of its own.
            (true, None) => return Err(SourceError::NoTime { path, seq: 0 }),
            (false, Some(_)) => return Err(SourceError::RateOfVideo { path }),
            _ => {}
        }
        let mut source = Self::of_input(path, input, options, Clock::Container)?;
        source.ends_early = ends_early;
        if let Some(from_ns) = options.span.from_ns.filter(|_| source.stated.is_none()) {
            source.seek(from_ns, options.decoder_threads)?;
        }
        Ok(source)
    }

    /// Opens the live stream at `url`: frames leave the decoder at once, and may change their size.
    ///
    /// # Errors
    /// When nobody answers, or the data is not a video that can be decoded.
    pub(super) fn stream(url: &str) -> Result<Self, SourceError> {
        quiet_libav();
        let options = VideoOptions { keep_damaged: true, ..VideoOptions::default() };
        Self::of_input(url.into(), open_stream(url)?, options, Clock::Stream)
    }

    fn of_input(
        path: PathBuf,
        input: av::format::context::Input,
        options: VideoOptions,
        clock: Clock,
    ) -> Result<Self, SourceError> {
        let (index, decoder, time_base, start_pts, declared_ns, hint, check) = {
            let stream = best_video(&path, &input)?;
            let (rate, average) = (stream.rate(), stream.avg_frame_rate());
            let stated_ns = options.stated_rate.and_then(|rate| Some(rate.stamp_ns(1)? as f64));
            let declared_ns = stated_ns.or_else(|| plausible_period_ns((rate.0, rate.1), (average.0, average.1)));
            let decoder = open_decoder(&path, &stream, options.decoder_threads, clock == Clock::Stream)?;
            let hint = count_hint(&input, &stream, options.span);
            let check = PacketCheck::of(&path, &stream, options.decoder_threads);
            (stream.index(), decoder, stream.time_base(), stream.start_time(), declared_ns, hint, check)
        };
        let origin_ns = match input.metadata().get(ORIGIN_TAG) {
            Some(text) => text.parse().map_err(|_| SourceError::NotAVideo {
                path: path.clone(),
                reason: format!("its tag {ORIGIN_TAG} is `{text}`, expected whole nanoseconds"),
            })?,
            None => 0,
        };
        let tick_ns = 1e9 * f64::from(time_base.0) / f64::from(time_base.1.max(1));
        Ok(Self {
            pictures: PictureMaker::new(path.clone(), decoder.id()),
            size_px: [decoder.width(), decoder.height()],
            stamps: StampWatch::new(path.display().to_string(), declared_ns, tick_ns),
            path,
            clock,
            input,
            stream: index,
            time_base,
            start_pts,
            stated: options.stated_rate.map(|rate| (rate, 0)),
            origin_ns,
            decoder,
            damage: DamageLog::default(),
            messages: Messages::default(),
            keep_damaged: options.keep_damaged,
            check,
            steps: BTreeMap::new(),
            undecoded: BTreeSet::new(),
            layout: None,
            held: VecDeque::new(),
            missing: 0,
            span: options.span,
            frame_count_hint: hint,
            ahead: None,
            phase: Phase::Reading,
            ends_early: None,
            faults: StreamFaults::default(),
            seq: 0,
            read_at: VecDeque::new(),
            arrival: None,
            in_turn: VecDeque::new(),
            latest_pts: None,
            trimmed: false,
            packets: Some(0),
            seen_ns: None,
            before_ns: None,
            after_ns: None,
            last_good_ns: None,
        })
    }

    /// When the packet of the last frame passed on was read, in a stream.
    pub(super) fn arrival(&self) -> Option<Instant> {
        self.arrival
    }

    /// Seeks to a key frame from which the frame at `from_ns` can be decoded. libav's index may lead to one that is
    /// shown later, so the first decoded frame decides.
    fn seek(&mut self, from_ns: i64, threads: usize) -> Result<(), SourceError> {
        for margin_s in [0, 2, 10, 60] {
            let to_us = from_ns.saturating_sub(self.origin_ns) / 1000 - margin_s * 1_000_000;
            if self.input.seek(to_us, ..=to_us).is_err() {
                break;
            }
            self.decoder.flush();
            self.ahead = None;
            (self.damage, self.messages) = Default::default();
            self.undecoded.clear();
            self.in_turn.clear();
            self.trimmed = false;
            self.packets = None;
            self.phase = Phase::Reading;
            if let Some(frame) = self.decode() {
                let starts_ns = self.stamp(&frame)?.ns;
                self.ahead = Some(frame);
                if starts_ns <= from_ns {
                    return Ok(());
                }
            }
        }
        // Not seekable, or the span starts before the first frame: read from the start.
        self.input = open_input(&self.path)?;
        let stream = best_video(&self.path, &self.input)?;
        self.decoder = open_decoder(&self.path, &stream, threads, false)?;
        (self.damage, self.messages) = Default::default();
        (self.ahead, self.phase) = (None, Phase::Reading);
        Ok(())
    }

    /// The next frame out of the decoder; `None` when it has no more.
    fn decode(&mut self) -> Option<av::frame::Video> {
        if let Some(frame) = self.ahead.take() {
            return Some(frame);
        }
        let mut frame = av::frame::Video::empty();
        loop {
            let received = self.decoder.receive_frame(&mut frame);
            for (number, said) in self.messages.take() {
                self.damage.heard(number, said);
            }
            match received {
                Ok(()) => return Some(frame),
                Err(av::Error::Eof) => return None,
                Err(av::Error::Other { .. }) if self.phase == Phase::Reading => self.feed(),
                // While draining, a decoder that wants more input has no more frames.
                Err(av::Error::Other { .. }) => return None,
                Err(error) => self.damaged_packet(error, true),
            }
        }
    }

    /// The next frame in presentation order. The last ones wait for each other: a decoder that is drained may be late
    /// to say that a packet failed.
    fn next_in_order(&mut self) -> Option<(av::frame::Video, u64)> {
        while self.held.is_empty() || self.phase == Phase::Draining {
            let next = self.decode();
            if self.phase == Phase::Draining {
                let until = next.as_ref().and_then(time_of);
                self.undecoded.extend(self.damage.failed_before(until));
            }
            let Some(frame) = next else { break };
            let pts = time_of(&frame);
            let number = self.damage.picture(pts, is_damaged(&frame));
            pts.inspect(|pts| {
                self.undecoded.remove(pts);
            });
            self.held.push_back((frame, number));
        }
        self.held.pop_front()
    }

    fn leave_out(&mut self, stamp: Timestamp) {
        self.faults.pictures_left_out += 1;
        if self.faults.pictures_left_out == 1 && self.ends_early.is_none() {
            let fate = if self.keep_damaged { "not measured" } else { "left out" };
            tracing::warn!(
                "{}: the picture at {} s is damaged and {fate}, as are those predicted from it; more are counted",
                self.path.display(),
                stamp.seconds()
            );
        }
    }

    /// Gives the decoder the stream's next packet.
    fn feed(&mut self) {
        let mut unreadable = 0;
        loop {
            let mut packet = av::Packet::empty();
            match packet.read(&mut self.input) {
                Ok(()) if packet.stream() != self.stream => continue,
                Ok(()) => {
                    self.note_arrival(&packet);
                    self.packets = self.packets.map(|packets| packets + 1);
                    // An MP4's edit list may leave out frames at the end, and libav then drops them. But where the
                    // length of the last frame was unknown, the list ends at its start, and it would be dropped too.
                    // Setting the flags that the binding knows clears the discard flag; frames before the recording's
                    // start stay out.
                    if is_left_out(&packet) && packet.pts().is_some_and(|pts| pts >= self.start_pts) {
                        let frames = self.input.stream(self.stream).map_or(0, |stream| stream.frames());
                        let more = self.packets.is_some_and(|packets| packets + i64::from(MAX_REORDERED) < frames);
                        if packet.duration() <= 1 && !more && !self.trimmed {
                            packet.set_flags(packet.flags());
                        }
                        self.trimmed = true;
                    }
                    let pts = packet.pts().or(packet.dts());
                    if packet.pts().is_none() && self.clock == Clock::Container {
                        self.in_turn.extend(packet.dts());
                    }
                    let number = self.damage.packet(pts, packet.is_key());
                    self.messages.packet(&mut self.decoder, number);
                    if packet.is_corrupt() {
                        self.damaged_packet(av::Error::InvalidData, false);
                        continue;
                    }
                    // The decoder would conceal the damage.
                    let Checked { sound, step, sent } = self.check.send(&packet, &mut self.decoder);
                    self.steps.extend(pts.zip(step));
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
                Err(av::Error::Eof) => {}
                Err(error) => {
                    self.ends_early.get_or_insert_with(|| format!("reading failed: {error}"));
                }
            }
            // A failure here shows as a decoder without frames.
            let _ = self.decoder.send_eof();
            self.phase = Phase::Draining;
            self.damage.suspect_last(self.packets_in_work());
            return;
        }
    }

    fn note_arrival(&mut self, packet: &av::Packet) {
        if self.clock == Clock::Stream
            && let Some(pts) = packet.pts()
        {
            if self.read_at.len() == MAX_ARRIVALS {
                self.read_at.pop_front();
            }
            self.read_at.push_back((pts, Instant::now()));
        }
    }

    /// A packet is lost: the latest, or with `by_decoder` one that a decoder thread was still working on.
    fn damaged_packet(&mut self, error: av::Error, by_decoder: bool) {
        // A decoder of several threads returns a packet's error when it is given a later one; when it is drained, only
        // its messages tell whose it is.
        let later = if by_decoder { self.packets_in_work() } else { 0 };
        if self.phase == Phase::Reading || !self.damage.has_suspects() {
            self.undecoded.extend(self.damage.packet_is_damaged(later));
        }
        if by_decoder {
            // No picture will take its time.
            self.in_turn.pop_back();
        }
        self.faults.damaged_packets += 1;
        // Nonsensical times are never reached.
        if self.undecoded.len() > MAX_UNDECODED {
            self.undecoded.pop_last();
        }
        // At a cut the last packet is expected to be broken, and the end is reported.
        if self.faults.damaged_packets == 1 && self.ends_early.is_none() {
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
    fn at(&self) -> String {
        self.seen_ns.map_or_else(|| "the start".to_owned(), |ns| format!("{} s", seconds(ns)))
    }

    /// The container's time of `frame`.
    fn stamp(&mut self, frame: &av::frame::Video) -> Result<Timestamp, SourceError> {
        if let Some((rate, number)) = &mut self.stated {
            let late = || SourceError::TimeRange { path: self.path.clone(), seq: self.seq };
            let ns = rate.stamp_ns(*number).ok_or_else(late)?;
            *number += 1;
            self.seen_ns = Some(ns);
            return Ok(Timestamp { ns, clock: Clock::StatedRate });
        }
        let ticks = match (frame.pts(), frame.timestamp()) {
            (Some(pts), _) => pts,
            (None, guess) if !self.in_turn.is_empty() || guess.is_some() => {
                self.faults.guessed_stamps += 1;
                if self.faults.guessed_stamps == 1 {
                    tracing::warn!(
                        "{}: frames after {} have no presentation time; the times of their packets are taken in turn",
                        self.path.display(),
                        self.at()
                    );
                }
                // Of a recording's pictures, libav's guess depends on the number of threads; a repeated time is seen
                // to be one.
                let latest = self.latest_pts.filter(|_| self.clock == Clock::Container);
                self.in_turn.pop_front().or(latest).or(guess).unwrap_or_default()
            }
            (None, _) => return Err(SourceError::NoTime { path: self.path.clone(), seq: self.seq }),
        };
        let stamp = self.timed(ticks)?;
        (self.latest_pts, self.seen_ns) = (Some(ticks), Some(stamp.ns));
        Ok(stamp)
    }

    fn timed(&self, ticks: i64) -> Result<Timestamp, SourceError> {
        let ns = ticks_to_ns(ticks, self.time_base.0.into(), self.time_base.1.into())
            .and_then(|ns| ns.checked_add(self.origin_ns))
            .ok_or_else(|| SourceError::TimeRange { path: self.path.clone(), seq: self.seq })?;
        Ok(Timestamp { ns, clock: self.clock })
    }

    /// The stream has ended: complete, early, or empty.
    fn end(&mut self) -> Result<Option<Frame>, SourceError> {
        self.phase = Phase::Ended;
        self.faults.report(&self.path);
        let path = self.path.clone();
        if let Some(why) = self.ends_early.take() {
            let last_good_s = self.last_good_ns.map(seconds);
            return Err(SourceError::Truncated { path, frames: self.seq, last_good_s, why });
        }
        if self.seq > 0 {
            return Ok(None);
        }
        if self.seen_ns.is_none() || self.span == Span::default() {
            return Err(SourceError::NoFrames { path });
        }
        let (from_s, to_s) = (self.span.from_ns.map(seconds), self.span.to_ns.map(seconds));
        let (before_s, after_s) = (self.before_ns.map(seconds), self.after_ns.map(seconds));
        Err(SourceError::EmptySpan { path, from_s, to_s, before_s, after_s })
    }
}

impl FrameSource for VideoFile {
    fn next_frame(&mut self) -> Result<Option<Frame>, SourceError> {
        let next = self.next_sound();
        if next.is_err() {
            self.phase = Phase::Ended;
        }
        next
    }

    fn size_px(&self) -> [u32; 2] {
        self.size_px
    }

    fn frame_count_hint(&self) -> Option<u64> {
        self.frame_count_hint
    }

    fn faults(&self) -> StreamFaults {
        self.faults
    }
}

impl VideoFile {
    /// The next frame of the span that is not damaged.
    fn next_sound(&mut self) -> Result<Option<Frame>, SourceError> {
        while self.phase != Phase::Ended {
            let next = self.next_in_order();
            let until = next.as_ref().map_or(Some(i64::MAX), |(frame, _)| time_of(frame));
            if let Some(frame) = self.undecoded_before(until)? {
                next.into_iter().for_each(|next| self.held.push_front(next));
                return Ok(Some(frame));
            }
            let Some((decoded, number)) = next else {
                return self.end();
            };
            let stamp = match self.stamp(&decoded) {
                // The first packets of some senders have none.
                Err(SourceError::NoTime { .. }) if self.clock == Clock::Stream && self.seq == 0 => {
                    self.faults.unstamped += 1;
                    if self.faults.unstamped == 1 {
                        tracing::warn!("{}: frames before the first time stamp are left out", self.path.display());
                    }
                    continue;
                }
                stamp => stamp?,
            };
            if self.span.from_ns.is_some_and(|from| stamp.ns < from) {
                self.before_ns = Some(stamp.ns);
                continue;
            }
            if self.span.to_ns.is_some_and(|to| stamp.ns > to) {
                self.ends_early = None;
                self.after_ns = Some(stamp.ns);
                return self.end();
            }
            self.missing = self.missing.saturating_add(self.stamps.gap(stamp.ns, self.seq, &mut self.faults));
            let sound = self.damage.is_sound(number, time_of(&decoded));
            if !sound {
                self.leave_out(stamp);
                if !self.keep_damaged {
                    self.missing = self.missing.saturating_add(1);
                    continue;
                }
            }
            let after = [decoded.width(), decoded.height()];
            if after != self.size_px && self.clock == Clock::Container {
                return Err(SourceError::SizeChange {
                    path: self.path.clone(),
                    at: format!("{} s", stamp.seconds()),
                    seq: self.seq,
                    before: self.size_px,
                    after,
                });
            }
            self.arrival =
                decoded.pts().and_then(|pts| self.read_at.iter().rev().find(|(of, _)| *of == pts)).map(|(_, at)| *at);
            let step = time_of(&decoded).and_then(|pts| self.steps.remove(&pts));
            let picture = self.pictures.picture(decoded)?;
            let picture = match step {
                Some(step) => {
                    let quantisation = Quantisation::of_step(step, picture.size_px());
                    picture.quantised(Some(quantisation))
                }
                None => picture,
            };
            self.layout = Some((picture.format(), picture.colour()));
            let picture = if sound { picture } else { picture.marked_damaged() };
            if sound {
                self.last_good_ns = Some(stamp.ns);
            }
            return Ok(Some(self.frame(stamp, picture)));
        }
        Ok(None)
    }

    fn frame(&mut self, stamp: Timestamp, picture: Picture) -> Frame {
        let frame = Frame { seq: self.seq, stamp, gap: std::mem::take(&mut self.missing), host: None, picture };
        self.seq += 1;
        frame
    }

    /// The frame of a damaged packet that gave no picture, if one comes before `pts`.
    fn undecoded_before(&mut self, pts: Option<i64>) -> Result<Option<Frame>, SourceError> {
        if self.stated.is_some() {
            return Ok(None);
        }
        // At a cut the last packets are expected to be broken.
        let pts = pts.filter(|pts| *pts != i64::MAX || self.ends_early.is_none());
        while let Some(first) = self.undecoded.first().copied()
            && pts.is_some_and(|pts| first < pts)
        {
            self.undecoded.remove(&first);
            let Some((format, colour)) = self.layout.filter(|_| self.keep_damaged) else { continue };
            let stamp = self.timed(first)?;
            if !self.span.contains(stamp.ns) {
                continue;
            }
            self.missing = self.missing.saturating_add(self.stamps.gap(stamp.ns, self.seq, &mut self.faults));
            self.leave_out(stamp);
            let Ok(picture) = Picture::missing(self.size_px, format, colour) else { continue };
            return Ok(Some(self.frame(stamp, picture)));
        }
        Ok(None)
    }
}
