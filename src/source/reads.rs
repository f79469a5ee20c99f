//! Which parts of a picture were recorded, and which were read.
//!
//! The tracker reads small parts of a picture, and declares them first ([`Picture::declare_read`]). This has two uses:
//! a recorder can keep only those parts ([`Picture::windows_read`]), and the missing parts of such a picture are never
//! taken for something that the camera saw: reading there is refused.

use super::{Picture, Window};

/// A part of a picture was wanted that was not recorded.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error(
    "columns {} to {} of rows {} to {} are wanted, which were not recorded",
    area.x0, area.x1.saturating_sub(1), area.y0, area.y1.saturating_sub(1)
)]
pub struct NotRecorded {
    /// The area wanted, pixels.
    pub area: Window,
}

impl Picture {
    /// The same picture, of which only some windows were recorded; samples outside mean nothing.
    pub fn of_parts(mut self, there: Vec<Window>) -> Self {
        self.reads.there = Some(there);
        self
    }

    /// The same picture, marked as damaged: its frame has a time but no measurement.
    pub(crate) fn marked_damaged(mut self) -> Self {
        self.reads.damaged = true;
        self
    }

    /// The same picture, marked as a camera or a coder gave it. Without the mark a program may have made it of others.
    pub(crate) fn marked_as_given(mut self) -> Self {
        self.reads.as_given = true;
        self
    }

    /// Whether it is known to be so: only then its noise, and what of it lasts, tell how it came about.
    pub(crate) fn is_as_given(&self) -> bool {
        self.reads.as_given
    }

    /// The same picture, marked as interlaced or not.
    pub(crate) fn interlaced(mut self, interlaced: bool) -> Self {
        self.reads.interlaced = interlaced;
        self
    }

    /// Whether its odd and even rows were taken at different times.
    pub fn is_interlaced(&self) -> bool {
        self.reads.interlaced
    }

    /// Whether it is known to be damaged, so that nothing may be measured in it.
    pub fn is_damaged(&self) -> bool {
        self.reads.damaged
    }

    /// Whether all of it was recorded.
    pub(crate) fn is_whole(&self) -> bool {
        let [width, height] = self.size_px();
        let all = Window { x0: 0, y0: 0, x1: width, y1: height };
        self.reads.there.as_ref().is_none_or(|there| all.without(there).is_empty())
    }

    /// The parts that were recorded; `None` for all of it.
    pub fn recorded(&self) -> Option<&[Window]> {
        self.reads.there.as_deref()
    }

    /// Must be called before using samples of the pixels in `area` (a sample of a subsampled channel belongs to all
    /// pixels it covers). Parts of `area` outside the picture do not matter.
    ///
    /// # Errors
    /// When not all of them were recorded.
    pub fn declare_read(&self, area: Window) -> Result<(), NotRecorded> {
        let area = area.clipped(self.size_px());
        if let Some(there) = &self.reads.there
            && !area.grown(0, self.coarsest()).clipped(self.size_px()).without(there).is_empty()
        {
            return Err(NotRecorded { area });
        }
        self.reads.read.lock().push(area);
        Ok(())
    }

    /// What was read, plus `margin_px` on all sides: windows that do not overlap and split no sample of a subsampled
    /// channel. Depends on the set of areas read, not on their order.
    pub fn windows_read(&self, margin_px: u32) -> Vec<Window> {
        let step = self.coarsest();
        let mut areas: Vec<Window> = {
            let read = self.reads.read.lock();
            read.iter().map(|area| area.grown(margin_px, step).clipped(self.size_px())).collect()
        };
        // Large ones first: they contain most of the others.
        areas.sort_by_key(|w| (std::cmp::Reverse(w.pixels()), w.y0, w.x0, w.y1, w.x1));
        let mut windows = Vec::with_capacity(areas.len());
        for area in areas {
            windows.extend(area.without(&windows));
        }
        windows
    }

    /// Pixels per sample of the coarsest channel.
    fn coarsest(&self) -> u32 {
        (0..self.format().channels()).filter_map(|i| self.plane(i)).flat_map(|plane| plane.scale).max().unwrap_or(1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::source::{Colour, PixelFormat};

    fn picture() -> Picture {
        let planes = vec![vec![0; 32 * 16], vec![0; 16 * 8], vec![0; 16 * 8]];
        Picture::from_planes(32, 16, PixelFormat::Yuv { chroma_log2: [1, 1] }, Colour::SRGB, planes).unwrap()
    }

    fn window(x0: u32, y0: u32, x1: u32, y1: u32) -> Window {
        Window { x0, y0, x1, y1 }
    }

    #[test]
    fn what_was_looked_at_is_kept_in_whole_samples_and_once() {
        let picture = picture();
        for area in [window(3, 3, 7, 9), window(5, 1, 9, 5), window(20, 10, 60, 60), window(4, 4, 5, 5)] {
            picture.declare_read(area).unwrap();
        }
        let kept = picture.windows_read(0);
        assert_eq!(kept.iter().map(Window::pixels).sum::<u64>(), 6 * 8 + 6 * 6 - 4 * 4 + 12 * 6);
        assert!(kept.iter().all(|w| [w.x0, w.y0, w.x1, w.y1].iter().all(|v| v % 2 == 0)), "{kept:?}");
        // With a margin, the same windows cover all that was read.
        let again = super::tests::picture().of_parts(picture.windows_read(4));
        again.declare_read(window(1, 0, 9, 13)).unwrap();
    }

    #[test]
    fn what_is_not_there_is_not_looked_at() {
        let parts = picture().of_parts(vec![window(0, 0, 8, 8), window(8, 0, 16, 16)]);
        parts.declare_read(window(2, 2, 16, 8)).unwrap();
        parts.declare_read(window(40, 40, 50, 50)).unwrap();
        let refused = parts.declare_read(window(2, 2, 9, 9)).unwrap_err();
        assert_eq!(refused.to_string(), "columns 2 to 8 of rows 2 to 8 are wanted, which were not recorded");
        let refused = parts.declare_read(window(15, 0, 17, 1)).unwrap_err();
        assert_eq!(refused.area, window(15, 0, 17, 1));
        assert_eq!(parts.windows_read(0), [window(2, 2, 16, 8)]);
    }
}
