//! A video file of drawings: H.264 in MP4 through libav, every frame at its camera time.
//!
//! Times are rounded to whole microseconds (1/60 000 s with the MPEG-4 part 2 encoder, its finest unit): at most 0.5 µs
//! (8.4 µs) from the stamp given, never accumulating. Frame intervals may vary; a gap stays a gap.

use super::clock::{Origin, Rising};
use super::colour::FromBgr;
use super::{SinkError, settle_written};
use crate::source::{quiet_libav, url_of};
use ffmpeg_the_third as av;
use std::path::{Path, PathBuf};

/// Encoders, tried in this order.
const ENCODERS: [Encoder; 3] = [
    Encoder { name: "libx264", ticks_per_s: 1_000_000, options: &[("preset", "veryfast"), ("crf", "20")] },
    Encoder { name: "libopenh264", ticks_per_s: 1_000_000, options: &[("rc_mode", "quality")] },
    Encoder { name: "mpeg4", ticks_per_s: 60_000, options: &[("q", "3")] },
];

/// Frames from key frame to key frame: jumps in a player land within two seconds at 60 Hz.
const KEY_FRAME_EVERY: u32 = 120;

struct Encoder {
    name: &'static str,
    ticks_per_s: i64,
    options: &'static [(&'static str, &'static str)],
}

/// Writes one video file.
pub(crate) struct VideoWriter {
    path: PathBuf,
    output: av::format::context::Output,
    encoder: av::encoder::video::Encoder,
    to_yuv: FromBgr,
    ticks_per_s: i64,
    phase: Phase,
}

enum Phase {
    /// No frame yet; the header needs the time of the first.
    Fresh,
    Running {
        origin: Origin,
        shown: Rising,
        /// Last interval, ticks: also how long the last frame is shown.
        interval: i64,
    },
    Finished,
}

impl VideoWriter {
    /// Opens the file and the encoder for BGR pictures of even width and height.
    pub(crate) fn create(path: &Path, size_px: [u32; 2]) -> Result<Self, SinkError> {
        // The standard library's error for a missing folder is clearer than libav's; libav then overwrites the file.
        std::fs::File::create(path).map_err(|source| SinkError::Io { path: path.into(), source })?;
        let fail = |doing| move |source| SinkError::Video { path: path.into(), doing, source };
        quiet_libav();
        let mut output = av::format::output_as(url_of(path), "mp4").map_err(fail("opening"))?;
        let (codec, choice) = find_encoder(path)?;

        let mut settings = av::codec::Context::new_with_codec(codec).encoder().video().map_err(fail("encoder"))?;
        let [width, height] = size_px;
        settings.set_width(width);
        settings.set_height(height);
        settings.set_format(av::format::Pixel::YUV420P);
        settings.set_colorspace(av::color::Space::BT709);
        settings.set_color_range(av::color::Range::MPEG);
        settings.set_time_base(av::Rational(1, choice.ticks_per_s as i32));
        // Rate control only: without it x264 would take the time base for the frame rate.
        settings.set_frame_rate(Some(av::Rational(60, 1)));
        settings.set_gop(KEY_FRAME_EVERY);
        // Frames leave in order of arrival: decoding times are the stamps themselves, and the file needs no offset.
        settings.set_max_b_frames(0);
        if output.format().flags().contains(av::format::Flags::GLOBAL_HEADER) {
            settings.set_flags(av::codec::Flags::GLOBAL_HEADER);
        }
        let mut options = av::Dictionary::new();
        for (key, value) in choice.options {
            options.set(key, value);
        }
        let encoder = settings.open_with(options).map_err(fail("opening the encoder"))?;

        let mut stream = output.add_stream(codec).map_err(fail("adding the stream"))?;
        stream.set_time_base(av::Rational(1, choice.ticks_per_s as i32));
        stream.copy_parameters_from_context(&encoder);
        let to_yuv = FromBgr::for_video(size_px).map_err(fail("colour conversion"))?;
        Ok(Self { path: path.into(), output, encoder, to_yuv, ticks_per_s: choice.ticks_per_s, phase: Phase::Fresh })
    }

    /// Adds a picture, rows of B'G'R' with `stride` bytes each, shown from `stamp_ns` on.
    pub(crate) fn write(&mut self, bgr: &[u8], stride: usize, stamp_ns: i64) -> Result<(), SinkError> {
        if let Phase::Fresh = self.phase {
            self.start(Origin::of_first(stamp_ns))?;
        }
        let Phase::Running { origin, shown, interval } = &mut self.phase else {
            return Err(self.failed("writing after the end")(av::Error::Eof));
        };
        let (before, own) = (shown.last, ticks(origin.elapsed_ns(stamp_ns), self.ticks_per_s));
        let tick = shown.next(
            own,
            stamp_ns,
            "a frame is not later than the one before: such frames are one tick apart in the overlay",
        );
        if before >= 0 {
            *interval = tick - before;
        }
        let mut frame = self.to_yuv.convert(bgr, stride).map_err(self.failed("colour conversion"))?;
        frame.set_pts(Some(tick));
        frame.set_color_space(av::color::Space::BT709);
        frame.set_color_range(av::color::Range::MPEG);
        self.encoder.send_frame(&frame).map_err(self.failed("encoding"))?;
        self.drain()
    }

    /// Encodes the rest and completes the file; a second call does nothing.
    pub(crate) fn finish(&mut self) -> Result<(), SinkError> {
        match self.phase {
            Phase::Finished => return Ok(()),
            Phase::Fresh => self.start(Origin::of_first(0))?,
            Phase::Running { .. } => {}
        }
        let flushed = self.encoder.send_eof().map_err(self.failed("encoding")).and_then(|()| self.drain());
        self.phase = Phase::Finished;
        // The trailer makes the file playable even if the encoder failed.
        let ended = self.output.write_trailer().map_err(self.failed("completing"));
        flushed.and(ended)?;
        settle_written(&self.path)
    }

    fn start(&mut self, origin: Origin) -> Result<(), SinkError> {
        if origin.ns != 0 {
            let note = format!("time 0 of this file is {} ns of the camera's clock", origin.ns);
            self.output.metadata_mut().set("comment", &note);
        }
        let mut options = av::Dictionary::new();
        // The time of the first frame is stored in this unit; MP4's own default would round it to milliseconds.
        options.set("movie_timescale", self.ticks_per_s.to_string());
        self.output.write_header_with(options).map_err(self.failed("writing the header"))?;
        self.phase = Phase::Running { origin, shown: Rising::new(), interval: self.ticks_per_s / 60 };
        Ok(())
    }

    /// Moves finished packets from the encoder into the file.
    fn drain(&mut self) -> Result<(), SinkError> {
        let interval = if let Phase::Running { interval, .. } = self.phase { interval } else { 0 };
        let codec_base = av::Rational(1, self.ticks_per_s as i32);
        let stream_base = self.output.stream(0).map_or(codec_base, |s| s.time_base());
        let mut packet = av::Packet::empty();
        while receive(&mut self.encoder, &mut packet).map_err(self.failed("encoding"))? {
            packet.set_stream(0);
            packet.set_duration(interval);
            packet.rescale_ts(codec_base, stream_base);
            packet.write_interleaved(&mut self.output).map_err(self.failed("writing"))?;
        }
        Ok(())
    }

    fn failed(&self, doing: &'static str) -> impl Fn(av::Error) -> SinkError + use<> {
        let path = self.path.clone();
        move |source| SinkError::Video { path: path.clone(), doing, source }
    }
}

/// Takes a finished packet from an encoder; `false` when it wants more frames first, or has ended.
pub(super) fn receive(encoder: &mut av::encoder::video::Encoder, packet: &mut av::Packet) -> Result<bool, av::Error> {
    match encoder.receive_packet(packet) {
        Ok(()) => Ok(true),
        Err(av::Error::Eof) => Ok(false),
        Err(av::Error::Other { errno }) if would_block(errno) => Ok(false),
        Err(error) => Err(error),
    }
}

/// Whether a system error number is EAGAIN, whose value depends on the system.
fn would_block(errno: i32) -> bool {
    std::io::Error::from_raw_os_error(errno).kind() == std::io::ErrorKind::WouldBlock
}

/// Nanoseconds in whole ticks, rounded to nearest.
fn ticks(ns: i64, ticks_per_s: i64) -> i64 {
    let product = i128::from(ns) * i128::from(ticks_per_s);
    let rounded = (product + 500_000_000).div_euclid(1_000_000_000);
    i64::try_from(rounded).unwrap_or(i64::MAX)
}

fn find_encoder(path: &Path) -> Result<(av::Codec, &'static Encoder), SinkError> {
    for choice in &ENCODERS {
        if let Some(codec) = av::encoder::find_by_name(choice.name) {
            if choice.name != "libx264" {
                tracing::warn!(
                    encoder = choice.name,
                    "libav is built without libx264: the overlay will be larger or poorer"
                );
            }
            return Ok((codec, choice));
        }
    }
    Err(SinkError::NoEncoder { path: path.into(), tried: ENCODERS.map(|e| e.name).join(", ") })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stamps_round_to_the_nearest_tick() {
        assert_eq!(ticks(16_666_667, 1_000_000), 16_667);
        assert_eq!(ticks(16_666_499, 1_000_000), 16_666);
        assert_eq!(ticks(16_666_667, 60_000), 1_000);
        assert_eq!(ticks(i64::MAX, 1_000_000), 9_223_372_036_854_776);
    }
}
