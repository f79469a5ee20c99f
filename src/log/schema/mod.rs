//! The output of a run, defined once for writers and readers: the names of its files, the topics of a log and their
//! messages ([`messages`]), the names of its attachments and metadata, and the columns of the table.
//!
//! | topic | schema | what | when |
//! |---|---|---|---|
//! | `/catheter/estimate` | `catoptra.Estimate` | all that was measured, with covariances, view by view | every frame |
//! | `/catheter/deflection` | `catoptra.Deflection` | θ and its σ; NaN and the reason when not measured | every frame |
//! | `/scene` | `foxglove.SceneUpdate` | tube, bands and coil direction, in the base frame if there is one | every frame |
//! | `/camera/annotations` | `foxglove.ImageAnnotations` | outline, centre and label of every band | every frame |
//! | `/camera/image` | `foxglove.CompressedImage` | the whole picture, JPEG: to look at | every second, with pictures |
//! | `/camera/calibration` | `foxglove.CameraCalibration` | intrinsics, `plumb_bob` or `rational_polynomial` | once |
//! | `/tf` | `foxglove.FrameTransform` | pose of frame `camera` in frame `base`, if there is one | once |
//! | `/coil/current` | `catoptra.Current` | currents of the coils, on the host's clock | live, when given |
//! | `/camera/windows` | `catoptra.PictureWindows` | what the tracker looked at | with `--record windows` |
//! | `/health` | `catoptra.Health` | counts, misses by reason, drift alarms | every second, and at the end |
//!
//! The windows of a picture follow its estimate after some frames. A drift alarm triggers an extra `/health` message.

pub(crate) mod messages;
mod protobuf;
pub(crate) mod table;

use foxglove::Schema;
use foxglove::messages::{CameraCalibration, CompressedImage, FrameTransform, ImageAnnotations, SceneUpdate};
use messages::{Current, Deflection, Estimate, Health, PictureWindows};
pub(crate) use protobuf::Catoptra;

/// All messages are Protobuf.
pub(crate) const ENCODING: &str = "protobuf";

/// How the samples of a picture's window are compressed.
pub(crate) const WINDOW_FORMAT: &str = "png";

/// Name of the log in the folder of a run.
pub(crate) const LOG_FILE: &str = "log.mcap";

/// Name of the table in the folder of a run.
pub(crate) const TABLE_FILE: &str = "track.csv";

/// Name of the video of the pictures in the folder of a run.
pub(crate) const PICTURES_FILE: &str = "pictures.mkv";

/// Name of the video of that number, from 1, where there are several.
pub(crate) fn pictures_file(number: u32) -> String {
    if number == 1 { PICTURES_FILE.to_owned() } else { PICTURES_FILE.replace(".mkv", &format!("-{number}.mkv")) }
}

/// Name of the attached copy of schemas and channels: their records, one after another.
pub(crate) const TOPICS_ATTACHMENT: &str = "topics";

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
    Image,
}

impl Topic {
    pub(crate) const ALL: [Self; 10] = [
        Self::Estimate,
        Self::Deflection,
        Self::Scene,
        Self::Annotations,
        Self::Calibration,
        Self::Transform,
        Self::Health,
        Self::Current,
        Self::Windows,
        Self::Image,
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
            Self::Image => "/camera/image",
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
            Self::Image => CompressedImage::get_schema(),
        }
    }
}
