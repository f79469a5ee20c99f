//! The bands of a frame, to a few tenths of a pixel: blobs, and which of them each marker is in each view.
//!
//! Blobs are searched in windows around the last positions; when not all markers are found there, in the whole picture.
//! The result is the same either way: a blob counts only when it lies wholly inside its window, and then it is the same
//! one that a search of the whole picture finds.

use crate::estimate::Miss;
use crate::rig::Rig;
use crate::segment::{Blob, Search, SegmentError, Segmenter};
use crate::source::{Frame, NotRecorded, Timestamp, Window};
use crate::track::assign::assigner::{Assigned, Assigner};
use nalgebra::Point3;

/// What a search reads around its window: a cell of two pixels on each side, and what rounds both to whole cells.
const RING_PX: u32 = 4;

/// Finds the bands, near to where they were last.
pub(in crate::track) struct Finder {
    segmenter: Segmenter,
    assigner: Assigner,
    /// Whether whole pictures are searched, not windows.
    full_frame: bool,
}

/// Blobs of a picture, and which of them each marker is.
pub(in crate::track) struct Found {
    pub blobs: Vec<Blob>,
    pub assigned: Vec<Result<Assigned, Miss>>,
}

impl Found {
    /// Around each band that was found, in each view.
    pub(in crate::track) fn windows(&self) -> Vec<Window> {
        self.bands().map(|(.., blob)| blob.bounds).collect()
    }

    /// Each band that was found: its marker, its view and the blob.
    pub(in crate::track) fn bands(&self) -> impl Iterator<Item = (usize, usize, &Blob)> {
        self.assigned.iter().enumerate().flat_map(move |(marker, assigned)| {
            let blobs = assigned.iter().flat_map(|assigned| assigned.blobs.iter().enumerate());
            blobs.filter_map(move |(view, blob)| Some((marker, view, self.blobs.get((*blob)?)?)))
        })
    }

    /// Around one marker's band, if it was found, in each view that shows it.
    pub(in crate::track) fn windows_of(&self, marker: usize) -> impl Iterator<Item = Window> {
        self.bands().filter(move |(own, ..)| *own == marker).map(|(.., blob)| blob.bounds)
    }

    /// Whether all markers are there.
    pub(in crate::track) fn is_complete(&self) -> bool {
        self.assigned.iter().all(Result::is_ok)
    }
}

impl Finder {
    /// # Errors
    /// When a marker has no colour model.
    pub(in crate::track) fn new(rig: &Rig, full_frame: bool) -> Result<Self, SegmentError> {
        Ok(Self { segmenter: Segmenter::for_rig(rig)?, assigner: Assigner::new(rig), full_frame })
    }

    /// The bands of a frame.
    ///
    /// # Errors
    /// When the picture cannot be segmented, or too little of it was recorded.
    pub(in crate::track) fn find(&mut self, rig: &Rig, frame: &Frame) -> Result<Found, SegmentError> {
        match self.find_in_picture(rig, frame) {
            Err(SegmentError::NotRecorded(why)) => self.find_in_parts(rig, frame, why),
            found => found,
        }
    }

    fn find_in_picture(&mut self, rig: &Rig, frame: &Frame) -> Result<Found, SegmentError> {
        let picture = &frame.picture;
        if let Some(windows) = self.assigner.windows(rig, frame.stamp) {
            let blobs = if self.full_frame {
                let size_px = picture.size_px();
                let mut all = self.segmenter.all_blobs(picture)?.to_vec();
                all.retain(|blob| windows.iter().any(|window| window.finds_whole(blob, size_px)));
                all
            } else {
                self.segmenter.blobs(picture, &windows)?.to_vec()
            };
            let found = self.whole(rig, frame, blobs);
            if found.is_complete() {
                return Ok(found);
            }
        }
        let blobs = self.segmenter.all_blobs(picture)?.to_vec();
        let assigned = self.assigner.assign(rig, &blobs, frame.stamp);
        Ok(Found { blobs, assigned })
    }

    /// The same without any memory; `None` when the picture cannot be segmented.
    pub(in crate::track) fn find_alone(&mut self, rig: &Rig, frame: &Frame) -> Option<Found> {
        let blobs = self.segmenter.all_blobs(&frame.picture).ok()?.to_vec();
        let assigned = Assigner::new(rig).assign(rig, &blobs, frame.stamp);
        Some(Found { blobs, assigned })
    }

    /// Remembers where a marker is.
    pub(in crate::track) fn remember(&mut self, marker: usize, at: Point3<f64>, stamp: Timestamp) {
        self.assigner.remember(marker, at, stamp);
    }

    /// Bands that lie whole in the parts of a picture that were recorded: how a log is followed whose beginning is lost
    /// or left out, and after frames in which a band was not measured now, but was then: it is searched further away.
    /// It counts only when all are there: no other tells what is behind what was not recorded.
    fn find_in_parts(&mut self, rig: &Rig, frame: &Frame, why: NotRecorded) -> Result<Found, SegmentError> {
        let inner = |part: &Window| Search { marker: None, view: None, window: part.shrunk(RING_PX) };
        let searches = frame.picture.recorded().unwrap_or_default().iter().map(inner);
        let searches: Vec<_> = searches.filter(|search| search.window.pixels() > 0).collect();
        let blobs = self.segmenter.blobs(&frame.picture, &searches)?.to_vec();
        let found = self.whole(rig, frame, blobs);
        if found.is_complete() { Ok(found) } else { Err(why.into()) }
    }

    /// Those of some blobs that are whole.
    fn whole(&mut self, rig: &Rig, frame: &Frame, mut blobs: Vec<Blob>) -> Found {
        blobs.retain(|blob| !blob.touches_border);
        let assigned = self.assigner.assign(rig, &blobs, frame.stamp);
        Found { blobs, assigned }
    }
}
