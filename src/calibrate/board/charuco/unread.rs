//! Why a ChArUco board is not found though there are markers: which of the things said of it is wrong.

use crate::calibrate::board::charuco::dictionary::Dictionary;
use crate::calibrate::board::charuco::layout::Layout;
use crate::calibrate::board::charuco::markers::{Marker, Quad};
use crate::calibrate::board::charuco::{FEWEST, read};
use crate::calibrate::board::flat::{homography, map, median};
use crate::calibrate::board::grey::Grey;
use crate::calibrate::board::judge::Flaw;

/// Markers of another size than this part of a square more or less, and a pixel, are not what was said.
const RATIO: f64 = 0.1;
/// Ratios of marker and square that are tried.
const RATIOS: [f64; 7] = [0.35, 0.45, 0.55, 0.65, 0.75, 0.85, 0.95];
/// Squares in a row that are tried.
const COLUMNS: std::ops::RangeInclusive<usize> = 3..=30;
/// So many markers are no accident.
const ENOUGH: usize = 3;
/// Fewer than so many within a board may be.
const ACCIDENTS: usize = 2;

/// Why a ChArUco board is not found.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Unread {
    /// No marker that fits.
    #[error("; no two markers of {dictionary} that belong together are seen")]
    NoMarkers {
        /// As asked for.
        dictionary: Dictionary,
    },
    /// Markers of another dictionary.
    #[error("; its markers are of {found}, not of {dictionary}")]
    OtherDictionary {
        /// The smallest that has the markers seen.
        found: Dictionary,
        /// As asked for.
        dictionary: Dictionary,
    },
    /// OpenCV's layout of other versions.
    #[error(
        "; its markers are laid out in OpenCV's {} pattern (with an even number of rows the square at the upper left is {}): \
         {}", if *.legacy { "legacy" } else { "newer" }, if *.legacy { "light" } else { "dark" },
        if *.legacy { "add `:legacy` to the board" } else { "leave out `:legacy`" }
    )]
    Layout {
        /// Whether the legacy one is seen, not the newer one.
        legacy: bool,
    },
    /// Markers that are not on it.
    #[error("; there are markers up to number {most}, on a board of {0}x{1} squares they end at {last}: are these its \
        columns and rows of SQUARES (not of corners)?", .squares[0], .squares[1])]
    OtherMarkers {
        /// The largest number seen.
        most: usize,
        /// The largest on the board.
        last: usize,
        /// Squares in a row and a column, as asked for.
        squares: [usize; 2],
    },
    /// Another number of squares.
    #[error(
        "; its markers are those of a board {found} squares wide, not {asked}: are columns and rows those of SQUARES \
        (not of corners)?"
    )]
    OtherWidth {
        /// Squares in a row.
        found: usize,
        /// As asked for.
        asked: usize,
    },
    /// Markers that are larger or smaller.
    #[error(
        "; its markers are {found:.2} of a square wide, {asked:.2} by what was said: one of the two lengths is wrong"
    )]
    Ratio {
        /// Marker to square, as seen.
        found: f64,
        /// As asked for.
        asked: f64,
    },
    /// Markers that contradict.
    #[error("; {here} markers are where such a board has them, {elsewhere} others are not: is it the right board?")]
    Elsewhere {
        /// Markers in their places.
        here: usize,
        /// Others of the dictionary.
        elsewhere: usize,
    },
    /// Too little of it.
    #[error(
        "; {corners} of its corners are seen beside {markers} markers, at least {FEWEST} that are not in a line are \
        needed, and two whole squares side by side"
    )]
    FewCorners {
        /// Corners.
        corners: usize,
        /// Markers.
        markers: usize,
    },
    /// Corners that are no board's.
    #[error("; what was seen is none: {0}")]
    Flaw(Flaw),
}

/// What was seen.
pub(super) struct Clues<'a> {
    pub(super) picture: &'a Grey,
    pub(super) quads: &'a [Quad],
    pub(super) layout: &'a Layout,
    pub(super) dictionary: Dictionary,
    /// In the dictionary.
    pub(super) markers: &'a [Marker],
}

impl Clues<'_> {
    /// What shows that another board is seen than the one asked for; `images` are those of that one.
    pub(super) fn other_board(&self, images: &[Vec<Marker>]) -> Option<Unread> {
        let own = images.first().map_or(0, Vec::len);
        let [columns, rows] = self.layout.squares;
        let squares = |columns: usize, rows: usize| Layout { squares: [columns, rows], ..self.layout.clone() };
        let most = |layout: &Layout, markers: &[Marker]| layout.images(markers).first().map_or(0, Vec::len);
        if let Some(found) = images.iter().find_map(|image| self.ratio(image)) {
            return Some(Unread::Ratio { found, asked: self.layout.marker });
        }
        // Higher than was said: some of its markers are none of the board's, and may be beyond the dictionary.
        let family = Dictionary::families().find(|family| family.is_akin(self.dictionary))?;
        let markers = self.exact(family);
        let high = |columns: usize| squares(columns, 2 * family.size() / columns);
        let last = self.layout.count().saturating_sub(1);
        let beyond = |image: &Vec<Marker>| image.iter().map(|marker| marker.id).filter(|id| *id > last).collect();
        let beyond: Vec<usize> = high(columns).images(&markers).first().map_or_else(Vec::new, beyond);
        if let (true, Some(most)) = (beyond.len() > 1, beyond.into_iter().max()) {
            return Some(Unread::OtherMarkers { most, last, squares: self.layout.squares });
        }
        let flipped = Layout { light_first: !self.layout.light_first, ..self.layout.clone() };
        let of_flipped = if rows.is_multiple_of(2) { most(&flipped, self.markers) } else { 0 };
        let elsewhere = images.first().map_or(0, |image| self.strangers(image));
        if own >= ENOUGH && elsewhere < ACCIDENTS.max(own / 4) && of_flipped <= own {
            return None;
        }
        // Of all that may have been said wrongly, what explains most markers.
        let mut told = vec![(of_flipped, Unread::Layout { legacy: flipped.light_first })];
        for marker in RATIOS {
            let images = Layout { marker, ..self.layout.clone() }.images(self.markers);
            if let Some((count, found)) = images.first().and_then(|image| Some((image.len(), self.ratio(image)?))) {
                told.push((count, Unread::Ratio { found, asked: self.layout.marker }));
            }
        }
        for found in COLUMNS.filter(|found| *found != columns) {
            told.push((most(&high(found), &markers), Unread::OtherWidth { found, asked: columns }));
        }
        let contradiction = (own > 0 && elsewhere >= own).then_some(Unread::Elsewhere { here: own, elsewhere });
        let best = told.into_iter().rev().max_by_key(|(count, _)| *count);
        best.filter(|(count, _)| *count > own.max(ENOUGH - 1)).map(|(_, why)| why).or(contradiction)
    }

    /// Markers of a dictionary without a cell that is read wrong.
    fn exact(&self, dictionary: Dictionary) -> Vec<Marker> {
        let around = self.layout.plain() / self.layout.marker;
        read(self.picture, self.quads, around, dictionary).into_iter().filter(|marker| marker.wrong == 0).collect()
    }

    /// Why nothing at all was found.
    pub(super) fn nothing(&self) -> Unread {
        // Words with many cells are no accident; a few of few cells are.
        let mut families: Vec<Dictionary> = Dictionary::families().collect();
        families.sort_by_key(|family| std::cmp::Reverse(family.cells()));
        let other = families.into_iter().filter(|family| !family.is_akin(self.dictionary)).find_map(|family| {
            let around = self.layout.plain() / self.layout.marker;
            let readings = self.quads.iter().filter_map(|quad| quad.read(self.picture, family.cells(), around));
            let ids: Vec<Option<usize>> =
                readings.map(|reading| reading.markers(family, 0).first().map(|marker| marker.id)).collect();
            let mut known: Vec<usize> = ids.iter().flatten().copied().collect();
            let most = 2 * known.len() >= ids.len();
            known.sort_unstable();
            known.dedup();
            // Some may be accidents, with any number.
            (most && known.len() >= ENOUGH).then(|| known.get(known.len() * 3 / 4)).flatten().map(|id| family.with(*id))
        });
        match other {
            Some(found) => Unread::OtherDictionary { found, dictionary: self.dictionary },
            None => Unread::NoMarkers { dictionary: self.dictionary },
        }
    }

    /// Marker to square as the middles and corners of an image's markers have it, where it is not what was said.
    fn ratio(&self, image: &[Marker]) -> Option<f64> {
        let middles: Option<Vec<_>> =
            image.iter().map(|marker| Some((self.layout.middle(marker.id)?, marker.middle()))).collect();
        let back = homography(&middles?)?.try_inverse()?;
        let mut ratios = Vec::new();
        for marker in image {
            let corners: Option<Vec<_>> = marker.corners.iter().map(|c| map(&back, c.x, c.y)).collect();
            let corners = corners?;
            let around = corners.iter().zip(corners.iter().cycle().skip(1));
            ratios.extend(around.map(|(a, b)| (b - a).norm()));
        }
        let (found, asked) = (median(ratios), self.layout.marker);
        let pixel = median(image.iter().map(|marker| asked / marker.side_px()).collect());
        (image.len() >= ENOUGH && (found - asked).abs() > RATIO * asked + pixel).then_some(found)
    }

    /// How many markers stand within an image of the board that are none of it: where it has other ones, or none.
    pub(super) fn strangers(&self, image: &[Marker]) -> usize {
        let [columns, rows] = self.layout.squares.map(|n| n as f64 - 1.0);
        let Some(back) = homography(&self.layout.pairs(image)).and_then(|flat| flat.try_inverse()) else { return 0 };
        let within = |marker: &Marker| {
            let place = map(&back, marker.middle().x, marker.middle().y);
            place.is_some_and(|p| (-1.0..columns).contains(&p.x) && (-1.0..rows).contains(&p.y))
        };
        let stranger =
            |marker: &&Marker| marker.wrong == 0 && within(marker) && !image.iter().any(|own| own.is_at(marker));
        self.markers.iter().filter(stranger).count()
    }
}
