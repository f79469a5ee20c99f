//! Options that tracking a recording and tracking live share.

use crate::sink::{OutputFrame, PictureCodec};

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

    /// How whole pictures are compressed, if they are recorded.
    pub(super) fn codec(self) -> Option<PictureCodec> {
        match self {
            Self::Windows => None,
            Self::Ffv1 => Some(PictureCodec::Ffv1),
            Self::H264 => Some(PictureCodec::H264),
        }
    }
}
