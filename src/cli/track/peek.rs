//! A source whose first frame has been looked at.

use catoptra::source::{Frame, FrameSource, SourceError, Tally};

/// Gives the frame it was made with, then those of the source.
pub(super) struct Peeked {
    first: Option<Frame>,
    source: Box<dyn FrameSource + Send>,
}

impl Peeked {
    /// Takes the first frame out of `source`.
    ///
    /// # Errors
    /// When there is none.
    pub(super) fn new(mut source: Box<dyn FrameSource + Send>) -> Result<Self, SourceError> {
        Ok(Self { first: source.next_frame()?, source })
    }

    /// The first frame, as long as it has not been given.
    pub(super) fn first(&self) -> Option<&Frame> {
        self.first.as_ref()
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

    fn tally(&self) -> Tally {
        self.source.tally()
    }
}
