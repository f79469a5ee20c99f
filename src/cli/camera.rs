//! Live sources as they are named on the command line, by `live` and `studio`.

use super::units::exposure_ms;
use super::{Exit, Failure};
use crate::source::host::HostClock;
use crate::source::live::{Camera, CameraSettings, Paced, RawFormat, RawPictures, Stream};
use crate::source::{self, FrameRate, FrameSource, SourceOptions};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Options of a live source.
#[derive(Debug, clap::Args)]
pub(super) struct SourceArgs {
    /// Play a recording at its own pace
    #[arg(long, conflicts_with = "raw")]
    pub(super) realtime: bool,
    /// Raw pictures on standard input, as 1280x1024:bayer_rg8@60
    #[arg(long, value_name = "FORMAT")]
    pub(super) raw: Option<RawFormat>,
    /// Camera: frames per second
    #[arg(long, value_name = "RATE", allow_hyphen_values = true)]
    pub(super) fps: Option<FrameRate>,
    /// Camera: exposure time, as 8.5ms; without a unit it is milliseconds
    #[arg(long, value_name = "T", value_parser = exposure_ms, allow_negative_numbers = true)]
    pub(super) exposure: Option<f64>,
    /// Camera: gain, in its own unit
    #[arg(long, value_name = "G", value_parser = finite, allow_negative_numbers = true)]
    gain: Option<f64>,
    /// Camera: pixel format, such as bayer_rg8 or MJPG
    #[arg(long, value_name = "FORMAT")]
    format: Option<String>,
}

pub(super) fn finite(text: &str) -> Result<f64, String> {
    text.parse().ok().filter(|x: &f64| x.is_finite()).ok_or_else(|| "expected a number".to_owned())
}

pub(super) fn positive(text: &str) -> Result<f64, String> {
    finite(text).ok().filter(|x| *x > 0.0).ok_or_else(|| "expected a number above 0, such as 8.5".to_owned())
}

/// Standard input without the standard library's small buffer, and with a pipe large enough for half a picture.
#[cfg(unix)]
fn standard_input() -> Result<Box<dyn std::io::Read + Send>, Failure> {
    use std::os::fd::AsFd as _;
    let refused = |e: std::io::Error| Failure::usage(format!("standard input: {e}"));
    let input = std::io::stdin().as_fd().try_clone_to_owned().map_err(refused)?;
    // Fails if it is not a pipe.
    let _ = rustix::pipe::fcntl_setpipe_size(&input, 1 << 20);
    Ok(Box::new(std::fs::File::from(input)))
}

#[cfg(not(unix))]
fn standard_input() -> Result<Box<dyn std::io::Read + Send>, Failure> {
    Ok(Box::new(std::io::stdin()))
}

/// Whether a source is a camera or a stream by its name, and not a file.
pub(super) fn is_live(source: &str) -> bool {
    let camera = ["genicam:", "gst:", "/dev/"].iter().any(|begin| source.starts_with(begin));
    camera || source == "-" || source.contains("://")
}

impl SourceArgs {
    /// Opens it; a camera is asked for pictures of `size_px`.
    pub(super) fn open(
        &self,
        name: &str,
        size_px: [u32; 2],
        clock: HostClock,
        stop: &Arc<AtomicBool>,
    ) -> Result<Box<dyn FrameSource + Send>, Failure> {
        if !self.realtime && self.raw.is_none() {
            let settings = || CameraSettings {
                size_px,
                rate: self.fps,
                exposure_s: self.exposure.map(|ms| ms * 1e-3),
                gain: self.gain,
                format: self.format.clone(),
            };
            if let Some(id) = name.strip_prefix("genicam:") {
                return Ok(Box::new(Camera::genicam(id, settings(), clock, Arc::clone(stop)).map_err(Failure::usage)?));
            }
            if name.starts_with("/dev/") {
                let path = Path::new(name);
                return Ok(Box::new(Camera::v4l2(path, settings(), clock, Arc::clone(stop)).map_err(Failure::usage)?));
            }
        }
        if let (Some(text), false, None) = (name.strip_prefix("gst:"), self.realtime, self.raw)
            && self.settings().is_empty()
        {
            return Ok(Box::new(Camera::gstreamer(text, clock, Arc::clone(stop)).map_err(Failure::usage)?));
        }
        if let Some((option, _)) = self.settings().first() {
            return Err(Failure::usage(format!(
                "{name}: --{option} is for cameras, /dev/video0 or genicam:; this source is as it comes"
            )));
        }
        if let Some(format) = self.raw {
            if name != "-" {
                return Err(Failure::usage(format!(
                    "{name}: --raw describes what is on standard input: give - as the source"
                )));
            }
            return Ok(Box::new(RawPictures::new("standard input", standard_input()?, format, clock)));
        }
        if self.realtime {
            let recording = source::open_to_track(name, SourceOptions::default()).map_err(Failure::usage)?;
            return Ok(Box::new(Paced::new(recording, clock, Arc::clone(stop))));
        }
        if name != "-" && Path::new(name).exists() {
            let advice = "is a file or folder: play it at its own pace with --realtime, or use `catoptra track`";
            return Err(Failure::usage(format!("{name}: {advice}")));
        }
        Ok(Box::new(Stream::open(name, clock, Arc::clone(stop)).map_err(|error| {
            let exit = if stop.load(Ordering::Relaxed) { Exit::Interrupted } else { Exit::Usage };
            Failure::new(exit, error)
        })?))
    }

    /// The options for a camera.
    pub(super) fn settings(&self) -> Vec<(&'static str, String)> {
        let options = [
            ("fps", self.fps.map(|rate| rate.to_string())),
            ("exposure", self.exposure.map(|ms| format!("{ms} ms"))),
            ("gain", self.gain.map(|gain| gain.to_string())),
            ("format", self.format.clone()),
        ];
        options.into_iter().filter_map(|(name, value)| Some((name, value?))).collect()
    }
}
