//! A custom source: a camera whose driver delivers buffers of bytes, with a counter and a time.
//!
//! A recording plays the driver. Yours replaces [`Driver`]; everything that Catoptra needs is in [`FrameSource`].

use catoptra::rig::Rig;
use catoptra::source::{
    self, Clock, Colour, Frame, FrameSource, Picture, PixelFormat, SourceError, SourceOptions, Timestamp,
};
use catoptra::track::{TrackOptions, Tracker};
use std::error::Error;
use std::io::Write as _;
use std::path::Path;

/// A driver's buffer: bytes blue, green, red of every pixel, row by row.
struct Buffer {
    bytes: Vec<u8>,
    counter: u64,
    exposed_at_ns: i64,
}

/// Simulates the camera: plays a recording and loses a frame.
struct Driver(Box<dyn FrameSource + Send>);

impl Driver {
    fn grab(&mut self) -> Result<Option<Buffer>, SourceError> {
        let Some(frame) = self.0.next_frame()? else { return Ok(None) };
        if frame.seq == 10 {
            return self.grab();
        }
        let bytes = blue_green_red(&frame.picture);
        Ok(Some(Buffer { bytes, counter: frame.seq, exposed_at_ns: frame.stamp.ns }))
    }
}

/// The camera as Catoptra sees it.
struct MyCamera {
    driver: Driver,
    size_px: [u32; 2],
    received: u64,
    last_counter: Option<u64>,
}

impl FrameSource for MyCamera {
    fn next_frame(&mut self) -> Result<Option<Frame>, SourceError> {
        let Some(buffer) = self.driver.grab()? else { return Ok(None) };
        // How samples are stored; the tracker uses them without conversion.
        let format = PixelFormat::RgbPacked { step: 3, order: [2, 1, 0] };
        let [width, height] = self.size_px;
        let picture = Picture::from_planes(width, height, format, Colour::SRGB, vec![buffer.bytes])
            .map_err(|error| SourceError::Camera { name: "mine".into(), reason: error.to_string() })?;
        // Frames that the camera counted but did not deliver.
        let gap = self.last_counter.map_or(0, |last| buffer.counter.saturating_sub(last + 1));
        self.last_counter = Some(buffer.counter);
        self.received += 1;
        Ok(Some(Frame {
            seq: self.received - 1,
            stamp: Timestamp { ns: buffer.exposed_at_ns, clock: Clock::Device },
            gap: u32::try_from(gap).unwrap_or(u32::MAX),
            host: None,
            picture,
        }))
    }

    fn size_px(&self) -> [u32; 2] {
        self.size_px
    }
}

fn main() -> Result<(), Box<dyn Error>> {
    let rig = Rig::load(Path::new("calibration/dev_tank/rig.toml"))?;
    let recording = source::open("sample_frames/planar.mkv", SourceOptions::default())?;
    let size_px = recording.size_px();
    let mut camera = MyCamera { driver: Driver(recording), size_px, received: 0, last_counter: None };
    let mut tracker = Tracker::new(&rig, TrackOptions::default())?;
    let mut out = std::io::stdout().lock();
    for _ in 0..20 {
        let Some(frame) = camera.next_frame()? else { break };
        let estimate = tracker.step(&frame)?;
        let theta = estimate.deflection.as_ref().map(|angles| angles.theta_rad.to_degrees());
        let theta = theta.map_or_else(|miss| format!("{miss:?}"), |deg| format!("{deg:+.2}°"));
        writeln!(out, "frame {}, {} lost before: θ {theta}", estimate.seq, estimate.gap)?;
    }
    Ok(())
}

/// The nearest chroma sample for every pixel.
fn blue_green_red(picture: &Picture) -> Vec<u8> {
    let [width, height] = picture.size_px();
    let Some(map) = picture.rgb_from_stored() else { return Vec::new() };
    let planes = [0, 1, 2].map(|channel| picture.plane(channel));
    let stored = |x: u32, y: u32| {
        planes.each_ref().map(|plane| {
            let plane = plane.as_ref()?;
            let row = plane.row((y / plane.scale[1]) as usize)?;
            row.get((x / plane.scale[0]) as usize * plane.step).copied().map(f64::from)
        })
    };
    let pixels = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
    let rgb = pixels.map(|(x, y)| map.apply(&stored(x, y).map(Option::unwrap_or_default).into()));
    rgb.flat_map(|rgb| [rgb.z, rgb.y, rgb.x].map(|value| value.round().clamp(0.0, 255.0) as u8)).collect()
}
