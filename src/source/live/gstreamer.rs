//! GStreamer pipelines: `gst:PIPELINE`, any source and processing that GStreamer supports.
//!
//! The pipeline is written as for `gst-launch-1.0`, without a sink; one is added that takes pictures unchanged in the
//! supported formats. A stamp is the buffer's presentation time, from the pipeline's own zero: in a live pipeline the
//! pipeline's clock at capture, for a file the file's time ([`Clock::Stream`]). Lost frames are counted by the buffers'
//! `offset` where it holds a frame number, and by their stamps.
//!
//! A pipeline that fails is restarted, trying once a second. One that ends has ended for good.

use super::super::counter::Wrap;
use super::super::decoded::PictureMaker;
use super::super::host::HostClock;
use super::super::{ChromaSiting, Clock, Picture, SourceError, Timestamp};
use super::camera::{Camera, CapturedFrame, Connection, INTERLACED};
use super::samples;
use ffmpeg_the_third::codec::Id;
use ffmpeg_the_third::color::{Range, Space, TransferCharacteristic};
use ffmpeg_the_third::format::Pixel;
use ffmpeg_the_third::frame::Video;
use gstreamer::prelude::*;
use gstreamer::{self as gst, ClockTime, MessageView};
use gstreamer_app::AppSink;
use gstreamer_video::{
    VideoChromaSite, VideoColorMatrix, VideoColorRange, VideoFormat, VideoFrameExt as _, VideoFrameRef, VideoInfo,
    VideoInterlaceMode, VideoTransferFunction,
};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};

/// Supported formats.
const FORMATS: [(&str, VideoFormat, Pixel); 15] = [
    ("I420", VideoFormat::I420, Pixel::YUV420P),
    ("NV12", VideoFormat::Nv12, Pixel::NV12),
    ("Y42B", VideoFormat::Y42b, Pixel::YUV422P),
    ("Y444", VideoFormat::Y444, Pixel::YUV444P),
    ("YUY2", VideoFormat::Yuy2, Pixel::YUYV422),
    ("UYVY", VideoFormat::Uyvy, Pixel::UYVY422),
    ("RGB", VideoFormat::Rgb, Pixel::RGB24),
    ("BGR", VideoFormat::Bgr, Pixel::BGR24),
    ("RGBA", VideoFormat::Rgba, Pixel::RGBA),
    ("BGRA", VideoFormat::Bgra, Pixel::BGRA),
    ("ARGB", VideoFormat::Argb, Pixel::ARGB),
    ("ABGR", VideoFormat::Abgr, Pixel::ABGR),
    ("RGBx", VideoFormat::Rgbx, Pixel::RGBZ),
    ("BGRx", VideoFormat::Bgrx, Pixel::BGRZ),
    ("xRGB", VideoFormat::Xrgb, Pixel::ZRGB),
];

/// Mosaics of colour sensors, `video/x-bayer`.
const MOSAICS: [(&str, Pixel); 4] = [
    ("rggb", Pixel::BAYER_RGGB8),
    ("bggr", Pixel::BAYER_BGGR8),
    ("grbg", Pixel::BAYER_GRBG8),
    ("gbrg", Pixel::BAYER_GBRG8),
];

/// How long a pipeline may take to its first picture: a network camera takes some seconds.
const START_TIMEOUT: Duration = Duration::from_secs(15);
/// Pictures queued in the sink before the pipeline waits.
const QUEUE_LENGTH: u32 = 8;

impl Camera {
    /// The pipeline described by `text`, for example `videotestsrc ! video/x-raw,format=I420`.
    ///
    /// # Errors
    /// When it cannot be built, or gives no supported picture.
    pub fn gstreamer(text: &str, clock: HostClock, stop: Arc<AtomicBool>) -> Result<Self, SourceError> {
        let name = format!("gst:{text}");
        let (text, called) = (text.to_owned(), name.clone());
        let open = move || -> Result<Box<dyn Connection>, SourceError> {
            let refused = |reason: String| SourceError::Camera { name: called.clone(), reason };
            Ok(Box::new(Session::open(&called, &text).map_err(refused)?))
        };
        Self::start(&name, Box::new(open), clock, stop)
    }
}

/// Format of a pipeline's pictures.
struct Layout {
    size_px: [u32; 2],
    pixel: Pixel,
    /// `None` for a mosaic.
    info: Option<VideoInfo>,
    caps: gst::Caps,
}

/// A running pipeline; dropping it stops the pipeline.
struct Session {
    name: String,
    pipeline: gst::Element,
    sink: AppSink,
    pictures: PictureMaker,
    layout: Layout,
    /// The sample that was taken to learn the format.
    first: Option<(gst::Sample, Instant)>,
    /// Pictures so far, where buffers have no frame number.
    count: u64,
    ended: bool,
}

impl Session {
    fn open(name: &str, text: &str) -> Result<Self, String> {
        gst::init().map_err(|e| format!("GStreamer does not start: {e}"))?;
        let described = format!("{text} ! appsink name=catoptra_sink sync=false max-buffers={QUEUE_LENGTH}");
        let pipeline = gst::parse::launch(&described)
            .map_err(|e| format!("{e}; write it as for gst-launch-1.0, without a sink at its end"))?;
        let bin = pipeline.downcast_ref::<gst::Bin>().ok_or("it is not a pipeline")?;
        let sink = bin.by_name("catoptra_sink").and_then(|sink| sink.downcast::<AppSink>().ok());
        let sink = sink.ok_or("its end takes no sink")?;
        sink.set_caps(Some(&wanted()));
        let mut session = Self {
            name: name.to_owned(),
            pictures: PictureMaker::new(name.into(), Id::RAWVIDEO),
            layout: Layout { size_px: [0; 2], pixel: Pixel::None, info: None, caps: gst::Caps::new_empty() },
            pipeline: pipeline.clone(),
            sink,
            first: None,
            count: 0,
            ended: false,
        };
        if pipeline.set_state(gst::State::Playing).is_err() {
            return Err(session.trouble().unwrap_or_else(|| "it does not start".to_owned()));
        }
        let began = Instant::now();
        while session.first.is_none() {
            session.first = session.pull(Duration::from_millis(100))?;
            if session.ended || began.elapsed() > START_TIMEOUT {
                let seconds = began.elapsed().as_secs();
                return Err(format!(
                    "it has given no picture in {seconds} s{}",
                    if session.ended { " and has ended" } else { "" }
                ));
            }
        }
        if let Some((sample, _)) = &session.first {
            session.layout = layout(sample)?;
            if let Some(info) = &session.layout.info {
                session.pictures.set_default_siting(siting(info));
            }
        }
        Ok(session)
    }

    /// The next sample and its arrival; `None` when none arrives in time, or at the end.
    fn pull(&mut self, wait: Duration) -> Result<Option<(gst::Sample, Instant)>, String> {
        let wait = ClockTime::from_nseconds(u64::try_from(wait.as_nanos()).unwrap_or(u64::MAX));
        if let Some(sample) = self.sink.try_pull_sample(wait) {
            return Ok(Some((sample, Instant::now())));
        }
        match self.trouble() {
            Some(reason) => Err(reason),
            None => {
                self.ended |= self.sink.is_eos();
                Ok(None)
            }
        }
    }

    /// The first error on the pipeline's bus.
    fn trouble(&self) -> Option<String> {
        let message = self.pipeline.bus()?.pop_filtered(&[gst::MessageType::Error])?;
        let MessageView::Error(error) = message.view() else { return None };
        let details = error.debug().map(|text| text.to_string()).unwrap_or_default();
        let advice = if details.contains("not-negotiated") || details.contains("not-linked") {
            "; if its pictures are of another format, end it with: ! videoconvert ! video/x-raw,format=I420"
        } else {
            ""
        };
        let from = error.src().map(|element| element.name().to_string()).unwrap_or_default();
        Some(format!("{from}: {}{advice}", error.error()))
    }

    fn picture(&mut self, buffer: &gst::BufferRef, caps: &gst::CapsRef) -> Result<Picture, String> {
        if caps != self.layout.caps.as_ref() {
            return Err(format!("it is of another kind than the first one: {caps}"));
        }
        let Layout { size_px, pixel, info, .. } = &self.layout;
        let frame = match info {
            Some(info) => of_video(buffer, info, *pixel)?,
            None => {
                // Rows of a mosaic are multiples of four bytes.
                let map = buffer.map_readable().map_err(|e| e.to_string())?;
                let padding = (4 - size_px[0] as usize % 4) % 4;
                samples::of_buffer(&map, *pixel, *size_px, padding).ok_or("the buffer is too short")?
            }
        };
        self.pictures.picture(frame).map_err(|e| e.to_string())
    }
}

impl Drop for Session {
    fn drop(&mut self) {
        if self.pipeline.set_state(gst::State::Null).is_err() {
            tracing::debug!("{}: the pipeline could not be stopped", self.name);
        }
    }
}

impl Connection for Session {
    fn next(&mut self, wait: Duration) -> Result<Option<CapturedFrame>, SourceError> {
        let taken = match self.first.take() {
            Some(first) => Some(first),
            None => {
                let name = self.name.clone();
                self.pull(wait).map_err(|reason| SourceError::Camera { name, reason })?
            }
        };
        let Some((sample, arrival)) = taken else { return Ok(None) };
        let picture = match (sample.buffer(), sample.caps()) {
            (Some(buffer), Some(caps)) => self.picture(buffer, caps),
            _ => Err("the pipeline gave no picture".to_owned()),
        };
        let buffer = sample.buffer();
        let stamp = buffer.and_then(gst::BufferRef::pts).and_then(|pts| i64::try_from(pts.nseconds()).ok());
        // `offset` has several meanings; it is a frame number where `offset_end` is the next one.
        let numbered = buffer.filter(|buffer| buffer.offset().checked_add(1) == Some(buffer.offset_end()));
        let number = numbered.map_or(self.count, gst::BufferRef::offset);
        self.count = number.wrapping_add(1);
        let stamp = stamp.map(|ns| Timestamp { ns, clock: Clock::Stream });
        Ok(Some(CapturedFrame { number, stamp, arrival, age: None, picture }))
    }

    fn size_px(&self) -> [u32; 2] {
        self.layout.size_px
    }

    fn wrap(&self) -> Wrap {
        Wrap::Bits64
    }

    fn driver_counts(&self) -> bool {
        true
    }

    fn ended(&self) -> bool {
        self.ended
    }
}

/// The caps that the sink accepts.
fn wanted() -> gst::Caps {
    let raw = gst::Caps::builder("video/x-raw").field("format", gst::List::new(FORMATS.map(|(name, ..)| name))).build();
    let mosaic = gst::Caps::builder("video/x-bayer").field("format", gst::List::new(MOSAICS.map(|(name, _)| name)));
    let mut all = raw;
    all.merge(mosaic.build());
    all
}

fn layout(sample: &gst::Sample) -> Result<Layout, String> {
    let caps = sample.caps_owned().ok_or("its pictures do not say what they are")?;
    let structure = caps.structure(0).ok_or("its pictures do not say what they are")?;
    if structure.name() == "video/x-bayer" {
        let format = structure.get::<&str>("format").map_err(|e| e.to_string())?;
        let found = MOSAICS.iter().find(|(name, _)| *name == format);
        let (_, pixel) = found.ok_or_else(|| format!("mosaics of format {format} are not read"))?;
        let side = |name: &str| {
            structure
                .get::<i32>(name)
                .map_err(|e| e.to_string())
                .and_then(|n| u32::try_from(n).map_err(|e| e.to_string()))
        };
        return Ok(Layout {
            size_px: [side("width")?, side("height")?],
            pixel: *pixel,
            info: None,
            caps: caps.clone(),
        });
    }
    let info = VideoInfo::from_caps(&caps).map_err(|e| e.to_string())?;
    if info.interlace_mode() != VideoInterlaceMode::Progressive {
        return Err(format!("its pictures are interlaced: {INTERLACED}"));
    }
    let found = FORMATS.iter().find(|(_, format, _)| *format == info.format());
    let (_, _, pixel) = found.ok_or_else(|| format!("pictures of format {} are not read", info.format()))?;
    Ok(Layout { size_px: [info.width(), info.height()], pixel: *pixel, info: Some(info), caps: caps.clone() })
}

/// A copy of a raw picture, with its colour tags.
fn of_video(buffer: &gst::BufferRef, info: &VideoInfo, pixel: Pixel) -> Result<Video, String> {
    let mapped = VideoFrameRef::from_buffer_ref_readable(buffer, info).map_err(|e| e.to_string())?;
    let mut frame = Video::new(pixel, info.width(), info.height());
    for (plane, stride) in mapped.plane_stride().iter().enumerate().take(frame.planes()) {
        let length = samples::row_bytes(pixel, plane, info.width() as usize);
        let from = mapped.plane_data(plane as u32).map_err(|e| e.to_string())?;
        let stride = usize::try_from(*stride).map_err(|_| "its rows are stored from the bottom up".to_owned())?;
        let (to_stride, rows) = (frame.stride(plane), frame.plane_height(plane) as usize);
        for (from, to) in from.chunks(stride).zip(frame.data_mut(plane).chunks_mut(to_stride)).take(rows) {
            let row = from.get(..length).zip(to.get_mut(..length)).ok_or("the buffer is too short")?;
            row.1.copy_from_slice(row.0);
        }
    }
    let colours = info.colorimetry();
    match colours.matrix() {
        VideoColorMatrix::Bt601 => frame.set_color_space(Space::SMPTE170M),
        VideoColorMatrix::Bt709 => frame.set_color_space(Space::BT709),
        VideoColorMatrix::Bt2020 => frame.set_color_space(Space::BT2020NCL),
        // Missing tags are filled in, with a warning, as for a recording.
        _ => {}
    }
    match colours.range() {
        VideoColorRange::Range0_255 => frame.set_color_range(Range::JPEG),
        VideoColorRange::Range16_235 => frame.set_color_range(Range::MPEG),
        _ => {}
    }
    match colours.transfer() {
        VideoTransferFunction::Srgb => frame.set_color_transfer_characteristic(TransferCharacteristic::IEC61966_2_1),
        VideoTransferFunction::Gamma10 => frame.set_color_transfer_characteristic(TransferCharacteristic::Linear),
        _ => {}
    }
    Ok(frame)
}

/// Siting of the chroma samples.
fn siting(info: &VideoInfo) -> ChromaSiting {
    let site = info.chroma_site();
    match (site.contains(VideoChromaSite::H_COSITED), site.contains(VideoChromaSite::V_COSITED)) {
        (true, true) => ChromaSiting::TopLeft,
        (false, false) if site.contains(VideoChromaSite::JPEG) => ChromaSiting::Center,
        _ => ChromaSiting::Left,
    }
}
