//! Notices a picture in which some bands are still where an earlier picture had them: it is torn, as when a transfer
//! ends early in a buffer that is used again, or a picture is copied while the next is drawn. Its rows above and below
//! the tear are of different moments.
//!
//! In: the bands of the last pictures, and what these showed there. Out: whether a picture shows one of them again, to
//! the last bit. A band that has moved sideways by a pixel since, or did just before, cannot have the same rows again.
//! Of one that moves along itself, those in its middle may be alike, but not its first and last ones. Of one that
//! hardly moves, all must be the same. The picture that is wholly the one before is [`super::repeated_pictures`]'.
//!
//! A coder may leave rows as they were although something moves there by a few pixels. It keeps many more where nothing
//! moves. So where rows are often the same, they tell nothing; and a part of a band, or one that hardly moved, tells
//! only where noise is known to be new in every picture.
//!
//! Cannot detect: rows that were coded again, with losses; old rows in most pictures, or a part that is old in every
//! picture (it never shows the same twice).

use super::repeated_pictures::{is_recent, rows};
use crate::estimate::Estimate;
use crate::source::{Picture, Timestamp, Window};
use crate::track::assign::Found;
use nalgebra::{Point2, Vector2};
use std::collections::VecDeque;

/// Pictures that are remembered: drivers and cameras rarely use more buffers in turn.
const KEPT: usize = 8;
/// How far a band that is there again has moved, pixels.
const MOVED_PX: f64 = 1.0;
/// One that has moved as far is enough: it is not a coder that is late.
const FAR_PX: f64 = 5.0;
/// Rows that are not the same again by chance, one after the other, and which part of a band's they must be.
const ROWS: usize = 4;
const PART: f64 = 0.4;
/// Bands (or views of one) that are old: a coder may be late with one that moves slowly.
const FEWEST_BANDS: usize = 2;
/// If more than this part of all rows is the same in the next picture, as where a coder keeps them, rows tell nothing.
const USUAL: f64 = 0.03;

/// The bands in the last pictures.
#[derive(Debug, Default)]
pub(in crate::track) struct Torn {
    /// Latest first.
    kept: VecDeque<Shown>,
    is_seen: bool,
    /// Rows of bands that were the same in the next picture, and all.
    same: [usize; 2],
}

/// What a picture showed.
#[derive(Debug, Default)]
struct Shown {
    stamp: Option<Timestamp>,
    bands: Vec<Band>,
    /// The first channel in the bands' windows, row by row.
    bytes: Vec<u8>,
}

/// A band in a view.
#[derive(Debug)]
struct Band {
    marker: usize,
    view: usize,
    centre_px: Point2<f64>,
    /// Its direction.
    axis: Vector2<f64>,
    window: Window,
    /// Where its bytes begin, and how many a row has.
    bytes: [usize; 2],
}

/// How a band moved, as far as it matters here.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Moved {
    Hardly,
    AlongItself,
    Sideways,
    Far,
}

impl Shown {
    /// How a band moved from where it is here, if it is here.
    fn moved(&self, band: &Band) -> Option<Moved> {
        let here = self.bands.iter().find(|here| (here.marker, here.view) == (band.marker, band.view))?;
        let way = here.centre_px - band.centre_px;
        Some(match (way.perp(&band.axis).abs(), way.norm()) {
            (_, FAR_PX..) => Moved::Far,
            (MOVED_PX.., _) => Moved::Sideways,
            (_, MOVED_PX..) => Moved::AlongItself,
            _ => Moved::Hardly,
        })
    }

    /// Which rows of a band a picture shows again.
    fn again(&self, band: &Band, picture: &Picture) -> Option<Again> {
        let [begin, row] = band.bytes;
        let now = rows(&picture.plane(0)?, band.window);
        let same = now.zip(self.bytes.get(begin..)?.chunks_exact(row)).map(|(now, before)| now == Some(before));
        Some(Again::of(same))
    }
}

/// Rows of a band that are the same again.
#[derive(Debug, Default)]
struct Again {
    count: usize,
    of: usize,
    /// One after the other: from the first row, anywhere, up to the last row.
    first: usize,
    longest: usize,
    last: usize,
}

impl Again {
    fn of(rows: impl Iterator<Item = bool>) -> Self {
        let mut again = Self::default();
        for is_same in rows {
            again.of += 1;
            again.count += usize::from(is_same);
            again.last = if is_same { again.last + 1 } else { 0 };
            again.longest = again.longest.max(again.last);
            if again.last == again.of {
                again.first = again.of;
            }
        }
        again
    }

    /// Whether they cannot be after such a motion, where rows are hardly ever the same. `noise_is_new`: none is by
    /// chance.
    fn are_old(&self, moved: Moved, noise_is_new: bool) -> bool {
        let all = self.of > 0 && self.count == self.of;
        let rows = match moved {
            Moved::Hardly => return all && noise_is_new,
            _ if all => return true,
            Moved::AlongItself => self.first.max(self.last),
            Moved::Sideways | Moved::Far => self.longest,
        };
        noise_is_new && rows >= ROWS && rows as f64 >= PART * self.of as f64
    }
}

impl Torn {
    /// Whether a picture, which is not wholly the one before, still shows a band where an earlier one did.
    /// `noise_is_new`: in every picture.
    pub(in crate::track) fn is_torn(&mut self, picture: &Picture, stamp: Timestamp, noise_is_new: bool) -> bool {
        let mut same = self.same;
        let is_rare = (same[0] as f64) < USUAL * same[1] as f64;
        let is_recent = |shown: &Shown| shown.stamp.is_some_and(|then| is_recent(stamp, then));
        // Where rows tell nothing, they are only counted.
        let compared = if is_rare { KEPT } else { 1 };
        let recent = self.kept.iter().take(compared).enumerate().filter(|(_, shown)| is_recent(shown));
        let bands = recent.flat_map(|(age, shown)| shown.bands.iter().map(move |band| (age, shown, band)));
        let (mut old, mut is_sure) = (0, false);
        for (age, shown, band) in bands {
            // To the last picture from the one before it, or since an earlier one.
            let other = self.kept.get(if age == 0 { 1 } else { 0 });
            let moved = other.and_then(|other| other.moved(band)).unwrap_or(Moved::Hardly);
            // It may be back where it hardly moved from.
            if age > 0 && moved == Moved::Hardly {
                continue;
            }
            let Some(again) = shown.again(band, picture) else { continue };
            if age == 0 {
                same = [same[0] + again.count, same[1] + again.of];
            }
            // Where it was not recorded, nothing was the same.
            if is_rare && again.are_old(moved, noise_is_new) && picture.declare_read(band.window).is_ok() {
                old += 1;
                is_sure |= moved == Moved::Far && again.count == again.of;
            }
        }
        let is_torn = is_sure || old >= FEWEST_BANDS;
        if is_torn {
            self.is_seen = true;
        } else {
            self.same = same;
        }
        is_torn
    }

    /// Whether a picture was torn.
    pub(in crate::track) fn is_seen(&self) -> bool {
        self.is_seen
    }

    /// Remembers a picture that was measured, and the bands that were located in it.
    pub(in crate::track) fn remember(&mut self, picture: &Picture, found: &Found, estimate: &Estimate) {
        let Some(plane) = picture.plane(0) else { return };
        let oldest = if self.kept.len() == KEPT { self.kept.pop_back() } else { None };
        let mut shown = oldest.unwrap_or_default();
        shown.stamp = Some(estimate.stamp);
        shown.bands.clear();
        shown.bytes.clear();
        let is_located = |marker: usize| estimate.markers.get(marker).is_some_and(|own| own.position.is_ok());
        for (marker, view, blob) in found.bands().filter(|(marker, ..)| is_located(*marker)) {
            let (begin, window) = (shown.bytes.len(), blob.bounds);
            rows(&plane, window).flatten().for_each(|row| shown.bytes.extend_from_slice(row));
            let row = (shown.bytes.len() - begin) / rows(&plane, window).len().max(1);
            let (centre_px, axis, bytes) = (blob.centre_px, blob.axis, [begin, row.max(1)]);
            shown.bands.push(Band { marker, view, centre_px, axis, window, bytes });
        }
        self.kept.push_front(shown);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_that_are_the_same_are_counted_from_both_ends() {
        let again = |rows: &str| Again::of(rows.chars().map(|c| c == '='));
        let counts = |rows| {
            let Again { count, of, first, longest, last } = again(rows);
            [count, of, first, longest, last]
        };
        assert_eq!(counts("==.===.="), [6, 8, 2, 3, 1]);
        assert_eq!(counts("===="), [4, 4, 4, 4, 4]);
        assert_eq!(counts(""), [0; 5]);
        let all = [Moved::Hardly, Moved::AlongItself, Moved::Sideways, Moved::Far];
        let are_old = |rows, noise_is_new| all.map(|moved| again(rows).are_old(moved, noise_is_new));
        assert_eq!(are_old("========", true), [true; 4]);
        assert_eq!(are_old("========", false), [false, true, true, true]);
        assert_eq!(are_old("====....", true), [false, true, true, true]);
        assert_eq!(are_old("...====..", true), [false, false, true, true]);
        assert_eq!(are_old("===.====", true), [false, true, true, true]);
        for (rows, noise_is_new) in [("===.===", true), ("====.......", true), ("", true), ("====....", false)] {
            assert_eq!(are_old(rows, noise_is_new), [false; 4], "{rows}");
        }
        assert_eq!(are_old("==", true), [true; 4], "a band of two rows");
    }
}
