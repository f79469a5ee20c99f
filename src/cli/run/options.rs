//! Options shared by offline and live tracking.

use crate::cli::Failure;
use crate::log::is_log;
use crate::sink::{OutputFrame, PictureCodec, Profile};
use std::path::Path;

/// The frame of reference of table and report.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub(in crate::cli) enum Reference {
    Base,
    Camera,
}

impl From<Reference> for OutputFrame {
    fn from(reference: Reference) -> Self {
        match reference {
            Reference::Base => Self::Base,
            Reference::Camera => Self::Camera,
        }
    }
}

impl Reference {
    /// The word for it.
    pub(in crate::cli) fn word(self) -> &'static str {
        match self {
            Self::Base => "base",
            Self::Camera => "camera",
        }
    }
}

/// Whom the log is for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, clap::ValueEnum)]
pub(in crate::cli) enum LogFor {
    #[default]
    Foxglove,
    Ros2,
}

impl From<LogFor> for Profile {
    fn from(log: LogFor) -> Self {
        match log {
            LogFor::Foxglove => Self::Foxglove,
            LogFor::Ros2 => Self::Ros2,
        }
    }
}

impl LogFor {
    /// The word for it, unless it is the default.
    pub(in crate::cli) fn unusual(self) -> Option<String> {
        match self {
            Self::Foxglove => None,
            Self::Ros2 => Some("ros2".to_owned()),
        }
    }
}

/// What is recorded of the pictures.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub(in crate::cli) enum Record {
    Windows,
    Ffv1,
    H264,
}

impl Record {
    /// The word for it.
    pub(in crate::cli) fn word(self) -> &'static str {
        match self {
            Self::Windows => "windows",
            Self::Ffv1 => "ffv1",
            Self::H264 => "h264",
        }
    }

    /// All, the one that keeps all that tracking needs in the least space first.
    pub(in crate::cli) const ALL: [Self; 3] = [Self::Windows, Self::Ffv1, Self::H264];

    /// The one with this word.
    pub(in crate::cli) fn of_word(word: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|record| record.word() == word)
    }

    /// Checks that `source` has what is to be recorded.
    ///
    /// # Errors
    /// When whole pictures are wanted of a log, which has parts of them.
    pub(in crate::cli) fn check(self, source: &Path) -> Result<(), Failure> {
        if self.codec().is_some() && is_log(source) {
            let text = "holds parts of its pictures, and a video of them would be black elsewhere: --record windows \
                        keeps the parts";
            return Err(Failure::usage(format!("{}: {text}", source.display())));
        }
        Ok(())
    }

    /// Codec of whole pictures, if they are recorded.
    pub(in crate::cli) fn codec(self) -> Option<PictureCodec> {
        match self {
            Self::Windows => None,
            Self::Ffv1 => Some(PictureCodec::Ffv1),
            Self::H264 => Some(PictureCodec::H264),
        }
    }
}
