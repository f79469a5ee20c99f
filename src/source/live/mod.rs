//! Where frames come from while they are taken: streams, raw pictures on a pipe, recordings played at their own pace.
//!
//! A live source waits for its frames. It gives them the host's time ([`super::HostTime`]) beside the camera's, and goes on after
//! an interruption that a camera or a network survives. Set its `stop` flag, and it ends at the next frame or within some
//! seconds of silence.

mod paced;
mod raw;
mod stream;

pub use paced::Paced;
pub use raw::{RawFormat, RawPictures};
pub use stream::Stream;
