//! V4L2 cameras on Linux: `/dev/video0`, or better, its persistent name under `/dev/v4l/by-id`.
//!
//! The kernel stamps each buffer with its monotonic clock, at the start of the exposure or the end of the transfer as
//! the driver declares; the program reads the same clock, so a stamp's age is known exactly. The driver counts buffers.
//! Not supported: devices with separate planes (multi-planar, as on some phone processors).

use super::super::counter::Wrap;
use super::super::decoded::{PictureMaker, is_damaged};
use super::super::host::HostClock;
use super::super::jpeg::{self, Steps};
use super::super::{Clock, SourceError, Timestamp};
use super::camera::{Camera, CapturedFrame, Connection, INTERLACED};
use super::samples;
use super::settings::{Asked, CameraSettings};
use super::v4l2_setup::{self as setup, Layout, Offer, letters};
use ffmpeg_the_third as av;
use rustix::time::{ClockId, clock_gettime};
use std::io;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};
use v4l::buffer::{Flags, Metadata, Type};
use v4l::control::{Control, Value};
use v4l::format::FieldOrder;
use v4l::format::{Colorspace, Quantization, TransferFunction};
use v4l::frameinterval::FrameIntervalEnum;
use v4l::framesize::FrameSizeEnum;
use v4l::io::mmap::Stream;
use v4l::io::traits::{CaptureStream, Stream as _};
use v4l::video::Capture as _;
use v4l::{Device, Format, FourCC, Fraction, capability};

/// Buffers that the driver may fill ahead.
const BUFFERS: u32 = 8;

impl Camera {
    /// The V4L2 camera at `path`.
    ///
    /// # Errors
    /// When there is none, or its pictures cannot be read.
    pub fn v4l2(
        path: &Path,
        settings: CameraSettings,
        clock: HostClock,
        stop: Arc<AtomicBool>,
    ) -> Result<Self, SourceError> {
        let name = path.display().to_string();
        let (path, called) = (path.to_path_buf(), name.clone());
        let open = move || -> Result<Box<dyn Connection>, SourceError> {
            let refused = |reason: String| SourceError::Camera { name: called.clone(), reason };
            Ok(Box::new(Session::open(&called, &path, &settings).map_err(refused)?))
        };
        Self::start(&name, Box::new(open), clock, stop)
    }
}

/// A camera that is streaming.
struct Session {
    name: String,
    stream: Stream<'static>,
    pictures: PictureMaker,
    layout: Layout,
    jpeg: Option<JpegDecoder>,
    format: Format,
    sources_named: bool,
}

impl Session {
    fn open(name: &str, path: &Path, settings: &CameraSettings) -> Result<Self, String> {
        let device = Device::with_path(path).map_err(|e| format!("no camera that can be opened ({e})"))?;
        let caps = device.query_caps().map_err(|e| format!("is not a camera ({e})"))?;
        let needed = capability::Flags::VIDEO_CAPTURE | capability::Flags::STREAMING;
        if !caps.capabilities.contains(needed) {
            return Err(format!(
                "{} gives no pictures here (it can {}); a camera often has a second device beside, such as /dev/video0 \
                 beside /dev/video1",
                caps.card, caps.capabilities
            ));
        }
        let format = set_format(name, &device, settings)?;
        let code = letters(format.fourcc.repr);
        let layout = setup::layout(format.fourcc.repr)
            .ok_or_else(|| format!("the camera takes pixel format {code}, which cannot be read"))?;
        set_rate(name, &device, settings);
        for control in setup::controls(settings) {
            let objection = control.apply(
                |id, value| device.set_control(Control { id, value: Value::Integer(value) }),
                |id| match device.control(id)?.value {
                    Value::Integer(value) => Ok(value),
                    Value::Boolean(value) => Ok(value.into()),
                    _ => Err(io::ErrorKind::InvalidData.into()),
                },
            );
            objection.into_iter().for_each(|text| tracing::warn!("{name}: {text}"));
        }
        let (jpeg, codec) = match layout {
            Layout::Jpeg => (Some(JpegDecoder::new()?), av::codec::Id::MJPEG),
            Layout::Raw(_) => (None, av::codec::Id::RAWVIDEO),
        };
        let stream = started(&device).map_err(|e| format!("does not start: {e}; is another program using it?"))?;
        tracing::info!("{name}: {}, {code}, {}x{} pixels", caps.card, format.width, format.height);
        let pictures = PictureMaker::new(name.into(), codec);
        Ok(Self { name: name.to_owned(), stream, pictures, layout, jpeg, format, sources_named: false })
    }

    fn lost(&self, error: &io::Error) -> SourceError {
        SourceError::Camera { name: self.name.clone(), reason: error.to_string() }
    }

    /// Reports once which moment the driver stamps.
    fn name_sources(&mut self, flags: Flags) {
        if std::mem::replace(&mut self.sources_named, true) {
            return;
        }
        let start = flags & Flags::TSTAMP_SRC_MASK == Flags::TSTAMP_SRC_SOE;
        let moment = if start { "the start of the exposure" } else { "the end of the frame" };
        tracing::debug!("{}: the driver stamps {moment}; buffer flags {flags:?}", self.name);
    }
}

impl Connection for Session {
    fn next(&mut self, wait: Duration) -> Result<Option<CapturedFrame>, SourceError> {
        // The binding's own time-out corrupts its queue, so a buffer is requested only when there is one.
        let wait_ms = i32::try_from(wait.as_millis()).unwrap_or(i32::MAX);
        match self.stream.handle().poll(POLLIN, wait_ms) {
            Ok(0) => return Ok(None),
            Ok(_) => {}
            Err(error) if error.kind() == io::ErrorKind::Interrupted => return Ok(None),
            Err(error) => return Err(self.lost(&error)),
        }
        let (bytes, meta) = match self.stream.next() {
            Ok((bytes, meta)) => (bytes, *meta),
            Err(error) => {
                return Err(SourceError::Camera { name: self.name.clone(), reason: error.to_string() });
            }
        };
        let (arrival, now) = (Instant::now(), clock_gettime(ClockId::Monotonic));
        let bytes = bytes.get(..meta.bytesused as usize).unwrap_or(bytes);
        let picture = if meta.flags.contains(Flags::ERROR) {
            Err("the driver marks it as damaged".to_owned())
        } else {
            video(bytes, self.layout, self.jpeg.as_mut(), &self.format).and_then(|(frame, steps)| {
                let picture = self.pictures.picture(frame).map_err(|e| e.to_string())?;
                Ok(picture.of_jpeg(steps.as_ref()))
            })
        };
        self.name_sources(meta.flags);
        let stamp = stamp(&meta);
        let now_ns = now.tv_sec.saturating_mul(1_000_000_000).saturating_add(now.tv_nsec);
        let age = stamp.and_then(|stamp| u64::try_from(now_ns.saturating_sub(stamp.ns)).ok()).map(Duration::from_nanos);
        Ok(Some(CapturedFrame { number: meta.sequence.into(), stamp, arrival, age, picture }))
    }

    fn size_px(&self) -> [u32; 2] {
        [self.format.width, self.format.height]
    }

    fn wrap(&self) -> Wrap {
        Wrap::Bits32
    }

    fn driver_counts(&self) -> bool {
        true
    }
}

/// `poll(2)`: data can be read.
const POLLIN: i16 = 1;

/// Starts streaming. All buffers but the first are queued here; the binding queues that one when asked for a picture.
fn started(device: &Device) -> io::Result<Stream<'static>> {
    let mut stream = Stream::with_buffers(device, Type::VideoCapture, BUFFERS)?;
    stream.set_timeout(Duration::from_secs(1));
    // The driver may have granted fewer than requested.
    (1..BUFFERS as usize).try_for_each(|index| stream.queue(index)).or_else(|error| match error.raw_os_error() {
        Some(INVALID) => Ok(()),
        _ => Err(error),
    })?;
    stream.start()?;
    Ok(stream)
}

/// `errno(3)`: no such buffer.
const INVALID: i32 = 22;

/// The kernel's stamp; `None` when it is not of the monotonic clock.
fn stamp(meta: &Metadata) -> Option<Timestamp> {
    if meta.flags & Flags::TIMESTAMP_MASK != Flags::TIMESTAMP_MONOTONIC {
        return None;
    }
    let ns = meta.timestamp.sec.checked_mul(1_000_000_000)?.checked_add(meta.timestamp.usec.checked_mul(1000)?)?;
    Some(Timestamp { ns, clock: Clock::V4l2Monotonic })
}

/// The picture in a buffer, with the driver's colour tags, and the quantiser steps of a JPEG.
fn video(
    bytes: &[u8],
    layout: Layout,
    jpeg: Option<&mut JpegDecoder>,
    format: &Format,
) -> Result<(av::frame::Video, Option<Steps>), String> {
    match (layout, jpeg) {
        (Layout::Raw(pixel), _) => {
            let padding = (format.stride as usize).saturating_sub(samples::row_bytes(pixel, 0, format.width as usize));
            let frame = samples::of_buffer(bytes, pixel, [format.width, format.height], padding);
            let mut frame = frame.ok_or_else(|| format!("its buffer holds {} bytes only", bytes.len()))?;
            tag(&mut frame, format);
            Ok((frame, None))
        }
        (Layout::Jpeg, Some(jpeg)) => jpeg.decode(bytes),
        (Layout::Jpeg, None) => Err("there is no decoder".to_owned()),
    }
}

/// Decodes a camera's JPEGs one by one.
struct JpegDecoder {
    /// Sees the damage that the decoder conceals: on a busy bus, pieces of pictures are lost without a word.
    examiner: jpeg::Examiner,
    decoder: av::decoder::Video,
}

impl JpegDecoder {
    fn new() -> Result<Self, String> {
        let codec = av::decoder::find(av::codec::Id::MJPEG).ok_or("FFmpeg has no decoder of JPEG here")?;
        let decoder = av::codec::Context::new_with_codec(codec).decoder().video();
        let decoder = decoder.map_err(|e| format!("no decoder of JPEG: {e}"))?;
        Ok(Self { examiner: jpeg::Examiner::default(), decoder })
    }

    fn decode(&mut self, bytes: &[u8]) -> Result<(av::frame::Video, Option<Steps>), String> {
        if jpeg::is_cut_off(bytes) {
            return Err("its JPEG ends early".to_owned());
        }
        let jpeg::Examined { damage, steps } = self.examiner.examine(bytes);
        if let Some(what) = damage {
            return Err(format!("its JPEG is damaged: {what}"));
        }
        let mut frame = av::frame::Video::empty();
        self.decoder
            .send_packet(&av::Packet::copy(bytes))
            .and_then(|()| self.decoder.receive_frame(&mut frame))
            .map_err(|e| format!("its JPEG cannot be decoded: {e}"))?;
        if is_damaged(&frame) { Err("its JPEG is damaged".to_owned()) } else { Ok((frame, steps)) }
    }
}

/// Colour tags as V4L2 defines them; the defaults are those of `linux/videodev2.h` (V4L2_MAP_*_DEFAULT).
fn tag(frame: &mut av::frame::Video, format: &Format) {
    use av::color::{Range, Space, TransferCharacteristic as Curve};
    let full = match format.quantization {
        Quantization::FullRange => true,
        Quantization::LimitedRange => false,
        Quantization::Default => matches!(format.colorspace, Colorspace::JPEG),
    };
    frame.set_color_range(if full { Range::JPEG } else { Range::MPEG });
    frame.set_color_space(match format.colorspace {
        Colorspace::Rec709 | Colorspace::DCIP3 => Space::BT709,
        Colorspace::Rec2020 => Space::BT2020NCL,
        _ => Space::SMPTE170M,
    });
    frame.set_color_transfer_characteristic(match (format.transfer, format.colorspace) {
        (TransferFunction::None, _) | (TransferFunction::Default, Colorspace::RAW) => Curve::Linear,
        (TransferFunction::SRGB, _) | (TransferFunction::Default, Colorspace::SRGB | Colorspace::JPEG) => {
            Curve::IEC61966_2_1
        }
        _ => Curve::BT709,
    });
}

/// Sets format and size; returns what the camera accepted.
fn set_format(name: &str, device: &Device, settings: &CameraSettings) -> Result<Format, String> {
    let [width, height] = settings.size_px;
    let descriptions = device.enum_formats().map_err(|e| format!("does not report its pixel formats: {e}"))?;
    let offers: Vec<Offer> = descriptions.iter().map(|d| offer(device, d.fourcc, settings.size_px)).collect();
    let code = setup::choose(&offers, settings.format.as_deref(), settings.rate)?;
    let wanted = Format::new(width, height, FourCC::new(&code));
    let got = device
        .set_format(&wanted)
        .map_err(|e| format!("the camera refuses {width}x{height} pixels of {}: {e}", letters(code)))?;
    if got.fourcc.repr != code {
        let (asked, taken) = (letters(code), letters(got.fourcc.repr));
        tracing::warn!("{name}: pixel format: {asked} requested, the camera uses {taken}");
    }
    // Drivers without a choice may leave it open.
    if !matches!(got.field_order, FieldOrder::Any | FieldOrder::Progressive) {
        return Err(format!("its pictures are interlaced ({}): {INTERLACED}", got.field_order));
    }
    Ok(got)
}

fn offer(device: &Device, fourcc: FourCC, [width, height]: [u32; 2]) -> Offer {
    let fits = |size: &FrameSizeEnum| match size {
        FrameSizeEnum::Discrete(size) => (size.width, size.height) == (width, height),
        FrameSizeEnum::Stepwise(sizes) => {
            (sizes.min_width..=sizes.max_width).contains(&width)
                && (sizes.min_height..=sizes.max_height).contains(&height)
        }
    };
    let sizes = device.enum_framesizes(fourcc).unwrap_or_default();
    let has_size = sizes.is_empty() || sizes.iter().any(|size| fits(&size.size));
    let intervals = device.enum_frameintervals(fourcc, width, height).unwrap_or_default();
    let rates = intervals.iter().map(|interval| match &interval.interval {
        FrameIntervalEnum::Discrete(interval) => hz(*interval),
        FrameIntervalEnum::Stepwise(intervals) => hz(intervals.min),
    });
    Offer { code: fourcc.repr, has_size, most_hz: rates.reduce(f64::max) }
}

fn hz(interval: Fraction) -> f64 {
    f64::from(interval.denominator) / f64::from(interval.numerator.max(1))
}

fn set_rate(name: &str, device: &Device, settings: &CameraSettings) {
    let Some(rate) = settings.rate else { return };
    let asked = Asked { what: "frame rate", unit: " Hz", value: rate.hz() };
    let mut parameters = match device.params() {
        Ok(parameters) => parameters,
        Err(error) => {
            tracing::warn!(
                "{name}: {}",
                asked.objection::<io::Error>(Err(error), Err(io::ErrorKind::Unsupported.into())).unwrap_or_default()
            );
            return;
        }
    };
    parameters.interval = interval(rate.fraction());
    let (set, got) = match device.set_params(&parameters) {
        Ok(got) => (Ok(()), Ok(hz(got.interval))),
        Err(error) => (Err(error), device.params().map(|now| hz(now.interval))),
    };
    asked.objection(set, got).into_iter().for_each(|text| tracing::warn!("{name}: {text}"));
}

/// Seconds per frame, in V4L2's 32-bit fraction: 59.94 is 59 940 000 000 / 1 000 000 000 here.
fn interval((mut frames, mut seconds): (i64, i64)) -> Fraction {
    while frames % 10 == 0 && seconds % 10 == 0 && seconds > 0 {
        (frames, seconds) = (frames / 10, seconds / 10);
    }
    while frames.max(seconds) > i64::from(u32::MAX) {
        (frames, seconds) = (frames / 2, seconds / 2);
    }
    let small = |n: i64| u32::try_from(n).unwrap_or(u32::MAX).max(1);
    Fraction::new(small(seconds), small(frames))
}

#[cfg(test)]
mod tests {
    use super::*;
    use v4l::Timestamp as Time;

    fn format(code: &[u8; 4], width: u32, height: u32, stride: u32) -> Format {
        Format { stride, ..Format::new(width, height, FourCC::new(code)) }
    }

    #[test]
    fn a_stamp_counts_if_it_is_of_the_monotonic_clock() {
        let meta = |flags: Flags| Metadata { flags, timestamp: Time::new(12, 345_678), ..Metadata::default() };
        let found = stamp(&meta(Flags::TIMESTAMP_MONOTONIC | Flags::TSTAMP_SRC_SOE | Flags::DONE)).unwrap();
        assert_eq!((found.ns, found.clock), (12_345_678_000, Clock::V4l2Monotonic));
        assert_eq!(stamp(&meta(Flags::TIMESTAMP_COPY)), None);
        assert_eq!(stamp(&meta(Flags::TIMESTAMP_UNKNOWN)), None);
    }

    #[test]
    fn raw_pictures_carry_the_driver_s_rows_and_colours() {
        // 4 x 2 pixels of YUYV, rows of 12 bytes.
        let bytes: Vec<u8> = (0..24).collect();
        let srgb = Format { colorspace: Colorspace::SRGB, ..format(b"YUYV", 4, 2, 12) };
        let (frame, _) = video(&bytes, Layout::Raw(av::format::Pixel::YUYV422), None, &srgb).unwrap();
        assert_eq!(frame.data(0)[frame.stride(0)..][..8], [12, 13, 14, 15, 16, 17, 18, 19]);
        let mut maker = PictureMaker::new("test".into(), av::codec::Id::RAWVIDEO);
        let colour = maker.picture(frame).unwrap().colour();
        use crate::source::{Matrix, Range, Transfer};
        assert_eq!((colour.matrix, colour.range, colour.transfer), (Matrix::Bt601, Range::Limited, Transfer::Srgb));
        let short = video(&bytes[..18], Layout::Raw(av::format::Pixel::YUYV422), None, &srgb).err().unwrap();
        assert!(short.contains("18 bytes"), "{short}");
    }

    #[test]
    fn jpegs_are_decoded_one_by_one_and_damaged_ones_are_refused() {
        let mut bytes = Vec::new();
        let grey = image::RgbImage::from_pixel(64, 48, image::Rgb([90, 90, 90]));
        image::codecs::jpeg::JpegEncoder::new_with_quality(&mut bytes, 95).encode_image(&grey).unwrap();
        let mut decoder = JpegDecoder::new().unwrap();
        let jpeg = format(b"MJPG", 64, 48, 0);
        for _ in 0..3 {
            // A driver may pass on more than the picture.
            let padded = [&bytes[..], &[0; 16]].concat();
            let (frame, steps) = video(&padded, Layout::Jpeg, Some(&mut decoder), &jpeg).unwrap();
            assert_eq!((frame.width(), frame.height(), steps.is_some()), (64, 48, true));
            assert!(frame.data(0)[0].abs_diff(90) < 2);
            let cut = video(&bytes[..bytes.len() / 2], Layout::Jpeg, Some(&mut decoder), &jpeg).err().unwrap();
            assert!(cut.contains("ends early"), "{cut}");
            // A piece in the middle was lost.
            let lost = [&bytes[..bytes.len() - 24], &bytes[bytes.len() - 12..]].concat();
            let lost = video(&lost, Layout::Jpeg, Some(&mut decoder), &jpeg).err().unwrap();
            assert!(lost.contains("its JPEG is damaged: "), "{lost}");
        }
    }

    #[test]
    fn a_rate_becomes_an_interval_of_32_bits() {
        for (rate, expected) in [("60", 60.0), ("59.94", 59.94), ("60000/1001", 60_000.0 / 1001.0), ("0.5", 0.5)] {
            let found = interval(rate.parse::<crate::source::FrameRate>().unwrap().fraction());
            assert!((hz(found) - expected).abs() < 1e-6, "{rate}: {found}");
        }
        assert_eq!(interval((60_000_000_000, 1_000_000_000)).to_string(), "1/60");
    }

    #[test]
    fn what_is_no_camera_is_named() {
        let settings = CameraSettings { size_px: [4, 4], rate: None, exposure_s: None, gain: None, format: None };
        let open = |path: &str| {
            let path = Path::new(path);
            Camera::v4l2(path, settings.clone(), HostClock::start(), Arc::default()).unwrap_err().to_string()
        };
        let error = open("/dev/video_that_is_not_there");
        assert!(error.contains("/dev/video_that_is_not_there") && error.contains("No such file"), "{error}");
        let error = open("/dev/null");
        assert!(error.contains("/dev/null: is not a camera"), "{error}");
    }
}
