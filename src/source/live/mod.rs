//! Live sources: cameras, streams, raw pictures on a pipe, recordings played at their own pace.
//!
//! A live source waits for its frames. It gives them the host's time ([`super::HostTime`]) as well as the camera's, and
//! continues after an interruption if camera or network come back. When its `stop` flag is set, it ends at the next
//! frame or after some seconds of silence.

#[cfg(not(all(target_os = "linux", feature = "genicam", feature = "gstreamer")))]
mod absent;
#[cfg_attr(
    not(any(target_os = "linux", feature = "genicam", feature = "gstreamer")),
    allow(dead_code, reason = "this build has no camera that needs it")
)]
mod camera;
mod catching_up;
#[cfg(feature = "genicam")]
mod genicam;
#[cfg(feature = "gstreamer")]
mod gstreamer;
mod one_clock;
mod paced;
mod raw;
mod retry;
#[cfg_attr(
    not(any(target_os = "linux", feature = "genicam", feature = "gstreamer")),
    allow(dead_code, reason = "this build has no camera that needs it")
)]
mod samples;
#[cfg_attr(
    not(any(target_os = "linux", feature = "genicam", feature = "gstreamer")),
    allow(dead_code, reason = "this build has no camera that needs it")
)]
mod settings;
mod stalls;
mod stream;
#[cfg(target_os = "linux")]
mod v4l2;
#[cfg(target_os = "linux")]
mod v4l2_setup;

pub use camera::Camera;
pub use paced::Paced;
pub use raw::{RawFormat, RawPictures};
pub use settings::CameraSettings;
pub use stream::Stream;
