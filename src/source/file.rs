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

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Instant;

use ffmpeg_the_third as av;

use super::container::{is_raw, measure, open_input, open_stream, quiet_libav};
use super::decoded::PictureMaker;
use super::decoding::{Decoded, Decoding};
use super::extent::Extent;
use super::gaps::plausible_period_ns;
use super::names::without_credentials;
use super::stamps::StampWatch;
use super::times::{seconds, ticks_to_ns};
use super::{
    Clock, Colour, Frame, FrameRate, FrameSource, Picture, PixelFormat, SourceError, Span, StreamFaults, Timestamp,
};

/// How a recording is read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct VideoOptions {
    /// Threads of the decoder; 0 for as many as keep all cores busy. Some codecs always have one (`container`).
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

/// So many frames without a time stamp in a row are left out; beyond, there is none to come.
const MOST_UNSTAMPED: u32 = 300;

/// A recorded video.
pub struct VideoFile {
    path: PathBuf,
    clock: Clock,
    decoding: Decoding,
    /// Stated rate of a raw stream.
    stated: Option<FrameRate>,
    /// Camera time at the container's zero, see [`ORIGIN_TAG`].
    origin_ns: i64,
    pictures: PictureMaker,
    keep_damaged: bool,
    /// Format and colours, for pictures that could not be decoded.
    layout: Option<(PixelFormat, Colour)>,
    stamps: StampWatch,
    /// Camera frames lost or left out since the last frame passed on.
    missing: u32,
    span: Span,
    size_px: [u32; 2],
    frame_count_hint: Option<u64>,
    ended: bool,
    faults: StreamFaults,
    /// Pictures whose places are not known, as packets may be missing at the end.
    unplaced: u64,
    /// Frames without a time stamp since the last with one.
    unstamped_in_a_row: u32,
    seq: u64,
    /// Live: when the packet of the last frame passed on was read.
    arrival: Option<Instant>,
    /// Presentation time of the latest picture.
    latest_pts: Option<i64>,
    /// Stamps decoded: the latest before the span, and the first after it.
    before_ns: Option<i64>,
    after_ns: Option<i64>,
    last_good_ns: Option<i64>,
}

/// Tag with the camera's clock at the container's zero, nanoseconds. Videos recorded by this program have it when the
/// clock counts from a distant past, which containers resolve to some hundred nanoseconds at best.
pub(crate) const ORIGIN_TAG: &str = "CATOPTRA_ORIGIN_NS";

impl std::fmt::Debug for VideoFile {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "VideoFile({}, {:?} px)", self.path.display(), self.size_px)
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
            Extent::Several => {
                tracing::warn!(
                    "{}: holds several recordings one after the other; only the first is read: split it, or join them \
                     with a program that knows MP4",
                    path.display()
                );
                None
            }
            Extent::Whole | Extent::Undeclared => None,
        };
        let input = open_input(&path)?;
        match (is_raw(&input), options.stated_rate) {
            (true, None) => return Err(SourceError::NoTime { path, seq: 0 }),
            (false, Some(_)) => return Err(SourceError::RateOfVideo { path }),
            _ => {}
        }
        let mut source = Self::of_input(path, input, options, Clock::Container)?;
        source.decoding.packets.ends_early = ends_early;
        if let Some(from_ns) = options.span.from_ns.filter(|_| source.stated.is_none()) {
            source.seek(from_ns)?;
        }
        Ok(source)
    }

    /// Opens the live stream at `url`: frames leave the decoder at once, and may change their size. It ends when `stop`
    /// is set. Stamps of a stream that [has no times](Self::has_times) are only numbers.
    ///
    /// # Errors
    /// When nobody answers, or the data is not a video that can be decoded.
    pub(super) fn stream(url: &str, stop: &Arc<AtomicBool>) -> Result<Self, SourceError> {
        quiet_libav();
        let options = VideoOptions { keep_damaged: true, ..VideoOptions::default() };
        let mut source = Self::of_input(without_credentials(url).into(), open_stream(url)?, options, Clock::Stream)?;
        source.decoding.stop = Arc::clone(stop);
        Ok(source)
    }

    /// Whether the data has times, or only pictures.
    pub(super) fn has_times(&self) -> bool {
        !is_raw(self.decoding.packets.input())
    }

    fn of_input(
        path: PathBuf,
        input: av::format::context::Input,
        options: VideoOptions,
        clock: Clock,
    ) -> Result<Self, SourceError> {
        let decoding = Decoding::new(path.clone(), input, options.decoder_threads, clock)?;
        let [rate, average] = decoding.packets.rates.map(|rate| (rate.0, rate.1));
        let stated_ns = options.stated_rate.and_then(|rate| Some(rate.stamp_ns(1)? as f64));
        let time_base = decoding.packets.time_base;
        let tick_ns = 1e9 * f64::from(time_base.0) / f64::from(time_base.1.max(1));
        let declared_ns = stated_ns.or_else(|| plausible_period_ns(rate, average, tick_ns));
        let origin_ns = match decoding.packets.input().metadata().get(ORIGIN_TAG) {
            Some(text) => text.parse().map_err(|_| SourceError::NotAVideo {
                path: path.clone(),
                reason: format!("its tag {ORIGIN_TAG} is `{text}`, expected whole nanoseconds"),
            })?,
            None => 0,
        };
        Ok(Self {
            pictures: PictureMaker::new(path.clone(), decoding.decoder().id()),
            size_px: [decoding.decoder().width(), decoding.decoder().height()],
            stamps: StampWatch::new(path.display().to_string(), declared_ns, tick_ns),
            frame_count_hint: decoding.packets.count_hint(options.span),
            path,
            clock,
            decoding,
            stated: options.stated_rate,
            origin_ns,
            keep_damaged: options.keep_damaged,
            layout: None,
            missing: 0,
            span: options.span,
            ended: false,
            faults: StreamFaults::default(),
            unplaced: 0,
            unstamped_in_a_row: 0,
            seq: 0,
            arrival: None,
            latest_pts: None,
            before_ns: None,
            after_ns: None,
            last_good_ns: None,
        })
    }

    /// What its stamps were so far.
    pub(super) fn into_stamps(self) -> StampWatch {
        self.stamps
    }

    /// When the packet of the last frame passed on was read, in a stream.
    pub(super) fn arrival(&self) -> Option<Instant> {
        self.arrival
    }

    /// Seeks to a key frame from which the frame at `from_ns` can be decoded. libav's index may lead to one that is
    /// shown later, so the first decoded frame decides.
    fn seek(&mut self, from_ns: i64) -> Result<(), SourceError> {
        for margin_s in [0, 2, 10, 60] {
            let to_us = from_ns.saturating_sub(self.origin_ns) / 1000 - margin_s * 1_000_000;
            if !self.decoding.seek(to_us) {
                break;
            }
            let Some(first) = self.decoding.next_picture() else { continue };
            // Their places count from the first packet.
            if self.decoding.packets.takes_turns {
                break;
            }
            let starts_ns = first.pts().map(|ticks| self.timed(ticks)).transpose()?.map(|stamp| stamp.ns);
            self.decoding.put_back(first);
            if starts_ns.is_some_and(|starts_ns| starts_ns <= from_ns) {
                return Ok(());
            }
        }
        // Not seekable, or the span starts before the first frame: read from the start.
        self.decoding.restart()
    }

    /// What becomes of pictures that are not trusted.
    fn fate(&self) -> &'static str {
        if self.keep_damaged { "not measured" } else { "left out" }
    }

    /// A picture's place is not known, as packets may be missing at the end.
    fn leave_out_last(&mut self, stamp: Timestamp) {
        self.faults.pictures_left_out += 1;
        self.unplaced += 1;
        if self.unplaced == 1 && self.decoding.packets.ends_early.is_none() {
            tracing::warn!(
                "{}: the pictures from {} s on are {}: nothing tells whether the stream is complete, and if packets \
                 are missing at its end, these pictures belong to later times",
                self.path.display(),
                stamp.seconds(),
                self.fate()
            );
        }
    }

    fn leave_out(&mut self, stamp: Timestamp) {
        self.faults.pictures_left_out += 1;
        if self.faults.pictures_left_out == self.unplaced + 1 && self.decoding.packets.ends_early.is_none() {
            let fate = self.fate();
            tracing::warn!(
                "{}: the picture at {} s is damaged and {fate}, as are those predicted from it; more are counted",
                self.path.display(),
                stamp.seconds()
            );
        }
    }

    /// The container's time of a picture, or that of its turn.
    fn stamp(&mut self, picture: &Decoded) -> Result<Timestamp, SourceError> {
        let ticks = match picture.time {
            Some(ticks) if !picture.in_turn => ticks,
            time => {
                // Of a recording's pictures, libav's guess depends on the number of threads; a repeated time is seen to
                // be one.
                let guess = picture.frame.timestamp();
                let latest = self.latest_pts.filter(|_| guess.is_some() && self.clock == Clock::Container);
                let no_time = || SourceError::NoTime { path: self.path.clone(), seq: self.seq };
                let ticks = time.or(latest).or(guess).ok_or_else(no_time)?;
                self.note_guess();
                ticks
            }
        };
        let stamp = self.timed(ticks)?;
        (self.latest_pts, self.decoding.packets.reached_ns) = (Some(ticks), Some(stamp.ns));
        Ok(stamp)
    }

    /// A picture has no time of its own. Those of a raw stream never have.
    fn note_guess(&mut self) {
        if !self.has_times() {
            return;
        }
        self.faults.guessed_stamps += 1;
        if self.faults.guessed_stamps == 1 {
            tracing::warn!(
                "{}: frames after {} have no presentation time; the times of their packets are taken in turn",
                self.path.display(),
                self.decoding.packets.at()
            );
        }
    }

    /// The time that a container's ticks, or a picture's place in a raw stream of stated rate, mean.
    fn timed(&self, ticks: i64) -> Result<Timestamp, SourceError> {
        let out_of_range = || SourceError::TimeRange { path: self.path.clone(), seq: self.seq };
        if let Some(rate) = self.stated {
            let ns = u64::try_from(ticks).ok().and_then(|number| rate.stamp_ns(number)).ok_or_else(out_of_range)?;
            return Ok(Timestamp { ns, clock: Clock::StatedRate });
        }
        let av::Rational(numerator, denominator) = self.decoding.packets.time_base;
        let ns = ticks_to_ns(ticks, numerator.into(), denominator.into())
            .and_then(|ns| ns.checked_add(self.origin_ns))
            .ok_or_else(out_of_range)?;
        Ok(Timestamp { ns, clock: self.clock })
    }

    /// The stream has ended: complete, early, or empty.
    fn end(&mut self) -> Result<Option<Frame>, SourceError> {
        self.ended = true;
        let faults = self.faults();
        // Those whose places are not known were told of, and need not be damaged.
        let pictures_left_out = faults.pictures_left_out.saturating_sub(self.unplaced);
        StreamFaults { pictures_left_out, ..faults }.report(&self.path);
        if self.stated.is_some() && self.faults.pictures_left_out > self.unplaced {
            tracing::warn!(
                "{}: a raw stream has no times: if the damage left no trace of some pictures, those after it are too \
                 early by as many frames",
                self.path.display()
            );
        }
        let path = self.path.clone();
        if let Some(why) = self.decoding.packets.ends_early.take() {
            let last_good_s = self.last_good_ns.map(seconds);
            return Err(SourceError::Truncated { path, frames: self.seq, last_good_s, why });
        }
        if self.seq > 0 {
            return Ok(None);
        }
        if self.decoding.packets.reached_ns.is_none() || self.span == Span::default() {
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
        self.ended |= next.is_err();
        next
    }

    /// 0 of a stream that was joined between two key frames, before its first picture.
    fn size_px(&self) -> [u32; 2] {
        self.size_px
    }

    fn frame_count_hint(&self) -> Option<u64> {
        self.frame_count_hint
    }

    fn faults(&self) -> StreamFaults {
        StreamFaults { damaged_packets: self.decoding.damaged_packets, ..self.faults }
    }
}

impl VideoFile {
    /// The next frame of the span that is not damaged.
    fn next_sound(&mut self) -> Result<Option<Frame>, SourceError> {
        while !self.ended {
            let next = self.decoding.next_picture();
            let until = next.as_ref().map_or(Some(i64::MAX), Decoded::pts);
            if self.layout.is_none() {
                self.layout = next.as_ref().and_then(|next| self.pictures.layout(&next.frame));
            }
            if let Some(frame) = self.undecoded_before(until)? {
                next.into_iter().for_each(|next| self.decoding.put_back(next));
                return Ok(Some(frame));
            }
            let Some(decoded) = next else {
                return self.end();
            };
            let Some(stamp) = self.stamp_if_any(&decoded)? else { continue };
            if self.span.from_ns.is_some_and(|from| stamp.ns < from) {
                self.before_ns = Some(stamp.ns);
                continue;
            }
            if self.span.to_ns.is_some_and(|to| stamp.ns > to) {
                self.decoding.packets.ends_early = None;
                self.after_ns = Some(stamp.ns);
                return self.end();
            }
            let gap = self.stamps.gap(stamp.ns, self.seq, &mut self.faults);
            self.missing = self.missing.saturating_add(gap);
            if gap > 0 {
                self.pictures.are_missing_before(&decoded.frame, stamp.seconds());
            }
            let sound = self.decoding.is_sound(&decoded);
            if !sound {
                if self.decoding.may_lack_before(&decoded) {
                    self.leave_out_last(stamp);
                } else {
                    self.leave_out(stamp);
                }
                if !self.keep_damaged {
                    self.missing = self.missing.saturating_add(1);
                    continue;
                }
            }
            if self.size_px == [0, 0] {
                self.size_px = [decoded.frame.width(), decoded.frame.height()];
            }
            self.check_size(&decoded.frame, stamp)?;
            self.arrival = self.decoding.packets.arrival_of(decoded.frame.pts());
            let stated = self.decoding.stated_of(&decoded);
            let picture = self.pictures.picture_stating(decoded.frame, stated)?;
            self.layout = Some((picture.format(), picture.colour()));
            let picture = if sound { picture } else { picture.marked_damaged() };
            if sound {
                self.last_good_ns = Some(stamp.ns);
            }
            return Ok(Some(self.frame(stamp, picture)));
        }
        Ok(None)
    }

    /// The stamp of a frame; `None` for a frame without any, which is left out and counted: the first ones of some
    /// streams or of a span, and where the packet with the stamp was lost.
    fn stamp_if_any(&mut self, picture: &Decoded) -> Result<Option<Timestamp>, SourceError> {
        let stamp = self.stamp(picture);
        let has_others = self.clock == Clock::Stream || self.latest_pts.is_some() || self.span.from_ns.is_some();
        match &stamp {
            // A recording or stream without times is refused.
            Err(SourceError::NoTime { .. })
                if self.has_times() && has_others && self.unstamped_in_a_row < MOST_UNSTAMPED =>
            {
                self.unstamped_in_a_row += 1;
                self.faults.unstamped += 1;
                if self.faults.unstamped == 1 {
                    tracing::warn!(
                        "{}: frames without a time stamp are left out: those before the first one, or whose packet was \
                         lost; they are counted",
                        self.path.display()
                    );
                }
                return Ok(None);
            }
            Ok(_) => self.unstamped_in_a_row = 0,
            Err(_) => {}
        }
        stamp.map(Some)
    }

    /// The pictures of a recording have one size.
    fn check_size(&self, frame: &av::frame::Video, stamp: Timestamp) -> Result<(), SourceError> {
        let after = [frame.width(), frame.height()];
        if after == self.size_px || self.clock != Clock::Container {
            return Ok(());
        }
        Err(SourceError::SizeChange {
            path: self.path.clone(),
            at: format!("{} s", stamp.seconds()),
            seq: self.seq,
            before: self.size_px,
            after,
        })
    }

    fn frame(&mut self, stamp: Timestamp, picture: Picture) -> Frame {
        let frame = Frame { seq: self.seq, stamp, gap: std::mem::take(&mut self.missing), host: None, picture };
        self.seq += 1;
        frame
    }

    /// The frame of a damaged packet that gave no picture, if one comes before `pts`.
    fn undecoded_before(&mut self, pts: Option<i64>) -> Result<Option<Frame>, SourceError> {
        while let Some(first) = self.decoding.failed_before(pts) {
            let Some((format, colour)) = self.layout.filter(|_| self.keep_damaged) else { continue };
            let stamp = self.timed(first)?;
            if !self.span.contains(stamp.ns) {
                continue;
            }
            self.missing = self.missing.saturating_add(self.stamps.gap(stamp.ns, self.seq, &mut self.faults));
            self.leave_out(stamp);
            let Ok(picture) = Picture::missing(self.size_px, format, colour) else { continue };
            self.arrival = self.decoding.packets.arrival_of(Some(first));
            return Ok(Some(self.frame(stamp, picture)));
        }
        Ok(None)
    }
}
