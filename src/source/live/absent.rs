//! Stand-ins for cameras that this build does not support; they say what to do about it.

use super::super::SourceError;
use super::super::host::HostClock;
use super::Camera;
#[cfg(not(all(target_os = "linux", feature = "genicam")))]
use super::CameraSettings;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

#[cfg(not(feature = "genicam"))]
impl Camera {
    /// A GenICam camera, in a build that supports them.
    ///
    /// # Errors
    /// Always: how to build with them.
    pub fn genicam(
        id: &str,
        _settings: CameraSettings,
        _clock: HostClock,
        _stop: Arc<AtomicBool>,
    ) -> Result<Self, SourceError> {
        let reason = "this catoptra was built without GenICam cameras; install libaravis-dev and libusb-1.0-0-dev \
                      (Debian, Ubuntu; elsewhere Aravis 0.8.25 or newer), then install it anew with: cargo install \
                      --locked --path . --features genicam";
        Err(SourceError::Camera { name: format!("genicam:{id}"), reason: reason.to_owned() })
    }
}

#[cfg(not(feature = "gstreamer"))]
impl Camera {
    /// A GStreamer pipeline, in a build that has them.
    ///
    /// # Errors
    /// Always: how to build with them.
    pub fn gstreamer(text: &str, _clock: HostClock, _stop: Arc<AtomicBool>) -> Result<Self, SourceError> {
        let reason = "this catoptra was built without GStreamer; install libgstreamer1.0-dev and \
                      libgstreamer-plugins-base1.0-dev (Debian, Ubuntu; elsewhere GStreamer 1.18 or newer), then \
                      install it anew with: cargo install --locked --path . --features gstreamer";
        Err(SourceError::Camera { name: format!("gst:{text}"), reason: reason.to_owned() })
    }
}

#[cfg(not(target_os = "linux"))]
impl Camera {
    /// A V4L2 camera, on Linux.
    ///
    /// # Errors
    /// Always: only Linux has them.
    pub fn v4l2(
        path: &std::path::Path,
        _settings: CameraSettings,
        _clock: HostClock,
        _stop: Arc<AtomicBool>,
    ) -> Result<Self, SourceError> {
        let reason = "cameras under /dev exist only on Linux; use a stream, or raw pictures on standard input (--raw)";
        Err(SourceError::Camera { name: path.display().to_string(), reason: reason.to_owned() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    #[cfg(not(feature = "gstreamer"))]
    fn a_pipeline_in_a_build_without_says_how_to_build_one_with() {
        let error = Camera::gstreamer("videotestsrc", HostClock::start(), Arc::default()).unwrap_err().to_string();
        assert!(error.contains("libgstreamer1.0-dev") && error.contains("--features gstreamer"), "{error}");
    }

    #[test]
    #[cfg(not(feature = "genicam"))]
    fn a_genicam_camera_in_a_build_without_says_how_to_build_one_with() {
        let settings = CameraSettings { size_px: [2, 2], rate: None, exposure_s: None, gain: None, format: None };
        let error = Camera::genicam("", settings, HostClock::start(), Arc::default()).unwrap_err().to_string();
        assert!(error.contains("libaravis-dev") && error.contains("--features genicam"), "{error}");
    }
}
