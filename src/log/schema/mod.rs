//! What a run leaves behind, defined once: the topics of a log and their messages ([`messages`]), the names in its metadata, and
//! the columns of the table ([`table`]). Sinks write by it, readers read by it.

pub mod messages;
mod protobuf;
pub(crate) mod table;

use foxglove::Schema;
use foxglove::messages::{CameraCalibration, FrameTransform, ImageAnnotations, SceneUpdate};
use messages::{Current, Deflection, Estimate, Health, PictureWindows};
pub(crate) use protobuf::Catoptra;

/// All messages are Protobuf.
pub(crate) const ENCODING: &str = "protobuf";

/// How the samples of a picture's window are compressed.
pub(crate) const WINDOW_FORMAT: &str = "png";

/// Name of the attached rig file.
pub(crate) const RIG_ATTACHMENT: &str = "rig.toml";

/// Name of the attached options of the run.
pub(crate) const OPTIONS_ATTACHMENT: &str = "options.toml";

/// Name of the metadata record, and of this program.
pub(crate) const METADATA: &str = "catoptra";

/// A topic of a log.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Topic {
    Estimate,
    Deflection,
    Scene,
    Annotations,
    Calibration,
    Transform,
    Health,
    Current,
    Windows,
}

impl Topic {
    pub(crate) const ALL: [Self; 9] = [
        Self::Estimate,
        Self::Deflection,
        Self::Scene,
        Self::Annotations,
        Self::Calibration,
        Self::Transform,
        Self::Health,
        Self::Current,
        Self::Windows,
    ];

    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Estimate => "/catheter/estimate",
            Self::Deflection => "/catheter/deflection",
            Self::Scene => "/scene",
            Self::Annotations => "/camera/annotations",
            Self::Calibration => "/camera/calibration",
            Self::Transform => "/tf",
            Self::Health => "/health",
            Self::Current => "/coil/current",
            Self::Windows => "/camera/windows",
        }
    }

    pub(crate) fn schema(self) -> Option<Schema> {
        use foxglove::Encode as _;
        match self {
            Self::Estimate => Catoptra::<Estimate>::get_schema(),
            Self::Deflection => Catoptra::<Deflection>::get_schema(),
            Self::Scene => SceneUpdate::get_schema(),
            Self::Annotations => ImageAnnotations::get_schema(),
            Self::Calibration => CameraCalibration::get_schema(),
            Self::Transform => FrameTransform::get_schema(),
            Self::Health => Catoptra::<Health>::get_schema(),
            Self::Current => Catoptra::<Current>::get_schema(),
            Self::Windows => Catoptra::<PictureWindows>::get_schema(),
        }
    }
}
