//! Whether the catheter stays where it is.
//!
//! A coder that predicts, or a camera that averages over time, takes the noise out of what stays. As soon as it moves,
//! and for some time after it has stopped, there are errors again: residuals of bands at rest tell nothing of those in
//! motion.

use crate::rig::Rig;
use crate::track::memory::by_band::ByBand;
use nalgebra::Point2;

/// A band whose image shifts by this in every view that shows it, pixels, has moved. Something in front of a band
/// shifts it in one view.
const MOVED_PX: f64 = 0.5;
/// Frames after which a coder has corrected most of what it left.
const CORRECTED_FRAMES: u32 = 30;

/// Where the bands are, and since when.
pub(in crate::track) struct Stays {
    places_px: ByBand<Option<Point2<f64>>>,
    /// Frames since one of them moved; `None` before the first motion.
    frames: Option<u32>,
}

impl Stays {
    pub(in crate::track) fn new(rig: &Rig) -> Self {
        Self { places_px: ByBand::new(rig, |_, _| None), frames: None }
    }

    /// Adds a frame: the bands that were fitted, with their images in some views. Returns whether this is the first
    /// motion.
    pub(in crate::track) fn add(&mut self, bands: impl Iterator<Item = (usize, Vec<(usize, Point2<f64>)>)>) -> bool {
        let mut moved = false;
        for (marker, images) in bands {
            let mut shifts_px = Vec::with_capacity(images.len());
            for (view, image) in &images {
                if let Some(place) = self.places_px.get_mut(marker, *view) {
                    shifts_px.push((image - *place.get_or_insert(*image)).norm());
                }
            }
            if shifts_px.is_empty() || shifts_px.iter().any(|shift| *shift < MOVED_PX) {
                continue;
            }
            moved = true;
            for (view, image) in images {
                if let Some(place) = self.places_px.get_mut(marker, view) {
                    *place = Some(image);
                }
            }
        }
        let is_first = moved && self.frames.is_none();
        self.frames = if moved { Some(0) } else { self.frames.map(|frames| frames.saturating_add(1)) };
        is_first
    }

    /// Whether the residuals of this frame are those of bands at rest, of a catheter that also moves.
    pub(in crate::track) fn is_at_rest(&self) -> bool {
        self.frames.is_some_and(|frames| frames >= CORRECTED_FRAMES)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::fixture;

    #[test]
    fn what_moves_in_every_view_has_moved_and_rests_some_time_later() {
        let mut stays = Stays::new(&fixture::rig());
        let mut add = |left: f64, right: f64| {
            let images = vec![(0, Point2::new(100.0 + left, 50.0)), (1, Point2::new(300.0, 80.0 + right))];
            let first = stays.add(std::iter::once((1, images)));
            (first, stays.is_at_rest())
        };
        assert!((0..60).all(|_| add(0.0, 0.1) == (false, false)), "it has never moved");
        // Something is in front of it in one view.
        assert_eq!(add(4.0, 0.0), (false, false));
        assert_eq!(add(4.0, -3.0), (true, false));
        assert!((1..CORRECTED_FRAMES).all(|_| add(4.0, -3.0) == (false, false)));
        assert_eq!(add(4.0, -3.0), (false, true));
        // Slowly, too.
        assert!((1..=8).map(|i| f64::from(i) * 0.1).any(|px| add(4.0 + px, -3.0 - px) == (false, false)));
    }

    #[test]
    fn a_view_that_shows_a_band_later_is_no_motion() {
        let mut stays = Stays::new(&fixture::rig());
        let [one, other] = [(0, Point2::new(100.0, 50.0)), (1, Point2::new(300.0, 80.0))];
        assert!(!stays.add(std::iter::once((1, vec![one]))));
        assert!(!stays.add(std::iter::once((1, vec![one, other]))));
        assert!(!stays.add(std::iter::once((1, vec![other]))));
        assert!(stays.add(std::iter::once((1, vec![(1, Point2::new(300.0, 84.0))]))));
    }
}
