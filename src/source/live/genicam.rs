//! GenICam cameras, GigE Vision and USB3 Vision, through Aravis.
//!
//! Stamps and frame counter are the camera's own. Aravis requests lost packets from a GigE camera again; a picture that
//! is still incomplete is left out and counted. The trigger stays as the camera has it, unless a frame rate is
//! requested: then Aravis switches it off.

use super::super::counter::Wrap;
use super::super::decoded::PictureMaker;
use super::super::host::HostClock;
use super::super::{Clock, SourceError, Timestamp};
use super::camera::{Camera, CapturedFrame, Connection};
use super::samples;
use super::settings::{Asked, CameraSettings, plain};
use aravis::{Aravis, Buffer, BufferStatus, prelude::*};
use ffmpeg_the_third::codec::Id;
use ffmpeg_the_third::color::{Range, Space};
use ffmpeg_the_third::format::Pixel;
use parking_lot::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, LazyLock};
use std::time::{Duration, Instant};

/// Buffers that Aravis may fill ahead: a quarter of a second at 60 Hz.
const BUFFERS: usize = 16;
/// Controls that would change colours or brightness by themselves.
const AUTOMATIC: [&str; 3] = ["ExposureAuto", "GainAuto", "BalanceWhiteAuto"];

/// Meaning of YUV: matrix and range (GenICam Pixel Format Naming Convention: full range unless a standard is named).
type Yuv = Option<(Space, Range)>;
const FULL_601: Yuv = Some((Space::SMPTE170M, Range::JPEG));
const LIMITED_601: Yuv = Some((Space::SMPTE170M, Range::MPEG));
const LIMITED_709: Yuv = Some((Space::BT709, Range::MPEG));

/// Supported formats, the best first.
const FORMATS: [(&str, Pixel, Yuv); 17] = [
    ("BayerRG8", Pixel::BAYER_RGGB8, None),
    ("BayerGB8", Pixel::BAYER_GBRG8, None),
    ("BayerGR8", Pixel::BAYER_GRBG8, None),
    ("BayerBG8", Pixel::BAYER_BGGR8, None),
    ("RGB8", Pixel::RGB24, None),
    ("RGB8Packed", Pixel::RGB24, None),
    ("BGR8", Pixel::BGR24, None),
    ("BGR8Packed", Pixel::BGR24, None),
    ("RGBa8", Pixel::RGBA, None),
    ("BGRa8", Pixel::BGRA, None),
    ("YCbCr422_8", Pixel::YUYV422, FULL_601),
    ("YCbCr601_422_8", Pixel::YUYV422, LIMITED_601),
    ("YCbCr709_422_8", Pixel::YUYV422, LIMITED_709),
    ("YUV422_8", Pixel::YUYV422, FULL_601),
    ("YUV422_YUYV_Packed", Pixel::YUYV422, FULL_601),
    ("YUV422_8_UYVY", Pixel::UYVY422, FULL_601),
    ("YUV422Packed", Pixel::UYVY422, FULL_601),
];

/// Only one thread at a time may read Aravis's list of cameras.
static ARAVIS: LazyLock<Mutex<Option<Aravis>>> = LazyLock::new(|| Mutex::new(Aravis::initialize().ok()));

impl Camera {
    /// The GenICam camera called `id`, as `arv-tool` lists it (identifier, model, serial number or address), or the
    /// first camera when `id` is empty.
    ///
    /// # Errors
    /// When there is none, or its pictures cannot be read.
    pub fn genicam(
        id: &str,
        settings: CameraSettings,
        clock: HostClock,
        stop: Arc<AtomicBool>,
    ) -> Result<Self, SourceError> {
        let name = format!("genicam:{id}");
        let (id, called) = (id.to_owned(), name.clone());
        let open = move || -> Result<Box<dyn Connection>, SourceError> {
            let refused = |reason: String| SourceError::Camera { name: called.clone(), reason };
            Ok(Box::new(Session::open(&called, &id, &settings).map_err(refused)?))
        };
        Self::start(&name, Box::new(open), clock, stop)
    }
}

/// A camera that is streaming.
struct Session {
    name: String,
    camera: aravis::Camera,
    stream: aravis::Stream,
    pictures: PictureMaker,
    pixel: Pixel,
    yuv: Yuv,
    size_px: [u32; 2],
    wrap: Wrap,
    lost: Arc<AtomicBool>,
}

impl Session {
    fn open(name: &str, id: &str, settings: &CameraSettings) -> Result<Self, String> {
        let known = listed();
        let wanted = known.iter().find(|names| names.iter().any(|known| known == id)).and_then(|names| names.first());
        let wanted = wanted.map_or(id, String::as_str);
        let camera =
            aravis::Camera::new((!wanted.is_empty()).then_some(wanted)).map_err(|e| match known.as_slice() {
                [] => format!(
                    "no GenICam camera answers ({e}). GigE: is it in the same network, and does the firewall let it \
                     through? USB3: may this user access it (Aravis' udev rules)?"
                ),
                some => {
                    let names: Vec<&str> = some.iter().filter_map(|names| names.first()).map(String::as_str).collect();
                    format!("no such GenICam camera ({e}); there are: {}", names.join(", "))
                }
            })?;
        let said = |what: &str| {
            let what = what.to_owned();
            move |e: aravis::glib::Error| format!("{what}: {e}")
        };
        let (pixel, yuv) = set_up(name, &camera, settings)?;
        let (x, y, width, height) = camera.region().map_err(said("its region cannot be read"))?;
        let size_px = [width, height].map(i32::unsigned_abs);
        if camera.is_gv_device()
            && let Err(error) = camera.gv_auto_packet_size()
        {
            tracing::debug!("{name}: the packet size is left as it is: {error}");
        }
        let lost = Arc::new(AtomicBool::new(false));
        if let Some(device) = camera.device() {
            let lost = Arc::clone(&lost);
            device.connect_control_lost(move |_| lost.store(true, Ordering::Relaxed));
        }
        let stream = camera.create_stream().map_err(said("gives no stream"))?;
        let payload = camera.payload().map_err(said("does not report the size of its pictures"))? as usize;
        for _ in 0..BUFFERS {
            stream.push_buffer(Buffer::new_allocate(payload));
        }
        camera.start_acquisition().map_err(said("does not start"))?;
        tracing::info!(
            "{name}: {} {}, {width}x{height} pixels at {x},{y} of the sensor",
            camera.vendor_name().unwrap_or_default(),
            camera.model_name().unwrap_or_default()
        );
        let wrap = if camera.is_gv_device() { Wrap::Block16 } else { Wrap::Bits64 };
        let pictures = PictureMaker::new(name.into(), Id::RAWVIDEO);
        Ok(Self { name: name.to_owned(), camera, stream, pictures, pixel, yuv, size_px, wrap, lost })
    }

    fn taken(&mut self, buffer: &Buffer, arrival: Instant) -> Option<CapturedFrame> {
        let picture = match buffer.status() {
            BufferStatus::Success => {
                let (padding, _) = buffer.image_padding();
                let size_px = [buffer.image_width(), buffer.image_height()].map(i32::unsigned_abs);
                let padding = usize::try_from(padding).unwrap_or(0);
                let frame = samples::of_buffer(&buffer.image_data(), self.pixel, size_px, padding);
                frame.ok_or("it is shorter than its size says".to_owned()).and_then(|mut frame| {
                    if let Some((space, range)) = self.yuv {
                        frame.set_color_space(space);
                        frame.set_color_range(range);
                    }
                    self.pictures.picture(frame).map_err(|e| e.to_string())
                })
            }
            // The buffer received nothing.
            BufferStatus::Cleared | BufferStatus::Aborted | BufferStatus::Unknown => return None,
            BufferStatus::Timeout | BufferStatus::MissingPackets => Err("packets of it are missing".to_owned()),
            other => Err(format!("{other:?}")),
        };
        let stamp = i64::try_from(buffer.timestamp()).ok().filter(|ns| *ns != 0);
        let stamp = stamp.map(|ns| Timestamp { ns, clock: Clock::Device });
        Some(CapturedFrame { number: buffer.frame_id(), stamp, arrival, age: None, picture })
    }
}

impl Connection for Session {
    fn next(&mut self, wait: Duration) -> Result<Option<CapturedFrame>, SourceError> {
        if self.lost.load(Ordering::Relaxed) {
            return Err(SourceError::Camera { name: self.name.clone(), reason: "it does not answer".to_owned() });
        }
        let wait_us = u64::try_from(wait.as_micros()).unwrap_or(u64::MAX);
        let Some(buffer) = self.stream.timeout_pop_buffer(wait_us) else { return Ok(None) };
        let taken = self.taken(&buffer, Instant::now());
        self.stream.push_buffer(buffer);
        Ok(taken)
    }

    fn size_px(&self) -> [u32; 2] {
        self.size_px
    }

    fn wrap(&self) -> Wrap {
        self.wrap
    }

    fn driver_counts(&self) -> bool {
        false
    }
}

impl Drop for Session {
    fn drop(&mut self) {
        if let Err(error) = self.camera.stop_acquisition() {
            tracing::debug!("{}: could not be stopped: {error}", self.name);
        }
    }
}

/// Names of each available camera; the first is the one that Aravis opens it by.
fn listed() -> Vec<Vec<String>> {
    let aravis = ARAVIS.lock();
    let devices = aravis.as_ref().map(Aravis::get_device_list).unwrap_or_default();
    let names = devices.into_iter().map(|d| [d.id, d.physical_id, d.model, d.address]);
    names.map(|names| names.iter().map(|name| name.to_string_lossy().into_owned()).collect()).collect()
}

/// Sets what was requested and locks the rest; warns where the camera deviates.
fn set_up(name: &str, camera: &aravis::Camera, settings: &CameraSettings) -> Result<(Pixel, Yuv), String> {
    let format = camera.pixel_format_as_string().map_err(|e| format!("does not report its pixel format: {e}"))?;
    let offered = camera.dup_available_pixel_formats_as_strings().unwrap_or_default();
    let offered: Vec<&str> = offered.iter().map(|name| name.as_str()).collect();
    let wanted = choose(&format, &offered, settings.format.as_deref())?;
    if wanted != format {
        let refused = |e| format!("pixel format {wanted}: the camera refuses it and stays at {format} ({e})");
        camera.set_pixel_format_from_string(wanted).map_err(refused)?;
    }
    let got = camera.pixel_format_as_string().map_err(|e| format!("does not report its pixel format: {e}"))?;
    let (_, pixel, yuv) = readable(&got).ok_or_else(|| unreadable(&got, &offered))?;
    if plain(&got) != plain(wanted) {
        tracing::warn!("{name}: pixel format: {wanted} requested, the camera uses {got}");
    }
    // A refusal is noticed: the source reports its picture size, and the caller checks it.
    let [width, height] = settings.size_px.map(|n| i32::try_from(n).unwrap_or(i32::MAX));
    if let Ok((x, y, w, h)) = camera.region()
        && (w, h) != (width, height)
        && let Err(error) = camera.set_region(x, y, width, height)
    {
        tracing::warn!("{name}: size: the camera refuses {width}x{height} at {x},{y} ({error}) and stays at {w}x{h}");
    }
    for feature in AUTOMATIC.into_iter().filter(|feature| camera.is_feature_available(feature).unwrap_or(false)) {
        let set = camera.set_string(feature, "Off");
        match camera.string(feature) {
            Ok(got) if got == "Off" => {}
            Ok(got) => {
                tracing::warn!("{name}: {feature}: Off requested, the camera uses {got}{}", in_brackets(set.err()))
            }
            Err(error) => {
                tracing::warn!(
                    "{name}: {feature}: Off requested, and the camera does not report what it uses ({error})"
                )
            }
        }
    }
    let warn_of = |objection: Option<String>| objection.into_iter().for_each(|text| tracing::warn!("{name}: {text}"));
    if let Some(exposure_s) = settings.exposure_s {
        let asked = Asked { what: "exposure", unit: " ms", value: exposure_s * 1e3 };
        let set = camera.set_exposure_time(exposure_s * 1e6);
        warn_of(asked.objection(set, camera.exposure_time().map(|us| us * 1e-3)));
    }
    if let Some(value) = settings.gain {
        warn_of(Asked { what: "gain", unit: "", value }.objection(camera.set_gain(value), camera.gain()));
    }
    if let Some(rate) = settings.rate {
        let asked = Asked { what: "frame rate", unit: " Hz", value: rate.hz() };
        warn_of(asked.objection(camera.set_frame_rate(rate.hz()), camera.frame_rate()));
    }
    let number = |read: Result<f64, _>, scale: f64| read.map_or("?".to_owned(), |x| format!("{:.3}", x * scale));
    tracing::info!(
        "{name}: {got}, exposure {} ms, gain {}, {} Hz",
        number(camera.exposure_time(), 1e-3),
        number(camera.gain(), 1.0),
        number(camera.frame_rate(), 1.0)
    );
    Ok((*pixel, *yuv))
}

fn in_brackets(error: Option<aravis::glib::Error>) -> String {
    error.map_or_else(String::new, |e| format!(" ({e})"))
}

fn readable(format: &str) -> Option<&'static (&'static str, Pixel, Yuv)> {
    FORMATS.iter().find(|(name, ..)| plain(name) == plain(format))
}

fn unreadable(format: &str, offered: &[&str]) -> String {
    if format.to_ascii_lowercase().starts_with("mono") {
        return format!(
            "pixel format {format} has no colours, and the bands are told apart by theirs; the camera has {}",
            offered.join(", ")
        );
    }
    let read: Vec<&str> = FORMATS.iter().map(|(name, ..)| *name).collect();
    format!("pixel format {format} cannot be read: {} can; the camera has {}", read.join(", "), offered.join(", "))
}

/// The pixel format to set: the requested one, else the current one if supported, else the best that is.
fn choose<'a>(present: &'a str, offered: &[&'a str], asked: Option<&str>) -> Result<&'a str, String> {
    if let Some(asked) = asked {
        let found = offered.iter().chain([&present]).find(|name| plain(name) == plain(asked));
        let found = found.ok_or_else(|| format!("pixel format {asked}: the camera has {}", offered.join(", ")))?;
        return readable(found).map(|_| *found).ok_or_else(|| unreadable(found, offered));
    }
    if readable(present).is_some() {
        return Ok(present);
    }
    let best = FORMATS.iter().find_map(|(name, ..)| offered.iter().find(|o| plain(o) == plain(name)));
    best.copied().ok_or_else(|| unreadable(present, offered))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_format_asked_for_is_found_by_any_spelling() {
        let offered = ["Mono8", "BayerRG8", "RGB8"];
        assert_eq!(choose("BayerRG8", &offered, Some("rgb8")), Ok("RGB8"));
        assert_eq!(choose("RGB8", &offered, Some("bayer_rg8")), Ok("BayerRG8"));
        let error = choose("RGB8", &offered, Some("bayer_gb8")).unwrap_err();
        assert!(error.contains("bayer_gb8") && error.contains("Mono8, BayerRG8, RGB8"), "{error}");
    }

    #[test]
    fn a_format_that_can_be_read_stays_and_another_gives_way_to_the_best() {
        let offered = ["Mono8", "Mono12", "RGB8", "BayerGR8"];
        assert_eq!(choose("RGB8", &offered, None), Ok("RGB8"));
        assert_eq!(choose("Mono12", &offered, None), Ok("BayerGR8"));
    }

    #[test]
    fn a_camera_without_colours_is_refused() {
        for asked in [None, Some("mono8")] {
            let error = choose("Mono8", &["Mono8", "Mono16"], asked).unwrap_err();
            assert!(error.contains("no colours") && error.contains("Mono8, Mono16"), "{error}");
        }
    }
}
