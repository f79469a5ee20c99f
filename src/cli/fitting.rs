//! Sources that fit a rig: of its size, in colour, with a first frame.

use super::{Exit, Failure};
use crate::rig::Rig;
use crate::source::{self, Frame, FrameSource, PixelFormat, SourceError, SourceOptions, StreamFaults};
use std::path::Path;

/// The recording or folder `source`, at its first frame; `rig` with the file it is from.
///
/// # Errors
/// [`Exit::Usage`] when it cannot be read, or does not fit.
pub(super) fn open((source, options): (&Path, SourceOptions), rig: (&Path, &Rig)) -> Result<Peeked, Failure> {
    fitting(source, source::open(source, options), rig)
}

/// As [`open`], and logs that hold windows of their pictures.
///
/// # Errors
/// As [`open`].
pub(super) fn open_to_track((source, options): (&Path, SourceOptions), rig: (&Path, &Rig)) -> Result<Peeked, Failure> {
    fitting(source, source::open_to_track(source, options), rig)
}

fn fitting(
    source: &Path,
    opened: Result<Box<dyn FrameSource + Send>, SourceError>,
    (rig_file, rig): (&Path, &Rig),
) -> Result<Peeked, Failure> {
    let invalid = |e: SourceError| Failure::new(Exit::Usage, e);
    let name = source.display();
    let opened = opened.map_err(invalid)?;
    check_size(&name.to_string(), opened.size_px(), (rig_file, rig))?;
    let peeked = Peeked::new(opened).map_err(invalid)?;
    if peeked.first.as_ref().is_some_and(|frame| frame.picture.format() == PixelFormat::Grey) {
        let text = format!("{name}: pictures are grey; markers are told by their colour");
        return Err(Failure::new(Exit::Usage, text));
    }
    Ok(peeked)
}

/// Refuses pictures, of the source called `name`, that have not the size of those of the rig's camera.
///
/// # Errors
/// [`Exit::Usage`].
pub(super) fn check_size(name: &str, size_px: [u32; 2], (rig_file, rig): (&Path, &Rig)) -> Result<(), Failure> {
    let ([width, height], expected) = (size_px, rig.camera.size_px);
    if size_px == expected {
        return Ok(());
    }
    let text = format!(
        "{name}: pictures of {width}x{height} pixels, but the camera in {} has {}x{}; a calibration holds for one size only",
        rig_file.display(),
        expected[0],
        expected[1]
    );
    Err(Failure::new(Exit::Usage, text))
}

/// A source whose first frame has been looked at.
pub(super) struct Peeked {
    first: Option<Frame>,
    source: Box<dyn FrameSource + Send>,
}

impl Peeked {
    /// Takes the first frame out of `source`.
    ///
    /// # Errors
    /// When there is none.
    fn new(mut source: Box<dyn FrameSource + Send>) -> Result<Self, SourceError> {
        Ok(Self { first: source.next_frame()?, source })
    }
}

impl FrameSource for Peeked {
    fn next_frame(&mut self) -> Result<Option<Frame>, SourceError> {
        match self.first.take() {
            Some(frame) => Ok(Some(frame)),
            None => self.source.next_frame(),
        }
    }

    fn size_px(&self) -> [u32; 2] {
        self.source.size_px()
    }

    fn frame_count_hint(&self) -> Option<u64> {
        self.source.frame_count_hint()
    }

    fn faults(&self) -> StreamFaults {
        self.source.faults()
    }
}
